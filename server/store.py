"""The store that the settings name."""

from isogi_core.cache.copies import Copies
from isogi_core.cache.place import Place
from isogi_core.cache.root import Root
from isogi_core.cache.store import default_store
from isogi_core.errors import StoreError
from server.settings import Settings
from server.studio import whereabouts


def present(settings: Settings) -> Root:
    """The root of a store that is there, as whoever looks after it opens it. Raises StoreError where there is none."""
    place = place_of(settings)
    if place.scheme == "file" and not place.folder.is_dir():
        raise StoreError(f"There is no store at {place}: name the folder or URL that light was baked into.")
    root = Root(place, make=False)
    root.open()
    return root


def root_of(settings: Settings) -> Root:
    """The root of the light that a server of these settings reads and has baked. Raises StoreError."""
    place = place_of(settings)
    keeps = place.remote and settings.store_cache_mb > 0
    return Root(place, copies=Copies(place.url, settings.store_cache_mb << 20) if keeps else None)


def place_of(settings: Settings) -> Place:
    """The place that the settings name."""
    url = settings.store or str(default_store())
    return whereabouts(Place(url, settings.store_seconds, settings.store_retries))
