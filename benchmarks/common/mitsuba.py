"""Mitsuba's path tracer on the mesh of an isosurface, under constant light or a probe."""

import importlib.util
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.common.mesh import Mesh
from isogi_core.model.view import View, rotation_matrix

NEVER = 1000
"""A depth at which no path is, for Russian roulette to begin at."""

SAMPLERS = ("independent", "multijitter")
"""Mitsuba's default, and the one of its own that errs least here at equal samples."""

FROM_MITSUBA = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Turns the axes of Mitsuba's environment maps (+y up, columns from -z towards +x) to those of
probes, whose columns grow the other way round and are mirrored before."""


EVEN = np.ones((1, 1, 3), np.float32)
"""The image of light of radiance 1 from everywhere."""


def installed() -> bool:
    """Whether Mitsuba is there."""
    return importlib.util.find_spec("mitsuba") is not None


def usable(variant: str) -> bool:
    """Whether a variant runs here: the llvm ones need LLVM's shared library, which
    ``DRJIT_LIBLLVM_PATH`` may name.
    """
    import mitsuba  # noqa: PLC0415

    try:
        mitsuba.set_variant(variant)
        return float(np.sum(mitsuba.Float(1.0) + mitsuba.Float(1.0))) == 2.0
    except (ImportError, RuntimeError):
        return False


def rgb(value: Sequence[float] | np.ndarray) -> dict[str, Any]:
    """A colour as Mitsuba takes it."""
    return {"type": "rgb", "value": [float(each) for each in value]}


def matte(albedo: Sequence[float]) -> dict[str, Any]:
    """What is diffuse on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(albedo)}}


class PathTracer:
    """One variant of Mitsuba: a mesh in world units, diffuse on both sides, in even light or that
    of a probe.
    """

    def __init__(
        self,
        variant: str,
        mesh: Mesh,
        view: View,
        albedo: float,
        depth: int,
        probe: np.ndarray = EVEN,
        sampler: str = SAMPLERS[0],
    ) -> None:
        """Set the scene up for paths of at most ``depth`` segments, none ended by chance.

        ``probe`` is a lat-long image (h, w, 3) as isogi has them, turned as the view says; one
        pixel is even light. Light is not seen itself.
        """
        self._begin(variant, probe)
        shape = self._shape(mesh, matte([albedo] * 3))
        self._load(
            {
                "light": self._light(probe, view),
                "mesh": shape,
                "sensor": self._sensor(view, sampler),
            },
            depth,
        )

    def _begin(self, variant: str, probe: np.ndarray) -> None:
        """Choose a variant."""
        import mitsuba  # noqa: PLC0415

        self.mitsuba = mitsuba
        self.variant = variant
        self.turns = probe.size > EVEN.size
        mitsuba.set_variant(variant)
        mitsuba.set_log_level(mitsuba.LogLevel.Error)

    def _load(self, parts: Mapping[str, Any], depth: int, hides: bool = True) -> None:
        """Make the scene of its parts, and what traces its paths; whether it ``hides`` light that
        is seen itself.
        """
        self.scene = self.mitsuba.load_dict({"type": "scene", **parts})
        how = {"max_depth": depth, "rr_depth": NEVER, "hide_emitters": hides}
        self.integrator = self.mitsuba.load_dict({"type": "path", **how})

    def _light(self, probe: np.ndarray, view: View) -> dict[str, Any]:
        if self.turns:
            return self._envmap(probe, view)
        return {"type": "constant", "radiance": rgb(probe[0, 0])}

    def spec(self, view: View) -> None:
        """Move the camera, and turn the probe, to those of ``view``, of the same size and field of
        view.
        """
        self.mitsuba.set_variant(self.variant)
        parameters = self.mitsuba.traverse(self.scene)
        parameters["sensor.to_world"] = self._camera(view)
        if self.turns:
            parameters["light.to_world"] = self._turned(view)
        parameters.update()

    def picture(self, samples: int, threads: int, seed: int = 0) -> np.ndarray:
        """The picture, (h, w, 4) float32 RGB and alpha, of so many paths per pixel on so many
        threads.
        """
        import drjit  # noqa: PLC0415

        self.mitsuba.set_variant(self.variant)
        drjit.set_thread_count(threads)
        return np.array(
            self.mitsuba.render(self.scene, integrator=self.integrator, spp=samples, seed=seed)
        )

    def _sensor(self, view: View, sampler: str) -> dict[str, Any]:
        film = {
            "type": "hdrfilm",
            "width": view.width,
            "height": view.height,
            "rfilter": {"type": "box"},
        }
        film |= {"pixel_format": "rgba", "component_format": "float32"}
        lens = {"fov": view.camera.fov, "fov_axis": "y", "to_world": self._camera(view)}
        return {"type": "perspective", **lens, "film": film, "sampler": {"type": sampler}}

    def _camera(self, view: View) -> Any:
        camera = view.camera
        return self.mitsuba.ScalarTransform4f().look_at(
            origin=list(camera.eye), target=list(camera.target), up=list(camera.up)
        )

    def _envmap(self, probe: np.ndarray, view: View) -> dict[str, Any]:
        image = np.ascontiguousarray(probe[:, ::-1], np.float32)
        return {
            "type": "envmap",
            "bitmap": self.mitsuba.Bitmap(image),
            "to_world": self._turned(view),
        }

    def _turned(self, view: View) -> Any:
        """Where the environment map's axes lie in the world under the view's light rotation."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrix(view.light) @ FROM_MITSUBA
        return self.mitsuba.ScalarTransform4f(matrix)

    def _shape(self, mesh: Mesh, bsdf: Mapping[str, Any], normals: np.ndarray | None = None) -> Any:
        """A mesh that reflects by a ``bsdf``, shaded with the ``normals`` of its points where there
        are any.
        """
        points, triangles = mesh
        properties = self.mitsuba.Properties()
        properties["bsdf"] = self.mitsuba.load_dict(bsdf)
        shape = self.mitsuba.Mesh(
            "isosurface",
            len(points),
            len(triangles),
            has_vertex_normals=normals is not None,
            props=properties,
        )
        parameters = self.mitsuba.traverse(shape)
        parameters["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(triangles, np.uint32).ravel()
        if normals is not None:
            parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
        parameters.update()
        return shape
