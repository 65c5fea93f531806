"""The root of a store: what is there, what is absent, and what is not known because the store is away."""

import errno
import functools
import http.server
import json
import pickle
import sys
import threading
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from isogi_core.cache.copies import Copies
from isogi_core.cache.place import Place
from isogi_core.cache.root import BELIEVED, Root
from isogi_core.cache.sentinel import CONTENT, SENTINEL
from isogi_core.cache.shelf import Found
from isogi_core.errors import ChangedError, PlaceError, StoreAwayError, StoreError, StoreFullError, StoreReadOnlyError
from tests.s3 import ACCESS_KEY, SECRET_KEY, Fault, S3Server
from tests.worker.clock import Clock

KEY, OTHER = "layer/c/0/0/0/0", "layer/c/0/0/1/0"
IMPATIENT = {"seconds": 0.3, "retries": 0}


@pytest.fixture(params=["folder", "s3", "memory"])
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A folder or URL of each kind of store, with nothing in it."""
    if request.param == "s3":
        return str(request.getfixturevalue("s3").url)
    return {"folder": str(tmp_path / "light"), "memory": f"memory://{uuid.uuid4().hex}"}[request.param]


def bucket(s3: S3Server, clock: Clock | None = None, **more: Any) -> Root:
    """A store that has its sentinel and one object, and whose calls fail soon."""
    root = Root(Place(s3.url, **{**IMPATIENT, **more}), clock=clock or Clock())
    root.put(KEY, b"light", None)
    s3.calls.clear()
    return root


def methods(s3: S3Server) -> list[str]:
    """What was asked, since the calls were last forgotten."""
    return [f"{call.method} {call.key.removeprefix(s3.prefix).lstrip('/')}" for call in s3.calls]


# --- objects ------------------------------------------------------------------------------------------------------


def test_objects_are_kept_listed_and_deleted(where: str) -> None:
    root = Root(where)
    assert root.get(KEY) is None and root.layers() == []
    root.put(KEY, b"light", None)
    root.put(OTHER, b"", None)
    root.put("costs/x/zarr.json", b"{}", None)
    again = Root(where, make=False)
    assert again.get(KEY) == Found(b"light") and again.view(OTHER) == b""
    assert again.names("layer") == ["c"] and {"layer", "costs"} <= set(again.layers())
    assert sorted(again.keys("layer")) == [KEY, OTHER]
    again.delete(KEY)
    assert root.get(KEY) is None and sorted(root.keys("layer")) == [OTHER]


def test_an_object_is_written_in_place_of_what_was_read_alone(where: str) -> None:
    mine, theirs = Root(where), Root(where)
    mine.put(KEY, b"old", None)
    with pytest.raises(ChangedError):
        theirs.put(KEY, b"unread", None)
    read = theirs.get(KEY)
    mine.put(KEY, b"new", mine.get(KEY))
    with pytest.raises(ChangedError):
        theirs.put(KEY, b"stale", read)
    assert theirs.get(KEY) == Found(b"new")
    theirs.delete(KEY)
    with pytest.raises(ChangedError):
        mine.put(KEY, b"back", Found(b"new", '"a tag"'))


def test_of_many_that_write_at_once_each_is_told_or_kept(where: str) -> None:
    """Where the store can tell; in one process memory can too, for its calls come one after the other."""
    if where.startswith("memory"):
        pytest.skip("a store in memory cannot tell")
    kept: list[int] = []

    def write(number: int) -> None:
        root = Root(where)
        while True:
            found = root.get(KEY)
            numbers = json.loads(found.data) if found else []
            try:
                return root.put(KEY, json.dumps([*numbers, number]).encode(), found)
            except ChangedError:
                kept.append(number)

    writers = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    found = Root(where).get(KEY)
    assert found is not None and sorted(json.loads(found.data)) == list(range(8))


# --- the sentinel -------------------------------------------------------------------------------------------------


def test_a_new_store_gets_a_sentinel(where: str) -> None:
    with pytest.raises(StoreAwayError, match="is gone"):
        Root(where, make=False).open()
    Root(where).open()
    assert Root(where, make=False).get(SENTINEL) == Found(CONTENT)
    assert json.loads(CONTENT) == {"kind": "isogi light", "format": 1}


@pytest.mark.parametrize(
    ("sentinel", "told"),
    [(b'{"format": 2}', "is of format 2, and this isogi knows 1"), (b"", "damaged"), (b"[]", "damaged")],
)
def test_a_store_of_another_format_is_refused(where: str, sentinel: bytes, told: str) -> None:
    first = Root(where)
    first.put(KEY, b"light", None)
    first.put(SENTINEL, sentinel, first.get(SENTINEL))
    for use in (lambda r: r.open(), lambda r: r.get(KEY), lambda r: r.put(OTHER, b"", None), lambda r: r.prove()):
        with pytest.raises(StoreError, match=told):
            use(Root(where))


def test_what_is_missing_in_a_store_that_has_died_is_not_absent(where: str) -> None:
    clock = Clock()
    root = Root(where, clock=clock)
    root.put(KEY, b"light", None)
    assert root.get(OTHER) is None
    other = Root(where, clock=clock)
    other.delete(KEY)
    other.delete(SENTINEL)
    assert root.get(OTHER) is None, "believed for a moment"
    clock.now += BELIEVED
    for use in (lambda: root.get(KEY), lambda: root.names("layer"), lambda: root.put(OTHER, b"", None), root.prove):
        with pytest.raises(StoreAwayError, match="is gone"):
            use()
    Root(where).open()
    clock.now += BELIEVED
    assert root.get(KEY) is None


def test_a_file_system_without_hard_links_is_one_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    Root(tmp_path).put(KEY, b"light", None)
    assert sorted(path.name for path in tmp_path.iterdir()) == [SENTINEL, "layer"]


def test_a_folder_that_was_unmounted_is_not_baked_into(tmp_path: Path) -> None:
    root = Root(tmp_path / "light")
    root.put(KEY, b"light", None)
    (tmp_path / "light").rename(tmp_path / "disk")
    (tmp_path / "light").mkdir()
    with pytest.raises(StoreAwayError, match="is gone"):
        root.put(OTHER, b"light", None)
    assert not list((tmp_path / "light").iterdir())


# --- an object store that fails -----------------------------------------------------------------------------------


def test_that_something_is_absent_takes_no_look_at_the_sentinel_each_time(s3: S3Server) -> None:
    root = bucket(s3)
    assert [root.get(OTHER) for _ in range(3)] == [None] * 3
    assert methods(s3) == [f"GET {OTHER}"] * 3
    root._clock.now += BELIEVED  # type: ignore[attr-defined]
    assert root.get(OTHER) is None
    assert methods(s3)[3:] == [f"GET {OTHER}", f"GET {SENTINEL}"]


@pytest.mark.parametrize("fault", [500, 503, 403, "hang", "short", "drop", "no-bucket"])
def test_a_store_that_fails_is_away_and_is_let_alone_for_a_while(s3: S3Server, fault: Fault) -> None:
    clock = Clock()
    root = bucket(s3, clock)
    clock.now += BELIEVED
    s3.fault = lambda call: fault
    for _ in range(5):
        with pytest.raises(StoreAwayError) as told:
            root.get(OTHER)
        assert str(told.value).endswith(".") and "\n" not in str(told.value)
        assert not {ACCESS_KEY, SECRET_KEY} & set(str(told.value).replace("=", " ").split())
    assert methods(s3) == [f"GET {OTHER}", f"GET {SENTINEL}"]
    s3.fault = lambda call: None
    clock.now += BELIEVED
    assert root.get(KEY) == Found(b"light")


def test_a_bucket_that_is_gone_is_not_taken_for_empty(s3: S3Server) -> None:
    clock = Clock()
    root = bucket(s3, clock)
    s3.fault = lambda call: "no-bucket"
    clock.now += BELIEVED
    with pytest.raises(StoreAwayError, match="is gone"):
        root.get(KEY)
    with pytest.raises(StoreAwayError, match="Cannot make a place for light"):
        Root(Place(s3.url, **IMPATIENT)).open()


def test_one_object_that_fails_is_no_dead_store(s3: S3Server) -> None:
    root = bucket(s3)
    s3.fault = lambda call: 500 if call.key.endswith(KEY) else None
    for use in (lambda: root.get(KEY), lambda: root.put(KEY, b"more", Found(b"light", '"tag"'))):
        with pytest.raises(StoreError, match="500") as told:
            use()
        assert not isinstance(told.value, StoreAwayError)
    assert root.get(OTHER) is None


def test_a_call_is_tried_again_so_often_and_no_more(s3: S3Server) -> None:
    root = bucket(s3, retries=2)
    faults = iter([500, "drop"])
    s3.fault = lambda call: next(faults, None)
    assert root.get(KEY) == Found(b"light")
    assert methods(s3) == [f"GET {KEY}"] * 3
    s3.fault = lambda call: 500
    with pytest.raises(StoreAwayError):
        root.get(KEY)
    assert methods(s3)[3:] == [f"GET {KEY}"] * 3 + [f"GET {SENTINEL}"] * 3


def test_who_has_the_wrong_key_is_told_and_not_let_in(s3: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIASOMEBODYELSE")
    with pytest.raises(StoreAwayError, match="403 Forbidden") as told:
        Root(Place(s3.url, **IMPATIENT)).open()
    assert "SOMEBODYELSE" not in str(told.value) and not s3.objects


def test_a_store_that_may_only_be_read_is_read(s3: S3Server) -> None:
    bucket(s3)
    s3.fault = lambda call: 403 if call.method == "PUT" else None
    root = Root(Place(s3.url, **IMPATIENT))
    root.open()
    with pytest.raises(StoreReadOnlyError):
        root.prove()
    assert root.read_only and root.get(KEY) == Found(b"light") and root.get(OTHER) is None
    with pytest.raises(StoreReadOnlyError, match="can only be read"):
        root.put(OTHER, b"", None)
    s3.fault = lambda call: None
    root.prove()
    assert not root.read_only
    root.put(OTHER, b"", None)


def test_a_store_without_room_is_full_and_is_read(s3: S3Server) -> None:
    root = bucket(s3)
    s3.fault = lambda call: 507 if call.method == "PUT" else None
    for use in (lambda: root.put(OTHER, b"light", None), root.prove):
        with pytest.raises(StoreFullError, match="the store is full"):
            use()
    assert not root.read_only and root.get(KEY) == Found(b"light")


@pytest.mark.parametrize("told", [True, False])
def test_a_store_without_conditional_writes_is_written_all_the_same(
    s3: S3Server, monkeypatch: pytest.MonkeyPatch, told: bool
) -> None:
    if told:
        monkeypatch.setenv("AWS_CONDITIONAL_PUT", "disabled")
    s3.fault = lambda call: 501 if call.method == "PUT" and call.condition else None
    root = bucket(s3)
    root.put(KEY, b"more", Found(b"light", '"what was there long ago"'))
    assert root.get(KEY) == Found(b"more")
    root.prove()
    assert any(call.condition for call in s3.calls) is not told


def test_a_store_that_is_read_by_http_is_never_written(tmp_path: Path) -> None:
    Root(tmp_path / "light").put(KEY, b"light", None)
    with served(tmp_path) as address:
        root = Root(f"{address}/light")
        assert root.view(KEY) == b"light" and root.get(OTHER) is None
        with pytest.raises(StoreReadOnlyError):
            root.prove()
        assert root.read_only


class served:
    """A folder behind an HTTP server that knows GET and HEAD; its address."""

    def __init__(self, folder: Path) -> None:
        handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)

    def __enter__(self) -> str:
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()


# --- secrets ------------------------------------------------------------------------------------------------------


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
    with pytest.raises(PlaceError, match="must not hold a password") as told:
        Root(url)
    assert "hunter2" not in str(told.value)


def test_a_root_travels_as_its_place_alone(s3: S3Server) -> None:
    root = bucket(s3)
    sent = pickle.dumps((root, root.place))
    assert not any(secret.encode() in sent for secret in (ACCESS_KEY, SECRET_KEY))
    assert not any(secret in f"{root!r} {root.place!r} {root.place}" for secret in (ACCESS_KEY, SECRET_KEY))
    there, place = pickle.loads(sent)
    assert place == root.place and there.get(KEY) == Found(b"light")


def test_a_missing_library_is_told_with_what_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(StoreError, match=r"pip install 'isogi\[s3\]'"):
        Root("s3://bucket/light").open()


# --- copies -------------------------------------------------------------------------------------------------------


@pytest.fixture
def copied(s3: S3Server, tmp_path: Path) -> Iterator[Root]:
    """A store with copies in a folder of this machine."""
    bucket(s3)
    yield Root(Place(s3.url, **IMPATIENT), copies=Copies(s3.url, 1 << 20, tmp_path / "copies"))


def test_what_is_read_again_does_not_travel_again(s3: S3Server, copied: Root, tmp_path: Path) -> None:
    again = Root(copied.place, copies=Copies(s3.url, 1 << 20, tmp_path / "copies"))
    assert copied.view(KEY) == b"light"
    sent = s3.sent
    assert [root.view(KEY) for root in (copied, copied)] == [b"light"] * 2
    assert s3.sent == sent, "told that it still stands"
    assert again.view(KEY) == b"light"
    assert s3.sent == sent + len(CONTENT), "another process asks for the sentinel"


def test_what_another_machine_has_improved_is_seen_at_once(s3: S3Server, copied: Root) -> None:
    assert copied.view(KEY) == b"light"
    other = Root(copied.place)
    other.put(KEY, b"better light", other.get(KEY))
    assert copied.view(KEY) == b"better light" == copied.view(KEY)
    other.delete(KEY)
    assert copied.view(KEY) is None


def test_who_writes_reads_no_copy(s3: S3Server, copied: Root) -> None:
    copied.view(KEY)
    s3.calls.clear()
    assert copied.get(KEY) == Found(b"light")
    assert [call.condition for call in s3.calls] == [""]


def test_a_damaged_copy_is_none(copied: Root, tmp_path: Path) -> None:
    copied.view(KEY)
    (path,) = (tmp_path / "copies").iterdir()
    kept = path.read_bytes()
    for place in range(len(kept)):
        path.write_bytes(kept[:place] + bytes([kept[place] ^ 1]) + kept[place + 1 :])
        assert copied.view(KEY) == b"light"
        assert path.read_bytes() == kept


def test_copies_take_no_more_room_than_they_may(tmp_path: Path) -> None:
    copies = Copies("s3://bucket", 10_000, tmp_path)
    for number in range(100):
        copies.put(str(number), Found(bytes(900), '"tag"'))
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 11_000
    assert copies.get("99") == Found(bytes(900)) and copies.get("0") is None


def test_copies_that_cannot_be_kept_are_none(tmp_path: Path, s3: S3Server) -> None:
    (tmp_path / "file").write_text("")
    bucket(s3)
    root = Root(s3.url, copies=Copies(s3.url, 1 << 20, tmp_path / "file"))
    assert root.view(KEY) == b"light" == root.view(KEY)
