"""Isovalues that comments of files name."""

import math
import re

_LEVEL = re.compile(
    r"isocontour range for [\d.]+ ?% of the density: \(([-+\d.eE]+), ?([-+\d.eE]+)\)"
    r"|\b(?:isovalue|isolevel|contour level)s?\b\s*[:=]?\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)",
    re.IGNORECASE,
)
"""How a comment names an isovalue: Psi4 names those that hold a share of the density."""


def level_in(comments: str) -> float | None:
    """The isovalue that ``comments`` of a file name, None if they name none."""
    found = _LEVEL.search(comments)
    if found is None:
        return None
    try:
        levels = [float(each) for each in found.groups() if each is not None]
    except ValueError:
        return None
    return max(levels, key=abs) if all(map(math.isfinite, levels)) else None
