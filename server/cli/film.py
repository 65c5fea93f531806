"""``isogi film``: the frames of a film, each as good as asked, as pictures in a folder or as a movie."""

import json
import math
import shutil
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import write_whole
from server.cli.film_path import film_path, view_in, views_in
from server.cli.movie import FRAMES, check_movie, write_movie
from server.cli.render import awaited
from server.errors import ParameterError
from server.parameters import FrameParams, read, view_of
from server.pictures import encode
from server.progress import Progress, open_scene
from server.render.engine import RenderEngine
from server.render.resources import root_of
from server.settings import Settings

MOST_FRAMES = 100_000
"""Frames of a film, at most."""


@dataclass(frozen=True)
class Wishes:
    """What is to be filmed: the file or folder, keyframes, seconds of film, and when a frame is good enough.

    A frame ends at the ``target_error``, or after ``seconds``; all of them by the ``deadline``, also in seconds.
    """

    output: Path
    views: tuple[str, ...] = ()
    views_file: Path | None = None
    length: float = 10.0
    fps: float = 24.0
    target_error: float | None = None
    seconds: float | None = None
    deadline: float | None = None

    @property
    def is_movie(self) -> bool:
        """Whether the film is one file, and no folder of pictures."""
        return bool(self.output.suffix)

    @property
    def folder(self) -> Path:
        """Where the pictures are kept."""
        return self.output.with_name(f"{self.output.name}.frames") if self.is_movie else self.output


class Reel:
    """The frames of a film in a ``folder``, and what is known of each; those of the same film are gone on from."""

    def __init__(self, folder: Path, digest: str) -> None:
        """Look at what is there. Raises ViewError where the folder holds another film."""
        self._folder, self._digest, self._list = folder, digest, folder / "film.json"
        self.frames: dict[int, dict[str, Any]] = {}
        if self._list.exists():
            kept = json.loads(self._list.read_text(encoding="utf-8"))
            if kept["film"] != digest:
                raise ViewError(f"{folder} holds frames of another film: name another file, or delete that folder.")
            self.frames = {int(n): facts for n, facts in kept["frames"].items() if self.path(int(n)).exists()}

    def path(self, n: int) -> Path:
        """The picture of a frame, counted from 0."""
        return self._folder / (FRAMES % (n + 1))

    def keep(self, n: int, picture: bytes, facts: Mapping[str, Any]) -> None:
        """Write a frame, and what is known of it."""
        self._folder.mkdir(exist_ok=True)
        write_whole(self.path(n), picture)
        self.frames[n] = dict(facts)
        document = {"film": self._digest, "frames": {str(each): self.frames[each] for each in sorted(self.frames)}}
        write_whole(self._list, json.dumps(document, indent=1).encode())


def film(target: str, wishes: Wishes, knobs: Mapping[str, str], settings: Settings) -> dict[str, Any]:
    """Render the frames that are not there yet, make the movie of all, and say how good they are.

    Raises SceneError, VolumeError, LightError, ViewError and LibraryError before anything is begun, StoreError,
    WorkersError and OSError later.
    """
    begun = time.monotonic()
    if not wishes.output.parent.is_dir():
        raise ViewError(f"There is no folder {wishes.output.parent} for {wishes.output.name}: make it first.")
    scene = open_scene(target, settings)
    shots = shots_of(scene, wishes, knobs)
    size = {"width": shots[0].width, "height": shots[0].height}
    if wishes.is_movie:
        check_movie(wishes.output, **size)
    for shot in shots:
        view_of(scene, shot, settings)
    reel = Reel(wishes.folder, digest_of(scene, shots))
    kept = len(reel.frames)
    if kept < len(shots):
        shoot(scene, shots, reel, Budget(wishes.seconds, wishes.deadline, begun), settings)
    if wishes.is_movie:
        write_movie(wishes.output, [reel.path(n) for n in range(len(shots))], wishes.fps)
        shutil.rmtree(wishes.folder)
    errors = [facts["error"] for facts in reel.frames.values()]
    return {
        "file": str(wishes.output),
        "scene": scene.name,
        "frames": len(shots),
        "kept": kept,
        **size,
        "fps": wishes.fps,
        "final": sum(facts["final"] for facts in reel.frames.values()) / len(shots),
        "target_error": wishes.target_error or scene.target_error,
        "error": {"median": float(np.median(errors)), "worst": max(errors)},
        "seconds": time.monotonic() - begun,
    }


def shots_of(scene: Scene, wishes: Wishes, knobs: Mapping[str, str]) -> list[FrameParams]:
    """The parameters of each frame; ParameterError where a view is none, or the frames are none or too many."""
    count = round(wishes.length * wishes.fps)
    if not 1 <= count <= MOST_FRAMES:
        raise ParameterError(f"length × fps must be 1 to {MOST_FRAMES:,} frames, not {count:,}.", "length")
    views = [view_in(text) for text in wishes.views]
    if wishes.views_file is not None:
        views += views_in(document_in(wishes.views_file))
    if len(views) == 1:
        raise ParameterError("One view is no path: give two or more.", "view")
    own = {"isovalue": repr(scene.isovalue), "exposure": repr(scene.default_exposure)}
    own["albedo"] = ",".join(map(repr, scene.albedo))
    own |= {"max_error": repr(wishes.target_error or scene.target_error), "f": "png"}
    path = film_path(knobs, views, own, count)
    return [read(FrameParams, {**shot, "max_error": own["max_error"], "f": "png"}.items()) for shot in path]


def document_in(file: Path) -> Any:
    """What is in a JSON or TOML file, or the lines of any other. Raises ParameterError."""
    try:
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".json":
            return json.loads(text)
        return tomllib.loads(text) if file.suffix == ".toml" else [line for line in text.split() if line]
    except ValueError as error:
        raise ParameterError(f"{file.name} cannot be read: {error}.", "views-file") from None


def digest_of(scene: Scene, shots: Sequence[FrameParams]) -> str:
    """Hex name of all that frames show, and of how good they are to be."""
    asked = [shot.model_dump(mode="json", exclude_unset=True) for shot in shots]
    return blake2b(json.dumps([scene.digest, asked]).encode(), digest_size=12).hexdigest()


@dataclass(frozen=True)
class Budget:
    """Seconds that frames may take: each so many, and all of them so many since they were ``begun``."""

    each: float | None
    all: float | None
    begun: float
    clock: Callable[[], float] = time.monotonic

    def share(self, frames: int) -> float | None:
        """Seconds for the next frame where so many are left; None for as long as it takes."""
        left = math.inf if self.all is None else max(self.begun + self.all - self.clock(), 0.0) / frames
        share = min(left, math.inf if self.each is None else self.each)
        return None if math.isinf(share) else share


def shoot(scene: Scene, shots: Sequence[FrameParams], reel: Reel, budget: Budget, settings: Settings) -> None:
    """Render the frames that are not on the ``reel`` yet. Raises StoreError and WorkersError."""
    missing = [n for n in range(len(shots)) if n not in reel.frames]
    place, memory = (root_of(settings), settings.workers, settings.scheduler), settings.memory_mb << 20
    with (
        closing(RenderEngine([scene], *place, memory, projected=settings.projected_mb << 20)) as engine,
        Progress("filming", "frame") as bar,
    ):
        engine.start()
        for done, n in enumerate(missing):
            shot, seconds = shots[n], budget.share(len(missing) - done)
            frame = awaited(engine, scene.id, view_of(scene, shot, settings), shot.max_error, seconds)
            exposure = scene.default_exposure if shot.exposure is None else shot.exposure
            facts = {"error": frame.total.likely, "final": frame.final}
            reel.keep(n, encode(frame, "png", exposure, shot.overlay), facts)
            bar.count(done + 1, len(missing))


def filmed(facts: Mapping[str, Any]) -> str:
    """What ``film`` did, for a person."""
    size = f"{facts['frames']} frames of {facts['width']} × {facts['height']}"
    error = f"error {facts['error']['median']:.4f}, at worst {facts['error']['worst']:.4f}"
    return f"{facts['file']}: {size}, {facts['final']:.0%} final at {facts['target_error']:g}, {error}"
