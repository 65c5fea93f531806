"""What is prepared ahead of a slider, and makes way for frames."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from server.render.loaded_scene import VALUES_AHEAD, Prefetch, next_values

STEP = 0.02
LEVELS = np.array([-np.inf, *(np.arange(51) * STEP), np.inf])
LONG = 30.0


class Preparing:
    """Prepares values at once, or, ``halting``, waits at each until it is told to go on or is
    cancelled.
    """

    def __init__(self) -> None:
        self.halting = False
        self.begun: list[float] = []
        self.done: list[float] = []
        self.dropped: list[float] = []
        self.go = threading.Event()
        self.changed = threading.Condition()

    def __call__(self, isovalue: float, cancelled: threading.Event) -> None:
        self._add(self.begun, isovalue)
        while self.halting and not self.go.wait(0.001):
            if cancelled.is_set():
                self._add(self.dropped, isovalue)
                raise Cancelled("Nobody waits for this any more.")
        self._add(self.done, isovalue)

    def wait_for(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, LONG)

    def _add(self, values: list[float], value: float) -> None:
        with self.changed:
            values.append(value)
            self.changed.notify_all()


def show(prefetch: Prefetch, *isovalues: float) -> None:
    for isovalue in isovalues:
        with prefetch.frame(isovalue):
            pass


@pytest.fixture
def prepare() -> Preparing:
    return Preparing()


@pytest.fixture
def prefetch(prepare: Preparing) -> Iterator[Prefetch]:
    """What prepares for a slider from 0 to 1."""
    with closing(Prefetch(prepare, LEVELS, (0.0, 1.0))) as prefetch:
        yield prefetch


@pytest.fixture
def halted(prepare: Preparing, prefetch: Prefetch) -> Preparing:
    """Preparations that a slider has begun, and that wait."""
    prepare.halting = True
    show(prefetch, 0.5, 0.51)
    prepare.wait_for(lambda: len(prepare.begun) == 1)
    return prepare


@pytest.mark.parametrize(("before", "now"), [(0.5, 0.55), (0.5, 0.58), (0.5, 0.3)])
def test_next_values_go_on_as_the_slider_moves(before: float, now: float) -> None:
    assert next_values(before, now, LEVELS) == pytest.approx(
        [now + (now - before) * n for n in (1, 2)]
    )


def test_a_slow_slider_is_in_the_next_group_next() -> None:
    assert next_values(0.5, 0.501, LEVELS) == [LEVELS[27], LEVELS[28]]
    below = next_values(0.5, 0.499, LEVELS)
    assert below == [np.nextafter(LEVELS[25], -1.0), np.nextafter(LEVELS[24], -1.0)]


def test_groups_may_be_of_any_width() -> None:
    levels = np.array([-np.inf, 0.0, 1e-6, 2e-6, 0.5, 1.0, np.inf])
    assert next_values(1e-7, 2e-7, levels) == [1e-6, 2e-6]
    assert next_values(1e-7, 1.1e-6, levels) == pytest.approx([2.1e-6, 0.5])


def test_no_value_lies_beyond_the_first_or_last_group() -> None:
    assert next_values(1.0, 1.001, LEVELS) == [] == next_values(-0.001, -0.002, LEVELS)
    assert next_values(0.0, -1e300, LEVELS) == next_values(2.0, 1.7e308, LEVELS) == []


def test_a_slider_that_moves_is_prepared_for(prepare: Preparing, prefetch: Prefetch) -> None:
    show(prefetch, 0.5, 0.51)
    prepare.wait_for(lambda: len(prepare.done) == VALUES_AHEAD)
    prefetch.close()
    assert prepare.done == next_values(0.5, 0.51, LEVELS)


def test_values_that_cannot_be_asked_for_are_left_out(prepare: Preparing) -> None:
    with closing(Prefetch(prepare, LEVELS, (0.0, 0.53))) as prefetch:
        show(prefetch, 0.5, 0.51)
        prepare.wait_for(lambda: len(prepare.done) == 1)
        show(prefetch, 0.53)
    assert prepare.done == [pytest.approx(0.52)]


def test_one_that_stands_is_not(prepare: Preparing, prefetch: Prefetch) -> None:
    show(prefetch, 0.5, 0.5, 0.5)
    prefetch.close()
    assert not prepare.begun


def test_nothing_is_prepared_while_a_frame_is_worked_on(
    prepare: Preparing, prefetch: Prefetch
) -> None:
    with prefetch.frame(0.4):
        show(prefetch, 0.5, 0.51)
        assert not prepare.begun
    prepare.wait_for(lambda: len(prepare.done) == VALUES_AHEAD)


def test_a_frame_drops_what_is_prepared_and_it_is_taken_up_again(
    halted: Preparing, prefetch: Prefetch
) -> None:
    first, second = next_values(0.5, 0.51, LEVELS)
    assert halted.begun == [first]
    with prefetch.frame(0.51):
        halted.wait_for(lambda: halted.dropped == [first])
    halted.wait_for(lambda: halted.begun == [first, first])
    halted.go.set()
    halted.wait_for(lambda: halted.done == [first, second])


def test_a_turn_of_the_slider_changes_what_is_coming(halted: Preparing, prefetch: Prefetch) -> None:
    show(prefetch, 0.505)
    halted.go.set()
    expected = next_values(0.51, 0.505, LEVELS)
    halted.wait_for(lambda: halted.done[-2:] == expected)


def test_closing_drops_what_is_prepared(halted: Preparing, prefetch: Prefetch) -> None:
    prefetch.close()
    assert len(halted.dropped) == 1 and not halted.done


def test_preparations_for_the_frame_itself_are_not_cancelled(
    halted: Preparing, prefetch: Prefetch
) -> None:
    with prefetch.frame(0.535):
        time.sleep(0.05)  # long enough to be dropped
        halted.go.set()
        halted.wait_for(lambda: len(halted.done) == 1)
        assert not halted.dropped
    expected = next_values(0.51, 0.535, LEVELS)
    halted.wait_for(lambda: halted.done[-2:] == expected)


def test_what_was_kept_going_is_still_dropped_by_a_later_frame(
    halted: Preparing, prefetch: Prefetch
) -> None:
    show(prefetch, 0.535)
    with prefetch.frame(0.9):
        halted.wait_for(lambda: len(halted.dropped) == 1)


def test_a_frame_that_ends_after_closing_keeps_its_own_result(prefetch: Prefetch) -> None:
    show(prefetch, 0.5)
    with prefetch.frame(0.51):
        prefetch.close()
