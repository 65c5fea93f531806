"""Boundaries between materials: found where the materials of a made volume say, and nowhere else."""

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.plan.isovalue_presets import TRIED_ISOVALUES, find_boundaries, peaks, prominence, surface_integrals
from tests.loaded import load_scene

Z, Y, X = np.mgrid[:32, :36, :40].astype(np.float64)


def ball(radius: float, softness: float) -> np.ndarray:
    """1 within a ball, 0 outside, and half-way at its radius."""
    distance = np.sqrt((X - 19.5) ** 2 + (Y - 17.5) ** 2 + (Z - 15.5) ** 2)
    return np.asarray(1.0 / (1.0 + np.exp((distance - radius) / softness)))


def materials(*values: float, softness: float = 0.5) -> np.ndarray:
    """Balls within each other, the outermost first, in a surrounding of 0."""
    steps = np.diff([0.0, *values])
    return np.asarray(sum(step * ball(14.0 - 4.0 * i, softness) for i, step in enumerate(steps)))


def found(array: np.ndarray, **more: str) -> tuple[float, ...]:
    volume = make_volume(array, **more)  # type: ignore[arg-type]
    return find_boundaries(volume, volume.value_range)


@pytest.mark.parametrize(
    ("values", "between"), [((100.0,), (50,)), ((100.0, 240.0), (50, 170)), ((60.0, 90.0), (30, 75))]
)
def test_a_boundary_is_half_way_between_two_materials(values: tuple[float, ...], between: tuple[float, ...]) -> None:
    assert found(materials(*values)) == pytest.approx(between, abs=0.06 * max(values))


def test_which_side_is_solid_does_not_matter() -> None:
    array = materials(100.0, 240.0)
    assert found(array, solid="below") == found(array)


def test_a_mask_has_its_boundary_in_the_middle() -> None:
    assert found((materials(1.0) > 0.5).astype(np.uint8)) == pytest.approx((0.5,), abs=0.02)


def test_noise_in_a_material_is_no_boundary() -> None:
    noise = np.random.default_rng(3).normal(0.0, 3.0, X.shape)
    assert found(materials(100.0, 240.0) + noise) == pytest.approx((50, 170), abs=15)


@pytest.mark.parametrize("unit", [1e-300, 1e-3, 1e30, 1e305])
def test_units_do_not_matter(unit: float) -> None:
    assert np.divide(found(materials(100.0, 240.0) * unit), unit) == pytest.approx((50, 170), abs=14)


def test_values_that_are_missing_or_far_off_are_not_looked_at() -> None:
    array = materials(100.0, 240.0)
    before = found(array)
    array[0, 0, :3] = np.nan, np.inf, 1e30
    volume = make_volume(array)
    assert find_boundaries(volume, volume.core) == before


def test_a_boundary_outside_the_range_is_not_suggested() -> None:
    volume = make_volume(materials(100.0, 240.0))
    assert find_boundaries(volume, (100.0, 240.0)) == pytest.approx((170,), abs=14)


@pytest.mark.parametrize("array", [np.zeros((4, 4, 4)), np.full((2, 2, 2), 7, np.uint8)])
def test_one_material_has_none(array: np.ndarray) -> None:
    assert found(array) == ()


def test_the_integrals_are_those_of_a_plane() -> None:
    """A ramp of slope 3 along y: each isosurface has the box's face for area, and 3 for gradient."""
    volume = make_volume(np.broadcast_to(6.0 * np.arange(9.0)[:, None], (5, 9, 7)).copy(), (4.0, 2.0, 3.0))
    total, area = surface_integrals(volume)
    inner = slice(1, TRIED_ISOVALUES - 1)
    assert (total[inner] / area[inner]).tolist() == pytest.approx([3.0 / volume.scale] * (TRIED_ISOVALUES - 2))
    assert np.ptp(area[inner]) == pytest.approx(0.0, abs=1e-9)


def test_prominence_is_the_fall_to_the_higher_saddle() -> None:
    curve = np.array([2.0, 5.0, 3.0, 4.0, 1.0, 9.0, 0.0])
    assert [prominence(curve, at) for at in (1, 2, 3, 5)] == [4.0, 0.0, 1.0, 9.0]


def test_a_plateau_is_one_peak() -> None:
    curve = np.zeros(100)
    curve[30:41], curve[70] = 2.0, 1.0
    assert peaks(curve) == [35.0, 70.0]


def test_the_engine_has_its_two_metals(shared_data: object) -> None:
    scene = load_scene(f"{shared_data}/engine_256x256x128_uint8.nhdr")
    assert [preset.isovalue for preset in scene.presets] == pytest.approx([75, 180], abs=12)
    assert [preset.name for preset in scene.presets] == [f"{preset.isovalue:g}" for preset in scene.presets]
