"""``isogi store stats`` and ``prune``: what a store holds, and letting go of what is not needed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from isogi_core.cache.census import Census, Count, census_of
from isogi_core.cache.pruning import Plan, Wish, plan_of
from isogi_core.cache.pruning import prune as let_go
from server.durations import span
from server.progress import counting

if TYPE_CHECKING:
    from isogi_core.cache.root import Root


def stats(root: Root, texels: bool) -> dict[str, Any]:
    """What a store holds, layer by layer. Raises StoreError."""
    with counting("counting", "chunk") as tell:
        census = census_of(root, texels, tell)
    layers = [layer_facts(count, root.now()) for count in census.counts.values()]
    if not texels:
        layers = [{key: value for key, value in layer.items() if key not in ("texels", "paths")} for layer in layers]
    return {
        "store": str(root.place),
        "bytes": sum(count.files.size for count in census.counts.values()),
        "layers": sorted(layers, key=lambda layer: (layer["volume"], layer["scene"] or "", layer["kind"])),
        "bakes": [bake_facts(layers, census) for layers in census.costs],
        "quarantined_bytes": sum(found.size for found in census.inventory.quarantined),
        "unreadable_layers": len(census.inventory.layers) - len(census.counts),
    }


def layer_facts(count: Count, now: float) -> dict[str, Any]:
    """One layer."""
    own, layer, files = count.facts.attributes, count.facts.layer, count.files
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
        "baked_ago": told(now - written),
        "used_ago": told(now - files.used),
    }


def by_samples(count: Count) -> dict[str, int]:
    """Texels with light by the samples that they took."""
    return {str(samples): texels for samples, texels in sorted(count.samples.items()) if samples > 0}


def told(seconds: float) -> float | None:
    """Seconds as JSON may have them; None where they are unknown."""
    return None if math.isnan(seconds) else max(seconds, 0.0)


def bake_facts(layers: tuple[str, ...], census: Census) -> dict[str, Any]:
    """What the bake of a look took."""
    cost = census.costs[layers]
    return {"layers": list(layers), "seconds": cost.seconds, "paths": cost.paths, "texels": cost.texels}


def table(facts: Mapping[str, Any]) -> str:
    """What a store holds, for a person: each volume, and under it its layers."""
    lines, volume = [], None
    for layer in facts["layers"]:
        if layer["volume"] != volume:
            volume = layer["volume"]
            lines.append(f"{volume}, {' × '.join(map(str, reversed(layer['lattice'])))} texels")
        lines.append(f"  {layer_line(layer, facts)}")
    if facts["unreadable_layers"]:
        lines.append(f"{facts['unreadable_layers']:,} layers cannot be read: see `isogi store verify`")
    if facts["quarantined_bytes"]:
        lines.append(f"{facts['quarantined_bytes'] / 1e6:,.1f} MB in quarantine")
    return "\n".join([*lines, f"{facts['store']}: {len(facts['layers']):,} layers, {facts['bytes'] / 1e6:,.1f} MB"])


def layer_line(layer: Mapping[str, Any], facts: Mapping[str, Any]) -> str:
    """One layer, for a person."""
    what = f"{layer['digest'][:8]} {layer['kind']}, order {layer['order']}, {layer['precision']}"
    parts = [what, f"{layer['chunks']:,} chunks", f"{layer['bytes'] / 1e6:,.1f} MB"]
    if "texels" in layer:
        parts.append(f"{layer['texels']['lit']:,} texels lit, {layer['texels']['void']:,} void")
    parts += [f"{layer['damaged']:,} damaged"] if layer["damaged"] else []
    seconds = [bake["seconds"] for bake in facts["bakes"] if bake["layers"][0] == layer["digest"]]
    parts += [f"{span(sum(seconds))} of processors with what it was baked with"] if seconds else []
    parts += [f"used {span(layer['used_ago'], 2)} ago"] if layer["used_ago"] is not None else []
    return ", ".join(parts)


def wish_of(older_than: float | None, keep_gb: float | None, scene: str | None, empty: bool) -> Wish:
    """What is to go, as the options tell it."""
    age = math.inf if older_than is None else older_than
    return Wish(age, math.inf if keep_gb is None else 1e9 * keep_gb, scene, empty)


def prune(root: Root, wish: Wish, delete: bool) -> dict[str, Any]:
    """Tell what goes by a ``wish``, and ``delete`` it if so. Raises StoreError."""
    census = census_of(root, texels=False)
    plan = plan_of(census, wish, root.now())
    if delete:
        let_go(root, census, plan)
    return {"store": str(root.place), "deleted": delete, **plan_facts(plan, root.now())}


def plan_facts(plan: Plan, now: float) -> dict[str, Any]:
    """What goes, and what would if it were not being written to."""
    names = ("digest", "scene", "volume", "kind", "chunks", "bytes", "used_ago")
    going, busy = ([layer_facts(count, now) for count in counts] for counts in (plan.going, plan.busy))
    return {
        "bytes": plan.size,
        "layers": [{name: layer[name] for name in names} for layer in going],
        "busy": [{name: layer[name] for name in names} for layer in busy],
    }


def pruned(facts: Mapping[str, Any]) -> str:
    """What went, or would, for a person."""
    verb = "deleted" if facts["deleted"] else "would be deleted"
    lines = [f"{prune_line(layer)}: {verb}" for layer in facts["layers"]]
    lines += [f"{prune_line(layer)}: left, for it is being written to" for layer in facts["busy"]]
    size = f"{len(facts['layers']):,} layers, {facts['bytes'] / 1e6:,.1f} MB"
    return "\n".join([*lines, f"{facts['store']}: {size} {verb}{'' if facts['deleted'] else '; add --yes to do it'}"])


def prune_line(layer: Mapping[str, Any]) -> str:
    """A layer that goes, for a person."""
    what = f"{layer['digest'][:8]} {layer['kind']} light of {layer['volume']}"
    return f"{what}, {layer['bytes'] / 1e6:,.1f} MB, used {span(layer['used_ago'] or 0.0, 2)} ago"
