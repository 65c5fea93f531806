"""Arguments that commands share: options of views, of volumes and of work, and the modules that
do the work.
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
from isogi_server.clocks import waiting
from isogi_server.knobs import KNOB_GROUPS, KNOBS
from isogi_server.values import Span, seconds_of, seconds_of_age

if TYPE_CHECKING:
    from isogi_server.settings import Settings

COMMAND_MODULES = {
    "settings": "isogi_server.cli.setting_options",
    "serve": "isogi_server.cli.serve",
    "render": "isogi_server.cli.render",
    "reference": "isogi_server.cli.render",
    "report": "isogi_report.command",
    "prewarm": "isogi_server.cli.prewarm",
    "export": "isogi_server.cli.export",
    "film": "isogi_server.cli.film",
    "publish": "isogi_server.cli.publish",
    "publish --interactive": "isogi_server.cli.publish_live",
    "inspect": "isogi_server.inspect.text",
    "convert": "isogi_server.cli.export",
    "bench": "isogi_report.speed",
    "store": "isogi_server.cli.store",
}
"""The module that does the work of a command; "settings" is the one that reads settings."""


def module_of(command: str) -> Any:
    """Import the module of a command, now: help is printed without any of them."""
    with waiting("starting"):
        return import_module(COMMAND_MODULES[command])


Command = Callable[..., Any]

FIRST_HEADING = "Options"
"""The heading of options without a group."""

VIEW_GROUPS = {
    heading: tuple(knob.name for knob in KNOB_GROUPS[heading])
    for heading in (FIRST_HEADING, "Camera", "Light", "Picture")
}
"""The knobs that are options of a view, by heading."""


def view_options(span: str = "", **otherwise: str) -> dict[str, str]:
    """Return the options of a view with their help. Options in RANGE_OPTIONS also take a ``span``
    such as first:last.

    ``otherwise`` describes, by name, the defaults of a command that differ from the usual ones.
    """
    otherwise = {"azimuth": "", "elevation": "", "distance": "fitted to the surface"} | otherwise
    # The camera is fitted to the surface unless options place it, so angles and distance have no
    # fixed default.
    fitted = {
        name: replace(KNOBS[name], default=None, otherwise=usual)
        for name, usual in otherwise.items()
    }
    knobs = {
        name: fitted.get(name, KNOBS[name]) for names in VIEW_GROUPS.values() for name in names
    }
    texts = {name: knob.text for name, knob in knobs.items()}
    if span:
        texts |= {name: f"{texts[name][:-1]}; or {span}." for name in RANGE_OPTIONS}
    return texts


RANGE_OPTIONS = ("isovalue", "azimuth", "elevation", "distance", "yaw")
"""Options of a view that also take ranges in commands that make several views."""

VIEW_OPTIONS = view_options()
FILM_OPTIONS = view_options("first:last")
GRID_OPTIONS = view_options("first:last:step")

DEVELOPING_OPTIONS = ("shading", "samples", "exposure", "antialias", "background", "overlay")
"""Options that ``reference`` does not read, as it stores radiance."""

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
        "Directions for each isovalue, spread over all sides; default: 12 if none are given."
    ),
    "times": "Steps of a series in time, each with separate light: all, 3, 0:9 or 0:9:3.",
    "target_error": "Relative error of pictures at which light is final.",
    **{name: KNOBS[name].text for name in ("distance", "fov", "width", "height")},
}
WORK_OPTIONS = {
    "workers": "Processes that compute light; default: one per core.",
    "store": "Path or URL of the light's store; default: in the user's cache folder.",
    "scheduler": "Address of a Dask scheduler whose workers bake, tls://…",
    "scheduler_ca": "File of the authority, PEM, that signed the scheduler's certificate.",
    "scheduler_cert": "File of this client's certificate, PEM.",
    "scheduler_key": "File of the certificate's key, PEM.",
    "insecure_scheduler": "Join a scheduler without certificates.",
}
SWITCH_OPTIONS = ("insecure_scheduler",)
"""Options that take no value."""


LIGHT_HELP = (
    f"Light in place of the scene's: {', '.join(ENVIRONMENTS)}, or a probe's file (.hdr, .exr)"
)

RAW_HELP = (
    "The content of a file without a header: sizes along x, y, z, type and byte order, such "
    "as 256x256x128,uint8,little."
)


def options(table: dict[str, str]) -> Callable[[Command], Command]:
    """Return a decorator that adds a text option for each row; values are checked when they are
    read, as those of HTTP are.
    """

    def decorate(command: Command) -> Command:
        # The option that is added last comes first in the help.
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
"""Options of ``volume_options``; given ones are appended to the target after a #."""


def volume_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options VOLUME_OPTIONS to a command, and append given ones to its target."""

    @click.option(
        "--axes",
        type=click.Choice(["world", "raw"]),
        help=(
            "Place of the volume: as its file says, or raw, voxel index times spacing; default: "
            "world."
        ),
    )
    @click.option("--raw", help=RAW_HELP)
    @click.option(
        "--solid",
        type=click.Choice(["above", "below"]),
        help=(
            "Side of the isovalue that is solid; default: above, but below if most of the "
            "border is above."
        ),
    )
    @click.option(
        "--smooth",
        help=(
            "Width in voxels, 0 to 8, of a Gaussian that smooths the volume: about 1 removes "
            "dimples due to noise; default: 0."
        ),
    )
    @click.option(
        "--pieces",
        help=(
            "Hide pieces of fewer voxels than this, such as specks of noise, or all but the "
            "largest at the isovalue of the scene file; default: 0, none."
        ),
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
        # A probe's file is relative to the present directory, not to the volume.
        if "." in (placing["environment"] or ""):
            placing["environment"] = str(Path(placing["environment"]).resolve())
        given[name] = placed_target(given[name], placing)
        return command(**given)

    return placed


def placed_target(target: str | None, placing: Mapping[str, str | None]) -> str | None:
    """Append options about the volume to a command's target after a #: to that of a demo if no
    target is given; None if there is neither target nor option.
    """
    for key, value in placing.items():
        if value is not None:
            target = target or "demo:casting"
            # A # in the name of a file that exists is a part of the name.
            chosen = "#" in target and not Path(target).exists()
            target = f"{target}{'&' if chosen else '#'}{key}={quote(value)}"
    return target


def raw_option(command: Command) -> Command:
    """Add only the option --raw, which describes a file without a header."""

    @click.option("--raw", help=RAW_HELP)
    @wraps(command)
    def placed(raw: str | None, **given: Any) -> Any:
        return command(**{**given, "target": placed_target(given["target"], {"raw": raw})})

    return placed


EXISTING_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
"""Type of an option that names an existing file."""

AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")


Check = Callable[[click.Context, click.Parameter, str | None], float | None]
"""A callback that reads an option as a number."""


def checked(read: Callable[[str], float]) -> Check:
    """Return a callback that reads the text of an option by ``read``; its ValueError becomes
    BadParameter.
    """

    def check(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
        try:
            return None if text is None else read(text)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None

    return check


def number(low: float, high: float) -> Check:
    """Return a callback for a number from ``low`` to ``high``."""
    return checked(Span(low, high).read)


share_of_error, factor = (checked(KNOBS[name].kind.read) for name in ("max_error", "exposure"))
"""Callbacks of options that are a relative error, or a factor on radiance."""

duration = checked(seconds_of)
age = checked(seconds_of_age)
"""Callbacks of options that are a span of time, or an age: seconds."""


def settings_from(config: Path | None = None, **given: Any) -> "Settings":
    """Read the settings: options first, then the environment, then a file. Raises UsageError
    that names the wrong one.
    """
    settings: Settings = module_of("settings").settings_from(config, **given)
    return settings


def show(facts: dict[str, Any], text: Callable[[dict[str, Any]], str], as_json: bool) -> None:
    """Print facts, as JSON or as text for a person."""
    click.echo(json.dumps(facts, allow_nan=False) if as_json else text(facts))
