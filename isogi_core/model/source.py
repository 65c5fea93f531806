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
    if "://" in text:
        return SceneSource(name_of(Path(text)), {"volume": text, **overrides}, Path.cwd())
    path = Path(text).resolve()
    if path.suffix != ".toml":
        whole = next((each for each in path.parents if each.suffix == ".zarr"), path)
        name, place = name_of(path), str(path.relative_to(whole.parent))
        return SceneSource(name, {"volume": place, **overrides}, whole.parent)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"Cannot read the scene {path}: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"The scene {path} is not valid TOML: {error}.") from error
    return SceneSource(path.stem, {**document, **overrides}, path.parent)


def is_zarr(path: Path) -> bool:
    """Whether a volume at ``path`` is to be read as Zarr: a folder, or a place in one that ends in .zarr."""
    return path.is_dir() or (not path.is_file() and any(each.suffix == ".zarr" for each in (path, *path.parents)))


def name_of(path: Path) -> str:
    """What a person calls the volume at ``path``: the file's name, and what is chosen of a Zarr hierarchy."""
    whole = next((each for each in path.parents if each.suffix == ".zarr"), path)
    return "-".join([whole.stem, *path.relative_to(whole).parts])
