"""References: a view path-traced from each pixel, with an estimate of its noise, refined round
by round.
"""

import io
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from isogi_core.errors import ReportError
from isogi_core.files.spelling import shortest
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import Paths, variance_of_mean
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.value_survey import digest_of
from isogi_core.model.view import View
from isogi_core.plan.budget import BOUNCES_SHARE, bounces_for, survival_for
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import write_whole

REFERENCE_REPLICAS = 8
"""Number of independent randomisations of a reference."""

MAX_LOST_LIGHT = 0.001
"""Most light, as a share, that the bounces which a reference leaves out may bring."""

FIRST_ROUND_PATHS = 16
"""Paths per pixel of the first round; each further one doubles the number."""

MAX_PIXEL_PATHS = REFERENCE_REPLICAS << 32
"""Most paths per pixel for which there are random numbers."""

NOISE_DECAY = 1.75
"""The samples that a noise takes grow as its inverse to this power, as points are stratified
(measured on the demos under a sky).
"""

REFERENCE_FORMAT = 1
"""Version of references: increased if their paths, or the data in their files, change."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The mean of ``samples`` paths from each pixel, over independent randomisations.

    - ``mean``: (h, w, 3) float32 linear RGB; ``variance``: (h, w) float32 of the mean's luminance,
      0 off the surface.
    - ``on``: (h, w) bool, the pixels that show the surface.
    - ``seconds``: processor time spent.
    - ``sums``: (surface pixels, replicas, 3) float64, from which it can be continued.
    - ``subject``: the digest of ``subject_of``.
    """

    mean: np.ndarray
    variance: np.ndarray
    on: np.ndarray
    samples: int
    seconds: float
    sums: np.ndarray = field(
        default_factory=lambda: np.zeros((0, REFERENCE_REPLICAS, 3)), repr=False
    )
    subject: str = ""

    @property
    def standard_error(self) -> np.ndarray:
        """Standard error of each pixel's luminance, (h, w) float32."""
        return np.asarray(np.sqrt(self.variance))

    @property
    def noise(self) -> float:
        """Relative standard error of the whole: root mean square over the surface, over the
        mean luminance.
        """
        if self.on.any():
            light = float((self.mean[self.on] @ LUMINANCE_WEIGHTS).mean())
        else:
            light = 0.0
        if light > 0.0:
            return float(np.sqrt(self.variance[self.on].mean(dtype=np.float64))) / light
        return 0.0


REFERENCE_FIELDS = fields(Reference)
"""Fields that a file keeps."""


def trace_reference(
    renderer: Renderer,
    view: View,
    samples: int,
    former: Reference | None = None,
    progress: Callable[[int], object] | None = None,
) -> Reference:
    """Trace the reference of ``view`` with ``samples`` paths per pixel, rounded up to a multiple of
    REFERENCE_REPLICAS.

    It continues the sequences of a ``former`` reference: its bits do not depend on the number of
    rounds. Bounces are those of the renderer's scene. ``progress`` is called with the number of
    paths as they are traced.

    Raises ReportError if ``former`` is of another subject or the scene has several surfaces; and
    Cancelled, as the renderer's tiles do, leaving ``former`` as it is.
    """
    refuse_several(renderer.prepared.scene)
    subject = subject_of(renderer.prepared.scene, view)
    gbuffer = renderer.gbuffer(view)
    if former is None:
        former = from_sums(
            gbuffer, np.zeros((len(gbuffer.points), REFERENCE_REPLICAS, 3)), 0, 0.0, subject
        )
    if former.subject != subject:
        raise ReportError("The reference to continue is of another scene or view: begin a new one.")
    # Trace the samples that each replica still lacks, and add them to a copy of the sums.
    taken = former.samples // REFERENCE_REPLICAS
    wanted = -(-samples // REFERENCE_REPLICAS)
    if wanted <= taken:
        return former
    paths = Paths(RotatedLight(renderer.caches.spec("gi"), view), gbuffer, renderer.tiles)
    sums = former.sums.copy()
    paths.prepare()
    begun = time.process_time()
    paths.add(sums, streams.REFERENCE_STREAM, taken, wanted - taken, progress)
    return from_sums(gbuffer, sums, wanted, former.seconds + time.process_time() - begun, subject)


def refuse_several(scene: Scene) -> None:
    """Raise ReportError if a ``scene`` has several surfaces, or one of glass: pixels of a
    reference show one side of one surface that keeps light.
    """
    if scene.surfaces.material.refracts:
        raise ReportError(
            "A reference needs light that a surface keeps, and glass keeps none: render it "
            "path_traced."
        )
    if scene.surfaces.several:
        raise ReportError(
            "A reference shows one side of one surface, and this scene has more: render it "
            "path_traced instead."
        )


def from_sums(
    gbuffer: GBuffer, sums: np.ndarray, count: int, seconds: float, subject: str
) -> Reference:
    """Make the reference whose replicas have ``count`` samples each, from their ``sums``."""
    height, width = gbuffer.shape
    # Scatter the pixels of the surface into the picture; the spread of the replicas gives the
    # variance of their mean.
    mean = np.zeros((height * width, 3), np.float32)
    variance = np.zeros(height * width, np.float32)
    on = np.zeros(height * width, np.bool_)
    mean[gbuffer.pixels] = sums.mean(axis=1) / max(count, 1)
    variance[gbuffer.pixels] = variance_of_mean(sums / max(count, 1))
    on[gbuffer.pixels] = True
    picture = (
        mean.reshape(height, width, 3),
        variance.reshape(height, width),
        on.reshape(height, width),
    )
    return Reference(*picture, count * REFERENCE_REPLICAS, seconds, sums, subject)


def with_bounces(scene: Scene, bounces: int | None = None) -> Scene:
    """Return the scene with paths of ``bounces``; by default with as many as lose less than
    MAX_LOST_LIGHT.
    """
    if bounces is None:
        bounces = bounces_for(scene.inputs.reflecting, MAX_LOST_LIGHT / BOUNCES_SHARE)
    # Roulette follows from the bounces.
    survival = survival_for(scene.inputs.reflecting, bounces)
    return replace(scene, plan=replace(scene.plan, bounces=bounces, survival=survival))


def subject_of(scene: Scene, view: View) -> str:
    """Return the hex digest of everything that a reference's light depends on."""
    lights = [scene.lighting.environment.digest, scene.lighting.lamps.digest]
    albedo = scene.surfaces.albedo_for(view.albedo)
    if scene.lighting.room.any:
        lights += [scene.lighting.room.digest]
    if scene.surfaces.colours:
        lights += [scene.surfaces.colours.digest]
    shine = scene.surfaces.shine_for(view.shine)
    lights += [repr(shine)] if shine else []
    world = [scene.volume.digest, *lights, albedo, *scene.departures]
    camera = [view.camera.eye, view.camera.target, view.camera.up, view.camera.fov]
    picture = [view.isovalue, *camera, view.light, view.width, view.height]
    return digest_of([REFERENCE_FORMAT, *world, scene.bounces, scene.plan.survival, *picture])


def save_reference(path: Path, reference: Reference, scene: Scene, view: View) -> None:
    """Write a reference of ``view`` as .npz, completely or not at all. Its entry ``about`` is
    JSON that describes scene and view.
    """
    surface = {"normals": scene.settings.normals, "offset": scene.settings.offset}
    shown = {
        name: value
        for name, value in asdict(view).items()
        if name not in ("moving", "smooth", "strip", "orientation")
    }
    about = {
        "format": REFERENCE_FORMAT,
        "scene": scene.name,
        "bounces": scene.bounces,
        **surface,
        "view": shown,
    }
    file = io.BytesIO()
    np.savez(
        file,
        about=json.dumps(about),
        **{each.name: getattr(reference, each.name) for each in REFERENCE_FIELDS},
    )
    write_whole(path, file.getvalue())


def load_reference(path: Path, scene: Scene, view: View) -> Reference:
    """Read the reference of ``view`` from a file. Raises OSError, and ReportError if the file
    is damaged or of another subject.
    """
    # Read the file; anything but a complete archive of this format is refused.
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            if about["format"] != REFERENCE_FORMAT:
                raise ReportError(
                    f"{path} was written by another version of isogi: remove it, or name "
                    "another file."
                )
            kept = {each.name: file[each.name] for each in REFERENCE_FIELDS}
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ReportError(
            f"{path} is no complete reference ({error}): remove it, or name another file."
        ) from None
    # Refuse a reference of another subject, and say what the file holds.
    if kept["subject"] != subject_of(scene, view):
        described = (
            "{scene} at {spelled}, {width} × {height} pixels, {bounces} bounces, "
            "{normals} normals, {offset:g} off"
        )
        kept_view = described.format(
            **about, **about["view"], spelled=shortest(about["view"]["isovalue"])
        )
        raise ReportError(
            f"{path} is of another scene, view or way of tracing ({kept_view}): name another file."
        )
    return Reference(
        **{name: value if value.ndim else value.item() for name, value in kept.items()}
    )


@dataclass(frozen=True)
class ReferenceGoal:
    """The condition at which a reference stops to grow: the first to be met of ``samples``,
    ``noise`` and ``seconds``.
    """

    samples: int | None = None
    noise: float | None = None
    seconds: float | None = None

    def met(self, reference: Reference) -> bool:
        """Return True if a reference has the samples, or at most the noise, of this goal."""
        sampled = self.samples is not None and reference.samples >= self.samples
        return sampled or (self.noise is not None and reference.noise <= self.noise)

    def foresee(self, reference: Reference) -> int | None:
        """Return the samples at which a reference is expected to stop, without regard to time;
        None if that is unknown.
        """
        if self.samples is not None:
            return max(self.samples, reference.samples)
        if self.noise is None:
            return None
        # Noise falls as samples^(-1 / NOISE_DECAY), and rounds double the samples.
        wanted = reference.samples * max(reference.noise / self.noise, 1.0) ** NOISE_DECAY
        return int(2 ** math.ceil(math.log2(wanted)))


def grow_reference(
    renderer: Renderer,
    view: View,
    goal: ReferenceGoal,
    former: Reference | None = None,
    progress: Callable[[int], object] | None = None,
) -> Iterator[Reference]:
    """Yield references of 16, 32, … paths per pixel, each continued from the last or the ``former``
    one, up to the ``goal``.

    The last has as many paths as fit into the time, judged by the rounds before; the first is made
    in any case. Raises the errors of ``trace_reference``.
    """
    begun = time.monotonic()
    reference = former
    before = former.samples if former is not None else 0
    while reference is None or not goal.met(reference):
        taken = reference.samples if reference is not None else 0
        # Double the paths, but take no more than the goal asks for.
        wanted = min(max(2 * taken, FIRST_ROUND_PATHS), goal.samples or MAX_PIXEL_PATHS)
        # Take only as many as fit into the time that is left, at the speed of the rounds so far.
        if goal.seconds is not None and taken > before:
            spent = time.monotonic() - begun
            wanted = min(wanted, taken + fitting(goal.seconds - spent, spent / (taken - before)))
        if wanted <= taken:
            return
        reference = trace_reference(renderer, view, wanted, reference, progress)
        yield reference


def fitting(seconds: float, each: float) -> int:
    """Return the number of samples that fit into ``seconds`` if each takes ``each`` seconds, a
    multiple of REFERENCE_REPLICAS.
    """
    return int(max(seconds, 0.0) / max(each, 1e-9)) // REFERENCE_REPLICAS * REFERENCE_REPLICAS
