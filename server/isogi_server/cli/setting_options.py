"""Options for settings: reading them, and their documentation."""

import os
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from isogi_core.errors import advice
from isogi_server.settings import FORMER_SETTING_NAMES, Settings, read_settings

PREFIX = "ISOGI_"
"""Prefix of environment variables."""

SECRET_SETTINGS = ("token",)
"""Settings without an option, as all users of a machine can see the options of its commands."""

CONFIG = (
    "A TOML file with settings, such as port = 8080; options and the environment come before it."
)


def settings_from(config: Path | None = None, **given: Any) -> Settings:
    """Read the settings: the options ``given``, if they are not None, then the environment, then
    the file ``config``.

    The token is removed from the environment, which workers inherit. Raises UsageError, which names
    the first setting that is wrong, and OSError if the file cannot be read.
    """
    try:
        settings = read_settings(
            config, **{name: value for name, value in given.items() if value is not None}
        )
        os.environ.pop(variable("token"), None)
        return settings
    # A ValidationError is a ValueError as well, so it must come first.
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        # An error without a place breaks a rule about several settings.
        if not first["loc"]:
            raise click.UsageError(f"{first['msg'].removeprefix('Value error, ')}.") from None
        name = str(first["loc"][0])
        if first["type"] == "extra_forbidden":
            raise click.UsageError(
                f"There is no setting '{name}': {advice(name, Settings.model_fields)}"
            ) from None
        # Never print a token.
        if name in SECRET_SETTINGS:
            value = ""
        else:
            value = f", not {first['input']!r}"
        raise click.UsageError(f"{complaint(name, first)}{value}.") from None
    except ValueError as error:
        raise click.UsageError(f"{error}.") from None


OTHER_VARIABLES = ("ISOGI_KERNEL_CACHE", "ISOGI_SHARED_DATA")
"""Environment variables that are not settings of a server."""

SERVICE_LINKS = re.compile(r"ISOGI_(SERVICE_|PORT_\d)\w*")
"""Environment variables that Kubernetes sets if a service is called isogi."""


def unknown_variables() -> list[str]:
    """Return a sentence about each environment variable that looks like a setting but is none,
    as it may be misspelt.
    """
    known = [*map(variable, (*Settings.model_fields, *FORMER_SETTING_NAMES)), *OTHER_VARIABLES]
    unknown = [
        name
        for name in sorted(os.environ)
        if name.startswith(PREFIX) and name not in known and not SERVICE_LINKS.fullmatch(name)
    ]
    return [
        f"{name} is no variable of isogi and is ignored: {hint(name, known)}" for name in unknown
    ]


def hint(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the known variable that resembles it, apart from the
    prefix; else the command that lists all.
    """
    words = {each.removeprefix(PREFIX): each for each in known}
    if close := get_close_matches(name.removeprefix(PREFIX).upper(), words, 1):
        return f"did you mean {words[close[0]]}?"
    return "`isogi serve --help` lists all."


KINDS = {
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "bool_parsing": "true or false",
}
"""Expected kinds of values, by pydantic's types of errors."""

BOUNDS = {
    "greater_than_equal": ("at least", "ge"),
    "greater_than": ("more than", "gt"),
    "less_than_equal": ("at most", "le"),
    "less_than": ("less than", "lt"),
}
"""Words for bounds of numbers, and the key of the bound in the error, by pydantic's types of
errors.
"""


def complaint(name: str, error: Mapping[str, Any]) -> str:
    """Return the requirement that a setting does not meet, by pydantic's ``error``."""
    if (kind := KINDS.get(error["type"])) is not None:
        return f"{name} is {kind}"
    if (bound := BOUNDS.get(error["type"])) is not None:
        words, key = bound
        return f"{name} is {words} {error['ctx'][key]:g}"
    return f"{name}: {error['msg'].removeprefix('Value error, ')}"


def setting_options() -> list[click.Parameter]:
    """Return the options of all settings that may have one, and the option for their file."""
    file = click.Option(
        ["--config"], type=click.Path(path_type=Path, exists=True, dir_okay=False), help=CONFIG
    )
    names = [name for name in Settings.model_fields if name not in SECRET_SETTINGS]
    former = [click.Option([flag(name)], hidden=True) for name in FORMER_SETTING_NAMES]
    own = [
        click.Option(
            [flag(name)],
            is_flag=switched(name),
            default=None,
            help=f"{described(name)} [{variable(name)}]",
        )
        for name in names
    ]
    return [file, *own, *former]


def switched(name: str) -> bool:
    """Return True if a setting is on or off, so that its option takes no value."""
    return Settings.model_fields[name].annotation is bool


def secrets() -> list[tuple[str, str]]:
    """Return environment variable and description of the settings that have no option."""
    return [(variable(name), described(name)) for name in SECRET_SETTINGS]


def described(name: str) -> str:
    """Return the description of a setting, with its default if the description does not name it."""
    field = Settings.model_fields[name]
    text = field.description or ""
    complete = (
        switched(name)
        or field.default_factory is not None
        or field.default in (None, ())
        or "default:" in text
    )
    if complete:
        return text
    return f"{text.removesuffix('.')}; default: {field.default}."


def flag(name: str) -> str:
    """Return the option of a setting."""
    return f"--{name.replace('_', '-')}"


def variable(name: str) -> str:
    """Return the environment variable of a setting."""
    return f"{PREFIX}{name.upper()}"


def rows() -> list[str]:
    """Return one row of a Markdown table for each setting, as in docs/settings.md."""
    options = {
        name: "–" if name in SECRET_SETTINGS else f"`{flag(name)}`"
        for name in Settings.model_fields
    }
    return [
        f"| `{name}` | {option} | `{variable(name)}` | {described(name)} |"
        for name, option in options.items()
    ]
