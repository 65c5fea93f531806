"""A scene's isosurface with walls, glass, shine and clear surfaces, as Mitsuba takes it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click
import numpy as np

from benchmarks.common.mesh import make_mesh
from benchmarks.common.mitsuba import SAMPLERS, PathTracer, matte, rgb
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.room import Room
from isogi_core.model.view import View
from isogi_core.model.volume import make_volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene

VARIANT = "llvm_ad_rgb"
DEPTH = 24
"""Segments of a path, at most."""

CLOSER = 2
"""Points of the mesh along each axis, over those of the volume, where that has no more than FEW of
them.
"""

FEW = 128

SHARPER = 8
"""Pixels along each side of one of a probe."""


@dataclass(frozen=True)
class Ball:
    """A ball in the box of a volume, in the place of a mesh."""

    centre: tuple[float, float, float]
    radius: float


def surface_of(scene: Scene, albedo: Sequence[float]) -> dict[str, Any]:
    """What light meets at the surface: diffuse on both sides, metal, glass, or a share of it with
    the rest clear.
    """
    if scene.surfaces.material.refracts:
        if any(scene.surfaces.material.absorption):
            raise click.ClickException("Mitsuba's scene has no glass that absorbs: leave it out.")
        return {"type": "dielectric", "int_ior": scene.surfaces.material.index, "ext_ior": 1.0}
    if scene.surfaces.shine is not None and scene.surfaces.shine.strength:
        metal = {"type": "principled", "metallic": 1.0, "roughness": scene.surfaces.shine.roughness}
        return {"type": "twosided", "bsdf": metal | {"base_color": rgb(albedo)}}
    if scene.surfaces.clear:
        return {"type": "mask", "opacity": 1.0 - scene.surfaces.clear, "bsdf": matte(albedo)}
    return matte(albedo)


class SceneTracer(PathTracer):
    """Mitsuba's path tracer of a whole scene, in the coordinates of the volume's box.

    Behind a mask Mitsuba leaves out reflected light, too, where it is to hide lights: a shell under
    an even sky is 0.449 in place of 0.485. So lights are seen through clear surfaces, and a picture
    of black ones is taken off.
    """

    def __init__(
        self, scene: Scene, view: View, ball: Ball | None = None, *, black: bool = False
    ) -> None:
        """Take on a scene; a ``ball`` is exact, any other surface a mesh of the cells, with normals
        of the field.

        The surface is ``black`` where asked.
        """
        probe = scene.lighting.environment.constant + scene.lighting.environment.image
        self._begin(VARIANT, probe)
        parts: dict[str, Any] = {
            "sensor": self._sensor(view, SAMPLERS[1]),
            **self._walls(scene.lighting.room),
        }
        if probe.any():
            parts["light"] = self._light(pixelwise(probe) if self.turns else probe, view)
        bsdf = surface_of(scene, (0.0,) * 3 if black else tuple(scene.surfaces.albedo))
        if ball:
            parts["isosurface"] = self._ball(ball, bsdf)
        else:
            parts["isosurface"] = self._meshed(scene, view, bsdf)
        self._load(parts, DEPTH, hides=not scene.surfaces.clear)
        open_air = scene.surfaces.clear and not scene.lighting.room.any
        self._behind = (
            SceneTracer(scene, view, ball, black=True) if open_air and not black else None
        )

    def picture(self, samples: int, threads: int, seed: int = 0) -> np.ndarray:
        """The picture, as that of a ``PathTracer``; the alpha of a scene with clear surfaces is
        1.
        """
        seen = super().picture(samples, threads, seed)
        if self._behind is not None:
            seen[..., :3] -= self._behind.picture(samples, threads, seed)[..., :3]
        return seen

    def _walls(self, room: Room) -> Mapping[str, Any]:
        """Rectangles that are black behind where one side is lit."""
        parts = {}
        for number, (wall, corner, (u, v)) in enumerate(
            zip(room.walls, room.corners, room.edges, strict=True)
        ):
            matrix = np.eye(4)
            normal = np.cross(u, v)
            matrix[:3] = np.column_stack(
                [u / 2, v / 2, normal / np.linalg.norm(normal), corner + (u + v) / 2]
            )
            shape = {"type": "rectangle", "to_world": self.mitsuba.ScalarTransform4f(matrix)}
            both = matte(wall.albedo)
            shape["bsdf"] = both["bsdf"] if wall.sides == 1 else both
            if any(wall.radiance):
                shape["emitter"] = {"type": "area", "radiance": rgb(wall.radiance)}
            parts[f"wall{number}"] = shape
        return parts

    def _ball(self, ball: Ball, bsdf: Mapping[str, Any]) -> dict[str, Any]:
        return {"type": "sphere", "center": list(ball.centre), "radius": ball.radius, "bsdf": bsdf}

    def _meshed(self, scene: Scene, view: View, bsdf: Mapping[str, Any]) -> Any:
        """The mesh of the isosurface, whose points have the normals that isogi shades with."""
        level = scene.volume.normalise_isovalue(scene.isovalue)
        volume = scene.volume
        closer = CLOSER if max(volume.shape) <= FEW else 1
        voxels = between(np.asarray(volume.voxels, np.float32), closer)
        points, triangles = make_mesh(make_volume(voxels), level)
        points /= np.float32(closer)
        surface = PreparedScene(scene).surface(scene.isovalue)
        spacing = np.array(volume.spacing, np.float32)
        eye = tuple(np.array(view.camera.eye) / spacing)
        normals = GBuffer.of_points(surface, eye, points).normals(Tiles())
        points = points * spacing
        a, b, c = (points[triangles[:, k]] for k in range(3))
        inwards = (np.cross(b - a, c - a) * normals[triangles[:, 0]]).sum(axis=1) < 0.0
        outwards = np.where(inwards[:, None], triangles[:, ::-1], triangles)
        return self._shape((points, outwards), bsdf, normals)


def pixelwise(probe: np.ndarray) -> np.ndarray:
    """A finer image, which Mitsuba shows as isogi shows a ``probe`` (h, w, 3), whose pixels are
    even.

    Mitsuba interpolates between pixels, and puts the first and the last row onto the poles.
    """
    height = SHARPER * len(probe)
    rows = np.minimum(np.arange(height) * len(probe) // (height - 1), len(probe) - 1)
    return np.repeat(probe[rows], SHARPER, axis=1)


def between(voxels: np.ndarray, closer: int) -> np.ndarray:
    """The same values, with ``closer`` times as many along each axis: those of the trilinear field
    between them.
    """
    for axis in range(3 if closer > 1 else 0):
        count = voxels.shape[axis]
        at = np.arange((count - 1) * closer + 1) / closer
        low = np.minimum(at.astype(int), count - 2)
        share = (at - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        below = np.take(voxels, low, axis)
        above = np.take(voxels, low + 1, axis)
        voxels = below + share * (above - below)
    return voxels
