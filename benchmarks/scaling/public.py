"""Public files of many kinds: what isogi takes each for, and whether one command lights it.

    python -m benchmarks.scaling public --list FILE --folder PICTURES [--seconds 60]

The list has a line for each volume: a word that says where it comes from, and its path beside the
list, with what is chosen in it after a #. The files are no part of this repository.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.suite import part
from isogi_core.plan.assembly import load_scene

ERROR = 0.1
"""Error at which a picture is done."""

HEAD = ("from", "file", "read as", "voxels", "isovalue", "error, %")


@dataclass(frozen=True)
class Lit:
    """A volume that was drawn: where it is ``taken`` from, what it was read as, and its picture's
    ``error``.

    ``error`` is None where it was refused, and ``read_as`` says why then.
    """

    taken: str
    file: str
    read_as: str
    shape: tuple[int, ...] = ()
    isovalue: float = 0.0
    error: float | None = None

    @property
    def row(self) -> tuple[str, ...]:
        """A row of the table."""
        if self.error is None:
            return self.taken, self.file, self.read_as, "", "", "refused"
        size = " × ".join(map(str, self.shape[::-1]))
        return (
            self.taken,
            self.file,
            self.read_as,
            size,
            f"{self.isovalue:.5g}",
            f"{100.0 * self.error:.1f}",
        )


def draw(taken: str, path: str, picture: Path, seconds: int) -> Lit:
    """Draw the volume at ``path`` by one command, with a store for it alone."""
    with tempfile.TemporaryDirectory() as store:
        size = [
            "--width",
            "256",
            "--height",
            "192",
            "--target-error",
            str(ERROR),
            "--time",
            f"{seconds}s",
        ]
        given = ["-o", str(picture), "--store", store, "--json", *size]
        command = [sys.executable, "-m", "isogi_server", "render", path, *given]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    name = Path(path).name
    if done.returncode:
        return Lit(taken, name, (done.stderr.strip().splitlines() or [""])[-1].replace(path, name))
    scene = load_scene(path)
    read_as = scene.volume.orientation.read_as
    return Lit(
        taken,
        name,
        read_as,
        scene.volume.shape,
        float(scene.isovalue),
        json.loads(done.stdout)["error"],
    )


def lines_of(listed: Path) -> Iterator[tuple[str, str]]:
    """Where each volume of a list comes from, and its path."""
    for line in listed.read_text(encoding="utf-8").splitlines():
        taken, _, path = line.partition(" ")
        if path:
            yield taken, str(listed.parent / path.strip())


@part()
@click.option(
    "--list", "listed", type=click.Path(exists=True, dir_okay=False, path_type=Path), required=True
)
@click.option(
    "--seconds",
    type=click.IntRange(1),
    default=60,
    show_default=True,
    help="Most seconds to light each.",
)
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="Where pictures go.",
)
def public(listed: Path, seconds: int, folder: Path) -> Measurement:
    """Public files of many kinds: what each is read as, and the error of its picture."""
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for number, (taken, path) in enumerate(lines_of(listed)):
        found.append(draw(taken, path, folder / f"{number:02}.png", seconds))
        click.echo(" | ".join(found[-1].row), err=True)
    lit = [each.error for each in found if each.error is not None]
    figures = {
        "volumes": len(found),
        "lit": len(lit),
        "within 10 %": sum(error <= ERROR for error in lit),
    }
    refused = ", ".join(each.file for each in found if each.error is None)
    table = markdown(HEAD, [each.row for each in found], left=3)
    return Measurement(
        f"{len(found)} public volumes", figures, table, wrong=refused and f"Not lit: {refused}."
    )
