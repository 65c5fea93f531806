"""Volumes smoothed by a Gaussian, against closed forms and sums over all voxels."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.files.grid import Grid
from isogi_core.plan.variants import smoothed_by
from isogi_core.plan.volumes.smoothing import smoothed
from tests.loaded import load_scene


def blob(width: float, shape: tuple[int, int, int] = (40, 44, 48)) -> np.ndarray:
    """A Gaussian of standard deviation ``width`` about the middle, float64."""
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    square = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2
    return np.asarray(np.exp(-square / (2.0 * width**2)))


def in_slabs(array: np.ndarray, layers: int) -> Grid:
    """The grid of an array that comes a few layers at a time."""

    def slabs() -> Iterator[np.ndarray]:
        return (array[z : z + layers] for z in range(0, len(array), layers))

    return replace(Grid.of(array), slabs=slabs)


@pytest.mark.parametrize("sigma", [0.8, 1.0, 2.5])
def test_a_gaussian_of_a_gaussian_is_a_wider_one(sigma: float) -> None:
    """Variances add: exp(-r²/2w²) becomes (w/v)³ exp(-r²/2v²) with v² = w² + σ²."""
    width = 3.0
    wider = np.hypot(width, sigma)
    expected = (width / wider) ** 3 * blob(wider)
    found = smoothed(Grid.of(blob(width)), sigma).whole()
    assert found.dtype == np.float64
    assert np.abs(found - expected).max() < 2e-4
    single = smoothed(Grid.of(blob(width).astype(np.float32)), sigma).whole()
    assert single.dtype == np.float32 and np.abs(single - expected).max() < 2e-4


@pytest.mark.parametrize("layers", [1, 3, 100])
@pytest.mark.parametrize("shape", [(2, 3, 2), (9, 7, 8)])
def test_holes_stay_and_their_neighbours_are_means(
    shape: tuple[int, int, int], layers: int
) -> None:
    """Each voxel against the weighted sum over all others, in whatever slabs they come."""
    rng = np.random.default_rng(7)
    values = rng.integers(0, 200, shape).astype(np.uint8)
    values[rng.random(shape) < 0.2] = 255
    sigma = 0.9
    found = smoothed(in_slabs(values, layers), sigma, missing=(255,)).whole()
    reach = int(np.ceil(4.0 * sigma))
    wide = np.pad(values, reach, "edge")
    steps = np.arange(-reach, reach + 1)
    falls = np.exp(-0.5 * (steps / sigma) ** 2)
    weights = falls[:, None, None] * falls[:, None] * falls
    for place in np.ndindex(shape):
        part = wide[tuple(slice(n, n + 2 * reach + 1) for n in place)].astype(np.float64)
        there = weights * (part != 255)
        if values[place] == 255:
            assert np.isnan(found[place])
        else:
            assert found[place] == pytest.approx((there * part).sum() / there.sum(), rel=1e-5)


def test_bytes_are_not_rounded_again(tmp_path: Path) -> None:
    """A ramp of 8 bits, rounded to whole numbers, is a ramp again but for what rounding took."""
    x = np.arange(64)
    ramp = np.rint(np.broadcast_to(100.0 + 0.3 * x, (12, 12, 64))).astype(np.uint8)
    np.save(tmp_path / "ramp.npy", ramp)
    volume = load_scene(tmp_path / "ramp.npy", smooth=2, isovalue=110).volume
    values = volume.offset + volume.scale * volume.voxels.astype(np.float64)
    inner = values[6, 6, 10:-10]
    assert np.abs(inner - (100.0 + 0.3 * x[10:-10])).max() < 0.12
    assert np.diff(inner) == pytest.approx(0.3, abs=0.06)
    assert any("Smoothed" in note for note in volume.orientation.notes)


def test_a_target_says_how_far_it_is_smoothed(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", blob(4.0, (12, 13, 14)).astype(np.float32))
    plain, one, same = (
        load_scene(f"{tmp_path}/v.npy{rest}", isovalue=0.3, **settings)
        for rest, settings in (("", {}), ("#smooth=1", {}), ("", {"smooth": 1.0}))
    )
    assert one.volume.digest == same.volume.digest != plain.volume.digest
    assert one.bake_digest == same.bake_digest != plain.bake_digest
    assert one.volume.value_range[1] < plain.volume.value_range[1]
    for wrong in ("much", "9", "-1"):
        with pytest.raises(SceneError, match="smooth"):
            load_scene(f"{tmp_path}/v.npy#smooth={wrong}")


def test_the_demo_is_smoothed_and_labels_are_not(tmp_path: Path) -> None:
    plain = load_scene("demo:orbital")
    smooth = load_scene("demo:orbital", smooth=1.5)
    assert smooth.volume.digest != plain.volume.digest
    np.save(tmp_path / "labels.npy", np.pad(np.ones((4, 4, 4), np.uint8), 2))
    with pytest.raises(SceneError, match="leave smooth out"):
        load_scene(f"{tmp_path}/labels.npy", labels="all", smooth=1)


def test_a_variant_is_the_scene_that_says_so(tmp_path: Path) -> None:
    """Smoothed by a view, it has the light of a scene that is smoothed by itself, and its range of
    isovalues stays.
    """
    np.save(tmp_path / "v.npy", blob(4.0, (12, 13, 14)).astype(np.float32))
    plain = load_scene(tmp_path / "v.npy", isovalue=0.3)
    one = load_scene(tmp_path / "v.npy", isovalue=0.3, smooth=1)
    made = smoothed_by(plain, 1.0, "v@*1.0")
    assert made.volume.digest == one.volume.digest and made.id == "v@*1.0"
    assert made.bake_digest == one.bake_digest
    assert (made.isovalue, made.isovalues) == (plain.isovalue, plain.isovalues)
    again = smoothed_by(made, 0.0, "v")
    assert again.volume.digest == plain.volume.digest
