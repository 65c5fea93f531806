"""Runs: functions that divide work into pieces, and call them on the caller's thread or on
others.
"""

from collections.abc import Callable
from typing import Protocol

Piece = Callable[[int, int], object]
"""Function that does the work from ``first`` to before ``last``."""


class Run(Protocol):
    """Calls a function over the ranges of a whole, as ``frame.tiles.Tiles.run`` does."""

    def __call__(self, piece: Piece, total: int, size: int) -> None:
        """Call ``piece(first, last)`` for ranges of ``size`` up to ``total``. May raise
        Cancelled between them.
        """


def serially(piece: Piece, total: int, size: int) -> None:
    """Run one piece after another, on the caller's thread."""
    for first in range(0, total, size):
        piece(first, min(first + size, total))
