"""What is in a published page."""

import gzip
import json
import re
from base64 import b64decode
from pathlib import Path
from typing import Any

ELEMENT = re.compile(r'<script type="text/plain" data-file="([^"]+)">([^<]*)</script>')


def files_in(page: Path) -> dict[str, bytes]:
    """The files that are in a page, unpacked, by their names."""
    found = ELEMENT.findall(page.read_text(encoding="utf-8"))
    return {name: gzip.decompress(b64decode(letters)) for name, letters in found}


def document_in(page: Path) -> dict[str, Any]:
    """What a page draws by."""
    document: dict[str, Any] = json.loads(files_in(page)["scene.json"])
    return document
