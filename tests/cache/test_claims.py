"""Claims: who is met stays away, who is alone pays nothing, and nothing that goes wrong with them stops a bake."""

import errno
from pathlib import Path

import pytest

from isogi_core.cache.claims import COMPANY, Claims
from isogi_core.cache.folder import Folder
from isogi_core.cache.root import Root
from isogi_core.cache.shelf import Found
from tests.worker.clock import Clock

NAME = "0123456789abcdef0123.1.2.3"


@pytest.fixture
def root(tmp_path: Path) -> Root:
    root = Root(tmp_path)
    root.open()
    return root


def someone(root: Root, clock: Clock | None = None) -> Claims:
    """Claims of a process that has met another."""
    claims = Claims(root, clock or Clock())
    claims.meet()
    return claims


def left(root: Root) -> list[str]:
    """The keys of all claims in the store."""
    return [found.key for found in root.entries() if found.key.startswith("claims/")]


def test_a_claim_stands_while_the_work_lasts_and_no_longer(root: Root) -> None:
    one, other = someone(root), someone(root)
    with one.on(NAME, "one") as ours:
        assert ours and left(root) == [f"claims/{NAME}"]
        with other.on(NAME, "other") as theirs:
            assert not theirs
        assert left(root) == [f"claims/{NAME}"]
        with other.on("another", "other") as theirs:
            assert theirs
    assert not left(root)
    with other.on(NAME, "other") as theirs:
        assert theirs


def test_a_claim_ends_with_work_that_fails(root: Root) -> None:
    with pytest.raises(ZeroDivisionError), someone(root).on(NAME, "one"):
        raise ZeroDivisionError
    assert not left(root)


def test_who_has_met_nobody_for_a_while_neither_looks_nor_claims(root: Root, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    lonely, met = Claims(root, clock), someone(root, clock)
    clock.now += COMPANY + 1.0
    for asked in ("get", "put", "delete"):
        monkeypatch.setattr(Folder, asked, lambda *_: pytest.fail("the store was asked"))
    for claims in (lonely, met):
        with claims.on(NAME, "one") as ours:
            assert ours


def test_a_claim_that_stands_is_company(root: Root) -> None:
    clock = Clock()
    one, other = someone(root, clock), someone(root, clock)
    clock.now += COMPANY - 1.0
    with one.on(NAME, "one"), other.on(NAME, "other") as theirs:
        assert not theirs
    clock.now += COMPANY - 1.0
    with other.on(NAME, "other"):
        assert left(root)
    with one.on(NAME, "one"):
        assert not left(root)


def test_the_claim_of_who_was_killed_counts_until_somebody_insists(root: Root) -> None:
    killed = someone(root).on(NAME, "killed")
    killed.__enter__()
    other = someone(root)
    for insist in (False, True):
        with other.on(NAME, "other", insist) as theirs:
            assert theirs is insist
    assert not left(root)


def test_an_owner_takes_its_own_claim_over(root: Root) -> None:
    """The worker that had it died, and another of the same baker goes on at once."""
    dead = someone(root).on(NAME, "one")
    dead.__enter__()
    with someone(root).on(NAME, "one") as ours:
        assert ours
    assert not left(root)


def test_who_has_no_name_claims_nothing(root: Root) -> None:
    with someone(root).on(NAME, "") as ours:
        assert ours and not left(root)


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_where_no_claim_can_be_made_the_work_goes_on(root: Root, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, "so it is")

    claims = someone(root)
    for asked in ("put", "delete"):
        monkeypatch.setattr(Folder, asked, fail)
    with claims.on(NAME, "one") as ours:
        assert ours


def test_of_two_that_insist_one_has_it(root: Root, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody takes a claim over between another's look at it and that other's write."""
    killed = someone(root).on(NAME, "killed")
    killed.__enter__()

    def late(key: str) -> Found | None:
        found = Root.get(root, key)
        root.put(key, b"third", found)
        return found

    monkeypatch.setattr(root, "get", late)
    with someone(root).on(NAME, "other", insist=True) as theirs:
        assert not theirs


def test_a_claim_that_ends_at_this_moment_is_free(root: Root, monkeypatch: pytest.MonkeyPatch) -> None:
    killed = someone(root).on(NAME, "killed")
    killed.__enter__()
    monkeypatch.setattr(root, "get", root.delete)
    with someone(root).on(NAME, "other") as theirs:
        assert theirs
