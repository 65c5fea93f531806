"""``isogi store``: statistics of a store, checks of its objects, repair and pruning."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from isogi_core.cache.upkeep import (
    Audit,
    Census,
    Count,
    PrunePlan,
    PruneRule,
    audit_store,
    census_of,
    delete_layers,
    leftovers,
    plan_prune,
    repair_store,
)
from isogi_core.storage.store import Store
from isogi_server.progress import Progress
from isogi_server.render.stores import existing_store
from isogi_server.values import span

__all__ = [
    "existing_store",
    "prune",
    "pruned",
    "repair",
    "repaired",
    "rule_of",
    "stats",
    "table",
    "verified",
    "verify",
]


def stats(root: Store, texels: bool) -> dict[str, Any]:
    """Return the content of a store, layer by layer; with counts of ``texels`` if that is set.
    Raises StoreError.
    """
    with Progress("counting", "chunk") as bar:
        census = census_of(root, texels, bar.count)
    layers = [layer_facts(count, root.now()) for count in census.counts.values()]
    # A quick count has not read chunks: it knows neither texels nor paths.
    if not texels:
        layers = [
            {key: value for key, value in layer.items() if key not in ("texels", "paths")}
            for layer in layers
        ]
    return {
        "store": str(root.url),
        "bytes": sum(count.files.size for count in census.counts.values()),
        "layers": sorted(
            layers, key=lambda layer: (layer["volume"], layer["scene"] or "", layer["kind"])
        ),
        "bakes": [bake_facts(layers, census) for layers in census.costs],
        "quarantined_bytes": sum(found.size for found in census.inventory.quarantined),
        "unreadable_layers": len(census.inventory.layers) - len(census.counts),
    }


def layer_facts(count: Count, now: float) -> dict[str, Any]:
    """Return the facts about one layer."""
    own = count.facts.attributes
    layer = count.facts.layer
    files = count.files
    written = max((found.written for found in files.chunks.values()), default=math.nan)
    return {
        "digest": files.digest,
        **{name: own.get(name) for name in ("scene", "volume", "kind", "bounces")},
        "plan": (own.get("plan") or {}).get("representation"),
        "order": layer.order,
        "channels": layer.channels,
        "precision": layer.precision,
        "lattice": list(count.facts.texels),
        "chunks": len(files.chunks),
        "damaged": count.damaged,
        "bytes": files.size,
        "texels": {"lit": count.lit, "void": count.void, "by_samples": by_samples(count)},
        "paths": count.paths,
        "baked_ago": seconds_or_none(now - written),
        "used_ago": seconds_or_none(now - files.used),
    }


def by_samples(count: Count) -> dict[str, int]:
    """Return the number of lit texels for each number of samples."""
    return {
        str(samples): texels for samples, texels in sorted(count.samples.items()) if samples > 0
    }


def seconds_or_none(seconds: float) -> float | None:
    """Return seconds as JSON allows them; None if they are unknown."""
    if math.isnan(seconds):
        return None
    return max(seconds, 0.0)


def bake_facts(layers: tuple[str, ...], census: Census) -> dict[str, Any]:
    """Return the cost of one bake."""
    cost = census.costs[layers]
    return {
        "layers": list(layers),
        "seconds": cost.seconds,
        "paths": cost.paths,
        "texels": cost.texels,
    }


def table(facts: Mapping[str, Any]) -> str:
    """Return the content of a store as text: each volume, and below it its layers."""
    lines = []
    volume = None
    # Layers are sorted by volume: write its name once.
    for layer in facts["layers"]:
        if layer["volume"] != volume:
            volume = layer["volume"]
            lines.append(f"{volume}, {' × '.join(map(str, reversed(layer['lattice'])))} texels")
        lines.append(f"  {layer_line(layer, facts)}")
    if facts["unreadable_layers"]:
        lines.append(
            f"{facts['unreadable_layers']:,} layers cannot be read: see `isogi store verify`"
        )
    if facts["quarantined_bytes"]:
        lines.append(f"{facts['quarantined_bytes'] / 1e6:,.1f} MB in quarantine")
    return "\n".join(
        [
            *lines,
            f"{facts['store']}: {len(facts['layers']):,} layers, {facts['bytes'] / 1e6:,.1f} MB",
        ]
    )


def layer_line(layer: Mapping[str, Any], facts: Mapping[str, Any]) -> str:
    """Return the text about one layer."""
    what = f"{layer['digest'][:8]} {layer['kind']}, order {layer['order']}, {layer['precision']}"
    parts = [what, f"{layer['chunks']:,} chunks", f"{layer['bytes'] / 1e6:,.1f} MB"]
    if "texels" in layer:
        parts.append(f"{layer['texels']['lit']:,} texels lit, {layer['texels']['void']:,} void")
    if layer["damaged"]:
        parts += [f"{layer['damaged']:,} damaged"]
    seconds = [bake["seconds"] for bake in facts["bakes"] if bake["layers"][0] == layer["digest"]]
    if seconds:
        parts += [f"{span(sum(seconds))} of processors with what it was baked with"]
    if layer["used_ago"] is not None:
        parts += [f"used {span(layer['used_ago'], 2)} ago"]
    return ", ".join(parts)


def rule_of(
    older_than: float | None, keep_gb: float | None, scene: str | None, empty: bool
) -> PruneRule:
    """Return the rule of pruning that the options state."""
    if older_than is None:
        age = math.inf
    else:
        age = older_than
    return PruneRule(age, math.inf if keep_gb is None else 1e9 * keep_gb, scene, empty)


def prune(root: Store, rule: PruneRule, delete: bool) -> dict[str, Any]:
    """List the layers that a ``rule`` removes, and ``delete`` them if that is set. Raises
    StoreError.
    """
    census = census_of(root, texels=False)
    plan = plan_prune(census, rule, root.now())
    if delete:
        delete_layers(root, census, plan)
    return {"store": str(root.url), "deleted": delete, **plan_facts(plan, root.now())}


def plan_facts(plan: PrunePlan, now: float) -> dict[str, Any]:
    """Return the layers that are removed, and those that are kept only because they are being
    written.
    """
    names = ("digest", "scene", "volume", "kind", "chunks", "bytes", "used_ago")
    going, busy = (
        [layer_facts(count, now) for count in counts] for counts in (plan.going, plan.busy)
    )
    return {
        "bytes": plan.size,
        "layers": [{name: layer[name] for name in names} for layer in going],
        "busy": [{name: layer[name] for name in names} for layer in busy],
    }


def pruned(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``prune`` as text for a person."""
    if facts["deleted"]:
        verb = "deleted"
    else:
        verb = "would be deleted"
    lines = [f"{prune_line(layer)}: {verb}" for layer in facts["layers"]]
    lines += [f"{prune_line(layer)}: left, for it is being written to" for layer in facts["busy"]]
    size = f"{len(facts['layers']):,} layers, {facts['bytes'] / 1e6:,.1f} MB"
    return "\n".join(
        [
            *lines,
            f"{facts['store']}: {size} {verb}{'' if facts['deleted'] else '; add --yes to do it'}",
        ]
    )


def prune_line(layer: Mapping[str, Any]) -> str:
    """Return the text about a layer that is removed."""
    what = f"{layer['digest'][:8]} {layer['kind']} light of {layer['volume']}"
    return f"{what}, {layer['bytes'] / 1e6:,.1f} MB, used {span(layer['used_ago'] or 0.0, 2)} ago"


MAX_LISTED_OBJECTS = 20
"""Objects that are listed one by one; further ones are counted."""


def verify(root: Store) -> dict[str, Any]:
    """Check every object of a store. Raises StoreError if it cannot be read."""
    with Progress("checking", "object") as bar:
        audit = audit_store(root, progress=bar.count)
    return facts_of(audit, root)


def facts_of(audit: Audit, root: Store) -> dict[str, Any]:
    """Return the facts of an audit."""
    inventory = audit.inventory
    return {
        "store": str(root.url),
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
    """Return the facts of ``verify`` as text for a person."""
    damaged = facts["damaged"]
    lines = [f"{each['key']}: {each['why']}" for each in damaged[:MAX_LISTED_OBJECTS]] + more(
        damaged
    )
    if facts["unread"]:
        lines.append(
            f"{facts['unread']:,} chunks could not be checked, for the metadata of their layer "
            "is damaged"
        )
    lines += [f"{key}: left over" for key in facts["leftovers"][:MAX_LISTED_OBJECTS]] + more(
        facts["leftovers"]
    )
    lines += [f"{key}: not isogi's" for key in facts["foreign"][:MAX_LISTED_OBJECTS]] + more(
        facts["foreign"]
    )
    size = (
        f"{facts['chunks']:,} chunks in {facts['layers']:,} layers, {facts['bytes'] / 1e6:,.1f} MB"
    )
    if facts["sound"]:
        state = "all whole"
    else:
        state = f"{len(damaged):,} damaged: `isogi store repair` puts them away"
    return "\n".join([*lines, f"{facts['store']}: {size}, {state}"])


def more(names: Sequence[Any]) -> list[str]:
    """Return a line with the number of names that were not listed, if any."""
    if len(names) > MAX_LISTED_OBJECTS:
        return [f"… and {len(names) - MAX_LISTED_OBJECTS:,} more"]
    return []


def repair(root: Store, delete: bool) -> dict[str, Any]:
    """Move damaged objects of a store to quarantine, or ``delete`` them, and remove leftovers.
    Raises StoreError.
    """
    with Progress("checking", "object") as bar:
        repair = repair_store(root, delete, bar.count)
    moved = [{"key": key, "to": to} for key, to in repair.moved.items()]
    return {
        **facts_of(repair.audit, root),
        "put_away": moved,
        "removed": [found.key for found in repair.removed],
    }


def repaired(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``repair`` as text for a person."""
    moved = facts["put_away"]
    lines = [
        f"{each['key']}: {'deleted' if each['to'] is None else 'now ' + each['to']}"
        for each in moved[:MAX_LISTED_OBJECTS]
    ]
    missing = [
        each["key"] for each in facts["damaged"] if each["key"] not in {one["key"] for one in moved}
    ]
    lines += [
        *more(moved),
        *(
            f"{key}: made again when its scene is next served"
            for key in missing[:MAX_LISTED_OBJECTS]
        ),
    ]
    done = f"{len(moved):,} damaged objects put away, {len(facts['removed']):,} leftovers removed"
    rest = (
        f"{facts['whole']:,} chunks are whole, and what is missing is baked again when it is wanted"
    )
    return "\n".join([*lines, f"{facts['store']}: {done}; {rest}"])
