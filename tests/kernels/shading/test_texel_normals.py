"""Normals of texels: those that a bake lights them about, on their own isosurfaces and
projected.
"""

import numpy as np
import pytest

from isogi_core.kernels.shading.texel_normals import fill_texel_normals
from isogi_core.kernels.transport.transfer import (
    NO_SURFACE,
    TEXEL_PROJECTED,
    TOO_FAR,
    locate_texels,
    project_texels,
)
from tests.kernels.fields import field_of

SPACING = (1.0, 0.7, 1.3)


def bumps(shape=(20, 18, 16)):
    """A smooth field of a few waves."""
    z, y, x = np.mgrid[: shape[0], : shape[1], : shape[2]]
    return (np.sin(0.7 * x + 0.2 * y) + np.cos(0.5 * y - 0.4 * z) + np.sin(0.6 * z)).astype(
        np.float32
    )


def all_texels(shape):
    """Lattice indices (m, 3) of a lattice of this shape."""
    return np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=-1).astype(np.int32)


def facing(field, step, level, projected, texels):
    """`fill_texel_normals`: (m, 3)."""
    normals = np.full((len(texels), 3), np.nan, np.float32)
    fill_texel_normals(field, step, level, projected, texels, normals)
    return normals


@pytest.mark.parametrize("step", [1.0, 0.5])
def test_texels_face_as_their_bake_locates_them(step):
    field = field_of(bumps(), SPACING)
    texels = all_texels((20, 18, 16))
    points = np.empty((3, len(texels)))
    normals = np.empty((3, len(texels)))
    args = field, np.full(3, step), texels
    locate_texels(*args, points, normals, np.empty(len(texels)), np.empty(len(texels), np.bool_))
    stays = (texels[:, ::-1] * step == points.T).all(axis=1)
    stays &= normals.any(axis=0)
    assert stays.mean() > 0.95
    found = facing(field, np.full(3, step), 0.0, False, texels)
    np.testing.assert_allclose(found[stays], normals.T[stays], atol=1e-6)


@pytest.mark.parametrize("step", [1.0, 0.5])
def test_moved_texels_face_as_they_do_where_they_are_moved_to(step):
    field = field_of(bumps(), SPACING)
    texels = all_texels((20, 18, 16))
    points = np.empty((3, len(texels)))
    normals = np.empty((3, len(texels)))
    verdicts = np.empty(len(texels), np.uint8)
    project_texels(field, np.full(3, step), 0.4, texels, points, normals, verdicts)
    found = facing(field, np.full(3, step), 0.4, True, texels)
    there = verdicts == TEXEL_PROJECTED
    assert there.sum() > 500 and (verdicts == TOO_FAR).sum() > 100
    np.testing.assert_allclose(found[there], normals.T[there], atol=1e-3)
    assert not found[verdicts == TOO_FAR].any()


def test_texels_without_a_gradient_face_nowhere():
    voxels = bumps((20, 18, 16))
    voxels[:, :, :8] = 0.25
    field = field_of(voxels)
    texels = all_texels((20, 18, 16))
    flat = texels[:, 2] < 6
    args = np.full(3, 1.0), 0.4
    for projected in (False, True):
        found = facing(field, *args, projected, texels)
        assert not found[flat].any() and np.isfinite(found).all()
    points = np.empty((3, len(texels)))
    normals = np.empty((3, len(texels)))
    verdicts = np.empty(len(texels), np.uint8)
    project_texels(field, *args, texels, points, normals, verdicts)
    assert (verdicts[flat] == NO_SURFACE).all()
