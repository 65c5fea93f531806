"""The ``isogi`` command. What is heavy is imported by the command that needs it, so that help is quick."""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from isogi_core.errors import IsogiError, LightError, PlaceError, SceneError, ViewError, VolumeError
from server.options import SECRET, SettingsCommand
from server.upkeep.command import store

if TYPE_CHECKING:
    from server.settings import Settings

BAD_INPUT = (SceneError, VolumeError, LightError, ViewError, PlaceError)
VIEW_OPTIONS = {
    "isovalue": "In the volume's own units; default: the scene's.",
    "azimuth": "Degrees; 0 looks from +x, 90 from +y.",
    "elevation": "Degrees above the xy plane.",
    "distance": "From the target, in radii of the volume's bounding sphere.",
    "fov": "Vertical field of view, degrees.",
    "eye": "World x,y,z, instead of azimuth, elevation and distance.",
    "target": "World x,y,z to look at; default: the volume's centre.",
    "up": "World x,y,z that points up in the picture.",
    "yaw": "Turns the light about z, degrees.",
    "pitch": "Then about y, degrees.",
    "roll": "Then about x, degrees.",
    "light": "Quaternion w,x,y,z that turns the light, instead of yaw, pitch and roll.",
    "albedo": "Of the surface, one number or r,g,b, within the scene's albedos; default: the scene's albedo.",
    "width": "Pixels.",
    "height": "Pixels.",
    "shading": "gi, vicinity, lambert[_shadow|_fog], phong[_shadow] or path_traced.",
    "exposure": "Factor on radiance before the tone curve.",
    "samples": "Paths per pixel, for path_traced.",
    "overlay": "none, provisional (hatches what is not final) or error (each pixel's estimate as a colour).",
}
DEVELOPED = ("shading", "samples", "exposure", "overlay")
"""Options that what is told of radiance alone does not read."""

PICTURE_OPTIONS = ("albedo", "width", "height", "shading", "samples", "overlay")
REPORT_OPTIONS = {
    **{name: text for name, text in VIEW_OPTIONS.items() if name not in PICTURE_OPTIONS},
    "azimuth": "Degrees; 0 looks from +x, 90 from +y; default: 40.",
    "elevation": "Degrees above the xy plane; default: 30.",
    "distance": "From the target, in radii of the volume's bounding sphere; default: 2.2.",
}
WORK_OPTIONS = {
    "workers": "Baking processes; default: one per core.",
    "store": "Path or URL of the cache; default: the user's cache folder.",
    "scheduler": "Address of a Dask scheduler to bake on, instead of own workers.",
}
Command = Callable[..., Any]


def main() -> None:
    """Run the command line and leave with its exit status."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command: 0 done, 1 failed at work, 2 wrong use or bad input. Errors are one line on stderr."""
    try:
        return int(cli.main(list(arguments), "isogi", standalone_mode=False) or 0)
    except click.Abort:
        return complain("stopped", 1)
    except click.ClickException as error:
        return complain(error.format_message(), error.exit_code)
    except BAD_INPUT as error:
        return complain(str(error), 2)
    except (IsogiError, OSError) as error:
        return complain(str(error), 1)
    except Exception as error:
        return complain(f"unexpected {type(error).__name__}: {error}", 1)


def complain(message: str, status: int) -> int:
    """Say on stderr, in one line, what is wrong; gives the exit status back."""
    click.echo(f"isogi: {' '.join(message.split())}", err=True)
    return status


def options(table: dict[str, str]) -> Callable[[Command], Command]:
    """Decorator: one text option per row; they are checked where they are read, as HTTP's are."""

    def decorate(command: Command) -> Command:
        for name, text in reversed(table.items()):
            command = click.option(f"--{name}", help=text)(command)
        return command

    return decorate


def number(low: float, high: float) -> Callable[[click.Context, click.Parameter, str | None], float | None]:
    """Callback of an option that is a number from ``low`` to ``high``."""

    def check(_: click.Context, __: click.Parameter, value: str | None) -> float | None:
        from server.values import Span  # noqa: PLC0415

        try:
            return None if value is None else Span(low, high).read(value)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None

    return check


def duration(_: click.Context, __: click.Parameter, value: str | None) -> float | None:
    """Callback of an option that is a span of time: seconds."""
    from server.durations import seconds_of  # noqa: PLC0415

    try:
        return None if value is None else seconds_of(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def settings_from(config: Path | None = None, **given: Any) -> "Settings":
    """The settings: options first, then the environment, then a file; UsageError names what is wrong."""
    from pydantic import ValidationError  # noqa: PLC0415

    from server.settings import read_settings  # noqa: PLC0415

    try:
        return read_settings(config, **{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = str(first["loc"][0])
        told = "" if name in SECRET else f", not {first['input']!r}"
        raise click.UsageError(f"{name}: {first['msg']}{told}.") from None
    except ValueError as error:
        raise click.UsageError(f"{config}: {error}.") from None


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="isogi")
def cli() -> None:
    """Isosurfaces of volumes with global illumination, baked lazily."""


@cli.command(cls=SettingsCommand)
@click.argument("target", required=False)
def serve(target: str | None, config: Path | None, **given: str | None) -> None:
    """Serve TARGET, a scene (.toml) or a volume (.nrrd, .nhdr, .zarr); with neither, a demo."""
    settings = settings_from(config, **given)
    from server.serve import serve as serve_scene  # noqa: PLC0415

    serve_scene(target, settings)


@cli.command()
@click.argument("scene", metavar="TARGET")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False))
@options(VIEW_OPTIONS)
@click.option("--target-error", callback=number(0.0001, 1), help="Relative error at which a pixel is final.")
@click.option("--time", "seconds", callback=duration, help="Stop baking after so long: 90, 90s, 10m or 1h.")
@options(WORK_OPTIONS)
@click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")
def render(
    scene: str, output: Path, target_error: float | None, seconds: float | None, as_json: bool, **given: Any
) -> None:
    """Write a picture of TARGET; the suffix of the output chooses png, jpeg, webp or npy."""
    settings = settings_from(**{name: given.pop(name) for name in WORK_OPTIONS})
    from server.render import render as render_view  # noqa: PLC0415

    knobs = {name: value for name, value in {**given, "max_error": target_error}.items() if value is not None}
    facts = render_view(scene, output, knobs, settings, seconds)
    state = "provisional" if facts["provisional"] else "final"
    quality = f"estimated error {facts['error']:.4f}, {facts['final']:.1%} of the surface at {facts['target_error']:g}"
    line = f"{output}: {facts['width']} × {facts['height']}, {state}, {quality}"
    click.echo(json.dumps(facts, allow_nan=False) if as_json else line)


@cli.command()
@click.argument("scene", metavar="TARGET")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), help="A file, .npz.")
@options({name: text for name, text in VIEW_OPTIONS.items() if name not in DEVELOPED})
@click.option("--samples", type=click.IntRange(1), help="Stop at so many paths per pixel.")
@click.option("--target-error", callback=number(1e-6, 1), help="Stop at this noise; default: 0.005.")
@click.option("--time", "seconds", callback=duration, help="Stop after so long: 90, 90s, 10m or 1h.")
@click.option("--bounces", type=click.IntRange(0, 1000), help="Default: all but 0.1 % of the light.")
@click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")
def reference(
    scene: str,
    output: Path,
    samples: int | None,
    target_error: float | None,
    seconds: float | None,
    bounces: int | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Path-trace a view of TARGET from every pixel. Goes on where OUTPUT stopped."""
    if samples is not None and target_error is not None:
        raise click.UsageError("--samples and --target-error both say when to stop: keep one.")
    from server.reference import reference as make_reference  # noqa: PLC0415

    if samples is None and target_error is None and seconds is None:
        target_error = 0.005
    knobs = {name: value for name, value in given.items() if value is not None}
    goal = {"samples": samples, "noise": target_error, "seconds": seconds}
    facts = make_reference(scene, output, knobs, settings_from(), bounces, goal)
    line = f"{output}: {facts['width']} × {facts['height']}, {facts['samples']} paths per pixel, "
    line += f"noise {facts['noise']:.5f}, {facts['seconds']:.1f} seconds of the processor"
    click.echo(json.dumps(facts, allow_nan=False) if as_json else line)


@cli.command()
@click.argument("scene", metavar="TARGET")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@click.option("--size", type=click.IntRange(8, 1024), default=112, show_default=True, help="Pixels along each side.")
@options(REPORT_OPTIONS)
@click.option(
    "--deadline",
    callback=duration,
    help="Such as 90s, 10m or 1h: what does not fit is left out. The end may be a tenth late, and then it is drawn.",
)
@click.option("--only", multiple=True, metavar="KEY", help="Run this study alone; may be told more than once.")
@click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")
def report(
    scene: str, output: Path, size: int, deadline: float | None, only: tuple[str, ...], as_json: bool, **given: Any
) -> int:
    """Measure how wrong the light of TARGET is, by cause, against what it costs, and write that as a page.

    What was measured is kept in the folder: the same command goes on where it was stopped.
    """
    from server.report.command import Wishes, sentence  # noqa: PLC0415
    from server.report.command import report as report_view  # noqa: PLC0415

    knobs = {name: value for name, value in given.items() if value is not None}
    square = {"width": str(size), "height": str(size)}
    facts = report_view(scene, {**knobs, **square}, settings_from(), Wishes(output, deadline, only))
    click.echo(json.dumps(facts, allow_nan=False) if as_json else sentence(facts))
    return 1 if facts["stopped"] or facts["failed"] else 0


@cli.command()
@click.argument("scene", metavar="TARGET")
@click.option("--isovalue", "isovalues", multiple=True, help="One, first:last:step, or first:last for all between.")
@click.option("--views", help="Directions of each isovalue, spread over all sides; default: 12 where none are told.")
@click.option("--view", "directions", multiple=True, metavar="azimuth=40,elevation=30", help="One direction.")
@click.option(
    "--views-file", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="Such, .json or .toml."
)
@click.option("--orbit", "orbits", multiple=True, metavar="36@20", help="So many directions at an elevation.")
@click.option("--all-directions", is_flag=True, default=None, help="Whole isosurfaces, however they are looked at.")
@options({name: VIEW_OPTIONS[name] for name in ("distance", "fov", "width", "height")})
@click.option("--target-error", help="Relative error at which light is final.")
@click.option("--deadline", callback=duration, help="End by then, with what is baked: 90, 90s, 10m or 1h.")
@options(WORK_OPTIONS)
@click.option("--dry-run", is_flag=True, help="Tell what there is to be baked and how long it takes; bake nothing.")
@click.option("--continue", "go_on", is_flag=True, help="Go on with the last prewarm of TARGET that was stopped.")
@click.option("--server", metavar="URL", help="Have a running server do it; its token: ISOGI_TOKEN.")
@click.option("--detach", is_flag=True, help="Print the job's address, and leave the server to it.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def prewarm(scene: str, as_json: bool, **given: Any) -> int:
    """Bake ahead what views of TARGET from all sides need, or whole isosurfaces; stopped, it goes on (--continue)."""
    from server.prewarm.options import Way, carry_out  # noqa: PLC0415

    work = {name: given.pop(name) for name in WORK_OPTIONS}
    way = Way(**{name: given.pop(name) for name in ("dry_run", "go_on", "server", "detach")})
    summary, address = carry_out(scene, given, way, work)
    if summary is None:
        click.echo(json.dumps({"job": address}) if as_json else address)
        return 0
    click.echo(summary.model_dump_json() if as_json else str(summary))
    return 1 if summary.failed else 0


@cli.command()
@click.argument("target")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw the stiffness to a file, .png.")
@click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")
def inspect(target: str, picture: Path | None, as_json: bool) -> None:
    """Tell what is in TARGET, a volume or a scene, how stiff that is, and what will be baked for it."""
    from server.inspect.command import inspect as inspect_scene  # noqa: PLC0415

    click.echo(inspect_scene(target, picture, as_json))


@cli.command()
@click.argument("target", required=False)
@click.option("--isovalue", type=float, help="In the volume's own units; default: the scene's.")
@click.option("--size", type=click.IntRange(1, 4096), default=512, show_default=True, help="Pixels along each side.")
@click.option("--repeats", type=click.IntRange(1), default=5, show_default=True, help="Rounds that are timed.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def bench(target: str | None, isovalue: float | None, size: int, repeats: int, as_json: bool) -> None:
    """Measure this machine with TARGET, a scene or a volume; with neither, a demo."""
    from server.bench import bench as measure  # noqa: PLC0415
    from server.bench import table  # noqa: PLC0415

    figures = measure(target, isovalue, size, repeats)
    click.echo(json.dumps(figures, allow_nan=False) if as_json else table(figures))


cli.add_command(store)
