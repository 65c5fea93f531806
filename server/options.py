"""The options of ``isogi serve``: one for each setting, made from it when they are needed."""

from pathlib import Path

import click

SECRET = ("token",)
"""Settings without an option: what a command is given, all users of the machine can see."""

CONFIG = "A TOML file with settings, such as port = 8080; options and the environment come before it."


class SettingsCommand(click.Command):
    """A command that takes all settings. Its help is made late, for settings load a library that takes its time."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The command's own parameters and the settings' options."""
        *own, help_option = super().get_params(ctx)
        return [*own, *setting_options(), help_option]

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Tell the settings that have no option."""
        with formatter.section("Only in the environment or the file"):
            formatter.write_dl([(variable(name), described(name)) for name in SECRET])


def setting_options() -> list[click.Parameter]:
    """An option for each setting that may have one, and for the file of settings."""
    from server.settings import Settings  # noqa: PLC0415 (it loads pydantic)

    file = click.Option(["--config"], type=click.Path(path_type=Path, exists=True, dir_okay=False), help=CONFIG)
    names = [name for name in Settings.model_fields if name not in SECRET]
    return [file, *(click.Option([flag(name)], help=f"{described(name)} [{variable(name)}]") for name in names)]


def described(name: str) -> str:
    """What a setting is for, with its default where that is not told yet."""
    from server.settings import Settings  # noqa: PLC0415 (it loads pydantic)

    field = Settings.model_fields[name]
    text = field.description or ""
    told = field.default_factory is not None or field.default in (None, ()) or "default:" in text
    return text if told else f"{text.removesuffix('.')}; default: {field.default}."


def flag(name: str) -> str:
    """The option of a setting."""
    return f"--{name.replace('_', '-')}"


def variable(name: str) -> str:
    """The environment variable of a setting."""
    return f"ISOGI_{name.upper()}"


def rows() -> list[str]:
    """One row of a Markdown table for each setting, as docs/settings.md has them."""
    from server.settings import Settings  # noqa: PLC0415 (it loads pydantic)

    ways = {name: "–" if name in SECRET else f"`{flag(name)}`" for name in Settings.model_fields}
    return [f"| `{name}` | {way} | `{variable(name)}` | {described(name)} |" for name, way in ways.items()]
