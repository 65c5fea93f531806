"""The error estimate: its parts, its calibration against a long bake, how paths scatter, and what
is left to do.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec, band_of, spec_for, square_light
from isogi_core.bake.noise import (
    Effort,
    Goal,
    blend_noise,
    deviation,
    deviations,
    efforts,
    evenness,
    expected_samples,
    finished,
    good_enough,
    mean_luminance,
    noise_of_halves,
    path_deviation,
    relative_error,
    samples_left,
    samples_needed,
)
from isogi_core.bake.texel_light import VOID, Light, Part
from isogi_core.kernels.shading.lattice import LIGHT_NUMBERS, light_texels
from isogi_core.model.scene_plan import Layer, most_samples
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import (
    baked,
    climbed,
    orbital,
    plan_of,
    rotations_of,
    spec_of,
    surface_texels,
)
from tests.kernels.transport.harmonic_bases import basis
from tests.loaded import load_scene
from tests.scale import COMPILED

FACTOR = np.sqrt(4.0 * np.pi)

LEAST_SPREAD = 0.2
"""Least variance of a path over its second moment."""


def light_of(spec: BakeSpec, samples: list[list[int]], noise: float = 0.02, seed: int = 1) -> Light:
    """Light with these samples, a list for each part, and noise and coefficients at random."""
    rng = np.random.default_rng(seed)
    light = Light.dark(spec.plan, len(samples[0]))
    for part, own in zip(light.parts, samples, strict=True):
        part.samples[:] = own
        part.noise[:] = noise * (0.5 + rng.random(part.noise.shape))
        part.coefficients[:] = 0.1 * rng.normal(size=part.coefficients.shape)
        part.coefficients[:, :, 0] = (0.4 + 0.1 * rng.random()) / FACTOR
    return light


# --- the error of a texel
# -----------------------------------------------------------------------------------------


def test_luminance_is_a_mean_over_rotations_of_the_light() -> None:
    spec = orbital((0.3, 0.6, 0.9))
    light = light_of(spec, [[64] * 20, [64] * 20])
    lights = rotations_of(spec.luminance_light, 3000)
    seen = np.einsum(
        "mcn,tcn->m", np.broadcast_to(light.transfer, (20, 3, spec.order**2)), lights
    ) / len(lights)
    np.testing.assert_allclose(mean_luminance(light, spec), seen, rtol=0.05)


def test_error_is_relative_to_the_texels_own_light() -> None:
    spec = orbital(0.5, sky=False)
    light = light_of(spec, [[64] * 3])
    (part,) = light.parts
    part.coefficients[:, 0, 0] = np.array([1.0, 0.8, 0.01]) / FACTOR
    part.noise[:] = 0.02 / FACTOR
    bright, less, dark = relative_error(light, spec)
    assert [bright, less] == pytest.approx([0.02, 0.02 / 0.8], rel=1e-5)
    assert 0.4 < 0.02 / dark < 0.6, "that of dark texels is relative to half of the open light"


def test_errors_of_the_parts_are_independent() -> None:
    spec = orbital()
    light = light_of(spec, [[64] * 8, [64] * 8])
    direct, indirect = (deviation(part, spec) for part in light.parts)
    np.testing.assert_array_equal(deviations(light, spec), [direct, indirect])
    level = mean_luminance(light, spec)
    np.testing.assert_allclose(relative_error(light, spec), np.hypot(direct, indirect) / level)


def test_no_light_has_no_error() -> None:
    dark = load_scene("demo:orbital", lights=[{"type": "constant", "radiance": 0.0}])
    spec = spec_for(PreparedScene(dark), "gi")
    assert relative_error(light_of(spec, [[64] * 2]), spec).tolist() == [0.0, 0.0]


# --- when a texel is done, and what is next
# -------------------------------------------------------------------------


def test_the_strictest_goal_covers_all_and_none_covers_it() -> None:
    goals = [Goal(0.1, 16), Goal(0.02, 64), Goal(0.05)]
    strictest = Goal.strictest(goals)
    assert strictest == Goal(0.02)
    assert all(strictest.covers(each) and each.covers(each) for each in goals)
    assert not any(each.covers(strictest) for each in goals)


def test_a_texel_is_done_when_good_enough_spent_or_void() -> None:
    spec = orbital(sky=False)
    light = light_of(spec, [[64, 64, most_samples(0.01), VOID, 0]], noise=1.0)
    light.parts[0].noise[1] = 0.0
    assert finished(light, spec, Goal(0.01)).tolist() == [False, True, True, True, False]
    light.parts[0].noise[:] = 0.0
    assert finished(light, spec, Goal(0.01)).tolist() == [True, True, True, True, False], (
        "unlit is never done"
    )
    light.parts[0].samples[0] = 32
    assert not finished(light, spec, Goal(0.01))[0], "few paths that all died say nothing"


def test_all_parts_must_have_the_fewest_samples() -> None:
    most = most_samples(0.5)
    light = light_of(
        orbital(),
        [[64, 64, 32, most], [0, 64, 64, most]],
        noise=0.0,
    )
    assert finished(light, orbital(), Goal(0.5)).tolist() == [False, True, False, True]


def test_the_frame_and_the_bake_agree_on_final_light() -> None:
    """The frame judges errors that were rounded to single floats."""
    goal = Goal(0.02)
    errors = goal.texel_error * (1.0 + np.linspace(-1e-8, 1e-8, 201))
    samples = np.full(201, 64)
    final = good_enough(errors, samples, goal)
    assert 0 < final.sum() < 201
    assert good_enough(errors.astype(np.float32), samples, goal)[final].all()


# --- noise estimated from halves
# ------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 5])
def test_noise_is_half_the_difference_pooled_over_bands(order: int) -> None:
    """A twin in loops: band 0 with a quarter of its neighbour; above it the mean of the bands' mean
    squares.
    """
    projected = max(order, 2)
    samples = 32
    halves = np.random.default_rng(5).normal(size=(6, 2, projected**2))
    means = halves / (samples / 2)
    noise = noise_of_halves(halves, samples, order)
    assert noise.shape == (6, 1 if order == 1 else 2)
    for texel, estimated in zip(means, noise, strict=True):
        squares = [((a - b) / 2) ** 2 for a, b in texel.T]
        assert estimated[0] == pytest.approx(
            np.sqrt(0.75 * squares[0] + 0.25 * np.mean(squares[1:4]))
        )
        if order > 1:
            bands = [
                np.mean([squares[i] for i in np.flatnonzero(band_of(order) == l)])
                for l in range(1, order)
            ]
            assert estimated[1] == pytest.approx(np.sqrt(np.mean(bands)))


def test_noise_of_halves_is_the_standard_error_of_their_mean() -> None:
    """Halves of noise whose size is known: on average the estimate is that of all samples
    together.
    """
    samples = 64
    sigma = 0.3
    sums = np.random.default_rng(6).normal(size=(4000, 2, 25)) * sigma * np.sqrt(samples / 2)
    estimated = np.sqrt((noise_of_halves(sums, samples, 5) ** 2).mean(axis=0))
    np.testing.assert_allclose(estimated, sigma / np.sqrt(samples), rtol=0.03)


def test_pooled_noise_falls_as_stratified_points_do() -> None:
    former = np.array([[0.1, 0.3]], np.float32)
    latest = np.array([[0.2, 0.4]])
    decay = 0.4, 0.25
    low = 0.4 * 0.025
    high = 0.4 * 0.025 + 0.25 * (0.125 - 0.025)
    np.testing.assert_allclose(
        blend_noise(former, 64, latest, decay), np.sqrt([[low, high]]), rtol=1e-6
    )
    assert blend_noise(np.zeros((1, 2), np.float32), 0, latest, decay) is latest
    quiet = np.array([[0.2, 0.1]])
    np.testing.assert_allclose(blend_noise(quiet, 16, quiet, decay), np.sqrt(0.4) * quiet)


# --- calibration
# --------------------------------------------------------------------------------------------------


@COMPILED
def test_error_falls_as_samples_are_added() -> None:
    spec = orbital()
    texels = surface_texels(spec, 60)
    errors = [
        np.sqrt((relative_error(climbed(spec, texels, n), spec) ** 2).mean())
        for n in (16, 128, 1024)
    ]
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.5 * errors[1]


def wrongness(part: Part, reference: Part, spec: BakeSpec, count: int = 24) -> np.ndarray:
    """Errors of the luminance of each texel against a reference under turned lights, (texels,
    turns).
    """
    own = spec.term_of(part.layer).luminance
    n = min(part.layer.order**2, own.shape[1])
    if spec.order > 1:
        lights = rotations_of(own, count)[:, :, :n]
    else:
        lights = own[None]
    if part.layer.channels != lights.shape[1]:
        lights = lights.sum(axis=1, keepdims=True)
    return np.einsum(
        "mcn,tcn->mt", part.coefficients.astype(float) - reference.coefficients, lights
    )


def level_of(light: Light, spec: BakeSpec) -> np.ndarray:
    """The luminance that errors of texels are relative to: their own, unless they are dark."""
    loud = light.rows(np.arange(len(light)))
    for part in loud.parts:
        part.noise[:] = 1.0
    return np.sqrt((deviations(loud, spec) ** 2).sum(axis=0)) / relative_error(loud, spec)


LOOKS = {
    "grey": {},
    "beside a lobe": {"lobes": 1},
    "coloured": {"albedo": (0.9, 0.6, 0.3)},
    "indirect at a lower order": {"indirect_order": 3},
    "constant": {"sky": False},
    "vicinity": {"sky": False, "shading": "vicinity"},
}


@cache
def referred(name: str) -> tuple[BakeSpec, np.ndarray, Light]:
    """One of LOOKS, 160 texels of the orbital, and their light after 8192 samples."""
    spec = orbital(**LOOKS[name])  # type: ignore[arg-type]
    texels = surface_texels(spec, 160)
    assert len(texels) == 160
    return spec, texels, climbed(spec, texels, 8192)


@pytest.mark.slow
@COMPILED
@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("samples", [64, 256])
def test_the_estimate_is_calibrated(name: str, samples: int) -> None:
    """What each layer is wrong by is what it says."""
    spec, texels, reference = referred(name)
    for part, exact in zip(climbed(spec, texels, samples).parts, reference.parts, strict=True):
        seen = np.sqrt((wrongness(part, exact, spec) ** 2).mean())
        estimated = np.sqrt((deviation(part, spec) ** 2).mean())
        assert 0.75 < seen / estimated < 1.33, (part.layer.kind, seen / estimated)


@pytest.mark.slow
@COMPILED
@pytest.mark.parametrize("name", LOOKS)
def test_final_texels_are_within_their_error(name: str) -> None:
    """Those that stop early are those whose halves agreed by chance: the estimate is too low, but
    not by much.
    """
    (spec, texels, reference) = referred(name)
    target = 0.02
    light = baked(spec, texels, most_samples(target), target=target)
    parts = zip(light.parts, reference.parts, strict=True)
    wrong = sum(wrongness(part, exact, spec) for part, exact in parts)
    level = level_of(reference, spec)
    seen = np.sqrt(((wrong / level[:, None]) ** 2).mean())
    estimated = np.sqrt((relative_error(light, spec) ** 2).mean())
    assert finished(light, spec, Goal(target)).all()
    assert 0.75 < seen / estimated < 1.33, seen / estimated


# --- how paths scatter
# ------------------------------------------------------------------------------------------------


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same for each test."""
    return np.random.default_rng(12)


def ways(rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions with a cosine about z, of paths that leave; (count, 3)."""
    u, v = rng.random((2, count))
    radius = np.sqrt(u)
    angle = 2.0 * math.pi * v
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u)], axis=-1)


@pytest.mark.parametrize("order", [1, 2, 6])
def test_a_squared_light_is_its_squared_radiance(order: int, rng: np.random.Generator) -> None:
    """Against a fine grid: equal steps in z and in azimuth."""
    light = rng.normal(size=order**2)
    z = (np.arange(400) + 0.5) / 200.0 - 1.0
    angle = 2.0 * math.pi * (np.arange(64) + 0.5) / 64
    side = np.sqrt(1.0 - z**2)[:, None]
    grid = np.stack(
        np.broadcast_arrays(side * np.cos(angle), side * np.sin(angle), z[:, None]), axis=-1
    )
    values = basis(order, grid.reshape(-1, 3))
    expected = (values @ light) ** 2 @ values * 4.0 * math.pi / len(values)
    np.testing.assert_allclose(square_light(light), expected, rtol=2e-3, atol=2e-3)


def test_a_texels_spread_is_that_of_its_paths_light(rng: np.random.Generator) -> None:
    """Light of two bands, whose square has three and is wholly known; a third of the paths bring
    nothing.
    """
    light = np.pad(rng.normal(size=(3, 4)), ((0, 0), (0, 5)))
    colour = np.array([0.2126, 0.7152, 0.0722])
    square = square_light(colour @ light)
    values = basis(3, ways(rng, 3000)) * (rng.random((3000, 1)) < 2 / 3)
    transfer = np.float32(values.mean(axis=0))[None, None]
    lit = np.empty((1, LIGHT_NUMBERS), np.float32)
    args = (np.float32(light), np.float32(square), np.zeros(1, np.int32), 9, lit)
    light_texels(np.zeros(1, np.int32), transfer, np.full(1, 0.1, np.float32), *args)
    variance = (values @ (colour @ light)).var()
    least = LEAST_SPREAD * transfer[0, 0, 0] * square[0]
    assert lit[0, 3] == pytest.approx(0.1 * math.sqrt(variance + least), rel=1e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_deviation_of_paths_is_a_mean_over_rotations(
    channels: int, rng: np.random.Generator
) -> None:
    spec = spec_of(plan_of(Layer("direct", 4, channels)))
    light = Light.dark(spec.plan, 6)
    fading = 0.3 ** band_of(4)
    light.parts[0].coefficients[:] = 0.02 * rng.normal(size=(6, channels, 16)) * fading
    light.parts[0].coefficients[:, :, 0] = 0.2
    lights = rotations_of(spec.luminance_light, 3000)
    estimated = path_deviation(light, spec)
    second = np.array([square_light(one.sum(axis=0)) for one in lights[:300]])
    seen = light.transfer[:, channels // 2] @ second.mean(axis=0)
    mean = np.einsum("mcn,tcn->mt", light.transfer, lights)
    expected = seen - (mean**2).mean(axis=1) + LEAST_SPREAD * 0.2 * second[0, 0]
    np.testing.assert_allclose(estimated**2, expected, rtol=0.05)


def test_the_deviation_under_two_lights_is_a_mean_over_both(rng: np.random.Generator) -> None:
    """Direct light of order 4 beside a lobe, and reflected light of order 3 with it."""
    spec = spec_of(replace(plan_of(Layer("direct", 4), Layer("indirect", 3)), lobes=1))
    assert len(spec.terms) == 2 and not np.allclose(spec.terms[0].light[:, :9], spec.terms[1].light)
    light = Light.dark(spec.plan, 6)
    unit = spec.unit
    for part, mean in zip(light.parts, (0.2, 0.05), strict=True):
        part.coefficients[:] = (
            0.1 * mean * rng.normal(size=part.coefficients.shape) * 0.3 ** band_of(part.layer.order)
        )
        part.coefficients[:, :, 0] = mean
    both = np.zeros((2, 16))
    for row, term in zip(both, spec.terms, strict=True):
        row[: term.order**2] = term.luminance.sum(axis=0) / unit
    turns = rotations_of(both, 3000)
    mean = sum(
        light.columns([term])[:, 0] @ turns[:, i, : term.order**2].T
        for i, term in enumerate(spec.terms)
    )
    second = sum(
        part.coefficients[:, 0, 0] * term.square[0]
        for part, term in zip(light.parts, spec.terms, strict=True)
    )
    expected = np.maximum(second - (mean**2).mean(axis=1), 0.0) + LEAST_SPREAD * second
    np.testing.assert_allclose((path_deviation(light, spec) / unit) ** 2, expected, rtol=0.05)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_band_0_varies_less_where_paths_bring_equal_light(
    share: float, rng: np.random.Generator
) -> None:
    """Against the variances of paths that were drawn, of which a ``share`` brings light."""
    count = 100_000
    values = basis(2, ways(rng, count)) * (rng.random((count, 1)) < share)
    second = np.array([values[:, 0].mean()])
    variances = values.var(axis=0)
    estimated = evenness(values.mean(axis=0)[None], second, count)
    assert estimated[0] == pytest.approx(variances[0] / variances[1:].mean(), rel=0.02, abs=1e-4)


# --- efforts
# --------------------------------------------------------------------------------------------------


GOAL = Goal(0.05)
ERRORS = GOAL.texel_error


def test_samples_follow_the_rate_of_errors_up_to_a_level() -> None:
    error = ERRORS * np.array([4.0, 2.0, 1.02, 60.0, 0.2])
    samples = np.array([64, 64, 64, 64, 16])
    goals = [512, 256, 128, GOAL.most_samples, 64]  # 64 · 4^1.5 = 512, 64 · 2^1.5 = 181
    assert (samples + samples_left(error, samples, GOAL)).tolist() == goals


def test_texels_at_the_rate_take_the_predicted_samples() -> None:
    rng = np.random.default_rng(5)
    scale = rng.uniform(0.5, 5.0, 1000)
    samples = np.full(1000, 64)
    predicted = samples + samples_left(scale * samples ** (-2 / 3), samples, GOAL)
    while not (done := good_enough(scale * samples ** (-2 / 3), samples, GOAL)).all():
        samples = np.where(done, samples, 2 * samples)
    np.testing.assert_array_equal(samples[predicted > 128], predicted[predicted > 128])


def test_efforts_are_summed_chunk_by_chunk() -> None:
    rng = np.random.default_rng(6)
    samples = rng.choice([VOID, 0, 16, 64, 256, 2048], 400)
    error = rng.uniform(0.0, 0.3, 400)
    chunks = rng.integers(0, 5, 400)
    found = efforts(chunks, 6, error, samples, GOAL)
    for chunk in range(6):
        own = [(e, n) for e, n, at in zip(error, samples, chunks, strict=True) if at == chunk]
        lit = [(e, n) for e, n in own if n > 0 and not good_enough(np.array(e), np.array(n), GOAL)]
        left = sum(float(samples_left(np.array([e]), np.array([n]), GOAL)[0]) for e, n in lit)
        expected = sum(n == 0 for _, n in own), sum(n for _, n in lit), left, 0.0, len(lit)
        assert found[chunk].tolist() == pytest.approx(expected)
        mine = chunks == chunk
        assert Effort.of(error[mine], samples[mine], GOAL) == pytest.approx(expected)


def test_unlit_texels_are_expected_to_need_what_others_do() -> None:
    """What the unlit ones among the others would need is the mean of the chunk's lit ones."""
    samples = np.array([64, 64, 0, 0, 16])
    chunks = np.array([0, 0, 0, 1, 3])
    error = ERRORS * np.array([4.0, 2.0, 180.0, 180.0, 0.2])
    first, second, last = samples_needed(error[[0, 1, 4]], samples[[0, 1, 4]], GOAL)
    assert (first, second, last) == (512, 256, 64)
    assert expected_samples(chunks, 4, error, samples, GOAL).tolist() == [
        1.5 * (512 + 256),
        0.0,
        0.0,
        64,
    ]
