"""The root of all light that is kept at one place: objects by their keys, and whether the store is there at all.

A store that has died says "no such object" too, so a sentinel stands at its root: that something is missing is
believed only while the sentinel is seen. Raises StoreAwayError where the store cannot be used at the moment.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from isogi_core.cache.bucket import Bucket
from isogi_core.cache.copies import Copies
from isogi_core.cache.filesystem import FileSystem
from isogi_core.cache.folder import Folder
from isogi_core.cache.place import Place
from isogi_core.cache.sentinel import CONTENT, SENTINEL, check
from isogi_core.cache.shelf import Entry, Found, Shelf
from isogi_core.cache.troubles import told
from isogi_core.errors import ChangedError, StoreAwayError, StoreError, StoreFullError, StoreReadOnlyError

BELIEVED = 1.0
"""Seconds for which a look at the sentinel stands, and after which a store that is away is asked again."""

TRIED = 10.0
"""Seconds after which a store that could only be read is tried again."""

GONE = "its isogi.json is missing; bring the store back, or start isogi anew to begin with an empty one"


class Root:
    """All light at a ``place``. Safe to use from many threads.

    ``make`` is whether a place without a sentinel is taken for a new one and gets it: a worker's is not. Pickled, it is
    no more than its place: the other process connects with its own credentials.
    """

    def __init__(
        self,
        place: str | Path | Place,
        make: bool = True,
        copies: Copies | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open nothing yet."""
        self.place = Place.of(place)
        self.make = make
        self.copies = copies
        self.read_only = False
        self._clock = clock
        self._shelf: Shelf | None = None
        self._seen = False
        self._bare = False
        self._away: StoreAwayError | None = None
        self._until = -1.0
        self._tried = 0.0
        self._lock = threading.RLock()
        self._opening = threading.Lock()

    def __repr__(self) -> str:
        return f"Root({self.place.url!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.place, self.make)

    @classmethod
    def of(cls, place: "Where") -> "Root":
        """The root of a place; a root is its own."""
        return place if isinstance(place, Root) else cls(place)

    def open(self) -> None:
        """See that the store is there, and make a new one its sentinel. Raises StoreError."""
        self.alive()

    def get(self, key: str) -> Found | None:
        """An object as it is now, or None where there is none and the store is there to say so."""
        return self._get(key, None)

    def read(self, key: str) -> bytes | None:
        """The bytes of an object as it is now; None where there is none."""
        found = self.get(key)
        return None if found is None else found.data

    def now(self) -> float:
        """The time of this machine's calendar; the one that objects are dated by is taken to be near."""
        return time.time()

    def view(self, key: str) -> bytes | None:
        """The bytes of an object, from this machine's copies where the store says that these still stand."""
        if self.copies is None:
            found = self._get(key, None)
        else:
            known = self.copies.get(key)
            found = self._get(key, known)
            if found is not None and found is not known:
                self.copies.put(key, found)
        return None if found is None else found.data

    def put(self, key: str, data: bytes, former: Found | None) -> None:
        """Write an object in place of the ``former`` (None where there was none).

        Raises ChangedError where another stands there by now, if the store can tell.
        """
        with self._writing(f"write {key} to"):
            self._opened.put(key, data, former)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._writing(f"delete {key} from"):
            self._opened.delete(key)

    def move(self, key: str, to: str) -> None:
        """Have an object, if it is there, under another key."""
        with self._writing(f"move {key} in"):
            self._opened.move(key, to)

    def entries(self) -> list[Entry]:
        """All objects with their sizes and dates, and what is half written, by their keys."""
        self._hopeful()
        with self._telling("list what is in"):
            return sorted(self._opened.entries())

    def layers(self) -> list[str]:
        """Names of the folders at the root: digests of layers, and ``costs``."""
        return self.names("")

    def names(self, folder: str) -> list[str]:
        """Names of the folders right under ``folder``; none only where the store is there to say so."""
        self._hopeful()
        with self._telling(f"list {folder or 'all'} in"):
            names = self._opened.names(folder)
        if not names:
            self.alive()
        return names

    def keys(self, layer: str) -> Iterator[str]:
        """Keys of all objects of a layer."""
        self._hopeful()
        with self._telling(f"list {layer} in"):
            yield from self._opened.keys(layer)

    def alive(self) -> None:
        """Raise StoreAwayError unless the sentinel is seen; a look stands for BELIEVED seconds.

        While one looks at a store that was away, others are told so at once.
        """
        away = self._away
        if not self._lock.acquire(blocking=away is None):
            raise StoreAwayError(str(away))
        try:
            if self._clock() >= self._until:
                self._away = self._look()
                self._until = self._clock() + BELIEVED
            if self._away is not None:
                raise type(self._away)(str(self._away))
        finally:
            self._lock.release()

    def prove(self) -> None:
        """See that the store is there and takes light; sets ``read_only``. Raises StoreAwayError and its kinds."""
        self._until = -1.0
        self.alive()
        try:
            self._opened.prove(CONTENT)
            self.read_only = False
        except Exception as error:
            trouble = told("write to", self.place, error)
            self.read_only = isinstance(trouble, StoreReadOnlyError)
            raise trouble from None

    def only_read(self) -> bool:
        """Whether the store can only be read; where it could, that is tried again now and then."""
        if self.read_only and self._clock() >= self._tried + TRIED:
            self._tried = self._clock()
            with suppress(StoreError):
                self.prove()
        return self.read_only

    @property
    def _opened(self) -> Shelf:
        """The shelf; made on first use, for that may load a library."""
        with self._opening:
            if self._shelf is None:
                self._shelf = shelf_of(self.place)
            return self._shelf

    def _get(self, key: str, known: Found | None) -> Found | None:
        self._hopeful()
        with self._telling(f"read {key} from"):
            found = self._opened.get(key, known)
        if found is None:
            self.alive()
        return found

    def _hopeful(self) -> None:
        """Ask nothing of a store that was away a moment ago, and not before it was seen for the first time."""
        if self._away is not None or not self._seen:
            self.alive()

    @contextmanager
    def _writing(self, what: str) -> Iterator[None]:
        """Around what writes to the store."""
        self._hopeful()
        if self.read_only:
            raise StoreReadOnlyError(f"The store at {self.place} can only be read: nothing more is baked into it.")
        with self._telling(what, writing=True):
            yield

    def _look(self) -> StoreAwayError | None:
        """Why the sentinel is not seen; None where it is. Makes it in a new store."""
        try:
            found = self._opened.get(SENTINEL)
        except StoreError:
            raise
        except Exception as error:
            return told("reach", self.place, error)
        if found is not None:
            check(found.data, self.place)
            self._seen = True
            return None
        if self._bare:
            return None
        if self._seen or not self.make:
            return StoreAwayError(f"The store at {self.place} is gone: {GONE}.")
        return self._found()

    def _found(self) -> StoreAwayError | None:
        """Make the sentinel. A place without one that can only be read is taken as it is."""
        try:
            self._opened.found(CONTENT)
        except ChangedError:
            pass
        except Exception as error:
            trouble = told("make a place for light at", self.place, error)
            if not isinstance(trouble, StoreReadOnlyError):
                return trouble
            self.read_only = self._bare = True
        self._seen = True
        return None

    @contextmanager
    def _telling(self, what: str, writing: bool = False) -> Iterator[None]:
        """Tell what goes wrong as the store's: away where its sentinel fares no better, else a trouble of this object.

        A write that failed for want of room or of permission is told as that.
        """
        try:
            yield
        except StoreError:
            raise
        except Exception as error:
            trouble = told(what, self.place, error)
            if writing and isinstance(trouble, StoreFullError | StoreReadOnlyError):
                raise trouble from error
            self._until = -1.0
            (self.prove if writing else self.alive)()
            raise StoreError(str(trouble)) from error


Where = str | Path | Place | Root
"""What a root is named by."""


def shelf_of(place: Place) -> Shelf:
    """The shelf of a place, by its scheme."""
    if place.remote:
        return Bucket(place, SENTINEL)
    return Folder(place.folder, SENTINEL) if place.scheme == "file" else FileSystem(place, SENTINEL)
