"""Lines of the command line, parsed and not run."""

import shlex

import click

from isogi_server.cli.command import cli


def parsed(line: str) -> click.Context:
    """What a line such as ``isogi render a.toml -o a.png  # comment`` gives its command. Raises
    ClickException.
    """
    program, *words = shlex.split(line, comments=True)
    assert program == "isogi"
    command: click.Command | None = cli
    context = click.Context(cli, info_name=program)
    while isinstance(command, click.Group) and words:
        name, command, words = command.resolve_command(context, words)
        context = click.Context(command, context, name)
    assert command is not None
    return command.make_context(context.info_name, words, context.parent)
