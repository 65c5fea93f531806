"""Smooth edges: what they cost at rest, and how much nearer than plain pixels they are to 256
samples a pixel.

    python -m benchmarks.speed edges [TARGET] [--size 512] [--repeats 9] [--json]

Every camera is new to the renderer, light is final, and both end with a picture of eight bits. The
error is the root mean square over pixels that the surface covers in part, in linear light as the
screen shows it.
"""

import tempfile
from dataclasses import replace
from unittest.mock import patch

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.frame import edges as frame_edges
from isogi_core.frame.film import BACKGROUND, averaged, develop, linear_table
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.shading.edges import find_contrasts
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.view import View
from isogi_report.speed import (
    LOOSEST_GOAL,
    Candidate,
    bake_view,
    make_renderer,
    medians,
    seconds,
    view_of,
)

TRUE = 256
"""Samples of a pixel that counts as true."""

PIECE = 1 << 12
"""Pixels that are sampled so together."""


@part(size=512, repeats=9)
@click.argument("target", required=False)
def edges(target: str | None, size: int, repeats: int) -> Measurement:
    """What smooth edges cost, and how near they are to the true ones."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        plain = view_of(scene, size)
        bake_view(renderer, plain, MIN_SAMPLES)
        smooth = replace(plain, smooth=True)
        took = medians(
            {"plain": pictured(renderer, plain), "smooth": pictured(renderer, smooth)}, repeats
        )
        errors = errors_of(
            renderer.render(plain, LOOSEST_GOAL),
            renderer.render(smooth, LOOSEST_GOAL),
            renderer,
        )
    figures = {**milliseconds(took), "smooth / plain": took["smooth"] / took["plain"], **errors}
    return Measurement(f"{scene.name} at {scene.isovalue:g}, {size} × {size}", figures)


def pictured(renderer: Renderer, view: View) -> Candidate:
    """A picture of a ``view`` from a camera that is new to the renderer."""

    def work(_: int) -> float:
        renderer.forget_views()
        return seconds(
            lambda: develop(
                renderer.render(view, LOOSEST_GOAL), renderer.prepared.scene.default_exposure
            )
        )

    return work


def errors_of(plain: Frame, smooth: Frame, renderer: Renderer) -> dict[str, float]:
    """The errors of both along silhouettes, and their ratio."""
    exposure = renderer.prepared.scene.default_exposure
    found = np.empty(plain.state.shape, np.uint8)
    find_contrasts(develop(plain, exposure), plain.state, found)
    silhouettes = np.flatnonzero(found == frame_edges.SILHOUETTE).astype(np.uint32)
    partly = []
    true = []
    for some in np.split(silhouettes, range(PIECE, len(silhouettes), PIECE)):
        with patch.object(frame_edges, "find_edges", lambda *_, some=some: (some, TRUE)):
            samples = frame_edges.sample_edges(plain, exposure, renderer.tiles)
        if samples is not None:
            cut = (samples.covered[:, 3] > 0.0) & (samples.covered[:, 3] < 1.0)
            partly.append(some[cut])
            true.append(linear_table()[averaged(samples, exposure, BACKGROUND, clear=False)][cut])
    pixels = np.concatenate(partly)
    wanted = np.concatenate(true)
    stairs, soft = (
        float(
            np.sqrt(
                np.mean(
                    (linear_table()[develop(each, exposure).reshape(-1, 3)[pixels]] - wanted) ** 2
                )
            )
        )
        for each in (plain, smooth)
    )
    samples = smooth.edges
    if samples is None:
        share = 0.0
    else:
        share = samples.on.size / smooth.state.size
    return {
        "RMSE, plain": stairs,
        "RMSE, smooth": soft,
        "smooth / plain, RMSE": soft / stairs,
        "samples / pixels": share,
    }
