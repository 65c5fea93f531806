import time
from collections.abc import Callable
from unittest.mock import MagicMock

import pytest

from tests.worker.clock import Clock
from worker import niceness as nice
from worker.niceness import BACK_NICENESS, FORWARD_NICENESS, Sessions

ANNA = 11
BERT = 12
LONG = 30.0


class Kernel:
    """Grants a change in so many seconds, and notes what was changed when, in tenths of a
    second.
    """

    def __init__(self, clock: Clock, every: float = 0.0) -> None:
        self.clock = clock
        self.every = every
        self.next = 0.0
        self.changes: list[tuple[int, int, int]] = []

    def __call__(self, pid: int, niceness: int) -> bool:
        if self.clock() < self.next:
            return False
        self.next = self.clock() + self.every
        self.changes.append((round(10 * self.clock()), pid, niceness))
        return True


class Bench:
    """Sessions whose thread waits no time; what is to happen meanwhile does so by a clock of its
    own.
    """

    def __init__(self, every: float = 0.0) -> None:
        self.clock = Clock()
        self.leaders = [ANNA, BERT]
        self.kernel = Kernel(self.clock, every)
        self.plan: dict[int, Callable[[], None]] = {}
        self.sessions = Sessions(lambda: self.leaders, self.kernel, self.clock, self.pause)

    def pause(self, seconds: float) -> None:
        self.clock.now = round(self.clock() + seconds, 9)
        self.plan.pop(round(10 * self.clock()), lambda: None)()

    def run(self, seconds: float) -> list[tuple[int, int, int]]:
        """What is changed when all step back for so long."""
        self.sessions.step_back(seconds)
        if self.sessions._thread:
            self.sessions._thread.join(LONG)
        assert self.sessions._thread is None
        return sorted(self.kernel.changes)


def both(tenth: int, niceness: int) -> list[tuple[int, int, int]]:
    """What is changed of two sessions at once."""
    return [(tenth, ANNA, niceness), (tenth, BERT, niceness)]


def test_each_session_steps_back_and_forward_once() -> None:
    assert Bench().run(0.5) == both(0, BACK_NICENESS) + both(5, FORWARD_NICENESS)


def test_a_view_that_moves_on_prolongs_low_priority() -> None:
    bench = Bench()
    bench.plan = {tenth: lambda: bench.sessions.step_back(0.5) for tenth in (3, 6)}
    assert bench.run(0.5) == both(0, BACK_NICENESS) + both(11, FORWARD_NICENESS)


def test_a_change_that_is_not_granted_is_tried_again() -> None:
    changes = Bench(every=0.19).run(0.5)
    back = [(tenth, BACK_NICENESS) for tenth in (0, 2)]
    forward = [(tenth, FORWARD_NICENESS) for tenth in (5, 7)]
    assert [(tenth, niceness) for tenth, _, niceness in changes] == back + forward
    assert {pid for _, pid, _ in changes[:2]} == {pid for _, pid, _ in changes[2:]} == {ANNA, BERT}


def test_a_session_goes_back_when_a_view_moves_again() -> None:
    bench = Bench(every=0.19)
    bench.plan = {6: lambda: bench.sessions.step_back(0.3)}
    changes = [(tenth, niceness) for tenth, _, niceness in bench.run(0.5)]
    assert changes[:2] == [(0, BACK_NICENESS), (2, BACK_NICENESS)]
    assert changes[2:] == [
        (5, FORWARD_NICENESS),
        (7, BACK_NICENESS),
        (9, FORWARD_NICENESS),
        (11, FORWARD_NICENESS),
    ]


def test_a_worker_that_is_started_anew_steps_back_too() -> None:
    bench = Bench()
    bench.plan = {2: lambda: bench.leaders.remove(ANNA), 3: lambda: bench.leaders.append(13)}
    forward = [(5, BERT, FORWARD_NICENESS), (5, 13, FORWARD_NICENESS)]
    assert bench.run(0.5) == [*both(0, BACK_NICENESS), (3, 13, BACK_NICENESS), *forward]


def test_closing_has_all_come_forward() -> None:
    bench = Bench()
    bench.sessions = Sessions(lambda: bench.leaders, bench.kernel, bench.clock)
    bench.sessions.step_back(1e9)
    while len(bench.kernel.changes) < 2:
        time.sleep(0.01)
    bench.sessions.close()
    assert sorted(bench.kernel.changes[2:]) == [
        (0, ANNA, FORWARD_NICENESS),
        (0, BERT, FORWARD_NICENESS),
    ]
    assert bench.sessions._thread is None


def test_nothing_steps_back_where_nobody_leads_a_session() -> None:
    bench = Bench()
    bench.leaders = []
    assert bench.run(0.5) == []


def test_where_there_are_no_sessions_there_is_nothing_to_change() -> None:
    assert nice.set_session_niceness(2**31 - 1, BACK_NICENESS)
    assert not nice.leads_session(2**31 - 1)


@pytest.mark.parametrize(("answer", "done"), [(2, True), (None, False)])
def test_a_kernel_that_says_later_is_asked_again(
    monkeypatch: pytest.MonkeyPatch, answer: int | None, done: bool
) -> None:
    """An unbuffered write gives None when the kernel says EAGAIN."""
    file = MagicMock()
    file.__enter__.return_value.write = lambda said: (
        answer if said == b"10" else pytest.fail("another niceness")
    )
    monkeypatch.setattr("builtins.open", lambda path, mode, buffering: file)
    assert nice.set_session_niceness(ANNA, BACK_NICENESS) is done
