"""Parts of several surfaces' frames: depth peels against crossings with spheres, and light mixed of
two levels.
"""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.several.composed_frame import ComposedFrame, Part, step_key, to_refine
from isogi_core.frame.several.mixed_reading import Level, MixedReading, mixed
from isogi_core.frame.several.peels import Hits, Peeler, SideLayers, first_of, side_layers
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    LIGHT_NUMBERS,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    VOID_GRADE,
)
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume
from isogi_core.plan.variants import Side
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import ball, scene_of

SIZE = 24
EYE = np.array([20.0, -80.0, 20.0])
MIDDLE = 20.0
LEVELS = (4.0, 0.0, 8.0)
"""Isovalues of balls of radius 8, 12 and 4."""


@pytest.fixture(scope="module")
def prepared() -> PreparedScene:
    return PreparedScene(scene_of(ball(), 4.0))


def peeled(
    prepared: PreparedScene, levels: tuple[float, ...], clears: list[float]
) -> tuple[View, Hits, np.ndarray]:
    """What a view along y shows."""
    camera = Camera(tuple(EYE.tolist()), (MIDDLE, MIDDLE, MIDDLE), (0.0, 0.0, 1.0), 20.0)  # type: ignore[arg-type]
    view = View(levels[0], camera, width=SIZE, height=SIZE)
    peeler = Peeler.of(view, [prepared.surface(each) for each in levels], np.array(clears), Tiles())
    return view, *peeler.whole(view, Tiles())


def test_weights_and_what_is_left_make_a_whole(prepared: PreparedScene) -> None:
    _, hits, left = peeled(prepared, LEVELS, [0.3, 0.6, 0.5])
    total = np.bincount(hits.pixels, hits.weights, SIZE * SIZE) + left.ravel()
    np.testing.assert_allclose(total, 1.0, atol=1.0 / 512.0)


def through_sheets(clear: float) -> tuple[Hits, float]:
    """What a ray shows that meets seventy clear sheets before an opaque block, and what is left of
    it.
    """
    values = np.where(np.arange(80) < 71, np.arange(80) % 2 - 0.5, 4.0)
    sheets = make_volume(
        np.ones((9, 80, 9), np.float32) * values[:, None].astype(np.float32), (1.0, 1.0, 1.0)
    )
    prepared = PreparedScene(scene_of(sheets, 1.5))
    view = View(
        1.5, Camera((4.0, -80.0, 4.0), (4.0, 40.0, 4.0), (0.0, 0.0, 1.0), 1.0), width=1, height=1
    )
    surfaces = [prepared.surface(each) for each in (view.isovalue, 0.0)]
    hits, left = Peeler.of(view, surfaces, np.array([0.0, clear]), Tiles()).whole(view, Tiles())
    return hits, left.item()


def test_a_ray_shows_all_layers_that_count() -> None:
    hits, left = through_sheets(0.5)
    assert (hits.sides // 2).tolist() == [1] * 10 and left == 0.0
    np.testing.assert_allclose(hits.weights, 0.5 ** np.arange(1, 11))


def test_the_last_layer_is_the_opaque_one_that_is_left() -> None:
    hits, left = through_sheets(0.99)
    sheets = len(hits.sides) - 1
    assert 32 <= sheets < 70, "it shows most of them, and no ray takes for ever"
    assert (hits.sides // 2).tolist() == [1] * sheets + [0]
    np.testing.assert_allclose(hits.weights[:-1], 0.01 * 0.99 ** np.arange(sheets), rtol=1e-5)
    assert hits.weights[-1] == pytest.approx(0.99**sheets) and left == 0.0


def test_a_surface_at_the_shown_isovalue_is_that_one(prepared: PreparedScene) -> None:
    _, once, _ = peeled(prepared, (4.0,), [0.5])
    _, twice, _ = peeled(prepared, (4.0, 4.0), [0.5, 0.2])
    np.testing.assert_array_equal(once.points, twice.points)
    np.testing.assert_allclose(once.weights, twice.weights)


def test_a_side_is_a_tall_picture_of_its_layers(prepared: PreparedScene) -> None:
    view, hits, _ = peeled(prepared, LEVELS, [0.5, 0.8, 0.0])
    first = first_of(view, hits, prepared.surface(4.0))
    assert len(np.unique(first.pixels)) == len(first.pixels)
    layers = side_layers(hits, Side(1), first, prepared.surface(0.0))
    some = hits.rows_of(Side(1))
    assert layers.layers == 1
    ((rows, pixels),) = layers.each
    np.testing.assert_array_equal(pixels, hits.pixels[some])
    assert rows == slice(0, len(some))
    np.testing.assert_array_equal(layers.gbuffer.points, hits.points[some])
    away = np.linalg.norm(layers.gbuffer.points - MIDDLE, axis=1)
    np.testing.assert_allclose(away, 12.0, atol=0.1)


# --- work that is left
# -------------------------------------------------------------------------------------------------


def part_of(side: Side, error: float, measured: bool, final: bool = False) -> Part:
    """A part of 100 pixels of luminance 1 with this relative error."""
    total = TotalError(error, error, error)
    quality = SimpleNamespace(waiting=0)
    frame = SimpleNamespace(
        true_mean=1.0,
        improving=not final,
        outdated=False,
        walls_coarse=False,
        quality=quality,
        total=total,
        noise=error,
        measured=total if measured else None,
    )
    layers = SimpleNamespace(weights=np.ones(100))
    return Part(side, cast(SideLayers, layers), cast(Frame, frame), cast(Caches, "light"))


def refined(*parts: Part, target: float = 0.02) -> list[Side]:
    """The sides that take steps, in order: each pixel shows a point of each part, so that the
    picture is as bright as all parts together.
    """
    frame = SimpleNamespace(true_mean=float(len(parts)), surface=100, parts=parts)
    errors = {part.side: part.frame.total.likely for part in parts}
    return [part.side for part in to_refine(cast(ComposedFrame, frame), errors, target)]


A, B, C = Side(0), Side(1), Side(1, True)


def test_sides_take_steps_until_errors_add_up_to_the_target() -> None:
    """Three parts of one brightness may err by 3 · 0.02 together, as squares."""
    small = part_of(B, 0.02, measured=True), part_of(C, 0.02, measured=True)
    assert refined(part_of(A, 0.05, measured=True), *small) == []
    assert refined(part_of(A, 0.06, measured=True), *small) == [A]
    noisy = part_of(B, 0.07, measured=True)
    assert refined(part_of(A, 0.08, measured=True), noisy, small[1]) == [A, B]
    assert refined(part_of(A, 0.06, measured=True, final=True), *small) == []


def test_sides_are_measured_before_the_worst_takes_steps() -> None:
    """Its steps would be in vain if all together are good enough."""
    worst = part_of(A, 0.03, measured=True)
    others = part_of(B, 0.01, measured=False), part_of(C, 0.015, measured=False)
    assert sorted([worst, *others], key=step_key, reverse=True) == [others[1], others[0], worst]
    assert refined(worst, *others) == []
    noisy = part_of(B, 0.055, measured=False)
    assert refined(part_of(A, 0.03, measured=True), noisy, others[1]) == [B]


# --- light of two levels
# ----------------------------------------------------------------------------------------------


ONE = cast(Caches, "one")
OTHER = cast(Caches, "other")
SHARES = (Level(ONE, 0.75), Level(OTHER, 0.25))


def reading(grades: list[int], error: float) -> Reading:
    grade = np.array(grades, np.uint8)
    rows = np.where(np.isin(grade, (UNBAKED_GRADE, BURIED_GRADE, VOID_GRADE)), -1, 0).astype(
        np.int32
    )
    samples = np.full(len(grade), 64, np.int32)
    errors = np.full(len(grade), error, np.float32)
    short = np.array([(grade < FINAL).any()])
    return Reading(
        rows,
        grade,
        bytes(grades),
        samples,
        errors,
        np.array([0, len(grade)]),
        short,
        Goal(0.02),
        rough=False,
    )


def mix(one: list[int], other: list[int]) -> tuple[Reading, np.ndarray]:
    """What two levels are together where all texels have light 1 and 3, and noise 0.1 and 0.2."""
    lights = [np.full((len(one), LIGHT_NUMBERS), light, np.float32) for light in (1.0, 3.0)]
    for light, noise in zip(lights, (0.1, 0.2), strict=True):
        light[:, 3] = noise
    return mixed(SHARES, [(reading(one, 0.01), lights[0]), (reading(other, 0.04), lights[1])])


def test_light_is_mixed_by_shares_and_noise_as_independent() -> None:
    found, lit = mix([FINAL], [CONVERGING])
    np.testing.assert_allclose(lit[0, [0, 1, 2, 4, 5, 6]], 1.5)
    assert lit[0, 3] == pytest.approx(np.hypot(0.075, 0.05))
    assert found.error[0] == pytest.approx(np.hypot(0.0075, 0.01))
    assert found.grade.tolist() == [CONVERGING] and found.short.all() and found.whole


@pytest.mark.parametrize(
    ("one", "other", "grade", "light"),
    [
        (FINAL, UNBAKED_GRADE, PARTIAL_GRADE, 1.0),
        (BURIED_GRADE, FINAL, FINAL, 3.0),
        (BURIED_GRADE, CONVERGING, CONVERGING, 3.0),
        (BURIED_GRADE, BURIED_GRADE, BURIED_GRADE, 0.0),
        (UNBAKED_GRADE, BURIED_GRADE, UNBAKED_GRADE, 0.0),
        (VOID_GRADE, VOID_GRADE, VOID_GRADE, 1.5),
    ],
)
def test_where_a_level_holds_nothing_the_other_stands_in(
    one: int, other: int, grade: int, light: float
) -> None:
    found, lit = mix([one], [other])
    assert found.grade.tolist() == [grade]
    assert lit[0, 0] == pytest.approx(light)


def test_each_level_is_baked_by_its_own_caches() -> None:
    found, _ = mix([CONVERGING], [FINAL])
    assert isinstance(found, MixedReading)

    class Nothing:
        """A picture that lacks what is asked of it."""

        def of(self, reading: Reading, *_: Any) -> tuple[Reading]:
            return (reading,)

    stages = found.stages(cast(Any, Nothing()))
    assert [stage.caches for stage in stages] == [ONE, OTHER]


def test_one_level_is_read_as_it_is() -> None:
    single = reading([FINAL], 0.01), np.zeros((1, LIGHT_NUMBERS), np.float32)
    assert mixed(SHARES[:1], [single]) is single
