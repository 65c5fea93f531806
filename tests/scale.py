"""How much tests do: all of it with compiled kernels, and little where Numba is switched off and
Python runs them.
"""

from typing import TypeVar

import pytest
from numba import config

Amount = TypeVar("Amount")

PYTHON = bool(config.DISABLE_JIT)
"""Whether Python runs the kernels."""

COMPILED = pytest.mark.skipif(PYTHON, reason="only compiled kernels do that, or so much of it")
"""Mark of tests of compilation, and of those that Python is too slow for."""


def many(count: int) -> int:
    """A count of cheap items with compiled kernels, and a thousandth of it in Python, at least
    100.
    """
    return few(count, max(count // 1000, 100))


def few(compiled: Amount, in_python: Amount) -> Amount:
    """How many rays, paths, … of a test: so many with compiled kernels, and so few in Python."""
    return in_python if PYTHON else compiled
