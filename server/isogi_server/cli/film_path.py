"""The path of a film: the parameters of each frame, eased along keyframes."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.frame.film import ground_of
from isogi_core.plan.scene import Scene
from isogi_server.errors import ParameterError
from isogi_server.parameters import FrameParams
from isogi_server.values import finite, shown

Knobs = Mapping[str, str]
"""Parameters of a view, as text."""

PERIODIC_ANGLES = ("azimuth", "yaw", "pitch", "roll")
"""Angles of period 360°."""

FIXED_PARAMETERS = (
    *("width", "height", "shading", "samples", "overlay", "shine"),
    *("projection", "environment", "background", "window"),
    *("cut", "time", "smooth", "hide", "material"),
)
"""Parameters that cannot be interpolated: all views have the same."""

HEX_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")

ON_THE_PAGE = ("scene", "name", "compare", "rulers", "measure", "slices", "draw")
"""Parameters of a page's link that do not belong to a picture."""


def film_path(
    given: Knobs, views: Sequence[Knobs], scene: Knobs, frames: int, still: bool = False
) -> list[dict[str, str]]:
    """Return the views of ``frames`` frames: along the keyframes ``views``; or between the ends of
    parameters ``given`` as first:last; or once around, unless the camera is ``still``.

    ``scene`` are the values of parameters that views leave out. Raises ParameterError.
    """
    given = untinted(given, scene)
    views = [untinted(view, scene) for view in views]
    swept = [name for name, text in given.items() if ":" in text]
    if views and swept:
        raise ParameterError(
            f"{swept[0]}={given[swept[0]]} and views both say what moves: keep one.", swept[0]
        )
    if views:
        return along([{**given, **view} for view in views], scene, frames, short=True)
    # Without anything that moves, the camera turns once around.
    if not swept and not still:
        start = given.get("azimuth", defaults(scene)["azimuth"])
        given = {**given, "azimuth": f"{start}:{finite_number('azimuth', start) + 360.0!r}"}
        swept = ["azimuth"]
    ends = [ends_of(name, given[name]) for name in swept]
    keys = [
        {**given, **{name: end[k] for name, end in zip(swept, ends, strict=True)}} for k in (0, 1)
    ]
    return along(keys, scene, frames, short=False)


def along(keys: Sequence[Knobs], scene: Knobs, frames: int, short: bool) -> list[dict[str, str]]:
    """Return the views of ``frames`` frames along the keyframes ``keys``. Angles take the ``short``
    way if that is set, else the way that their numbers say.

    A closed path, whose last keyframe equals the first, moves evenly; any other starts and ends at
    rest. Raises ParameterError.
    """
    names = list(dict.fromkeys(name for key in keys for name in key))
    usual = defaults(scene)
    whole = [{name: key.get(name, usual.get(name, "")) for name in names} for key in keys]
    # Parameters that are equal in all keyframes stay as they are; the others are interpolated as
    # numbers.
    fixed = {name: whole[0][name] for name in names if len({key[name] for key in whole}) == 1}
    tracks = {
        name: track(name, [key[name] for key in whole], short)
        for name in names
        if name not in fixed
    }
    closed = bool(tracks) and all(is_closed(name, rows) for name, rows in tracks.items())
    # The last frame of a closed path comes before its end, which is the first frame again.
    places = (len(keys) - 1) * np.arange(frames) / max(frames if closed else frames - 1, 1)
    moving = {name: eased(rows, places, closed) for name, rows in tracks.items()}
    return [
        {**fixed, **{name: text_of(name, rows[n]) for name, rows in moving.items()}}
        for n in range(frames)
    ]


def eased(rows: np.ndarray, places: np.ndarray, closed: bool) -> np.ndarray:
    """Interpolate ``rows`` (k, n) at ``places`` (m,) from 0 to k - 1: a curve through one row at
    each integer.

    The curve is a monotone cubic that overshoots no row. The slopes at the ends of a path that is
    not ``closed`` are zero. Source: Fritsch and Carlson, "Monotone piecewise cubic interpolation",
    1980, with harmonic means as slopes.
    """
    steps = np.diff(rows, axis=0)
    rest = np.zeros_like(steps[:1])
    before = np.concatenate([steps[-1:] if closed else rest, steps])
    after = np.concatenate([steps, steps[:1] if closed else rest])
    # The slope at a row is the harmonic mean of the steps before and after it, zero if their signs
    # differ.
    same = before * after > 0.0
    slopes = np.where(same, 2.0 * before * after / np.where(same, before + after, 1.0), 0.0)
    # Evaluate the cubic Hermite polynomial of the interval.
    at = np.clip(places.astype(np.intp), 0, len(steps) - 1)
    t = (places - at)[:, None]
    rise = t * t * (3.0 - 2.0 * t)
    bend = t * (1.0 - t)
    return rows[at] + rise * steps[at] + bend * ((1.0 - t) * slopes[at] - t * slopes[at + 1])


def track(name: str, texts: Sequence[str], short: bool) -> np.ndarray:
    """Return the values of a parameter at the keyframes, (k, n). Raises ParameterError if it
    cannot move.
    """
    if name in FIXED_PARAMETERS:
        raise ParameterError(f"{name} cannot change in a film: give all views the same.", name)
    if "" in texts:
        raise ParameterError(
            f"{name} is given by some views and not by others: give it in all of them.", name
        )
    parts = [[finite_number(name, part) for part in text.split(",")] for text in texts]
    most = max(map(len, parts))
    if any(len(row) not in (1, most) for row in parts):
        raise ParameterError(
            f"{name} has more numbers in some views than in others: give it alike.", name
        )
    # A single number stands for all channels.
    rows = np.array([row if len(row) == most else row * most for row in parts])
    # q and -q are the same rotation: choose the sign that is closer to the keyframe before.
    if name == "light":
        rows[1:] *= np.cumprod(np.where(np.sum(rows[1:] * rows[:-1], axis=1) < 0.0, -1.0, 1.0))[
            :, None
        ]
    if short and name in PERIODIC_ANGLES:
        return np.unwrap(rows, period=360.0, axis=0)
    return rows


def is_closed(name: str, rows: np.ndarray) -> bool:
    """Return True if a parameter ends at its first value; angles after whole turns."""
    way = np.abs(rows[-1] - rows[0])
    if name in PERIODIC_ANGLES:
        way = np.minimum(way % 360.0, -way % 360.0)
    return bool(np.all(way < 1e-9))


def text_of(name: str, row: np.ndarray) -> str:
    """Return the values of a parameter as text, angles without whole turns."""
    return ",".join(
        repr(math.fmod(value, 360.0) if name in PERIODIC_ANGLES else value)
        for value in row.tolist()
    )


def defaults(scene: Knobs) -> dict[str, str]:
    """Return the values of parameters that views leave out: the scene's, else the general
    defaults.
    """
    usual = {
        name: field.default
        for name, field in FrameParams.model_fields.items()
        if field.default is not None
    }
    return {**{name: str(value) for name, value in usual.items()}, **scene}


def finite_number(name: str, text: str) -> float:
    """Return the number that a text spells. Raises ParameterError."""
    value = finite(text)
    if math.isnan(value):
        raise ParameterError(f"{name} must be a number, or first:last, not {shown(text)}.", name)
    return value


def ends_of(name: str, text: str) -> tuple[str, str]:
    """Return the two ends of a text such as 60:120. Raises ParameterError."""
    first, _, last = text.partition(":")
    if ":" in last:
        raise ParameterError(f"{name} must be a number, or first:last, not {shown(text)}.", name)
    return first, last


def view_in(text: str) -> dict[str, str]:
    """Return the parameters in a link that the page shares, or in a text such as
    ``azimuth=40,elevation=30``. Raises ParameterError.
    """
    if "://" in text or text.startswith("?"):
        return {
            name: value
            for name, value in parse_qsl(urlsplit(text).query)
            if name not in ON_THE_PAGE
        }
    # Otherwise the text is a list of name=value.
    pairs = [part.partition("=") for part in text.split(",")]
    if not all(name and equals for name, equals, _ in pairs):
        raise ParameterError(
            f"view must be a link, or such as azimuth=40,elevation=30, not {shown(text)}.", "view"
        )
    return {name.strip(): value.strip() for name, _, value in pairs}


def untinted(view: Knobs, scene: Knobs) -> dict[str, str]:
    """Return a view whose ``tint``, a colour that the page's links give next to the albedo, is part
    of the albedo.

    Raises ParameterError.
    """
    view = dict(view)
    tint = view.pop("tint", None)
    if tint is None:
        return view
    if not HEX_COLOUR.fullmatch(tint):
        raise ParameterError(f"tint must be a colour such as #ff8800, not {shown(tint)}.", "tint")
    # The tint is the hue of an albedo whose largest channel is given.
    most = max(
        finite_number("albedo", share) for share in view.get("albedo", scene["albedo"]).split(",")
    )
    return {**view, "albedo": ",".join(repr(most * share) for share in ground_of(tint))}


def views_in(document: Any) -> list[dict[str, str]]:
    """Return the views in a document: a list of links, or of tables of parameters. Raises
    ParameterError.
    """
    if isinstance(document, dict):
        found = document.get("views")
    else:
        found = document
    if not isinstance(found, list) or not found:
        raise ParameterError(
            'A file of views needs a list "views", such as [{"azimuth": 40}].', "views-file"
        )
    return [view_in(each) if isinstance(each, str) else known(each) for each in found]


def known(view: Any) -> dict[str, str]:
    """Return the parameters of a view in a document as text. Raises ParameterError."""
    if not isinstance(view, dict):
        raise ParameterError(
            f"A view must be a link or a table of parameters, not {shown(view)}.", "views-file"
        )
    rows = {name: value if isinstance(value, list) else [value] for name, value in view.items()}
    return {name: ",".join(map(str, row)) for name, row in rows.items() if name not in ON_THE_PAGE}


STEPS_PATTERN = re.compile(r"(\d{1,7})(?::(\d{1,7})(?::0*([1-9]\d{0,6}))?)?", re.ASCII)
"""Steps of a series: 3, 0:9 or 0:9:3."""


def steps_in(text: str, scene: Scene) -> list[int]:
    """Return the steps of the scene's series that a ``text`` names: all, one, first:last or
    first:last:step.

    Raises ParameterError if it names none, or steps that the series does not have.
    """
    count = scene.volume.moment[1]
    if count < 2:
        raise ParameterError(
            f"The volume '{scene.volume.name}' is no series in time: leave times out.", "times"
        )
    found = STEPS_PATTERN.fullmatch(text)
    if text != "all" and found is None:
        raise ParameterError(
            f"times must be all, a step, or first:last:step, not {shown(text)}.", "times"
        )
    # all, or first:last:step with both ends included.
    if found is None:
        first = "0"
        last = str(count - 1)
        step = "1"
    else:
        first, last, step = found.groups()
    steps = range(int(first), int(last or first) + 1, int(step or 1))
    if not steps or steps[-1] >= count:
        raise ParameterError(
            f"times = {shown(text)}: the series has the steps 0 to {count - 1}.", "times"
        )
    return list(steps)


@contextmanager
def at_step(time: int) -> Iterator[None]:
    """Name the step of the series in a ViewError of the block, as value ranges differ between
    steps.
    """
    try:
        yield
    except ViewError as error:
        if isinstance(error, ParameterError):
            name = error.parameter
        else:
            name = ""
        raise ParameterError(f"Step {time} of the series: {error}", name) from None
