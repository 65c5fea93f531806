"""Voxels of published pages: those that draw isosurfaces of a range, as differences from a
prediction; docs/card.md has the layout of their files.
"""

from itertools import pairwise

import numpy as np

from isogi_core.frame.card.coding import byte_planes, fold_signs


def voxels_file(codes: np.ndarray, needed: np.ndarray) -> bytes:
    """Return the file of some layers of a volume, from which their ``codes`` (layers, ny, nx)
    can be read exactly.

    Voxels that are not ``needed`` (layers, ny, nx) are idle. A reader guesses that a voxel which
    the file does not state has the least idle value if the voxel before it is at most that, and
    else the greatest. So idle voxels take few bytes if they have two values, in large regions.
    """
    idle = codes[~needed]
    if idle.size:
        sides = np.array([idle.min(), idle.max()], codes.dtype)
    else:
        sides = np.zeros(2, codes.dtype)
    # State each voxel that a reader would guess wrongly.
    before = voxels_before(codes)
    stated = needed | (codes != np.where(before <= sides[0], sides[0], sides[1]))
    # Mark where stated voxels begin and end along z: borders are fewer than voxels.
    changes = stated.copy()
    changes[1:] ^= stated[:-1]
    marks = np.packbits(changes, axis=0, bitorder="little")
    return sides.tobytes() + marks.tobytes() + byte_planes(differences(codes)[stated])


def voxels_before(codes: np.ndarray) -> np.ndarray:
    """Return the voxel before each of some layers, of the same shape: along x; at the first x
    along y; at the first x and y along z; 0 before the first one of all.
    """
    before = np.zeros_like(codes)
    before[:, :, 1:] = codes[:, :, :-1]
    before[:, 1:, 0] = codes[:, :-1, 0]
    before[1:, 0, 0] = codes[:-1, 0, 0]
    return before


def differences(codes: np.ndarray) -> np.ndarray:
    """Return the differences of ``codes`` from their predictions, modulo their range, as codes that
    are small for small differences of either sign; of the same shape, unsigned.

    Floats count as the integers that have their bits.
    """
    size = codes.dtype.itemsize
    whole = codes.view(f"<u{size}")
    apart = (whole - predictions(whole)).astype(f"<i{size}")
    return fold_signs(apart)


def predictions(whole: np.ndarray) -> np.ndarray:
    """Predict each of some layers of integers by those before it along x, y and z; int64, of the
    same shape.

    The prediction is the median of the three neighbours before it, and of what three planes and a
    trilinear function through its seven neighbours give: it follows edges and slopes alike
    (Martucci 1990, with one more axis).
    """
    # Neighbours outside of the layers are 0.
    wide = np.pad(whole.astype(np.int64), [(1, 0)] * 3)
    found = np.empty(whole.shape, np.int64)
    for z, (above, layer) in enumerate(pairwise(wide)):
        x, y, z1 = layer[1:, :-1], layer[:-1, 1:], above[1:, 1:]
        xy, xz, yz = layer[:-1, :-1], above[1:, :-1], above[:-1, 1:]
        xyz = above[:-1, :-1]
        guesses = (x, y, z1, x + y - xy, x + z1 - xz, y + z1 - yz, x + y + z1 - xy - xz - yz + xyz)
        found[z] = np.partition(np.stack(guesses), 3, axis=0)[3]
    return found
