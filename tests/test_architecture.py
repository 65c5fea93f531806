"""The house's own rules: who imports whom, where errors live, what kernels may not do, what the
help loads.
"""

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from isogi_core.errors import IsogiError

ROOT = Path(__file__).parent.parent
PACKAGES = ("isogi_core", "worker", "server")
SOURCES = [
    path
    for package in (*PACKAGES, "isogi_report")
    for path in sorted((ROOT / package).rglob("*.py"))
]
TESTS = sorted((ROOT / "tests").rglob("*.py"))
HEAVY = ("numba", "llvmlite", "zarr", "distributed", "dask", "fastapi", "uvicorn")
LONGEST_TEST_NAME = 60


def nodes(path: Path) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def offenders(paths: Iterable[Path], faults: Callable[[Path], Any]) -> dict[str, Any]:
    """Files in which ``faults`` finds some, and these."""
    found = {name_of(path): faults(path) for path in paths}
    return {name: faults for name, faults in found.items() if faults}


@pytest.mark.parametrize("package", ["isogi_core", "isogi_worker", "isogi_server"])
def test_each_package_has_its_errors_in_one_module(package: str) -> None:
    module = import_module(f"{package}.errors")
    errors = [each for _, each in inspect.getmembers(module, inspect.isclass)]
    assert errors
    for error in errors:
        assert issubclass(error, IsogiError)
        assert error.__doc__


@cache
def facts_of_sources(path: Path) -> tuple[set[str], set[str], str | None]:
    """Errors that a source file defines, names it imports from Numba, and its docstring; each file
    is parsed once.
    """
    module, *others = nodes(path)
    assert isinstance(module, ast.Module)
    return errors_defined_in(others), names_from_numba(others), ast.get_docstring(module)


def errors_defined_in(tree: Iterable[ast.AST]) -> set[str]:
    """Names of the exceptions that a module defines."""
    classes = [node for node in tree if isinstance(node, ast.ClassDef)]
    bases = {
        node.name: {ast.unparse(base).split(".")[-1] for base in node.bases} for node in classes
    }
    return {
        name
        for name, of in bases.items()
        if any(base.endswith(("Error", "Exception")) for base in of)
    }


def test_errors_are_defined_nowhere_else() -> None:
    others = [path for path in SOURCES if path.name != "errors.py"]
    assert offenders(others, lambda path: facts_of_sources(path)[0]) == {}


def test_the_search_for_errors_finds_some() -> None:
    assert "StoreError" in errors_defined_in(nodes(ROOT / "isogi_core" / "errors.py"))


def has_no_docstring(path: Path) -> bool:
    return path.name != "__main__.py" and not facts_of_sources(path)[2]


def test_each_file_says_what_it_is() -> None:
    assert offenders(SOURCES, has_no_docstring) == {}


LEANING = re.compile(r"(The same|That|Those|These|They|Them|Its?|As|Such)\b")
"""How docstrings begin that mean nothing in a help window, where the name above is not seen."""

SAYS_NOTHING = re.compile(
    "AHEAD|CROWDED|ENOUGH|EVEN|FAR|FEW|FIRST|KEPT|LARGE|LARGEST|LEAST|LONGEST|MANY|MARGIN|MORE|MOST|NARROW|NEAR|NOTHING"
    "|ONE|OWN|PATIENCE|PIECE|REACH|SHARE|SHORT|SMALL|STEP|STEPS|UNKNOWN|USUAL|WHOLE"
)
"""Names of constants that do not say of what: MAX_SURVEYED_VOXELS does, and MOST does not."""


def vague_constants(path: Path) -> list[str]:
    """Constants of a module whose names say how much, and not of what."""
    lines = [
        node
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign)
    ]
    targets = [each for line in lines for target in line.targets for each in ast.walk(target)]
    names = [each.id for each in targets if isinstance(each, ast.Name)]
    return [name for name in names if SAYS_NOTHING.fullmatch(name)]


def test_constants_say_of_what() -> None:
    assert len(SOURCES) > 200
    assert offenders(SOURCES, vague_constants) == {}


def test_the_search_for_vague_constants_finds_them(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text("MOST = 3\nFEW, MAX_CHUNKS = 1, 2\nSTEP_MARK = '+'\n")
    assert vague_constants(module) == ["MOST", "FEW"]


def docstrings(path: Path) -> Iterator[str]:
    """The docstrings of a module, its classes and functions, and the strings below assignments."""
    for node in nodes(path):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
            yield from (
                below for above, below in pairwise(map(text_of, node.body)) if not above and below
            )


def text_of(node: ast.stmt) -> str:
    """The text of a statement that is a string alone; else nothing."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        value = node.value.value
    else:
        value = ""
    return value if isinstance(value, str) else ""


def leaning(path: Path) -> list[str]:
    """First lines of docstrings that lean on what stands above them."""
    return [text.splitlines()[0] for text in docstrings(path) if LEANING.match(text)]


def test_docstrings_stand_alone_in_a_help_window() -> None:
    clients = [ROOT / "isogi/client.py", ROOT / "isogi/widget.py"]
    assert offenders((*SOURCES, *clients), leaning) == {}


def test_the_search_for_leaning_docstrings_finds_them(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    texts = (
        "The same, held.",
        "Italic text.",
        "Its middle.",
        "That of a scene.",
        "A scene.",
        "Assembly.",
    )
    module.write_text(
        "\n".join(f'def f{i}():\n    """{text}"""' for i, text in enumerate(texts))
        + '\nX = 1\n"""Those."""\n'
    )
    assert leaning(module) == ["Those.", "The same, held.", "Its middle.", "That of a scene."]


def test_numba_is_asked_for_kernels_in_one_place_only() -> None:
    users = {
        name_of(path)
        for path in SOURCES
        if {"njit", "jit", "vectorize"} & facts_of_sources(path)[1]
    }
    assert users == {"isogi_core/kernels/_jit.py"}


def names_from_numba(tree: Iterable[ast.AST]) -> set[str]:
    imports = [node for node in tree if isinstance(node, ast.ImportFrom) and node.module == "numba"]
    return {alias.name for node in imports for alias in node.names}


QUICK = (["--help"], ["--version"], ["render", "--help"], ["serve", "--port", "none"])
"""What the command line answers without loading the renderer."""


def test_help_versions_and_refusals_load_no_renderer() -> None:
    code = f"""
import sys
from isogi_server.cli.command import run
for arguments in {QUICK!r}:
    status = run(arguments)
    loaded = [name for name in {HEAVY!r} if name in sys.modules]
    if loaded:
        sys.exit(f"{{arguments}}: status {{status}}, loaded {{loaded}}")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "serve" in done.stdout


def names_too_long(tree: Iterable[ast.AST]) -> list[str]:
    names = [node.name for node in tree if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return [name for name in names if name.startswith("test_") and len(name) > LONGEST_TEST_NAME]


@cache
def faults_of_tests(path: Path) -> tuple[list[str], list[str], list[str]]:
    """Long names, imported test modules and replaced clocks in a file of tests, which is parsed
    once.
    """
    tree = list(nodes(path))
    return names_too_long(tree), imported_test_modules(tree), clocks_replaced(tree)


def test_names_of_tests_are_short() -> None:
    assert offenders(TESTS, lambda path: faults_of_tests(path)[0]) == {}


def imported_test_modules(tree: Iterable[ast.AST]) -> list[str]:
    """Test modules from which a module imports."""
    modules = [node.module or "" for node in tree if isinstance(node, ast.ImportFrom)]
    return [name for name in modules if name.split(".")[-1].startswith("test_")]


def test_no_test_module_is_imported() -> None:
    assert offenders(TESTS, lambda path: faults_of_tests(path)[1]) == {}


def clocks_replaced(tree: Iterable[ast.AST]) -> list[str]:
    """Functions of the clock that a test replaces in the module ``time`` itself, and so for the
    whole process.
    """
    patches = [
        node for node in tree if isinstance(node, ast.Call) and is_patch(node.func) and node.args
    ]
    targets = [ast.unparse(node.args[0]).strip("'\"") for node in patches]
    return [target for target in targets if re.fullmatch(r"(.*\.)?(time|datetime)(\.\w+)?", target)]


def is_patch(function: ast.expr) -> bool:
    return isinstance(function, ast.Attribute) and function.attr in ("setattr", "patch", "object")


def test_the_clock_is_replaced_for_no_whole_process() -> None:
    assert offenders(TESTS, lambda path: faults_of_tests(path)[2]) == {}


@pytest.mark.parametrize(
    "text",
    [
        "m.setattr(time, 'monotonic', f)",
        "m.setattr('time.time', f)",
        "mock.patch('server.jobs.time.monotonic', f)",
        "mock.patch.object(jobs.time, 'sleep')",
    ],
)
def test_the_search_for_replaced_clocks_finds_them(text: str) -> None:
    assert clocks_replaced(ast.walk(ast.parse(text)))


def test_a_clock_of_one_module_may_be_replaced() -> None:
    assert not clocks_replaced(
        ast.walk(ast.parse("m.setattr(jobs, 'time', clock); m.setattr(jobs, 'now', f)"))
    )


CLUSTER_MODULES = {"distributed", "dask", "tornado", "cryptography"}
"""Modules that only a server loads that joins a cluster."""

COMMANDS = ("serve", "render", "prewarm")
LOADED_TO_BAKE = (*(f"isogi_server.cli.{each}" for each in COMMANDS), "isogi_worker.local_pool")


def test_who_joins_no_cluster_loads_nothing_of_clusters() -> None:
    """Neither a server nor `isogi render`, nor their workers, which run
    ``isogi_worker.local_worker``.
    """
    program = f"import sys, {', '.join(LOADED_TO_BAKE)}; print(*sys.modules)"
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    loaded = set(told.stdout.split())
    assert "isogi_worker.local_worker" in loaded
    assert loaded & CLUSTER_MODULES == set()


WEB_FRAMEWORK = {"fastapi", "starlette", "uvicorn", "anyio"}


def test_a_picture_is_rendered_without_the_web_framework() -> None:
    told = subprocess.run(
        [sys.executable, "-c", "import sys, isogi_server.cli.render; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert set(told.stdout.split()) & WEB_FRAMEWORK == set()
