"""One cold view and the views after it: isogi, served and by ``isogi render``, next to Mitsuba.

    python -m benchmarks.speed cold [--only TEXT …] [--size 512] [--repeats 3] [--views 8]

Each scene is seen at azimuth 40, elevation 25, three radii away, 30 degrees wide, and starts from
an empty store:

- *Served*: a server that is ready draws the view until its picture is final. Seconds are those of
  the wall from the first request; core-seconds are the processor time of the server and all its
  child processes, by the system's count.
- *Rendered*: ``isogi render`` of the same view, from the start of its process to the file.
- *Row*: the server goes on with ``--views`` cameras 10 degrees apart, then with as many turns of
  the light 30 degrees apart, each to its final picture.
- *Mitsuba*: ``multijitter``, its best sampler here, on the marching-cubes mesh, to the true error
  of isogi's served picture. Its set-up is left out. See ``benchmarks.accuracy equal-error``.
- *Denoised*: 64 paths a pixel of Mitsuba, with Intel's Open Image Denoise guided by albedo and
  normals, next to the true error of the picture that isogi shows at that moment.

The true error of isogi is against long paths from each pixel; Mitsuba's is against its own
converged picture, so that the mesh does not count. If ``py-spy`` is installed, a further cold view
is sampled to tell the kinds of work that take the processor's time.
"""

import contextlib
import importlib.util
import json
import math
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.errors import relative_rmse, without
from benchmarks.accuracy.mitsuba_race import VARIANT, Converged, Mitsuba, draw, measured
from benchmarks.common import mesh, mitsuba
from benchmarks.common.measurement import Measurement, markdown, shown
from benchmarks.common.mitsuba import SAMPLERS
from benchmarks.common.scenes import LIGHTS, SEVEN, VOLUMES, Subject, scene_of, shared_data
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference, trace_reference, with_bounces
from isogi_report.speed import make_renderer

FIRST_AZIMUTH = 40
AZIMUTH_STEP = 10
"""Degrees between two cameras of a row."""

TURN_STEP = 30
"""Degrees between two turns of the light."""

CAMERA = {"elevation": 25, "distance": 3, "fov": 30}
BOUNCES = 4
REFERENCE_PATHS = 256
"""Paths a pixel of isogi's reference."""

DENOISED_PATHS = 64
GUIDE_PATHS = 16
"""Paths a pixel of the picture that is denoised, and of the pictures that guide the denoiser."""

LONGEST_WAIT = 600.0
"""Seconds after which a picture that is not final is given up."""

POLL_MS = 250
"""Longest that one request for a picture waits for light, in milliseconds."""

SETTLING_SECONDS = 5.0
"""Seconds between a server's readiness and its first view, for work of its start to end."""

KINDS = (
    ("paths of texels", ("sample_transfer", "bake_texels", "sample_texels")),
    ("paths of pixels", ("add_paths",)),
    ("controls", ("trace_controls",)),
    ("locating", ("locate",)),
    ("filter", ("filter_records", "FilteredLight")),
    ("encoding and writing", ("LayerStore.save", "ChunkStore.save", "Store.put")),
    ("reading light", ("LayerStore.read", "ChunkStore.read", "Loader.", "PagePool", "Store.get")),
    ("volume and maps", ("ActiveCellMaps", "make_volume", "survey", "make_active_cells")),
    ("imports", ("_find_and_load", "_call_with_frames_removed")),
    ("kernels loaded", ("_jit_cache", "unserialize", "_compile_for_args")),
    ("transport", ("distributed", "ssl", "asyncio", "multiprocessing", "selectors", "tornado")),
    ("drawing", ("gbuffer", "film.py", "shade", "view_texels", "surface_renderer", "renderer.py")),
)
"""Kinds of work by parts of the names on a stack; the first that is found counts."""

IDLE = (
    *("select (selectors", "wait (threading", "_worker (concurrent", "_recv", "poll (", "accept"),
    *("waitpid", "sleep", "_wait_for_tstate", "read (", "recv_bytes"),
)
"""Innermost functions of threads that wait."""


@dataclass
class Spent:
    """Costs of one picture: ``wall`` seconds and ``cores``, the core-seconds of all processes."""

    wall: float
    cores: float


@dataclass
class Seen(Spent):
    """A served picture from the first request to its final state.

    ``lit`` are the seconds to the first picture without provisional parts. ``pictures`` are all
    that were shown: seconds, and linear RGB (h, w, 3) float32 of the surface.
    """

    lit: float
    reported: float
    tasks: float
    paths: float
    duplicates: float
    pictures: list[tuple[float, np.ndarray]] = field(default_factory=list)


@part(size=512, repeats=3)
@click.option("--only", multiple=True, help="Part of a scene's name.")
@click.option("--views", type=click.IntRange(1), default=8, show_default=True, help="In each row.")
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option("--error", default=0.02, show_default=True, help="Error that pictures are to reach.")
@click.option("--peers/--no-peers", default=True, help="Race against Mitsuba if it is installed.")
def cold(
    size: int,
    repeats: int,
    only: tuple[str, ...],
    views: int,
    workers: int,
    error: float,
    peers: bool,
) -> Measurement:
    """One cold view, and the views after it, next to Mitsuba to equal true error."""
    found = dict[str, Mapping[str, Any]]()
    for subject in (each for each in SEVEN if wanted(each.name, only)):
        with tempfile.TemporaryDirectory() as folder:
            race = ColdRace(subject, Path(folder), size, workers, error)
            found[subject.name] = race.figures(repeats, views, peers)
        click.echo(table_of({subject.name: found[subject.name]}), err=True)
    figures = {
        f"{scene}: {name}": value for scene, each in found.items() for name, value in each.items()
    }
    return Measurement(
        f"A cold view, and those after it, {size} × {size}", figures, table_of(found)
    )


def table_of(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The figures ``found`` of some scenes as Markdown: a column for each scene."""
    names = dict.fromkeys(name for figures in found.values() for name in figures)
    rows = (
        (name, *(shown(figures[name]) if name in figures else "" for figures in found.values()))
        for name in names
    )
    return markdown(("figure", *found), rows)


class ColdRace:
    """One scene's cold view, its row of views, and what a path tracer takes to the same error."""

    def __init__(
        self, subject: Subject, folder: Path, size: int, workers: int, error: float
    ) -> None:
        """Write the scene of a ``subject`` to a file in ``folder``, which stores go to as well."""
        self.subject = subject
        self.folder = folder
        self.size = size
        self.workers = workers
        self.error = error
        self.file = write_scene(subject, folder)

    def figures(self, repeats: int, views: int, peers: bool) -> dict[str, Any]:
        """All figures of the scene: medians of ``repeats`` cold views."""
        cold_views = []
        rows: dict[str, list[Seen]] = {}
        for number in range(repeats):
            last = number == repeats - 1
            seen, rows = self.serve(f"served-{number}", views if last else 1)
            cold_views.append(seen)
        seen = sorted(cold_views, key=lambda each: each.wall)[len(cold_views) // 2]
        rendered = [self.render(f"rendered-{number}") for number in range(repeats)]
        scene = scene_of(self.subject, bounces=BOUNCES)
        errors = TrueErrors(scene, self.view(scene))
        true = errors.of(seen.pictures[-1][1])
        found = {
            "served: first lit picture, s": seen.lit,
            "served: final, s": statistics.median(each.wall for each in cold_views),
            "served: core-s": statistics.median(each.cores for each in cold_views),
            "served: reported error": seen.reported,
            "served: true error": true,
            "served: paths a task": seen.paths / max(seen.tasks, 1.0),
            "served: tasks": seen.tasks,
            "served: duplicate tasks": seen.duplicates,
            "rendered: s": statistics.median(each.wall for each in rendered),
            "rendered: core-s": statistics.median(each.cores for each in rendered),
        }
        for name, row in rows.items():
            found |= row_figures(name, row, seen.cores)
        found |= self.account()
        if peers and mitsuba.installed() and mesh.installed() and mitsuba.usable(VARIANT):
            found |= self.compete(scene, errors, seen, found)
        return found

    def view(self, scene: Scene) -> View:
        """The view that all race for."""
        camera = scene.camera(FIRST_AZIMUTH, CAMERA["elevation"], CAMERA["distance"], CAMERA["fov"])
        return View(scene.isovalue, camera, width=self.size, height=self.size)

    def serve(self, name: str, views: int) -> tuple[Seen, dict[str, list[Seen]]]:
        """A cold view, and two rows of views after it if there is more than one."""
        with serving(str(self.file), str(self.folder / name), self.workers) as server:
            time.sleep(SETTLING_SECONDS)
            seen = self.watch(server, {"azimuth": FIRST_AZIMUTH})
            rows: dict[str, list[Seen]] = {}
            if views > 1:
                cameras = [FIRST_AZIMUTH + AZIMUTH_STEP * i for i in range(1, views)]
                rows["cameras"] = [self.watch(server, {"azimuth": each}) for each in cameras]
                turns = [TURN_STEP * i for i in range(1, views)]
                first = {"azimuth": FIRST_AZIMUTH}
                if self.subject.light != "constant light":
                    rows["turns"] = [self.watch(server, {**first, "yaw": each}) for each in turns]
        return seen, rows

    def watch(self, server: Served, knobs: Mapping[str, Any]) -> Seen:
        """Ask for a view until its picture is final, as a script would that shows each picture."""
        asked = {**CAMERA, **knobs, "width": self.size, "height": self.size}
        asked |= {"f": "npy", "wait_ms": POLL_MS, "max_error": self.error}
        before = counts(server)
        cores = core_seconds(server.process.pid)
        begun = time.perf_counter()
        seen = Seen(0.0, 0.0, math.inf, math.nan, 0.0, 0.0, 0.0)
        while seen.wall < LONGEST_WAIT:
            answer = server.client.get(f"{server.path}/frame", params=asked).raise_for_status()
            seen.wall = time.perf_counter() - begun
            picture = np.load(BytesIO(answer.content))
            if not seen.pictures or not np.array_equal(seen.pictures[-1][1], picture[..., :3]):
                seen.pictures.append((seen.wall, picture[..., :3].copy()))
            if not (picture[..., 4] == 1).any():
                seen.lit = min(seen.lit, seen.wall)
            if answer.headers["isogi-provisional"] == "?0":
                break
        else:
            raise click.ClickException(f"{self.subject.name} is not final after {LONGEST_WAIT} s.")
        seen.cores = core_seconds(server.process.pid) - cores
        seen.reported = float(re.split("[;,]", answer.headers["isogi-error"])[0])
        after = counts(server)
        seen.tasks, seen.paths, seen.duplicates = (
            later - earlier for earlier, later in zip(before, after, strict=True)
        )
        return seen

    def render(self, name: str) -> Spent:
        """``isogi render`` of the view, as a process of its own."""
        options = [f"--azimuth={FIRST_AZIMUTH}", f"--width={self.size}", f"--height={self.size}"]
        options += [f"--{key}={value}" for key, value in CAMERA.items()]
        options += [f"--target-error={self.error}", f"--store={self.folder / name}"]
        output = str(self.folder / f"{name}.png")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        begun = time.perf_counter()
        subprocess.run(
            [
                sys.executable,
                "-m",
                "isogi_server",
                "render",
                str(self.file),
                "-o",
                output,
                *options,
            ],
            check=True,
            capture_output=True,
        )
        wall = time.perf_counter() - begun
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cores = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return Spent(wall, cores)

    def account(self) -> dict[str, Any]:
        """Shares of the processor's time by kind, of a further cold view; nothing without py-spy.

        The sampler counts threads that wait for the interpreter as busy, so shares compare and
        seconds do not.
        """
        spy = Path(sys.executable).with_name("py-spy")
        if not spy.exists():
            return {}
        stacks = self.folder / "stacks.raw"
        with serving(str(self.file), str(self.folder / "spied"), self.workers) as server:
            time.sleep(SETTLING_SECONDS)
            command = [str(spy), "record", "-s", "-f", "raw", "-o", str(stacks)]
            command += ["-p", str(server.process.pid)]
            with subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            ) as sampler:
                time.sleep(1.0)
                self.watch(server, {"azimuth": FIRST_AZIMUTH})
                sampler.send_signal(2)
                sampler.wait(60)
        return {f"share: {kind}": share for kind, share in shares(stacks).items()}

    def compete(
        self, scene: Scene, errors: "TrueErrors", seen: Seen, found: Mapping[str, Any]
    ) -> dict[str, Any]:
        """What Mitsuba takes to isogi's true error, and what its denoised picture shows."""
        peer = Mitsuba(scene, errors.view)
        tracer = peer.tracers[SAMPLERS[1]]
        best = peer.converge(errors.view, errors.reference.on)
        reached = peer.reach(SAMPLERS[1], best, found["served: true error"])
        figures = {
            "mitsuba: s to the same error": reached.cost.wall,
            "mitsuba: core-s": reached.cost.processor,
            "mitsuba: paths a pixel": reached.samples,
            "mitsuba / served": reached.cost.wall / found["served: final, s"],
            "mitsuba / served, core-s": reached.cost.processor / found["served: core-s"],
            "mitsuba / rendered": reached.cost.wall / found["rendered: s"],
        }
        if importlib.util.find_spec("pyoidn") is not None:
            seconds, error = denoised(tracer, best)
            figures |= {
                "denoised: s": seconds,
                "denoised: error": error,
                "served at that moment: error": errors.at(seen, seconds),
            }
        return figures


class TrueErrors:
    """Errors of isogi's pictures of a view against long paths from each pixel."""

    def __init__(self, scene: Scene, view: View) -> None:
        """Trace the reference of a ``view``."""
        self.view = view
        with tempfile.TemporaryDirectory() as store:
            renderer = make_renderer(with_bounces(scene), store)
            self.reference: Reference = trace_reference(renderer, view, REFERENCE_PATHS)

    def of(self, picture: np.ndarray) -> float:
        """The relative RMSE of a picture (h, w, 3), without the reference's noise."""
        wrong = relative_rmse(picture, self.reference.mean, self.reference.on)
        return without(wrong, self.reference.noise)

    def at(self, seen: Seen, seconds: float) -> float:
        """The error of what was shown after so many ``seconds``; infinite before any picture."""
        before = [picture for when, picture in seen.pictures if when <= seconds]
        if not before:
            return math.inf
        return self.of(before[-1])


def write_scene(subject: Subject, folder: Path) -> Path:
    """The scene file of a subject, in ``folder``."""
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    light = dict(LIGHTS[subject.light])
    if "file" in light:
        light["file"] = str(data / light["file"])
    lines = [
        f"volume = {json.dumps(str(data / VOLUMES[subject.volume]))}",
        f"isovalue = {subject.isovalue}",
        "albedo = 0.7",
        f"bounces = {BOUNCES}",
        "[[lights]]",
        *(f"{key} = {json.dumps(value)}" for key, value in light.items()),
    ]
    path = folder / f"{subject.folder}.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def counts(server: Served) -> tuple[float, float, float]:
    """Tasks done, paths of texels, and duplicate tasks so far."""
    return (
        server.metric("isogi_tasks_done_total"),
        server.metric("isogi_paths_total"),
        server.metric("isogi_tasks_duplicate_total"),
    )


def core_seconds(pid: int) -> float:
    """Processor seconds of a process and all its descendants, those that have ended included."""
    parent = psutil.Process(pid)
    total = 0.0
    for process in (parent, *parent.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            total += times.user + times.system + times.children_user + times.children_system
    return total


def row_figures(name: str, row: Sequence[Seen], first: float) -> dict[str, Any]:
    """Costs of the views after the first one, in core-seconds and over those of the ``first``, and
    seconds to the first picture of each without provisional parts.
    """
    cores = [each.cores for each in row]
    return {
        f"{name}: core-s a view": statistics.fmean(cores),
        f"{name}: worst over the first": max(cores) / first,
        f"{name}: mean over the first": statistics.fmean(cores) / first,
        f"{name}: median over the first": statistics.median(cores) / first,
        f"{name}: seconds a view": statistics.fmean(each.wall for each in row),
        f"{name}: first lit picture, s": statistics.median(each.lit for each in row),
    }


def shares(stacks: Path) -> dict[str, float]:
    """Shares of samples by kind, of the raw ``stacks`` that py-spy wrote."""
    found: Counter[str] = Counter()
    for line in stacks.read_text(encoding="utf-8").splitlines():
        stack, count = line.rsplit(" ", 1)
        innermost = stack.rsplit(";", 1)[-1]
        if any(word in innermost for word in IDLE):
            continue
        found[kind_of(stack)] += int(count)
    total = sum(found.values())
    return {kind: count / total for kind, count in found.most_common()}


def kind_of(stack: str) -> str:
    """The kind of work that a stack shows."""
    for kind, words in KINDS:
        if any(word in stack for word in words):
            return kind
    return "other"


def denoised(tracer: Any, best: Converged) -> tuple[float, float]:
    """Seconds and error of a picture of DENOISED_PATHS paths a pixel, denoised with guides."""
    import mitsuba as library  # noqa: PLC0415
    import pyoidn  # noqa: PLC0415

    guide = library.load_dict({"type": "aov", "aovs": "a:albedo,n:sh_normal"})

    def _guides() -> tuple[np.ndarray, np.ndarray]:
        image = np.array(library.render(tracer.scene, integrator=guide, spp=GUIDE_PATHS, seed=9))
        return np.ascontiguousarray(image[..., -6:-3]), np.ascontiguousarray(image[..., -3:])

    _guides()  # compiles
    begun = time.perf_counter()
    picture = draw(tracer, DENOISED_PATHS, 5)
    albedo, normals = _guides()
    colours = np.ascontiguousarray(picture[..., :3])
    clean = pyoidn.denoise(colours, albedo=albedo, normal=normals, hdr=True)
    seconds = time.perf_counter() - begun
    return seconds, measured(best, np.concatenate([clean, picture[..., 3:]], axis=-1))
