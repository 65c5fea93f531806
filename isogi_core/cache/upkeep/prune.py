"""Pruning: chooses layers of a store by a rule, and deletes them."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from isogi_core.cache.inventory import LayerFiles
from isogi_core.cache.upkeep.census import Census, Count, census_of
from isogi_core.errors import StoreError
from isogi_core.model.value_survey import digest_of
from isogi_core.storage.backend import Entry
from isogi_core.storage.store import Store

BUSY_SECONDS = 60.0
"""Seconds since its last write for which a layer counts as being written to."""


@dataclass(frozen=True)
class PruneRule:
    """Layers to delete: those not used for ``older_than`` seconds, and the longest unused beyond ``keep`` bytes.

    With ``scene`` only layers of the scene or volume of that name go. With ``empty`` layers without light go too.
    """

    older_than: float = math.inf
    keep: float = math.inf
    scene: str | None = None
    empty: bool = False


@dataclass(frozen=True, eq=False)
class PrunePlan:
    """The layers to delete, the longest unused first, and ``busy`` ones, which are being written to and stay."""

    going: tuple[Count, ...]
    busy: tuple[Count, ...]

    @property
    def size(self) -> int:
        """Bytes that are freed."""
        return sum(count.files.size for count in self.going)


def plan_prune(census: Census, rule: PruneRule, now: float) -> PrunePlan:
    """Choose the layers to delete by a ``rule``. Raises StoreError where the store does not know ages."""
    counts = sorted(census.counts.values(), key=lambda count: count.files.used)
    if any(math.isnan(count.files.used) for count in counts):
        raise StoreError("This store does not know when its objects were written: name the scene whose light goes.")
    wanted = chosen([count for count in counts if is_of(count, rule.scene)], rule, now)
    busy = [count for count in wanted if now - newest(count.files) <= BUSY_SECONDS]
    return PrunePlan(tuple(count for count in wanted if count not in busy), tuple(busy))


def chosen(counts: Sequence[Count], rule: PruneRule, now: float) -> list[Count]:
    """The layers, the longest unused first, that a rule deletes."""
    total, going = sum(count.files.size for count in counts), []
    everything = rule.scene is not None and rule == PruneRule(scene=rule.scene)
    for count in counts:
        old, empty = now - count.files.used > rule.older_than, rule.empty and not count.files.chunks
        if everything or old or empty or total > rule.keep:
            going.append(count)
            total -= count.files.size
    return going


def is_of(count: Count, name: str | None) -> bool:
    """Whether a layer is of the scene, or of the volume, of that name; None stands for any."""
    return name is None or name in (count.facts.attributes.get("scene"), count.facts.attributes.get("volume"))


def newest(files: LayerFiles) -> float:
    """Time of the last write to a layer, stamps of use left out."""
    return max((found.written for found in files.objects if found is not files.stamp), default=-math.inf)


def delete_layers(store: Store, census: Census, plan: PrunePlan) -> list[Entry]:
    """Delete the layers of a plan, and costs of their bakes; returns the deleted objects. Raises StoreError."""
    gone = [found for count in plan.going for found in count.files.objects] + stale_costs(census, plan)
    for found in gone:
        store.delete(found.key)
    return gone


def stale_costs(census: Census, plan: PrunePlan) -> list[Entry]:
    """The costs of bakes that lose a layer."""
    going = {count.files.digest for count in plan.going}
    names = [digest_of(list(layers)) for layers in census.costs if going.intersection(layers)]
    return [census.inventory.costs[name] for name in names]


log = logging.getLogger("isogi.cache")


def trim_projected(store: Store, most: int) -> int:
    """Delete layers for single isovalues, the longest unused first, beyond ``most`` bytes at ``store``; how many went.

    These are of projected texels, and of walls.

    What was written in the last minute stays. A store that knows no ages, or takes no writes now, is left as it is.
    """
    try:
        census = census_of(store, texels=False)
        counts = {d: count for d, count in census.counts.items() if count.facts.attributes.get("shown") is not None}
        plan = plan_prune(replace(census, counts=counts), PruneRule(keep=most), store.now())
        delete_layers(store, census, plan)
    except StoreError as error:
        log.info("Projected texels are not trimmed: %s", error)
        return 0
    return len(plan.going)
