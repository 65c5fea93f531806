"""Compiled kernels: options, one signature each, and a cache that follows every edit of a
source.
"""

import ast
import importlib
import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numba
import pytest
from numba import config

from isogi_core.kernels import _cache_folder, _jit
from tests.scale import COMPILED

FOLDER = Path(_jit.__file__).parent
SOURCES = sorted(FOLDER.rglob("*.py"))


def kernel_names():
    """Every kernel as (module, name, whether it is an entry kernel): entry kernels name their
    types.
    """
    for path in SOURCES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef):
                for mark in node.decorator_list:
                    if isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "kernel":
                        module = ".".join(path.relative_to(FOLDER).with_suffix("").parts)
                        yield module, node.name, bool(mark.args)


KERNELS = list(kernel_names())
ENTRIES = [(module, name) for module, name, entry in KERNELS if entry]


def find(module, name):
    """A kernel by its module and name."""
    return getattr(importlib.import_module(f"isogi_core.kernels.{module}"), name)


def test_kernels_were_found():
    assert len(KERNELS) > 60 and len(ENTRIES) > 10


@COMPILED
def test_an_entry_kernel_has_exactly_one_signature():
    for module, name in ENTRIES:
        entry = find(module, name)
        (signature,) = entry.ready.signatures
        with pytest.raises(TypeError, match="No matching definition"):
            entry(*[None] * len(signature))


@COMPILED
def test_options_keep_threads_out_and_nan_in():
    for module, name, _ in KERNELS:
        options = find(module, name).targetoptions
        assert options["nogil"] and options["error_model"] == "numpy", (module, name)
        assert not options.get("parallel", False), (module, name)
        math = options["fastmath"]
        assert math in (_jit.FASTMATH, _jit.EXACT, _jit.ANY_ORDER), (
            f"{module}.{name}: more would make isnan() False"
        )
    assert _jit.EXACT < _jit.FASTMATH == {"nsz", "contract"}
    assert _jit.FASTMATH | {"reassoc"} == _jit.ANY_ORDER


@COMPILED
def test_the_cache_lies_in_the_folder_of_these_sources():
    assert Path(config.CACHE_DIR) == _jit.KERNEL_FOLDER
    assert _jit.KERNEL_FOLDER.name == _cache_folder.sources_digest()


def test_the_cache_goes_where_it_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("ISOGI_KERNEL_CACHE", raising=False)
    assert _cache_folder.cache_folder().parent == tmp_path / "xdg" / "isogi" / "kernels"
    monkeypatch.setenv("ISOGI_KERNEL_CACHE", str(tmp_path / "told"))
    assert _cache_folder.cache_folder().parent == tmp_path / "told"


def test_editing_any_source_changes_the_digest(monkeypatch, tmp_path):
    shutil.copytree(FOLDER, tmp_path / "kernels", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(_cache_folder, "__file__", str(tmp_path / "kernels" / "_cache_folder.py"))
    for edited in (path.relative_to(FOLDER) for path in SOURCES):
        before = _cache_folder.sources_digest()
        with (tmp_path / "kernels" / edited).open("a", encoding="utf-8") as source:
            source.write("\n")
        after = _cache_folder.sources_digest()
        (tmp_path / "kernels" / edited).rename(tmp_path / "kernels" / edited.with_stem("renamed"))
        assert len({before, after, _cache_folder.sources_digest()}) == 3, edited
        (tmp_path / "kernels" / edited.with_stem("renamed")).rename(tmp_path / "kernels" / edited)


def test_another_checkout_or_a_touched_source_has_its_own_digest(monkeypatch, tmp_path):
    """Numba loads nothing that was compiled from another path, or before its source was touched."""
    digests = []
    for name in ("here", "there"):
        shutil.copytree(FOLDER, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
        monkeypatch.setattr(_cache_folder, "__file__", str(tmp_path / name / "_cache_folder.py"))
        digests += [_cache_folder.sources_digest(), _cache_folder.sources_digest()]
    os.utime(tmp_path / "there" / "_jit.py", (1, 1))
    digests.append(_cache_folder.sources_digest())
    here, here_again, there, there_again, touched = digests
    assert (here, there) == (here_again, there_again)
    assert len({here, there, touched}) == 3


ENTRY = """\
from isogi_core.kernels._jit import kernel
from isogi_core.kernels.helper import shift

@kernel("float64(float64)")
def entry(x):
    return shift(x)
"""
HELPER = """\
from isogi_core.kernels._jit import kernel

@kernel()
def shift(x):
    return x + {}
"""
ASK = """\
import sys
from isogi_core.kernels.entry import entry
assert not entry.loaded
sys.stdout.write(f"{entry(1.0)} {sum(entry.ready.stats.cache_hits.values())}")
"""


@pytest.mark.long
@pytest.mark.slow
@COMPILED
def test_an_edited_helper_is_compiled_anew_an_old_one_loaded(house):
    """A house of two files, each run a fresh process: the entry kernel's own file never changes."""
    house.write("entry.py", ENTRY)
    answers = []
    for step in (1.0, 1.0, 2.5, 1.0):
        house.write("helper.py", HELPER.format(step), step)
        answers.append(house.ask(ASK))
    assert answers == ["2.0 0", "2.0 1", "3.5 0", "2.0 1"]
    assert len(list(house.cache.iterdir())) == 2


MORE = """\
from isogi_core.kernels._jit import kernel

@kernel("float64(float64)")
def more(x):
    return x + 2.0
"""
ASK_BOTH = """\
import os, subprocess, sys
from isogi_core.kernels import _jit
from isogi_core.kernels.entry import entry
from isogi_core.kernels.more import more
stored = entry.stored
def hits(kernel):
    kernel(1.0)
    return sum(kernel.ready.stats.cache_hits.values())
sys.stdout.write(f"{stored} {hits(entry)} {hits(more)} {_jit.KERNEL_FOLDER} ")
sys.stdout.flush()
if "--again" not in sys.argv:
    subprocess.run([sys.executable, __file__, "--again"], check=True)
"""
READ_ONLY = (
    "unshare",
    "--mount",
    "sh",
    "-c",
    'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0" && exec "$@"',
)
"""Runs a command, if root may, where a folder is read-only for everybody."""


def write_two(house):
    """Two entry kernels, and a helper of the first."""
    house.write("helper.py", HELPER.format(1.0))
    house.write("entry.py", ENTRY)
    house.write("more.py", MORE)


@pytest.fixture
def sealed(house):
    """The command before one in which the cache of the house is read-only; it has one kernel of
    two.
    """
    write_two(house)
    house.ask("import isogi_core.kernels.entry as e; e.entry(1.0)")
    if os.geteuid():
        folders = [house.cache, *(each for each in house.cache.rglob("*") if each.is_dir())]
        for folder in folders:
            folder.chmod(0o555)
        yield ()
        for folder in folders:
            folder.chmod(0o755)
        return
    before = (*READ_ONLY, str(house.cache))
    if subprocess.run([*before, "true"], check=False, capture_output=True).returncode:
        pytest.skip("folders cannot be made read-only for root here")
    yield before


@pytest.mark.slow
@COMPILED
def test_a_read_only_cache_is_used_and_added_to_elsewhere(house, sealed, tmp_path):
    """Such as one in an image: what it has is loaded, and what it lacks is compiled once."""
    before = sorted(house.cache.rglob("*"))
    (tmp_path / "room").mkdir()
    said = house.ask(ASK_BOTH, *sealed, TMPDIR=str(tmp_path / "room"))
    stored, *rest = said.split()
    folder = rest[2]
    assert (stored, rest[:2]) == ("True", ["1", "0"])
    assert rest[3:] == ["True", "1", "1", folder], "a process that it starts shares the folder"
    assert folder.startswith(str(tmp_path / "room")) and sorted(house.cache.rglob("*")) == before
    said = house.ask(ASK_BOTH, *sealed, TMPDIR=str(tmp_path / "room"))
    assert said.split()[:4] == ["True", "1", "1", folder]


@pytest.mark.slow
@COMPILED
def test_a_cache_that_cannot_be_made_is_replaced(house, tmp_path):
    write_two(house)
    room = tmp_path / "room"
    room.mkdir()
    cache = "/proc/version/kernels"
    said = house.ask(ASK_BOTH, ISOGI_KERNEL_CACHE=cache, TMPDIR=str(room)).split()
    assert said[:3] == ["False", "0", "0"] and said[4:7] == ["True", "1", "1"]
    assert said[3] == said[7] and said[3].startswith(str(room))


@COMPILED
def test_threads_that_call_a_kernel_wait_for_one_compilation(tmp_path, monkeypatch):
    monkeypatch.setattr(_jit, "KERNEL_FOLDER", tmp_path)
    made = []

    def compile_here(signature, cache, **options):
        made.append(signature)
        return numba.njit(signature, **options)

    monkeypatch.setattr(_jit, "njit", compile_here)
    entry = _jit.Entry(lambda x: x + 1.0, "float64(float64)", {"nogil": True})
    assert not entry.loaded
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(entry, [1.0, 2.0, 3.0, 4.0])) == [2.0, 3.0, 4.0, 5.0]
    assert entry.loaded
    assert made == ["float64(float64)"]


@COMPILED
def test_a_kernel_that_somebody_is_at_is_left_to_them(tmp_path, monkeypatch):
    monkeypatch.setattr(_jit, "KERNEL_FOLDER", tmp_path)
    monkeypatch.setattr(
        _jit.Entry, "_compile", lambda entry: setattr(entry, "_ready", entry.__wrapped__)
    )
    entry = _jit.Entry(lambda x: x, "float64(float64)", {})
    with _cache_folder.locked(tmp_path / f"{entry.name}.lock"):
        entry.offer()
    assert not entry.loaded
    entry.offer()
    assert entry.loaded


class Square(NamedTuple):
    """A square by its side."""

    side: float


class Box(NamedTuple):
    """A box by its two sides."""

    width: float
    height: float


@_jit.Choice
def area(shape, scale):
    """The area of a shape."""


@area.case(Square)
def area_of_square(shape, scale):
    """The area of a square."""
    return scale * shape.side * shape.side


@area.case()
def area_of_others(shape, scale):
    """The area of a box."""
    return scale * shape.width * shape.height


@_jit.kernel()
def areas(side, width):
    """Areas of a square and of a box, which one helper chooses between."""
    return area(Square(side), 2.0), area(Box(width, side), 1.0)


def test_a_choice_takes_the_body_for_its_record():
    """The case of the record where there is one, compiled or run by Python, else the one without
    records.
    """
    assert areas(3.0, 5.0) == (18.0, 15.0)
    assert area(Square(2.0), 1.0) == 4.0


@_jit.Choice
def rim(shape, other):
    """The rim of two shapes."""


@rim.case(Square)
def rim_of_squares(shape, other):
    """The rim of what has a square in it."""


@rim.case(Box)
def rim_of_boxes(shape, other):
    """The rim of what has a box in it."""


def test_a_choice_refuses_two_cases_that_fit_alike():
    """No order of imports decides which of them runs: the one who adds a case hears of it."""
    with pytest.raises(TypeError, match="rim has two cases"):
        rim(Square(1.0), Box(1.0, 2.0))
    assert rim(Square(1.0), Square(1.0)) is None


def test_helpers_find_every_body_of_a_choice():
    """Entry kernels that any of the bodies calls must be loaded before: they count as parts."""
    found = {}
    _jit.find_parts(getattr(areas, "py_func", areas), found)
    assert {each.__name__ for each in found} >= {"areas", "area_of_square", "area_of_others"}
