"""The ``isogi`` command line: the arguments of each command. The module that does its work is
loaded when it is called.
"""

import errno
import gc
import io
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from isogi_core.allocation import keep_memory_small
from isogi_core.errors import (
    IsogiError,
    LightError,
    SceneError,
    StoreUrlError,
    ViewError,
    VolumeError,
    advice,
)
from isogi_server.cli.arguments import (
    AS_JSON,
    DEVELOPING_OPTIONS,
    EXISTING_FILE,
    FILM_OPTIONS,
    GRID_OPTIONS,
    PREWARM_OPTIONS,
    REPORT_OPTIONS,
    VIEW_OPTIONS,
    WORK_OPTIONS,
    age,
    duration,
    factor,
    module_of,
    number,
    options,
    raw_option,
    settings_from,
    share_of_error,
    show,
    volume_options,
)
from isogi_server.cli.help import Commands, SettingsCommand
from isogi_server.cli.stopping import stopped_at_once
from isogi_server.knobs import KNOBS
from isogi_worker.fork_server import start_fork_server

BAD_INPUT = (SceneError, VolumeError, LightError, ViewError, StoreUrlError)


def main() -> None:
    """Run the command line, and exit with its status."""
    keep_memory_small()
    escape_unknown_characters()
    # A command creates 200,000 objects that it keeps: to search these for garbage took a tenth of
    # its start.
    gc.set_threshold(50_000)
    sys.exit(run(sys.argv[1:]))


def escape_unknown_characters() -> None:
    """Let stdout and stderr escape characters that their encoding lacks: file names may hold
    any.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def run(arguments: Sequence[str]) -> int:
    """Run one command; return 0 if it is done, 1 if it failed, 2 for wrong use or bad input.
    Errors are one line on stderr.
    """
    # Errors of use and input exit with 2, errors at work with 1.
    try:
        return int(cli.main(list(arguments), "isogi", standalone_mode=False) or 0)
    except click.Abort:
        return complain("stopped", 1)
    except click.NoSuchOption as error:
        name = error.option_name
        near = error.possibilities
        return complain(
            f"There is no option '{name}': {advice(name, near) if near else '--help lists all.'}", 2
        )
    except click.ClickException as error:
        return complain(error.format_message(), error.exit_code)
    except BAD_INPUT as error:
        return complain(str(error), 2)
    except OSError as error:
        return complain(described(error), 1)
    except IsogiError as error:
        return complain(str(error), 1)
    except Exception as error:
        return complain(f"unexpected {type(error).__name__}: {error}", 1)


def described(error: OSError) -> str:
    """Return a sentence about an ``error`` of the system, with the file that it is about."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        what = error.filename or "The output"
        return f"{what} cannot be written ({error.strerror}): make room, and run the command again."
    if error.strerror is None or error.filename is None:
        return str(error)
    return f"{error.filename}: {error.strerror}."


def complain(message: str, status: int) -> int:
    """Print one line on stderr about an error; return the exit ``status``."""
    click.echo(f"isogi: {' '.join(message.split())}", err=True)
    return status


def ended(facts: dict[str, Any], text: Callable[[dict[str, Any]], str], as_json: bool) -> int:
    """Print the ``facts`` of a command as ``show`` does; return its exit status: 1 if its light is
    not complete because there was ``trouble``.
    """
    show(facts, text, as_json)
    if facts["trouble"]:
        return complain(f"The light is not complete. {facts['trouble']}", 1)
    return 0


@click.group(
    cls=Commands,
    subcommand_metavar="COMMAND|FILE [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="isogi")
@click.pass_context
def cli(context: click.Context) -> None:
    """Render isosurfaces of volumes with global illumination."""
    # ``serve`` writes these sentences to its log.
    if context.invoked_subcommand != "serve":
        for sentence in module_of("settings").unknown_variables():
            complain(sentence, 0)


@cli.command(cls=SettingsCommand)
@click.argument("target", required=False)
@volume_options
def serve(target: str | None, config: Path | None, **given: str | None) -> None:
    """Serve TARGET, a scene (.toml) or a volume (NRRD, NIfTI, DICOM, TIFF, Zarr …); by default a
    demo.
    """
    with stopped_at_once():
        settings = settings_from(config, **given)
        # Workers of this machine are forked from a process that takes a while to load: start it
        # first.
        if not settings.scheduler:
            start_fork_server()
        module_of("serve").serve(target, settings)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False))
@options(VIEW_OPTIONS)
@click.option(
    "--target-error", callback=share_of_error, help="Relative error at which a pixel is final."
)
@click.option(
    "--time", "seconds", callback=duration, help="Stop baking after this time: 90, 90s, 10m or 1h."
)
@options(WORK_OPTIONS)
@AS_JSON
def render(
    scene: str,
    output: Path,
    target_error: float | None,
    seconds: float | None,
    as_json: bool,
    **given: Any,
) -> int:
    """Write a picture of TARGET; the suffix of OUTPUT chooses png, jpeg, webp or npy."""
    settings = settings_from(**{name: given.pop(name) for name in WORK_OPTIONS})
    knobs = {
        name: value
        for name, value in {**given, "max_error": target_error}.items()
        if value is not None
    }
    work = module_of("render")
    facts = work.render(scene, output, knobs, settings, seconds)
    return ended(facts, work.rendered, as_json)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="A file, .npz.",
)
@options({name: text for name, text in VIEW_OPTIONS.items() if name not in DEVELOPING_OPTIONS})
@click.option("--samples", type=click.IntRange(1), help="Stop at this number of paths per pixel.")
@click.option(
    "--target-error", callback=number(1e-6, 1), help="Stop at this noise; default: 0.005."
)
@click.option(
    "--time", "seconds", callback=duration, help="Stop after this time: 90, 90s, 10m or 1h."
)
@click.option(
    "--bounces", type=click.IntRange(0, 1000), help="Default: all but 0.1 % of the light."
)
@AS_JSON
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
    """Path-trace a view of TARGET from every pixel. Continues a reference that OUTPUT holds."""
    if samples is not None and target_error is not None:
        raise click.UsageError("--samples and --target-error both say when to stop: keep one.")
    if samples is None and target_error is None and seconds is None:
        target_error = 0.005
    knobs = {name: value for name, value in given.items() if value is not None}
    goal = {"samples": samples, "noise": target_error, "seconds": seconds}
    work = module_of("reference")
    show(work.reference(scene, output, knobs, settings_from(), bounces, goal), work.grown, as_json)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder.",
)
@click.option(
    "--size",
    type=click.IntRange(8, 1024),
    default=112,
    show_default=True,
    help="Pixels along each side.",
)
@options(REPORT_OPTIONS)
@click.option(
    "--deadline",
    callback=duration,
    help="90s, 10m or 1h, plus a tenth: studies that do not fit are left out.",
)
@click.option(
    "--only",
    multiple=True,
    metavar="KEY",
    help="Run only this study; may be given more than once.",
)
@AS_JSON
def report(
    scene: str,
    output: Path,
    size: int,
    deadline: float | None,
    only: tuple[str, ...],
    as_json: bool,
    **given: Any,
) -> int:
    """Measure the errors of TARGET's light by cause, and their cost, and write a page about them.

    Measurements are kept in the folder: the same command continues one that was stopped.
    """
    work = module_of("report")
    knobs = {name: value for name, value in given.items() if value is not None}
    square = {"width": str(size), "height": str(size)}
    facts = work.report(
        scene, {**knobs, **square}, settings_from(), work.ReportRequest(output, deadline, only)
    )
    show(facts, work.sentence, as_json)
    if facts["stopped"] or facts["failed"]:
        return 1
    return 0


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "--isovalue",
    "isovalues",
    multiple=True,
    help="One, first:last:step, first:last for all between, or adaptive:20.",
)
@click.option(
    "--view", "directions", multiple=True, metavar="azimuth=40,elevation=30", help="One direction."
)
@click.option("--views-file", type=EXISTING_FILE, help="Directions in a file, .json or .toml.")
@click.option(
    "--orbit",
    "orbits",
    multiple=True,
    metavar="36@20",
    help="Directions around the volume: a number, at an elevation.",
)
@click.option(
    "--all-directions", is_flag=True, default=None, help="Whole isosurfaces, for all directions."
)
@options(PREWARM_OPTIONS)
@click.option(
    "--deadline",
    callback=duration,
    help="Stop after this time, with the light that is baked: 90, 90s, 10m or 1h.",
)
@options(WORK_OPTIONS)
@click.option(
    "--dry-run",
    is_flag=True,
    help="Print how much there is to bake and how long it takes; bake nothing.",
)
@click.option(
    "--continue",
    "resume",
    is_flag=True,
    help="Resume the last prewarm of TARGET that was stopped.",
)
@click.option("--server", metavar="URL", help="Have a running server bake; its token: ISOGI_TOKEN.")
@click.option(
    "--detach", is_flag=True, help="Print the job's address, and do not wait for its end."
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def prewarm(
    scene: str,
    dry_run: bool,
    resume: bool,
    server: str | None,
    detach: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Bake light ahead: of views of TARGET, or of whole isosurfaces; --continue resumes a stopped
    prewarm.
    """
    work = module_of("prewarm")
    workers = {name: given.pop(name) for name in WORK_OPTIONS}
    times = given.pop("times")
    # Refuse options that do not go together.
    fields = work.fields_given(given)
    if resume and (set(fields) - {"deadline"} or times or dry_run or server):
        raise click.UsageError(
            "--continue resumes the former order: leave out all options but --deadline, --workers …"
        )
    if detach and not server:
        raise click.UsageError("--detach is for a job of a server: name it by --server.")
    order = work.order_of(fields)
    # Bake here: the rest of an earlier order, or the order.
    if server is None:
        settings = settings_from(**workers)
        if resume:
            rest = work.resume(scene, settings, order.deadline)
        else:
            rest = None
        if rest:
            done = [rest]
        else:
            done = work.prewarm_series(scene, times, order, settings, dry_run)
    # A server has its own workers and scenes: options of the work here mean nothing to it.
    elif named := [
        name.replace("_", "-")
        for name, value in {"times": times, **workers}.items()
        if value is not None
    ]:
        raise click.UsageError(
            f"--{named[0]} is only for work in this process: leave it out, or leave --server out."
        )
    elif detach:
        address = work.detach(server, scene, order, dry_run)
        click.echo(json.dumps({"job": address}) if as_json else address)
        return 0
    else:
        done = [work.follow(server, scene, order, dry_run)]
    return 1 if work.print_summaries(done, as_json) else 0


@cli.command()
@click.argument("target")
@volume_options
@click.option(
    "--plan",
    is_flag=True,
    help="Print all facts, with the plan, the histogram, and the stiffness of surfaces.",
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Draw the stiffness to this file, .png.",
)
@AS_JSON
def inspect(target: str, plan: bool, picture: Path | None, as_json: bool) -> None:
    """Summarise TARGET, a volume or a scene, in ten lines; with --plan, print all facts."""
    click.echo(module_of("inspect").inspect(target, picture, as_json, plan))


@cli.command()
@click.argument("target")
@raw_option
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="A folder, .ome.zarr."
)
@AS_JSON
def convert(target: str, output: Path, as_json: bool) -> None:
    """Write the volume of TARGET as an OME-Zarr image with coarser levels, which opens quickly."""
    work = module_of("convert")
    show(work.convert(target, output), work.converted, as_json)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="The file to write.",
)
@click.option(
    "--isovalue", "isovalues", multiple=True, help="One; of a volume also more, or first:last."
)
@options({name: GRID_OPTIONS[name] for name in ("albedo", "yaw", "pitch", "roll", "light")})
@click.option("--exposure", callback=factor, help=KNOBS["exposure"].text)
@click.option("--target-error", help="Relative error of pictures at which light is final.")
@click.option(
    "--coefficients",
    is_flag=True,
    help="Also write harmonics of the light, into a .vti: see docs/export.md.",
)
@options(WORK_OPTIONS)
@AS_JSON
def export(
    scene: str,
    output: Path,
    isovalues: tuple[str, ...],
    exposure: float | None,
    target_error: str | None,
    coefficients: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Write TARGET with its light to OUTPUT.

    An isosurface as a mesh (.ply, .glb, .obj, .usdz), or values and light as a volume (.vti, .nrrd,
    .nii.gz, .zarr). A yaw as first:last:step makes a numbered file for each turn of the light.
    """
    settings = settings_from(**{name: given.pop(name) for name in WORK_OPTIONS})
    work = module_of("export")
    knobs = {name: value for name, value in given.items() if value is not None}
    request = work.ExportRequest(output, isovalues, target_error, exposure, coefficients)
    return ended(work.export(scene, request, knobs, settings), work.exported, as_json)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="A movie, or a folder."
)
@options(FILM_OPTIONS)
@click.option(
    "--view",
    "views",
    multiple=True,
    metavar="LINK|azimuth=40,…",
    help="A keyframe; give two or more.",
)
@click.option("--views-file", type=EXISTING_FILE, help="Keyframes, in a file.")
@click.option("--times", help="Steps of a series in time, in turn: all, 0:9 or 0:9:3.")
@click.option("--length", callback=duration, default="10s", show_default=True, help="Of the film.")
@click.option(
    "--fps", callback=number(0.1, 240), default="24", show_default=True, help="Frames of a second."
)
@click.option(
    "--target-error", callback=share_of_error, help="Relative error at which a frame is final."
)
@click.option("--time", "seconds", callback=duration, help="Longest time for a frame: 5, 5s or 1m.")
@click.option(
    "--deadline", callback=duration, help="Longest time for all frames together, shared evenly."
)
@options(WORK_OPTIONS)
@AS_JSON
def film(scene: str, as_json: bool, **given: Any) -> int:
    """Film TARGET: a whole turn, options given as first:last, a path along views, or steps in time.

    The suffix of OUTPUT chooses GIF, WebP, MP4 or WebM; without one, it is a folder of PNGs. The
    same command continues one that was stopped.
    """
    settings = settings_from(**{name: given.pop(name) for name in WORK_OPTIONS})
    work = module_of("film")
    knobs = {name: value for name in FILM_OPTIONS if (value := given.pop(name)) is not None}
    facts = work.film(scene, work.FilmRequest(**given), knobs, settings)
    return ended(facts, work.filmed, as_json)


@cli.command()
@click.argument("scene", metavar="TARGET")
@volume_options
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="A folder; with --interactive also one file, such as page.html.",
)
@options(GRID_OPTIONS)
@click.option(
    "--interactive", is_flag=True, help="Write a page that draws on the visitor's graphics card."
)
@click.option("--megabytes", callback=number(0.1, 1e6), help="Size limit of the interactive page.")
@click.option("--caption", help="A text under the picture.")
@click.option(
    "--target-error", callback=share_of_error, help="Relative error at which a picture is final."
)
@click.option(
    "--time", "seconds", callback=duration, help="Longest time for a picture: 5, 5s or 1m."
)
@click.option(
    "--deadline", callback=duration, help="Longest time for all pictures together, shared evenly."
)
@options(WORK_OPTIONS)
@AS_JSON
def publish(scene: str, interactive: bool, as_json: bool, **given: Any) -> int:
    """Write a page that shows pictures of TARGET by sliders, without a server.

    An option given as first:last:step becomes a slider; without any, the azimuth. An interactive
    page draws all views itself, for isovalues given as first:last. The same command continues one
    that was stopped.
    """
    settings = settings_from(**{name: given.pop(name) for name in WORK_OPTIONS})
    work = module_of("publish --interactive" if interactive else "publish")
    knobs = {name: value for name in GRID_OPTIONS if (value := given.pop(name)) is not None}
    facts = work.publish(scene, work.PageRequest(**given), knobs, settings)
    return ended(facts, work.published, as_json)


@cli.command()
@click.argument("target", required=False)
@volume_options
@click.option("--isovalue", type=float, help=KNOBS["isovalue"].text)
@click.option(
    "--size",
    type=click.IntRange(1, 4096),
    default=512,
    show_default=True,
    help="Pixels along each side.",
)
@click.option(
    "--repeats", type=click.IntRange(1), default=5, show_default=True, help="Rounds that are timed."
)
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def bench(
    target: str | None, isovalue: float | None, size: int, repeats: int, as_json: bool
) -> None:
    """Measure this machine with TARGET, a scene or a volume; with neither, a demo."""
    work = module_of("bench")
    show(work.bench(target, isovalue, size, repeats), work.table, as_json)


STORE_ARGUMENT = click.argument("where", metavar="[STORE]", required=False)


@cli.group()
def store() -> None:
    """Maintain a STORE of light, a folder or URL; by default the one that `isogi serve` uses.

    All of it is safe while servers and workers use the store.
    """


def store_at(where: str | None) -> Any:
    """Open the named store, else that of the settings. Raises StoreError if there is none."""
    return module_of("store").existing_store(settings_from(store=where))


@store.command()
@STORE_ARGUMENT
@AS_JSON
def verify(where: str | None, as_json: bool) -> int:
    """Check every object of a STORE, and change nothing; exit status 1 if any is damaged."""
    work = module_of("store")
    facts = work.verify(store_at(where))
    show(facts, work.verified, as_json)
    return 0 if facts["sound"] else 1


@store.command()
@STORE_ARGUMENT
@click.option(
    "--delete",
    is_flag=True,
    help="Delete what is damaged, instead of moving it to STORE/quarantine.",
)
@AS_JSON
def repair(where: str | None, delete: bool, as_json: bool) -> None:
    """Move damaged objects of a STORE away, so that they are baked again when they are needed."""
    work = module_of("store")
    show(work.repair(store_at(where), delete), work.repaired, as_json)


@store.command()
@STORE_ARGUMENT
@click.option("--quick", is_flag=True, help="Read no chunks, and count no texels.")
@AS_JSON
def stats(where: str | None, quick: bool, as_json: bool) -> None:
    """List the bakes in a STORE, with their size, texels, costs and age."""
    work = module_of("store")
    show(work.stats(store_at(where), not quick), work.table, as_json)


@store.command()
@STORE_ARGUMENT
@click.option(
    "--older-than",
    callback=age,
    help="Light that was neither baked nor read for this time: 30d, 12h.",
)
@click.option(
    "--keep-gb",
    type=click.FloatRange(0),
    help="The light unused longest, above this number of gigabytes.",
)
@click.option(
    "--scene", help="Only light of this scene or volume; without other options, all of it."
)
@click.option("--empty", is_flag=True, help="Layers that hold no light.")
@click.option("--yes", is_flag=True, help="Delete; without this option, only list.")
@AS_JSON
def prune(
    where: str | None,
    older_than: float | None,
    keep_gb: float | None,
    scene: str | None,
    empty: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Delete light from a STORE that is no longer needed; without --yes, only list it."""
    if older_than is None and keep_gb is None and scene is None and not empty:
        raise click.UsageError(
            "Name the light to delete: --older-than, --keep-gb, --scene or --empty."
        )
    work = module_of("store")
    rule = work.rule_of(older_than, keep_gb, scene, empty)
    show(work.prune(store_at(where), rule, yes), work.pruned, as_json)
