"""How near pictures are to the truth while the light turns, beside the papers' own method at equal bake time.

    python -m benchmarks.accuracy -o FOLDER [--size 96] [--paths 1024] [--only "engine under grace"]

Writes docs/accuracy-measured.md and its pictures. Each subject is a view of a volume under a light; light is baked
once, for all turns, to the scene's target error, with all that a scene may ask for (``sharpen = true``). The papers'
method (see ``papers``) bakes the same view for as many seconds of the processor, or more. Both are held against
references that are path-traced from each pixel to the lights themselves. What was measured is kept in FOLDER; a
subject that is there is not measured again. Needs the shared data.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image

from benchmarks.error_curve import rms
from benchmarks.papers import PapersBake
from benchmarks.reports import DOCS, Subject, scene_of
from isogi_core.model.view import quaternion_from_angles
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import error_map, score, shown_as
from isogi_core.report.reference import Reference
from server.measure import view_of
from server.render import write
from server.report.command import STAND
from server.report.prints import error_colours

PLACES = (("engine", 70), ("engine", 170), ("CT head", 110), ("MNI brain", 90), ("carp", 110))
LIGHTS = ("constant light", "uffizi", "grace", "noon_grass")

FINER = (("lattice", 2), ("order", 10), ("target_error", 0.01))
"""What a scene may say of a volume whose bones are a voxel or two thin."""

TURNS = ((0.0, 0.0, 0.0), (110.0, 25.0, 0.0), (230.0, -40.0, 60.0))
"""Angles (z, y, x), in degrees, that the light is turned by."""

RMSE, P99, SUN = 0.03, 0.10, 0.04
"""What issue and page ask for: relative RMSE, its 99th percentile, and the RMSE under noon_grass."""

SCALE = 0.2
"""The relative error at the ends of the maps' colours."""

PICTURED = 1
"""Which of the TURNS pictures show."""

ABOUT = """\
# Measured: pictures beside the truth while the light turns

Each row is a view of a volume, its light turned to {turns} orientations; the figures are those of the worst. Errors \
are of the luminance of surface pixels, against paths from each pixel to the lights themselves with as many bounces \
as may matter ({paths:,} a pixel), over the reference's mean: the relative RMSE, less the reference's own noise, and \
the 99th percentile of errors as they are. Light is baked once for all turns, by scenes of albedo 0.7 with `sharpen \
= true` and else isogi's own plan, to a target error of 2 %, or as they say besides: the last rows are of a volume \
whose bones are a voxel or two thin. Beside it stands the papers' own method: harmonics of \
order 5 of all light (one number under constant light), texels on their own isosurfaces, trilinear pixels, and as \
many paths for each texel as take at least as long to bake. Seconds are of the processor. The goals are {rmse:.0%} \
and {p99:.0%}, and \
{sun:.0%} under noon_grass."""

MADE = """\
`python -m benchmarks.accuracy -o FOLDER` makes this page anew. Pictures have {size} × {size} pixels."""


@dataclass(frozen=True)
class Case:
    """A view of a ``subject`` whose scene says what is ``told``, besides what all of them say."""

    subject: Subject
    told: tuple[tuple[str, float], ...] = ()

    @property
    def name(self) -> str:
        """What a person calls it."""
        return ", ".join([self.subject.name, *(f"`{key} = {value:g}`" for key, value in self.told)])

    def folder(self, size: int, paths: int) -> str:
        """The name of the folder of what is measured in pictures of a size, by so many paths a pixel."""
        told = "".join(f"-{key}-{value:g}" for key, value in self.told)
        return f"{self.subject.folder}{told}-{size}-{paths}"


OWN = tuple(Case(Subject(*place, light)) for place in PLACES for light in LIGHTS)
TOLD = tuple(Case(Subject(*PLACES[-1], light), FINER) for light in LIGHTS[1:])
CASES = (*OWN, *TOLD)


@dataclass(frozen=True)
class Measured:
    """What was found of one subject, by turns: ``rmse`` and ``p99`` of ours, and of the papers' method.

    ``noise`` is the references' own; ``seconds`` of the processor were baked, and a texel takes so many ``bytes``.
    """

    rmse: list[float]
    p99: list[float]
    papers_rmse: list[float]
    papers_p99: list[float]
    noise: list[float]
    seconds: float
    papers_seconds: float
    bytes: int
    papers_bytes: int
    lobes: int


@click.command()
@click.option("-o", "--output", default="accuracy", type=click.Path(path_type=Path, file_okay=False), show_default=True)
@click.option("--size", type=click.IntRange(8, 1024), default=96, show_default=True, help="Pixels along each side.")
@click.option("--paths", type=click.IntRange(8), default=1024, show_default=True, help="Paths a pixel of references.")
@click.option("--only", multiple=True, help="Part of a subject's name, such as 'engine under grace'; repeatable.")
def main(output: Path, size: int, paths: int, only: tuple[str, ...]) -> None:
    """Measure what is not in OUTPUT yet, and write the page when all of it is there."""
    folders = {case: output / case.folder(size, paths) for case in CASES}
    for case, folder in folders.items():
        if (not only or any(part in case.name for part in only)) and not (folder / "measured.json").exists():
            click.echo(case.name, err=True)
            measure(case, folder, size, paths)
        if (folder / "measured.json").exists():
            click.echo(line_of(case, read(folder)))
    if all((folder / "measured.json").exists() for folder in folders.values()):
        write_page({case: read(folder) for case, folder in folders.items()}, size, paths)
        write_pictures(folders)


def measure(case: Case, folder: Path, size: int, paths: int) -> None:
    """Bake a view by both methods, compare, and keep what was found in its ``folder``."""
    scene = scene_of(case.subject, sharpen=True, **dict(case.told))
    view = view_of(scene, size, camera=scene.camera(**STAND, fov=30.0))
    bench = Bench(scene, view, folder)
    ours, papers = bench.planned, PapersBake(bench)
    papers.grow(ours.seconds, lambda text: click.echo(f"  the papers' method: {text}", err=True))
    ours.frame()
    renderer, found, shown = bench.renderer(scene), [], {}
    for number, angles in enumerate(TURNS):
        turned = replace(view, light=quaternion_from_angles(*angles))
        best = replace(bench, view=turned, folder=folder / f"turn-{number}", _made={}).reference(paths)
        pictures = {"papers": papers.radiance(turned), "isogi": renderer.render(turned, scene.target_error).radiance}
        found.append([score(picture, best, 1.0) for picture in pictures.values()])
        if number == PICTURED:
            shown = drawn(pictures, best, scene.default_exposure)
    theirs, own = zip(*found, strict=True)
    keep(
        folder,
        Measured(
            rmse=[each.rmse for each in own],
            p99=[each.p99 for each in own],
            papers_rmse=[each.rmse for each in theirs],
            papers_p99=[each.p99 for each in theirs],
            noise=[each.noise for each in own],
            seconds=ours.seconds,
            papers_seconds=papers.seconds,
            bytes=scene.plan.bytes_per_texel,
            papers_bytes=papers.bytes,
            lobes=scene.plan.lobes,
        ),
        shown,
    )


def drawn(pictures: Mapping[str, np.ndarray], best: Reference, exposure: float) -> dict[str, np.ndarray]:
    """Pictures (h, w, 3) uint8 sRGB of both methods, the reference, and the methods' errors."""
    shown = {name: develop(each, best.on, exposure) for name, each in {**pictures, "reference": best.mean}.items()}
    errors = {f"{name} error": error_colours(error_map(each, best), SCALE) for name, each in pictures.items()}
    return {**shown, **errors}


def develop(radiance: np.ndarray, on: np.ndarray, exposure: float) -> np.ndarray:
    """Radiance as frames show it, (h, w, 3) uint8 sRGB."""
    return np.rint(255.0 * shown_as(radiance, on, exposure)).astype(np.uint8)


def keep(folder: Path, found: Measured, shown: Mapping[str, np.ndarray]) -> None:
    """Write what was found of a view, the figures last."""
    np.savez_compressed(folder / "pictures.npz", **dict[str, Any](shown))
    write(folder / "measured.json", json.dumps(asdict(found), indent=1).encode())


def read(folder: Path) -> Measured:
    """What was found of a view."""
    return Measured(**json.loads((folder / "measured.json").read_text("utf-8")))


def goal(subject: Subject) -> float:
    """The relative RMSE that is asked of a subject."""
    return SUN if subject.light == "noon_grass" else RMSE


def met(case: Case, found: Measured) -> bool:
    """Whether a view is within the goals at each turn."""
    return max(found.rmse) <= goal(case.subject) and max(found.p99) <= P99


def line_of(case: Case, found: Measured) -> str:
    """A view's row of the table."""
    papers, own = cell(found.papers_rmse, found.papers_p99), cell(found.rmse, found.p99)
    bakes, within = f"{found.papers_seconds:.0f} | {found.seconds:.0f}", "yes" if met(case, found) else "no"
    return (
        f"| {case.name} | {papers} | **{own}** | {within} | {max(found.noise):.2%} | {bakes}"
        f" | {found.papers_bytes} | {found.bytes} | {found.lobes} |"
    )


def cell(rmse: Sequence[float], p99: Sequence[float]) -> str:
    """The worst turn's errors, in per cent."""
    return f"{100 * max(rmse):.2f} ({100 * max(p99):.1f})"


def write_page(found: Mapping[Case, Measured], size: int, paths: int) -> None:
    """Write docs/accuracy-measured.md."""
    about = ABOUT.format(turns=len(TURNS), paths=paths, rmse=RMSE, p99=P99, sun=SUN)
    head = (
        "| view | papers' method, RMSE (99th percentile), % | **isogi** | within goals | references' noise"
        " | papers' bake, s | bake, s | papers' bytes a texel | bytes a texel | lobes |"
    )
    rule = "| --- | ---: | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    table = "\n".join([head, rule, *(line_of(case, each) for case, each in found.items())])
    parts = [about, table, summed(found), MADE.format(size=size), *map(shown_in_page, PLACES)]
    write(DOCS / "accuracy-measured.md", ("\n\n".join(parts) + "\n").encode())


def summed(found: Mapping[Case, Measured]) -> str:
    """What is said of all views."""
    by_plan, finer = (sum(met(case, found[case]) for case in cases) for cases in (OWN, TOLD))
    own, papers = (
        rms([error for case in OWN for error in getattr(found[case], name)]) for name in ("rmse", "papers_rmse")
    )
    return (
        f"{by_plan} of {len(OWN)} views are within the goals by the plan's own choice, and {finer} of the {len(TOLD)}"
        f" whose scenes say more. Over the former and all turns the root mean square of the errors is {own:.2%}; the"
        f" papers' method has {papers:.2%}."
    )


def shown_in_page(place: tuple[str, float]) -> str:
    """A place's pictures in the page."""
    name = f"{place[0]} at {place[1]:g}"
    what = "the papers' method, isogi, the reference, and errors of the papers' method and of isogi"
    caption = f"{', '.join(LIGHTS)} from above; {what} (blue {SCALE:.0%} of the mean too dark, red too bright)"
    return f"## {name}\n\n![{name}]({sheet_of(place)})\n\n*{name}; {caption}.*"


def sheet_of(place: tuple[str, float]) -> str:
    """Where a place's pictures are, from docs."""
    return f"accuracy/{place[0]}-{place[1]:g}.png".lower().replace(" ", "-")


def write_pictures(folders: Mapping[Case, Path]) -> None:
    """Write a sheet for each place: lights from above, and columns as the page says."""
    for place in PLACES:
        rows = []
        for light in LIGHTS:
            with np.load(folders[Case(Subject(*place, light))] / "pictures.npz") as shown:
                columns = ("papers", "isogi", "reference", "papers error", "isogi error")
                rows.append(np.concatenate([shown[name] for name in columns], axis=1))
        sheet = Image.fromarray(np.concatenate(rows))
        sheet.resize((2 * sheet.width, 2 * sheet.height), Image.Resampling.NEAREST).save(DOCS / sheet_of(place))


if __name__ == "__main__":
    main()
