"""Scheduling: what work goes first, and what is done once; and the update bus."""

import asyncio
import gc
import threading
import time
import weakref
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress

import pytest

from isogi_core.errors import Cancelled
from isogi_core.frame.tiles import Interruption
from isogi_core.prepared.prepared_scene import Index
from isogi_server.errors import BusyError
from isogi_server.logs import REQUEST_ID
from isogi_server.render import update_bus
from isogi_server.render.scheduling import (
    Client,
    FairSemaphore,
    LongRenders,
    Rank,
    Renders,
)
from isogi_server.render.update_bus import UpdateBus
from tests.server.loops import IN_NO_TIME


@pytest.fixture
def renders() -> Iterator[Renders]:
    renders = Renders(1)
    yield renders
    renders.close()


async def test_work_comes_in_the_order_of_its_deadlines(renders: Renders) -> None:
    order: list[float] = []
    release = threading.Event()
    first = asyncio.create_task(renders.run(lambda: release.wait(10), Rank.within(0.4)))
    await asyncio.sleep(0.01)
    later = [
        asyncio.create_task(
            renders.run(lambda patience=patience: order.append(patience), Rank.within(patience))
        )
        for patience in (0.8, 0.4, 0.1, 0.0)
    ]
    await asyncio.sleep(0.01)
    release.set()
    await asyncio.gather(first, *later)
    assert order == [0.0, 0.1, 0.4, 0.8]


class Turns:
    """Places, and who had one, in order."""

    def __init__(self, **options: bool) -> None:
        self.places = FairSemaphore(1, **options)
        self.order = list[str]()

    async def take(self, name: str, rank: Rank, seconds: float = 0.1) -> None:
        async with self.places.place(rank):
            self.order.append(name)
            await asyncio.sleep(seconds)

    def begin(self, name: str, rank: Rank, seconds: float = 0.1) -> asyncio.Task[None]:
        return asyncio.create_task(self.take(name, rank, seconds))


@pytest.fixture
def turns() -> Turns:
    return Turns()


@IN_NO_TIME
async def test_one_place_alone_is_given_while_others_are_pressed() -> None:
    pressed = [True]
    working = [0]
    most = [0]

    async def take() -> None:
        async with places.place(Rank.within(0.0)):
            working[0] += 1
            most[0] = max(most[0], working[0])
            await asyncio.sleep(0.01)
            working[0] -= 1

    places = FairSemaphore(3, lambda: pressed[0])
    await asyncio.gather(*(take() for _ in range(4)))
    alone = most[0]
    pressed[0] = False
    await asyncio.gather(*(take() for _ in range(4)))
    assert (alone, most[0]) == (1, 3)


@IN_NO_TIME
@pytest.mark.parametrize(("even", "slow"), [(True, 10), (False, 5)])
async def test_even_turns_count_alike_and_others_by_time(even: bool, slow: int) -> None:
    """Of 20 turns; one client's take three times as long."""
    turns = Turns(even=even)

    async def draw(name: str, seconds: float, client: Client) -> None:
        while len(turns.order) < 20:
            await turns.take(name, Rank.within(0.0, client=client), seconds)

    kinds = [("quick", 0.02, Client()), ("slow", 0.06, Client())]
    await asyncio.gather(*(draw(*kind) for kind in kinds for _ in range(2)))
    assert abs(turns.order[:20].count("slow") - slow) <= 2


@IN_NO_TIME
async def test_patient_work_does_not_wait_forever(turns: Turns) -> None:
    tasks = [
        turns.begin(name, Rank.within(patience), 0.02)
        for name, patience in (("first", 0.0), ("patient", 0.1))
    ]
    for _ in range(12):
        tasks.append(turns.begin("draft", Rank.within(0.0), 0.02))
        await asyncio.sleep(0.015)
    await asyncio.gather(*tasks)
    assert 2 <= turns.order.index("patient") < len(turns.order) - 1


async def test_work_that_waits_too_long_is_refused_and_blocks_no_other() -> None:
    places = FairSemaphore(1)
    async with places.place(Rank(0.0)):
        with pytest.raises(BusyError, match="ask again"):
            async with places.place(Rank.within(0.0, longest=0.01)):
                pass
    async with asyncio.timeout(10), places.place(Rank.within(0.0, longest=0.0)):
        pass


async def test_what_was_begun_is_ended_before_a_later_request_begins(turns: Turns) -> None:
    async def request(name: str, rank: Rank) -> None:
        for part in range(3):
            await turns.take(f"{name}{part}", rank, 0.0)

    await asyncio.gather(*(request(name, Rank(due)) for due, name in enumerate("abc")))
    assert turns.order.index("a2") < turns.order.index("c0")
    assert turns.order.index("b2") < turns.order.index("c1")


async def test_a_turn_that_is_not_waited_for_any_more_goes_to_the_next() -> None:
    places = FairSemaphore(1)
    async with places.place(Rank(0.0)):
        leaving = asyncio.create_task(places.place(Rank(0.0)).__aenter__())
        await asyncio.sleep(0)
        leaving.cancel()
        await asyncio.gather(leaving, return_exceptions=True)
    for _ in range(3):
        async with asyncio.timeout(1), places.place(Rank(0.0)):
            pass


async def test_abandoned_work_is_cancelled_and_the_next_begins_anew(renders: Renders) -> None:
    told = threading.Event()

    def work(cancelled: threading.Event) -> str:
        if cancelled.wait(10):
            told.set()
        return "old"

    tasks = [asyncio.create_task(renders.share("key", work, Rank(0.0))) for _ in range(2)]
    await asyncio.sleep(0.05)
    tasks[0].cancel()
    await asyncio.sleep(0.05)
    assert not told.is_set()
    tasks[1].cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    assert await renders.share("key", lambda _: "new", Rank(0.0)) == "new"
    assert told.is_set()


async def test_shared_work_logs_the_id_of_the_first_request(renders: Renders) -> None:
    async def ask(number: str) -> list[str]:
        REQUEST_ID.set(number)
        own = await renders.run(REQUEST_ID.get, Rank(0.0))
        return [own, await renders.share("key", lambda _: REQUEST_ID.get(), Rank(0.0))]

    (one, first), (two, shared) = await asyncio.gather(ask("one"), ask("two"))
    assert (one, two) == ("one", "two")
    assert first == shared == "one"


async def test_errors_reach_all_that_share(renders: Renders) -> None:
    def fail(_: threading.Event) -> None:
        raise BusyError("full")

    shares = (renders.share("key", fail, Rank(0.0)) for _ in range(3))
    assert [str(error) for error in await asyncio.gather(*shares, return_exceptions=True)] == [
        "full"
    ] * 3


class Array:
    """Stands for an array that work is about."""


async def test_work_that_fails_is_freed_at_once(renders: Renders) -> None:
    left: list[weakref.ref[Array]] = []

    def fail(_: threading.Event) -> None:
        array = Array()
        left.append(weakref.ref(array))
        raise ValueError(f"{array}")

    gc.disable()
    try:
        with suppress(ValueError):
            await renders.share("picture", fail, Rank.within(0.4))
        await renders.run(lambda: None, Rank.within(0.4))
        await asyncio.sleep(0.0)
        assert left[0]() is None
    finally:
        gc.enable()


class LongWork:
    """Work in passes that notes each one in an ``order``, between two of which it gives way."""

    def __init__(self, name: str, order: list[str], passes: int = 3) -> None:
        self.name = name
        self.order = order
        self.passes = passes

    def __call__(self, cancelled: threading.Event) -> str:
        assert isinstance(cancelled, Interruption)
        for number in range(self.passes):
            if number:
                cancelled.give_way()
            if cancelled.is_set():
                self.order.append(f"{self.name} ends")
                raise Cancelled("Nobody waits.")
            self.order.append(f"{self.name}{number}")
            time.sleep(0.02)
        return self.name


@pytest.fixture
async def long_renders() -> AsyncIterator[LongRenders]:
    renders = LongRenders(2)
    yield renders
    renders.close()


async def test_long_works_of_clients_take_turns_by_passes(long_renders: LongRenders) -> None:
    order = list[str]()
    works = [LongWork(name, order) for name in ("a", "b")]
    found = await asyncio.gather(
        *(long_renders.share(each.name, each, Rank(0.0, client=Client())) for each in works)
    )
    assert found == ["a", "b"]
    assert order == ["a0", "b0", "a1", "b1", "a2", "b2"]


async def test_a_client_has_one_long_work_begun_at_a_time(long_renders: LongRenders) -> None:
    order = list[str]()
    greedy, other = Client(), Client()
    asked = [("a", greedy), ("b", greedy), ("c", greedy), ("d", other)]
    await asyncio.gather(
        *(
            long_renders.share(name, LongWork(name, order), Rank(0.0, client=client))
            for name, client in asked
        )
    )
    assert order.index("d0") < order.index("a2") < order.index("b0")
    assert order.index("b2") < order.index("c0")


async def test_long_work_that_nobody_waits_for_ends_between_passes(
    long_renders: LongRenders,
) -> None:
    order = list[str]()
    tasks = {
        name: asyncio.create_task(
            long_renders.share(name, LongWork(name, order, 50), Rank(0.0, client=Client()))
        )
        for name in ("left", "stays")
    }
    while "stays1" not in order:
        await asyncio.sleep(0.005)
    tasks["left"].cancel()
    while "left ends" not in order:
        await asyncio.sleep(0.005)
    assert await tasks["stays"] == "stays"


async def test_long_work_that_cannot_begin_in_time_is_refused(long_renders: LongRenders) -> None:
    order = list[str]()
    greedy = Client()
    first = asyncio.create_task(
        long_renders.share("a", LongWork("a", order, 20), Rank(0.0, client=greedy))
    )
    await asyncio.sleep(0.01)
    with pytest.raises(BusyError, match="Path-traced"):
        await long_renders.share(
            "b", LongWork("b", order), Rank.within(0.0, longest=0.02, client=greedy)
        )
    assert await first == "a"
    assert await long_renders.share("c", LongWork("c", order), Rank(0.0, client=greedy)) == "c"
    assert "b0" not in order


async def test_errors_of_long_work_reach_who_asked(long_renders: LongRenders) -> None:
    def fail(_: threading.Event) -> None:
        raise TimeoutError("late")

    with pytest.raises(TimeoutError, match="late"):
        await long_renders.share("a", fail, Rank(0.0))
    work = LongWork("b", [])
    assert await long_renders.share("b", work, Rank(0.0)) == "b"


A, B, C = (0, 0, 1), (0, 0, 2), (0, 0, 3)


async def publish(updates: UpdateBus, *given: tuple[str, Index, bool]) -> None:
    """The workers' thread tells these."""
    await asyncio.to_thread(lambda: [updates.publish(*each) for each in given])
    await asyncio.sleep(0)


async def test_updates_reach_those_that_wait_for_the_chunk() -> None:
    updates = UpdateBus()
    with updates.pending("gi", {A, B}, 0) as mine, updates.pending("near", {A}, 0) as other:
        await publish(updates, ("gi", C, False))
        assert not mine.some.is_set()
        await publish(updates, ("gi", A, True))
        assert mine.some.is_set() and not mine.all.is_set()
        await publish(updates, ("gi", A, False), ("gi", B, False))
        assert mine.all.is_set()
        assert not other.some.is_set()


async def test_dark_chunks_are_lit_with_an_update_of_each() -> None:
    updates = UpdateBus()
    with (
        updates.pending("gi", {A, B, C}, 0, {A, B}) as some,
        updates.pending("gi", {A, C}, 0) as none,
    ):
        await publish(updates, ("gi", C, True), ("gi", A, True))
        assert not some.lit.is_set()
        await publish(updates, ("gi", B, True))
        assert some.lit.is_set() and not some.all.is_set()
        assert not none.lit.is_set(), "without dark ones, all are waited for"
        await publish(updates, ("gi", A, False), ("gi", C, False))
        assert none.lit.is_set() and none.all.is_set()


async def test_updates_before_the_wait_count_from_its_number_on() -> None:
    updates = UpdateBus()
    await publish(updates, ("gi", A, False))
    seen = updates.newest("gi")
    await publish(updates, ("gi", B, False))
    assert (seen, updates.newest("gi"), updates.newest("near")) == (1, 2, 0)
    with updates.pending("gi", {A, B}, seen) as waiting:
        assert waiting.some.is_set() and waiting.chunks == {A}
    with updates.pending("gi", {A}, seen) as waiting:
        assert not waiting.some.is_set()


async def test_updates_are_remembered_for_some_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(update_bus, "MOST_UPDATES", 2)
    monkeypatch.setattr(update_bus, "MOST_BAKES", 1)
    updates = UpdateBus()
    await publish(updates, ("gi", A, False))
    seen = updates.newest("gi")
    await publish(updates, *(("near", each, True) for each in (A, B, C)))
    # Whether B of "gi" was updated since then is not known any more: look again.
    with updates.pending("gi", {B}, seen) as waiting:
        assert waiting.all.is_set()
    with updates.pending("gi", {B}, updates.newest("near")) as waiting:
        assert not waiting.some.is_set()
    # The number of a bake that is forgotten is no smaller than it was, and misses nothing.
    assert seen <= updates.newest("gi") <= updates.newest("near") == 4
    with updates.pending("gi", {A}, updates.newest("gi")) as waiting:
        await publish(updates, ("gi", A, True))
        assert waiting.some.is_set()


async def test_a_quiet_bake_waits_while_others_are_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(update_bus, "MOST_UPDATES", 2)
    updates = UpdateBus()
    await publish(updates, ("gi", A, False), *(("near", each, True) for each in (A, B, C)))
    with updates.pending("gi", {A}, updates.newest("gi")) as waiting:
        assert not waiting.some.is_set(), "nothing is new since a frame that is drawn now"


@IN_NO_TIME
async def test_a_client_that_comes_anew_is_not_behind_all_that_waits(turns: Turns) -> None:
    """Requests of one address have waited for long; the draft of a stream that comes now has its
    turn between them.
    """
    crowd = Client()
    stream = Client()
    tasks = [turns.begin("request", Rank(0.0, client=crowd)) for _ in range(40)]
    await asyncio.sleep(1.0)
    for _ in range(5):
        await turns.take("draft", Rank.within(0.0, client=stream))
    assert turns.order.count("request") <= 10 + 5 + 2
    await asyncio.gather(*tasks)
    assert turns.order.count("request") == 40


@IN_NO_TIME
async def test_a_view_that_is_replaced_keeps_its_place_in_line(turns: Turns) -> None:
    first = Client()
    second = Client()
    third = Client()
    working = turns.begin("first", Rank(0.0, client=first))
    await asyncio.sleep(0.01)
    older = turns.begin("older", Rank(0.0, client=second))
    await asyncio.sleep(0.01)
    older.cancel()
    later = [
        turns.begin("later", Rank(0.0, client=client)) for client in (first, first, first, third)
    ]
    await asyncio.sleep(0.15)
    await asyncio.gather(working, turns.begin("newer", Rank(0.0, client=second)), *later)
    assert turns.order.index("newer") <= 2 and "older" not in turns.order


@IN_NO_TIME
async def test_who_took_much_is_not_behind_for_long(turns: Turns) -> None:
    greedy = Client()
    other = Client()
    await turns.take("long", Rank(0.0, client=greedy), 100.0)
    tasks = [turns.begin("other", Rank(0.0, client=other)) for _ in range(60)]
    await asyncio.gather(*tasks, turns.begin("greedy", Rank(0.0, client=greedy)))
    assert 2 <= turns.order.index("greedy") <= 30
