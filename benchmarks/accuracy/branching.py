"""In how many ways paths should go on from the first surface that they hit: error against time.

    python -m benchmarks.accuracy branching [TARGET] [--size 512] [--only engine] [--json]

Texels from all over a view are baked level by level until they are final, in tasks as workers have
them, on one thread, with 1, 2, 4 and 8 branches. Times are over those of single paths: until all
texels are final, and until the error is what single paths end with, between levels by a power of
time. Errors are estimated ones, root mean squares over the texels.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.common.measurement import Figures, Measurement, markdown, shown
from benchmarks.common.scenes import Subject, scene_of
from benchmarks.common.suite import part
from benchmarks.speed.paths import view_texels
from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.noise import Goal, relative_error
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, next_level
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene

BRANCHES = (1, 2, 4, 8)

SUBJECTS = (
    *(
        Subject("engine", 70, "grace"),
        Subject("CT head", 110, "grace"),
        Subject("MNI brain", 90, "grace"),
    ),
    *(
        Subject("chest CT", 60, "grace"),
        Subject("carp", 110, "noon_grass"),
        Subject("engine", 170, "uffizi"),
    ),
)

Curve = list[tuple[float, float]]
"""Seconds, and the error after them, level by level."""


@part(size=512)
@click.argument("target", required=False)
@click.option(
    "--only", multiple=True, help="Measure only scenes with this in their names; may be repeated."
)
def branching(target: str | None, size: int, only: tuple[str, ...]) -> Measurement:
    """In how many ways paths should go on from the first surface that they hit."""
    figures: dict[str, Figures] = {
        name: measured(scene, size) for name, scene in scenes_of(target, only)
    }
    head = ("scene", *next(iter(figures.values())))
    text = markdown(head, ((name, *map(shown, own.values())) for name, own in figures.items()))
    flat = {
        f"{name}: {what}": value for name, own in figures.items() for what, value in own.items()
    }
    return Measurement("Paths that branch", flat, text)


def scenes_of(target: str | None, only: tuple[str, ...]) -> Iterator[tuple[str, Scene]]:
    """The scene ``target``, or those of the SUBJECTS that are wanted, with their names."""
    if target is not None:
        yield target, load_scene(target)
        return
    for subject in SUBJECTS:
        if wanted(subject.name, only):
            yield subject.name, scene_of(subject, bounces=4)


def measured(scene: Scene, size: int) -> Figures:
    """Times and errors of a scene's texels by the branches of their paths."""
    tasks = view_texels(scene, size)
    curves = {branches: curve_of(scene, branches, tasks) for branches in BRANCHES}
    time_alone, error_alone = curves[1][-1]
    found: dict[str, float | int] = {"planned": scene.plan.branches, "single, error": error_alone}
    for branches in BRANCHES[1:]:
        seconds, error = curves[branches][-1]
        found[f"{branches}: time until final"] = seconds / time_alone
        found[f"{branches}: error then"] = error / error_alone
        found[f"{branches}: time to equal error"] = (
            seconds_to(error_alone, curves[branches]) / time_alone
        )
    return found


def curve_of(scene: Scene, branches: int, tasks: list[np.ndarray]) -> Curve:
    """How the error of the texels of ``tasks`` falls with time, where paths have so many
    ``branches``.
    """
    spec = spec_for(
        PreparedScene(replace(scene, plan=replace(scene.plan, branches=branches))), "gi"
    )
    goal = Goal(scene.target_error)
    for texels in tasks:  # maps are made, and kernels loaded
        refine(Light.dark(spec.plan, len(texels)), texels, spec, FIRST_LEVEL, goal)
    lights = [Light.dark(spec.plan, len(texels)) for texels in tasks]
    seconds = 0.0
    curve = Curve()
    level = 0
    while level < scene.plan.samples:
        level = next_level(level)
        begun = time.process_time()
        for light, texels in zip(lights, tasks, strict=True):
            refine(light, texels, spec, level, goal)
        seconds += time.process_time() - begun
        errors = np.concatenate([relative_error(light, spec)[~light.void] for light in lights])
        curve.append((seconds, float(np.sqrt(np.mean(errors**2)))))
    return curve


def seconds_to(error: float, curve: Curve) -> float:
    """When a curve comes to an ``error``: between two levels as if it fell with a power of time."""
    seconds, errors = np.log(curve).T
    if curve[-1][1] <= error:
        return float(np.exp(np.interp(-np.log(error), -errors, seconds)))
    return math.inf
