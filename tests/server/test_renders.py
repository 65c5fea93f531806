"""What work goes first, what is done once, and who hears of light."""

import asyncio
import threading
from collections.abc import Iterator

import pytest

from isogi_core.bake.recipe import Index
from server.errors import BusyError
from server.gate import Gate
from server.logs import REQUEST_ID
from server.news import News
from server.renders import ASKED, DRAFT, REFINED, REST, Renders
from server.turns import Rank, Turns
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
        first = asyncio.create_task(renders.run(lambda: release.wait(10), Rank.within(ASKED)))
        await asyncio.sleep(0.01)
        later = [
            asyncio.create_task(renders.run(lambda patience=patience: order.append(patience), Rank.within(patience)))
            for patience in (REFINED, ASKED, REST, DRAFT)
        ]
        await asyncio.sleep(0.01)
        release.set()
        await asyncio.gather(first, *later)

    asyncio.run(play())
    assert order == [DRAFT, REST, ASKED, REFINED]


def test_who_can_wait_does_not_wait_forever() -> None:
    order: list[str] = []

    async def take(turns: Turns, name: str, patience: float) -> None:
        async with turns.turn(Rank.within(patience)):
            order.append(name)
            await asyncio.sleep(0.02)

    async def play() -> None:
        turns = Turns(1)
        tasks = [asyncio.create_task(take(turns, "first", 0.0)), asyncio.create_task(take(turns, "patient", 0.1))]
        for number in range(12):
            tasks.append(asyncio.create_task(take(turns, f"draft {number}", 0.0)))
            await asyncio.sleep(0.015)
        await asyncio.gather(*tasks)

    played(play())
    assert 2 <= order.index("patient") < len(order) - 1


def test_who_has_waited_long_enough_is_refused_and_keeps_nobody_else_waiting() -> None:
    async def play() -> None:
        turns = Turns(1)
        async with turns.turn(Rank(0.0)):
            with pytest.raises(BusyError, match="ask again"):
                async with turns.turn(Rank.within(0.0, longest=0.01)):
                    pass
        async with asyncio.timeout(10), turns.turn(Rank.within(0.0, longest=0.0)):
            pass

    asyncio.run(play())


def test_what_was_begun_is_ended_before_a_later_request_begins() -> None:
    order: list[str] = []

    async def request(turns: Turns, name: str, rank: Rank) -> None:
        for part in range(3):
            async with turns.turn(rank):
                order.append(f"{name}{part}")
                await asyncio.sleep(0.0)

    async def play() -> None:
        turns = Turns(1)
        await asyncio.gather(*(request(turns, name, Rank(due)) for due, name in enumerate("abc")))

    asyncio.run(play())
    assert order.index("a2") < order.index("c0")
    assert order.index("b2") < order.index("c1")


def test_a_turn_that_is_not_waited_for_any_more_goes_to_the_next() -> None:
    async def play() -> None:
        turns = Turns(1)
        async with turns.turn(Rank(0.0)):
            leaving = asyncio.create_task(turns.turn(Rank(0.0)).__aenter__())
            await asyncio.sleep(0)
            leaving.cancel()
            await asyncio.gather(leaving, return_exceptions=True)
        for _ in range(3):
            async with asyncio.timeout(1), turns.turn(Rank(0.0)):
                pass

    asyncio.run(play())


def test_work_that_nobody_waits_for_is_told_so_and_the_next_is_done_afresh(renders: Renders) -> None:
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


def test_what_work_logs_has_the_id_of_the_request_that_asked_first(renders: Renders) -> None:
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


def test_a_gate_lets_no_more_in_than_it_may() -> None:
    gate = Gate(1, "guests are in")
    with gate.admitted():
        with pytest.raises(BusyError, match=r"^1 guests are in already: ask again in a second\.$"), gate.admitted():
            pass
        assert gate.open == 1
    assert gate.open == 0


A, B, C = (0, 0, 1), (0, 0, 2), (0, 0, 3)


async def hear(news: News, *told: tuple[str, Index, bool]) -> None:
    """The workers' thread tells these."""
    await asyncio.to_thread(lambda: [news.tell(*each) for each in told])
    await asyncio.sleep(0)


def test_news_are_heard_by_who_waits_for_the_chunk() -> None:
    async def play() -> None:
        news = News()
        with news.pending("gi", {A, B}, 0) as mine, news.pending("near", {A}, 0) as other:
            await hear(news, ("gi", C, False))
            assert not mine.some.is_set()
            await hear(news, ("gi", A, True))
            assert mine.some.is_set() and not mine.all.is_set()
            await hear(news, ("gi", A, False), ("gi", B, False))
            assert mine.all.is_set()
            assert not other.some.is_set()

    asyncio.run(play())


def test_news_that_came_before_one_waited_count_since_then() -> None:
    async def play() -> None:
        news = News()
        await hear(news, ("gi", A, False))
        seen = news.newest("gi")
        await hear(news, ("gi", B, False))
        assert (seen, news.newest("gi"), news.newest("near")) == (1, 2, 0)
        with news.pending("gi", {A, B}, seen) as waiting:
            assert waiting.some.is_set() and waiting.chunks == {A}
        with news.pending("gi", {A}, seen) as waiting:
            assert not waiting.some.is_set()

    asyncio.run(play())
