"""Cases of extreme light: too much of it, none, all from one point, or from inside what it lights."""

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.lighting import (
    ABOVE,
    HEIGHT,
    SIDE,
    Light,
    lamps,
    lit,
    plane,
    probes,
    skies,
    solid,
    spot,
    spot_irradiance,
)
from benchmarks.stability.pictures import faults, surface_light
from benchmarks.stability.stage import CONSTANT, frame_of, view_bake, view_of
from isogi_core.model.plan import FEWEST
from isogi_core.model.scene import Scene
from isogi_core.model.sky import LUMINANCE

GROUP = "extreme light"

SHADINGS = ("gi", "path_traced", "vicinity", "lambert_shadow", "phong")


@case(GROUP, "finite frames", "every number of every frame is finite, and its error is from 0 to 1", 0, "numbers")
def finite_frames(size: Size) -> Outcome:
    """A plane under every hard light, still and turning where it may, by models that treat light differently."""
    wrong, frames = 0, 0
    for light, rotating in list(hard_lights())[:: size.pick(3, 1)]:
        scene = lit(plane(), -HEIGHT, light, rotating=rotating, target_error=0.1)
        for shading in SHADINGS[: size.pick(2, 5)]:
            wrong += faults(frame_of(scene, view_of(scene, size.pick(6, 24), shading=shading, **ABOVE)))
            frames += 1
    return Outcome(wrong, f"of {frames} frames")


def hard_lights() -> Iterator[tuple[Light, bool]]:
    """Every hard light, and whether it may turn: what is all around does both."""
    around: list[tuple[str, Light]] = [*probes(), *skies()]
    for _, light in around:
        yield light, False
        yield light, True
    for _, lamp in lamps():
        yield lamp, False


@case(GROUP, "light that stays", "one pixel of 1e6 lights an open plane by the cosine law", 0.01, "relative")
def cosine_law(size: Size) -> Outcome:
    """Baked as irradiance, and path-traced."""
    worst = max(spot_error(row, shading, False, size) for row in (2, 8, 14) for shading in SHADINGS[:2])
    return Outcome(worst, "14° to 82° from the normal")


@case(GROUP, "light that turns", "harmonics of one such pixel light an open plane by the cosine law", 0.06, "relative")
def cosine_law_of_harmonics(size: Size) -> Outcome:
    """Baked as transfer of order 6, which leaves 13/256 of a cosine lobe's height, and less, to the next harmonics."""
    worst = max(spot_error(row, "gi", True, size) for row in (2, 8, 11))
    return Outcome(worst, "14° to 65° from the normal")


def spot_error(row: int, shading: str, rotating: bool, size: Size) -> float:
    """How far the plane's mean radiance under one pixel is from albedo · E / π."""
    scene = lit(plane(), -HEIGHT, spot(32, 64, row, 10, 1e6), rotating=rotating, lobes=0)
    view = view_of(scene, size.pick(8, 24), shading=shading, **ABOVE, **samples_of(shading, size))
    right = scene.albedo[0] * spot_irradiance(32, 64, row, 1e6) / math.pi
    return abs(float(surface_light(frame_of(scene, view)).mean()) / right - 1.0)


def samples_of(shading: str, size: Size) -> dict[str, int]:
    """Paths for each pixel of a view that asks for them."""
    return {"samples": size.pick(64, 256)} if shading == "path_traced" else {}


@case(GROUP, "any strength", "light of 2^100 and of 2^-100 makes the frame of light of 1, bit for bit", 0, "relative")
def any_strength(size: Size) -> Outcome:
    """Half a sky of each radiance; after as many samples, the strength divided out."""
    usual, *others = (strong_frame(strength, size) for strength in (1.0, 2.0**-100, 2.0**-20, 2.0**20, 2.0**100))
    return Outcome(max(float(np.abs(other - usual).max()) for other in others), "light and told error")


def strong_frame(strength: float, size: Size) -> np.ndarray:
    """Light over its strength, and told error, of the body under a half sky of some radiance; (h, w, 4)."""
    half = np.zeros((8, 16, 3))
    half[:4] = strength
    scene = lit(solid(), 0.5, half)
    frame = frame_of(scene, view_of(scene, size.pick(12, 48)), 64)
    return np.concatenate([frame.radiance / strength, frame.error[..., None]], axis=-1)


@case(GROUP, "no light", "frames are black and final after the fewest samples, and baking ends", FEWEST, "samples")
def no_light(size: Size) -> Outcome:
    """Black probe, constant and lamps; a frame that is not black or not final counts as endless."""
    dark: list[Light] = [np.zeros((8, 16, 3)), {**CONSTANT, "radiance": 0.0}, {"type": "sky", "scale": 0.0}]
    dark += [lamp for name, lamp in lamps() if name.endswith((" 0", "irradiance 0"))]
    return Outcome(
        max(samples_in_the_dark(lit(plane(), -HEIGHT, light), size) for light in dark), f"{len(dark)} lights"
    )


def samples_in_the_dark(scene: Scene, size: Size) -> float:
    """The most samples that a texel takes until the frame is final; infinite where it is not, or not black."""
    view = view_of(scene, size.pick(8, 32), **ABOVE)
    with view_bake(scene, view) as bake:
        bake.grow(scene.plan.samples, scene.target_error)
        bake.frame()
        frame = bake.renderer.render(view)
    done = not frame.provisional and not frame.radiance.any() and frame.estimated_error == 0.0
    return float(bake.light.samples.max()) if done else math.inf


@case(
    GROUP,
    "ringing",
    "no pixel is negative where harmonics ring below zero, and what is kept of them is not cut",
    0,
    "pixels",
)
def ringing(size: Size) -> Outcome:
    """One bright pixel turned to the back of a body, in harmonics: their sum falls below zero in the shade."""
    scene = lit(solid(24), 0.5, spot(32, 64, 16, 40, 1e6), rotating=True, lobes=0, target_error=0.1)
    view = view_of(scene, size.pick(24, 96))
    with view_bake(scene, view) as bake:
        bake.grow(FEWEST)
        radiance = bake.frame().radiance
    rung = (bake.light.transfer @ bake.look.luminance_light.T)[~bake.light.void] < 0.0
    if not rung.any():
        return Outcome(math.inf, "nothing rings: the transfer was cut")
    return Outcome(int((radiance < 0.0).any(axis=-1).sum()), f"{rung.mean():.0%} of the texels ring below zero")


@case(GROUP, "point lamp", "a plane far below a lamp receives I / r²", 0.001, "relative")
def point_lamp(size: Size) -> Outcome:
    """From 1e2 to 1e6 boxes away."""
    return Outcome(max(lamp_error(boxes * SIDE, size) for boxes in (1e2, 1e4, 1e6)), "1e2 to 1e6 boxes away")


@case(
    GROUP,
    "near lamp",
    "a plane 4 voxels below a lamp receives I / r²",
    0.2,
    "relative",
    known="Light is gathered where rays start, 0.3 voxel above the surface: a lamp at r voxels counts as r - 0.3 away.",
)
def near_lamp(size: Size) -> Outcome:
    """At the middle of the plane."""
    return Outcome(lamp_error(4.0, size), "0.3 of 4 voxels nearer")


def lamp_error(distance: float, size: Size) -> float:
    """How far the radiance right below a lamp of intensity r² is from albedo / π."""
    middle = (SIDE - 1) / 2.0
    place = {"position": [middle, middle, HEIGHT + distance], "intensity": distance**2}
    scene = lit(plane(), -HEIGHT, {"type": "point", **place})
    frame = frame_of(scene, view_of(scene, 2 * size.pick(5, 20) + 1, **ABOVE))
    across = np.where(frame.state > 0, np.linalg.norm(frame.position[..., :2] - middle, axis=-1), math.inf)
    below = np.unravel_index(across.argmin(), across.shape)
    return abs(float(frame.radiance[below] @ LUMINANCE) * math.pi / scene.albedo[0] - 1.0)
