"""``isogi render``: bake what one view needs, then write its picture."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isogi_core.errors import ViewError
from isogi_core.model.view import View
from server.facts import coverage_facts
from server.opening import open_scene
from server.params import FrameParams, read
from server.pictures import SUFFIXES, encode, format_for
from server.progress import progress_bar, show
from server.settings import Settings
from server.views import view_of
from worker.errors import WorkersError

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from server.studio import Studio
    from worker.outlook import TimeLeft

STEP = 2.0
"""Seconds between two looks at how far the baking is."""

PATIENCE = 120.0
"""Seconds without anything new after which the workers are taken for broken."""


def render(
    target: str,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    seconds: float | None = None,
) -> dict[str, Any]:
    """Write the picture of a view, named by ``knobs``, and tell how good it is and what it took.

    Ends when every pixel is final, or after ``seconds`` of baking. Raises SceneError, VolumeError,
    LightError and ViewError before anything is begun, StoreError, WorkersError and OSError later.
    """
    started = time.monotonic()
    form = format_of(output)
    scene = open_scene(target, settings)
    params = read(FrameParams, [*knobs.items(), ("f", form)])
    format_for(params, None)
    view = view_of(scene, params, settings)
    from server.store import root_of  # noqa: PLC0415 (kernels: bad input is told before they are compiled)
    from server.studio import Studio  # noqa: PLC0415

    place, memory = (root_of(settings), settings.workers, settings.scheduler), settings.memory_mb << 20
    with closing(Studio([scene], *place, memory, sharp=settings.sharp_mb << 20)) as studio:
        studio.start()
        frame = refine(studio, scene.id, view, params.max_error, seconds)
        left, paths = studio.time_left(scene.id, frame, params.max_error), studio.paths
    exposure = scene.default_exposure if params.exposure is None else params.exposure
    write(output, encode(frame, form, exposure, params.overlay))
    return {
        "file": str(output),
        "format": form,
        **frame_facts(frame, left),
        "target_error": params.max_error or scene.target_error,
        "final": frame.coverage["final"],
        "paths": paths,
        "stopped": "time" if frame.provisional else "target",
        "seconds": time.monotonic() - started,
    }


def frame_facts(frame: Frame, left: TimeLeft | None) -> dict[str, Any]:
    """Size, quality and version of a frame, and the time until it would be final."""
    size = {"width": frame.view.width, "height": frame.view.height}
    return {**size, **coverage_facts(frame, left).model_dump(), "version": frame.version}


def format_of(output: Path) -> str:
    """The format that the file's suffix names; ViewError for others and where the folder is missing."""
    if output.suffix.lower() not in SUFFIXES:
        raise ViewError(f"{output} names no picture format: end it in {', '.join(SUFFIXES)}.")
    if not output.parent.is_dir():
        raise ViewError(f"There is no folder {output.parent} for {output.name}: make it first.")
    return SUFFIXES[output.suffix.lower()]


def refine(studio: Studio, scene: str, view: View, max_error: float | None, seconds: float | None) -> Frame:
    """The frame once it is final or the time is spent; chunks are counted on a bar meanwhile.

    Raises WorkersError where the workers fail, or nothing has changed for PATIENCE seconds.
    """
    changed = time.monotonic()
    deadline = changed + seconds if seconds is not None else math.inf
    version = ""
    with progress_bar("baking", "chunk") as bar:
        while True:
            left = max(0.0, deadline - time.monotonic())
            frame = studio.frame(scene, view, max_error=max_error, wait=min(STEP, left))
            show(bar, frame.chunks_final, frame.chunks_needed, studio.time_left(scene, frame, max_error))
            now = time.monotonic()
            if not frame.provisional or now >= deadline:
                return frame
            if studio.trouble():
                raise WorkersError(studio.trouble())
            if frame.version != version:
                version, changed = frame.version, now
            elif now - changed > PATIENCE:
                raise WorkersError(no_light(studio))


def no_light(studio: Studio) -> str:
    """That nothing was baked for PATIENCE seconds, and why as far as is known."""
    why = " ".join(studio.unready()) or "The workers bake nothing new."
    return f"No light came for {PATIENCE:g} seconds. {why}"


def write(path: Path, data: bytes) -> None:
    """Write the file whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
