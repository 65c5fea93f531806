"""Light of whole chunks for cards: from the bytes alone a twin draws the frame; few bits, and
blocks that are known.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.card import blocks
from isogi_core.frame.card.block_format import CODES, words_of
from isogi_core.frame.card.blocks import (
    coded_chunks,
    fold_chunks,
    known_light,
    known_transfer,
    raw_scale,
    transfer_chunks,
)
from isogi_core.frame.card.coded_light import coarse_words, join_light, light_file
from isogi_core.frame.card.coded_picture import ControlPictures, draw_coded
from isogi_core.frame.card.coding import Coding, coding_for
from isogi_core.frame.card.looks import look_at, seen_chunks
from isogi_core.frame.known_blocks import KnownBlocks, Packed
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_normals import find_texel_normals
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.shading.irradiance_ratio import DIRECT_COLUMN, REFLECTED_COLUMN
from isogi_core.kernels.shading.lattice import BURIED_GRADE, VOID_GRADE
from isogi_core.model.view import View, quaternion_from_angles, rotation_matrix
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_server.answers import card_scene
from tests.card_twin import BURIED, FLAT, VOID, Twin, blocks_in, normal_of
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, refine_chunk, shading_of
from tests.loaded import load_scene
from tests.published import light_in

Make = Callable[[Scene], Workbench]
BenchOf = Callable[[str], Workbench]
TILES = Tiles()
LOOSE_GOAL = Goal.checked(LOOSE)
SCENES: dict[str, dict[str, Any]] = {
    "colours": {"lights": [SKY], "albedo": [0.8, 0.6, 0.4]},
    "albedos": {"lights": [SKY], "albedo": 0.6, "albedos": [0.2, 0.8]},
    "irradiance": {"lights": [{**SKY, "scale": 3e4}], "rotating": False},
    "constant": {"lights": [CONSTANT]},
    "fine": {"lights": [SKY], "lattice": 1.5, "chunk": 8},
}


@pytest.fixture(scope="module")
def bench_of(tmp_path_factory: pytest.TempPathFactory) -> BenchOf:
    """Makes workbenches of SCENES, on stores in which their `view()` is baked."""

    @cache
    def baked(name: str) -> Workbench:
        scene = load_scene(
            "demo:orbital", bounces=2, target_error=LOOSE, projected=False, **SCENES[name]
        )
        bench = Workbench(scene, tmp_path_factory.mktemp(name))
        bench.bake(bench.view(size=40))
        return bench

    return lambda name: baked(name).again()


def drawn(
    bench: Workbench, view: View, target: float = LOOSE, filters: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and radiance before lobes of a view's surface."""
    gbuffer = bench.renderer.gbuffer(view)
    light = RotatedLight(bench.caches.spec("gi"), view)
    texels = bench.renderer.surface.texels(view, gbuffer)
    shot = Shot(gbuffer, light, Goal(target), TILES)
    _, framebuffer = shading_of(bench.caches, filters).picture(texels, shot)
    return gbuffer.points, gbuffer.normals(TILES), framebuffer.radiance[gbuffer.pixels]


# --- what blocks draw
# -------------------------------------------------------------------------------------------------


TURN = quaternion_from_angles(70.0, -20.0, 15.0)


def twin_of(bench: Workbench, view: View, raw: bool, target: float = LOOSE) -> Twin:
    """The twin with all chunks of a view."""
    scene = card_scene(bench.renderer, view, ()).model_dump()
    twin = Twin(scene, rotation_matrix(view.light))
    indices = [each.at for each in seen_chunks(bench.renderer, view, Goal.checked(target), TILES)]
    if raw:
        packed = transfer_chunks(bench.renderer, indices, Goal.checked(target), TILES)
    else:
        packed = fold_chunks(bench.renderer, view, indices, Goal.checked(target), TILES)
    twin.take(b"".join(each.data for each in packed.blocks))
    return twin


def differences(twin: Twin, bench: Workbench, view: View, raw: bool) -> tuple[np.ndarray, float]:
    """Differences of sRGB codes, the largest of each pixel, and the relative RMSE of the
    radiance.
    """
    points, normals, expected = drawn(bench, view, filters=not raw)
    assert len(points) > 250
    found = np.array(
        [twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)]
    )
    apart = np.abs(twin.develop(found) - twin.develop(expected.astype(np.float64))).max(axis=1)
    return apart, float(np.sqrt(((found - expected) ** 2).mean()) / expected.mean())


@pytest.mark.usefixtures("unfiltered")
@pytest.mark.parametrize("raw", [False, True], ids=["folded", "raw"])
@pytest.mark.parametrize("name", SCENES)
def test_the_bytes_draw_the_frame(bench_of: BenchOf, name: str, raw: bool) -> None:
    bench = bench_of(name)
    view = bench.view(
        size=40, light=TURN if bench.scene.lighting.rotating else (1.0, 0.0, 0.0, 0.0)
    )
    apart, rmse = differences(twin_of(bench, view, raw), bench, view, raw)
    assert (apart <= 2).mean() == 1.0, (
        f"{(apart > 2).sum()} of {len(apart)} pixels, up to {apart.max()}"
    )
    assert rmse < 0.002


@pytest.mark.usefixtures("unfiltered")
def test_the_albedo_of_a_view_is_in_the_document(bench_of: BenchOf) -> None:
    bench = bench_of("albedos")
    view = bench.view(size=40, albedo=(0.3, 0.5, 0.7))
    for raw in (False, True):
        apart, rmse = differences(twin_of(bench, view, raw), bench, view, raw)
        assert (apart <= 2).all() and rmse < 0.002


def test_records_are_the_kernels_inputs_in_halves(bench_of: BenchOf) -> None:
    bench = bench_of("colours")
    view = bench.view(size=40, light=TURN)
    twin = twin_of(bench, view, False)
    light = RotatedLight(bench.caches.spec("gi"), view)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    reading, records = kernels_inputs(bench, view, light)
    expected = records[
        :,
        [
            DIRECT_COLUMN,
            DIRECT_COLUMN + 1,
            DIRECT_COLUMN + 2,
            REFLECTED_COLUMN,
            REFLECTED_COLUMN + 1,
            REFLECTED_COLUMN + 2,
        ],
    ]
    own = [twin.texels[z, y, x] for z, y, x in texels.positions.tolist()]
    found = np.array([[*each.direct, *each.reflected] for each in own])
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
    lit = reading.rows >= 0
    cosines = np.sum(
        [each.normal for each in np.array(own, object)[lit]] * records[lit, 11:14], axis=1
    )
    assert lit.sum() > 500 and cosines.min() > 1.0 - 1e-7


def kernels_inputs(bench: Workbench, view: View, light: RotatedLight) -> tuple[Any, np.ndarray]:
    """The reading and the records that the frame of a view is made of."""
    from isogi_core.frame.shading import fill_texel_records

    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    shot = Shot(texels.gbuffer, light, Goal(LOOSE), TILES)
    shading = shading_of(bench.caches)
    reading, lit = shading.lit(texels, shot)
    found = find_texel_normals(texels, shading.normals, bench.prepared, TILES)
    normals = found.select(reading.on_surface, texels, bench.prepared, TILES)
    return reading, fill_texel_records(reading.grade, lit, normals, light, TILES)


def test_a_brick_ends_with_its_mean(bench_of: BenchOf) -> None:
    bench = bench_of("colours")
    view = bench.view(size=40)
    at = [each.at for each in seen_chunks(bench.renderer, view, LOOSE_GOAL, TILES)][:3]
    for block in blocks_in(
        b"".join(
            each.data for each in fold_chunks(bench.renderer, view, at, LOOSE_GOAL, TILES).blocks
        )
    ):
        bricks: dict[tuple[int, ...], list[int]] = {}
        for (z, y, x), number in block.numbers():
            bricks.setdefault((z // 4, y // 4, x // 4), []).append(number)
        assert list(block.masks) == sorted(block.masks)
        for place, mean in block.means().items():
            own = block.records[[i for i in bricks[place] if block.words[i] not in (BURIED, VOID)]]
            if len(own):
                np.testing.assert_allclose(
                    block.records[mean], own.mean(axis=0), rtol=2e-3, atol=1e-6
                )
        assert len(block.records) == sum(map(len, bricks.values())) + len(bricks)


def test_versions_change_with_light_alone(workbench: Make) -> None:
    bench = workbench(
        load_scene("demo:orbital", bounces=2, target_error=LOOSE, **SCENES["colours"])
    )
    view = bench.view(size=24)
    before = seen_chunks(bench.renderer, view, LOOSE_GOAL, TILES)
    (unlit,) = {each.version for each in before}
    assert not any(each.final for each in before)
    at = [before[0].at]
    columns = bench.caches.spec("gi").columns
    for packed in (
        fold_chunks(bench.renderer, view, at, LOOSE_GOAL, TILES),
        transfer_chunks(bench.renderer, at, LOOSE_GOAL, TILES),
    ):
        (empty,) = blocks_in(packed.blocks[0].data, 3 * columns + 2)
        assert (len(empty.masks), len(empty.records), empty.version) == (0, 0, "00" * 8)
    bench.bake(view)
    after = seen_chunks(bench.renderer, view, LOOSE_GOAL, TILES)
    assert [each.at for each in after] == [each.at for each in before]
    assert unlit not in {each.version for each in after} and all(each.final for each in after)
    assert seen_chunks(bench.again().renderer, view, LOOSE_GOAL, TILES) == after
    assert [
        each.version
        for each in seen_chunks(bench.renderer, bench.view(size=24, light=TURN), LOOSE_GOAL, TILES)
    ] == [each.version for each in after]


def test_most_visible_chunks_come_first(workbench: Make) -> None:
    bench = workbench(
        load_scene("demo:orbital", bounces=2, target_error=LOOSE, **SCENES["colours"])
    )
    view = bench.view(size=48)
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    order = [each.at for each in seen_chunks(bench.renderer, view, LOOSE_GOAL, TILES)]
    counts = dict.fromkeys(texels.chunks, 0)
    for corner in texels.corners.ravel().tolist():
        counts[texels.chunks[texels.places[corner] >> 3 * texels.lattice.bits]] += 1
    assert [counts[at] for at in order] == sorted(counts.values(), reverse=True)


def test_noisy_light_is_filtered_across_chunks(workbench: Make) -> None:
    """After a few paths the bytes draw what the frame has of filtered light, up to texels that no
    view has yet.
    """
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=0.02, **SCENES["colours"]))
    view = bench.view(size=40)
    bench.bake(view, 0.6)
    indices = [each.at for each in seen_chunks(bench.renderer, view, Goal.checked(0.02), TILES)]
    packed = fold_chunks(bench.renderer, view, indices, Goal.checked(0.02), TILES)
    alone = fold_chunks(bench.renderer, view, indices[:1], Goal.checked(0.02), TILES)
    assert not packed.alone and alone.blocks[0].data == packed.blocks[0].data, (
        "neighbours are asked for by themselves"
    )
    twin = Twin(card_scene(bench.renderer, view, ()).model_dump())
    twin.take(b"".join(each.data for each in packed.blocks))
    points, normals, expected = drawn(bench, view, 0.02)
    found = np.array(
        [twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)]
    )
    assert np.sqrt(((found - expected) ** 2).mean()) / expected.mean() < 0.01


def test_transfer_of_noisy_texels_is_filtered_as_light(workbench: Make) -> None:
    """Under a light that the page turns it draws what the server does, by the chunks of the view
    alone.
    """
    bench = workbench(
        load_scene(
            "demo:orbital", bounces=2, target_error=0.02, projected=False, **SCENES["colours"]
        )
    )
    view = bench.view(size=40, light=TURN)
    bake_to(bench, view, FIRST_LEVEL)
    twin = twin_of(bench, view, raw=True, target=0.02)
    points, normals, filtered = drawn(bench, view, 0.02)
    grainy = drawn(bench, view, 0.02, filters=False)[2]
    found = np.array(
        [twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)]
    )
    errors = [
        float(np.sqrt(((each - filtered) ** 2).mean()) / filtered.mean())
        for each in (found, grainy)
    ]
    assert errors[0] < 0.002 and errors[1] > 0.02, errors


def test_transfer_stands_for_its_chunk_alone(workbench: Make) -> None:
    bench = workbench(
        load_scene(
            "demo:orbital", bounces=2, target_error=0.02, projected=False, **SCENES["colours"]
        )
    )
    view = bench.view(size=40)
    bake_to(bench, view, FIRST_LEVEL)
    at = [each.at for each in seen_chunks(bench.renderer, view, Goal.checked(0.02), TILES)]
    packed = transfer_chunks(bench.renderer, at, Goal.checked(0.02), TILES)
    assert (
        packed.alone
        and transfer_chunks(bench.renderer, at[:1], Goal.checked(0.02), TILES).blocks[0].data
        == packed.blocks[0].data
    )


def bake_to(bench: Workbench, view: View, samples: int) -> None:
    """Bring the texels of a view to so many samples."""
    for demand in bench.renderer.render(view, Goal(1e-3, samples)).demands:
        refine_chunk(bench.caches.of("gi"), samples, 1e-3, demand)


# --- transfer in few bits
# ---------------------------------------------------------------------------------------------


RNG = np.random.default_rng(3)


def coding_of(bench: Workbench, error: float) -> Coding:
    spec = bench.caches.spec("gi")
    return coding_for(spec, raw_scale(spec), error)


@pytest.fixture
def colours(bench_of: BenchOf) -> Workbench:
    return bench_of("colours")


@pytest.mark.parametrize("turn", [0.0, 110.0])
@pytest.mark.parametrize("name", SCENES)
def test_rounding_errs_as_much_as_is_allowed(bench_of: BenchOf, name: str, turn: float) -> None:
    """Of light that a surface reflects which sees half of it, whichever way the light is turned."""
    bench = bench_of(name)
    spec = bench.caches.spec("gi")
    error = 0.02
    coding = coding_of(bench, error)
    numbers = RNG.normal(size=(4000, spec.channels * spec.columns + 2)).astype(np.float32)
    wrong = (coding.numbers(coding.codes(numbers)) - numbers)[:, :-2]
    turned = quaternion_from_angles(turn if bench.scene.lighting.rotating else 0.0, 0.0, 0.0)
    columns = (
        RotatedLight(spec, bench.view(size=8, light=turned)).reflected / spec.unit * raw_scale(spec)
    )
    light = np.array([0.2126, 0.7152, 0.0722]) @ columns
    if spec.channels == 3:
        light = (np.array([0.2126, 0.7152, 0.0722])[:, None] * columns).ravel()
    found = (wrong @ light).std() / (0.5 * spec.unoccluded / spec.unit)
    assert error / 2 < found < 2 * error


def test_codes_are_whole_numbers_that_two_bytes_hold() -> None:
    coding = Coding(np.array([0.5, 1e-9, 0.0], np.float32))
    codes = coding.codes(np.array([[1.2, 1.0, 7.0], [-1.3, -1.0, 0.0]], np.float32))
    np.testing.assert_array_equal(codes, [[2, 32767, 0], [-3, -32767, 0]])
    np.testing.assert_array_equal(coding.numbers(codes)[:, [0, 2]], [[1.0, 0.0], [-1.5, 0.0]])


@pytest.mark.usefixtures("unfiltered")
def test_light_in_few_bits_holds_the_transfer(colours: Workbench) -> None:
    bench = colours
    view = colours.view(size=40)
    tiles = bench.renderer.tiles
    coding = coding_of(bench, 0.01)
    indices = [each.at for each in seen_chunks(bench.renderer, view, LOOSE_GOAL, tiles)]
    whole = transfer_chunks(bench.renderer, indices, LOOSE_GOAL, tiles)
    expected = blocks_in(b"".join(each.data for each in whole.blocks), len(coding.steps))
    few, _ = coded_chunks(bench.renderer, indices, LOOSE_GOAL, (coding, coding), tiles)
    found = light_in(light_file(few), coding.steps.astype(float))
    assert len(found) > 3
    for chunk, same in zip(found, expected, strict=True):
        assert chunk.at == same.at
        assert chunk.masks == {place: mask for place, (mask, _) in same.masks.items()}
        known = list(CODES.values())
        np.testing.assert_array_equal(np.isin(chunk.words, known), np.isin(same.words, known))
        apart = np.abs(chunk.numbers - same.records) - 1e-3 * np.abs(same.records)
        assert (apart <= 1.001 * coding.steps).all() and (
            apart <= 0.501 * coding.steps
        ).mean() > 0.9, "means are of codes"


@pytest.mark.usefixtures("unfiltered")
def test_coarse_light_has_the_means_of_all_bricks(colours: Workbench) -> None:
    bench = colours
    tiles = bench.renderer.tiles
    codings = coding_of(bench, 0.01), coding_of(bench, 0.04)
    seen = [
        each.at for each in seen_chunks(bench.renderer, colours.view(size=40), LOOSE_GOAL, tiles)
    ]
    fine, coarse = zip(
        *(
            coded_chunks(bench.renderer, part, LOOSE_GOAL, codings, tiles)
            for part in (seen[:2], seen[2:])
        ),
        strict=True,
    )
    steps, coarse_steps = (each.steps.astype(float) for each in codings)
    alone = light_in(light_file(join_light(coarse)), coarse_steps)
    whole = light_in(light_file(join_light(fine)), steps)
    for means, chunk in zip(alone, whole, strict=True):
        assert means.at == chunk.at and means.masks == dict.fromkeys(chunk.masks, 0)
        ends = np.cumsum([mask.bit_count() + 1 for mask in chunk.masks.values()]) - 1
        np.testing.assert_array_equal(means.words, chunk.words[ends])
        apart = np.abs(means.numbers - chunk.numbers[ends])
        assert (apart <= 0.501 * (steps + coarse_steps) + 0.5 * coarse_steps).all()
        assert (apart <= 0.501 * (steps + coarse_steps)).mean() > 0.9, "means are of codes"


def test_a_file_may_have_no_light() -> None:
    assert light_in(light_file(join_light([])), np.ones(5)) == []


def test_normals_in_few_bits_stay_near_and_codes_as_they_are() -> None:
    n = RNG.normal(size=(500, 3))
    n[:6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    grade = np.full(len(n), FINAL, np.uint8)
    near = coarse_words(words_of(n, grade))
    cosines = [float(normal_of(int(word)) @ each) for word, each in zip(near, n, strict=True)]
    assert np.degrees(np.arccos(np.clip(min(cosines), -1.0, 1.0))) < 0.3
    assert not np.isin(near, [BURIED, VOID, FLAT]).any()
    kept = words_of(np.zeros((3, 3)), np.array([BURIED_GRADE, VOID_GRADE, FINAL], np.uint8))
    np.testing.assert_array_equal(coarse_words(kept), kept)


@pytest.mark.usefixtures("unfiltered")
@pytest.mark.parametrize("name", ["colours", "irradiance", "constant"])
def test_pictures_of_fine_codes_are_isogis(bench_of: BenchOf, name: str) -> None:
    bench = bench_of(name)
    view = bench.view(size=40)
    framebuffer = draw_coded(bench.renderer, view, coding_of(bench, 1e-4), LOOSE_GOAL)
    expected = drawn(bench, view)[2]
    if bench.caches.spec("gi").lobes:
        expected = expected + bench.renderer.surface.lobe_radiance(bench.renderer.render(view))
    shown = framebuffer.radiance[bench.renderer.gbuffer(view).pixels]
    np.testing.assert_allclose(shown, expected, atol=2e-3 * expected.mean())


@pytest.mark.usefixtures("unfiltered")
def test_coded_pictures_have_colours_by_data(workbench: Make) -> None:
    """As isogi's picture has them: the page multiplies the light of a white surface."""
    table = {"use": "colour", "of": "gradient", "map": "coolwarm"}
    kept: dict[str, Any] = {"bounces": 2, "target_error": LOOSE, "projected": False}
    bench = workbench(load_scene("demo:orbital", lights=[CONSTANT], volumes=[table], **kept))
    view = bench.view(size=40)
    bench.bake(view)
    framebuffer = draw_coded(bench.renderer, view, coding_of(bench, 1e-4), LOOSE_GOAL)
    gbuffer = bench.renderer.gbuffer(view)
    light = RotatedLight(bench.caches.spec("gi"), view)
    tints = light.tints(gbuffer, bench.renderer.tiles)
    expected = tints * drawn(bench, view)[2]
    shown = framebuffer.radiance[gbuffer.pixels]
    assert np.ptp(tints, axis=0).max() > 0.3
    np.testing.assert_allclose(shown, expected, atol=2e-3 * expected.mean())


def test_measured_errors_grow_by_what_rounding_adds(colours: Workbench) -> None:
    views = [colours.view(azimuth=azimuth, size=48) for azimuth in (40.0, 43.0)]
    pictures = ControlPictures(colours.renderer, views, Goal.checked(0.2))
    fine, coarse_error = (pictures.measure(coding_of(colours, error)) for error in (1e-3, 0.6))
    assert len(pictures) == 2 and fine.controls == 2 * 256
    assert fine.low < fine.likely < fine.high < coarse_error.low


def test_views_without_a_surface_are_not_measured(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", target_error=LOOSE, projected=False))
    view = bench.view(size=16)
    away = replace(view.camera, target=tuple(2.0 * np.array(view.camera.eye) - view.camera.target))
    assert (
        len(ControlPictures(bench.renderer, [replace(view, camera=away)], Goal.checked(0.5))) == 0
    )


# --- known blocks
# --------------------------------------------------------------------------------------------------


TARGET = 0.02
GOAL = Goal.checked(TARGET)


@pytest.fixture(scope="module")
def grainy(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """A scene whose light is grainy, so that blocks depend on chunks beside."""
    scene = load_scene("demo:orbital", bounces=2, target_error=TARGET, **SCENES["albedos"])
    found = Workbench(scene, tmp_path_factory.mktemp("grainy"))
    found.bake(found.view(size=40), 0.6)
    return found


@pytest.fixture
def bench(grainy: Workbench, tmp_path: Path) -> Workbench:
    """The grainy scene on a store that may be baked on."""
    return Workbench(grainy.scene, Path(shutil.copytree(grainy.folder, tmp_path / "light")))


@pytest.fixture
def folded(monkeypatch: pytest.MonkeyPatch) -> list[Index]:
    """Every chunk that is folded, as often as it is."""
    counted: list[Index] = []

    def counting(renderer: object, view: View, chunks: Sequence[Index], *more: object) -> Packed:
        counted.extend(chunks)
        return fold_chunks(renderer, view, chunks, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(blocks, "fold_chunks", counting)
    return counted


def seen(bench: Workbench) -> list[Index]:
    return [each.at for each in seen_chunks(bench.renderer, bench.view(size=40), GOAL, TILES)]


def data(packed: Packed) -> list[bytes]:
    return [each.data for each in packed.blocks]


def test_chunks_are_folded_once_for_all_visitors(bench: Workbench, folded: list[Index]) -> None:
    view = bench.view(size=40)
    at = seen(bench)
    once = known_light(bench.renderer, view, at[:5], GOAL, TILES)
    again = known_light(bench.renderer, view, [*at[::-1], at[0]], GOAL, TILES)
    assert sorted(folded) == sorted(at)
    assert once.blocks == again.blocks[-2:-7:-1] and again.blocks[-1] is once.blocks[0]
    assert data(again)[:-1] == data(fold_chunks(bench.renderer, view, at[::-1], GOAL, TILES))
    assert not again.alone


@pytest.mark.parametrize("change", ["light", "albedo", "target"])
def test_other_light_is_folded_by_itself(
    bench: Workbench, folded: list[Index], change: str
) -> None:
    view = bench.view(size=40)
    at = seen(bench)[:3]
    known_light(bench.renderer, view, at, GOAL, TILES)
    more = {
        "light": {"light": quaternion_from_angles(70.0, 0.0, 0.0)},
        "albedo": {"albedo": (0.3, 0.3, 0.3)},
    }
    other = bench.view(size=40, **more.get(change, {}))
    target = 0.3 if change == "target" else TARGET
    found = known_light(bench.renderer, other, at, Goal.checked(target), TILES)
    assert len(folded) == 6
    assert data(found) == data(fold_chunks(bench.renderer, other, at, Goal.checked(target), TILES))


def test_what_is_baked_on_is_folded_once_more(bench: Workbench, folded: list[Index]) -> None:
    """So are the chunks beside, whose light is filtered by it."""
    view = bench.view(size=40)
    at = seen(bench)
    known_light(bench.renderer, view, at, GOAL, TILES)
    folded.clear()
    bench.bake(bench.view(size=16), 0.3)
    found = known_light(bench.renderer, view, at, GOAL, TILES)
    assert folded
    assert data(found) == data(fold_chunks(bench.renderer, view, at, GOAL, TILES))


def test_transfer_is_known_whatever_the_light(bench: Workbench) -> None:
    at = seen(bench)[:4]
    once, again = (known_transfer(bench.renderer, at, GOAL, TILES) for _ in range(2))
    assert once.blocks == again.blocks
    assert once.blocks != known_light(bench.renderer, bench.view(size=40), at, GOAL, TILES).blocks


def test_known_blocks_take_few_bytes(bench: Workbench, folded: list[Index]) -> None:
    """The oldest go, and are folded once more."""
    view = bench.view(size=40)
    at = seen(bench)
    bench.renderer.blocks = known = KnownBlocks(100_000)
    for each in at:
        known_light(bench.renderer, view, [each], GOAL, TILES)
        assert known.nbytes <= 100_000
    known_light(bench.renderer, view, [at[0]], GOAL, TILES)
    assert folded.count(at[0]) == 2 and folded.count(at[-1]) == 1


def test_a_look_at_final_light_is_kept_until_more_is_baked(bench: Workbench) -> None:
    view = bench.view(size=40)
    once = look_at(bench.renderer, view, Goal.checked(0.9), TILES)
    assert once.frame is None and look_at(bench.renderer, view, Goal.checked(0.9), TILES) is once
    bench.bake(bench.view(size=16), 0.3)
    again = look_at(bench.renderer, view, Goal.checked(0.9), TILES)
    assert again.seen != once.seen and [each.at for each in again.seen] == [
        each.at for each in once.seen
    ]


def test_a_look_at_light_to_come_is_not_kept(bench: Workbench) -> None:
    view = bench.view(azimuth=220.0, size=40)
    once, again = (look_at(bench.renderer, view, Goal.checked(0.9), TILES) for _ in range(2))
    assert once.frame is not None and again.frame is not once.frame and again.seen == once.seen
