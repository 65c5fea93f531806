"""``isogi publish``: pictures of a scene for a grid of cameras, isovalues and rotations of the
light, and a page that shows them.
"""

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.files.scene_file import Target
from isogi_core.frame.film import coded, ground_of
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import check_folder, write_whole
from isogi_server.answers import defaults
from isogi_server.cli.film_path import PERIODIC_ANGLES
from isogi_server.cli.reel import Reel, ReelRequest, quality_line
from isogi_server.errors import ParameterError
from isogi_server.parameters import FrameParams, read
from isogi_server.pictures import smoothed
from isogi_server.prewarm.order import stepped
from isogi_server.progress import open_scene
from isogi_server.settings import Settings
from isogi_server.values import finite, shown
from isogi_server.views import check_view, with_first_view

MOST_PICTURES = 100_000
"""Pictures of a grid, at most."""

DEFAULT_AZIMUTHS = "0:345:15"
"""Azimuths of the grid if no parameter has several values."""

PAGE_SUFFIXES = {".html", ".htm"}
"""Suffixes of pages that are one file."""

PAGE_TEMPLATE = Path(__file__).with_name("published.html")


@dataclass(frozen=True)
class PageRequest(ReelRequest):
    """A page that a command asks for, with a ``caption``. An interactive page may take
    ``megabytes`` at most.
    """

    megabytes: float | None = None
    caption: str | None = None

    @property
    def one_file(self) -> bool:
        """Return True if the page is to be one file, and not a folder."""
        return self.output.suffix.lower() in PAGE_SUFFIXES


def publish(
    target: Target, request: PageRequest, knobs: Mapping[str, str], settings: Settings
) -> dict[str, Any]:
    """Render the pictures that are missing, and write the page; return facts about its quality.

    Raises SceneError, VolumeError, LightError and ViewError before any work, and StoreError,
    WorkersError and OSError later.
    """
    # Refuse options of interactive pages.
    if request.megabytes is not None:
        raise ParameterError(
            "--megabytes is for a page that draws by itself: give --interactive too.", "megabytes"
        )
    if request.one_file:
        raise ParameterError(
            f"-o {request.output} names one file, which a page that draws by itself can be: give "
            "--interactive too, or name a folder.",
            "output",
        )
    check_output(request.output)
    scene = open_scene(target, settings)
    sliders = sliders_of(knobs)
    knobs = with_first_view(scene, knobs)
    # Check each picture of the grid before the first is rendered.
    shots = shots_of(
        sliders, {**knobs, "max_error": repr(request.target_error or scene.target_error)}
    )
    for shot in shots.values():
        check_view(scene, shot, settings)
    reel = Reel(request.output, scene, shots)
    reel.shoot(request, settings)
    page = page_of(scene, sliders, reel, request.caption or "")
    write_whole(request.output / "index.html", page.encode())
    counts = {name: len(values) for name, values in sliders.items()}
    facts = {"file": str(request.output), **reel.about, "sliders": counts, **reel.summary()}
    return {**facts, "seconds": request.passed}


def check_output(output: Path) -> None:
    """Raise ViewError if a page cannot be written there: its parent folder is missing, or a
    file has the name of the folder, or the reverse.
    """
    check_folder(output)
    if output.suffix.lower() in PAGE_SUFFIXES:
        if output.is_dir():
            raise ViewError(f"{output} is a folder, and the page is one file: name another.")
    elif output.is_file():
        raise ViewError(f"{output} is a file, and the page takes a folder: name another.")


def sliders_of(knobs: Mapping[str, str]) -> dict[str, list[float]]:
    """Return the values of each parameter given as first:last:step; azimuths all around if there is
    none.

    Raises ParameterError.
    """
    given = {name: values_in(name, text) for name, text in knobs.items() if ":" in text}
    sliders = given or {"azimuth": values_in("azimuth", DEFAULT_AZIMUTHS)}
    count = 1
    # Stop as soon as the product is too large.
    for values in sliders.values():
        count *= len(values)
        if count > MOST_PICTURES:
            raise ParameterError(
                f"The grid has more than {MOST_PICTURES:,} pictures: ask for larger steps."
            )
    return sliders


def values_in(name: str, text: str) -> list[float]:
    """Return the numbers of a text such as 0:90:15, rounded so that they read well. Raises
    ParameterError.
    """
    numbers = [finite(part) for part in text.split(":")]
    sensible = (
        len(numbers) == 3
        and numbers[2] > 0.0
        and 0.0 <= numbers[1] - numbers[0] < MOST_PICTURES * numbers[2]
    )
    if not sensible:
        raise ParameterError(
            f"{name} must be a number, or first:last:step such as 0:90:15, not {shown(text)}.", name
        )
    return [float(f"{value:.12g}") for value in stepped(*numbers)]


def shots_of(
    sliders: Mapping[str, list[float]], knobs: Mapping[str, str]
) -> dict[str, FrameParams]:
    """Return the parameters of each picture of the grid, by file name, which holds the places
    of the sliders.
    """
    shots = {}
    for places in itertools.product(*(range(len(values)) for values in sliders.values())):
        at = {
            name: repr(values[n]) for (name, values), n in zip(sliders.items(), places, strict=True)
        }
        name = f"pictures/{'-'.join(map(str, places))}.webp"
        shots[name] = smoothed(read(FrameParams, {**knobs, **at, "f": "webp"}.items()), "webp")
    return shots


def page_of(scene: Scene, sliders: Mapping[str, list[float]], reel: Reel, caption: str) -> str:
    """Return the HTML of the page, which needs no other file but the pictures."""
    facts = reel.summary()
    quality = (
        f"{facts['final']:.0%} of the pictures final at a relative error of "
        f"{facts['target_error']:g}"
    )
    document = {
        "name": scene.name,
        "caption": caption,
        "width": reel.about["width"],
        "height": reel.about["height"],
        "quality": quality,
        "ground": ground_colour(next(iter(reel.shots.values())).background),
        "sliders": [
            {"name": name, "values": values, "start": first_place(scene, name, values)}
            for name, values in sliders.items()
        ],
        "errors": [float(f"{reel.facts[name]['error']:.3g}") for name in reel.shots],
    }
    # A < within JSON could end the script element.
    return PAGE_TEMPLATE.read_text(encoding="utf-8").replace(
        "{DATA}", json.dumps(document).replace("<", "\\u003c")
    )


def first_place(scene: Scene, name: str, values: Sequence[float]) -> int:
    """Return the place at which a slider starts: the value closest to the first view of the
    scene.
    """
    front = dict(zip(("azimuth", "elevation"), scene.front, strict=True))
    usual = {**defaults(scene), **front}.get(name)
    if not isinstance(usual, float):
        return 0
    # Distances of angles are taken the short way round.
    away = np.abs(np.array(values) - usual)
    if name in PERIODIC_ANGLES:
        turn = 360.0
    else:
        turn = math.inf
    return int(np.argmin(np.minimum(away, turn - away % turn)))


def ground_colour(background: str) -> str:
    """Return the background of the pictures as a CSS colour, empty if it is transparent."""
    if background == "transparent":
        return ""
    return f"#{coded(np.array(ground_of(background))).tobytes().hex()}"


def published(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``publish`` as text for a person."""
    grid = " × ".join(f"{count} {name}" for name, count in facts["sliders"].items())
    return f"{quality_line(facts, 'pictures')} ({grid}): open {facts['file']}/index.html"
