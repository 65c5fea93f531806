"""``isogi film``: the frames of a film as pictures in a folder, or as a movie.

FFmpeg writes MP4 and WebM; GIF and WebP need only Pillow.
"""

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from isogi_core.errors import ViewError
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import check_folder, check_writable
from isogi_server.answers import defaults
from isogi_server.cli.film_path import film_path, steps_in, view_in, views_in
from isogi_server.cli.loops import WRITERS, write_loop
from isogi_server.cli.reel import Reel, ReelRequest, quality_line
from isogi_server.cli.render import is_placed
from isogi_server.errors import LibraryError, ParameterError
from isogi_server.parameters import FrameParams, read
from isogi_server.pictures import smoothed
from isogi_server.progress import open_scene
from isogi_server.settings import Settings
from isogi_server.values import document_in
from isogi_server.views import check_view, with_first_view

MOST_FRAMES = 100_000
"""Frames of a film, at most."""

FRAME_FILE_NAME = "frame-%05d.png"
"""File names of a film's pictures, numbered from 1."""

MOVIE_CODECS = {
    ".mp4": ("-c:v", "libx264", "-crf", "16", "-preset", "slow", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-crf", "24", "-b:v", "0", "-row-mt", "1"),
}
"""Movie formats that FFmpeg writes, with options for codec and quality."""

MOVIE_COLOUR_OPTIONS = [
    "-vf",
    "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p",
    "-colorspace",
    "bt709",
]
MOVIE_COLOUR_OPTIONS += [
    "-color_primaries",
    "bt709",
    "-color_trc",
    "iec61966-2-1",
    "-color_range",
    "tv",
]
"""Tags that tell players the colour space of the pictures: sRGB, by the matrix of BT.709."""


@dataclass(frozen=True)
class FilmRequest(ReelRequest):
    """A film that a command asks for: keyframes, length in seconds, frames per second.

    ``times`` names steps of a series that the film goes through, each for the same time.
    """

    views: tuple[str, ...] = ()
    views_file: Path | None = None
    length: float = 10.0
    fps: float = 24.0
    times: str | None = None

    @property
    def is_movie(self) -> bool:
        """Return True if the film is one file, and not a folder of pictures."""
        return bool(self.output.suffix)

    @property
    def folder(self) -> Path:
        """Return the folder in which the pictures are kept."""
        if self.is_movie:
            return self.output.with_name(f"{self.output.name}.frames")
        return self.output


def film(
    target: str, request: FilmRequest, knobs: Mapping[str, str], settings: Settings
) -> dict[str, Any]:
    """Render the frames that are missing, and make the movie; return facts about its quality.

    Raises SceneError, VolumeError, LightError, ViewError and LibraryError before any work, and
    StoreError, WorkersError and OSError later.
    """
    # Check all input, and each frame, before the first is rendered.
    check_folder(request.output)
    views = keyframes(request)
    scene = open_scene(variant_of(target, views), settings)
    shots = shots_of(scene, request, views, knobs)
    if request.is_movie:
        check_movie(request.output, shots[0].width, shots[0].height)
    for shot in shots:
        check_view(scene, shot, settings)
    reel = Reel(
        request.folder, scene, {FRAME_FILE_NAME % n: shot for n, shot in enumerate(shots, 1)}
    )
    if request.is_movie:
        check_writable(request.output)
    reel.shoot(request, settings)
    if request.is_movie:
        write_movie(request.output, [reel.path(name) for name in reel.shots], request.fps)
        shutil.rmtree(request.folder)
    facts = {"file": str(request.output), **reel.about, "fps": request.fps, **reel.summary()}
    return {**facts, "seconds": request.passed}


def keyframes(request: FilmRequest) -> list[dict[str, str]]:
    """Return the parameters of each keyframe. Raises ParameterError if one cannot be read, or
    if there is a single one.
    """
    views = [view_in(text) for text in request.views]
    if request.views_file is not None:
        views += views_in(document_in(request.views_file, str.split))
    if len(views) == 1:
        raise ParameterError("One view is no path: give two or more.", "view")
    return views


def variant_of(target: str, views: Sequence[Mapping[str, str]]) -> str:
    """Return the ``target`` with the environment, cut, time, smoothing, hidden labels and material
    that all views share, as the fragment of its address: ``a.nhdr#cut=…&time=3``.

    Raises ParameterError if a view names surfaces: a film shows those of the scene.
    """
    if any("surfaces" in view for view in views):
        raise ParameterError(
            "A film shows the scene's own surfaces: change its [[surfaces]].", "surfaces"
        )
    # A change that all views share becomes part of the target, so that the film has a single scene.
    # Views that differ in one are refused by ``film_path``.
    for key in ("environment", "cut", "time", "smooth", "hide", "material"):
        named = {view.get(key, "") for view in views}
        if len(named) == 1 and named != {""}:
            target += f"{'&' if '#' in target else '#'}{key}={quote(named.pop())}"
    return target


def shots_of(
    scene: Scene, request: FilmRequest, views: Sequence[Mapping[str, str]], knobs: Mapping[str, str]
) -> list[FrameParams]:
    """Return the parameters of each frame along the ``views``. Raises ParameterError if there
    are too many frames, or none.
    """
    count = round(request.length * request.fps)
    if not 1 <= count <= MOST_FRAMES:
        raise ParameterError(
            f"length × fps must be 1 to {MOST_FRAMES:,} frames, not {count:,}.", "length"
        )
    knobs = with_first_view(scene, knobs, views)
    # Parameters that a view leaves out take the scene's values, so that the path can interpolate
    # them.
    usual = {name: str(value) for name, value in defaults(scene).items()}
    if not any(is_placed(view) for view in (knobs, *views)):
        usual["azimuth"], usual["elevation"] = map(repr, scene.front)
    if scene.surfaces.colours is None:
        usual["albedo"] = ",".join(map(repr, scene.surfaces.albedo))
    usual |= {"max_error": repr(request.target_error or scene.target_error), "f": "png"}
    path = film_path(knobs, views, usual, count, still=request.times is not None)
    if request.times is not None:
        steps = steps_in(request.times, scene)
        path = [
            {**shot, "time": str(steps[n * len(steps) // count])} for n, shot in enumerate(path)
        ]
    shots = (
        read(FrameParams, {**shot, "max_error": usual["max_error"], "f": "png"}.items())
        for shot in path
    )
    return [smoothed(shot, "png") for shot in shots]


def filmed(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``film`` as text for a person."""
    return quality_line(facts, "frames")


def check_movie(output: Path, width: int, height: int) -> None:
    """Raise ViewError if the file names no movie format, or the format does not allow the size;
    LibraryError if FFmpeg is missing.
    """
    suffix = output.suffix.lower()
    if suffix in MOVIE_CODECS:
        encoder(suffix)
        # Colours are stored at half resolution (4:2:0).
        if width % 2 or height % 2:
            raise ViewError(
                f"A {suffix} needs even width and height, not {width} × {height}: change them."
            )
    elif suffix not in WRITERS:
        known = ", ".join((*WRITERS, *MOVIE_CODECS))
        raise ViewError(
            f"{output} names no kind of film: end it in {known}, or name a folder for pictures."
        )


def write_movie(output: Path, pictures: Sequence[Path], fps: float) -> None:
    """Write pictures, in the order of their files, to a movie. Raises LibraryError and OSError."""
    suffix = output.suffix.lower()
    # Write to another file first, so that the output is complete or missing.
    half = pictures[0].with_name(f"movie{suffix}")
    if suffix in WRITERS:
        write_loop(half, pictures, round(1000.0 / fps))
        os.replace(half, output)
        return
    reading = ["-framerate", f"{fps:g}", "-i", str(pictures[0].with_name(FRAME_FILE_NAME))]
    command = [
        encoder(suffix),
        "-y",
        "-loglevel",
        "error",
        *reading,
        *MOVIE_CODECS[suffix],
        *MOVIE_COLOUR_OPTIONS,
        str(half),
    ]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise LibraryError(f"FFmpeg wrote no {suffix}: {done.stderr.strip() or done.returncode}.")
    os.replace(half, output)


def encoder(suffix: str) -> str:
    """Return the path of FFmpeg. Raises LibraryError if it is missing."""
    try:
        import imageio_ffmpeg  # noqa: PLC0415

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ModuleNotFoundError, RuntimeError):
        raise LibraryError(
            f"A film in a {suffix} needs FFmpeg: pip install 'isogi[film]'."
        ) from None
