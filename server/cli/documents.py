"""Documents of views that commands read: JSON, TOML, or what a command reads from plain text."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from isogi_core.files.regular import read_small
from server.errors import ParameterError

MAX_DOCUMENT_BYTES = 1 << 26
"""Bytes of a file of views or directions, at most."""


def document_in(file: Path, otherwise: Callable[[str], Any]) -> Any:
    """What a JSON or TOML ``file`` holds; the text of any other is read by ``otherwise``. Raises ParameterError."""
    readers = {".json": json.loads, ".toml": tomllib.loads}
    try:
        return readers.get(file.suffix, otherwise)(read_small(file, MAX_DOCUMENT_BYTES).decode())
    except (OSError, RecursionError, ValueError) as error:
        raise ParameterError(f"{file.name} cannot be read: {error}.", "views-file") from None
