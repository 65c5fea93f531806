"""Light that is lent in small drafts: what has none yet is lit by the rest of its cell, and nothing is filtered."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame import shading
from isogi_core.frame.shading import lend_light
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import first_texels
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.lattice import BURIED, LIT, PARTIAL, UNBAKED, VOID
from tests.frame.conftest import SKY, Workbench, reading_of, refine_chunk, relative_rmse
from tests.loaded import load_scene

Make = Callable[..., Workbench]


def orbital(workbench: Make) -> Workbench:
    """The orbital under a sky, with nothing baked."""
    return workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=1e-3))


def test_unlit_texels_have_the_mean_of_their_cells_others(workbench: Make) -> None:
    """Texels of all grades, beside a loop over cells; void, buried and half-baked ones lend nothing."""
    bench, random = orbital(workbench), np.random.default_rng(5)
    view = bench.view(size=24)
    texels, empty = bench.renderer.texels(view, bench.renderer.gbuffer(view)), reading_of(bench, view, Tiles(1))
    chosen = random.choice([UNBAKED, PARTIAL, CONVERGING, FINAL, BURIED, VOID], len(texels.places))
    reading, lit = replace(empty, grade=chosen.astype(np.uint8)), random.random((len(chosen), LIT), np.float32)
    after, lent = lend_light(texels, reading, lit)
    expected: dict[int, list[np.ndarray]] = {}
    for cell in texels.corners.tolist():
        lenders = [t for t in cell if CONVERGING <= chosen[t] <= FINAL]
        for t in cell:
            if chosen[t] == UNBAKED and lenders:
                expected.setdefault(t, []).append(lit[lenders].mean(axis=0))
    assert 100 < len(expected) < (chosen == UNBAKED).sum()
    for t, means in expected.items():
        assert after.grade[t] == CONVERGING
        assert any(np.allclose(lent[t], mean, rtol=1e-5) for mean in means)
    others = np.setdiff1d(np.arange(len(chosen)), [*expected])
    assert np.array_equal(lent[others], lit[others]) and np.array_equal(after.grade[others], chosen[others])
    assert np.array_equal(reading.grade, chosen), "what was read stays as it is"


def test_light_that_is_all_there_is_left_alone(workbench: Make) -> None:
    bench = orbital(workbench)
    view = bench.view(size=24)
    texels, empty = bench.renderer.texels(view, bench.renderer.gbuffer(view)), reading_of(bench, view, Tiles(1))
    reading, lit = replace(empty, grade=np.full_like(empty.grade, CONVERGING)), np.ones((len(empty.grade), LIT))
    assert lend_light(texels, reading, lit) == (reading, lit)


@pytest.mark.parametrize("size", [64, 128])
def test_a_draft_is_lit_by_a_quarter_of_its_texels(size: int, workbench: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small one unfiltered. Either is near to the picture at rest, which is filtered."""
    bench = orbital(workbench)
    view = bench.view(size=size)
    for demand in bench.renderer.render(view).demands:
        first = demand.offsets[first_texels(demand.offsets, demand.bits)]
        refine_chunk(bench.caches.of("gi"), 64, 1e-3, replace(demand, offsets=first))
    steps, filters = set[int](), shading.filter_texels

    def noted(*given: Any) -> None:
        steps.add(given[4])
        filters(*given)

    monkeypatch.setattr(shading, "filter_texels", noted)
    draft = bench.renderer.render(replace(view, moving=True))
    assert steps == (set() if size == 64 else {1}) and draft.coverage["provisional"] < 0.02
    rest = bench.renderer.render(view)
    assert steps == {1, 2} and relative_rmse(draft, rest) < 0.15
