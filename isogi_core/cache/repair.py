"""The repair of a store: what is damaged goes to quarantine, or for good, so that it is baked again when it is wanted.

Safe beside servers and workers: to them an object that goes is absent, and they write whole ones in its place.
"""

from dataclasses import dataclass, field
from hashlib import sha256

from isogi_core.cache.audit import Audit, Auditor, Damage, Tell, leftovers
from isogi_core.cache.inventory import QUARANTINE
from isogi_core.cache.root import Root
from isogi_core.cache.shelf import Entry


@dataclass(eq=False)
class Repair:
    """What was found and done: ``moved`` says where a damaged object went, by its key; None where it was deleted."""

    audit: Audit
    moved: dict[str, str | None] = field(default_factory=dict)
    removed: list[Entry] = field(default_factory=list)


class Repairer:
    """Mends a store as it is audited. ``delete`` keeps no copy of what is damaged."""

    def __init__(self, root: Root, delete: bool = False) -> None:
        """Do nothing yet."""
        self.root = root
        self.delete = delete
        self._moved: dict[str, str | None] = {}

    def repair(self, tell: Tell = lambda _, __: None) -> Repair:
        """Audit the store, put what is damaged out of the way, and remove leftovers. Raises StoreError."""
        audit = Auditor(self.root).audit(self._put_away, tell)
        for damage in audit.damages:
            self._put_away(damage)
        old = list(leftovers(audit.inventory, self.root.now()))
        for found in old:
            self.root.delete(found.key)
        return Repair(audit, self._moved, old)

    def _put_away(self, damage: Damage) -> None:
        """Put a damaged object away, once; one that is missing cannot be."""
        content = None if damage.key in self._moved else self.root.read(damage.key)
        if content is None:
            return
        if self.delete:
            self._moved[damage.key] = None
            self.root.delete(damage.key)
            return
        to = self._moved[damage.key] = f"{QUARANTINE}/{damage.key}.{sha256(content).hexdigest()[:8]}"
        self.root.move(damage.key, to)
