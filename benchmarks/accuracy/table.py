"""How near pictures are to the truth while the light turns, beside the papers' own method at equal
bake time.

    python -m benchmarks.accuracy table -o FOLDER [--size 96] [--paths 1024] [--only "engine under
    grace"]

Each case is a view of a volume under a light; light is baked once, for all turns, to the scene's
target error, by the plan's own choices. The papers' method (see ``papers``) bakes the same view for
as many seconds of the processor, or more. Both are held against references that are path-traced
from each pixel to the lights themselves. What was measured is kept in FOLDER; a case that is there
is not measured again. Needs the shared data.
"""

import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image

from benchmarks.accuracy.benches import bench_of, wanted
from benchmarks.accuracy.errors import rms
from benchmarks.accuracy.papers import PapersBake
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import Subject, scene_of
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.model.view import quaternion_from_angles
from isogi_core.reference import Reference
from isogi_core.storage.atomic_file import write_whole
from isogi_report.metrics import error_map, score, shown_as
from isogi_report.plots import error_colours

PLACES = (("engine", 70), ("engine", 170), ("CT head", 110), ("MNI brain", 90), ("carp", 110))
LIGHTS = ("constant light", "uffizi", "grace", "noon_grass")

FINER = (("lattice", 2), ("order", 10), ("target_error", 0.01))
"""What a scene may say of a volume whose bones are a voxel or two thin."""

TURNS = ((0.0, 0.0, 0.0), (110.0, 25.0, 0.0), (230.0, -40.0, 60.0))
"""Angles (z, y, x), in degrees, that the light is turned by."""

RMSE = 0.03
P99 = 0.10
SUN = 0.04
"""What issue and page ask for: relative RMSE, its 99th percentile, and the RMSE under
noon_grass.
"""

SCALE = 0.2
"""The relative error at the ends of the maps' colours."""

PICTURED = 1
"""Which of the TURNS pictures show."""

ABOUT = """\
Each row is a view of a volume, its light turned to {turns} orientations; the figures are those of \
the worst. Errors are of the luminance of surface pixels, against paths from each pixel to the \
lights themselves with as many bounces as may matter ({paths:,} a pixel), over the reference's \
mean: the relative RMSE, less the reference's own noise, and the 99th percentile of errors as they \
are. Light is baked once for all turns, by scenes of albedo 0.7 and isogi's own plan, to a target \
error of 2 %, or as they say besides. Beside it stands the papers' own method: harmonics of order \
5 of all light (one number under constant light), texels on their own isosurfaces, trilinear \
pixels, and as many paths for each texel as take at least as long to bake. Seconds are of the \
processor. The goals are {rmse:.0%} and {p99:.0%}, and {sun:.0%} under noon_grass. Pictures have \
{size} × {size} pixels."""

HEAD = (
    *(
        "view",
        "papers' method, RMSE (99th percentile), %",
        "**isogi**",
        "within goals",
        "references' noise",
    ),
    *("papers' bake, s", "bake, s", "papers' bytes a texel", "bytes a texel", "lobes"),
)


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
        """The name of the folder of what is measured in pictures of a size, by so many paths a
        pixel.
        """
        told = "".join(f"-{key}-{value:g}" for key, value in self.told)
        return f"{self.subject.folder}{told}-{size}-{paths}"


OWN = tuple(Case(Subject(*place, light)) for place in PLACES for light in LIGHTS)
TOLD = tuple(Case(Subject(*PLACES[-1], light), FINER) for light in LIGHTS[1:])
CASES = (*OWN, *TOLD)


@dataclass(frozen=True)
class Measured:
    """What was found of one subject, by turns: ``rmse`` and ``p99`` of ours, and of the papers'
    method.

    ``noise`` is the references' own; ``seconds`` of the processor were baked, and a texel takes so
    many ``bytes``.
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


@part(size=96)
@click.option(
    "-o",
    "--output",
    default="accuracy",
    type=click.Path(path_type=Path, file_okay=False),
    show_default=True,
)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=1024,
    show_default=True,
    help="Paths a pixel of references.",
)
@click.option(
    "--only", multiple=True, help="Part of a view's name, such as 'engine under grace'; repeatable."
)
def table(output: Path, size: int, paths: int, only: tuple[str, ...]) -> Measurement:
    """Pictures beside the truth while the light turns, and beside the papers' own method."""
    folders = {case: output / case.folder(size, paths) for case in CASES}
    for case, folder in folders.items():
        if wanted(case.name, only) and not (folder / "measured.json").exists():
            click.echo(case.name, err=True)
            measure(case, folder, size, paths)
    found = {
        case: read(folder)
        for case, folder in folders.items()
        if (folder / "measured.json").exists()
    }
    sheets = dict(sheets_of(folders))
    pictures = {sheet_of(place): data for place, data in sheets.items()}
    return Measurement(
        f"Pictures beside the truth while the light turns, {size} × {size}",
        figures_of(found),
        body(found, sheets, size, paths),
        pictures,
    )


def measure(case: Case, folder: Path, size: int, paths: int) -> None:
    """Bake a view by both methods, compare, and keep what was found in its ``folder``."""
    scene = scene_of(case.subject, **dict(case.told))
    bench = bench_of(scene, size, folder)
    ours = bench.planned
    papers = PapersBake(bench)
    papers.grow(ours.seconds, lambda text: click.echo(f"  the papers' method: {text}", err=True))
    ours.frame()
    renderer = bench.renderer(scene)
    found = []
    shown = {}
    for number, angles in enumerate(TURNS):
        turned = replace(bench.view, light=quaternion_from_angles(*angles))
        best = replace(bench, view=turned, folder=folder / f"turn-{number}", _made={}).reference(
            paths
        )
        pictures = {
            "papers": papers.radiance(turned),
            "isogi": renderer.render(turned, Goal.checked(scene.target_error)).radiance,
        }
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


def drawn(
    pictures: Mapping[str, np.ndarray], best: Reference, exposure: float
) -> dict[str, np.ndarray]:
    """Pictures (h, w, 3) uint8 sRGB of both methods, the reference, and the methods' errors."""
    shown = {
        name: shown_as(each, best.on, exposure)
        for name, each in {**pictures, "reference": best.mean}.items()
    }
    errors = {
        f"{name} error": error_colours(error_map(each, best), SCALE)
        for name, each in pictures.items()
    }
    return {**shown, **errors}


def keep(folder: Path, found: Measured, shown: Mapping[str, np.ndarray]) -> None:
    """Write what was found of a view, the figures last."""
    np.savez_compressed(folder / "pictures.npz", **dict[str, Any](shown))
    write_whole(folder / "measured.json", json.dumps(asdict(found), indent=1).encode())


def read(folder: Path) -> Measured:
    """What was found of a view."""
    return Measured(**json.loads((folder / "measured.json").read_text("utf-8")))


def asked_rmse(subject: Subject) -> float:
    """The relative RMSE that is asked of a subject."""
    if subject.light == "noon_grass":
        return SUN
    return RMSE


def met(case: Case, found: Measured) -> bool:
    """Whether a view is within the goals at each turn."""
    return max(found.rmse) <= asked_rmse(case.subject) and max(found.p99) <= P99


def cells(case: Case, found: Measured) -> tuple[str, ...]:
    """A view's row of the table."""
    return (
        case.name,
        cell(found.papers_rmse, found.papers_p99),
        f"**{cell(found.rmse, found.p99)}**",
        "yes" if met(case, found) else "no",
        f"{max(found.noise):.2%}",
        f"{found.papers_seconds:.0f}",
        f"{found.seconds:.0f}",
        *map(str, (found.papers_bytes, found.bytes, found.lobes)),
    )


def cell(rmse: Sequence[float], p99: Sequence[float]) -> str:
    """The worst turn's errors, in per cent."""
    return f"{100 * max(rmse):.2f} ({100 * max(p99):.1f})"


def body(
    found: Mapping[Case, Measured], sheets: Iterable[tuple[str, float]], size: int, paths: int
) -> str:
    """The text of the page: what was done, the table, and the pictures of the places that have a
    sheet.
    """
    about = ABOUT.format(turns=len(TURNS), paths=paths, rmse=RMSE, p99=P99, sun=SUN, size=size)
    rows = markdown(HEAD, (cells(case, each) for case, each in found.items()))
    return "\n\n".join([about, rows, *map(shown_in_page, sheets)])


def figures_of(found: Mapping[Case, Measured]) -> dict[str, float]:
    """Figures of each view, and of those together that are by the plan's own choice."""
    figures: dict[str, float] = {}
    for case, each in found.items():
        figures |= {
            f"{case.name}: RMSE, %": 100.0 * max(each.rmse),
            f"{case.name}: 99th percentile, %": 100.0 * max(each.p99),
            f"{case.name}: papers' RMSE, %": 100.0 * max(each.papers_rmse),
            f"{case.name}: papers' 99th percentile, %": 100.0 * max(each.papers_p99),
            f"{case.name}: bake, s": each.seconds,
            f"{case.name}: papers' bake, s": each.papers_seconds,
            f"{case.name}: bytes a texel": each.bytes,
        }
    own = {case: each for case, each in found.items() if not case.told}
    finer = {case: each for case, each in found.items() if case.told}
    for name, some in (("by the plan", own), ("of scenes that say more", finer)):
        figures |= {
            f"views {name}": len(some),
            f"views {name} within goals": sum(starmap(met, some.items())),
        }
    if own:
        figures["RMSE of all turns, %"] = 100.0 * rms(
            [error for each in own.values() for error in each.rmse]
        )
        papers = [error for each in own.values() for error in each.papers_rmse]
        figures["papers' RMSE of all turns, %"] = 100.0 * rms(papers)
    return figures


def shown_in_page(place: tuple[str, float]) -> str:
    """A place's pictures in the page."""
    name = f"{place[0]} at {place[1]:g}"
    what = "the papers' method, isogi, the reference, and errors of the papers' method and of isogi"
    caption = (
        f"{', '.join(LIGHTS)} from above; {what} (blue {SCALE:.0%} of the mean too dark, "
        "red too bright)"
    )
    return f"## {name}\n\n![{name}](accuracy-table/{sheet_of(place)})\n\n*{name}; {caption}.*"


def sheet_of(place: tuple[str, float]) -> str:
    """The name of the file with a place's pictures."""
    return f"{place[0]}-{place[1]:g}.png".lower().replace(" ", "-")


def sheets_of(folders: Mapping[Case, Path]) -> Iterator[tuple[tuple[str, float], bytes]]:
    """A sheet (PNG) for each place that is measured under all lights: lights from above, columns as
    the page says.
    """
    columns = ("papers", "isogi", "reference", "papers error", "isogi error")
    for place in PLACES:
        files = [folders[Case(Subject(*place, light))] / "pictures.npz" for light in LIGHTS]
        if all(file.exists() for file in files):
            rows = []
            for file in files:
                with np.load(file) as shown:
                    rows.append(np.concatenate([shown[name] for name in columns], axis=1))
            sheet = Image.fromarray(np.concatenate(rows))
            data = io.BytesIO()
            sheet.resize((2 * sheet.width, 2 * sheet.height), Image.Resampling.NEAREST).save(
                data, "png"
            )
            yield place, data.getvalue()
