"""Pictures of many views of a scene in a folder, for films and pages; pictures that exist are
not made again.
"""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.frame.frame import Frame
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import check_folder_writable, write_whole
from isogi_server.cli.film_path import at_step
from isogi_server.cli.render import (
    PACKED_PIXEL_BYTES,
    awaited,
    is_placed,
    seen_whole,
    trouble_of,
    working,
)
from isogi_server.parameters import FrameParams
from isogi_server.pictures import FORMAT_OF_SUFFIX, encode
from isogi_server.progress import Progress, left_text
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change, SceneVariant
from isogi_server.render.variants import Variants
from isogi_server.settings import Settings
from isogi_server.views import goal_of, turn_baked, view_of
from isogi_worker.progress import ASSUMED_WORK_RATIOS, TimeLeft

RECORD_WRITE_SECONDS = 1.0
"""Seconds between two writings of the list of pictures; after a crash, pictures that it lacks
are made again.
"""


OPEN_STEPS = 2
"""Steps of a series, and turns of light that is baked for each turn, that are open at a time, in
addition to the scene's.
"""


@dataclass(frozen=True)
class ReelRequest:
    """Pictures that a command asks for: the file or folder for them, and when a picture is good
    enough.

    A picture ends at the ``target_error``, or after ``seconds``; all of them end by the
    ``deadline``, in seconds since ``begun``.
    """

    output: Path
    target_error: float | None = None
    seconds: float | None = None
    deadline: float | None = None
    clock: Callable[[], float] = time.monotonic
    begun: float = field(default_factory=time.monotonic)

    def share(self, pictures: int) -> float | None:
        """Return the seconds for the next picture if ``pictures`` are left; None if it may take
        any time.
        """
        if self.deadline is None:
            left = math.inf
        else:
            left = max(self.deadline - self.passed, 0.0) / pictures
        share = min(left, math.inf if self.seconds is None else self.seconds)
        return None if math.isinf(share) else share

    @property
    def passed(self) -> float:
        """Return the seconds since the work was begun."""
        return self.clock() - self.begun


class Reel:
    """The pictures of ``shots`` in a ``folder``, with ``facts`` about each that is made."""

    def __init__(self, folder: Path, scene: Scene, shots: Mapping[str, FrameParams]) -> None:
        """Find the pictures that exist; ``shots`` are parameters by file name. Raises ViewError
        if the folder holds other pictures.
        """
        self.shots = shots
        self._folder = folder
        self._scene = scene
        self._list = folder / "pictures.json"
        # Each step of a series has another surface: the camera sees the whole volume then.
        moving = len({shot.time for shot in shots.values()}) > 1
        self._placed = moving or any(is_placed(shot.model_fields_set) for shot in shots.values())
        # The digest of all that pictures depend on tells if the folder belongs to the same request.
        asked = [[name, shot.model_dump(mode="json")] for name, shot in shots.items()]
        whole = [scene.digest, scene.default_exposure, self._placed, asked]
        self._digest = blake2b(json.dumps(whole).encode(), digest_size=12).hexdigest()
        self.facts: dict[str, dict[str, Any]] = {}
        self.trouble = ""
        self._written = -math.inf
        if self._list.exists():
            try:
                kept = json.loads(self._list.read_text(encoding="utf-8"))
            except ValueError as error:
                raise ViewError(
                    f"{self._list} is damaged: delete that file, and its pictures are drawn again."
                ) from error
            if kept["asked"] != self._digest:
                raise ViewError(
                    f"{folder} holds pictures of something else: name another one, or delete "
                    "that folder."
                )
            self.facts = {
                name: facts for name, facts in kept["pictures"].items() if self.path(name).exists()
            }
        self._kept = len(self.facts)

    def path(self, name: str) -> Path:
        """Return the path of a picture."""
        return self._folder / name

    @property
    def missing(self) -> list[str]:
        """Return the names of pictures that are not made yet."""
        return [name for name in self.shots if name not in self.facts]

    def keep(self, name: str, picture: bytes, facts: Mapping[str, Any]) -> None:
        """Write a picture, and note the facts about it."""
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(self.path(name), picture)
        self.facts[name] = dict(facts)
        if time.monotonic() - self._written >= RECORD_WRITE_SECONDS:
            self._write_list()

    def _write_list(self) -> None:
        """Write the list of pictures and their facts."""
        write_whole(
            self._list,
            json.dumps({"asked": self._digest, "pictures": self.facts}, indent=1).encode(),
        )
        self._written = time.monotonic()

    def summary(self) -> dict[str, Any]:
        """Return the quality of all pictures: the share that is final, the target, the median
        and the largest error, and the reason why no more light came, if there is one.
        """
        errors = [facts["error"] for facts in self.facts.values()]
        goal = goal_of(self._scene, next(iter(self.shots.values())).max_error)
        final = sum(facts["final"] for facts in self.facts.values()) / len(self.shots)
        worst = {"median": float(np.median(errors)), "worst": max(errors)}
        return {"final": final, "target_error": goal.error, "error": worst, "trouble": self.trouble}

    @property
    def about(self) -> dict[str, Any]:
        """Return the name of the scene, the number of pictures, of kept ones, and their size."""
        first = next(iter(self.shots.values()))
        count = {"pictures": len(self.shots), "kept": self._kept}
        return {"scene": self._scene.name, **count, "width": first.width, "height": first.height}

    def shoot(self, request: ReelRequest, settings: Settings) -> None:
        """Make the pictures that are missing; ``trouble`` then tells why some are not final. Raises
        UnwritableError before any work, StoreError and WorkersError.
        """
        if not self.missing:
            return
        pixels = sum(self.shots[name].width * self.shots[name].height for name in self.missing)
        check_folder_writable(self._folder, PACKED_PIXEL_BYTES * pixels)
        with working(self._scene, settings) as engine, Progress("rendering", "picture") as bar:
            try:
                self._shoot(engine, request, settings, bar)
                self.note_trouble(engine)
            finally:
                if self.facts:
                    self._write_list()

    def note_trouble(self, engine: RenderEngine) -> None:
        """Note why the ``engine`` bakes no more light, if pictures are not final for that."""
        final = all(facts["final"] for facts in self.facts.values())
        self.trouble = "" if final else trouble_of(engine)

    def _shoot(
        self, engine: RenderEngine, request: ReelRequest, settings: Settings, bar: Progress
    ) -> None:
        """Make the missing pictures one after the other, with a bar."""
        missing = self.missing
        shots = self.shots
        variants = Variants(engine, lambda _: None, most=OPEN_STEPS)
        bar.show(0, len(missing))
        # All pictures share one target and distance, at which the whole surface is visible.
        if not self._placed:
            whole = seen_whole(engine.renderer(self._scene.id), list(shots.values()), settings)
            shots = dict(zip(shots, whole, strict=True))
        spent: list[float] = []
        for done, name in enumerate(missing):
            begun = request.clock()
            shot = shots[name]
            seconds = request.share(len(missing) - done)
            scene = self._shown(variants, shot)
            step = nullcontext() if scene is self._scene else at_step(scene.volume.moment[0])
            with step:
                view = view_of(scene, shot, settings)
            # Draw the picture with its share of the time.
            later = time_of_others(spent, len(missing) - done - 1)
            show = partial(self._show, engine, scene, shot, bar, (done, len(missing)), later)
            frame = awaited(engine, scene.id, view, goal_of(scene, shot.max_error), seconds, show)
            if shot.exposure is None:
                exposure = self._scene.default_exposure
            else:
                exposure = shot.exposure
            picture = encode(frame, FORMAT_OF_SUFFIX[self.path(name).suffix], exposure, shot)
            self.keep(name, picture, {"error": frame.total.likely, "final": frame.final})
            spent.append(request.clock() - begun)
            bar.show(done + 1, len(missing), time_of_others(spent, len(missing) - done - 1))

    def _show(
        self,
        engine: RenderEngine,
        scene: Scene,
        shot: FrameParams,
        bar: Progress,
        counts: tuple[int, int],
        later: TimeLeft | None,
        frame: Frame,
    ) -> None:
        """Draw on the bar the number of pictures done, and the time for this picture and the
        ``later`` ones.
        """
        this_one = engine.time_left(scene.id, frame, goal_of(scene, shot.max_error))
        if this_one and later:
            bar.show(*counts, this_one.plus(later))
        elif this_one and not frame.final:
            bar.show(*counts, note=f"this one: {left_text(this_one)}")

    def _shown(self, variants: Variants, shot: FrameParams) -> Scene:
        """Return the scene at the step of its series, and in the turned light, that a ``shot`` asks
        for; the scene itself if it needs no other. Raises ParameterError.
        """
        change = Change(time=shot.time, turn=turn_baked(self._scene, shot))
        variant = SceneVariant.of(self._scene, change)
        if variant.any:
            return variants.make(self._scene, variant, None)
        return self._scene


def time_of_others(spent: Sequence[float], count: int) -> TimeLeft | None:
    """Estimate the time for ``count`` further pictures from the seconds ``spent`` on each so far;
    None before there are two.

    The first picture is not counted, as the others reuse its light.
    """
    if len(spent) < 2:
        return None
    work = count * sum(spent[1:]) / (len(spent) - 1)
    return TimeLeft.of(work, ASSUMED_WORK_RATIOS)


def quality_line(facts: Mapping[str, Any], what: str) -> str:
    """Return the quality of the pictures as text for a person; ``what`` names the pictures."""
    size = f"{facts['pictures']} {what} of {facts['width']} × {facts['height']}"
    error = f"error {facts['error']['median']:.4f}, at worst {facts['error']['worst']:.4f}"
    return (
        f"{facts['file']}: {size}, {facts['final']:.0%} final at {facts['target_error']:g}, {error}"
    )
