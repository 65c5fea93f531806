"""Scenes of hard volumes under hard lights, what renders them with light baked here, and rays at
their surfaces.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.active_cells import ActiveCells, block_ranges, make_active_cells
from isogi_core.kernels.tracing.cast import cast_batch, cast_one_by_one
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue, Volume, make_volume
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene, make_field
from isogi_report.bench import ViewBake
from isogi_report.metrics import luminance_of
from tests.loaded import load_scene
from tests.stability.volumes import Specimen, ball, body, grid, ramp

CONSTANT: Mapping[str, Any] = {"type": "constant"}
STAND = {"azimuth": 40.0, "elevation": 30.0, "distance": 2.4, "fov": 30.0}
"""The camera of a view unless another is given."""

ABOVE = {"azimuth": 40.0, "elevation": 80.0}
"""Where the camera sees the ``plane``."""

SIDE = 12
HEIGHT = 4.3
"""Voxels along each side of the plane's volume, and of the plane above the bottom of its box."""

Light = Mapping[str, Any] | np.ndarray
"""A ``[[lights]]`` table, or the picture (h, w, 3) of a probe."""


def plane_volume() -> Volume:
    """The field -z: at isovalue -HEIGHT a plane across the whole box, open to the sky."""
    return make_volume(-np.arange(SIDE)[:, None, None] * np.ones((SIDE, SIDE, SIDE)), name="plane")


def ball_volume(side: int = SIDE) -> Volume:
    """The field r - distance from the middle: at isovalue 0 a ball of radius r, a third of the
    side.
    """
    return make_volume(-ball(grid(side, side, side), (0.0, 0.0, 0.0), side / 3.0), name="ball")


def body_volume(side: int = 16) -> Volume:
    """The field of the body, 1 within, 0 without, and a ramp of 3 voxels between: its skin is at
    isovalue 0.5.
    """
    return make_volume(ramp(body(side), 3.0), name="body")


def scene_of(volume: Volume, isovalue: float, **settings: Any) -> Scene:
    """A scene of a volume that is in no file, by default under constant light of radiance 1."""
    scene = load_scene("demo:orbital", **{"lights": [dict(CONSTANT)], **settings})
    inputs = replace(scene.inputs, centre=volume.centre, radius=volume.radius)
    plan = plan_scene(inputs, scene.settings.overrides)
    return replace(
        scene,
        volume=volume,
        isovalue=isovalue,
        isovalues=volume.value_range,
        inputs=inputs,
        plan=plan,
    )


def scenes_of(name: str, specimen: Specimen, **settings: Any) -> list[Scene]:
    """The scenes of a specimen, one for each of its isovalues."""
    volume = make_volume(specimen.make(), specimen.spacing, name=name)
    return [scene_of(volume, each, **settings) for each in specimen.isovalues]


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


def spot(
    height: int, width: int, row: int, column: int, radiance: float, around: float = 0.0
) -> np.ndarray:
    """A probe of ``around`` everywhere but in one pixel."""
    image = np.full((height, width, 3), around)
    image[row, column] = radiance
    return image


def view_of(scene: Scene, size: int, **settings: Any) -> View:
    """A square view of a scene at its isovalue, its camera at STAND but for what is given."""
    stand = {name: settings.pop(name, value) for name, value in STAND.items()}
    return View(scene.isovalue, scene.camera(**stand), width=size, height=size, **settings)


@contextmanager
def renderer_of(scene: Scene) -> Iterator[Renderer]:
    """A renderer of a scene, without light."""
    with (
        closing(Tiles()) as tiles,
        TemporaryDirectory(ignore_cleanup_errors=True) as folder,
    ):  # stamps of use come late
        yield Renderer(Caches(PreparedScene(scene), Path(folder), 1 << 30), tiles)


@contextmanager
def view_bake(scene: Scene, view: View) -> Iterator[ViewBake]:
    """The texels that a view of the scene reads, none of them baked."""
    with renderer_of(scene) as renderer:
        yield ViewBake(renderer, view)


def frame_of(scene: Scene, view: View, samples: int | None = None) -> Frame:
    """The frame of a view, its light baked to the scene's target error, or with so many samples of
    each texel.
    """
    if view.shading not in SPECS:
        with renderer_of(scene) as renderer:
            return renderer.render(view)
    with view_bake(scene, view) as bake:
        if not len(bake.texels):
            return bake.renderer.render(view)
        goal = Goal(1e-9) if samples else Goal(scene.target_error)
        bake.grow(samples or goal.most_samples, goal)
        return bake.frame()


def picture_of(scene: Scene, view: View, samples: int) -> np.ndarray:
    """The picture of a view, (h, w, 3) uint8, at the scene's own exposure; ``samples`` are of each
    texel read.
    """
    return develop(frame_of(scene, view, samples), scene.default_exposure)


def grey_levels(one: np.ndarray, other: np.ndarray) -> int:
    """The largest difference of two pictures (h, w, 3) uint8."""
    return int(np.abs(one.astype(int) - other.astype(int)).max(initial=0))


def surface_light(frame: Frame) -> np.ndarray:
    """Luminance (n,) of the pixels that show the surface."""
    return luminance_of(frame.radiance[frame.state > 0])


def is_finite(frame: Frame) -> bool:
    """Whether all numbers of a frame are finite, and its errors between 0 and 1."""
    finite = np.isfinite(frame.radiance).all() and np.isfinite(frame.position).all()
    errors = np.append(frame.error.ravel(), frame.noise)
    return bool(finite and ((errors >= 0.0) & (errors <= 1.0)).all())


ARITHMETICS: Mapping[str, Callable[..., None]] = {"float32": cast_batch, "float64": cast_one_by_one}
"""The float32 traversal, refined in float64, which frames and bakes cast with; and the scalar
caster.
"""


@dataclass(frozen=True, eq=False)
class Surface:
    """The isosurface of a ``field`` at a normalised isovalue, ``level``; ``bricks`` are its map."""

    field: Field
    bricks: ActiveCells
    level: Isovalue

    def cast(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        sides: Any = UNKNOWN_SIDE,
        by: str = "float32",
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where rays (n, 3) in index space meet it: t (n,), inf where they do not, and the side
        they came from.
        """
        count = len(origins)
        t = np.empty(count)
        came = np.empty(count, np.int8)
        given = np.broadcast_to(np.asarray(sides, np.int8), count).copy()
        levels = np.full(count, self.level)
        starts, ways = (np.ascontiguousarray(v.T, np.float64) for v in (origins, directions))
        ARITHMETICS[by](self.field, self.bricks, Rays(levels, starts, ways, given), t, came)
        return t, came

    def height(self, points: np.ndarray) -> np.ndarray:
        """The trilinear field less the isovalue at points (n, 3), by SciPy, float64: solid above
        0.
        """
        value = map_coordinates(
            self.field.voxels.astype(np.float64), points.T[::-1], order=1, mode="nearest"
        )
        return value - self.level


def surface_of(array: np.ndarray, isovalue: float, **changes: Any) -> Surface:
    """The isosurface of a volume (z, y, x), its isovalue in its own units; ``changes`` are of the
    Field.
    """
    return surface_in(make_volume(array), isovalue, **changes)


def surface_in(volume: Volume, isovalue: float, **changes: Any) -> Surface:
    """The isosurface of a volume that is made."""
    level = volume.normalise_isovalue(isovalue)
    bricks = make_active_cells(volume.voxels, block_ranges(volume.voxels), level, level)
    return Surface(make_field(volume)._replace(**changes), bricks, level)
