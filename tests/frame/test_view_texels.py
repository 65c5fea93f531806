"""Texels of a view: their normals, kept for other views, and what their noise counts in its
picture.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from isogi_core.frame import texel_normals
from isogi_core.frame.demand import most_seen
from isogi_core.frame.texel_normals import LatticeNormals, find_texel_normals
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.chunks import add_footprints
from isogi_core.kernels.shading.lattice import Lattice
from isogi_report.speed import make_renderer, view_of
from tests.frame.conftest import Workbench
from tests.loaded import load_scene

RNG = np.random.default_rng(4)


def test_numbers_name_texels_of_the_whole_lattice(orbital: Workbench) -> None:
    lattice = orbital.prepared.lattice
    views = [orbital.view(size=16, isovalue=isovalue) for isovalue in (0.02, 0.05)]
    found = [
        orbital.renderer.surface.texels(view, orbital.renderer.gbuffer(view)) for view in views
    ]
    places: dict[int, tuple[int, ...]] = {}
    for texels in found:
        numbers = texels.numbers(texels.places)
        assert len(np.unique(numbers)) == len(texels.positions)
        for number, place in zip(numbers.tolist(), texels.positions.tolist(), strict=True):
            assert places.setdefault(number, tuple(place)) == tuple(place)
    assert (
        len(set(places.values())) == len(places)
        and max(places) < np.prod(lattice.chunks) * lattice.texels
    )


def test_normals_of_other_views_are_not_found_again(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = orbital.view(size=24)
    tiles = Tiles(2)
    asked = []
    fill = texel_normals.fill_texel_normals
    monkeypatch.setattr(
        texel_normals, "fill_texel_normals", lambda *each: (asked.append(len(each[4])), fill(*each))
    )
    texels = orbital.renderer.surface.texels(view, orbital.renderer.gbuffer(view))
    known = LatticeNormals(1 << 20)
    first, again = (
        find_texel_normals(texels, known, orbital.prepared, tiles).at_positions for _ in range(2)
    )
    assert sum(asked) == len(first) > 100
    assert first.tobytes() == again.tobytes()
    assert (
        find_texel_normals(
            texels, LatticeNormals(1 << 20), orbital.prepared, tiles
        ).at_positions.tobytes()
        == first.tobytes()
    )


def test_a_full_table_begins_anew() -> None:
    known = LatticeNormals(6000)
    asked = list[int]()
    assert known.nbytes == 0, "nothing is taken before it is needed"

    def find(numbers: np.ndarray, rows: np.ndarray) -> np.ndarray:
        asked.append(len(rows))
        return np.stack([numbers[rows], 2 * numbers[rows], 3 * numbers[rows]], axis=1).astype(
            np.float32
        )

    for count in (60, 60, 100, 300, 10):
        numbers = RNG.choice(1 << 40, count, replace=False).astype(np.uint64)
        for _ in range(2):
            got = known.of(numbers, lambda rows, numbers=numbers: find(numbers, rows), Tiles(1))
            assert np.array_equal(got[:, 0], numbers.astype(np.float32))
            assert np.array_equal(got[:, 2], (3 * numbers).astype(np.float32))
    assert known.nbytes == 5120, "256 texels, of 20 bytes each"
    assert asked == [60, 60, 100, 300, 172, 10], "more than it holds are found again in part"


# --- footprints
# --------------------------------------------------------------------------------------------------


RANDOM = np.random.default_rng(3)


def shares(points: np.ndarray, lattice: Lattice) -> Iterator[np.ndarray]:
    """The shares of the eight texels around each of the ``points`` (n, 3) in its light, x fastest;
    (n,) each.
    """
    last = np.array(lattice.shape[::-1]) - 1
    place = np.clip(points * np.array(lattice.density), 0.0, last)
    inside = place - np.minimum(np.floor(place), last - 1)
    for corner in range(8):
        upper = (corner >> np.arange(3)) & 1 == 1
        yield np.where(upper, inside, 1.0 - inside).prod(axis=1)


def test_footprints_predict_the_noise_of_pixels(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", lattice=0.4)
    renderer = make_renderer(scene, str(tmp_path))
    view = view_of(scene, 24)
    texels = renderer.surface.texels(view, renderer.gbuffer(view))
    seen = np.concatenate(texels.footprints)
    noise = RANDOM.normal(size=(len(seen), 2000))
    each = zip(texels.corners.T, shares(texels.gbuffer.points, texels.lattice), strict=True)
    pixels = sum(share[:, None] * noise[corner] for corner, share in each)
    variance = float((np.asarray(pixels) ** 2).sum(axis=0).mean())
    assert variance <= 1.02 * seen.sum()
    assert variance >= 0.9 * seen.sum()
    assert 0.02 < seen.min() / seen.mean() < 0.2, "texels that are hardly seen become final, too"


def test_footprints_are_the_squares_of_the_weights() -> None:
    lattice = Lattice.of((9, 7, 5), (0.5, 1.0, 2.0))
    points = RANDOM.uniform(0.0, 1.0, (200, 3)) * (8.0, 6.0, 4.0)
    points = points.astype(np.float32)
    corners = RANDOM.integers(0, 30, (200, 8)).astype(np.uint32)
    seen = np.zeros(30)
    twin = np.zeros(30)
    add_footprints(lattice, points, corners, seen)
    for corner, share in enumerate(shares(points.astype(np.float64), lattice)):
        twin += np.bincount(corners[:, corner], share**2, len(twin))
    np.testing.assert_allclose(seen, twin, rtol=1e-6)


def test_the_view_that_sees_a_texel_most_counts() -> None:
    views = (np.array([1, 4]), np.array([2.0, 0.5])), (np.array([4, 6]), np.array([1.0, 3.0]))
    assert most_seen(np.array([1, 4, 6]), *views).tolist() == [2.0, 1.0, 3.0]
