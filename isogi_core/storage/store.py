"""The store: objects by key at one URL, and checks that the store can be reached and written to.

A store is recognised by its sentinel. If a drive is not mounted or a bucket is gone, the sentinel
is missing, too: absent objects are then reported as an absent store, and not as light to be baked.
"""

import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import zarr
from numcodecs.zstd import Zstd
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from isogi_core.errors import (
    ChangedError,
    DamagedChunkError,
    StoreAwayError,
    StoreError,
    StoreFullError,
    StoreReadOnlyError,
)
from isogi_core.storage.backend import Backend, Entry, StoredObject, StoreUrl, store_error
from isogi_core.storage.calls import Calls, CountedBackend
from isogi_core.storage.folder import Copies, FileSystem, Folder
from isogi_core.storage.object_store import Bucket

SENTINEL_KEY = "isogi.json"
"""Key of the object that marks a folder or bucket as a store of isogi's."""

STORE_FORMAT = 1
"""Version of the store's layout."""

SENTINEL_CONTENT = json.dumps({"kind": "isogi light", "format": STORE_FORMAT}).encode()
"""The sentinel's content."""

CHECKED = 1.0
"""Seconds for which a check of the sentinel stands,
and after which an unreachable store is checked again.

Each chunk that a view lacks asks for the check: this makes it one small read a second, however many
chunks lack light. A store that comes back is noticed by the first request after this second.
"""

CHECK_SECONDS = 0.5
"""Seconds that one caller waits for a check of a remote store that was away."""

REMOTE_READERS = 16
"""Reads at once from a remote store, where the network takes the time."""

LOCAL_READERS = 4
"""Reads at once from a store on this machine, where unpacking takes the time."""

LOG_SECONDS = 600.0
"""Seconds in which the same message of an object is logged once."""

WRITE_RETRY_SECONDS = 10.0
"""Seconds after which a read-only store is tested again for writing."""

SENTINEL_GONE = (
    "its isogi.json is missing; bring the store back, or start isogi again to "
    "begin with an empty one"
)


def check_sentinel(sentinel: bytes, url: StoreUrl) -> None:
    """Raise StoreError if a store's sentinel is damaged or of another format."""
    try:
        version = json.loads(sentinel)["format"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise StoreError(
            f"{SENTINEL_KEY} in the store at {url} is damaged: delete it, and start isogi "
            "again, which makes it."
        ) from None
    if version != STORE_FORMAT:
        raise StoreError(
            f"The store at {url} is of format {version}, and this isogi knows {STORE_FORMAT}:"
            " name another store, or use the isogi that made it."
        )


class Store:
    """All objects at a ``url``. Safe to use from many threads.

    If ``make``, a place without a sentinel is taken for a new store and gets one; workers do not
    make stores. ``copies`` are local copies of remote objects. ``readers``, ``most_readers``
    threads, read for all scenes and their variants together. A pickled store holds only its URL:
    the other process connects with its own credentials.
    """

    def __init__(
        self,
        url: str | Path | StoreUrl,
        make: bool = True,
        copies: Copies | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Set up without a connection. Raises StoreUrlError for a URL that holds a secret."""
        self.url = StoreUrl.of(url)
        self.make = make
        self.copies = copies
        self.read_only = False
        if self.url.remote:
            self.most_readers = REMOTE_READERS
        else:
            self.most_readers = LOCAL_READERS
        self.readers: Executor = ThreadPoolExecutor(self.most_readers, "loader")
        self.calls = Calls()
        self._clock = clock
        # The state of the connection: the backend, once made; the sentinel, once seen; and the
        # error of the last check, which stands until a time.
        self._made: Backend | None = None
        self._seen = False
        self._without_sentinel = False
        self._away: StoreAwayError | None = None
        self._checked_until = -1.0
        # Time at which ``only_read`` last tested for writing.
        self._tried = 0.0
        self._lock = threading.RLock()
        self._opening = threading.Lock()
        self._checker: threading.Thread | None = None
        self._logged: dict[str, float] = {}
        self._last_answer = 0.0

    def __repr__(self) -> str:
        return f"Store({self.url.url!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.url, self.make)

    @classmethod
    def of(cls, store: "StoreLike") -> "Store":
        """Return the store at a URL; a Store is returned as it is."""
        if isinstance(store, Store):
            return store
        return cls(store)

    def open(self) -> None:
        """Check that the store is there, and write the sentinel of a new one. Raises StoreError."""
        self.check_reachable()

    def get(self, key: str) -> StoredObject | None:
        """Read an object from the store; None if there is none. Raises StoreError."""
        return self._get(key, None)

    def read(self, key: str) -> bytes | None:
        """Read the bytes of an object from the store; None if there is none. Raises StoreError."""
        found = self.get(key)
        return None if found is None else found.data

    def now(self) -> float:
        """Return the time of this machine's calendar,
        which is taken to agree with the one that dates objects.
        """
        return time.time()

    def view(self, key: str) -> bytes | None:
        """Read the bytes of an object that ends with a checksum, from a local copy if the store
        confirms that it is unchanged.

        A damaged object is read once more, without the copy. Only sound objects are copied: the
        store would confirm a damaged copy for ever by the tag of the sound object.
        """
        # Send the tag of a sound copy along, so that the store sends an object only if it is
        # another one.
        if self.copies is None:
            known = None
        else:
            known = self.copies.get(key)
        if known is not None and not is_sound(known.data):
            known = None
        found = self._get(key, known)
        if found is not None and found is not known:
            found = self._sound(key, found)
            if self.copies is not None and found is not None and is_sound(found.data):
                self.copies.put(key, found)
        return None if found is None else found.data

    def get_sound(self, key: str) -> StoredObject | None:
        """Read an object that ends with a checksum from the store, as ``get`` does.

        A damaged one is read once more, as the damage may be of the answer alone.
        """
        return self._sound(key, self.get(key))

    def _sound(self, key: str, found: StoredObject | None) -> StoredObject | None:
        """Return an object that was read; if it is remote and damaged, read it again."""
        if found is None or not self.url.remote or is_sound(found.data):
            return found
        return self._get(key, None)

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``, which is None if there was none.

        Raises StoreError, and ChangedError if another was written meanwhile and the store can
        detect that.
        """
        with self._writing(f"write {key} to"):
            self._backend.put(key, data, former)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._writing(f"delete {key} from"):
            self._backend.delete(key)

    def move(self, key: str, to: str) -> None:
        """Rename an object, if it is there."""
        with self._writing(f"move {key} in"):
            self._backend.move(key, to)

    def entries(self) -> list[Entry]:
        """List all objects with sizes and dates, half-written ones included, sorted by key."""
        self._check_after_failure()
        with self._translated_errors("list what is in"):
            found = sorted(self._backend.entries())
        # A store that is gone lists nothing either: make sure that it is there.
        if not found:
            self.check_reachable()
        return found

    def layers(self) -> list[str]:
        """List the folders at the top of the store: digests of layers, ``costs`` and others."""
        return self.folders("")

    def folders(self, folder: str) -> list[str]:
        """List the folders right under ``folder``.

        An empty list means that the store is there and has none.
        """
        self._check_after_failure()
        with self._translated_errors(f"list {folder or 'all'} in"):
            names = self._backend.folders(folder)
        # A store that is gone lists nothing either: make sure that it is there.
        if not names:
            self.check_reachable()
        return names

    def keys(self, layer: str) -> Iterator[str]:
        """List the keys of all objects of a layer."""
        self._check_after_failure()
        with self._translated_errors(f"list {layer} in"):
            yield from self._backend.keys(layer)

    def check_reachable(self) -> None:
        """Raise StoreAwayError if the sentinel cannot be read, and StoreError if it is damaged or
        of another format; a check stands for CHECKED seconds.

        While one thread checks a store that was away, other threads get the error of the check
        before, without waiting. If the store is remote and does not answer within CHECK_SECONDS,
        the thread that asked gets that error, too. A read-only place that never had a sentinel
        passes.
        """
        # A remote store that was away is checked by a thread, as a call may take seconds. Raise a
        # new error each time: raising adds a traceback, so threads must not share one.
        away = self._away
        if away is not None and self.url.remote:
            self._check_in_thread()
            away = self._away
            if away is not None:
                raise type(away)(str(away))
            return
        # Threads wait for a first check, but not for one of a store that was away.
        if not self._lock.acquire(blocking=away is None):
            raise StoreAwayError(str(away))
        try:
            if self._clock() >= self._checked_until:
                self._away = self._check()
                self._checked_until = self._clock() + CHECKED
            if self._away is not None:
                raise type(self._away)(str(self._away))
        finally:
            self._lock.release()

    @property
    def seconds_silent(self) -> float:
        """Seconds since the store last answered a read, with an object or without."""
        return self._clock() - self._last_answer

    def note_silence(self) -> StoreAwayError:
        """Note that the store does not answer,
        and return the error for callers that wait for it.
        """
        self._away = StoreAwayError(f"The store at {self.url} does not answer.")
        self._checked_until = self._clock() + CHECKED
        return self._away

    def is_new_message(self, text: str) -> bool:
        """Return True, and remember the message,
        if ``text`` was not logged in the last LOG_SECONDS.
        """
        now = self._clock()
        with self._opening:
            recent = {each: at for each, at in self._logged.items() if now - at < LOG_SECONDS}
            self._logged = recent
            return recent.setdefault(text, now) == now

    def check_writable(self) -> None:
        """Check that the store is there and takes writes, and set ``read_only``.

        Raises StoreAwayError, StoreFullError or StoreReadOnlyError if not.
        """
        # Do not rely on an earlier check.
        self._checked_until = -1.0
        self.check_reachable()
        try:
            # A place without a sentinel takes no writes until one can be made there.
            if self._without_sentinel:
                with suppress(ChangedError):
                    self._backend.create_sentinel(SENTINEL_CONTENT)
                self._without_sentinel = False
            else:
                self._backend.check_writable(SENTINEL_CONTENT)
            self.read_only = False
        except Exception as error:
            trouble = store_error("write to", self.url, error)
            self.read_only = isinstance(trouble, StoreReadOnlyError)
            raise trouble from None

    def only_read(self) -> bool:
        """Return True if the store is read-only.

        ``read_only`` is the result of the last test for writing. If it is True, test again first,
        but not within WRITE_RETRY_SECONDS of the last time. This takes calls to the store; if they
        fail, no error is raised.
        """
        if self.read_only and self._clock() >= self._tried + WRITE_RETRY_SECONDS:
            self._tried = self._clock()
            with suppress(StoreError):
                self.check_writable()
        return self.read_only

    def _check_in_thread(self) -> None:
        """Start a thread that checks the store and notes the result, and wait for it, at most for
        CHECK_SECONDS.

        If such a thread is running already, or the last check still stands, return immediately.
        """
        with self._opening:
            if self._clock() < self._checked_until or (
                self._checker is not None and self._checker.is_alive()
            ):
                return
            checker = threading.Thread(target=self._check_and_note, name="store", daemon=True)
            checker.start()
            self._checker = checker
        checker.join(CHECK_SECONDS)

    def _check_and_note(self) -> None:
        """Check the store, and note the result."""
        with self._lock:
            try:
                self._away = self._check()
            except StoreError as error:
                self._away = StoreAwayError(str(error))
            self._checked_until = self._clock() + CHECKED

    @property
    def _backend(self) -> Backend:
        """The backend, made on first use, as that may load a library.

        Raises StoreError if the library is missing, or if it rejects the URL.
        """
        with self._opening:
            if self._made is None:
                self._made = CountedBackend(backend_at(self.url), self.calls)
            return self._made

    def _get(self, key: str, known: StoredObject | None) -> StoredObject | None:
        """Read an object, unless the store holds the ``known`` one; None if there is none."""
        self._check_after_failure()
        with self._translated_errors(f"read {key} from"):
            found = self._backend.get(key, known)
        self._last_answer = self._clock()
        # An absent object may mean an absent store: make sure that the store is there.
        if found is None:
            self.check_reachable()
        return found

    def _check_after_failure(self) -> None:
        """Check the store before its first use, and if the last check has failed."""
        if self._away is not None or not self._seen:
            self.check_reachable()

    @contextmanager
    def _writing(self, action: str) -> Iterator[None]:
        """Raise StoreReadOnlyError if the store is read-only,
        run the block, and translate its errors.
        """
        self._check_after_failure()
        if self.read_only:
            raise StoreReadOnlyError(
                f"The store at {self.url} can only be read: nothing more is baked into it."
            )
        with self._translated_errors(action, writing=True):
            yield

    def _check(self) -> StoreAwayError | None:
        """Read the sentinel, and make it in a new store.

        Return the reason if that fails, else None.
        """
        try:
            found = self._backend.get(SENTINEL_KEY)
        except StoreError:
            raise
        except Exception as error:
            return store_error("reach", self.url, error)
        if found is not None:
            check_sentinel(found.data, self.url)
            self._seen = True
            return None
        if self._without_sentinel:
            return None
        # A store that was there before, or that is not ours to make, has vanished.
        if self._seen or not self.make:
            return StoreAwayError(f"The store at {self.url} is gone: {SENTINEL_GONE}.")
        return self._create_sentinel()

    def _create_sentinel(self) -> StoreAwayError | None:
        """Write the sentinel, and return the reason if that fails, else None.

        A read-only place is used without one.
        """
        try:
            self._backend.create_sentinel(SENTINEL_CONTENT)
        except ChangedError:
            pass  # another process has made the same store at this moment
        except Exception as error:
            trouble = store_error("make a place for light at", self.url, error)
            if not isinstance(trouble, StoreReadOnlyError):
                return trouble
            self.read_only = self._without_sentinel = True
        self._seen = True
        return None

    @contextmanager
    def _translated_errors(self, action: str, writing: bool = False) -> Iterator[None]:
        """Translate a backend's errors in the block; ``action`` completes "Cannot … the store", as
        in ``store_error``. A StoreError passes as it is.

        If a write lacks room or permission, raise StoreFullError or StoreReadOnlyError. After any
        other error check the store immediately, with a trial write if ``writing``. Raise the error
        of the check, or StoreError for this action alone if the store passes.

        After a failed read, a remote store counts as away until a check has passed: if the check
        takes longer than CHECK_SECONDS, raise StoreAwayError for this action.
        """
        try:
            yield
        except StoreError:
            raise
        except Exception as error:
            trouble = store_error(action, self.url, error)
            if writing and isinstance(trouble, StoreFullError | StoreReadOnlyError):
                raise trouble from error
            # Check the store immediately: if it is gone, this raises, and later calls need not
            # fail one by one.
            self._checked_until = -1.0
            # Count a remote store as away, so that the check is left to a thread and this caller
            # waits CHECK_SECONDS at most. Not after a write: the store may still be read, and reads
            # go on meanwhile.
            if self.url.remote and not writing:
                self._away = self._away or trouble
            if writing:
                self.check_writable()
            else:
                self.check_reachable()
            raise StoreError(str(trouble)) from error


StoreLike = str | Path | StoreUrl | Store
"""A store, or the folder or URL of one."""


def backend_at(url: StoreUrl) -> Backend:
    """Return the backend of a URL, by its scheme. Raises StoreError if a library is missing."""
    if url.remote:
        return Bucket(url, SENTINEL_KEY)
    if url.scheme == "file":
        return Folder(url.folder, SENTINEL_KEY)
    return FileSystem(url, SENTINEL_KEY)


METADATA_KEY = "zarr.json"
"""Name of the object that describes a Zarr array."""


def description(**array: Any) -> bytes:
    """Return the ``zarr.json`` of an array made with these arguments of ``zarr.create_array``."""
    # Let Zarr write the metadata to memory, so that it is Zarr's in all details.
    store = MemoryStore()
    zarr.create_array(store, zarr_format=3, **array)
    return store._store_dict[METADATA_KEY].to_bytes()


@lru_cache(maxsize=64)
def described_array(document: bytes) -> "zarr.Array[Any]":
    """Return the array that a ``zarr.json`` describes, without chunks. Raises errors of many kinds
    for other documents.

    The result is cached: metadata is read before each new chunk, and parsing it takes Zarr as long
    as a small task takes to bake.
    """
    store = MemoryStore({METADATA_KEY: default_buffer_prototype().buffer.from_bytes(document)})
    return zarr.open_array(store, mode="r", zarr_format=3)


CRC_BYTES = 4
"""Bytes of the checksum, crc32c, at the end of an object."""

ZSTD_LEVEL = 1
"""Compression level of Zstandard."""


def wrap(record: np.ndarray) -> bytes:
    """Compress a ``record``, (bytes,) uint8, into an object with a checksum."""
    body = bytes(Zstd(level=ZSTD_LEVEL).encode(record))
    return body + checksum_of(body)


def unwrap(stored: bytes, size: int) -> np.ndarray:
    """Return the record in an object, (``size``,) uint8.

    Raises DamagedChunkError if it is damaged.
    """
    return unwrap_all([stored], size)[0]


def unwrap_all(stored: Sequence[bytes], size: int) -> np.ndarray:
    """Check and decompress objects that ``wrap`` has made. Return their records of ``size`` bytes,
    (objects, ``size``) uint8, read-only.

    Raises DamagedChunkError if any is damaged. All are decoded as one stream, so that Zstandard is
    set up once.
    """
    # A body is a frame, and Zstandard decodes frames in a row to their contents in a row.
    bodies = b"".join(map(body_of, stored))
    try:
        records = np.frombuffer(Zstd().decode(bodies) if stored else b"", np.uint8)
    except (RuntimeError, ValueError) as error:
        raise DamagedChunkError("it does not unpack") from error
    if len(records) != len(stored) * size:
        raise DamagedChunkError("it does not unpack to a record")
    return records.reshape(len(stored), size)


def body_of(stored: bytes) -> bytes:
    """Return an object without its checksum. Raises DamagedChunkError if the checksum is wrong."""
    body = stored[:-CRC_BYTES]
    checksum = stored[-CRC_BYTES:]
    if len(stored) <= CRC_BYTES or checksum_of(body) != checksum:
        raise DamagedChunkError("its checksum is wrong")
    return body


def is_sound(stored: bytes) -> bool:
    """Return True if the checksum at the end of an object is right."""
    try:
        body_of(stored)
    except DamagedChunkError:
        return False
    return True


def checksum_of(body: bytes) -> bytes:
    """Return the checksum that ends an object with this ``body``."""
    return google_crc32c.value(body).to_bytes(CRC_BYTES, "little")


MAX_TRIES = 5
"""Tries of a write while others write the same document.

A try fails only if the write of another process has succeeded meanwhile, so that this many
processes can write a document at the same moment, and all of them succeed. Hardly more do: a
document belongs to one prewarm, or to the walls of one scene.
"""


class Documents:
    """The JSON documents in one ``folder`` of a ``store``.

    Methods block: do not call them in an event loop.
    """

    def __init__(self, store: StoreLike, folder: str) -> None:
        """Set up without a request to the store."""
        self.store = Store.of(store)
        self.folder = folder

    def path_of(self, name: str) -> str:
        """Return the path or URL of a document, for messages."""
        return f"{self.store.url.name}/{self._key(name)}"

    def read(self, name: str) -> dict[str, Any] | None:
        """Read a document; None if there is none. Raises StoreError if it is not a JSON object."""
        found = self.store.get(self._key(name))
        try:
            if found is None:
                document = None
            else:
                document = json.loads(found.data)
        except (ValueError, RecursionError) as error:
            raise StoreError(f"{self.path_of(name)} is damaged ({error}): move it away.") from error
        if document is not None and not isinstance(document, dict):
            raise StoreError(f"{self.path_of(name)} is damaged (no JSON object): move it away.")
        return document

    def write(self, name: str, document: dict[str, Any]) -> None:
        """Write a document in place of the former one.

        Raises StoreError if others write it at the same time, again and again.
        """
        key = self._key(name)
        content = json.dumps(document, indent=1, allow_nan=False).encode()
        for _ in range(MAX_TRIES):
            # Replace the document that is there; if another process was faster, replace that one.
            with suppress(ChangedError):
                return self.store.put(key, content, self.store.get(key))
        raise StoreError(f"Others keep writing {self.path_of(name)}; it is tried again later.")

    def names(self) -> list[str]:
        """List the names of all documents, sorted."""
        found = (key.rpartition("/")[2] for key in self.store.keys(self.folder))
        return sorted(name.removesuffix(".json") for name in found if name.endswith(".json"))

    def _key(self, name: str) -> str:
        """Return the key of a document's object."""
        return f"{self.folder}/{name}.json"
