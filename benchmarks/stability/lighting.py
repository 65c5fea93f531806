"""Lights that are hard on a renderer, and scenes under them."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.stability import shapes
from benchmarks.stability.shapes import body, grid, ramp
from benchmarks.stability.stage import scene_of
from isogi_core.files.radiance import write_hdr
from isogi_core.model.scene import Scene
from isogi_core.model.volume import Volume, make_volume

Light = Mapping[str, Any] | np.ndarray
"""A ``[[lights]]`` table, or the picture (h, w, 3) of a probe."""

SIDE = 12
"""Voxels along each side of the plane's volume."""

HEIGHT = 4.3
"""Where the plane lies, in voxels above the bottom of its box."""

ABOVE = {"azimuth": 40.0, "elevation": 80.0}
"""A stand from which the plane is seen."""


def plane() -> Volume:
    """The field -z: at isovalue -HEIGHT a plane across the whole box, open to the sky."""
    return make_volume(-np.arange(SIDE)[:, None, None] * np.ones((SIDE, SIDE, SIDE)), name="plane")


def ball(side: int = SIDE) -> Volume:
    """The field r - distance from the middle: at isovalue 0 a ball of radius r, a third of the side."""
    return make_volume(-shapes.ball(grid(side, side, side), (0.0, 0.0, 0.0), side / 3.0), name="ball")


def solid(side: int = 16) -> Volume:
    """The field of the body, 1 within, 0 without, and a ramp of 3 voxels between: its skin is at isovalue 0.5."""
    return make_volume(ramp(body(side), 3.0), name="body")


def lit(volume: Volume, isovalue: float, *lights: Light, **settings: Any) -> Scene:
    """A scene of a volume under ``lights``."""
    with TemporaryDirectory() as folder:
        tables = [table_of(light, Path(folder) / f"{n}.hdr") for n, light in enumerate(lights)]
        return scene_of(volume, isovalue, lights=tables, **settings)


def table_of(light: Light, path: Path) -> Mapping[str, Any]:
    """The light as a scene names it; a probe's picture is written to ``path``."""
    if not isinstance(light, np.ndarray):
        return light
    write_hdr(path, light)
    return {"type": "probe", "file": str(path)}


def spot(height: int, width: int, row: int, column: int, radiance: float, around: float = 0.0) -> np.ndarray:
    """A probe of ``around`` everywhere but in one pixel."""
    image = np.full((height, width, 3), around)
    image[row, column] = radiance
    return image


def spot_irradiance(height: int, width: int, row: int, radiance: float) -> float:
    """What a surface with normal +z receives from one pixel above it: L · 2π/w · (sin²θ_bottom - sin²θ_top) / 2."""
    top, bottom = (math.sin(math.pi * edge / height) ** 2 for edge in (row, row + 1))
    return radiance * math.pi / width * (bottom - top)


def probes() -> Iterator[tuple[str, np.ndarray]]:
    """Probes of every hard sort, by what they are."""
    yield "one pixel of 1e6", spot(32, 64, 3, 10, 1e6)
    yield "one pixel of 1e30", spot(32, 64, 3, 10, 1e30)
    yield "one pixel of 1e30 beside 1e-30", spot(32, 64, 3, 10, 1e30, 1e-30)
    yield "one pixel below the plane", spot(32, 64, 30, 10, 1e6)
    yield "all black", np.zeros((8, 16, 3))
    yield "all 1e-30", np.full((8, 16, 3), 1e-30)
    yield "all 1e30", np.full((8, 16, 3), 1e30)
    yield "a single pixel", np.ones((1, 1, 3))
    yield "two pixels", spot(2, 1, 0, 0, 2.0)
    yield "one column", spot(64, 1, 3, 0, 10.0)
    yield "one row", spot(1, 64, 0, 3, 10.0)
    yield "red alone", np.ones((4, 8, 3)) * (1e6, 0.0, 0.0)


def skies() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Skies at the ends of their ranges."""
    for elevation in (0.0, 90.0):
        for turbidity in (1.9, 10.0):
            sun = {"sun_elevation": elevation, "turbidity": turbidity}
            yield f"sun at {elevation:g}°, turbidity {turbidity:g}", {"type": "sky", **sun}


def lamps() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Lamps inside the plane's solid, on it, just over it and far away; large, small and dark ones."""
    middle = (SIDE - 1) / 2.0
    for name, z in (("inside", 2.0), ("on the surface", HEIGHT), ("touching", HEIGHT + 0.3), ("far", 1e6 * SIDE)):
        for intensity in (0.0, 1.0, 1e30):
            place = {"position": [middle, middle, z], "intensity": intensity}
            yield f"{name}, intensity {intensity:g}", {"type": "point", **place}
    for size, z in ((4.0, HEIGHT), (4.0, 2.0), (1e9, 1e9), (1e-12, 8.0)):
        edges = {"corner": [middle, middle, z], "u": [0.0, size, 0.0], "v": [size, 0.0, 0.0]}
        yield f"of side {size:g} at {z:g}", {"type": "area", **edges}
    for angle in (0.0, 90.0):
        for irradiance in (0.0, 1e30):
            sun = {"angle": angle, "irradiance": irradiance}
            yield f"{angle:g}° wide, irradiance {irradiance:g}", {"type": "directional", **sun}
