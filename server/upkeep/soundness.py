"""``isogi store verify`` and ``repair``: whether a store is sound, and mending it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from isogi_core.cache.audit import Audit, Auditor, leftovers
from isogi_core.cache.repair import Repairer
from server.progress import counting

if TYPE_CHECKING:
    from isogi_core.cache.root import Root

SHOWN = 20
"""Damaged objects that a person is told one by one."""


def verify(root: Root) -> dict[str, Any]:
    """Check every object of a store. Raises StoreError where it cannot be read."""
    with counting("checking", "object") as tell:
        audit = Auditor(root).audit(tell=tell)
    return facts_of(audit, root)


def facts_of(audit: Audit, root: Root) -> dict[str, Any]:
    """What an audit found."""
    inventory = audit.inventory
    return {
        "store": str(root.place),
        "sound": audit.sound,
        "layers": len(inventory.layers),
        "chunks": inventory.chunks,
        "whole": audit.whole,
        "unread": audit.unread,
        "bytes": sum(layer.size for layer in inventory.layers.values()),
        "damaged": [damage._asdict() for damage in audit.damages],
        "leftovers": [found.key for found in leftovers(inventory, root.now())],
        "being_written": len(inventory.leftovers) - len(leftovers(inventory, root.now())),
        "foreign": [found.key for found in inventory.foreign],
        "quarantined": len(inventory.quarantined),
    }


def verified(facts: Mapping[str, Any]) -> str:
    """What was found, for a person."""
    damaged = facts["damaged"]
    lines = [f"{each['key']}: {each['why']}" for each in damaged[:SHOWN]] + more(damaged)
    if facts["unread"]:
        lines.append(f"{facts['unread']:,} chunks could not be checked, for the metadata of their layer is damaged")
    lines += [f"{key}: left over" for key in facts["leftovers"][:SHOWN]] + more(facts["leftovers"])
    lines += [f"{key}: not isogi's" for key in facts["foreign"][:SHOWN]] + more(facts["foreign"])
    size = f"{facts['chunks']:,} chunks in {facts['layers']:,} layers, {facts['bytes'] / 1e6:,.1f} MB"
    state = "all whole" if facts["sound"] else f"{len(damaged):,} damaged: `isogi store repair` puts them away"
    return "\n".join([*lines, f"{facts['store']}: {size}, {state}"])


def more(names: Sequence[Any]) -> list[str]:
    """How many were not told."""
    return [f"… and {len(names) - SHOWN:,} more"] if len(names) > SHOWN else []


def repair(root: Root, delete: bool) -> dict[str, Any]:
    """Put away what is damaged in a store, and remove what was left over. Raises StoreError."""
    with counting("checking", "object") as tell:
        repair = Repairer(root, delete).repair(tell)
    moved = [{"key": key, "to": to} for key, to in repair.moved.items()]
    return {
        **facts_of(repair.audit, root),
        "put_away": moved,
        "removed": [found.key for found in repair.removed],
    }


def repaired(facts: Mapping[str, Any]) -> str:
    """What was done, for a person."""
    moved = facts["put_away"]
    lines = [f"{each['key']}: {'deleted' if each['to'] is None else 'now ' + each['to']}" for each in moved[:SHOWN]]
    missing = [each["key"] for each in facts["damaged"] if each["key"] not in {one["key"] for one in moved}]
    lines += [*more(moved), *(f"{key}: made again when its scene is next served" for key in missing[:SHOWN])]
    done = f"{len(moved):,} damaged objects put away, {len(facts['removed']):,} leftovers removed"
    rest = f"{facts['whole']:,} chunks are whole, and what is missing is baked again when it is wanted"
    return "\n".join([*lines, f"{facts['store']}: {done}; {rest}"])
