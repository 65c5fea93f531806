"""Mitsuba's path tracer on the mesh of an isosurface under constant light."""

import importlib.util
from typing import Any

import numpy as np

from benchmarks.mesh import Mesh
from isogi_core.model.view import View

NEVER = 1000
"""A depth at which no path is, for Russian roulette to begin at."""


def installed() -> bool:
    """Whether Mitsuba is there."""
    return importlib.util.find_spec("mitsuba") is not None


def usable(variant: str) -> bool:
    """Whether a variant runs here: the llvm ones need LLVM's shared library, which ``DRJIT_LIBLLVM_PATH`` may name."""
    import mitsuba  # noqa: PLC0415

    try:
        mitsuba.set_variant(variant)
        return float(np.sum(mitsuba.Float(1.0) + mitsuba.Float(1.0))) == 2.0
    except (ImportError, RuntimeError):
        return False


class PathTracer:
    """One variant of Mitsuba on one view: a mesh in world units, diffuse on both sides, in light of radiance 1."""

    def __init__(self, variant: str, mesh: Mesh, view: View, albedo: float, depth: int) -> None:
        """Set the scene up for paths of at most ``depth`` segments, none ended by chance."""
        import mitsuba  # noqa: PLC0415

        self.mitsuba, self.variant = mitsuba, variant
        mitsuba.set_variant(variant)
        parts = {"light": {"type": "constant", "radiance": 1.0}, "mesh": self._shape(mesh, albedo)}
        self.scene = mitsuba.load_dict({"type": "scene", "sensor": self._sensor(view), **parts})
        self.integrator = mitsuba.load_dict({"type": "path", "max_depth": depth, "rr_depth": NEVER})

    def _sensor(self, view: View) -> dict[str, Any]:
        camera, film = view.camera, {"type": "hdrfilm", "width": view.width, "height": view.height}
        look = self.mitsuba.ScalarTransform4f().look_at(
            origin=list(camera.eye), target=list(camera.target), up=list(camera.up)
        )
        film |= {"rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"}
        return {"type": "perspective", "fov": camera.fov, "fov_axis": "y", "to_world": look, "film": film}

    def _shape(self, mesh: Mesh, albedo: float) -> Any:
        points, triangles = mesh
        diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
        properties = self.mitsuba.Properties()
        properties["bsdf"] = self.mitsuba.load_dict({"type": "twosided", "bsdf": diffuse})
        shape = self.mitsuba.Mesh("isosurface", len(points), len(triangles), props=properties)
        parameters = self.mitsuba.traverse(shape)
        parameters["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(triangles, np.uint32).ravel()
        parameters.update()
        return shape

    def picture(self, samples: int, threads: int) -> np.ndarray:
        """The picture, (h, w, 3) float32, of so many paths per pixel on so many threads."""
        import drjit  # noqa: PLC0415

        self.mitsuba.set_variant(self.variant)
        drjit.set_thread_count(threads)
        return np.array(self.mitsuba.render(self.scene, integrator=self.integrator, spp=samples))
