"""Pictures of scenes as a user sees them, where their pixels meet the surface, and what is to be said of frames."""

import numpy as np

from benchmarks.stability.stage import frame_of, renderer_of
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.report.metrics import luminance


def picture_of(scene: Scene, view: View, samples: int) -> np.ndarray:
    """The picture of a view, (h, w, 3) uint8, at the scene's own exposure; ``samples`` are of each texel read."""
    return develop(frame_of(scene, view, samples), scene.default_exposure)


def grey_levels(one: np.ndarray, other: np.ndarray) -> int:
    """The largest difference of two pictures (h, w, 3) uint8."""
    return int(np.abs(one.astype(int) - other.astype(int)).max(initial=0))


def hits_of(scene: Scene, view: View) -> np.ndarray:
    """Where pixels meet the surface, in index space, (h, w, 3) float32; -1 where they do not."""
    hits = np.full((view.height * view.width, 3), -1.0, np.float32)
    with renderer_of(scene) as renderer:
        found = renderer.gbuffer(view)
    hits[found.pixels] = found.points
    return hits.reshape(view.height, view.width, 3)


def surface_light(frame: Frame) -> np.ndarray:
    """Luminance of the pixels that show the surface."""
    return luminance(frame.radiance[frame.state > 0])


def no_numbers(*planes: np.ndarray) -> int:
    """How many numbers of some planes are not finite."""
    return sum(int((~np.isfinite(plane)).sum()) for plane in planes)


def faults(frame: Frame) -> int:
    """Numbers of a frame, and of what its headers say, that are not finite, or no error from 0 to 1."""
    errors = frame.error, np.array(frame.estimated_error)
    beyond = sum(int((np.abs(error - 0.5) > 0.5).sum()) for error in errors)
    return no_numbers(frame.radiance, frame.position, *errors) + beyond
