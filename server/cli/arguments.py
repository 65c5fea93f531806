"""What commands share: the modules that do their work, the options of views and of work, and how a
volume is taken.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click

from isogi_core.model.lights import ENVIRONMENTS
from server.clocks import waiting
from server.knobs import KNOB_GROUPS, KNOBS
from server.values import Span, seconds_of, seconds_of_age

if TYPE_CHECKING:
    from server.settings import Settings

COMMAND_MODULES = {
    "settings": "server.cli.setting_options",
    "serve": "server.cli.serve",
    "render": "server.cli.render",
    "reference": "server.cli.render",
    "report": "isogi_report.command",
    "prewarm": "server.cli.prewarm",
    "export": "server.cli.export",
    "film": "server.cli.film",
    "publish": "server.cli.publish",
    "publish --interactive": "server.cli.publish_live",
    "inspect": "server.inspect.text",
    "convert": "server.cli.export",
    "bench": "isogi_report.speed",
    "store": "server.cli.store",
}
"""The module that does a command's work; ``settings`` are read by pydantic."""


def module_of(command: str) -> Any:
    """The module that does a command's work, loaded now: help is answered without any of them."""
    with waiting("starting"):
        return import_module(COMMAND_MODULES[command])


Command = Callable[..., Any]

FIRST_HEADING = "Options"
"""The heading of options of no group."""

VIEW_GROUPS = {
    heading: tuple(knob.name for knob in KNOB_GROUPS[heading])
    for heading in (FIRST_HEADING, "Camera", "Light", "Picture")
}
"""The knobs that are options of a view, by the headings of help."""


def view_options(span: str = "", **otherwise: str) -> dict[str, str]:
    """The options of a view with their help; the azimuth and the like take a ``span`` such as
    first:last too.

    Where a command has defaults of its own, ``otherwise`` has them by name.
    """
    otherwise = {"azimuth": "", "elevation": "", "distance": "all of it is seen"} | otherwise
    fitted = {
        name: replace(KNOBS[name], default=None, otherwise=usual)
        for name, usual in otherwise.items()
    }
    knobs = {
        name: fitted.get(name, KNOBS[name]) for names in VIEW_GROUPS.values() for name in names
    }
    return {
        name: f"{knob.text[:-1]}; or {span}." if span and name in RANGE_OPTIONS else knob.text
        for name, knob in knobs.items()
    }


RANGE_OPTIONS = ("isovalue", "azimuth", "elevation", "distance", "yaw")
"""Options of a view that also take ranges, where there are many views."""

VIEW_OPTIONS = view_options()
FILM_OPTIONS = view_options("first:last")
GRID_OPTIONS = view_options("first:last:step")

DEVELOPING_OPTIONS = ("shading", "samples", "exposure", "antialias", "background", "overlay")
"""Options that a reference, which is radiance alone, does not read."""

PICTURE_OPTIONS = (
    "window",
    "projection",
    *(name for name in VIEW_GROUPS["Picture"] if name != "exposure"),
)
REPORT_OPTIONS = {
    name: text
    for name, text in view_options(azimuth="40", elevation="30", distance="2.2").items()
    if name not in PICTURE_OPTIONS
}
PREWARM_OPTIONS = {
    "views": (
        "Directions of each isovalue, spread over all sides; default: 12 where none are given."
    ),
    "times": "Steps of a series in time, each with light of its own: all, 3, 0:9 or 0:9:3.",
    "target_error": "Relative error of pictures at which light is final.",
    **{name: KNOBS[name].text for name in ("distance", "fov", "width", "height")},
}
WORK_OPTIONS = {
    "workers": "Processes that compute light; default: one per core.",
    "store": "Path or URL where light is kept; default: the user's cache folder.",
    "scheduler": "Address of a Dask scheduler to compute on, tls://…, instead of own workers.",
    "scheduler_ca": "File of the authority, PEM, that signed its certificate.",
    "scheduler_cert": "File of the certificate, PEM, that it is shown.",
    "scheduler_key": "File of that certificate's key, PEM.",
    "insecure_scheduler": "Join a scheduler without certificates.",
}
SWITCH_OPTIONS = ("insecure_scheduler",)
"""Options that take no value."""


LIGHT_HELP = (
    f"Light in place of the scene's own: {', '.join(ENVIRONMENTS)}, or a probe's file (.hdr)"
)

RAW_HELP = (
    "What a file without a header holds: sizes along x, y, z, type and byte order, such "
    "as 256x256x128,uint8,little."
)


def options(table: dict[str, str]) -> Callable[[Command], Command]:
    """Decorator: one text option per row; they are checked where they are read, as HTTP's are."""

    def decorate(command: Command) -> Command:
        for name, text in reversed(table.items()):
            flag = f"--{name.replace('_', '-')}"
            command = click.option(flag, is_flag=name in SWITCH_OPTIONS, default=None, help=text)(
                command
            )
        return command

    return decorate


VOLUME_OPTIONS = (
    *("axes", "raw", "solid", "smooth", "pieces", "environment", "periodic", "repeat"),
    *("cut", "surfaces", "hide", "material"),
)
"""Options of ``volume_options``; those that are given follow the # of a target."""


def volume_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: the options of VOLUME_OPTIONS, which become parts of the command's target."""

    @click.option(
        "--axes",
        type=click.Choice(["world", "raw"]),
        help=(
            "Where the volume lies: as its file says, or raw, its voxels' indices times "
            "spacing; default: world."
        ),
    )
    @click.option("--raw", help=RAW_HELP)
    @click.option(
        "--solid",
        type=click.Choice(["above", "below"]),
        help=(
            "Which side of the isovalue is solid; default: above; below where most of the "
            "border is above."
        ),
    )
    @click.option(
        "--smooth",
        help=(
            "Smooth the volume by a Gaussian of so many voxels, 0 to 8: about 1 takes the "
            "dimples of noise away; default: 0."
        ),
    )
    @click.option(
        "--pieces",
        help="Show no pieces of fewer voxels than this, such as specks of noise; default: 0, all.",
    )
    @click.option("--environment", help=replace(KNOBS["environment"], help=LIGHT_HELP).text)
    @click.option(
        "--periodic",
        help=(
            "Along which axes the volume is one cell of a field that repeats, such as "
            "true,true,false; default: as its file says."
        ),
    )
    @click.option(
        "--repeat",
        help="How many cells of it to show along x, y and z, such as 2,2,1; default: 1,1,1.",
    )
    @options({name: KNOBS[name].text for name in ("cut", "surfaces", "hide", "material")})
    @wraps(command)
    def placed(**given: Any) -> Any:
        name = "scene" if "scene" in given else "target"
        placing = {key: given.pop(key) for key in VOLUME_OPTIONS}
        if "." in (placing["environment"] or ""):
            placing["environment"] = str(Path(placing["environment"]).resolve())
        given[name] = placed_target(given[name], placing)
        return command(**given)

    return placed


def placed_target(target: str | None, placing: Mapping[str, str | None]) -> str | None:
    """A command's target with what its options say of the volume after its #; None where nothing is
    said of none.
    """
    for key, value in placing.items():
        if value is not None:
            target = target or "demo:casting"
            chosen = "#" in target and not Path(target).exists()
            target = f"{target}{'&' if chosen else '#'}{key}={quote(value)}"
    return target


def raw_option(command: Command) -> Command:
    """Decorator: the option of ``volume_options`` that says what bare voxels are, alone."""

    @click.option("--raw", help=RAW_HELP)
    @wraps(command)
    def placed(raw: str | None, **given: Any) -> Any:
        return command(**{**given, "target": placed_target(given["target"], {"raw": raw})})

    return placed


EXISTING_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
"""The type of an option that names a file which must be there."""

AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")


Check = Callable[[click.Context, click.Parameter, str | None], float | None]
"""A callback of an option that is a number."""


def checked(read: Callable[[str], float]) -> Check:
    """Callback of an option: what ``read`` makes of its text; BadParameter says why where it is
    refused.
    """

    def check(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
        try:
            return None if text is None else read(text)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None

    return check


def number(low: float, high: float) -> Check:
    """Callback of an option that is a number from ``low`` to ``high``."""
    return checked(Span(low, high).read)


share_of_error, factor = (checked(KNOBS[name].kind.read) for name in ("max_error", "exposure"))
"""Callbacks of options that are a relative error, or a factor on radiance."""

duration = checked(seconds_of)
age = checked(seconds_of_age)
"""Callbacks of options that are a span of time, or an age: seconds."""


def settings_from(config: Path | None = None, **given: Any) -> "Settings":
    """The settings: options first, then the environment, then a file; UsageError names what is
    wrong.
    """
    settings: Settings = module_of("settings").settings_from(config, **given)
    return settings


def show(facts: dict[str, Any], text: Callable[[dict[str, Any]], str], as_json: bool) -> None:
    """Print facts, for a script or for a person."""
    click.echo(json.dumps(facts, allow_nan=False) if as_json else text(facts))
