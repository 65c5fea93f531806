"""Numbers as messages and file names write them: as short as they may be, and no shorter."""

from collections.abc import Callable

FEWEST_DIGITS = 6
MOST_DIGITS = 17
"""Digits of a number: as many as a person reads at a glance, and as many as a float has."""


LEAST_POWER = 1e16
"""The least number that is written with a power of ten: others are whole numbers in full."""


def shortest(value: float, same: Callable[[float], bool] | None = None) -> str:
    """Write a number with the fewest digits that give it again, at least FEWEST_DIGITS of them; or
    another number that is the ``same`` for some use.
    """
    for digits in range(FEWEST_DIGITS, MOST_DIGITS):
        text = f"{value:.{digits}g}"
        if "e+" in text and abs(value) < LEAST_POWER:
            text = f"{float(text):.0f}"
        if float(text) == value or (same is not None and same(float(text))):
            return text
    return f"{value:.{MOST_DIGITS}g}"
