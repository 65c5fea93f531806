"""Readings: how good the light of a view's texels is, and what of it is still wanted."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_reading import Lacking, grade_rows
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    BURIED_ROW,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    UNLIT_ROW,
    VOID_GRADE,
    VOID_ROW,
)
from isogi_core.model.scene_plan import MIN_SAMPLES, most_samples
from isogi_core.model.view import View
from tests.frame.conftest import CONSTANT, SKY, Workbench, reading_of, refine_chunk
from tests.loaded import load_scene

TARGET = 0.02


def test_grades_part_missing_rough_and_good_light() -> None:
    expected = [
        (0, 0.0, 0, PARTIAL_GRADE),
        (5, 0.01, MIN_SAMPLES // 2, CONVERGING),
        (1, 0.04, MIN_SAMPLES, CONVERGING),
        (2, 0.03, MIN_SAMPLES, FINAL),
        (3, 0.04, most_samples(TARGET), FINAL),
        (UNLIT_ROW, 0.0, 0, UNBAKED_GRADE),
        (VOID_ROW, 0.0, 0, VOID_GRADE),
        (BURIED_ROW, 0.0, 0, BURIED_GRADE),
    ]
    rows, error, samples, grades = (np.array(column) for column in zip(*expected, strict=True))
    assert grade_rows(rows.astype(np.int32), error.astype(np.float32), samples, TARGET).tolist() == grades.tolist()


def planes_of(view: View, error: float) -> Framebuffer:
    """A white picture that is not final."""
    pixels = view.width * view.height
    light = np.ones((pixels, 3), np.float32)
    return Framebuffer(light, np.full(pixels, PROVISIONAL, np.uint8), np.full(pixels, error, np.float32))


def test_light_short_of_final_is_demanded_chunk_by_chunk(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.5))
    view = bench.view(size=24)
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    before = reading_of(bench, view, Tiles(1))
    assert before.short.all() and not before.whole and (before.grade == UNBAKED_GRADE).all()
    wanted = Lacking(texels, before, planes_of(view, 1.0)).demands
    assert [demand.effort.unlit for demand in wanted] == np.diff(texels.bounds).tolist()
    assert [demand.index for demand in wanted] == list(texels.chunks)
    bench.bake(view)
    after = reading_of(bench, view, Tiles(1))
    assert not after.short.any() and after.version != before.version
    assert Lacking(texels, after, planes_of(view, 0.0)).demands == ()
    other = replace(view, width=40)
    some = reading_of(bench, other, Tiles(1))
    wider = bench.renderer.texels(other, bench.renderer.gbuffer(other))
    own = [some.grade[a:b] for a, b in zip(wider.bounds[:-1], wider.bounds[1:], strict=True)]
    assert some.short.tolist() == [bool((grade < FINAL).any()) for grade in own]
    assert [demand.index for demand in Lacking(wider, some, planes_of(other, 1.0)).demands] == [
        index for index, short in zip(wider.chunks, some.short, strict=True) if short
    ]


def test_dark_chunks_are_those_that_provisional_pixels_wait_for(workbench: Callable[..., Workbench]) -> None:
    """Where some of these have no light at all, those alone: the others light no pixel soon."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=1e-3))
    view, renderer = bench.view(size=24), Renderer(bench.caches, Tiles(), filters=False)
    frame, loader = renderer.render(view), bench.caches.of(view.shading)
    assert frame.quality.dark == {demand.index for demand in frame.demands}
    begun = {demand.index for demand in frame.demands[::2]}
    for demand in frame.demands[::2]:
        refine_chunk(loader, 16, 1e-3, replace(demand, offsets=demand.offsets[2:]))
    frame = renderer.render(view)
    assert 0.0 < frame.coverage["provisional"] < 1.0
    assert frame.quality.dark and frame.quality.dark.isdisjoint(begun)
    for demand in frame.demands:
        if demand.index not in begun:
            refine_chunk(loader, 16, 1e-3, demand)
    frame = renderer.render(view)
    assert frame.coverage["provisional"] > 0.0
    assert frame.quality.dark and frame.quality.dark <= begun
    bench.bake(view, target=1.0)
    assert renderer.render(view).quality.dark == frozenset()


def test_efforts_of_chunks_in_pieces_are_those_of_their_texels(
    workbench: Callable[..., Workbench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chunk that lies in two pieces, or in more, has the sum of both."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=1e-3))
    view = bench.view(size=24)
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    loader = bench.caches.of(view.shading)
    for demand in bench.renderer.render(view).demands[::2]:
        refine_chunk(loader, 16, bench.scene.target_error, demand)
    whole = reading_of(bench, view, Tiles(1))
    monkeypatch.setattr("isogi_core.frame.texel_reading.TEXELS_A_PIECE", 7)
    pieces = reading_of(bench, view, Tiles(2))
    efforts, same = (
        [d.effort for d in Lacking(texels, each, planes_of(view, 1.0)).demands] for each in (whole, pieces)
    )
    assert efforts == same and len(efforts) == len(texels.chunks)
    unlit = [int((whole.rows[a:b] == UNLIT_ROW).sum()) for a, b in pairwise(texels.bounds.tolist())]
    assert [effort.unlit for effort in efforts] == unlit and 0 < sum(unlit) < len(whole.rows)
    assert all(effort.taken > 0.0 for effort in efforts if not effort.unlit)


def test_threads_change_no_reading(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[CONSTANT], bounces=1, target_error=0.5))
    view = bench.view(size=24)
    bench.bake(view)
    one, other = (reading_of(bench, view, Tiles(threads)) for threads in (1, 3))
    assert one.version == other.version
    assert np.array_equal(one.rows, other.rows) and np.array_equal(one.grade, other.grade)
