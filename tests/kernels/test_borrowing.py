"""Kernels that make no arrays count no references; those that make some keep them as long as they
are read.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba import njit
from numba.core.runtime import _nrt_python, rtsys

from isogi_core.kernels._compiler import Compiler

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")


class Pair(NamedTuple):
    """Two arrays."""

    a: Any
    b: Any


def borrowing(function: Any) -> Any:
    """``function``, compiled as kernels are."""
    return njit(pipeline_class=Compiler, error_model="numpy")(function)


@borrowing
def total(pair: Pair) -> float:
    """The sum of all products: reads parts of a record."""
    found = 0.0
    for i in range(pair.a.shape[0]):
        row = pair.a[i]
        other = pair.b[i]
        for j in range(row.shape[0]):
            found += row[j] * other[j]
    return found


@borrowing
def swapped(pair: Pair) -> float:
    """``total`` of a new record of the same arrays."""
    return float(total(Pair(pair.b, pair.a)))


@borrowing
def doubled(values: np.ndarray) -> np.ndarray:
    """A new array."""
    return 2.0 * values


@borrowing
def tail(values: np.ndarray) -> np.ndarray:
    """A part of an array, handed on."""
    return values[1:]


@borrowing
def shifted(values: np.ndarray) -> float:
    """Copy an array onto itself, one place on; the sum of it then, and of a new one."""
    values[1:] = values[:-1]
    return float(doubled(tail(values)).sum())


PAIR = Pair(np.arange(12.0).reshape(4, 3), np.ones((4, 3)))


def references(function: Any) -> int:
    """How often the compiled ``function`` speaks of counts of references."""
    return sum(
        each.count("NRT_incref") + each.count("NRT_decref")
        for each in function.inspect_llvm().values()
    )


@pytest.mark.parametrize("function", [total, swapped])
def test_what_only_reads_counts_no_references(function: Any) -> None:
    """Numba's own pipeline counts them for the same function."""
    assert function(PAIR) == 66.0
    assert references(function) == 0
    usual = njit(error_model="numpy")(function.py_func)
    assert usual(PAIR) == 66.0 and references(usual) > 0


@pytest.fixture
def counted() -> Iterator[None]:
    """Numba counts what it allocates meanwhile."""
    _nrt_python.memsys_enable_stats()
    yield
    _nrt_python.memsys_disable_stats()


@pytest.mark.slow
@pytest.mark.usefixtures("counted")
def test_what_makes_arrays_lets_go_of_all() -> None:
    """As many arrays are freed as are made, and those that are handed on live as long as they are
    read.
    """
    values = np.arange(1000.0)
    shifted(values.copy()), tail(values), total(PAIR)
    before = rtsys.get_allocation_stats()
    for _ in range(50):
        assert shifted(values.copy()) == 2.0 * values[:-1].sum()
        assert tail(values)[0] == 1.0 and swapped(PAIR) == 66.0
    after = rtsys.get_allocation_stats()
    made = after.alloc - before.alloc
    freed = after.free - before.free
    assert made >= 50 and made == freed
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free


def test_arrays_that_are_handed_on_outlive_their_giver() -> None:
    """What a helper returns is held by who has it, also where the array that it is a part of is
    gone.
    """
    parts = [tail(np.full(1000, float(k))) for k in range(200)]
    assert all((part == k).all() for k, part in enumerate(parts))
