"""Readings: how good the light of a view's texels is, what is wanted of it, and what drafts
lend.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame import shading
from isogi_core.frame.demand import first_texels
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shading import carry_texel_light, filter_texel_light, lend_light
from isogi_core.frame.texel_reading import Lacking, grade_rows
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    BURIED_ROW,
    LIGHT_NUMBERS,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    UNLIT_ROW,
    VOID_GRADE,
    VOID_ROW,
)
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.scene_plan import most_samples
from isogi_core.model.view import View
from tests.frame.conftest import (
    CONSTANT,
    SKY,
    Workbench,
    reading_of,
    refine_chunk,
    relative_rmse,
    shading_of,
)
from tests.loaded import load_scene

TARGET = 0.02


def test_grades_part_missing_rough_and_good_light() -> None:
    expected = [
        (0, 0.0, 0, PARTIAL_GRADE),
        (5, 0.01, 32, CONVERGING),
        (1, 0.04, 64, CONVERGING),
        (2, 0.03, 64, FINAL),
        (3, 0.04, most_samples(TARGET), FINAL),
        (UNLIT_ROW, 0.0, 0, UNBAKED_GRADE),
        (VOID_ROW, 0.0, 0, VOID_GRADE),
        (BURIED_ROW, 0.0, 0, BURIED_GRADE),
    ]
    rows, error, samples, grades = (np.array(column) for column in zip(*expected, strict=True))
    assert (
        grade_rows(rows.astype(np.int32), error.astype(np.float32), samples, Goal(TARGET)).tolist()
        == grades.tolist()
    )


def planes_of(view: View, error: float) -> Framebuffer:
    """A white picture that is not final."""
    pixels = view.width * view.height
    light = np.ones((pixels, 3), np.float32)
    return Framebuffer(
        light, np.full(pixels, PROVISIONAL, np.uint8), np.full(pixels, error, np.float32)
    )


def test_light_short_of_final_is_demanded_chunk_by_chunk(
    workbench: Callable[..., Workbench],
) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.5))
    view = bench.view(size=24)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
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
    wider = bench.renderer.surface.texels(other, bench.renderer.gbuffer(other))
    own = [some.grade[a:b] for a, b in zip(wider.bounds[:-1], wider.bounds[1:], strict=True)]
    assert some.short.tolist() == [bool((grade < FINAL).any()) for grade in own]
    assert [demand.index for demand in Lacking(wider, some, planes_of(other, 1.0)).demands] == [
        index for index, short in zip(wider.chunks, some.short, strict=True) if short
    ]


def test_dark_chunks_are_those_that_provisional_pixels_wait_for(
    workbench: Callable[..., Workbench],
) -> None:
    """Where some of these have no light at all, those alone: the others light no pixel soon."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=1e-3))
    view = bench.view(size=24)
    renderer = Renderer(bench.caches, Tiles(), filters=False)
    frame = renderer.render(view)
    loader = bench.caches.of(view.shading)
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
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    loader = bench.caches.of(view.shading)
    for demand in bench.renderer.render(view).demands[::2]:
        refine_chunk(loader, 16, bench.scene.target_error, demand)
    whole = reading_of(bench, view, Tiles(1))
    monkeypatch.setattr("isogi_core.frame.texel_reading.TEXELS_A_PIECE", 7)
    pieces = reading_of(bench, view, Tiles(2))
    efforts, same = (
        [d.effort for d in Lacking(texels, each, planes_of(view, 1.0)).demands]
        for each in (whole, pieces)
    )
    assert efforts == same and len(efforts) == len(texels.chunks)
    unlit = [int((whole.rows[a:b] == UNLIT_ROW).sum()) for a, b in pairwise(texels.bounds.tolist())]
    assert [effort.unlit for effort in efforts] == unlit and 0 < sum(unlit) < len(whole.rows)
    assert all(effort.taken > 0.0 for effort in efforts if not effort.unlit)


# --- drafts
# --------------------------------------------------------------------------------------------------


Make = Callable[..., Workbench]


def orbital(workbench: Make) -> Workbench:
    """The orbital under a sky, with nothing baked."""
    return workbench(load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=1e-3))


def test_unlit_texels_have_the_mean_of_their_cells_others(workbench: Make) -> None:
    """Texels of all grades, beside a loop over cells; void, buried and half-baked ones lend
    nothing.
    """
    bench = orbital(workbench)
    random = np.random.default_rng(5)
    view = bench.view(size=24)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    empty = reading_of(bench, view, Tiles(1))
    chosen = random.choice(
        [UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL, BURIED_GRADE, VOID_GRADE],
        len(texels.places),
    )
    reading = replace(empty, grade=chosen.astype(np.uint8))
    lit = random.random((len(chosen), LIGHT_NUMBERS), np.float32)
    after, lent = lend_light(texels, reading, lit)
    expected: dict[int, list[np.ndarray]] = {}
    for cell in texels.corners.tolist():
        lenders = [t for t in cell if CONVERGING <= chosen[t] <= FINAL]
        for t in cell:
            if chosen[t] == UNBAKED_GRADE and lenders:
                expected.setdefault(t, []).append(lit[lenders].mean(axis=0))
    assert 100 < len(expected) < (chosen == UNBAKED_GRADE).sum()
    for t, means in expected.items():
        assert after.grade[t] == CONVERGING
        assert any(np.allclose(lent[t], mean, rtol=1e-5) for mean in means)
    others = np.setdiff1d(np.arange(len(chosen)), [*expected])
    assert np.array_equal(lent[others], lit[others]) and np.array_equal(
        after.grade[others], chosen[others]
    )
    assert np.array_equal(reading.grade, chosen), "what was read stays as it is"


def test_light_that_is_all_there_is_left_alone(workbench: Make) -> None:
    bench = orbital(workbench)
    view = bench.view(size=24)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    empty = reading_of(bench, view, Tiles(1))
    reading = replace(empty, grade=np.full_like(empty.grade, CONVERGING))
    lit = np.ones((len(empty.grade), LIGHT_NUMBERS))
    assert lend_light(texels, reading, lit) == (reading, lit)


@pytest.mark.slow
@pytest.mark.parametrize("size", [64, 128, 512])
def test_a_draft_is_lit_by_a_quarter_of_its_texels(
    size: int, workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small one reads no others. All are filtered as at rest, and near to that picture."""
    bench = orbital(workbench)
    view = bench.view(size=size)
    for demand in bench.renderer.render(view).demands:
        first = demand.offsets[first_texels(demand.offsets, demand.bits)]
        refine_chunk(bench.caches.of("gi"), 64, 1e-3, replace(demand, offsets=first))
    steps = set[int]()
    filters = shading.filter_texels

    def noted(*given: Any) -> None:
        steps.add(given[4])
        filters(*given)

    monkeypatch.setattr(shading, "filter_texels", noted)
    draft = bench.renderer.render(replace(view, moving=True))
    assert steps == {1, 2} and draft.coverage["provisional"] < 0.02
    unlit = sum(demand.effort.unlit for demand in draft.demands)
    assert unlit == 0 if size < 512 else unlit > 1000
    rest = bench.renderer.render(view)
    assert relative_rmse(draft, rest) < 0.15


def test_what_moves_reads_few_texels_where_pixels_are_large(workbench: Make) -> None:
    """Small views that move read first texels alone; large ones, and all at rest, the eight about
    each point.
    """
    bench = orbital(workbench)
    for size in (32, 64, 128, 512):
        view = bench.view(size=size)
        gbuffer = bench.renderer.gbuffer(view)
        rest, draft = (
            bench.renderer.surface.texels(replace(view, moving=moving), gbuffer)
            for moving in (False, True)
        )
        assert not rest.coarse and draft.coarse == (size < 512)
        assert bench.renderer.surface.texels(view, gbuffer) is rest, "both are kept"
        assert draft.coarse == (len(rest.places) > len(gbuffer.pixels))
        assert len(draft.places) <= 2 * len(gbuffer.pixels)
        assert np.isin(draft.numbers(draft.places), rest.numbers(rest.places)).all(), (
            "of those at rest"
        )


def test_a_coarse_draft_tells_the_noise_of_its_pixels(workbench: Make) -> None:
    """Over many independent lights of its texels, their pixels scatter as much as is told of them
    in the mean.
    """
    bench = orbital(workbench)
    random = np.random.default_rng(3)
    view = replace(bench.view(size=48), moving=True)
    gbuffer = bench.renderer.gbuffer(view)
    light = bench.renderer.surface.shot(view, gbuffer, Goal(1e-3), Tiles(1)).light
    tiles = Tiles(1)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    assert texels.coarse
    reading = replace(
        reading_of(bench, view, tiles), grade=np.full(len(texels.places), CONVERGING, np.uint8)
    )
    seen = []
    told = []
    for _ in range(64):
        lit = np.ones((len(texels.places), LIGHT_NUMBERS), np.float32)
        lit[:, :3] = 1.0 + 0.05 * random.normal(size=(len(lit), 1))
        lit[:, 3] = 0.05
        picture = carry_texel_light(texels, reading, lit, texels.gbuffer.shown(tiles), light, tiles)
        shown = picture.radiance[texels.gbuffer.pixels] @ LUMINANCE_WEIGHTS / light.spec.unit
        seen.append(shown)
        told.append(picture.error[texels.gbuffer.pixels] * shown)
    true = np.sqrt(np.var(seen, axis=0).mean())
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(true, rel=0.1)


def test_lent_light_may_all_be_wrong(workbench: Make) -> None:
    """A texel whose normal is turned round has the light of its cell, and as much error as light;
    none is filtered.
    """
    bench = orbital(workbench)
    view = bench.view(size=24)
    tiles = Tiles(1)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    turned = np.unique(texels.corners[::7, 3])
    normals = np.tile(np.array([[0.0, 0.0, 1.0]], np.float32), (len(texels.places), 1))
    normals[turned] *= -1.0
    grade = np.full(len(normals), CONVERGING, np.uint8)
    grade[turned] = UNBAKED_GRADE
    samples = np.where(grade == UNBAKED_GRADE, 0, 16).astype(np.int32)
    reading = replace(reading_of(bench, view, tiles), grade=grade, samples=samples)
    lit = np.full((len(normals), LIGHT_NUMBERS), 0.5, np.float32)
    lit[:, 3] = 0.01
    lit[turned] = 0.0
    for moving in (False, True):
        now = replace(view, moving=moving)
        light = bench.renderer.surface.shot(now, texels.gbuffer, Goal(1e-3), tiles).light
        found, filtered = filter_texel_light(texels, reading, lit, normals, light, tiles)
        assert (found.grade == CONVERGING).all()
        np.testing.assert_allclose(filtered[turned, :3], 0.5, rtol=1e-3)
        np.testing.assert_allclose(filtered[turned, 3], 0.5, rtol=1e-3)


@pytest.mark.parametrize(
    ("settings", "stays"),
    [
        ({"lights": [SKY]}, False),
        ({"lights": [CONSTANT]}, False),
        ({"room": "cornell"}, True),
        ({"lights": [CONSTANT], "glow": [{"sphere": [47.5] * 4, "radiance": 1.0}]}, True),
    ],
    ids=["sky", "constant", "room", "glow"],
)
def test_noise_of_light_that_stays_is_estimated_roughly(
    settings: dict[str, Any], stays: bool, workbench: Make
) -> None:
    bench = workbench(load_scene("demo:orbital", bounces=1, target_error=1e-3, **settings))
    view = bench.view(size=8)
    assert reading_of(bench, view, Tiles(1)).rough == bench.caches.spec("gi").rough == stays


def test_light_that_stays_is_filtered_if_noise_seems_small(workbench: Make) -> None:
    """Its noise is one difference of halves, which agree by chance at some texels."""
    bench = workbench(load_scene("demo:orbital", bounces=1, target_error=1e-3, room="cornell"))
    view = bench.view(size=24)
    for demand in bench.renderer.render(view).demands:
        refine_chunk(bench.caches.of("gi"), 16, 1e-3, demand)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    shot = bench.renderer.surface.shot(view, texels.gbuffer, Goal(1e-3), Tiles(1))
    reading, smooth = shading_of(bench.caches).lit(texels, shot)
    _, plain = shading_of(bench.caches, filters=False).lit(texels, shot)
    quiet = reading.lit & (reading.error <= 0.01)
    changed = (smooth[quiet] != plain[quiet]).any(axis=1)
    assert quiet.sum() > 20 and changed.mean() > 0.9


@pytest.mark.parametrize("rough", [False, True])
def test_texels_that_seem_quiet_lose_noise_if_it_is_rough(rough: bool, workbench: Make) -> None:
    """Every eighth texel says that it has no noise; all have as much. If noise is well known, they
    keep their light.
    """
    bench = orbital(workbench)
    view = bench.view(size=24)
    tiles = Tiles(1)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    count = len(texels.places)
    quiet = np.arange(count) % 8 == 0
    error = np.where(quiet, 0.0, 0.2).astype(np.float32)
    reading = replace(
        reading_of(bench, view, tiles),
        grade=np.full(count, CONVERGING, np.uint8),
        samples=np.full(count, 16, np.int32),
        error=error,
        rough=rough,
    )
    noise = 0.1 * np.random.default_rng(7).normal(size=count)
    lit = np.zeros((count, LIGHT_NUMBERS), np.float32)
    lit[:, :3] = 0.5 + noise[:, None]
    lit[:, 3] = 0.5 * error
    normals = np.tile(np.array([[0.0, 0.0, 1.0]], np.float32), (count, 1))
    gbuffer = bench.renderer.gbuffer(view)
    light = bench.renderer.surface.shot(view, gbuffer, Goal(1e-3), Tiles(1)).light
    _, filtered = filter_texel_light(texels, reading, lit, normals, light, tiles)
    left = [np.sqrt(((filtered[some, 1] - 0.5) ** 2).mean()) for some in (quiet, ~quiet)]
    assert left[1] < 0.5 * 0.1
    if rough:
        assert left[0] == pytest.approx(left[1], rel=0.25)
    else:
        assert np.array_equal(filtered[quiet], lit[quiet])
