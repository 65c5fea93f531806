"""A letter F in relief, in the world of a patient, as arrays that lie in it in any of the 48 ways
of a box.
"""

from itertools import permutations, product
from typing import Any

import numpy as np

SIZE = (16, 20, 12)
"""Voxels along the world's x, y, z: no two alike."""

STEPS = (1.0, 1.25, 1.5)
"""Millimetres along the same."""

ORIGIN = (-7.0, 31.5, -4.25)


def letter() -> np.ndarray:
    """The phantom (z, y, x) int16: a plate with an F upon it, and soft edges; no turn or mirror
    brings it to itself.
    """
    f = np.zeros(SIZE)
    f[2:14, 2:18, 2:5] = 400.0
    f[4:7, 3:17, 5:9] = 800.0
    f[7:12, 14:17, 5:9] = 800.0
    f[7:10, 9:11, 5:9] = 800.0
    for axis in range(3):
        f = (np.roll(f, 1, axis) + 2.0 * f + np.roll(f, -1, axis)) / 4.0
    return np.ascontiguousarray(f.transpose(2, 1, 0).round().astype(np.int16))


def affine() -> np.ndarray:
    """From the phantom's indices x, y, z to the world's right, anterior, superior; (4, 4)."""
    return np.vstack([np.column_stack([np.diag(STEPS), ORIGIN]), [0.0, 0.0, 0.0, 1.0]])


WAYS = [(order, signs) for order in permutations(range(3)) for signs in product((1, -1), repeat=3)]
"""All 48: which of the world's axes each of the array's lies along, and which way."""


def lying(order: tuple[int, ...], signs: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The phantom as an array (z, y, x) whose index axes lie as told, and its affine; the world is
    the same.
    """
    whole = letter().transpose(2, 1, 0)
    array = np.transpose(whole, order)[tuple(slice(None, None, sign) for sign in signs)]
    back = np.zeros((4, 4))
    back[3, 3] = 1.0
    for axis, (along, sign) in enumerate(zip(order, signs, strict=True)):
        back[along, axis] = sign
        back[along, 3] = SIZE[along] - 1 if sign < 0 else 0
    return np.ascontiguousarray(array.transpose(2, 1, 0)), affine() @ back


def landmarks() -> np.ndarray:
    """Eight indices (8, 3) of the phantom, x, y, z: its corners, drawn in a little."""
    return np.array([[x, y, z] for x in (3, 12) for y in (4, 16) for z in (2, 9)])


def world(indices: Any) -> np.ndarray:
    """World coordinates of the phantom's indices (n, 3)."""
    return np.asarray(indices) * np.array(STEPS) + np.array(ORIGIN)
