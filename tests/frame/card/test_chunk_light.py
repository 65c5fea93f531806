"""Light of whole chunks: from their bytes alone a twin draws what the frame has before lobes."""

from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.page_pool import UNLIT_VERSION
from isogi_core.frame.card.blocks import fold_chunks, seen_chunks, transfer_chunks
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.tiles import Stopwatch
from isogi_core.kernels.shading.irradiance_ratio import DIRECT_COLUMN, REFLECTED_COLUMN
from isogi_core.model.view import View, quaternion_from_angles, rotation_matrix
from server.answers import card_scene
from tests.card_twin import Twin, blocks_in
from tests.frame.card.benches import SCENES, TILES, Make, bench_of, drawn
from tests.frame.conftest import LOOSE, Workbench, refine_chunk
from tests.loaded import load_scene

TURN = quaternion_from_angles(70.0, -20.0, 15.0)


def twin_of(bench: Workbench, view: View, raw: bool, target: float = LOOSE) -> Twin:
    """The twin with all chunks of a view."""
    scene = card_scene(bench.renderer, view, ()).model_dump()
    twin = Twin(scene, rotation_matrix(view.light))
    indices = [each.at for each in seen_chunks(bench.renderer, view, target, TILES)]
    if raw:
        packed = transfer_chunks(bench.renderer, indices, target, TILES)
    else:
        packed = fold_chunks(bench.renderer, view, indices, target, TILES)
    twin.take(b"".join(each.data for each in packed.blocks))
    return twin


def differences(twin: Twin, bench: Workbench, view: View, raw: bool) -> tuple[np.ndarray, float]:
    """Differences of sRGB codes, the largest of each pixel, and the relative RMSE of the radiance."""
    points, normals, expected = drawn(bench, view, filters=not raw)
    assert len(points) > 250
    found = np.array([twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)])
    apart = np.abs(twin.develop(found) - twin.develop(expected.astype(np.float64))).max(axis=1)
    return apart, float(np.sqrt(((found - expected) ** 2).mean()) / expected.mean())


@pytest.mark.usefixtures("unfiltered")
@pytest.mark.parametrize("raw", [False, True], ids=["folded", "raw"])
@pytest.mark.parametrize("name", SCENES)
def test_the_bytes_draw_the_frame(workbench: Make, name: str, raw: bool) -> None:
    bench = bench_of(workbench, name)
    view = bench.view(size=40, light=TURN if bench.scene.lighting.rotating else (1.0, 0.0, 0.0, 0.0))
    apart, rmse = differences(twin_of(bench, view, raw), bench, view, raw)
    assert (apart <= 2).mean() == 1.0, f"{(apart > 2).sum()} of {len(apart)} pixels, up to {apart.max()}"
    assert rmse < 0.002


@pytest.mark.usefixtures("unfiltered")
def test_the_albedo_of_a_view_is_in_the_document(workbench: Make) -> None:
    bench = bench_of(workbench, "albedos")
    view = bench.view(size=40, albedo=(0.3, 0.5, 0.7))
    for raw in (False, True):
        apart, rmse = differences(twin_of(bench, view, raw), bench, view, raw)
        assert (apart <= 2).all() and rmse < 0.002


def test_records_are_the_kernels_inputs_in_halves(workbench: Make) -> None:
    bench = bench_of(workbench, "colours")
    view = bench.view(size=40, light=TURN)
    twin, light = twin_of(bench, view, False), RotatedLight(bench.caches.spec("gi"), view)
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
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
    cosines = np.sum([each.normal for each in np.array(own, object)[lit]] * records[lit, 11:14], axis=1)
    assert lit.sum() > 500 and cosines.min() > 1.0 - 1e-7


def kernels_inputs(bench: Workbench, view: View, light: RotatedLight) -> tuple[Any, np.ndarray]:
    """The reading and the records that the frame of a view is made of."""
    from isogi_core.frame.shading import fill_texel_records

    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    reading, lit = bench.renderer._texels.lit(texels, light, Until(LOOSE), TILES, Stopwatch())
    normals = bench.renderer._texels._texel_normals(view, texels, reading, TILES)
    return reading, fill_texel_records(reading.grade, lit, normals, light, TILES)


def test_a_brick_ends_with_its_mean(workbench: Make) -> None:
    bench = bench_of(workbench, "colours")
    view = bench.view(size=40)
    at = [each.at for each in seen_chunks(bench.renderer, view, LOOSE, TILES)][:3]
    for block in blocks_in(b"".join(each.data for each in fold_chunks(bench.renderer, view, at, LOOSE, TILES).blocks)):
        bricks: dict[tuple[int, ...], list[int]] = {}
        for (z, y, x), number in block.numbers():
            bricks.setdefault((z // 4, y // 4, x // 4), []).append(number)
        assert list(block.masks) == sorted(block.masks)
        for place, mean in block.means().items():
            own = block.records[[i for i in bricks[place] if block.words[i] not in (0x80008001, 0x80008002)]]
            if len(own):
                np.testing.assert_allclose(block.records[mean], own.mean(axis=0), rtol=2e-3, atol=1e-6)
        assert len(block.records) == sum(map(len, bricks.values())) + len(bricks)


def test_versions_change_with_light_alone(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=LOOSE, **SCENES["colours"]))
    view = bench.view(size=24)
    before = seen_chunks(bench.renderer, view, LOOSE, TILES)
    assert before and {each.version for each in before} == {UNLIT_VERSION} and not any(each.final for each in before)
    at, columns = [before[0].at], bench.caches.spec("gi").columns
    for packed in (
        fold_chunks(bench.renderer, view, at, LOOSE, TILES),
        transfer_chunks(bench.renderer, at, LOOSE, TILES),
    ):
        (empty,) = blocks_in(packed.blocks[0].data, 3 * columns + 2)
        assert (len(empty.masks), len(empty.records), empty.version) == (0, 0, "00" * 8)
    bench.bake(view)
    after = seen_chunks(bench.renderer, view, LOOSE, TILES)
    assert [each.at for each in after] == [each.at for each in before]
    assert UNLIT_VERSION not in {each.version for each in after} and all(each.final for each in after)
    assert seen_chunks(bench.again().renderer, view, LOOSE, TILES) == after
    assert [each.version for each in seen_chunks(bench.renderer, bench.view(size=24, light=TURN), LOOSE, TILES)] == [
        each.version for each in after
    ]


def test_most_visible_chunks_come_first(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=LOOSE, **SCENES["colours"]))
    view = bench.view(size=48)
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    order = [each.at for each in seen_chunks(bench.renderer, view, LOOSE, TILES)]
    counts = dict.fromkeys(texels.chunks, 0)
    for corner in texels.corners.ravel().tolist():
        counts[texels.chunks[texels.places[corner] >> 3 * texels.lattice.bits]] += 1
    assert [counts[at] for at in order] == sorted(counts.values(), reverse=True)


def test_noisy_light_is_filtered_across_chunks(workbench: Make) -> None:
    """After a few paths the bytes draw what the frame has of filtered light, up to texels that no view has yet."""
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=0.02, **SCENES["colours"]))
    view = bench.view(size=40)
    bench.bake(view, 0.6)
    indices = [each.at for each in seen_chunks(bench.renderer, view, 0.02, TILES)]
    packed = fold_chunks(bench.renderer, view, indices, 0.02, TILES)
    alone = fold_chunks(bench.renderer, view, indices[:1], 0.02, TILES)
    assert not packed.alone and alone.blocks[0].data == packed.blocks[0].data, "neighbours are asked for by themselves"
    twin = Twin(card_scene(bench.renderer, view, ()).model_dump())
    twin.take(b"".join(each.data for each in packed.blocks))
    points, normals, expected = drawn(bench, view, 0.02)
    found = np.array([twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)])
    assert np.sqrt(((found - expected) ** 2).mean()) / expected.mean() < 0.01


def test_transfer_of_noisy_texels_is_filtered_as_light(workbench: Make) -> None:
    """Under a light that the page turns it draws what the server does, by the chunks of the view alone."""
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=0.02, projected=False, **SCENES["colours"]))
    view = bench.view(size=40, light=TURN)
    bake_to(bench, view, FIRST_LEVEL)
    twin = twin_of(bench, view, raw=True, target=0.02)
    points, normals, filtered = drawn(bench, view, 0.02)
    grainy = drawn(bench, view, 0.02, filters=False)[2]
    found = np.array([twin.shade(p, n) for p, n in zip(points.astype(float), normals.astype(float), strict=True)])
    errors = [float(np.sqrt(((each - filtered) ** 2).mean()) / filtered.mean()) for each in (found, grainy)]
    assert errors[0] < 0.002 and errors[1] > 0.02, errors


def test_transfer_stands_for_its_chunk_alone(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=0.02, projected=False, **SCENES["colours"]))
    view = bench.view(size=40)
    bake_to(bench, view, FIRST_LEVEL)
    at = [each.at for each in seen_chunks(bench.renderer, view, 0.02, TILES)]
    packed = transfer_chunks(bench.renderer, at, 0.02, TILES)
    assert packed.alone and transfer_chunks(bench.renderer, at[:1], 0.02, TILES).blocks[0].data == packed.blocks[0].data


def bake_to(bench: Workbench, view: View, samples: int) -> None:
    """Bring the texels of a view to so many samples."""
    for demand in bench.renderer.render(view, 1e-3, enough=samples).demands:
        refine_chunk(bench.caches.of("gi"), samples, 1e-3, demand)
