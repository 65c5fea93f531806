"""Modules that the product imports, as its files write them."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("isogi", "isogi_core", "isogi_report", "server", "worker", "web")
ALONE = ("isogi_client.py", "isogi_widget.py")
"""Folders and modules that a wheel holds."""

LOADERS = ("library", "import_module")
"""Functions that import the module that is their first argument."""


def modules_of(text: str) -> Iterator[str]:
    """The full names of modules that a file of Python imports, at once or late."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Import(names=names):
                yield from (each.name for each in names)
            case ast.ImportFrom(module=str(module), level=0):
                yield module
            case ast.Call(func=ast.Name(id=name), args=[ast.Constant(value=str(module)), *_]):
                if name in LOADERS:
                    yield module


def imports_of_product() -> Iterator[tuple[Path, str]]:
    """The files of the product, each with the full name of each module that it imports."""
    folders = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    for path in [*folders, *map(ROOT.joinpath, ALONE)]:
        for module in modules_of(path.read_text(encoding="utf-8")):
            yield path.relative_to(ROOT), module
