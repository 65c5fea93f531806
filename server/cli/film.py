"""``isogi film``: the frames of a film, each as good as asked, as pictures in a folder or as a movie."""

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from isogi_core.errors import ViewError
from isogi_core.model.shine import SHINE_KNOBS
from isogi_core.plan.first_view import front_of
from isogi_core.plan.scene import Scene
from server.cli.documents import document_in
from server.cli.film_path import film_path, view_in, views_in
from server.cli.first_camera import is_placed
from server.cli.movie import FRAMES, check_movie, write_movie
from server.cli.reel import Budget, Reel, said
from server.cli.series import steps_in
from server.errors import ParameterError
from server.parameters import FrameParams, read
from server.pictures import smoothed
from server.progress import open_scene
from server.settings import Settings
from server.views import view_of

MOST_FRAMES = 100_000
"""Frames of a film, at most."""


@dataclass(frozen=True)
class Wishes:
    """What is to be filmed: the file or folder, keyframes, seconds of film, and when a frame is good enough.

    A frame ends at the ``target_error``, or after ``seconds``; all of them by the ``deadline``, also in seconds. Of a
    series the film goes through the steps that ``times`` names, each as long as the others.
    """

    output: Path
    views: tuple[str, ...] = ()
    views_file: Path | None = None
    length: float = 10.0
    fps: float = 24.0
    target_error: float | None = None
    seconds: float | None = None
    deadline: float | None = None
    times: str | None = None

    @property
    def is_movie(self) -> bool:
        """Whether the film is one file, and no folder of pictures."""
        return bool(self.output.suffix)

    @property
    def folder(self) -> Path:
        """Where the pictures are kept."""
        return self.output.with_name(f"{self.output.name}.frames") if self.is_movie else self.output


def film(target: str, wishes: Wishes, knobs: Mapping[str, str], settings: Settings) -> dict[str, Any]:
    """Render the frames that are not there yet, make the movie of all, and say how good they are.

    Raises SceneError, VolumeError, LightError, ViewError and LibraryError before anything is begun, StoreError,
    WorkersError and OSError later.
    """
    begun = time.monotonic()
    if not wishes.output.parent.is_dir():
        raise ViewError(f"There is no folder {wishes.output.parent} for {wishes.output.name}: make it first.")
    views = keyframes(wishes)
    scene = open_scene(variant_of(target, views), settings)
    shots = shots_of(scene, wishes, views, knobs)
    size = {"width": shots[0].width, "height": shots[0].height}
    if wishes.is_movie:
        check_movie(wishes.output, **size)
    for shot in shots:
        view_of(scene, shot, settings)
    reel = Reel(wishes.folder, scene, {FRAMES % n: shot for n, shot in enumerate(shots, 1)})
    kept = len(reel.facts)
    if reel.missing:
        reel.shoot(Budget(wishes.seconds, wishes.deadline, begun), settings)
    if wishes.is_movie:
        write_movie(wishes.output, [reel.path(name) for name in reel.shots], wishes.fps)
        shutil.rmtree(wishes.folder)
    about = {"file": str(wishes.output), "scene": scene.name, "pictures": len(shots), "kept": kept, **size}
    return {**about, "fps": wishes.fps, **reel.summary(), "seconds": time.monotonic() - begun}


def keyframes(wishes: Wishes) -> list[dict[str, str]]:
    """The parameters of each view that is given. Raises ParameterError where one is none, or alone."""
    views = [view_in(text) for text in wishes.views]
    if wishes.views_file is not None:
        views += views_in(document_in(wishes.views_file, str.split))
    if len(views) == 1:
        raise ParameterError("One view is no path: give two or more.", "view")
    return views


def variant_of(target: str, views: Sequence[Mapping[str, str]]) -> str:
    """The ``target`` in the environment, with the cut, at the time, of the material and without the labels that all
    views name.

    ParameterError where one names other surfaces.
    """
    if any("surfaces" in view for view in views):
        raise ParameterError("A film shows the scene's own surfaces: change its [[surfaces]].", "surfaces")
    for key in ("environment", "cut", "time", "hide", "material"):
        named = {view.get(key, "") for view in views}
        if len(named) == 1 and named != {""}:
            target += f"{'&' if '#' in target else '#'}{key}={quote(named.pop())}"
    return target


def shots_of(
    scene: Scene, wishes: Wishes, views: Sequence[Mapping[str, str]], knobs: Mapping[str, str]
) -> list[FrameParams]:
    """The parameters of each frame along the ``views``; ParameterError where frames are none, or too many."""
    count = round(wishes.length * wishes.fps)
    if not 1 <= count <= MOST_FRAMES:
        raise ParameterError(f"length × fps must be 1 to {MOST_FRAMES:,} frames, not {count:,}.", "length")
    own = {"isovalue": repr(scene.isovalue), "exposure": repr(scene.default_exposure)}
    if not any(is_placed(view) for view in (knobs, *views)):
        own["azimuth"], own["elevation"] = map(repr, front_of(scene.volume, scene.lighting.room.any))
    if scene.surfaces.colours is None:
        own["albedo"] = ",".join(map(repr, scene.surfaces.albedo))
    if scene.surfaces.shine is not None:
        own |= {name: f"{getattr(scene.surfaces.shine, field)}" for name, field in SHINE_KNOBS.items()}
    own |= {"glow": "1.0"} if scene.lighting.glowing.any else {}
    own |= {"max_error": repr(wishes.target_error or scene.target_error), "f": "png"}
    path = film_path(knobs, views, own, count, still=wishes.times is not None)
    if wishes.times is not None:
        steps = steps_in(wishes.times, scene)
        path = [{**shot, "time": str(steps[n * len(steps) // count])} for n, shot in enumerate(path)]
    shots = (read(FrameParams, {**shot, "max_error": own["max_error"], "f": "png"}.items()) for shot in path)
    return [smoothed(shot, "png") for shot in shots]


def filmed(facts: Mapping[str, Any]) -> str:
    """What ``film`` did, for a person."""
    return said(facts, "frames")
