"""Stiffness of fields whose stiffness is known."""

import numpy as np
import pytest

from isogi_core.frame.tiles import Tiles
from isogi_core.plan.projection import Stiffness, measure_stiffness
from isogi_core.runs import serially
from tests.kernels.fields import field_of

SIDE = 40


def ball(width: float) -> np.ndarray:
    """A ball of radius 13 whose skin is a ramp of ``width`` voxels; a mask where that is 0."""
    z, y, x = np.indices((SIDE,) * 3) - (SIDE - 1) / 2
    distance = np.sqrt(x * x + y * y + z * z) - 13.1
    return np.clip(0.5 - distance / width, 0.0, 1.0) if width else (distance < 0.0).astype(float)


def stiffness(voxels: np.ndarray, *levels: float) -> Stiffness:
    return measure_stiffness(field_of(voxels), levels or (0.5,), serially)


def shares(found: Stiffness) -> tuple[float, float, float]:
    """Steep, plateau, noisy at the first isovalue."""
    steep, plateau, noisy = (float(found.share(each)[0]) for each in (found.steep, found.plateau, found.noisy))
    return steep, plateau, noisy


@pytest.mark.parametrize("width", [8.0, 4.0, 3.0])
def test_a_ball_with_a_soft_skin_is_not_stiff(width: float) -> None:
    assert shares(stiffness(ball(width))) == (0.0, 0.0, 0.0)


def test_the_thinner_a_ramp_the_more_of_it_is_steep() -> None:
    steep = [shares(stiffness(ball(width)))[0] for width in (3.0, 2.0, 1.5, 1.0, 0.0)]
    assert steep == sorted(steep) and steep[1] < 0.2 and steep[3] > 0.9


def test_a_mask_is_steep_everywhere_and_no_more_than_steep() -> None:
    assert shares(stiffness(ball(0.0))) == (1.0, 0.0, 0.0)


def test_a_mask_seen_at_the_value_of_its_outside_is_on_a_plateau() -> None:
    steep, plateau, _ = shares(stiffness(ball(0.0), 0.0))
    assert steep == 1.0 and plateau > 0.5


def test_noise_is_noisy_and_a_little_noise_is_not() -> None:
    noise = np.random.default_rng(2).normal(size=(SIDE,) * 3)
    assert shares(stiffness(noise, 0.0))[2] > 0.9
    assert shares(stiffness(ball(8.0) + 0.01 * noise))[2] == 0.0


def test_terraces_are_plateaus_at_their_treads_values_alone() -> None:
    treads = np.floor(np.indices((30, 30, 30))[0] / 6.0)
    found = stiffness(treads, 1.0, 1.5)
    assert found.share(found.plateau).tolist() == [1.0, 0.0]
    assert found.share(found.steep).tolist() == [1.0, 1.0]


def test_a_surface_meets_the_faces_that_it_leads_to() -> None:
    """A rod along x through the box, cut off at y = 0 too."""
    rod = np.full((20, 20, 20), 0.0)
    rod[8:12, :12, :] = 1.0
    found = stiffness(rod)
    assert found.faces[:, 0].tolist() == [27, 27, 38, 0, 0, 0]


def test_cells_beside_a_hole_are_counted() -> None:
    voxels = ball(8.0)
    voxels[SIDE // 2, SIDE // 2, SIDE // 2 + 13] = np.nan
    found, whole = stiffness(voxels), stiffness(ball(8.0))
    assert whole.holed[0] == 0 and 0 < found.holed[0] < 50
    assert 0 < whole.cells[0] - found.cells[0] <= 8


def test_a_constant_volume_has_no_surface() -> None:
    found = stiffness(np.ones((5, 5, 5)), 0.5, 1.0)
    assert not found.cells.any() and shares(found) == (0.0, 0.0, 0.0)


def test_levels_ascend_and_threads_do_not_change_counts() -> None:
    voxels = np.random.default_rng(4).random((33, 12, 13))
    tiles = Tiles(3)
    one, many = (measure_stiffness(field_of(voxels), (0.7, 0.2, 0.7), run) for run in (serially, tiles.run))
    tiles.close()
    assert one.levels.tolist() == np.float32([0.2, 0.7]).tolist()
    for name in ("cells", "steep", "plateau", "noisy", "holed", "faces"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))


def test_a_stiffer_surface_is_expected_to_err_more() -> None:
    soft, steep = (stiffness(each).expectation(0) for each in (ball(8.0), ball(0.0)))
    noise = stiffness(np.random.default_rng(2).normal(size=(SIDE,) * 3), 0.0).expectation(0)
    assert soft.low < soft.likely < soft.high
    assert soft.likely < steep.likely < noise.likely
