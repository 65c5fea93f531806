"""Transfer in few bits: what rounding costs, what is kept, and how pictures of it are measured."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.frame.card.blocks import (
    CODES,
    FLAT,
    Coding,
    coarse,
    coded_chunks,
    coding_for,
    raw_scale,
    seen_chunks,
    transfer_chunks,
    words_of,
)
from isogi_core.frame.card.coded_picture import ControlPictures, draw_coded
from isogi_core.frame.lighting import RotatedLight
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.shading.lattice import BURIED_GRADE, VOID_GRADE
from isogi_core.model.view import quaternion_from_angles
from tests.card_twin import blocks_in, normal_of, read_coded
from tests.frame.card.benches import SCENES, Make, bench_of, drawn
from tests.frame.conftest import LOOSE, Workbench
from tests.loaded import load_scene

RNG = np.random.default_rng(3)


def coding_of(bench: Workbench, error: float) -> Coding:
    spec = bench.caches.spec("gi")
    return coding_for(spec, raw_scale(spec), error)


@pytest.fixture
def colours(workbench: Make) -> Workbench:
    return bench_of(workbench, "colours")


@pytest.mark.parametrize("turn", [0.0, 110.0])
@pytest.mark.parametrize("name", SCENES)
def test_rounding_errs_as_much_as_is_allowed(workbench: Make, name: str, turn: float) -> None:
    """Of light that a surface reflects which sees half of it, whichever way the light is turned."""
    bench = bench_of(workbench, name)
    spec, error = bench.caches.spec("gi"), 0.02
    coding = coding_of(bench, error)
    numbers = RNG.normal(size=(4000, spec.channels * spec.columns + 2)).astype(np.float32)
    wrong = (coding.numbers(coding.codes(numbers)) - numbers)[:, :-2]
    turned = quaternion_from_angles(turn if bench.scene.lighting.rotating else 0.0, 0.0, 0.0)
    columns = RotatedLight(spec, bench.view(size=8, light=turned)).reflected / spec.unit * raw_scale(spec)
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
def test_blocks_in_few_bits_hold_the_transfer(colours: Workbench) -> None:
    bench, view = colours, colours.view(size=40)
    tiles, coding = bench.renderer.tiles, coding_of(bench, 0.01)
    indices = [each.at for each in seen_chunks(bench.renderer, view, LOOSE, tiles)]
    whole = transfer_chunks(bench.renderer, indices, LOOSE, tiles)
    few = coded_chunks(bench.renderer, indices, LOOSE, coding, tiles)
    expected = blocks_in(b"".join(each.data for each in whole.blocks), len(coding.steps))
    for block, same in zip(few, expected, strict=True):
        assert int.from_bytes(block[14:16], "little") == 2
        bricks, records = (int.from_bytes(block[a : a + 4], "little") for a in (16, 20))
        numbers, words = read_coded(block[32 + 16 * bricks :], records, coding.steps.astype(float))
        known = list(CODES.values())
        np.testing.assert_array_equal(np.isin(words, known), np.isin(same.words, known))
        apart = np.abs(numbers - same.records) - 1e-3 * np.abs(same.records)
        assert (apart <= 1.001 * coding.steps).all() and (apart <= 0.501 * coding.steps).mean() > 0.9, (
            "means are of codes"
        )


def test_normals_in_few_bits_stay_near_and_codes_as_they_are() -> None:
    n = RNG.normal(size=(500, 3))
    n[:6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    grade = np.full(len(n), FINAL, np.uint8)
    words = words_of(n, grade)
    x, y = (coarse((words >> shift & 0xFFFF).astype(np.uint16), words).astype(np.uint32) for shift in (0, 16))
    near = x | y << 16
    cosines = [float(normal_of(int(word)) @ each) for word, each in zip(near, n, strict=True)]
    assert np.degrees(np.arccos(np.clip(min(cosines), -1.0, 1.0))) < 0.3
    assert not np.isin(near, [*CODES.values(), FLAT]).any()
    kept = words_of(np.zeros((3, 3)), np.array([BURIED_GRADE, VOID_GRADE, FINAL], np.uint8))
    for shift in (0, 16):
        part = (kept >> shift & 0xFFFF).astype(np.uint16)
        np.testing.assert_array_equal(coarse(part, kept), part)


@pytest.mark.usefixtures("unfiltered")
@pytest.mark.parametrize("name", ["colours", "irradiance", "constant"])
def test_pictures_of_fine_codes_are_isogis(workbench: Make, name: str) -> None:
    bench = bench_of(workbench, name)
    view = bench.view(size=40)
    framebuffer = draw_coded(bench.renderer, view, coding_of(bench, 1e-4), LOOSE)
    expected = drawn(bench, view)[2]
    if bench.caches.spec("gi").lobes:
        expected = expected + bench.renderer.lobe_radiance(bench.renderer.render(view))
    shown = framebuffer.radiance[bench.renderer.gbuffer(view).pixels]
    np.testing.assert_allclose(shown, expected, atol=2e-3 * expected.mean())


def test_measured_errors_grow_by_what_rounding_adds(colours: Workbench) -> None:
    views = [colours.view(azimuth=azimuth, size=48) for azimuth in (40.0, 43.0)]
    pictures = ControlPictures(colours.renderer, views, 0.2)
    fine, coarse_error = (pictures.measure(coding_of(colours, error)) for error in (1e-3, 0.6))
    assert len(pictures) == 2 and fine.controls == 2 * 256
    assert fine.low < fine.likely < fine.high < coarse_error.low


def test_views_without_a_surface_are_not_measured(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", target_error=LOOSE, projected=False))
    view = bench.view(size=16)
    away = replace(view.camera, target=tuple(2.0 * np.array(view.camera.eye) - view.camera.target))
    assert len(ControlPictures(bench.renderer, [replace(view, camera=away)], 0.5)) == 0
