"""The sentinel: the object at the root of a store by which it is known to be there, and of which format."""

import json

from isogi_core.cache.place import Place
from isogi_core.errors import StoreError

SENTINEL = "isogi.json"

FORMAT = 1
"""The version of what is kept and how."""

CONTENT = json.dumps({"kind": "isogi light", "format": FORMAT}).encode()


def check(sentinel: bytes, place: Place) -> None:
    """Raise StoreError where a store's sentinel is not one that this isogi knows."""
    try:
        version = json.loads(sentinel)["format"]
    except (ValueError, KeyError, TypeError):
        raise StoreError(
            f"{SENTINEL} in the store at {place} is damaged: delete it, and start isogi anew, which makes it again."
        ) from None
    if version != FORMAT:
        raise StoreError(
            f"The store at {place} is of format {version}, and this isogi knows {FORMAT}: name another store, or use"
            " the isogi that made it."
        )
