"""The cache of costly results: it keeps the newest, within so many bytes."""

import threading
from collections.abc import Hashable
from functools import partial
from typing import TypeVar

import numpy as np
import pytest

from isogi_core.lru_cache import LruCache

Key = TypeVar("Key", bound=Hashable)


class Growing(list[np.ndarray]):
    """Arrays that are kept together, as many as there are."""

    @property
    def nbytes(self) -> int:
        """Bytes of all."""
        return sum(each.nbytes for each in self)


def made(kept: LruCache[Key], *keys: Key) -> list[Key]:
    """Ask for results of 100 bytes; the keys of those that had to be made."""
    new: list[Key] = []

    def make(key: Key) -> np.ndarray:
        new.append(key)
        return np.zeros(100, np.uint8)

    for key in keys:
        kept.get(key, partial(make, key))
    return new


def size_of_one() -> int:
    """The bytes that a result of ``made`` is counted with."""
    kept: LruCache[str] = LruCache(1 << 20)
    made(kept, "a")
    return kept.nbytes


SIZE = size_of_one()


def test_results_that_fit_are_made_once() -> None:
    kept: LruCache[str] = LruCache(3 * SIZE)
    assert made(kept, "a", "b", "c", "a", "b", "c") == ["a", "b", "c"]
    assert kept.nbytes == 3 * SIZE


def test_the_longest_unused_result_makes_room() -> None:
    kept: LruCache[str] = LruCache(2 * SIZE + 50)
    assert made(kept, "a", "b", "a", "c") == ["a", "b", "c"]
    assert made(kept, "a", "b") == ["b"]
    assert kept.nbytes == 2 * SIZE


def test_room_is_made_before_a_result_is() -> None:
    kept: LruCache[str] = LruCache(3 * SIZE)
    made(kept, "a", "b", "c", "a")
    kept.make_room(SIZE)
    assert made(kept, "a", "c") == []
    kept.make_room(4 * SIZE)
    assert kept.nbytes == 0


def test_the_newest_result_is_kept_at_any_size() -> None:
    kept: LruCache[str] = LruCache(10)
    assert made(kept, "a", "a", "b", "b") == ["a", "b"]
    kept.clear()
    assert kept.nbytes == 0 and made(kept, "b") == ["b"]


def test_the_newest_of_a_kind_that_lasts_stays() -> None:
    kept: LruCache[tuple[str, int]] = LruCache(2 * SIZE, lasting=("step",))
    made(kept, ("step", 1), ("step", 2), ("view", 1), ("view", 2), ("view", 3))
    assert made(kept, ("step", 2), ("view", 3)) == []
    assert made(kept, ("step", 1)) == [("step", 1)], "an older one makes room"
    kept.clear()
    assert kept.nbytes == 0


def test_two_threads_make_a_result_once() -> None:
    kept: LruCache[str] = LruCache(1000)
    begun = threading.Event()
    go = threading.Event()
    count = []

    def make() -> np.ndarray:
        count.append(1)
        begun.set()
        go.wait(10)
        return np.zeros(1)

    results: list[np.ndarray] = []
    threads = [
        threading.Thread(target=lambda: results.append(kept.get("a", make))) for _ in range(2)
    ]
    threads[0].start()
    begun.wait(10)
    threads[1].start()
    go.set()
    for thread in threads:
        thread.join(10)
    assert count == [1] and results[0] is results[1]


def test_a_failed_result_leaves_nothing_and_is_tried_again() -> None:
    kept: LruCache[str] = LruCache(1000)
    for name in "aab":
        with pytest.raises(ZeroDivisionError):
            kept.get(name, lambda: np.zeros(1 // 0))
    assert kept.nbytes == 0
    assert made(kept, "a") == ["a"] and kept.nbytes == SIZE


def test_a_waiting_thread_makes_what_another_failed_to_make() -> None:
    kept: LruCache[str] = LruCache(1000)
    begun = threading.Event()
    go = threading.Event()

    def fail() -> np.ndarray:
        begun.set()
        go.wait(10)
        raise ValueError("too late")

    def first() -> None:
        with pytest.raises(ValueError, match="too late"):
            kept.get("a", fail)

    threads = [threading.Thread(target=first), threading.Thread(target=lambda: made(kept, "a"))]
    threads[0].start()
    begun.wait(10)
    threads[1].start()
    go.set()
    for thread in threads:
        thread.join(10)
    assert made(kept, "a") == [] and kept.nbytes == SIZE


def test_results_without_arrays_make_room_too() -> None:
    kept: LruCache[int] = LruCache(40_960)
    for key in range(100):
        kept.get(key, lambda: np.zeros(0))
    assert kept.nbytes <= 40_960
    assert 5 <= sum(kept.held(key) is not None for key in range(100)) <= 20


def test_results_that_grew_are_counted_when_asked_for() -> None:
    """And all of them when what is kept is settled; the oldest then make room."""
    kept: LruCache[str] = LruCache(3 * SIZE)
    made(kept, "a", "b", "c")
    grown = np.zeros(100, np.uint8)
    kept.get("d", lambda: grown)
    assert made(kept, "b", "c", "a") == ["a"], "the fourth drove out the first, and that the fourth"
    kept.drop("a")
    assert kept.nbytes == 2 * SIZE
    parts = Growing([grown])
    kept.get("parts", lambda: parts)
    parts.append(grown)
    assert kept.nbytes == 3 * SIZE
    assert kept.get("parts", Growing) is parts and kept.nbytes == 3 * SIZE + 100
    kept.settle()
    assert kept.nbytes == 2 * SIZE + 100 and made(kept, "c") == [] and kept.held("b") is None


def test_a_kind_has_a_limit_of_its_own() -> None:
    kept: LruCache[tuple[str, int]] = LruCache(10 * SIZE, {"light": 2 * SIZE})
    lights = [("light", turn) for turn in range(5)]
    surfaces = [("surface", number) for number in range(5)]
    assert made(kept, *surfaces, *lights) == [*surfaces, *lights] and kept.nbytes == 7 * SIZE
    assert made(kept, *surfaces, *lights[3:]) == [], (
        "lights drive out lights alone, the oldest first"
    )
    assert made(kept, lights[2]) == [lights[2]] and made(kept, lights[4], lights[3]) == [lights[3]]


def test_the_newest_of_a_kind_is_kept_at_any_size() -> None:
    kept: LruCache[tuple[str, int]] = LruCache(10 * SIZE, {"light": 1})
    light = kept.get(("light", 1), lambda: np.zeros(100, np.uint8))
    assert kept.get(("light", 1), lambda: np.zeros(0)) is light
    kept.get(("light", 2), lambda: np.zeros(100, np.uint8))
    assert kept.nbytes == SIZE
