"""The ``isogi store`` commands. What is heavy is imported by the command that needs it, so that help is quick."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from isogi_core.cache.root import Root

STORE = click.argument("where", metavar="[STORE]", required=False)
JSON = click.option("--json", "as_json", is_flag=True, help="Print the facts as JSON.")


def age(_: click.Context, __: click.Parameter, value: str | None) -> float | None:
    """Callback of an option that is an age: seconds."""
    from server.durations import seconds_of_age  # noqa: PLC0415

    try:
        return None if value is None else seconds_of_age(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def root_at(where: str | None) -> "Root":
    """The root of the store that is named, else of the one that the settings name. Raises StoreError where none is."""
    from server.cli import settings_from  # noqa: PLC0415
    from server.store import present  # noqa: PLC0415

    return present(settings_from(store=where))


def tell(facts: dict[str, Any], text: Callable[[dict[str, Any]], str], as_json: bool) -> None:
    """Print facts, for a script or for a person."""
    click.echo(json.dumps(facts, allow_nan=False) if as_json else text(facts))


@click.group()
def store() -> None:
    """Look after a STORE of light, a folder or URL; by default the one that `isogi serve` uses.

    All of it is safe beside servers and workers that use the store.
    """


@store.command()
@STORE
@JSON
def verify(where: str | None, as_json: bool) -> int:
    """Check every object of a STORE, and change nothing; exit status 1 if any is damaged."""
    from server.upkeep.soundness import verified  # noqa: PLC0415
    from server.upkeep.soundness import verify as check  # noqa: PLC0415

    facts = check(root_at(where))
    tell(facts, verified, as_json)
    return 0 if facts["sound"] else 1


@store.command()
@STORE
@click.option("--delete", is_flag=True, help="Delete what is damaged, instead of moving it to STORE/quarantine.")
@JSON
def repair(where: str | None, delete: bool, as_json: bool) -> None:
    """Put damaged objects of a STORE away, so that they are baked again when they are wanted."""
    from server.upkeep.soundness import repair as mend  # noqa: PLC0415
    from server.upkeep.soundness import repaired  # noqa: PLC0415

    tell(mend(root_at(where), delete), repaired, as_json)


@store.command()
@STORE
@click.option("--quick", is_flag=True, help="Read no chunk: tell no texels.")
@JSON
def stats(where: str | None, quick: bool, as_json: bool) -> None:
    """Tell what a STORE holds: bakes with their size, texels, costs and age."""
    from server.upkeep.holdings import stats as count  # noqa: PLC0415
    from server.upkeep.holdings import table  # noqa: PLC0415

    tell(count(root_at(where), not quick), table, as_json)


@store.command()
@STORE
@click.option("--older-than", callback=age, help="Light that was neither baked nor read for so long: 30d, 12h.")
@click.option("--keep-gb", type=click.FloatRange(0), help="The longest unused light beyond so many gigabytes.")
@click.option("--scene", help="Light of this scene or volume alone; with nothing else told, all of it.")
@click.option("--empty", is_flag=True, help="Layers that hold no light.")
@click.option("--yes", is_flag=True, help="Delete it; without this, only what would go is told.")
@JSON
def prune(
    where: str | None,
    older_than: float | None,
    keep_gb: float | None,
    scene: str | None,
    empty: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Delete light from a STORE that is not needed any more, once --yes says so."""
    if older_than is None and keep_gb is None and scene is None and not empty:
        raise click.UsageError("Say what is to go: --older-than, --keep-gb, --scene or --empty.")
    from server.upkeep.holdings import prune as let_go  # noqa: PLC0415
    from server.upkeep.holdings import pruned, wish_of  # noqa: PLC0415

    wish = wish_of(older_than, keep_gb, scene, empty)
    tell(let_go(root_at(where), wish, yes), pruned, as_json)
