"""Noise taken out of transfer: how much there is of it, and that filtering brings numbers nearer to the truth."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from isogi_core.bake.noise import Until
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.frame.card.chunk_light import calm_numbers, raw_numbers
from isogi_core.frame.card.filtered_transfer import number_noise
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.plan.scene import Scene
from tests.frame.conftest import SKY, Workbench, refine_chunk
from tests.loaded import load_scene

Make = Callable[[Scene], Workbench]
TARGET = 0.02


class Numbers(NamedTuple):
    """What a view's texels hold: as baked, filtered, the variance of the first, and how far they are baked."""

    raw: np.ndarray
    calm: np.ndarray
    noise: np.ndarray
    reading: Reading


def numbers_at(bench: Workbench, samples: int) -> Numbers:
    """The numbers of a view's texels once they have so many samples."""
    view, loader, tiles = bench.view(size=48), bench.caches.of("gi"), bench.renderer.tiles
    frame = bench.renderer.render(view, 1e-3, enough=samples)
    for demand in frame.demands:
        refine_chunk(loader, samples, 1e-3, demand)
    texels = bench.renderer.texels(view, bench.renderer.gbuffer(view))
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        reading = read_texels(texels, held.slots, loader.pool, Until(TARGET, FIRST_LEVEL), tiles)
        raw = raw_numbers(reading.rows, loader.pool)
        calm = calm_numbers(bench.renderer, texels, reading, loader.pool, tiles)[1]
        scatter = np.where(reading.rows >= 0, loader.pool.scatter[reading.rows], np.float32(0.0))
    return Numbers(raw, calm, number_noise(raw, scatter, loader.pool.spec), reading)


@pytest.fixture
def rungs(workbench: Make) -> tuple[Numbers, Numbers]:
    """A rough bake and one that stands for the truth."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2, target_error=TARGET, projected=False))
    return numbers_at(bench, FIRST_LEVEL), numbers_at(bench, 32 * FIRST_LEVEL)


def test_filtered_transfer_is_nearer_to_the_truth(rungs: tuple[Numbers, Numbers]) -> None:
    rough, truth = rungs
    noisy = rough.reading.noisy
    assert noisy.mean() > 0.8 and truth.reading.samples[noisy].min() >= 8 * FIRST_LEVEL
    before, after = (np.sqrt(((each - truth.raw)[noisy] ** 2).mean()) for each in (rough.raw, rough.calm))
    assert after < 0.8 * before
    np.testing.assert_array_equal(rough.calm[~noisy], rough.raw[~noisy])


def test_the_noise_of_numbers_is_about_what_it_is_taken_for(rungs: tuple[Numbers, Numbers]) -> None:
    rough, truth = rungs
    noisy = rough.reading.noisy
    wrong = ((rough.raw - truth.raw)[noisy] ** 2).mean()
    assert 0.25 < rough.noise[noisy].mean() / wrong < 4.0
