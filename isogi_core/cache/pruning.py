"""Pruning: which layers of a store are let go, and letting them go.

Safe beside servers and workers: what they want of it is baked again, and a layer that is being written to is left.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from isogi_core.cache.census import Census, Count
from isogi_core.cache.inventory import LayerFiles
from isogi_core.cache.root import Root
from isogi_core.cache.shelf import Entry
from isogi_core.errors import StoreError
from isogi_core.model.scene import digest_of

BUSY = 60.0
"""Seconds since its last write for which a layer counts as being written to."""


@dataclass(frozen=True)
class Wish:
    """What is to go: layers not used for ``older_than`` seconds; of the rest the longest unused beyond ``keep`` bytes.

    Of the scene or volume of that name alone, where one is told; and layers without any light, if they are ``empty``.
    """

    older_than: float = math.inf
    keep: float = math.inf
    scene: str | None = None
    empty: bool = False


@dataclass(frozen=True, eq=False)
class Plan:
    """The layers that go, the longest unused first, and those that would, were they not being written to."""

    going: tuple[Count, ...]
    busy: tuple[Count, ...]

    @property
    def size(self) -> int:
        """Bytes that become free."""
        return sum(count.files.size for count in self.going)


def plan_of(census: Census, wish: Wish, now: float) -> Plan:
    """What goes by a ``wish``. Raises StoreError where that asks for ages that the store does not tell."""
    counts = sorted(census.counts.values(), key=lambda count: count.files.used)
    if any(math.isnan(count.files.used) for count in counts):
        raise StoreError("This store does not tell when its objects were written: name the scene whose light goes.")
    wanted = chosen([count for count in counts if named(count, wish.scene)], wish, now)
    busy = [count for count in wanted if now - newest(count.files) <= BUSY]
    return Plan(tuple(count for count in wanted if count not in busy), tuple(busy))


def chosen(counts: Sequence[Count], wish: Wish, now: float) -> list[Count]:
    """Those of the layers, the longest unused first, that a wish lets go."""
    total, going = sum(count.files.size for count in counts), []
    everything = wish.scene is not None and wish == Wish(scene=wish.scene)
    for count in counts:
        old, empty = now - count.files.used > wish.older_than, wish.empty and not count.files.chunks
        if everything or old or empty or total > wish.keep:
            going.append(count)
            total -= count.files.size
    return going


def named(count: Count, name: str | None) -> bool:
    """Whether a layer is of the scene, or of the volume, of that name; None stands for any."""
    return name is None or name in (count.facts.attributes.get("scene"), count.facts.attributes.get("volume"))


def newest(files: LayerFiles) -> float:
    """When a layer was last written to; a stamp of its use is no light."""
    return max((found.written for found in files.objects if found is not files.stamp), default=-math.inf)


def prune(root: Root, census: Census, plan: Plan) -> list[Entry]:
    """Delete what a plan lets go, and costs that no layer is left of; what was deleted. Raises StoreError."""
    gone = [found for count in plan.going for found in count.files.objects] + stale_costs(census, plan)
    for found in gone:
        root.delete(found.key)
    return gone


def stale_costs(census: Census, plan: Plan) -> list[Entry]:
    """The costs of bakes that lose a layer."""
    going = {count.files.digest for count in plan.going}
    names = [digest_of(list(layers)) for layers in census.costs if going.intersection(layers)]
    return [census.inventory.costs[name] for name in names]
