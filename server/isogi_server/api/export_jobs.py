"""Exports over HTTP: jobs that bake an isosurface and make a file with its light."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar
from uuid import NAMESPACE_URL, uuid5

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.files.spelling import shortest
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_server.api.prewarm_jobs import Prewarm, finish_thread, lower_priority
from isogi_server.api.service import Service
from isogi_server.errors import ForbiddenError, UnknownJobError
from isogi_server.exports.lit_files import (
    check_coefficients,
    check_lattice,
    coefficient_count,
    expected_bytes,
    is_of_volume,
    no_surface,
    places_to_light,
    write_lit,
)
from isogi_server.parameters import ExportParams
from isogi_server.prewarm.order import PrewarmOrder, order_of
from isogi_server.render.jobs import Job, Result
from isogi_server.views import view_of

TYPES = {".glb": "model/gltf-binary", ".usdz": "model/vnd.usdz+zip", ".obj": "model/obj"}
"""Media types of file formats that have one."""

BAKED = 0.9
"""Progress of an export when all its light is baked; the rest is for making the file."""

VOLUMES_WITHHELD = (
    "This server hands out no voxels, and no light of chunks: export a mesh, such as f=glb, or "
    "have hand_out_voxels set."
)

Made = TypeVar("Made")

EXPORT_BYTES = 64 << 20
"""Bytes that the renderer of an export may keep."""


def begin(
    service: Service,
    scene: Scene,
    params: ExportParams,
    client: tuple[str, str] = ("", ""),
    request_key: str | None = None,
) -> Job:
    """Start the job that makes a file of a scene; ``client`` is its owner and address.

    A request that its client repeats under the same ``request_key`` is not carried out again: its
    job is returned, also if it has ended. Raises BusyError, ViewError, SceneError if the scene does
    not fit the format, and ForbiddenError for a volume if the server does not hand out voxels.
    """
    # Some formats hold the whole lattice, the others only a mesh of the surface.
    if is_of_volume(f".{params.f}") and not service.settings.hands_out_voxels:
        raise ForbiddenError(VOLUMES_WITHHELD)
    # Find errors now, so that the request is refused and no job fails later.
    view = view_of(scene, params.view, service.settings)
    scene.require_texels()
    if is_of_volume(f".{params.f}"):
        check_lattice(scene)
    if params.coefficients == "on":
        check_coefficients(scene, f".{params.f}")
    # Keys of different clients, and of different exports, are never the same.
    key = None
    if request_key is not None:
        named = (client[0], request_key, scene.id, params.model_dump_json())
        key = str(uuid5(NAMESPACE_URL, repr(named)))
        with suppress(UnknownJobError):
            return service.jobs.find(key)
    export = Export(service, scene, params, view, client[0])
    title = f"An export of {service.engine.variant(scene.id).base}"
    return service.jobs.begin("export", title, export.work, key, client)


def media_type(file: Path) -> str:
    """Return the media type of an exported file."""
    return TYPES.get(file.suffix, "application/octet-stream")


def reporter(job: Job) -> Callable[[int, int], None]:
    """Return a function by which threads report the points that are lit, and their number; the
    ``job`` is updated on this event loop.
    """
    loop = asyncio.get_running_loop()

    def report(done: int, total: int) -> None:
        share = BAKED + (1.0 - BAKED) * done / total
        loop.call_soon_threadsafe(job.report, share, f"Lighting: {done:,} of {total:,} points.")

    return report


@dataclass(eq=False)
class Export:
    """An export: its light is baked first, then a thread makes the file as ``params`` ask."""

    service: Service
    scene: Scene
    params: ExportParams
    view: View
    owner: str = ""
    cancelled: threading.Event = field(default_factory=threading.Event)

    async def work(self, job: Job) -> Iterable[Result]:
        """Bake the light and make the file; return when that has ended, even if cancelled.
        Raises FullError and ViewError.
        """
        exports = self.service.exports
        needed = await self._in_thread(self._check)
        if self._coefficients:
            rung = MAX_SAMPLES
        else:
            rung = FIRST_LEVEL
        # Bake the whole isosurface. Texels of exported coefficients get all samples, unless they
        # are good enough with fewer.
        prewarm = Prewarm(
            self.service, self.scene, self._order(), owner=self.owner, recorded=False, rung=rung
        )
        summary = await prewarm.carry_out(
            lambda share, text, left: job.report(BAKED * share, text, left)
        )
        # Make one file at a time, so that the check of the quota holds.
        async with exports.turn:
            exports.make_room({each.id for each in self.service.jobs.all()}, needed)
            own = self.service.engine.variant(self.scene.id).base
            output = exports.place(job.id, f"{own}-{shortest(self.view.isovalue)}{self._suffix}")
            await self._in_thread(partial(self._make, output, reporter(job)))
        good = (
            f"{summary.final:.0%} of its light final at a relative error of "
            f"{summary.target_error:g}"
        )
        return [Result(f"/v1/jobs/{job.id}/file", media_type(output), f"The file, {good}")]

    @property
    def _suffix(self) -> str:
        """Return the suffix of the file."""
        return f".{self.params.f}"

    @property
    def _coefficients(self) -> bool:
        """Return True if transfer coefficients are exported with the surface."""
        return self.params.coefficients == "on"

    def _order(self) -> PrewarmOrder:
        """Return the order to bake this isosurface from all directions."""
        params = self.params
        asked = {"target_error": params.max_error, "deadline": params.deadline}
        given = {name: value for name, value in asked.items() if value is not None}
        return order_of({"isovalues": [repr(self.view.isovalue)], "all_directions": True, **given})

    async def _in_thread(self, work: Callable[[], Made]) -> Made:
        """Run some work on a thread. If this task is cancelled, set ``cancelled``, which stops work
        that looks at it, and wait for the end of the work.
        """
        return await finish_thread(
            asyncio.get_running_loop().run_in_executor(None, work), self.cancelled
        )

    def _check(self) -> int:
        """Return the expected bytes of the file. Raises FullError if it is too large, and
        ViewError if a mesh would have no surface; a volume may be without one.
        """
        renderer = self.service.engine.renderer(self.scene.id)
        if self._coefficients:
            numbers = coefficient_count(renderer.caches.spec(self.view.shading))
        else:
            numbers = 0
        needed = expected_bytes(renderer.prepared, self.view.isovalue, self._suffix, numbers)
        # A mesh of no bytes has no vertex. The size of a volume file counts voxels: it is never 0.
        if not needed:
            raise no_surface(self.view.isovalue)
        self.service.exports.check(needed)
        return needed

    def _make(self, output: Path, report: Callable[[int, int], None]) -> None:
        """Make the file, on a thread of lower priority. Raises Cancelled, and VolumeError."""
        lower_priority()
        view = self.view
        exposure = self.params.exposure or self.scene.default_exposure
        with closing(Tiles(1)) as tiles:
            caches = self.service.engine.renderer(self.scene.id).caches
            renderer = Renderer(caches, tiles.cancelled_by(self.cancelled), EXPORT_BYTES)
            places = places_to_light(renderer, self._suffix, [(view.isovalue, view.isovalue)])
            write_lit(renderer, output, view, places, exposure, report, self._coefficients)
