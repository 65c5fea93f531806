"""Admission: who is let in, and whose place goes to a newcomer."""

import asyncio
from collections.abc import Hashable
from contextlib import suppress

import pytest

from isogi_server.errors import BusyError
from isogi_server.render.scheduling import AdmissionLimit, Place
from tests.server.loops import IN_NO_TIME


async def lost_of(*owners: Hashable, most: int, work: bool = False) -> list[int]:
    """The numbers of the places that were lost when these owners came, one a second."""
    limit = AdmissionLimit(most, "guests are in", work)
    places = list[Place]()
    for owner in owners:
        await asyncio.sleep(1)
        with suppress(BusyError):
            places.append(limit.enter(owner))
        assert limit.open <= most
    return [number for number, place in enumerate(places) if place.lost]


@IN_NO_TIME
async def test_no_more_are_let_in_than_may_be() -> None:
    limit = AdmissionLimit(1, "guests are in")
    with limit.admitted("a"):
        with (
            pytest.raises(BusyError, match=r"^1 guests are in already: ask again in a second\.$"),
            limit.admitted("b"),
        ):
            pass
        assert limit.open == 1
    assert limit.open == 0


@IN_NO_TIME
@pytest.mark.parametrize(
    ("owners", "work", "lost"),
    [
        ("aaaa", False, []),
        ("aaaaa", False, []),
        ("aaaab", False, [0]),
        ("aaaabb", False, [0, 1]),
        ("aaaabbb", False, [0, 1]),
        ("aaaabcd", False, [0, 1, 2]),
        ("aaaabcde", False, [0, 1, 2]),
        ("baaac", False, [1]),
        ("aaaab", True, [3]),
        ("aaaabb", True, [2, 3]),
    ],
)
async def test_a_newcomer_takes_a_place_of_who_has_most(
    owners: str, work: bool, lost: list[int]
) -> None:
    assert await lost_of(*owners, most=4, work=work) == lost


@IN_NO_TIME
async def test_the_place_that_goes_is_the_idlest() -> None:
    limit = AdmissionLimit(3, "guests are in")
    places = [limit.enter("a") for _ in range(3)]
    for place in (places[2], places[0]):
        await asyncio.sleep(1)
        place.use()
    limit.enter("b")
    assert [place.lost for place in places] == [False, True, False]


@IN_NO_TIME
async def test_63_others_have_a_place_beside_a_greedy_client() -> None:
    limit = AdmissionLimit(64, "guests are in")
    for _ in range(64):
        limit.enter("greedy")
    for other in range(63):
        limit.enter(other)
        with suppress(BusyError):
            limit.enter("greedy")
    assert limit.open == 64


ENDED: list[str] = []


async def three_seconds() -> str:
    try:
        await asyncio.sleep(3)
    finally:
        ENDED.append("work")
    return "done"


@IN_NO_TIME
@pytest.mark.parametrize(
    ("lost", "said", "seconds"), [(5, "done", 3), (1, "Another client needed", 1)]
)
async def test_work_ends_when_its_place_is_lost(lost: float, said: str, seconds: float) -> None:
    ENDED.clear()
    loop = asyncio.get_running_loop()
    limit = AdmissionLimit(2, "guests are in", work=True)
    _ = limit.enter("a")
    place = limit.enter("a")
    begun = loop.time()
    loop.call_later(lost, limit.enter, "b")
    try:
        came = await place.keep(three_seconds())
    except BusyError as error:
        came = str(error)
    assert (came[: len(said)], round(loop.time() - begun, 6), ENDED) == (said, seconds, ["work"])


@IN_NO_TIME
async def test_work_that_is_cancelled_besides_stays_cancelled() -> None:
    place = AdmissionLimit(1, "guests are in").enter("a")
    task = asyncio.create_task(place.keep(three_seconds()))
    await asyncio.sleep(1)
    place.lose(1)
    task.cancel()
    await asyncio.wait({task})
    assert task.cancelled()


@IN_NO_TIME
async def test_work_without_a_place_does_not_begin() -> None:
    ENDED.clear()
    place = AdmissionLimit(1, "guests are in").enter("a")
    place.lose(0)
    with pytest.raises(BusyError):
        await place.keep(three_seconds())
    assert not ENDED
