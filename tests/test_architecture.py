"""The house's own rules: who imports whom, where errors live, what kernels may not do, what the help loads."""

import ast
import inspect
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from isogi_core.errors import IsogiError

ROOT = Path(__file__).parent.parent
PACKAGES = ("isogi_core", "worker", "server")
KERNELS = sorted((ROOT / "isogi_core" / "kernels").glob("*.py"))
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
HEAVY = ("numba", "llvmlite", "zarr", "distributed", "dask", "fastapi", "uvicorn")


def nodes(path: Path) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_import_contracts_hold() -> None:
    """In a process of its own: the linter's set-up of logging silences every logger that it finds."""
    command = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
    linted = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert linted.returncode == 0, linted.stdout + linted.stderr
    assert "0 broken" in linted.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_its_errors_in_one_module(package: str) -> None:
    module = import_module(f"{package}.errors")
    errors = [each for _, each in inspect.getmembers(module, inspect.isclass)]
    assert errors
    for error in errors:
        assert issubclass(error, IsogiError)
        assert error.__doc__


def errors_defined_in(tree: Iterator[ast.AST]) -> set[str]:
    """Names of the exceptions that a module defines."""
    classes = [node for node in tree if isinstance(node, ast.ClassDef)]
    bases = {node.name: {ast.unparse(base).split(".")[-1] for base in node.bases} for node in classes}
    return {name for name, of in bases.items() if any(base.endswith(("Error", "Exception")) for base in of)}


@pytest.mark.parametrize("path", [path for path in SOURCES if path.name != "errors.py"], ids=name_of)
def test_errors_are_defined_nowhere_else(path: Path) -> None:
    assert errors_defined_in(nodes(path)) == set()


def test_the_search_for_errors_finds_some() -> None:
    assert "StoreError" in errors_defined_in(nodes(ROOT / "isogi_core" / "errors.py"))


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_no_file_is_too_long_and_each_says_what_it_is(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 400
    assert path.name == "__main__.py" or ast.get_docstring(ast.parse(text))


def forbidden_options(tree: Iterator[ast.AST]) -> list[str]:
    """What a kernel module may not ask of Numba: parallel, the whole of fastmath, prange."""
    found = []
    for node in tree:
        if isinstance(node, ast.keyword) and node.arg in ("parallel", "fastmath"):
            value = node.value
            if not (isinstance(value, ast.Constant) and value.value is False):
                found.append(f"{node.arg}={ast.unparse(value)}")
        elif isinstance(node, ast.Dict):
            keys = [key.value for key in node.keys if isinstance(key, ast.Constant)]
            pairs = zip(keys, node.values, strict=False)
            found += [f"{k}: {ast.unparse(v)}" for k, v in pairs if k == "parallel" or is_true(k, v)]
        elif isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node).endswith("prange"):
            found.append("prange")
    return found


def is_true(key: object, value: ast.expr) -> bool:
    return key == "fastmath" and isinstance(value, ast.Constant) and value.value is True


@pytest.mark.parametrize("path", KERNELS, ids=name_of)
def test_no_kernel_is_parallel_or_takes_all_of_fastmath(path: Path) -> None:
    assert forbidden_options(nodes(path)) == []


@pytest.mark.parametrize(
    "text",
    [
        "@njit(parallel=True)\ndef f(): ...",
        "njit(fastmath=True)",
        "o = {'fastmath': True}",
        "for i in numba.prange(3): ...",
    ],
)
def test_the_search_for_forbidden_options_finds_them(text: str) -> None:
    assert forbidden_options(ast.walk(ast.parse(text)))


def test_the_one_decorator_asks_for_what_is_allowed() -> None:
    from isogi_core.kernels import _jit
    from isogi_core.kernels.transfer import bake_texels

    assert not {"nnan", "ninf", "fast"} & _jit.FASTMATH
    options = bake_texels.targetoptions
    assert options["nogil"] is True
    assert options["fastmath"] == _jit.FASTMATH
    assert not options.get("parallel", False)


def test_numba_is_asked_for_kernels_in_one_place_only() -> None:
    users = {name_of(path) for path in SOURCES if {"njit", "jit", "vectorize"} & imported_names(path)}
    assert users == {"isogi_core/kernels/_jit.py"}


def imported_names(path: Path) -> set[str]:
    imports = [node for node in nodes(path) if isinstance(node, ast.ImportFrom) and node.module == "numba"]
    return {alias.name for node in imports for alias in node.names}


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["render", "--help"], ["serve", "--port", "none"]])
def test_the_command_line_answers_without_loading_the_renderer(arguments: list[str]) -> None:
    code = f"""
import sys
from server.cli import run
status = run({arguments!r})
loaded = [name for name in {HEAVY!r} if name in sys.modules]
sys.exit(f"status {{status}}, loaded {{loaded}}")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1].endswith("loaded []"), done.stderr
