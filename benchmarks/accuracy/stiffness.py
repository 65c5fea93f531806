"""What ``isogi inspect`` tells of an isosurface's error beside what it errs by, and the fit behind
it.

Each surface is shown in 48 × 48 pixels under constant light, its texels baked to 2 % each: the
error is that of interpolation alone, relative RMSE beside paths from each pixel, less the noise of
both.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import numpy as np
from scipy.optimize import minimize
from scipy.stats import spearmanr

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import shared_data
from benchmarks.common.suite import part
from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.projection import (
    NOISY_ERROR,
    SMOOTH_ERROR,
    STEEP_ERROR,
    Expectation,
    measure_stiffness,
)
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.bench import Bench
from tests.stability.scenes import scene_of, view_of
from tests.stability.volumes import body, ramp

VOLUMES = {
    "avm_337x319x154_uint8": (45, 120),
    "bonsai_256x256x256_uint8": (40, 80, 150),
    "boston_teapot_256x256x178_uint8": (35, 70, 120),
    "brain_t1_124x160x140_uint8": (60, 100),
    "bucky_32x32x32_uint8": (80, 150),
    "carp_256x512x256_uint8": (40, 110),
    "ct_head_208x256x225_uint8": (50, 110),
    "engine_256x256x128_uint8": (40, 70, 170),
    "fuel_crop_64x33x32_uint8": (30, 100),
    "heptane_302x302x302_uint8": (30, 100),
    "hydrogen3d_64x64x64_float32": (0.02, 0.4),
    "isabel_t30_wind_125x125x25_float32": (20, 35),
    "lidc_chest_256x256x133_uint8": (60, 150),
    "mni152_t1_197x233x189_uint8": (40, 90),
    "neghip_66x66x66_uint8": (40, 90, 160),
    "nucleon_41x41x41_uint8": (80, 200),
    "tooth_103x94x161_uint16": (400, 950),
}
"""Isovalues of the shared volumes."""

RAMPS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
NOISES = (0.02, 0.05, 0.1, 0.2)
"""Voxels that the ramps of made volumes are wide, and standard deviations of the noise on the ramp
of 4.
"""

PERCENTILES = (5, 10, 50, 90, 95)
SMALLEST = 0.001
"""Errors below are within the noise of the measurement, and count as this."""


class Surface(NamedTuple):
    """An isosurface by name: what is told of it, and the error that was measured."""

    name: str
    steep: float
    noisy: float
    told: Expectation
    error: float


@part()
@click.option("--only", default="", metavar="TEXT", help="Surfaces whose name has this.")
def stiffness(only: str) -> Measurement:
    """What `isogi inspect` tells of an isosurface's error, beside what it errs by, and the fit
    behind it.
    """
    surfaces = []
    for name, scene in scenes(only):
        surfaces.append(surface_of(name, scene))
        click.echo(told(surfaces[-1]), err=True)
    if len(surfaces) < 3:
        raise click.UsageError(
            f"{len(surfaces)} surfaces with '{only}' in their names are at hand, a fit takes three."
        )
    return Measurement("what is told of surfaces beside what was measured", figures(surfaces))


def scenes(only: str) -> Iterator[tuple[str, Scene]]:
    """The scenes of all surfaces at hand, by name."""
    settings = {"lights": [{"type": "constant"}], "target_error": 0.02}
    data = shared_data()
    for volume, isovalues in VOLUMES.items() if data else ():
        for isovalue in isovalues:
            if only in (name := f"{volume} {isovalue:g}"):
                yield name, load_scene(f"{data}/{volume}.nhdr", **settings, isovalue=isovalue)
    for name, voxels in made():
        if only in name:
            yield name, scene_of(make_volume(voxels, name=name), 0.5, target_error=0.02)


def made() -> Iterator[tuple[str, np.ndarray]]:
    """Made volumes by name: ramps, and noise on one of them."""
    for width in RAMPS:
        yield f"ramp {width:g}", ramp(body(), width)
    for deviation in NOISES:
        voxels = ramp(body(), 4.0)
        noise = np.random.default_rng(1).normal(0.0, deviation, voxels.shape)
        yield f"noise {deviation:g}", voxels + noise.astype(np.float32)


def surface_of(name: str, scene: Scene) -> Surface:
    """A surface, measured."""
    with TemporaryDirectory() as folder:
        bench = Bench(scene, view_of(scene, 48), Path(folder))
        frame = bench.planned.frame()
        error = bench.score(frame.radiance).rmse
        level = scene.volume.normalise_isovalue(scene.isovalue)
        measured = measure_stiffness(PreparedScene(scene).field, [level], bench.tiles.run)
        bench.tiles.close()
    steep, noisy = (float(measured.share(each)[0]) for each in (measured.steep, measured.noisy))
    left = math.sqrt(max(error**2 - frame.noise**2, 0.0))
    return Surface(name, steep, noisy, measured.expectation(0), max(left, SMALLEST))


def figures(surfaces: Sequence[Surface]) -> dict[str, float]:
    """How what is told lies to what was measured, and what a fit to these surfaces would be."""
    error = np.array([each.error for each in surfaces])
    likely = np.array([each.told.likely for each in surfaces])
    inside = [each.told.low <= each.error <= each.told.high for each in surfaces]
    spread = np.percentile(error / likely, PERCENTILES)
    smooth, steep, noisy = fit(surfaces)
    return {
        "surfaces": len(surfaces),
        **{
            f"measured / told, percentile {p}": float(x)
            for p, x in zip(PERCENTILES, spread, strict=True)
        },
        "within the range that is told": float(np.mean(inside)),
        "rank correlation": float(spearmanr(error, likely).statistic),
        **{"fit, smooth": smooth, "fit, all steep": steep, "fit, all noisy": noisy},
    }


def fit(surfaces: Sequence[Surface]) -> tuple[float, float, float]:
    """What surfaces err by that are smooth, and how much more by all steep, all noisy: least Σ
    |log(error / fit)|.
    """
    error = np.array([each.error for each in surfaces])
    shares = np.array([(1.0, each.steep, each.noisy) for each in surfaces])
    start = np.array([SMOOTH_ERROR, STEEP_ERROR, NOISY_ERROR])

    def strays(terms: np.ndarray) -> float:
        return float(np.abs(np.log(error / (shares @ np.abs(terms)))).sum())

    best = minimize(
        strays, start, method="Nelder-Mead", options={"maxiter": 9000, "xatol": 1e-7, "fatol": 1e-7}
    )
    smooth, steep, noisy = np.abs(best.x)
    return float(smooth), float(steep), float(noisy)


def told(surface: Surface) -> str:
    """A surface in a line."""
    low, likely, high = (
        100.0 * each for each in (surface.told.low, surface.told.likely, surface.told.high)
    )
    shares = f"steep {100.0 * surface.steep:.0f} %, noisy {100.0 * surface.noisy:.0f} %"
    return (
        f"{surface.name}: {shares}, told {likely:.2g} % ({low:.2g} to {high:.2g}), is "
        f"{100.0 * surface.error:.2g} %"
    )
