"""Measurements that the documents quote, and the steps of a release.

    python -m benchmarks.release measure [NAME ...]
    python -m benchmarks.release check
    python -m benchmarks.release tag VERSION

`measure` writes all pages of docs/measurements, one after the other: one night on two cores.
`check` refuses figures whose commit is not in the history, or too old for the code that they
measure. `tag` runs the check, joins the change log, and makes the commit and tag of a version.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from datetime import date
from typing import NamedTuple

import click

from benchmarks.common.measurement import FOLDER, ROOT

LONGEST_AGE = 150
"""Commits that may change what a page measures until its figures are too old to be quoted."""

TOWNCRIER = ("uv", "tool", "run", "towncrier==26.9.0")

VERSION_LINE = re.compile(r'^version = "[^"]*"$', re.MULTILINE)
"""The line of pyproject.toml that holds the version."""


class Page(NamedTuple):
    """A page of docs/measurements: its ``name``, the ``command`` after ``python -m benchmarks.``
    that writes it, and the ``sources`` (folders of the repository) that it measures.

    A page without a command needs files that the repository does not have, and is made by hand.
    """

    name: str
    command: tuple[str, ...]
    sources: tuple[str, ...]


LIGHT = ("isogi_core/kernels", "isogi_core/bake", "isogi_core/frame", "isogi_core/plan")
SERVICE = ("server", "worker")
FILES = ("isogi_core/files",)

PAGES = (
    Page("speed-frames", ("speed", "frames"), LIGHT),
    Page("speed-paths", ("speed", "paths"), ("isogi_core/kernels",)),
    Page(
        "speed-cold",
        (
            *("speed", "cold", "--repeats", "1", "--only", "engine", "--only", "head"),
            *("--only", "brain", "--only", "bonsai", "--only", "carp", "--only", "heptane"),
        ),
        (*LIGHT, *SERVICE),
    ),
    Page("speed-first-view", ("speed", "first-view"), (*LIGHT, *SERVICE)),
    Page(
        "accuracy-totals",
        ("accuracy", "totals", "--size", "48", "--paths", "512", "--only", "under grace"),
        LIGHT,
    ),
    Page("accuracy-table", ("accuracy", "table", "--size", "64", "--paths", "2048"), LIGHT),
    Page("accuracy-furnace", ("accuracy", "furnace", "--size", "48"), LIGHT),
    Page("accuracy-surfaces", ("accuracy", "surfaces", "--size", "24", "--paths", "512"), LIGHT),
    Page("accuracy-equal-error", ("accuracy", "equal-error", "--size", "256"), LIGHT),
    Page("accuracy-looks", ("accuracy", "looks"), LIGHT),
    Page("accuracy-reports", ("accuracy", "reports", "--size", "32", "--deadline", "150"), LIGHT),
    Page("service-load", ("service", "load", "--clients", "64", "--seconds", "180"), SERVICE),
    Page("service-routes", ("service", "routes", "demo:casting", "--seconds", "40"), SERVICE),
    Page("service-malformed", ("service", "malformed", "--files", "800"), (*FILES, *SERVICE)),
    Page("scaling-kinds", ("scaling", "kinds"), FILES),
    Page("scaling-kills-server", ("scaling", "kills", "--victim", "server"), SERVICE),
    Page("scaling-public", (), FILES),
)
"""The pages that README and guides quote; docs/measurements holds no other."""


def git(*arguments: str) -> str:
    """Return what a git command prints about this repository."""
    command = ["git", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def is_ancestor(commit: str) -> bool:
    """Return True if a ``commit`` is part of the history of the present one."""
    command = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0


def age(commit: str, sources: Sequence[str]) -> int:
    """Count the commits since ``commit`` that changed some of the ``sources``."""
    return int(git("rev-list", "--count", "--no-merges", f"{commit}..HEAD", "--", *sources))


def faults_of(page: Page) -> Iterator[str]:
    """Yield a sentence for each reason for which the figures of a ``page`` may not be quoted."""
    path = FOLDER / f"{page.name}.json"
    if not path.exists():
        yield f"{page.name}: there is no such page."
        return
    commit = json.loads(path.read_text(encoding="utf-8"))["commit"]
    if not is_ancestor(commit):
        yield f"{page.name}: its commit {commit} is not in the history."
        return
    count = age(commit, page.sources)
    if count > LONGEST_AGE:
        yield f"{page.name}: {count} commits have changed {', '.join(page.sources)} since then."


def faults(pages: Sequence[Page] = PAGES) -> list[str]:
    """Return a sentence for each fault of the quoted figures; none if all may be quoted."""
    found = [fault for page in pages for fault in faults_of(page)]
    known = {page.name for page in pages}
    strange = sorted({path.stem for path in FOLDER.glob("*.json")} - known)
    return found + [f"{name}: benchmarks/release.py does not list this page." for name in strange]


def refuse_old_figures() -> None:
    """Raise ClickException, with a sentence for each, if quoted figures have faults."""
    found = faults()
    if found:
        lines = "\n".join(found)
        raise click.ClickException(f"{lines}\nMeasure again: python -m benchmarks.release measure")


@click.group(help="Measurements that the documents quote, and the steps of a release.")
def release() -> None:
    """Hold the commands."""


@release.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
def measure(names: tuple[str, ...]) -> None:
    """Write the pages of docs/measurements, or those NAMED."""
    unknown = sorted(set(names) - {page.name for page in PAGES})
    if unknown:
        raise click.ClickException(f"No page is called {', '.join(unknown)}.")
    failed = []
    for page in PAGES:
        if not page.command or (names and page.name not in names):
            continue
        suite, *arguments = page.command
        command = [sys.executable, "-m", f"benchmarks.{suite}", *arguments, "--write"]
        click.echo(f"{page.name}: {' '.join(command[1:])}")
        # A part that fails costs the night one page, and not all that come after it.
        if subprocess.run(command, cwd=ROOT, check=False).returncode:
            failed.append(page.name)
    if failed:
        raise click.ClickException(f"Not measured: {', '.join(failed)}.")


@release.command()
def check() -> None:
    """Refuse quoted figures whose commit is gone, or too old for what they measure."""
    refuse_old_figures()
    click.echo(f"All {len(PAGES)} pages are of this history and at most {LONGEST_AGE} commits old.")


@release.command()
@click.argument("version")
def tag(version: str) -> None:
    """Make the commit and the tag of a VERSION, such as 0.1.0, of a clean tree."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise click.ClickException(f"'{version}' is no version such as 0.1.0.")
    if git("status", "--porcelain"):
        raise click.ClickException("Commit or remove what is changed in the tree first.")
    if git("tag", "--list", f"v{version}"):
        raise click.ClickException(f"The tag v{version} exists.")
    refuse_old_figures()
    date_changes(version)
    project = ROOT / "pyproject.toml"
    text = project.read_text(encoding="utf-8")
    project.write_text(VERSION_LINE.sub(f'version = "{version}"', text), encoding="utf-8")
    git("add", "--all")
    git("commit", "--quiet", "--allow-empty", "--message", f"Release {version}")
    git("tag", "--annotate", f"v{version}", "--message", f"isogi {version}")
    click.echo(f"Tagged v{version}. Publish it: git push origin main v{version}")


def date_changes(version: str) -> None:
    """Give the section of a ``version`` in CHANGELOG.md its date, or have towncrier write it.

    Raises ClickException if the section stands and files of changes/ are not part of it.
    """
    path = ROOT / "CHANGELOG.md"
    text = path.read_text(encoding="utf-8")
    files = [file.name for file in (ROOT / "changes").glob("*.md") if file.name != "README.md"]
    heading = f"## {version} (not released)"
    if heading not in text:
        subprocess.run([*TOWNCRIER, "build", "--yes", "--version", version], cwd=ROOT, check=True)
        return
    if files:
        raise click.ClickException(
            f"CHANGELOG.md has a section of {version}: write {', '.join(sorted(files))} of "
            "changes/ into it, and remove these files."
        )
    path.write_text(text.replace(heading, f"## {version} ({date.today()})"), encoding="utf-8")


if __name__ == "__main__":
    release()
