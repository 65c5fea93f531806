"""Each library that the product imports is one that ``pyproject.toml`` declares."""

import sys
import tomllib
from collections import defaultdict
from collections.abc import Mapping

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.package.imports import ROOT, imports_of_product, modules_of

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

DISTRIBUTIONS = {"PIL": "pillow", "nrrd": "pynrrd", "vtkmodules": "vtk"}
"""Distributions whose names are not those of their modules."""

UNDECLARED = {"hdf5plugin"}
"""Filters that few HDF5 files need: the message about such a file says how to install them."""

TOOLS = {"bench", "dev"}
"""Extras that the product does without."""


def imported() -> Mapping[str, set[str]]:
    """The files that import each library, by the name of its distribution."""
    found = defaultdict[str, set[str]](set)
    for path, module in imports_of_product():
        name = module.partition(".")[0]
        if name not in sys.stdlib_module_names and not name.startswith("isogi"):
            found[DISTRIBUTIONS.get(name, canonicalize_name(name))].add(str(path))
    return found


def declared() -> set[str]:
    """The distributions that the wheel asks for, with all extras of the product."""
    extras = PROJECT["optional-dependencies"]
    groups = [PROJECT["dependencies"], *(extras[each] for each in extras.keys() - TOOLS)]
    return {canonicalize_name(Requirement(each).name) for group in groups for each in group}


def test_each_imported_library_is_declared() -> None:
    found = imported()
    assert {"numpy", "starlette", "pillow", "vtk", "astropy"} <= found.keys()
    allowed = declared() | UNDECLARED
    assert {name: files for name, files in found.items() if name not in allowed} == {}


@pytest.mark.parametrize(
    "line",
    [
        "import strange.part as part",
        "from strange.part import name",
        "def late():\n    import strange.part",
        'part = library("strange.part", "a kind")',
        'part = import_module("strange.part")',
    ],
)
def test_imports_are_found_however_they_are_written(line: str) -> None:
    assert list(modules_of(line)) == ["strange.part"]
