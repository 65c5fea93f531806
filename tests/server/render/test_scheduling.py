"""Scheduling: what work goes first, and what is done once; and the update bus."""

import asyncio
import gc
import threading
import weakref
from collections.abc import Iterator
from contextlib import suppress

import pytest

from isogi_core.prepared.prepared_scene import Index
from server.errors import BusyError
from server.logs import REQUEST_ID
from server.render.bakes import UpdateBus
from server.render.scheduling import (
    DRAFT,
    REFINEMENT_PATIENCE,
    REQUEST_PATIENCE,
    REST_PATIENCE,
    Client,
    FairSemaphore,
    Rank,
    Renders,
)
from tests.server.loops import played


@pytest.fixture
def renders() -> Iterator[Renders]:
    renders = Renders(1)
    yield renders
    renders.close()


def test_work_comes_in_the_order_of_its_deadlines(renders: Renders) -> None:
    order: list[float] = []

    async def play() -> None:
        release = threading.Event()
        first = asyncio.create_task(renders.run(lambda: release.wait(10), Rank.within(REQUEST_PATIENCE)))
        await asyncio.sleep(0.01)
        later = [
            asyncio.create_task(renders.run(lambda patience=patience: order.append(patience), Rank.within(patience)))
            for patience in (REFINEMENT_PATIENCE, REQUEST_PATIENCE, REST_PATIENCE, DRAFT)
        ]
        await asyncio.sleep(0.01)
        release.set()
        await asyncio.gather(first, *later)

    asyncio.run(play())
    assert order == [DRAFT, REST_PATIENCE, REQUEST_PATIENCE, REFINEMENT_PATIENCE]


def test_one_place_alone_is_given_while_others_are_pressed() -> None:
    pressed, working, most = [True], [0], [0]

    async def take(places: FairSemaphore) -> None:
        async with places.place(Rank.within(0.0)):
            working[0] += 1
            most[0] = max(most[0], working[0])
            await asyncio.sleep(0.01)
            working[0] -= 1

    async def play() -> int:
        places = FairSemaphore(3, lambda: pressed[0])
        await asyncio.gather(*(take(places) for _ in range(4)))
        alone, pressed[0] = most[0], False
        await asyncio.gather(*(take(places) for _ in range(4)))
        return alone

    assert (played(play()), most[0]) == (1, 3)


@pytest.mark.parametrize(("even", "slow"), [(True, 10), (False, 5)])
def test_even_turns_count_alike_and_others_by_time(even: bool, slow: int) -> None:
    """Of 20 turns; one client's take three times as long."""
    turns: list[str] = []

    async def draw(places: FairSemaphore, name: str, seconds: float, client: Client) -> None:
        while len(turns) < 20:
            async with places.place(Rank.within(0.0, client=client)):
                turns.append(name)
                await asyncio.sleep(seconds)

    async def play() -> None:
        places = FairSemaphore(1, even=even)
        kinds = [("quick", 0.02, Client()), ("slow", 0.06, Client())]
        await asyncio.gather(*(draw(places, *kind) for kind in kinds for _ in range(2)))

    played(play())
    assert abs(turns[:20].count("slow") - slow) <= 2


def test_patient_work_does_not_wait_forever() -> None:
    order: list[str] = []

    async def take(places: FairSemaphore, name: str, patience: float) -> None:
        async with places.place(Rank.within(patience)):
            order.append(name)
            await asyncio.sleep(0.02)

    async def play() -> None:
        places = FairSemaphore(1)
        tasks = [asyncio.create_task(take(places, "first", 0.0)), asyncio.create_task(take(places, "patient", 0.1))]
        for number in range(12):
            tasks.append(asyncio.create_task(take(places, f"draft {number}", 0.0)))
            await asyncio.sleep(0.015)
        await asyncio.gather(*tasks)

    played(play())
    assert 2 <= order.index("patient") < len(order) - 1


def test_work_that_waits_too_long_is_refused_and_blocks_no_other() -> None:
    async def play() -> None:
        places = FairSemaphore(1)
        async with places.place(Rank(0.0)):
            with pytest.raises(BusyError, match="ask again"):
                async with places.place(Rank.within(0.0, longest=0.01)):
                    pass
        async with asyncio.timeout(10), places.place(Rank.within(0.0, longest=0.0)):
            pass

    asyncio.run(play())


def test_what_was_begun_is_ended_before_a_later_request_begins() -> None:
    order: list[str] = []

    async def request(places: FairSemaphore, name: str, rank: Rank) -> None:
        for part in range(3):
            async with places.place(rank):
                order.append(f"{name}{part}")
                await asyncio.sleep(0.0)

    async def play() -> None:
        places = FairSemaphore(1)
        await asyncio.gather(*(request(places, name, Rank(due)) for due, name in enumerate("abc")))

    asyncio.run(play())
    assert order.index("a2") < order.index("c0")
    assert order.index("b2") < order.index("c1")


def test_a_turn_that_is_not_waited_for_any_more_goes_to_the_next() -> None:
    async def play() -> None:
        places = FairSemaphore(1)
        async with places.place(Rank(0.0)):
            leaving = asyncio.create_task(places.place(Rank(0.0)).__aenter__())
            await asyncio.sleep(0)
            leaving.cancel()
            await asyncio.gather(leaving, return_exceptions=True)
        for _ in range(3):
            async with asyncio.timeout(1), places.place(Rank(0.0)):
                pass

    asyncio.run(play())


def test_abandoned_work_is_cancelled_and_the_next_begins_anew(renders: Renders) -> None:
    told = threading.Event()

    def work(cancelled: threading.Event) -> str:
        if cancelled.wait(10):
            told.set()
        return "old"

    async def play() -> str:
        tasks = [asyncio.create_task(renders.share("key", work, Rank(0.0))) for _ in range(2)]
        await asyncio.sleep(0.05)
        tasks[0].cancel()
        await asyncio.sleep(0.05)
        assert not told.is_set()
        tasks[1].cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return await renders.share("key", lambda _: "new", Rank(0.0))

    assert asyncio.run(play()) == "new"
    assert told.is_set()


def test_shared_work_logs_the_id_of_the_first_request(renders: Renders) -> None:
    async def ask(number: str) -> list[str]:
        REQUEST_ID.set(number)
        return [
            await renders.run(REQUEST_ID.get, Rank(0.0)),
            await renders.share("key", lambda _: REQUEST_ID.get(), Rank(0.0)),
        ]

    async def play() -> list[list[str]]:
        return list(await asyncio.gather(ask("one"), ask("two")))

    (one, first), (two, shared) = asyncio.run(play())
    assert (one, two) == ("one", "two")
    assert first == shared == "one"


def test_errors_reach_all_that_share(renders: Renders) -> None:
    def fail(_: threading.Event) -> None:
        raise BusyError("full")

    async def play() -> list[BaseException | None]:
        return list(
            await asyncio.gather(*(renders.share("key", fail, Rank(0.0)) for _ in range(3)), return_exceptions=True)
        )

    assert [str(error) for error in asyncio.run(play())] == ["full"] * 3


class Array:
    """Stands for an array that work is about."""


def test_work_that_fails_is_freed_at_once(renders: Renders) -> None:
    left: list[weakref.ref[Array]] = []

    def fail(_: threading.Event) -> None:
        array = Array()
        left.append(weakref.ref(array))
        raise ValueError(f"{array}")

    async def play() -> None:
        with suppress(ValueError):
            await renders.share("picture", fail, Rank.within(REQUEST_PATIENCE))
        await renders.run(lambda: None, Rank.within(REQUEST_PATIENCE))
        await asyncio.sleep(0.0)
        assert left[0]() is None

    gc.disable()
    try:
        asyncio.run(play())
    finally:
        gc.enable()


A, B, C = (0, 0, 1), (0, 0, 2), (0, 0, 3)


async def publish(updates: UpdateBus, *given: tuple[str, Index, bool]) -> None:
    """The workers' thread tells these."""
    await asyncio.to_thread(lambda: [updates.publish(*each) for each in given])
    await asyncio.sleep(0)


def test_updates_reach_those_that_wait_for_the_chunk() -> None:
    async def play() -> None:
        updates = UpdateBus()
        with updates.pending("gi", {A, B}, 0) as mine, updates.pending("near", {A}, 0) as other:
            await publish(updates, ("gi", C, False))
            assert not mine.some.is_set()
            await publish(updates, ("gi", A, True))
            assert mine.some.is_set() and not mine.all.is_set()
            await publish(updates, ("gi", A, False), ("gi", B, False))
            assert mine.all.is_set()
            assert not other.some.is_set()

    asyncio.run(play())


def test_dark_chunks_are_lit_with_an_update_of_each() -> None:
    async def play() -> None:
        updates = UpdateBus()
        with updates.pending("gi", {A, B, C}, 0, {A, B}) as some, updates.pending("gi", {A, C}, 0) as none:
            await publish(updates, ("gi", C, True), ("gi", A, True))
            assert not some.lit.is_set()
            await publish(updates, ("gi", B, True))
            assert some.lit.is_set() and not some.all.is_set()
            assert not none.lit.is_set(), "without dark ones, all are waited for"
            await publish(updates, ("gi", A, False), ("gi", C, False))
            assert none.lit.is_set() and none.all.is_set()

    asyncio.run(play())


def test_updates_before_the_wait_count_from_its_number_on() -> None:
    async def play() -> None:
        updates = UpdateBus()
        await publish(updates, ("gi", A, False))
        seen = updates.newest("gi")
        await publish(updates, ("gi", B, False))
        assert (seen, updates.newest("gi"), updates.newest("near")) == (1, 2, 0)
        with updates.pending("gi", {A, B}, seen) as waiting:
            assert waiting.some.is_set() and waiting.chunks == {A}
        with updates.pending("gi", {A}, seen) as waiting:
            assert not waiting.some.is_set()

    asyncio.run(play())


def test_a_client_that_comes_anew_is_not_behind_all_that_waits() -> None:
    """Requests of one address have waited for long; the draft of a stream that comes now has its turn between them."""
    order: list[str] = []

    async def take(places: FairSemaphore, name: str, rank: Rank) -> None:
        async with places.place(rank):
            order.append(name)
            await asyncio.sleep(0.1)

    async def play() -> None:
        places, crowd = FairSemaphore(1), Client()
        tasks = [asyncio.create_task(take(places, "request", Rank(0.0, client=crowd))) for _ in range(40)]
        await asyncio.sleep(1.0)
        stream = Client()
        for _ in range(5):
            await take(places, "draft", Rank.within(0.0, client=stream))
        assert order.count("request") <= 10 + 5 + 2
        await asyncio.gather(*tasks)

    played(play())
    assert order.count("request") == 40


def test_a_view_that_is_replaced_keeps_its_place_in_line() -> None:
    order: list[str] = []

    async def take(places: FairSemaphore, name: str, client: Client) -> None:
        async with places.place(Rank(0.0, client=client)):
            order.append(name)
            await asyncio.sleep(0.1)

    async def play() -> None:
        places, first, second, third = FairSemaphore(1), Client(), Client(), Client()
        working = asyncio.create_task(take(places, "first", first))
        await asyncio.sleep(0.01)
        older = asyncio.create_task(take(places, "older", second))
        await asyncio.sleep(0.01)
        older.cancel()
        again = [asyncio.create_task(take(places, "first", first)) for _ in range(3)]
        later = asyncio.create_task(take(places, "third", third))
        await asyncio.sleep(0.15)
        newer = asyncio.create_task(take(places, "newer", second))
        await asyncio.gather(working, later, newer, *again)

    played(play())
    assert order.index("newer") <= 2 and "older" not in order


def test_who_took_much_is_not_behind_for_long() -> None:
    order: list[str] = []

    async def take(places: FairSemaphore, name: str, client: Client, seconds: float) -> None:
        async with places.place(Rank(0.0, client=client)):
            order.append(name)
            await asyncio.sleep(seconds)

    async def play() -> None:
        places, greedy, other = FairSemaphore(1), Client(), Client()
        await take(places, "long", greedy, 100.0)
        tasks = [asyncio.create_task(take(places, "other", other, 0.1)) for _ in range(60)]
        tasks.append(asyncio.create_task(take(places, "greedy", greedy, 0.1)))
        await asyncio.gather(*tasks)

    played(play())
    assert 2 <= order.index("greedy") <= 30
