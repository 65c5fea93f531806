"""The inventory of a store: the kind of each of its objects, by the key alone."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import Entry

QUARANTINE_FOLDER = "quarantine"
"""Folder that damaged objects are moved to."""

STAMPS_FOLDER = "used"
"""Folder of stamps of use: see ``cache.chunk_store``."""

COSTS_FOLDER = "costs"
"""Folder of costs: see ``cache.costs``."""

CLAIMS_FOLDER = "claims"
"""Folder of claims: see ``cache.claims``."""

CHUNK_KEY = re.compile(r"([0-9a-f]{20})/c/(\d+)/(\d+)/(\d+)/0")
LAYER_KEY = re.compile(r"([0-9a-f]{20})/zarr\.json")
COST_KEY = re.compile(rf"{COSTS_FOLDER}/([0-9a-f]{{20}})/zarr\.json")
STAMP_KEY = re.compile(rf"{STAMPS_FOLDER}/([0-9a-f]{{20}})")
LEFTOVER_KEY = re.compile(rf".*\.partial|{CLAIMS_FOLDER}/.*")
OTHER_KEYS = re.compile(r"isogi\.json|(jobs|costs|used|volumes|files|colours|glow|walls)/.*")
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
        """All objects, the metadata last: a layer that is deleted in this order stays readable to the end."""
        return [*self.chunks.values(), *filter(None, (self.stamp, self.metadata))]

    @property
    def size(self) -> int:
        """Bytes of all objects."""
        return sum(found.size for found in self.objects)

    @property
    def used(self) -> float:
        """Time of the last write or read, by the store's calendar."""
        return max(found.written for found in self.objects)


@dataclass(eq=False)
class Inventory:
    """Objects of a store: ``layers`` by their digests, and others.

    ``costs`` are by the digests of their bakes. ``leftovers`` are half-written, by a process that was killed or is at
    work. ``foreign`` objects are not isogi's. ``quarantined`` ones were found damaged earlier.
    """

    layers: dict[str, LayerFiles] = field(default_factory=dict)
    costs: dict[str, Entry] = field(default_factory=dict)
    leftovers: list[Entry] = field(default_factory=list)
    foreign: list[Entry] = field(default_factory=list)
    quarantined: list[Entry] = field(default_factory=list)

    @property
    def chunks(self) -> int:
        """Number of objects that hold light."""
        return sum(len(layer.chunks) for layer in self.layers.values())

    def layer(self, digest: str) -> LayerFiles:
        """The objects of a layer, none as yet where it is new."""
        return self.layers.setdefault(digest, LayerFiles(digest))

    def add(self, found: Entry) -> None:
        """Add an object."""
        if found.key.startswith(f"{QUARANTINE_FOLDER}/"):
            self.quarantined.append(found)
        elif LEFTOVER_KEY.fullmatch(found.key):
            self.leftovers.append(found)
        elif match := CHUNK_KEY.fullmatch(found.key):
            z, y, x = map(int, match.groups()[1:])
            self.layer(match[1]).chunks[z, y, x] = found
        elif match := LAYER_KEY.fullmatch(found.key):
            self.layer(match[1]).metadata = found
        elif match := COST_KEY.fullmatch(found.key):
            self.costs[match[1]] = found
        elif not OTHER_KEYS.fullmatch(found.key):
            self.foreign.append(found)


def inventory_of(listed: Iterable[Entry]) -> Inventory:
    """The inventory of the ``listed`` objects of a store."""
    inventory, stamps = Inventory(), {}
    for found in listed:
        inventory.add(found)
        if match := STAMP_KEY.fullmatch(found.key):
            stamps[match[1]] = found
    for digest, layer in inventory.layers.items():
        layer.stamp = stamps.get(digest)
    return inventory
