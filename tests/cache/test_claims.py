"""Claims: who is met stays away, who is alone pays nothing, and nothing that goes wrong with them stops a bake."""

import errno
from pathlib import Path

import pytest

from isogi_core.cache.inventory import CONTENDED_SECONDS, Claims
from isogi_core.storage.backend import StoredObject
from isogi_core.storage.folder import Folder
from isogi_core.storage.store import Store
from tests.worker.clock import Clock

NAME = "0123456789abcdef0123.1.2.3"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path)
    store.open()
    return store


def someone(store: Store, clock: Clock | None = None) -> Claims:
    """Claims of a process that has met another."""
    claims = Claims(store, clock or Clock())
    claims.note_contention()
    return claims


def left(store: Store) -> list[str]:
    """The keys of all claims in the store."""
    return [found.key for found in store.entries() if found.key.startswith("claims/")]


def test_a_claim_stands_while_the_work_lasts_and_no_longer(store: Store) -> None:
    one, other = someone(store), someone(store)
    with one.on(NAME, "one") as ours:
        assert ours and left(store) == [f"claims/{NAME}"]
        with other.on(NAME, "other") as theirs:
            assert not theirs
        assert left(store) == [f"claims/{NAME}"]
        with other.on("another", "other") as theirs:
            assert theirs
    assert not left(store)
    with other.on(NAME, "other") as theirs:
        assert theirs


def test_a_claim_ends_with_work_that_fails(store: Store) -> None:
    with pytest.raises(ZeroDivisionError), someone(store).on(NAME, "one"):
        raise ZeroDivisionError
    assert not left(store)


def test_claims_end_a_while_after_the_last_contention(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    lonely, met = Claims(store, clock), someone(store, clock)
    clock.now += CONTENDED_SECONDS + 1.0
    for asked in ("get", "put", "delete"):
        monkeypatch.setattr(Folder, asked, lambda *_: pytest.fail("the store was asked"))
    for claims in (lonely, met):
        with claims.on(NAME, "one") as ours:
            assert ours


def test_a_claim_that_stands_is_company(store: Store) -> None:
    clock = Clock()
    one, other = someone(store, clock), someone(store, clock)
    clock.now += CONTENDED_SECONDS - 1.0
    with one.on(NAME, "one"), other.on(NAME, "other") as theirs:
        assert not theirs
    clock.now += CONTENDED_SECONDS - 1.0
    with other.on(NAME, "other"):
        assert left(store)
    with one.on(NAME, "one"):
        assert not left(store)


def test_a_killed_bakers_claim_counts_until_another_insists(store: Store) -> None:
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()
    other = someone(store)
    for insist in (False, True):
        with other.on(NAME, "other", insist) as theirs:
            assert theirs is insist
    assert not left(store)


def test_an_owner_takes_its_own_claim_over(store: Store) -> None:
    """The worker that had it died, and another of the same baker goes on at once."""
    dead = someone(store).on(NAME, "one")
    dead.__enter__()
    with someone(store).on(NAME, "one") as ours:
        assert ours
    assert not left(store)


def test_an_empty_owner_claims_nothing(store: Store) -> None:
    with someone(store).on(NAME, "") as ours:
        assert ours and not left(store)


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_where_no_claim_can_be_made_the_work_goes_on(
    store: Store, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, "so it is")

    claims = someone(store)
    for asked in ("put", "delete"):
        monkeypatch.setattr(Folder, asked, fail)
    with claims.on(NAME, "one") as ours:
        assert ours


def test_of_two_that_insist_one_has_it(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody takes a claim over between another's look at it and that other's write."""
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()

    def late(key: str) -> StoredObject | None:
        found = Store.get(store, key)
        store.put(key, b"third", found)
        return found

    monkeypatch.setattr(store, "get", late)
    with someone(store).on(NAME, "other", insist=True) as theirs:
        assert not theirs


def test_a_claim_that_ends_at_this_moment_is_free(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()
    monkeypatch.setattr(store, "get", store.delete)
    with someone(store).on(NAME, "other") as theirs:
        assert theirs
