"""Measure every case, and write docs/stability.md: ``python -m benchmarks.stability``."""

import json
from collections.abc import Iterator
from pathlib import Path

import click
from tqdm import tqdm

from benchmarks.stability.case import Case, Outcome, Size
from benchmarks.stability.cases import CASES
from benchmarks.stability.curve import ramp_notes
from benchmarks.stability.page import page

PAGE = Path(__file__).parents[2] / "docs" / "stability.md"
SIZES = [size.name.lower() for size in Size]


@click.command()
@click.option("-o", "--output", default=PAGE, type=click.Path(path_type=Path, dir_okay=False), show_default=True)
@click.option("--size", type=click.Choice(SIZES), default="full", show_default=True, help="How thoroughly.")
@click.option("--only", multiple=True, metavar="TEXT", help="Cases whose group or name has this; writes no page.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def main(output: Path, size: str, only: tuple[str, ...], as_json: bool) -> None:
    """Measure the cases; status 1 where one does not hold."""
    chosen = [case for case in CASES if not only or any(text in f"{case.group} {case.name}" for text in only)]
    if not chosen:
        raise click.UsageError(f"No case has {' or '.join(map(repr, only))} in its group or name.")
    results = list(measured(chosen, Size[size.upper()]))
    if not only:
        output.write_text(page(results, size, ramp_notes(results, output.parent / "stability")))
    click.echo(json.dumps([facts(*each) for each in results]) if as_json else "\n".join(lines(results)))
    raise SystemExit(0 if all(case.holds(outcome) for case, outcome in results) else 1)


def measured(cases: list[Case], size: Size) -> Iterator[tuple[Case, Outcome]]:
    """Each case and its outcome."""
    for case in (bar := tqdm(cases, unit="case")):
        bar.set_description(f"{case.group}, {case.name}")
        yield case, case.measure(size)


def facts(case: Case, outcome: Outcome) -> dict[str, object]:
    """A case for a script."""
    names = {"group": case.group, "name": case.name, "expected": case.expected, "unit": case.unit}
    figures = {"worst": float(outcome.worst), "most": case.most, "got": outcome.got, "holds": case.holds(outcome)}
    return {**names, **figures, "known": case.known}


def lines(results: list[tuple[Case, Outcome]]) -> Iterator[str]:
    """A line for each case."""
    for case, outcome in results:
        verdict = "holds" if case.holds(outcome) else "DOES NOT HOLD"
        figures = f"{outcome.worst:.3g} of {case.most:.3g} {case.unit}"
        yield f"{verdict}: {case.group}, {case.name}: {figures} {outcome.got}"


if __name__ == "__main__":
    main()
