"""Where a scene comes from: a TOML file, a bare volume file, or a built-in demo."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from isogi_core.errors import SceneError

DEFAULT_DEMO = "demo:casting"


@dataclass(frozen=True)
class SceneSource:
    """A scene as it was written: enough for another process to build the same scene.

    ``document`` is the parsed TOML; paths in it are relative to the folder ``base``.
    """

    name: str
    document: Mapping[str, Any] = field(hash=False)
    base: Path


def find_source(target: str | Path | None, overrides: Mapping[str, Any]) -> SceneSource:
    """Read what was written of a scene, without opening its volume."""
    text = str(target or DEFAULT_DEMO)
    if text.startswith("demo:"):
        return SceneSource(text.removeprefix("demo:"), {"volume": text, **overrides}, Path.cwd())
    path = Path(text).resolve()
    if path.suffix != ".toml":
        return SceneSource(path.stem, {"volume": path.name, **overrides}, path.parent)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"Cannot read the scene {path}: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"The scene {path} is not valid TOML: {error}.") from error
    return SceneSource(path.stem, {**document, **overrides}, path.parent)
