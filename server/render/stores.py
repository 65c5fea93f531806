"""The store that settings name, and a probe that says whether it answers."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from isogi_core.cache.chunk_store import default_store
from isogi_core.errors import StoreError, StoreReadOnlyError
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.folder import Copies
from isogi_core.storage.store import Store, StoreLike
from server.settings import Settings

FINDING_SECONDS = 5.0
"""Seconds for which a finding stands: probes come often, and from many."""

PROBE_SECONDS = 0.5
"""Seconds that a probe waits for the store: it answers whatever the store does."""


class StoreProbe:
    """Looks for a store's sentinel, and tries whether it could be written. Safe to use from many
    threads.
    """

    def __init__(self, store: StoreLike, clock: Callable[[], float] = time.monotonic) -> None:
        """Probe ``store`` when it is asked for the first time."""
        self._root = Store.of(store)
        self._clock = clock
        self._lock = threading.Lock()
        self._found = self._silent()
        self._until = -1.0
        self._late = -1.0
        self._looking: threading.Thread | None = None

    def reasons(self) -> list[str]:
        """Why light cannot be read or kept; none where it can, or where the store is one that is
        only read.

        Looked up at most every ``FINDING_SECONDS`` seconds, in a separate thread: a store that
        hangs holds nobody. What was found before stands for as long again.
        """
        with self._lock:
            if self._looking is None and self._clock() >= self._until:
                self._late = self._clock() + FINDING_SECONDS
                self._looking = threading.Thread(target=self._look_up, name="probe", daemon=True)
                self._looking.start()
            looking = self._looking
        if looking is not None:
            looking.join(PROBE_SECONDS)
        with self._lock:
            late = self._looking is not None and self._clock() >= self._late
            return self._silent() if late else self._found

    def _silent(self) -> list[str]:
        return [f"The store at {self._root.url} does not answer."]

    def _look_up(self) -> None:
        """Note what is found."""
        found = self._look()
        with self._lock:
            self._until = self._clock() + FINDING_SECONDS
            self._found = found
            self._looking = None

    def _look(self) -> list[str]:
        try:
            self._root.check_writable()
        except StoreReadOnlyError:
            return []
        except StoreError as error:
            return [str(error)]
        return []


def existing_store(settings: Settings) -> Store:
    """The store of the settings, for its upkeep. Raises StoreError where there is none."""
    place = place_of(settings)
    if place.scheme == "file" and not place.folder.is_dir():
        raise StoreError(
            f"There is no store at {place}: name the folder or URL that light was baked into."
        )
    store = Store(place, make=False)
    store.open()
    return store


def root_of(settings: Settings) -> Store:
    """The root of the light that a server of these settings reads and has baked. Raises
    StoreError.
    """
    place = place_of(settings)
    keeps = place.remote and settings.store_cache_mb > 0
    return Store(place, copies=Copies(place.url, settings.store_cache_mb << 20) if keeps else None)


def place_of(settings: Settings) -> StoreUrl:
    """The place that the settings name."""
    url = settings.store or str(default_store())
    return whereabouts(StoreUrl(url, settings.store_seconds, settings.store_retries))


def whereabouts(place: StoreUrl) -> StoreUrl:
    """A place whose folder is an absolute path, a URL as it is: workers may stand elsewhere."""
    if "://" in place.url:
        return place
    return replace(place, url=str(Path(place.url).resolve()))
