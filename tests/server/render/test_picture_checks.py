"""Checks of pictures, by a step that follows a script."""

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import Cancelled
from isogi_core.model.view import Camera, View
from isogi_server.render import picture_checks
from isogi_server.render.picture_checks import PictureChecks
from isogi_worker.bake_requests import Viewer

VIEW = View(0.5, Camera((5.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
ONE = Viewer("one", 1)
OTHER = Viewer("other", 2)
LONG = 30.0


class Steps:
    """Steps that wait until they may go on; each picture takes so many."""

    def __init__(self, most: int = 1) -> None:
        self.most = most
        self.broken = math.nan
        self.taken: list[float] = []
        self.cancelled: list[float] = []
        self.told: list[tuple[float, bool]] = []
        self.go = threading.Semaphore(0)
        self.begun = threading.Semaphore(0)
        self.ended = threading.Semaphore(0)
        self.checks = PictureChecks(self.step, self.note)

    def step(self, scene: str, view: View, goal: Goal, cancelled: threading.Event) -> bool:
        self.taken.append(view.isovalue)
        self.begun.release()
        assert self.go.acquire(timeout=LONG)
        if cancelled.is_set():
            self.cancelled.append(view.isovalue)
            raise Cancelled("Nobody waits for it.")
        if view.isovalue == self.broken:
            raise ZeroDivisionError
        return self.taken.count(view.isovalue) < self.most

    def note(self, scene: str, view: View, more: bool) -> None:
        self.told.append((view.isovalue, more))
        self.ended.release()

    def ask(self, isovalue: float, viewer: Viewer = ONE, delay: float = 0.0) -> None:
        view = replace(VIEW, isovalue=isovalue)
        self.checks.request("scene", view, Goal.checked(0.02), viewer, delay)

    def end(self, count: int) -> None:
        """Let so many steps end."""
        for _ in range(count):
            self.go.release()
            assert self.ended.acquire(timeout=LONG)


@pytest.fixture
def steps() -> Iterator[Steps]:
    made = Steps()
    yield made
    for _ in range(100):
        made.go.release()
    made.checks.close()


def test_a_picture_is_checked_until_no_step_is_left(steps: Steps) -> None:
    steps.most = 3
    steps.ask(0.5)
    steps.end(3)
    assert steps.told == [(0.5, True), (0.5, True), (0.5, False)]


def test_a_check_that_breaks_leaves_the_others(
    steps: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(picture_checks.log, "exception", lambda text, *_: said.append(text))
    steps.broken = 0.1
    steps.ask(0.1)
    steps.end(1)
    steps.ask(0.1)  # it waits, and gives way to the next
    steps.ask(0.2)
    steps.end(1)
    assert steps.told == [(0.1, False), (0.2, False)]
    assert [line.partition(":")[0] for line in said] == ["The check of a picture failed"]


def test_a_check_that_broke_is_tried_again_later(
    steps: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_checks.log, "exception", lambda *_: None)
    monkeypatch.setattr(picture_checks, "FAILURE_PATIENCE_SECONDS", 0.2)
    steps.broken = 0.1
    begun = time.monotonic()
    steps.ask(0.1)
    steps.end(1)
    # However often it is asked for, it is not checked before.
    for _ in range(50):
        steps.ask(0.1)
    steps.end(1)
    assert time.monotonic() - begun >= 0.2
    assert steps.taken == [0.1, 0.1]


def test_the_newest_picture_comes_first(steps: Steps) -> None:
    steps.ask(0.1)
    assert steps.begun.acquire(timeout=LONG)
    steps.ask(0.2, OTHER)
    steps.ask(0.3, Viewer("third", 3))
    steps.end(3)
    assert steps.taken == [0.1, 0.3, 0.2]


def test_who_leaves_or_moves_on_ends_the_check_at_work(steps: Steps) -> None:
    steps.ask(0.1)
    assert steps.begun.acquire(timeout=LONG)
    steps.ask(0.1)
    steps.ask(0.2)
    steps.end(1)
    assert steps.begun.acquire(timeout=LONG)
    steps.checks.leave(ONE)
    steps.end(1)
    assert steps.taken == [0.1, 0.2] and steps.told == [(0.1, False), (0.2, False)]


def test_no_more_than_so_many_pictures_wait(steps: Steps, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_checks, "MAX_WAITING_PICTURES", 6)
    steps.ask(0.0)
    assert steps.begun.acquire(timeout=LONG)
    for number in range(11):
        steps.ask(1.0 + number, Viewer(number, number))
    steps.end(7)
    assert len(steps.taken) == 7
    assert min(steps.taken[1:]) == 1.0 + 5, "those asked for first are dropped"


def test_a_long_step_outlives_a_crowd_that_asks_for_it(steps: Steps) -> None:
    steps.ask(0.1)
    assert steps.begun.acquire(timeout=LONG)
    # A script that waits for its picture asks again and again, as another viewer each time.
    for visit in range(1000):
        steps.ask(0.1, Viewer("script", 10 + visit))
    steps.end(1)
    assert steps.told == [(0.1, False)]
    assert not steps.cancelled


def test_a_step_ends_once_the_last_viewer_leaves(steps: Steps) -> None:
    steps.ask(0.1)
    assert steps.begun.acquire(timeout=LONG)
    steps.ask(0.1, OTHER)
    steps.checks.leave(ONE)
    steps.checks.leave(ONE)
    steps.ask(0.2, OTHER)
    steps.end(2)
    assert steps.taken == [0.1, 0.2] and steps.cancelled == [0.1]


def test_a_picture_waits_for_the_rest_of_its_light(steps: Steps) -> None:
    steps.ask(0.1, delay=LONG)
    steps.ask(0.2, OTHER)
    steps.end(1)
    assert steps.taken == [0.2], "the older picture waits, and the other one does not"
    # All its light is there: it is checked at once.
    steps.ask(0.1)
    steps.end(1)
    assert steps.taken == [0.2, 0.1]


def test_a_picture_that_lacks_light_for_long_is_measured(steps: Steps) -> None:
    steps.ask(0.1, delay=0.05)
    for _ in range(3):
        steps.ask(0.1, delay=LONG)
    steps.end(1)
    assert steps.taken == [0.1], "new light does not put it off"


def test_a_picture_that_waits_is_forgotten_if_its_viewer_leaves(steps: Steps) -> None:
    steps.ask(0.1, delay=0.05)
    steps.checks.leave(ONE)
    steps.ask(0.2, OTHER, delay=0.1)
    steps.end(1)
    assert steps.taken == [0.2]
