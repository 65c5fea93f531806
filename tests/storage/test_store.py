"""A store: its objects and documents, what is absent, and what is not known because the store is
away.
"""

import errno
import fcntl
import functools
import http.server
import json
import pickle
import re
import sys
import threading
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import (
    ChangedError,
    DamagedChunkError,
    StoreAwayError,
    StoreError,
    StoreFullError,
    StoreReadOnlyError,
    StoreUrlError,
)
from isogi_core.storage.backend import StoredObject, StoreUrl
from isogi_core.storage.folder import Copies
from isogi_core.storage.object_store import sentence
from isogi_core.storage.store import (
    Documents,
    Store,
    unwrap,
    unwrap_all,
    wrap,
)
from tests.s3 import ACCESS_KEY, SECRET_KEY, Fault, S3Server
from tests.worker.clock import Clock

KEY = "layer/c/0/0/0/0"
OTHER = "layer/c/0/0/1/0"
SENTINEL = b'{"kind": "isogi light", "format": 1}'
IMPATIENT = {"seconds": 0.3, "retries": 0}


@pytest.fixture(params=["folder", "s3", "standard_s3", "memory"])
def location(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A folder or URL of each kind of store, with nothing in it."""
    if request.param == "standard_s3":
        return str(request.getfixturevalue("standard_s3"))
    if request.param == "s3":
        return str(request.getfixturevalue("s3").url)
    return {"folder": str(tmp_path / "light"), "memory": f"memory://{uuid.uuid4().hex}"}[
        request.param
    ]


def bucket(s3: S3Server, clock: Clock | None = None, **more: Any) -> Store:
    """A store that has its sentinel and one object, and whose calls fail soon."""
    store = Store(StoreUrl(s3.url, **{**IMPATIENT, **more}), clock=clock or Clock())
    store.put(KEY, b"light", None)
    s3.calls.clear()
    return store


def methods(s3: S3Server) -> list[str]:
    """What was asked, since the calls were last forgotten."""
    return [f"{call.method} {call.key.removeprefix(s3.prefix).lstrip('/')}" for call in s3.calls]


# --- objects
# --------------------------------------------------------------------------------------------------


def test_objects_are_kept_listed_and_deleted(location: str) -> None:
    store = Store(location)
    assert store.get(KEY) is None and store.layers() == []
    store.put(KEY, b"light", None)
    store.put(OTHER, b"", None)
    store.put("costs/x/zarr.json", b"{}", None)
    again = Store(location, make=False)
    assert again.get(KEY) == StoredObject(b"light") and again.view(OTHER) == b""
    assert again.folders("layer") == ["c"] and {"layer", "costs"} <= set(again.layers())
    assert sorted(again.keys("layer")) == [KEY, OTHER]
    again.delete(KEY)
    assert store.get(KEY) is None and sorted(store.keys("layer")) == [OTHER]


def test_an_object_is_written_in_place_of_what_was_read_alone(location: str) -> None:
    mine, theirs = Store(location), Store(location)
    mine.put(KEY, b"old", None)
    with pytest.raises(ChangedError):
        theirs.put(KEY, b"unread", None)
    read = theirs.get(KEY)
    mine.put(KEY, b"new", mine.get(KEY))
    with pytest.raises(ChangedError):
        theirs.put(KEY, b"stale", read)
    assert theirs.get(KEY) == StoredObject(b"new")
    theirs.delete(KEY)
    with pytest.raises(ChangedError):
        mine.put(KEY, b"back", StoredObject(b"new", '"a tag"'))


def test_each_of_many_writers_is_kept_or_refused(location: str) -> None:
    """Where the store can tell; in one process memory can too, for its calls come one after the
    other.
    """
    if location.startswith("memory"):
        pytest.skip("a store in memory cannot tell")
    together = threading.Barrier(8)

    def write(number: int) -> None:
        store = Store(location)
        together.wait()
        while True:
            found = store.get(KEY)
            numbers = json.loads(found.data) if found else []
            with suppress(ChangedError):
                return store.put(KEY, json.dumps([*numbers, number]).encode(), found)

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(write, range(8)))
    found = Store(location).get(KEY)
    assert found is not None and sorted(json.loads(found.data)) == list(range(8))


def test_a_writer_waits_for_the_one_that_has_the_folder(tmp_path: Path) -> None:
    """And is refused what that one has changed: between its look at an object and its own, no other
    writes.
    """
    store = Store(tmp_path)
    store.put(KEY, b"light", None)
    with open(tmp_path / "isogi.json", "r+b") as other, ThreadPoolExecutor(1) as threads:
        fcntl.flock(other, fcntl.LOCK_EX)
        writing = threads.submit(store.put, KEY, b"more", store.get(KEY))
        with pytest.raises(TimeoutError):
            writing.result(timeout=0.2)
        (tmp_path / KEY).write_bytes(b"another's")
        fcntl.flock(other, fcntl.LOCK_UN)
        with pytest.raises(ChangedError):
            writing.result()
    assert store.get(KEY) == StoredObject(b"another's")


def test_a_moved_object_is_under_its_new_name_alone(location: str) -> None:
    store = Store(location)
    store.put(KEY, b"light", None)
    store.move(KEY, "aside/0")
    assert store.get(KEY) is None and store.get("aside/0") == StoredObject(b"light")
    store.put(KEY, b"more", None)
    store.move(KEY, "aside/0")
    store.move(OTHER, "aside/1")
    assert store.get("aside/0") == StoredObject(b"more") and store.get("aside/1") is None
    assert {entry.key: entry.size for entry in store.entries()} == {
        "aside/0": 4,
        "isogi.json": len(SENTINEL),
    }


# --- the sentinel
# -------------------------------------------------------------------------------------------------


def test_a_new_store_gets_a_sentinel(location: str) -> None:
    with pytest.raises(StoreAwayError, match="is gone"):
        Store(location, make=False).open()
    Store(location).open()
    assert Store(location, make=False).get("isogi.json") == StoredObject(SENTINEL)


def test_many_who_open_a_new_store_at_once_agree(location: str) -> None:
    stores = [Store(location) for _ in range(8)]
    barrier = threading.Barrier(len(stores))

    def first(store: Store) -> None:
        barrier.wait()
        store.open()
        store.put(f"layer/{id(store)}", b"light", None)

    with ThreadPoolExecutor(len(stores)) as threads:
        list(threads.map(first, stores))
    assert Store(location, make=False).get("isogi.json") == StoredObject(SENTINEL)
    assert len(list(Store(location, make=False).keys("layer"))) == len(stores), (
        "no light of theirs is lost"
    )


@pytest.mark.parametrize(
    ("sentinel", "raised"),
    [
        (b'{"format": 2}', "is of format 2, and this isogi knows 1"),
        (b"", "damaged"),
        (b"[]", "damaged"),
    ],
)
def test_a_store_of_another_format_is_refused(location: str, sentinel: bytes, raised: str) -> None:
    first = Store(location)
    first.put(KEY, b"light", None)
    first.put("isogi.json", sentinel, first.get("isogi.json"))
    for use in (
        lambda r: r.open(),
        lambda r: r.get(KEY),
        lambda r: r.put(OTHER, b"", None),
        lambda r: r.check_writable(),
    ):
        with pytest.raises(StoreError, match=raised):
            use(Store(location))


def test_missing_objects_of_a_dead_store_are_not_absent(location: str) -> None:
    clock = Clock()
    store = Store(location, clock=clock)
    store.put(KEY, b"light", None)
    assert store.get(OTHER) is None
    other = Store(location, clock=clock)
    other.delete(KEY)
    other.delete("isogi.json")
    clock.now += 0.4
    assert store.get(OTHER) is None, "believed for a moment"
    clock.now += 2.0
    for use in (
        lambda: store.get(KEY),
        lambda: store.folders("layer"),
        lambda: store.put(OTHER, b"", None),
        store.check_writable,
    ):
        with pytest.raises(StoreAwayError, match="is gone"):
            use()
    Store(location).open()
    clock.now += 2.0
    assert store.get(KEY) is None


def test_a_file_system_without_hard_links_is_one_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    Store(tmp_path).put(KEY, b"light", None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["isogi.json", "layer"]


def test_a_folder_that_was_unmounted_is_not_baked_into(tmp_path: Path) -> None:
    store = Store(tmp_path / "light")
    store.put(KEY, b"light", None)
    (tmp_path / "light").rename(tmp_path / "disk")
    (tmp_path / "light").mkdir()
    with pytest.raises(StoreAwayError, match="is gone"):
        store.put(OTHER, b"light", None)
    assert not list((tmp_path / "light").iterdir())


# --- an object store that fails
# -----------------------------------------------------------------------------------


def test_absent_objects_do_not_read_the_sentinel_each_time(s3: S3Server) -> None:
    clock = Clock()
    store = bucket(s3, clock)
    assert [store.get(OTHER) for _ in range(3)] == [None] * 3
    assert methods(s3) == [f"GET {OTHER}"] * 3
    clock.now += 2.0
    assert store.get(OTHER) is None
    assert methods(s3)[3:] == [f"GET {OTHER}", "GET isogi.json"]


@pytest.mark.parametrize("fault", [500, 503, 403, "hang", "short", "drop", "no-bucket"])
def test_a_store_that_fails_is_away_and_is_let_alone_for_a_while(
    s3: S3Server, fault: Fault
) -> None:
    clock = Clock()
    store = bucket(s3, clock)
    clock.now += 2.0
    s3.fault = lambda call: fault
    for _ in range(5):
        with pytest.raises(StoreAwayError) as raised:
            store.get(OTHER)
        assert str(raised.value).endswith(".") and "\n" not in str(raised.value)
        assert not {ACCESS_KEY, SECRET_KEY} & set(str(raised.value).replace("=", " ").split())
    assert methods(s3) == [f"GET {OTHER}", "GET isogi.json"]
    s3.fault = lambda call: None
    clock.now += 2.0
    assert store.get(KEY) == StoredObject(b"light")


def test_a_bucket_that_is_gone_is_not_taken_for_empty(s3: S3Server) -> None:
    clock = Clock()
    store = bucket(s3, clock)
    s3.fault = lambda call: "no-bucket"
    clock.now += 2.0
    with pytest.raises(StoreAwayError, match="is gone"):
        store.get(KEY)
    with pytest.raises(StoreAwayError, match="Cannot make a place for light"):
        Store(StoreUrl(s3.url, **IMPATIENT)).open()


def test_one_object_that_fails_is_no_dead_store(s3: S3Server) -> None:
    store = bucket(s3)
    s3.fault = lambda call: 500 if call.key.endswith(KEY) else None
    for use in (
        lambda: store.get(KEY),
        lambda: store.put(KEY, b"more", StoredObject(b"light", '"tag"')),
    ):
        with pytest.raises(StoreError, match="500") as raised:
            use()
        assert not isinstance(raised.value, StoreAwayError)
    assert store.get(OTHER) is None


def test_a_call_is_tried_again_so_often_and_no_more(s3: S3Server) -> None:
    store = bucket(s3, retries=2)
    faults = iter([500, "drop"])
    s3.fault = lambda call: next(faults, None)
    assert store.get(KEY) == StoredObject(b"light")
    assert methods(s3) == [f"GET {KEY}"] * 3
    s3.fault = lambda call: 500
    with pytest.raises(StoreAwayError):
        store.get(KEY)
    assert methods(s3)[3:] == [f"GET {KEY}"] * 3 + ["GET isogi.json"] * 3


def test_a_wrong_access_key_is_refused_and_not_repeated(
    s3: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIASOMEBODYELSE")
    with pytest.raises(StoreAwayError, match="403 Forbidden") as raised:
        Store(StoreUrl(s3.url, **IMPATIENT)).open()
    assert "SOMEBODYELSE" not in str(raised.value) and not s3.objects


def test_a_store_that_may_only_be_read_is_read(s3: S3Server) -> None:
    bucket(s3)
    s3.fault = lambda call: 403 if call.method == "PUT" else None
    store = Store(StoreUrl(s3.url, **IMPATIENT))
    store.open()
    with pytest.raises(StoreReadOnlyError):
        store.check_writable()
    assert store.read_only and store.get(KEY) == StoredObject(b"light") and store.get(OTHER) is None
    with pytest.raises(StoreReadOnlyError, match="can only be read"):
        store.put(OTHER, b"", None)
    s3.fault = lambda call: None
    store.check_writable()
    assert not store.read_only
    store.put(OTHER, b"", None)


def test_an_empty_bucket_takes_writes_once_it_may(s3: S3Server) -> None:
    s3.fault = lambda call: 403 if call.method == "PUT" else None
    store = Store(StoreUrl(s3.url, **IMPATIENT))
    store.open()
    with pytest.raises(StoreReadOnlyError):
        store.check_writable()
    assert store.read_only
    s3.fault = lambda call: None
    store.check_writable()
    assert not store.read_only
    store.put(OTHER, b"", None)


def test_a_store_without_room_is_full_and_is_read(s3: S3Server) -> None:
    store = bucket(s3)
    s3.fault = lambda call: 507 if call.method == "PUT" else None
    for use in (lambda: store.put(OTHER, b"light", None), store.check_writable):
        with pytest.raises(StoreFullError, match="the store is full"):
            use()
    assert not store.read_only and store.get(KEY) == StoredObject(b"light")


@pytest.mark.parametrize("raised", [True, False])
def test_a_store_without_conditional_writes_is_written(
    s3: S3Server, monkeypatch: pytest.MonkeyPatch, raised: bool
) -> None:
    if raised:
        monkeypatch.setenv("AWS_CONDITIONAL_PUT", "disabled")
    s3.fault = lambda call: 501 if call.method == "PUT" and call.condition else None
    store = bucket(s3)
    store.put(KEY, b"more", StoredObject(b"light", '"what was there long ago"'))
    assert store.get(KEY) == StoredObject(b"more")
    store.check_writable()
    assert any(call.condition for call in s3.calls) is not raised


def test_a_store_that_is_read_by_http_is_never_written(tmp_path: Path) -> None:
    Store(tmp_path / "light").put(KEY, b"light", None)
    with served(tmp_path) as address:
        store = Store(f"{address}/light")
        assert store.view(KEY) == b"light" and store.get(OTHER) is None
        with pytest.raises(StoreReadOnlyError):
            store.check_writable()
        assert store.read_only


class served:
    """A folder behind an HTTP server that knows GET and HEAD; its address."""

    def __init__(self, folder: Path) -> None:
        handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)

    def __enter__(self) -> str:
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True
        ).start()
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()


# --- secrets
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "url",
    [
        "s3://me:hunter2@bucket/light",
        "ftp://hunter2@host/x",
        "az://account/light?sig=hunter2",
        "simplecache::s3://a:hunter2@b/c",
    ],
)
def test_a_url_with_a_password_is_refused_and_not_repeated(url: str) -> None:
    with pytest.raises(StoreUrlError, match="must not hold a password") as raised:
        Store(url)
    assert "hunter2" not in str(raised.value)


def test_a_store_is_pickled_as_its_url_alone(s3: S3Server) -> None:
    store = bucket(s3)
    sent = pickle.dumps((store, store.url))
    assert not any(secret.encode() in sent for secret in (ACCESS_KEY, SECRET_KEY))
    assert not any(
        secret in f"{store!r} {store.url!r} {store.url}" for secret in (ACCESS_KEY, SECRET_KEY)
    )
    there, url = pickle.loads(sent)
    assert url == store.url and there.get(KEY) == StoredObject(b"light")


def test_a_missing_library_is_named_with_its_install_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(StoreError, match=r"pip install 'isogi\[s3\]'"):
        Store("s3://bucket/light").open()


# --- copies
# --------------------------------------------------------------------------------------------------


LIGHT = wrap(np.frombuffer(b"light", np.uint8))
BETTER = wrap(np.frombuffer(b"better light", np.uint8))
"""Objects with their checksums."""


@pytest.fixture
def copied(s3: S3Server, tmp_path: Path) -> Iterator[Store]:
    """A store with copies in a folder of this machine."""
    bucket(s3)
    s3.objects[f"{s3.prefix}/{KEY}"] = LIGHT
    yield Store(StoreUrl(s3.url, **IMPATIENT), copies=Copies(s3.url, 1 << 20, tmp_path / "copies"))


def test_objects_read_again_are_not_sent_again(s3: S3Server, copied: Store, tmp_path: Path) -> None:
    again = Store(copied.url, copies=Copies(s3.url, 1 << 20, tmp_path / "copies"))
    assert copied.view(KEY) == LIGHT
    sent = s3.sent
    assert [store.view(KEY) for store in (copied, copied)] == [LIGHT] * 2
    assert s3.sent == sent, "told that it still stands"
    assert again.view(KEY) == LIGHT
    assert s3.sent == sent + len(SENTINEL), "another process asks for the sentinel"


def test_another_machines_writes_are_seen_at_once(s3: S3Server, copied: Store) -> None:
    assert copied.view(KEY) == LIGHT
    other = Store(copied.url)
    other.put(KEY, BETTER, other.get(KEY))
    assert copied.view(KEY) == BETTER == copied.view(KEY)
    other.delete(KEY)
    assert copied.view(KEY) is None


def test_a_copy_of_another_stores_object_is_none(tmp_path: Path) -> None:
    copies = [Copies(url, 1 << 20, tmp_path) for url in ("s3://one", "s3://other")]
    copies[0].put(KEY, StoredObject(LIGHT, '"tag"'))
    assert copies[0].get(KEY) == StoredObject(LIGHT) and copies[1].get(KEY) is None


def test_writers_read_no_copy(s3: S3Server, copied: Store) -> None:
    copied.view(KEY)
    s3.calls.clear()
    assert copied.get(KEY) == StoredObject(LIGHT)
    assert [call.condition for call in s3.calls] == [""]


def test_a_damaged_copy_is_none(copied: Store, tmp_path: Path) -> None:
    copied.view(KEY)
    (path,) = (tmp_path / "copies").iterdir()
    kept = path.read_bytes()
    for url in range(len(kept)):
        path.write_bytes(kept[:url] + bytes([kept[url] ^ 1]) + kept[url + 1 :])
        assert copied.view(KEY) == LIGHT
        assert path.read_bytes() == kept


def flipping(s3: S3Server, times: int) -> None:
    """Have a bit flipped in the next answers with the object."""
    left = iter(["flip"] * times)
    s3.fault = lambda call: next(left, None) if call.key.endswith(KEY) else None  # type: ignore[return-value]
    s3.calls.clear()


def test_a_damaged_answer_is_read_again_and_not_kept(s3: S3Server, copied: Store) -> None:
    """Its tag is that of the sound object: the store would confirm the copy for ever."""
    flipping(s3, 1)
    assert copied.view(KEY) == LIGHT
    asked = [call.condition for call in s3.calls if call.key.endswith(KEY)]
    assert asked == ["", ""]
    sent = s3.sent
    assert copied.view(KEY) == LIGHT and s3.sent == sent


def test_answers_that_stay_damaged_are_never_kept(s3: S3Server, copied: Store) -> None:
    flipping(s3, 4)
    damaged = [copied.view(KEY), copied.view(KEY)]
    assert all(found not in (None, LIGHT) for found in damaged)
    assert len(s3.calls) - sum("isogi.json" in call.key for call in s3.calls) == 4
    assert copied.view(KEY) == LIGHT


def test_a_copy_that_was_damaged_on_its_way_is_dropped(
    s3: S3Server, copied: Store, tmp_path: Path
) -> None:
    """Such as former versions kept: whole on the disk, with the tag of the sound object."""
    assert copied.view(KEY) == LIGHT
    copies = Copies(s3.url, 1 << 20, tmp_path / "copies")
    kept = copies.get(KEY)
    assert kept is not None
    copies.put(KEY, StoredObject(bytes([kept.data[0] ^ 1]) + kept.data[1:], kept.tag))
    assert copied.view(KEY) == LIGHT
    assert copies.get(KEY) == kept


def test_a_writer_reads_a_damaged_answer_again(s3: S3Server, copied: Store) -> None:
    flipping(s3, 1)
    assert copied.get_sound(KEY) == StoredObject(LIGHT)
    flipping(s3, 2)
    found = copied.get_sound(KEY)
    assert found is not None and found.data != LIGHT, "it is given back for whoever reports it"


def test_copies_take_no_more_room_than_they_may(tmp_path: Path) -> None:
    copies = Copies("s3://bucket", 10_000, tmp_path)
    for number in range(100):
        copies.put(str(number), StoredObject(bytes(900), '"tag"'))
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 11_000
    assert copies.get("99") == StoredObject(bytes(900)) and copies.get("0") is None


def test_copies_that_cannot_be_kept_are_none(tmp_path: Path, s3: S3Server) -> None:
    (tmp_path / "file").write_text("")
    bucket(s3)
    s3.objects[f"{s3.prefix}/{KEY}"] = LIGHT
    store = Store(s3.url, copies=Copies(s3.url, 1 << 20, tmp_path / "file"))
    assert store.view(KEY) == LIGHT == store.view(KEY)


# --- documents
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_what_is_written_is_read_and_listed(tmp_path: Path, scheme: str) -> None:
    documents = Documents(f"{scheme}{tmp_path}", "papers")
    assert (documents.read("one"), documents.names()) == (None, [])
    documents.write("one", {"a": 1})
    documents.write("two", {"b": [2.5, None, "é"]})
    documents.write("one", {"a": 3})
    assert documents.read("one") == {"a": 3}
    assert documents.read("two") == {"b": [2.5, None, "é"]}
    assert documents.names() == ["one", "two"]
    assert documents.path_of("one") == f"{tmp_path}/papers/one.json"
    assert sorted(path.name for path in (tmp_path / "papers").iterdir()) == ["one.json", "two.json"]


@pytest.mark.parametrize("content", ["", "{", "[1]"])
def test_damaged_files_are_errors(tmp_path: Path, content: str) -> None:
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "one.json").write_text(content)
    with pytest.raises(StoreError, match="damaged"):
        Documents(tmp_path, "papers").read("one")


def test_a_place_that_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StoreError, match=re.escape(str(tmp_path))):
        Documents(str(tmp_path / "file"), "papers").write("one", {})


@pytest.mark.parametrize("others", [0, 1, 2, 100])
def test_a_document_that_others_write_too_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: int
) -> None:
    documents = Documents(tmp_path, "papers")
    put = Store.put
    tried = list[str]()

    def contested(store: Store, key: str, *what: Any) -> None:
        tried.append(key)
        if len(tried) <= others:
            raise ChangedError("Another writer was here.")
        put(store, key, *what)

    documents.write("one", {"a": 1})
    monkeypatch.setattr(Store, "put", contested)
    if others < 100:
        documents.write("one", {"a": 2})
        assert documents.read("one") == {"a": 2} and len(tried) == others + 1
    else:
        with pytest.raises(StoreError, match="Others keep writing"):
            documents.write("one", {"a": 2})
        assert documents.read("one") == {"a": 1} and 3 <= len(tried) <= 10


# --- what buckets say
# -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (
            "Error performing GET http://a/b?key=1 in 2s - HTTP error: error sending request",
            "before an answer",
        ),
        (
            "Generic S3 error: HTTP error: request or response body error\n\nDebug source:",
            "in the middle of an answer",
        ),
        (
            "Error performing PUT http://a/b in 1s - HTTP error: operation timed out",
            "no answer came in time",
        ),
        (
            (
                "Error performing PUT http://a/b in 1s - Server returned non-2xx status code: 400 "
                'Bad Request: {"a":{}}'
            ),
            "status code: 400 Bad Request",
        ),
        (
            "Error in 1s - Server returned non-2xx status code: 403 Forbidden: <Error><Code>",
            "status code: 403 Forbidden",
        ),
    ],
)
def test_what_a_bucket_says_is_a_sentence(said: str, told: str) -> None:
    words = sentence(OSError(said))
    assert words.endswith(told)
    assert not {"{", "<", "/", "?", "\n"} & {*words}


# --- objects of chunks
# ------------------------------------------------------------------------------------------------


RNG = np.random.default_rng(3)
RECORD = RNG.integers(0, 9, 200).astype(np.uint8)


def test_a_record_comes_back_from_its_object() -> None:
    for record in (RECORD, np.zeros(5000, np.uint8), RNG.integers(0, 256, 300).astype(np.uint8)):
        np.testing.assert_array_equal(unwrap(wrap(record), len(record)), record)


def test_every_bit_that_flips_and_every_cut_is_noticed() -> None:
    stored = wrap(RECORD)
    number = int.from_bytes(stored, "little")
    flipped = (
        (number ^ 1 << bit).to_bytes(len(stored), "little") for bit in range(8 * len(stored))
    )
    cut = (stored[:end] for end in range(len(stored)))
    for broken in (*flipped, *cut, stored + b"\0", bytes(len(stored))):
        with pytest.raises(DamagedChunkError):
            unwrap(broken, len(RECORD))


@pytest.mark.parametrize("size", [len(RECORD) - 1, len(RECORD) + 1, 0])
def test_a_record_of_another_layer_is_no_record(size: int) -> None:
    with pytest.raises(DamagedChunkError, match="does not unpack to a record"):
        unwrap(wrap(RECORD), size)


def test_one_damaged_object_of_many_is_noticed() -> None:
    records = RNG.integers(0, 9, (7, 64)).astype(np.uint8)
    stored = [wrap(record) for record in records]
    np.testing.assert_array_equal(unwrap_all(stored, 64), records)
    assert unwrap_all([], 64).shape == (0, 64)
    for broken in range(7):
        with pytest.raises(DamagedChunkError):
            unwrap_all([*stored[:broken], stored[broken][:-1], *stored[broken + 1 :]], 64)
