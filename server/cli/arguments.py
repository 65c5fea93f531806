"""What commands share: the modules that do their work, the options of views and of work, and how a volume is taken."""

import json
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click

from isogi_core.model.material import SHINE_HELP

if TYPE_CHECKING:
    from server.settings import Settings

COMMAND_MODULES = {
    "options": "server.cli.options",
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
    "convert": "server.cli.convert",
    "bench": "isogi_report.speed",
    "store": "server.cli.store",
}
"""The module that does a command's work; ``options`` checks what commands are given, for which it loads pydantic."""


def module_of(command: str) -> Any:
    """The module that does a command's work, loaded now: help is answered without any of them."""
    return import_module(COMMAND_MODULES[command])


Command = Callable[..., Any]

FIRST_HEADING = "Options"
"""The heading of options of no group."""

VIEW_GROUPS = {
    FIRST_HEADING: {
        "isovalue": "In the volume's own units; default: the scene's.",
        "projection": "perspective or orthographic; default: the scene's.",
    },
    "Camera": {
        "azimuth": "Degrees; 0 looks from +x, 90 from +y.",
        "elevation": "Degrees above the xy plane.",
        "distance": "From the target, in radii of the volume's bounding sphere; of a picture,"
        " default: all of it is seen.",
        "fov": "Vertical field of view, degrees.",
        "eye": "World x,y,z, instead of azimuth, elevation and distance.",
        "target": "World x,y,z to look at; default: the volume's centre.",
        "up": "World x,y,z that points up in the picture.",
        "window": "Planes that take away what the eye would see there: x>40, or 0,1,-1<12.5, with ; between them.",
    },
    "Light": {
        "yaw": "Turns the light about z, degrees.",
        "pitch": "Then about y, degrees.",
        "roll": "Then about x, degrees.",
        "light": "Quaternion w,x,y,z that turns the light, instead of yaw, pitch and roll.",
    },
    "Picture": {
        "albedo": "Of the surface, one number or r,g,b, within the scene's albedos; default: the scene's albedo.",
        **SHINE_HELP,
        "glow": "How bright what glows is, over the scene's own, 0 to 16; default: 1.",
        "width": "Pixels.",
        "height": "Pixels.",
        "shading": "gi (light from all around), vicinity, lambert[_shadow|_fog], phong[_shadow] or path_traced.",
        "exposure": "How much brighter: a factor on the light; default: the scene's.",
        "antialias": "Smooth edges, on or off; default: on, off in npy.",
        "background": "Behind the surface: light (default), dark, transparent (png, webp),"
        " or a colour such as #ffffff.",
        "samples": "Paths per pixel, for path_traced.",
        "overlay": "Over the picture: none, provisional (hatches what is not done)"
        " or error (colours each pixel by it).",
    },
}
"""What each option of a view does, by the headings of help."""

VIEW_OPTIONS = {name: text for texts in VIEW_GROUPS.values() for name, text in texts.items()}
DEVELOPING_OPTIONS = ("shading", "samples", "exposure", "antialias", "background", "overlay")
"""Options that a reference, which is radiance alone, does not read."""

PICTURE_OPTIONS = ("window", *(name for name in VIEW_GROUPS["Picture"] if name != "exposure"))
REPORT_OPTIONS = {
    **{name: text for name, text in VIEW_OPTIONS.items() if name not in (*PICTURE_OPTIONS, "projection")},
    "azimuth": "Degrees; 0 looks from +x, 90 from +y; default: 40.",
    "elevation": "Degrees above the xy plane; default: 30.",
    "distance": "From the target, in radii of the volume's bounding sphere; default: 2.2.",
}
RANGE_OPTIONS = ("isovalue", "azimuth", "elevation", "distance", "yaw")
"""Options of a view that also take ranges, where there are many views."""

FILM_OPTIONS = {
    name: f"{text[:-1]}; or first:last." if name in RANGE_OPTIONS else text for name, text in VIEW_OPTIONS.items()
}
GRID_OPTIONS = {
    name: f"{text[:-1]}; or first:last:step." if name in RANGE_OPTIONS else text for name, text in VIEW_OPTIONS.items()
}
PREWARM_OPTIONS = {
    "views": "Directions of each isovalue, spread over all sides; default: 12 where none are given.",
    "times": "Steps of a series in time, each with light of its own: all, 3, 0:9 or 0:9:3.",
    "target_error": "Relative error of pictures at which light is final.",
    **{name: VIEW_OPTIONS[name] for name in ("distance", "fov", "width", "height")},
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


ENVIRONMENT_HELP = "Light: overcast, studio, noon, evening or gallery, or a probe's file (.hdr); default: the scene's."


CUT_HELP = (
    "Planes along the volume's axes that take away what lies there, so that light comes in: x>40, with ; between."
)


SURFACES_HELP = (
    "What each pinned surface of the scene lets pass, in turn, from 0 to 1, or off to hide it, such as 0.4,off."
)


HIDE_HELP = "Which labels of a segmentation are hidden, by their values, such as 3,4; or none."


MATERIAL_HELP = (
    "What the surface is made of: diffuse, glass or subsurface, with numbers of it, such as glass,index=1.3."
)


RAW_HELP = (
    "What a file without a header holds: sizes along x, y, z, type and byte order, such as 256x256x128,uint8,little."
)


VOLUME_OPTIONS = ("axes", "raw", "solid", "environment", "cut", "surfaces", "hide", "material")
"""Options of ``volume_options``; those that are given follow the # of a target."""


def volume_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: the options of VOLUME_OPTIONS, which become parts of the command's target."""

    @click.option(
        "--axes",
        type=click.Choice(["world", "raw"]),
        help="Where the volume lies: as its file says, or raw, its voxels' indices times spacing; default: world.",
    )
    @click.option("--raw", help=RAW_HELP)
    @click.option(
        "--solid",
        type=click.Choice(["above", "below"]),
        help="Which side of the isovalue is solid; default: above; below where most of the border is above.",
    )
    @click.option("--environment", help=ENVIRONMENT_HELP)
    @click.option("--cut", help=CUT_HELP)
    @click.option("--surfaces", help=SURFACES_HELP)
    @click.option("--hide", help=HIDE_HELP)
    @click.option("--material", help=MATERIAL_HELP)
    @wraps(command)
    def placed(**given: Any) -> Any:
        name, placing = "scene" if "scene" in given else "target", {key: given.pop(key) for key in VOLUME_OPTIONS}
        if "." in (placing["environment"] or ""):
            placing["environment"] = str(Path(placing["environment"]).resolve())
        given[name] = placed_target(given[name], placing)
        return command(**given)

    return placed


def placed_target(target: str | None, placing: Mapping[str, str | None]) -> str | None:
    """A command's target with what its options say of the volume after its #; None where nothing is said of none."""
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


def options(table: dict[str, str]) -> Callable[[Command], Command]:
    """Decorator: one text option per row; they are checked where they are read, as HTTP's are."""

    def decorate(command: Command) -> Command:
        for name, text in reversed(table.items()):
            flag = f"--{name.replace('_', '-')}"
            command = click.option(flag, is_flag=name in SWITCH_OPTIONS, default=None, help=text)(command)
        return command

    return decorate


Check = Callable[[click.Context, click.Parameter, str | None], float | None]
"""A callback of an option that is a number."""


def number(low: float, high: float) -> Check:
    """Callback of an option that is a number from ``low`` to ``high``."""
    return lambda _, __, text: None if text is None else float(module_of("options").number(text, low, high))


def duration(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
    """Callback of an option that is a span of time: seconds."""
    return None if text is None else float(module_of("options").duration(text))


def age(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
    """Callback of an option that is an age: seconds."""
    return None if text is None else float(module_of("options").age(text))


def settings_from(config: Path | None = None, **given: Any) -> "Settings":
    """The settings: options first, then the environment, then a file; UsageError names what is wrong."""
    settings: Settings = module_of("options").settings_from(config, **given)
    return settings


def show(facts: dict[str, Any], text: Callable[[dict[str, Any]], str], as_json: bool) -> None:
    """Print facts, for a script or for a person."""
    click.echo(json.dumps(facts, allow_nan=False) if as_json else text(facts))
