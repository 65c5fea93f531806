"""Suites and their parts as commands: a part returns what it measured; printing and writing are
done here.
"""

import json
import shlex
from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from benchmarks.common.measurement import Measurement, merged, write_measurement
from isogi_report.sections import plain

Result = Measurement | Iterator[Measurement]
"""What a part gives: a measurement, or several as they come."""

TEXTS = {"size": "Pixels a side.", "repeats": "Timed rounds."}
"""Options that many parts have."""

HIDDEN = ("as_json", "write")
"""Parameters that change nothing of what is measured."""


def part(**defaults: int) -> Callable[[Callable[..., Result]], click.Command]:
    """Decorator: a function that measures, as a part of the suite whose package it is in.

    ``defaults`` may name ``size`` (pixels a side) and ``repeats`` (timed rounds), which the part
    then has as options.
    """

    def decorate(measure: Callable[..., Result]) -> click.Command:
        @wraps(measure)
        def run(as_json: bool, write: bool, **given: Any) -> None:
            result = measure(**given)
            found = []
            for each in [result] if isinstance(result, Measurement) else result:
                click.echo(
                    json_of(each) if as_json else f"\n{each.title}\n{each.text or each.lines}"
                )
                found.append(each)
            if write and found:
                keep(measure, merged(found))
            wrong = " ".join(each.wrong for each in found if each.wrong)
            if wrong:
                raise click.ClickException(wrong)

        made: Callable[..., Any] = run
        for name, default in defaults.items():
            add = click.option(
                f"--{name}",
                type=click.IntRange(1),
                default=default,
                show_default=True,
                help=TEXTS[name],
            )
            made = add(made)
        made = click.option(
            "--write", is_flag=True, help="Write the measurement to docs/measurements."
        )(made)
        made = click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")(
            made
        )
        return click.command(name_of(measure))(made)

    return decorate


def json_of(found: Measurement) -> str:
    """The figures on one line."""
    return json.dumps(plain(found.figures), allow_nan=False, ensure_ascii=False)


def name_of(measure: Callable[..., Result]) -> str:
    """What a part is called on the command line."""
    return measure.__name__.replace("_", "-")


def keep(measure: Callable[..., Result], found: Measurement) -> Path:
    """Write a part's measurement under the name of its suite, its own and its variant's."""
    suite = measure.__module__.split(".")[1]
    own = name_of(measure)
    command = shlex.join(
        ["python", "-m", f"benchmarks.{suite}", own, *told(click.get_current_context())]
    )
    page = write_measurement("-".join(filter(None, (suite, own, found.variant))), found, command)
    click.echo(f"wrote {page.name} and {page.stem}.json in docs/measurements", err=True)
    return page


def told(context: click.Context) -> Iterator[str]:
    """What a person said on the command line, but for paths, which are that person's own."""
    for parameter in sorted(
        context.command.params, key=lambda each: isinstance(each, click.Option)
    ):
        name = parameter.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if not given or name in HIDDEN or isinstance(parameter.type, click.Path):
            continue
        value = context.params[name]
        for each in value if isinstance(value, tuple) else (value,):
            yield from words(parameter, each)


def words(parameter: click.Parameter, value: Any) -> Iterable[str]:
    """A parameter as it is said; a file by its name alone."""
    text = Path(str(value)).name
    if isinstance(parameter, click.Argument):
        return (text,)
    if isinstance(value, bool):
        return ((*parameter.opts, *parameter.secondary_opts)[0 if value else -1],)
    return (parameter.opts[0], text)


class Suite(click.Group):
    """Parts by name, with - or _ in it; all of them in turn where none is named."""

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """The part of this name."""
        return super().get_command(context, name.replace("_", "-"))

    def list_commands(self, context: click.Context) -> list[str]:
        """The parts in the order in which they are run."""
        return list(self.commands)


def suite(about: str, *parts: click.Command) -> Suite:
    """The command of a suite."""

    @click.group(cls=Suite, invoke_without_command=True, help=about)
    @click.option("--list", "listing", is_flag=True, help="Name the parts, and run none.")
    @click.option(
        "--json", "as_json", is_flag=True, help="Of all parts: print the figures as JSON."
    )
    @click.option(
        "--write", is_flag=True, help="Of all parts: write the measurements to docs/measurements."
    )
    @click.pass_context
    def main(context: click.Context, listing: bool, as_json: bool, write: bool) -> None:
        if listing:
            width = max(len(each.name or "") for each in parts)
            for each in parts:
                click.echo(f"{each.name:<{width}}  {each.get_short_help_str(100)}")
            context.exit()
        if context.invoked_subcommand is None:
            flags = [*(["--json"] if as_json else []), *(["--write"] if write else [])]
            measured = [ran(each, flags) for each in parts]
            context.exit(int(not all(measured)))

    for each in parts:
        main.add_command(each)
    return main


def ran(each: click.Command, flags: list[str]) -> bool:
    """Run a part with its defaults; whether it could be measured and nothing was wrong."""
    click.echo(f"— {each.name}", err=True)
    try:
        each.main(flags, prog_name=each.name, standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return False
    return True
