"""The inventory of a store: what each of its objects is, by its key alone."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from isogi_core.bake.recipe import Index
from isogi_core.cache.shelf import Entry

QUARANTINE = "quarantine"
"""Where objects are moved that were found damaged."""

USED = "used"
"""Where stamps of use are: see ``cache.use``."""

COSTS = "costs"
"""Where costs are: see ``cache.costs``."""

CLAIMS = "claims"
"""Where claims are: see ``cache.claims``."""

CHUNK = re.compile(r"([0-9a-f]{20})/c/(\d+)/(\d+)/(\d+)/0")
METADATA = re.compile(r"([0-9a-f]{20})/zarr\.json")
COST = re.compile(rf"{COSTS}/([0-9a-f]{{20}})/zarr\.json")
STAMP = re.compile(rf"{USED}/([0-9a-f]{{20}})")
LEFTOVER = re.compile(rf".*\.partial|{CLAIMS}/.*")
KNOWN = re.compile(r"isogi\.json|(jobs|costs|used|volumes|files)/.*")
"""Other objects that isogi keeps beside the light."""


@dataclass(eq=False)
class LayerFiles:
    """The objects of one layer: its metadata, None where that is missing, its chunks, and the stamp of its use."""

    digest: str
    metadata: Entry | None = None
    chunks: dict[Index, Entry] = field(default_factory=dict)
    stamp: Entry | None = None

    @property
    def objects(self) -> list[Entry]:
        """All of them, the metadata last: a layer that is deleted in this order can be read to its end."""
        return [*self.chunks.values(), *filter(None, (self.stamp, self.metadata))]

    @property
    def size(self) -> int:
        """Bytes of all of them."""
        return sum(found.size for found in self.objects)

    @property
    def used(self) -> float:
        """When it was last written or read, in the store's calendar."""
        return max(found.written for found in self.objects)


@dataclass(eq=False)
class Inventory:
    """What a store holds: ``layers`` by their digests, and objects that are none of theirs.

    ``leftovers`` are what a process that was killed, or is at work, did not come to the end of; ``foreign`` is what
    isogi does not write; ``quarantined`` are objects that were found damaged earlier, and ``costs`` by their looks.
    """

    layers: dict[str, LayerFiles] = field(default_factory=dict)
    costs: dict[str, Entry] = field(default_factory=dict)
    leftovers: list[Entry] = field(default_factory=list)
    foreign: list[Entry] = field(default_factory=list)
    quarantined: list[Entry] = field(default_factory=list)

    @property
    def chunks(self) -> int:
        """Objects that hold light."""
        return sum(len(layer.chunks) for layer in self.layers.values())

    def layer(self, digest: str) -> LayerFiles:
        """The objects of a layer, none as yet where it is new."""
        return self.layers.setdefault(digest, LayerFiles(digest))

    def add(self, found: Entry) -> None:
        """Take in one more object."""
        if found.key.startswith(f"{QUARANTINE}/"):
            self.quarantined.append(found)
        elif LEFTOVER.fullmatch(found.key):
            self.leftovers.append(found)
        elif match := CHUNK.fullmatch(found.key):
            z, y, x = map(int, match.groups()[1:])
            self.layer(match[1]).chunks[z, y, x] = found
        elif match := METADATA.fullmatch(found.key):
            self.layer(match[1]).metadata = found
        elif match := COST.fullmatch(found.key):
            self.costs[match[1]] = found
        elif not KNOWN.fullmatch(found.key):
            self.foreign.append(found)


def inventory_of(listed: Iterable[Entry]) -> Inventory:
    """The inventory of what was ``listed`` of a store."""
    inventory, stamps = Inventory(), {}
    for found in listed:
        inventory.add(found)
        if match := STAMP.fullmatch(found.key):
            stamps[match[1]] = found
    for digest, layer in inventory.layers.items():
        layer.stamp = stamps.get(digest)
    return inventory
