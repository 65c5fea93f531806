"""A scene's isosurface with walls, glass, shine and clear surfaces, as Mitsuba takes it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.common.mesh import make_mesh
from benchmarks.common.mitsuba import NEVER, PathTracer, rgb
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
"""Points of the mesh along each axis, over those of the volume, where that has no more than FEW of them."""

FEW = 128


@dataclass(frozen=True)
class Ball:
    """A ball in the box of a volume, in the place of a mesh."""

    centre: tuple[float, float, float]
    radius: float


def surface_of(scene: Scene) -> dict[str, Any]:
    """What light meets at the surface: diffuse on both sides, metal, glass, or a share of it with the rest clear."""
    matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(scene.albedo)}}
    if scene.material.refracts:
        return {"type": "dielectric", "int_ior": scene.material.index, "ext_ior": 1.0}
    if scene.shine is not None and scene.shine.strength:
        metal = {"type": "principled", "metallic": 1.0, "roughness": scene.shine.roughness}
        return {"type": "twosided", "bsdf": metal | {"base_color": rgb(scene.albedo)}}
    if scene.clear:
        return {"type": "mask", "opacity": 1.0 - scene.clear, "bsdf": matte}
    return matte


class SceneTracer(PathTracer):
    """Mitsuba's path tracer of a whole scene, in the coordinates of the volume's box."""

    def __init__(self, scene: Scene, view: View, ball: Ball | None = None) -> None:
        """Take on a scene; a ``ball`` is exact, any other surface a mesh of the cells, with normals of the field."""
        import mitsuba  # noqa: PLC0415

        self.mitsuba, self.variant = mitsuba, VARIANT
        mitsuba.set_variant(VARIANT)
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        parts: dict[str, Any] = {"sensor": self._sensor(view, "multijitter"), **self._walls(scene.room)}
        probe = scene.environment.constant + scene.environment.image
        if probe.any():
            even = probe.shape[:2] == (1, 1)
            parts["light"] = {"type": "constant", "radiance": rgb(probe[0, 0])} if even else self._envmap(probe, view)
        parts["isosurface"] = self._ball(ball, scene) if ball else self._meshed(scene, view)
        self.scene = mitsuba.load_dict({"type": "scene", **parts})
        how = {"max_depth": DEPTH, "rr_depth": NEVER, "hide_emitters": True}
        self.integrator = mitsuba.load_dict({"type": "path", **how})

    def _walls(self, room: Room) -> Mapping[str, Any]:
        """Rectangles that are black behind where one side is lit."""
        parts = {}
        for number, (wall, corner, (u, v)) in enumerate(zip(room.walls, room.corners, room.edges, strict=True)):
            matrix = np.eye(4)
            normal = np.cross(u, v)
            matrix[:3] = np.column_stack([u / 2, v / 2, normal / np.linalg.norm(normal), corner + (u + v) / 2])
            shape = {"type": "rectangle", "to_world": self.mitsuba.ScalarTransform4f(matrix)}
            matte = {"type": "diffuse", "reflectance": rgb(wall.albedo)}
            shape["bsdf"] = matte if wall.sides == 1 else {"type": "twosided", "bsdf": matte}
            if any(wall.radiance):
                shape["emitter"] = {"type": "area", "radiance": rgb(wall.radiance)}
            parts[f"wall{number}"] = shape
        return parts

    def _ball(self, ball: Ball, scene: Scene) -> dict[str, Any]:
        return {"type": "sphere", "center": list(ball.centre), "radius": ball.radius, "bsdf": surface_of(scene)}

    def _meshed(self, scene: Scene, view: View) -> Any:
        """The mesh of the isosurface, whose points have the normals that isogi shades with."""
        level, volume = scene.volume.normalise_isovalue(scene.isovalue), scene.volume
        closer = CLOSER if max(volume.shape) <= FEW else 1
        voxels = between(np.asarray(volume.voxels, np.float32), closer)
        points, triangles = make_mesh(make_volume(voxels), level)
        points /= np.float32(closer)
        surface = PreparedScene(scene).surface(scene.isovalue)
        spacing = np.array(volume.spacing, np.float32)
        eye = tuple(np.array(view.camera.eye) / spacing)
        normals = GBuffer.of_points(surface, eye, points).normals(Tiles())
        return self._with_normals(points * spacing, triangles, normals, surface_of(scene))

    def _with_normals(self, points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, bsdf: Any) -> Any:
        a, b, c = (points[triangles[:, k]] for k in range(3))
        inwards = (np.cross(b - a, c - a) * normals[triangles[:, 0]]).sum(axis=1) < 0.0
        triangles = np.where(inwards[:, None], triangles[:, ::-1], triangles)
        properties = self.mitsuba.Properties()
        properties["bsdf"] = self.mitsuba.load_dict(bsdf)
        shape = self.mitsuba.Mesh("isosurface", len(points), len(triangles), props=properties, has_vertex_normals=True)
        parameters = self.mitsuba.traverse(shape)
        for name, values in (("vertex_positions", points), ("vertex_normals", normals), ("faces", triangles)):
            kind = np.uint32 if name == "faces" else np.float32
            parameters[name] = np.ascontiguousarray(values, kind).ravel()
        parameters.update()
        return shape


def between(voxels: np.ndarray, closer: int) -> np.ndarray:
    """The same values, with ``closer`` times as many along each axis: those of the trilinear field between them."""
    for axis in range(3 if closer > 1 else 0):
        count = voxels.shape[axis]
        at = np.arange((count - 1) * closer + 1) / closer
        low = np.minimum(at.astype(int), count - 2)
        share = (at - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        below, above = np.take(voxels, low, axis), np.take(voxels, low + 1, axis)
        voxels = below + share * (above - below)
    return voxels
