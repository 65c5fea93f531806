"""The built-in volumes: closed, varied, the same every time."""

import itertools

import numpy as np
import pytest
from scipy import ndimage

from isogi_core.errors import VolumeError
from isogi_core.model.demo import DEMOS, demo_volume
from isogi_core.model.volume import Volume

LEVELS = {"casting": (1.0, 60.0, 127.5, 200.0), "orbital": (0.005, 0.03, 0.2)}


@pytest.fixture(scope="module", params=sorted(DEMOS))
def demo(request: pytest.FixtureRequest) -> Volume:
    return demo_volume(request.param)


def solid(volume: Volume, isovalue: float) -> np.ndarray:
    """Mask (z, y, x) of the voxels inside."""
    return volume.voxels > volume.normalise_isovalue(isovalue)


def faces(mask: np.ndarray) -> bool:
    """Whether any voxel on the box is set."""
    return any(mask.take(end, axis).any() for axis in range(3) for end in (0, -1))


def test_surfaces_do_not_touch_the_box(demo: Volume) -> None:
    for level in LEVELS[demo.name]:
        inside = solid(demo, level)
        assert inside.any() and not faces(inside)


def test_default_isovalue_is_well_inside_the_range(demo: Volume) -> None:
    low, high = demo.value_range
    isovalue = DEMOS[demo.name].isovalue
    assert low + 0.01 * (high - low) < isovalue < high - 0.1 * (high - low)
    assert 0.005 < solid(demo, isovalue).mean() < 0.5


def test_demos_are_the_same_every_time(demo: Volume) -> None:
    assert demo.digest == demo_volume(demo.name).digest
    assert demo.holes == 0 and demo.solid == "above" and demo.spacing == (1.0, 1.0, 1.0)


def test_isovalues_of_the_casting_are_nested_offsets_of_its_skin() -> None:
    volume = demo_volume("casting")
    masks = [solid(volume, level) for level in (10.0, 60.0, 127.5, 200.0)]
    for outer, inner in itertools.pairwise(masks):
        assert not (inner & ~outer).any()
        assert 0.4 < inner.sum() / outer.sum() < 0.95


def test_casting_is_one_piece_with_openings_right_through() -> None:
    """No loose metal, no sealed cavity, and many handles: 1 - genus is well below zero."""
    inside = solid(demo_volume("casting"), DEMOS["casting"].isovalue)
    assert ndimage.label(inside)[1] == 1
    assert ndimage.label(~inside, np.ones((3, 3, 3)))[1] == 1
    assert euler_characteristic(inside) < -10


def euler_characteristic(mask: np.ndarray) -> int:
    """Vertices - edges + faces - cells of the voxels as closed cubes: 1 - genus for one piece."""
    padded = np.pad(mask, 1)
    total = 0
    for axes in range(8):
        cells = padded
        for axis in range(3):
            if axes >> axis & 1:
                cells = cells.take(range(1, cells.shape[axis]), axis) | cells.take(
                    range(cells.shape[axis] - 1), axis
                )
        total += (-1) ** (3 - axes.bit_count()) * int(cells.sum())
    return total


def test_euler_characteristic_of_a_ring_and_a_block() -> None:
    block = np.zeros((5, 5, 5), bool)
    block[1:4, 1:4, 1:4] = True
    ring = block.copy()
    ring[1:4, 2, 2] = False
    assert (euler_characteristic(block), euler_characteristic(ring)) == (1, 0)


def test_bores_of_the_casting_are_deep_and_narrow() -> None:
    """Down the axis of a bore there is no metal for 60 voxels, and all round it there is."""
    inside = solid(demo_volume("casting"), 127.5)
    assert not inside[27:96, 64, 43].any()
    assert (
        inside[50:80, 64, 27].any() and inside[50:80, 64, 60].any() and inside[50:80, 80, 43].any()
    )


def test_fins_are_thin_plates_with_gaps() -> None:
    """A line up through the fins' edge crosses metal and air in turn."""
    column = solid(demo_volume("casting"), 127.5)[40:78, 36, 64]
    assert np.count_nonzero(np.diff(column.astype(int)) == 1) >= 5


def test_orbital_density_against_its_formula() -> None:
    """Two lobes on the axis hold the maximum; the nodes 5z² = 3r² and z = 0 are empty."""
    volume = demo_volume("orbital")
    peak = np.unravel_index(volume.voxels.argmax(), volume.shape)
    assert abs(peak[1] - 47.5) < 1 and abs(peak[2] - 47.5) < 1
    assert abs(abs(peak[0] - 47.5) * 72 / 95 - 12.0) < 0.5
    assert volume.voxels[47:49].max() < 0.02
    np.testing.assert_allclose(volume.voxels, volume.voxels[::-1], atol=1e-6)
    np.testing.assert_allclose(volume.voxels, volume.voxels.transpose(0, 2, 1), atol=1e-6)
    assert ndimage.label(solid(volume, 0.03))[1] == 4


def test_unknown_demo_names_the_known_ones() -> None:
    with pytest.raises(VolumeError, match="casting, orbital"):
        demo_volume("teapot")
