"""Refining until a frame is final, with an engine that follows a script."""

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import Cancelled
from isogi_core.model.view import Camera, View
from isogi_server.cli import render
from isogi_worker.errors import WorkersError
from isogi_worker.progress import TimeLeft

VIEW = View(0.5, Camera((5.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
GOAL = Goal.checked(0.1)


class Script:
    """An engine whose frames are the versions of a script; the last stays."""

    def __init__(self, *versions: str) -> None:
        self.versions = list(versions)
        self.asked: list[dict[str, Any]] = []
        self.failing = ""
        self.workers = SimpleNamespace(preparing="")
        self.demands: tuple[str, ...] = ("a chunk",)

    def frame(self, scene: str, view: View, **more: Any) -> SimpleNamespace:
        self.asked.append(more)
        if len(self.versions) > 1:
            version = self.versions.pop(0)
        else:
            version = self.versions[0]
        known = {"final": version == "final", "checkable": version == "to be checked"}
        return SimpleNamespace(version=version, **known, chunks_needed=2, chunks_final=1)

    def lacking(self, scene: str, frame: Any) -> tuple[str, SimpleNamespace]:
        return scene, SimpleNamespace(demands=self.demands)

    def trouble(self) -> str:
        if len(self.versions) == 1:
            return self.failing
        return ""

    def time_left(self, scene: str, frame: Any, goal: Goal) -> TimeLeft:
        return TimeLeft(61.0, 200.0, 7300.0)

    def unready(self) -> list[str]:
        return ["No worker is alive."]


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A clock that moves on by one second with each look at it."""
    ticks = iter(range(10**6))
    monkeypatch.setattr(render, "time", SimpleNamespace(monotonic=lambda: float(next(ticks))))
    yield


def refine(engine: Script, goal: Goal = GOAL, seconds: float | None = None) -> Any:
    return render.draw_refined(engine, "scene", VIEW, goal, seconds)  # type: ignore[arg-type]


def test_it_asks_until_the_frame_is_final(capsys: pytest.CaptureFixture[str]) -> None:
    engine = Script("a", "b", "c", "final")
    assert refine(engine).version == "final"
    assert len(engine.asked) == 4 and all(1.0 <= each["wait"] <= 4.0 for each in engine.asked)
    assert all(each["goal"] == GOAL for each in engine.asked)
    bar = capsys.readouterr().err
    assert "lighting" in bar and "about 3.3 min left (1 min to 2 h)" in bar


def test_it_ends_when_the_time_is_spent() -> None:
    engine = Script("a")
    assert refine(engine, seconds=9).version == "a"
    waits = [each["wait"] for each in engine.asked]
    assert waits[-1] < max(waits)


def test_it_asks_once_where_there_is_no_time() -> None:
    engine = Script("a", "final")
    assert refine(engine, seconds=0).version == "a"
    assert engine.asked == [{"goal": GOAL, "wait": 0.0, "cancelled": None}]


class Slow(Script):
    """An engine whose steps end when they are cancelled alone."""

    def frame(self, scene: str, view: View, **more: Any) -> SimpleNamespace:
        if (cancelled := more["cancelled"]) is not None:
            assert cancelled.wait(30.0), "a step that nobody ends"
            raise Cancelled("Time is over.")
        return super().frame(scene, view, **more)

    def survey(self, *_: Any) -> SimpleNamespace:
        """The picture with the light that there is when the time ends."""
        return SimpleNamespace(version="now")


def test_a_step_ends_with_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first picture is drawn; a step that would go on is ended, and what is there is drawn."""
    monkeypatch.setattr(render, "time", time)
    engine = Slow("a", "final")
    assert refine(engine, seconds=0.2).version == "now"
    assert [each["wait"] for each in engine.asked] == [0.0]


def test_it_gives_up_where_nothing_changes() -> None:
    with pytest.raises(
        WorkersError, match=r"^No light came for 120 seconds. No worker is alive\.$"
    ):
        refine(Script("a", "b"))


def test_it_waits_while_workers_start_or_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Script("a")
    engine.workers.preparing = "The workers compile their kernels."
    ask = engine.frame

    def frame(*given: Any, **more: Any) -> SimpleNamespace:
        if len(engine.asked) == 1000:
            engine.workers.preparing = ""
        return ask(*given, **more)

    monkeypatch.setattr(engine, "frame", frame)
    with pytest.raises(WorkersError, match=r"^No light came for 120 seconds"):
        refine(engine)
    assert len(engine.asked) > 1000


def test_a_frame_that_lacks_no_light_is_the_answer() -> None:
    engine = Script("a")
    engine.demands = ()
    assert refine(engine).version == "a"
    assert len(engine.asked) == 1


def test_it_waits_while_control_pixels_measure_the_picture() -> None:
    engine = Script(*["to be checked"] * 200, "final")
    engine.demands = ()
    assert refine(engine).version == "final"


def test_it_ends_at_once_where_the_workers_fail() -> None:
    engine = Script("a", "b")
    engine.failing = "The disk is full."
    with pytest.raises(WorkersError, match=r"^The disk is full\.$"):
        refine(engine)
    assert len(engine.asked) == 1
