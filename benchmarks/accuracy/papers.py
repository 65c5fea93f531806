"""The papers' own method, to measure ours against (Wyman et al., TVCG 2006, sections 3 and 4).

A texel keeps all light, direct and reflected, as one set of harmonics of order ORDER in single
floats, and of a light that is the same from all sides one number; it is lit on the isosurface
through its own point. A pixel reads the eight texels around it, trilinearly, and no more.
"""

from collections.abc import Callable

import numpy as np

from benchmarks.accuracy.carrying import lit_texels
from isogi_core.bake.texel_light import next_level
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.lattice import Lattice
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_report.bench import Bench, ViewBake, with_plan

ORDER = 5
"""Bands of harmonics: 25 coefficients, as S1 keeps (section 3.2)."""


def papers_scene(scene: Scene) -> Scene:
    """The scene as the papers light it."""
    order = 1 if scene.inputs.constant else ORDER
    layer = Layer("whole", order, scene.plan.channels, half=False)
    return with_plan(scene, layers=(layer,), order=order, lobes=0).with_settings(projected=False)


class PapersBake:
    """The light of a bench's view by the papers' method; ``seconds`` of the processor were spent on
    it.
    """

    def __init__(self, bench: Bench) -> None:
        """Bake nothing yet."""
        scene = papers_scene(bench.scene)
        self.bake = ViewBake(bench.renderer(scene), bench.view)
        self.bytes = scene.plan.bytes_per_texel

    @property
    def seconds(self) -> float:
        """Seconds of the processor that the bake took."""
        return self.bake.seconds

    def grow(self, seconds: float, tell: Callable[[str], object] = lambda text: None) -> None:
        """Bake, each texel with as many paths, until that took at least so many ``seconds``."""
        samples = 0
        while self.seconds < seconds:
            samples = next_level(samples)
            self.bake.grow(samples)
            tell(f"{samples} paths, {self.seconds:.0f} s")

    def radiance(self, view: View) -> np.ndarray:
        """The picture of a ``view`` that differs from the bench's by its light alone; (h, w, 3)
        float64 linear RGB.
        """
        shown = self.bake.shown
        picture = np.zeros((view.height * view.width, 3))
        lit, held = lit_texels(self.bake.light, RotatedLight(self.bake.spec, view))
        picture[shown.gbuffer.pixels] = interpolate(shown, lit[:, :3], held)
        return picture.reshape(view.height, view.width, 3)


def interpolate(shown: ViewTexels, lit: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The light of surface points, trilinearly of the texels around them that hold any; (points,
    channels) float64.

    Of each texel that is ``shown``, ``lit`` (t, channels) is its light, and ``held`` (t,) whether
    it holds any.
    """
    weights = trilinear(shown.gbuffer.points, shown.lattice) * held[shown.corners]
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    return np.asarray((weights[:, :, None] * lit[shown.corners]).sum(axis=1))


def trilinear(points: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Weights (m, 8) of the texels about ``points`` (m, 3; x, y, z, voxels), x fastest (S1, section
    4.2).
    """
    places = points[:, ::-1].astype(np.float64) * np.array(lattice.density[::-1])
    low = np.clip(np.floor(places), 0, np.array(lattice.shape) - 2)
    inside = np.clip(places - low, 0.0, 1.0)[:, None]
    return np.where(list(np.ndindex(2, 2, 2)), inside, 1.0 - inside).prod(axis=-1)
