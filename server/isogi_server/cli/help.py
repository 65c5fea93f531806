"""Help of commands: options in groups by subject, and examples."""

from importlib import import_module
from pathlib import Path

import click

from isogi_core.errors import advice
from isogi_server.cli.arguments import FIRST_HEADING, VIEW_GROUPS

EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    "": (
        ("isogi engine.nhdr", "serve a volume: open the address in a browser"),
        ("isogi inspect engine.nhdr", "a summary of it"),
        ("isogi render engine.nhdr -o engine.png", "a picture of it"),
    ),
    "serve": (
        ("isogi serve", "a built-in demo"),
        ("isogi serve engine.nhdr", "a volume; isogi engine.nhdr does the same"),
        ("isogi serve engine.toml --port 8080", "a scene, at another port"),
        ("isogi serve 'bold.nii.gz#time=3'", "one step of a series in time"),
    ),
    "render": (
        ("isogi render engine.nhdr -o engine.png", "512 × 512 pixels"),
        (
            "isogi render engine.toml -o a.webp --azimuth 40 --target-error 0.05",
            "until the error is 5 %",
        ),
        (
            "isogi render engine.toml -o a.npy --isovalue 70 --time 30s",
            "radiance, after 30 seconds",
        ),
    ),
    "reference": (
        (
            "isogi reference engine.toml -o truth.npz --azimuth 40 --time 10m",
            "continues the file",
        ),
    ),
    "report": (
        ("isogi report engine.toml -o report --deadline 10m", "open report/index.html then"),
    ),
    "prewarm": (
        ("isogi prewarm engine.toml --isovalue 60:120:5 --views 12 --dry-run", "how long it takes"),
        (
            "isogi prewarm engine.toml --isovalue 60:120:5 --views 12",
            "13 isovalues, 12 views of each",
        ),
        ("isogi prewarm engine.toml --continue", "resumes the stopped one"),
    ),
    "inspect": (
        ("isogi inspect engine.nhdr", "the facts that matter"),
        ("isogi inspect engine.toml --plan", "all facts, and the plan of the light"),
        ("isogi inspect engine.nhdr --picture stiffness.png", "how steep its surfaces are"),
    ),
    "convert": (
        ("isogi convert scan.tif -o scan.ome.zarr", "in chunks, with coarser levels"),
        ("isogi convert x.raw --raw 256x256x128,uint8,little -o x.ome.zarr", "bare voxels"),
    ),
    "export": (
        ("isogi export engine.toml -o engine.glb --isovalue 70", "a mesh, for Blender and the web"),
        ("isogi export engine.toml -o engine.vti --isovalue 60:120", "a volume, for ParaView"),
    ),
    "film": (
        ("isogi film engine.toml -o engine.mp4", "a whole turn, ten seconds"),
        ("isogi film engine.toml -o sweep.gif --isovalue 60:160 --length 6", "the isovalue moves"),
    ),
    "publish": (
        ("isogi publish engine.toml -o engine", "a slider of the azimuth"),
        ("isogi publish engine.toml -o engine --isovalue 60:160:20", "a slider of the isovalue"),
    ),
    "bench": (("isogi bench engine.nhdr --size 256", "half a minute"),),
    "store": (("isogi store stats", "the user's store"),),
    "store verify": (("isogi store verify", "the user's store"),),
    "store repair": (("isogi store repair s3://bucket/light --delete", "a store elsewhere"),),
    "store stats": (("isogi store stats /light --quick", "without reading its chunks"),),
    "store prune": (
        ("isogi store prune --older-than 30d", "lists what would be deleted"),
        ("isogi store prune --keep-gb 20 --yes", "deletes it"),
    ),
}
"""Examples of each command, by its words after ``isogi``: lines to type, with explanations."""


HELP_GROUPS = {
    **{title: names for title, names in VIEW_GROUPS.items() if title != FIRST_HEADING},
    "Store and memory": (
        *("store", "store_seconds", "store_retries", "store_cache_mb", "projected_mb", "memory_mb"),
        *("volume_mb", "volume_cache", "volume_cache_mb"),
    ),
    "Workers and threads": (
        *(
            "workers",
            "scheduler",
            "scheduler_ca",
            "scheduler_cert",
            "scheduler_key",
            "insecure_scheduler",
        ),
        *("render_threads", "jobs"),
    ),
    "Access and limits": (
        *(
            "token_file",
            "tokens_file",
            "allowed_hosts",
            "allowed_origins",
            "max_pixels",
            "max_paths",
        ),
        *("trusted_proxies", "exports_mb", "hand_out_voxels"),
    ),
    "Uploads": ("uploads_mb", "uploads", "max_upload_mb", "upload_seconds", "reading_seconds"),
    "Connections": (
        *(
            "max_connections",
            "max_client_connections",
        ),
        "shutdown_seconds",
    ),
    "Streams": ("streams",),
    "Log": ("log_format", "log_level"),
}
"""The options of each group, by name; options without a group come first, under Options."""

MAX_EXAMPLE_COLUMNS = 46
"""Columns of the longest example that has its explanation on the same line."""


class WithExamples(click.Command):
    """A command whose help ends with examples."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples of the command."""
        rows = EXAMPLES.get(ctx.command_path.partition(" ")[2], ())
        if rows:
            with formatter.section("Examples"):
                formatter.write_dl(rows, col_max=MAX_EXAMPLE_COLUMNS)


class GroupedCommand(WithExamples):
    """A command whose help lists its options in groups."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, group by group."""
        rows: dict[str, list[tuple[str, str]]] = {
            FIRST_HEADING: [],
            **{title: [] for title in HELP_GROUPS},
        }
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record is not None and isinstance(param, click.Option):
                rows[group_of(param.name or "")].append(record)
        for title, records in rows.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def group_of(name: str) -> str:
    """Return the heading of the group that an option belongs to."""
    return next((title for title, names in HELP_GROUPS.items() if name in names), FIRST_HEADING)


class Group(WithExamples, click.Group):
    """A group of commands with this kind of help."""

    command_class = GroupedCommand


class Commands(Group):
    """The commands of ``isogi``. A word that is no command but names a volume or a scene is
    served.
    """

    group_class = Group

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; ``isogi FILE`` is ``isogi serve FILE``. Raises UsageError if there
        is none.
        """
        word = args[0]
        if word in self.commands or word.startswith("-"):
            return super().resolve_command(ctx, args)
        if names_target(word):
            return super().resolve_command(ctx, ["serve", *args])
        raise click.UsageError(f"There is no command '{word}': {advice(word, self.commands)}", ctx)


def names_target(word: str) -> bool:
    """Return True if a word names a file, a folder, a demo or a URL rather than a command."""
    path = Path(word.partition("#")[0])
    return word.startswith("demo:") or "://" in word or bool(path.suffix) or path.exists()


class SettingsCommand(GroupedCommand):
    """A command that takes all settings. Its options are made when they are needed, as the
    settings import pydantic, which is slow.
    """

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the command's parameters and the options of all settings."""
        *own, help_option = super().get_params(ctx)
        return [
            *own,
            *import_module("isogi_server.cli.setting_options").setting_options(),
            help_option,
        ]

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the settings that have no option, then the examples."""
        with formatter.section("Only in the environment or the file"):
            formatter.write_dl(import_module("isogi_server.cli.setting_options").secrets())
        super().format_epilog(ctx, formatter)
