"""The commands of README and docs, as they stand on their pages, and what a reader has beside
them.
"""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import nibabel as nib
import nrrd
import numpy as np

from isogi_core.files.radiance import write_hdr

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
HERE = "http://127.0.0.1:8000"
"""Where a server is on the pages."""

FENCED = re.compile(r"^```(sh|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)

ELSEWHERE = {
    "curl -LO https://raw": "needs the network: the tests have a file of this name",
    "make serve": "serves until it is stopped: the server of these tests stands for it",
    "make test": "runs these tests",
    "isogi serve": (
        "serves until it is stopped: tests/cluster/test_coming_and_going.py holds its options"
    ),
    "dask scheduler": (
        "runs until it is stopped: tests/cluster/test_coming_and_going.py holds its options"
    ),
    "dask worker": (
        "runs until it is stopped: tests/cluster/test_coming_and_going.py holds its options"
    ),
    "isogi prewarm engine.toml --continue": (
        "needs one that was stopped: tests/server/prewarm/test_kill.py kills some"
    ),
    "docker compose": "needs Docker: tests/cluster/test_compose.py holds its services",
}
"""How lines begin that are not run here, and why."""

LONG = tuple(
    f"isogi {name}" for name in ("export", "film", "prewarm", "publish", "reference", "report")
)
"""How lines begin that may take minutes: `make test-long` runs them."""


@dataclass(frozen=True)
class Block:
    """A block of a page: its ``kind``, sh or python, and its lines."""

    kind: str
    lines: tuple[str, ...]

    def without(self, *starts: str) -> "Block":
        """The block without the lines that begin so."""
        return Block(self.kind, tuple(line for line in self.lines if not line.startswith(starts)))


def pages() -> list[Path]:
    """README, and the pages of docs."""
    return [README, *sorted((ROOT / "docs").glob("*.md"))]


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page that a reader runs, in their order."""
    found = FENCED.findall(page.read_text(encoding="utf-8"))
    return [Block(kind, tuple(text.splitlines())) for kind, text in found]


def lines_of(page: Path) -> Iterator[str]:
    """The lines that a reader types into a shell."""
    return (
        line
        for block in blocks_of(page)
        if block.kind == "sh"
        for line in block.lines
        if line.strip()
    )


def isogi_lines(page: Path) -> list[str]:
    """The lines that call isogi."""
    return [line for line in lines_of(page) if shlex.split(line, comments=True)[:1] == ["isogi"]]


def write_files(folder: Path) -> Path:
    """Write what the pages name into a folder: a volume, a probe, the README's scene, and views;
    gives the scene.
    """
    z, y, x = np.mgrid[:10, :12, :14]
    radii = np.sqrt(((x - 6.5) / 6) ** 2 + ((y - 5.5) / 5) ** 2 + ((z - 4.5) / 4) ** 2)
    engine = np.clip(255 * (1.3 - radii) / 1.3, 0, 255).astype(np.uint8)
    for name in ("engine.nhdr", "engine.nrrd"):
        nrrd.write(str(folder / name), engine, index_order="C")
    nib.save(nib.Nifti1Image(engine.T, np.eye(4)), str(folder / "T1.nii.gz"))
    write_hdr(folder / "grace.hdr", np.linspace(2.0, 0.2, 8)[:, None, None] * np.ones((8, 16, 3)))
    (folder / "engine.toml").write_text(scene_of_the_readme())
    (folder / "views.txt").write_text("?azimuth=0&elevation=10\n?azimuth=90&elevation=40\n")
    return folder / "engine.toml"


def scene_of_the_readme() -> str:
    """The lines that the README says to save as engine.toml."""
    (text,) = re.findall(
        r"^```toml\n(.*?)^```\n\nSave these lines as `engine.toml`", README.read_text(), re.M | re.S
    )
    return str(text)
