"""Warming up: in a house of two small kernels, each compiled once, in processes of their own."""

import threading

import pytest
from numba import config

from isogi_core.kernels import _compilation, _jit
from isogi_core.kernels._compilation import (
    Compilation,
    KernelProgress,
    in_order,
    warm,
    with_callees,
)
from isogi_core.kernels._jit import entries_of, load
from tests.compile_kernels import entry_kernels
from tests.scale import COMPILED

pytestmark = COMPILED

SMALL = """\
from isogi_core.kernels._jit import kernel

@kernel("float64(float64)")
def one(x):
    return x + 1.0

@kernel()
def twice(x):
    return one(one(x))

@kernel("float64(float64)")
def two(x):
    return twice(x)

@kernel("float64(float64)")
def never(x):
    return x
"""
ASK = """\
import sys
from isogi_core.kernels.small import never, one, two
from isogi_core.kernels._compilation import warm
if __name__ == "__main__":
    was = one.stored, two.stored
    warm((one, two))
    hits = [sum(each.ready.stats.cache_hits.values()) for each in (one, two)]
    sys.stdout.write(f"{was} {one.loaded} {two.loaded} {hits} {one(1.0)} {two(1.0)} ")
    sys.stdout.write(f"{never.loaded} {never.stored}")
"""


def test_once_it_is_stopped_nothing_is_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr(_jit, "KERNEL_FOLDER", tmp_path)
    entries = [_jit.Entry(lambda x: x, "float64(float64)", {}) for _ in range(2)]
    stopped = threading.Event()
    stopped.set()
    warm(entries, stopped)
    assert not any(entry.loaded or entry.stored for entry in entries)


def test_what_is_loaded_is_what_is_compiled_ahead(tmp_path, monkeypatch):
    monkeypatch.setattr(_jit, "KERNEL_FOLDER", tmp_path)
    monkeypatch.setattr(
        _jit.Entry, "_compile", lambda entry: setattr(entry, "_ready", entry.__wrapped__)
    )
    entries = [_jit.Entry(lambda x: x, "float64(float64)", {}) for _ in range(2)]
    assert entries_of([entries[0], max, entries[1]]) == entries
    load([max, entries[1]])
    assert [entry.loaded for entry in entries] == [False, True]


def entry_of(function):
    """An entry kernel that is compiled nowhere."""
    return _jit.Entry(function, "float64(float64)", {})


def leaf(x):
    return x


LEAF = entry_of(leaf)


def helper(x):
    return LEAF(x)


def branch(x):
    return helper(x) + helper(x)


BRANCH = entry_of(branch)


def root(x):
    return BRANCH(x) + LEAF(x)


ROOT = entry_of(root)


def test_an_entry_kernel_knows_what_it_is_made_of():
    assert ROOT.parts == (root, BRANCH, LEAF)
    assert BRANCH.parts == (branch, helper, LEAF)
    assert BRANCH.size == sum(len(each.__code__.co_code) for each in (branch, helper))
    assert BRANCH.callees == [LEAF] and LEAF.callees == []


def test_callees_come_before_their_callers():
    assert with_callees([ROOT, max, ROOT]) == [LEAF, BRANCH, ROOT]
    assert in_order([ROOT, BRANCH, LEAF])[0] is LEAF
    assert in_order([BRANCH, ROOT], [LEAF, BRANCH])[0] is max(
        BRANCH, ROOT, key=lambda each: each.size
    )


def test_progress_counts_what_the_machine_lacked(monkeypatch):
    stored = {LEAF}
    monkeypatch.setattr(_jit.Entry, "stored", property(lambda entry: entry in stored))
    monkeypatch.setattr(_compilation, "compile_in_processes", lambda names, *_: stored.add(BRANCH))
    work = Compilation([BRANCH], [ROOT])
    stopped = threading.Event()
    assert work.progress([ROOT]) == KernelProgress(0, 2, None)
    assert work.progress([LEAF]) is None
    work.begin(stopped)
    work.wait([BRANCH])
    done, total, seconds = work.progress([ROOT])
    assert (done, total) == (1, 2) and seconds >= 0.0
    assert work.progress([BRANCH]) is None
    stored.add(ROOT)
    assert work.progress([ROOT]) is None


@pytest.mark.slow
def test_what_is_missing_is_compiled_by_others_and_loaded_here(house):
    house.write("small.py", SMALL)
    answers = [house.ask(ASK) for _ in range(2)]
    if config.NUMBA_DEFAULT_NUM_THREADS > 1:
        hits = "[1, 1]"
    else:
        hits = "[0, 0]"
    assert answers[0] == f"(False, False) True True {hits} 2.0 3.0 False False"
    assert answers[1] == "(True, True) True True [1, 1] 2.0 3.0 False False"


def test_what_a_kernel_calls_by_address_is_known_before():
    """A name in its object file that nobody has told the address of would end the process."""
    entries = entry_kernels()
    for entry in entries:
        entry.ready  # noqa: B018
        module, name = entry.name.split(".")[-2:]
        (code,) = [
            path.read_bytes() for path in _jit.KERNEL_FOLDER.glob(f"*/{module}.{name}-*.nbc")
        ]
        called = {each.name for each in entries if b"\0" + each.name.encode() + b"\0" in code}
        assert called == {each.name for each in entry.callees}, entry.name
    assert sum(bool(entry.callees) for entry in entries) > 10
