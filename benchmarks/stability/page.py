"""docs/stability.md: each case, what was expected, what was got, and the worst figure."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from benchmarks.stability.case import Case, Outcome

INTRODUCTION = """\
# Stability

What stiff fields and extreme values, shapes, views, lights and settings are expected to do, and what they do. Each \
row was measured, by `make stability SIZE={size}`; the tests measure the same cases with less of everything. A case \
holds where its worst figure is no more than the limit. Light is compared with paths that are traced from each \
pixel."""

KNOWN = """\
## Known

What cannot be made right, why, and how far off it may be."""

HEADER = ("case", "expected", "got", "worst", "limit")

Results = Sequence[tuple[Case, Outcome]]


def page(results: Results, size: str, notes: str = "") -> str:
    """The page, as Markdown, of what was measured at a ``size``; ``notes`` come at its end."""
    sections = [INTRODUCTION.format(size=size), told(results)]
    for group, rows in groupby(results, key=lambda result: result[0].group):
        sections.append(f"## {group.capitalize()}\n\n" + table(list(rows)))
    known = [f"- **{case.group}, {case.name}**: {case.known}" for case, _ in results if case.known]
    if known:
        sections.append("\n".join([KNOWN, "", *known]))
    return "\n\n".join([*sections, *([notes] if notes else [])]) + "\n"


def told(results: Results) -> str:
    """How many cases hold, in a sentence, those that do not, and how many have a fault that is known."""
    broken = [f"{case.group}, {case.name}" for case, outcome in results if not case.holds(outcome)]
    known = sum(bool(case.known) for case, _ in results)
    parts = [f"**{len(results) - len(broken)} of {len(results)} cases hold.**"]
    parts += [f"Not: {'; '.join(broken)}."] if broken else []
    parts += [f"Of {known} the limit is not what is expected, but what a known fault stays below."] if known else []
    return " ".join(parts)


def table(results: Results) -> str:
    """The rows of one group."""
    return "\n".join(map(row, [HEADER, ("---",) * len(HEADER), *map(cells, results)]))


def cells(result: tuple[Case, Outcome]) -> Iterator[str]:
    """One case: name, expectation, what was got, worst figure and limit."""
    case, outcome = result
    yield f"{case.name} (known)" if case.known else case.name
    yield case.expected
    yield outcome.got
    yield f"{figure(outcome.worst, case.unit)}{'' if case.holds(outcome) else ' **(more)**'}"
    yield figure(case.most, case.unit)


def figure(value: float, unit: str) -> str:
    """A figure in its unit; what is relative as a percentage, unless that would be all zeros."""
    return f"{value:.2%}" if unit == "relative" and not 0.0 < value < 1e-4 else f"{value:.3g} {unit}"


def row(texts: Iterable[str]) -> str:
    """A line of a table."""
    return f"| {' | '.join(text.replace('|', chr(92) + '|') for text in texts)} |"
