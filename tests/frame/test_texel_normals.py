"""Normals that are kept for other views: each is found once, and is the same."""

import numpy as np
import pytest

from isogi_core.frame import view_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ENTRY, OwnNormals, find_texel_normals
from tests.frame.conftest import Workbench

RNG = np.random.default_rng(4)


def test_numbers_name_texels_of_the_whole_lattice(orbital: Workbench) -> None:
    lattice = orbital.prepared.lattice
    views = [orbital.view(size=16, isovalue=isovalue) for isovalue in (0.02, 0.05)]
    found = [orbital.renderer.texels(view, orbital.renderer.gbuffer(view)) for view in views]
    places: dict[int, tuple[int, ...]] = {}
    for texels in found:
        numbers = texels.numbers(texels.places)
        assert len(np.unique(numbers)) == len(texels.positions)
        for number, place in zip(numbers.tolist(), texels.positions.tolist(), strict=True):
            assert places.setdefault(number, tuple(place)) == tuple(place)
    assert len(set(places.values())) == len(places) and max(places) < np.prod(lattice.chunks) * lattice.texels


def test_normals_of_other_views_are_not_found_again(orbital: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    view, tiles, asked = orbital.view(size=24), Tiles(2), []
    fill = view_texels.fill_texel_normals
    monkeypatch.setattr(view_texels, "fill_texel_normals", lambda *each: (asked.append(len(each[4])), fill(*each)))
    texels = orbital.renderer.texels(view, orbital.renderer.gbuffer(view))
    known = OwnNormals(1 << 20)
    first, again = (find_texel_normals(texels, known, orbital.prepared, tiles).own for _ in range(2))
    assert sum(asked) == len(first) > 100
    assert first.tobytes() == again.tobytes()
    assert find_texel_normals(texels, OwnNormals(1 << 20), orbital.prepared, tiles).own.tobytes() == first.tobytes()


def test_a_full_table_begins_anew() -> None:
    known, asked = OwnNormals(300 * ENTRY), list[int]()
    assert known.nbytes == 0, "nothing is taken before it is needed"

    def find(numbers: np.ndarray, rows: np.ndarray) -> np.ndarray:
        asked.append(len(rows))
        return np.stack([numbers[rows], 2 * numbers[rows], 3 * numbers[rows]], axis=1).astype(np.float32)

    for count in (60, 60, 100, 300, 10):
        numbers = RNG.choice(1 << 40, count, replace=False).astype(np.uint64)
        for _ in range(2):
            got = known.of(numbers, lambda rows, numbers=numbers: find(numbers, rows), Tiles(1))
            assert np.array_equal(got[:, 0], numbers.astype(np.float32))
            assert np.array_equal(got[:, 2], (3 * numbers).astype(np.float32))
    assert known.nbytes == 256 * ENTRY
    assert asked == [60, 60, 100, 300, 172, 10], "more than it holds are found again in part"
