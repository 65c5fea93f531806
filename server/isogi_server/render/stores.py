"""The store of the settings, and a probe that checks if it answers."""

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
from isogi_server.settings import Settings

FINDING_SECONDS = 5.0
"""Seconds for which a result is reused: load balancers and monitors probe often."""

PROBE_SECONDS = 0.5
"""Seconds for which a probe waits for the store: it answers even if the store hangs."""


class StoreProbe:
    """Probes if a store can be read and written, in a separate thread. Safe to use from many
    threads.
    """

    def __init__(self, store: StoreLike, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare to probe ``store``; nothing is read before ``reasons`` is called."""
        self._root = Store.of(store)
        self._clock = clock
        self._lock = threading.Lock()
        self._found = self._silent()
        self._until = -1.0
        self._late = -1.0
        self._looking: threading.Thread | None = None

    def reasons(self) -> list[str]:
        """Return the reasons why light cannot be read or kept: an empty list if it can, or if the
        store is meant only to be read.

        The store is probed at most every ``FINDING_SECONDS``. A store that hangs holds up no
        caller for longer than ``PROBE_SECONDS``. While a probe has taken less than
        ``FINDING_SECONDS``, the former result is returned, and after that the reason that the store
        does not answer. The same reason is given until the first probe has ended.
        """
        with self._lock:
            if self._looking is None and self._clock() >= self._until:
                self._late = self._clock() + FINDING_SECONDS
                self._looking = threading.Thread(target=self._look_up, name="probe", daemon=True)
                self._looking.start()
            looking = self._looking
        # Wait outside the lock, so that all callers wait for the same probe.
        if looking is not None:
            looking.join(PROBE_SECONDS)
        with self._lock:
            late = self._looking is not None and self._clock() >= self._late
            return self._silent() if late else self._found

    def _silent(self) -> list[str]:
        """Return the reason for a store that does not answer."""
        return [f"The store at {self._root.url} does not answer."]

    def _look_up(self) -> None:
        """Probe the store, and keep the result."""
        found = self._look()
        with self._lock:
            self._until = self._clock() + FINDING_SECONDS
            self._found = found
            self._looking = None

    def _look(self) -> list[str]:
        """Return the reasons that a probe of the store finds."""
        try:
            self._root.check_writable()
        except StoreReadOnlyError:
            return []
        except StoreError as error:
            return [str(error)]
        return []


def existing_store(settings: Settings) -> Store:
    """Open the store of the settings for its upkeep, without local copies. Never make one: raise
    StoreError if there is none.
    """
    place = place_of(settings)
    # If there is no such folder, its name is probably wrong. ``open`` would take the store for one
    # that has vanished, and advise to bring it back.
    if place.scheme == "file" and not place.folder.is_dir():
        raise StoreError(
            f"There is no store at {place}: name the folder or URL that light was baked into."
        )
    store = Store(place, make=False)
    store.open()
    return store


def root_of(settings: Settings) -> Store:
    """Return the store in which a server of these settings reads light and has it baked. Raises
    StoreError.

    A remote store keeps copies of its objects on the local disk, if the settings allow.
    """
    place = place_of(settings)
    keeps = place.remote and settings.store_cache_mb > 0
    return Store(place, copies=Copies(place.url, settings.store_cache_mb << 20) if keeps else None)


def place_of(settings: Settings) -> StoreUrl:
    """Return the URL of the store that the settings name, or that of the default store, with
    limits of time and retries.
    """
    url = settings.store or str(default_store())
    return whereabouts(StoreUrl(url, settings.store_seconds, settings.store_retries))


def whereabouts(place: StoreUrl) -> StoreUrl:
    """Make the path of a folder absolute, as workers may run in another directory; return a URL
    as it is.
    """
    if "://" in place.url:
        return place
    return replace(place, url=str(Path(place.url).resolve()))
