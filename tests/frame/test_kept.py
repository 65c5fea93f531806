"""What is kept for the next frames: the newest, within so many bytes."""

import threading

import numpy as np
import pytest

from isogi_core.kept import OVERHEAD, Kept

SIZE = OVERHEAD + 100
"""Bytes that a result of ``made`` is counted with."""


def made(kept: Kept[str], *names: str) -> list[str]:
    """Ask for results of 100 bytes; the names of those that had to be made."""
    new: list[str] = []

    def make(name: str) -> np.ndarray:
        new.append(name)
        return np.zeros(100, np.uint8)

    for name in names:
        kept.get(name, lambda name=name: make(name))  # type: ignore[misc]
    return new


def test_what_fits_is_made_once() -> None:
    kept: Kept[str] = Kept(3 * SIZE)
    assert made(kept, "a", "b", "c", "a", "b", "c") == ["a", "b", "c"]
    assert kept.nbytes == 3 * SIZE


def test_the_longest_unused_makes_room() -> None:
    kept: Kept[str] = Kept(2 * SIZE + 50)
    assert made(kept, "a", "b", "a", "c") == ["a", "b", "c"]
    assert made(kept, "a", "b") == ["b"]
    assert kept.nbytes == 2 * SIZE


def test_the_newest_is_kept_however_large() -> None:
    kept: Kept[str] = Kept(10)
    assert made(kept, "a", "a", "b", "b") == ["a", "b"]
    kept.clear()
    assert kept.nbytes == 0 and made(kept, "b") == ["b"]


def test_two_threads_make_it_once() -> None:
    kept: Kept[str] = Kept(1000)
    begun, go, count = threading.Event(), threading.Event(), []

    def make() -> np.ndarray:
        count.append(1)
        begun.set()
        go.wait(10)
        return np.zeros(1)

    results: list[np.ndarray] = []
    threads = [threading.Thread(target=lambda: results.append(kept.get("a", make))) for _ in range(2)]
    threads[0].start()
    begun.wait(10)
    threads[1].start()
    go.set()
    for thread in threads:
        thread.join(10)
    assert count == [1] and results[0] is results[1]


def test_what_fails_is_tried_again() -> None:
    kept: Kept[str] = Kept(1000)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            kept.get("a", lambda: np.zeros(1 // 0))
    assert made(kept, "a") == ["a"]
    assert kept.nbytes == SIZE


def test_what_fails_leaves_nothing() -> None:
    kept: Kept[str] = Kept(1000)
    for name in "abc":
        with pytest.raises(ZeroDivisionError):
            kept.get(name, lambda: np.zeros(1 // 0))
    assert kept.nbytes == 0


def test_who_waits_for_what_fails_makes_it() -> None:
    kept: Kept[str] = Kept(1000)
    begun, go = threading.Event(), threading.Event()

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
    kept: Kept[int] = Kept(10 * OVERHEAD)
    for key in range(100):
        kept.get(key, lambda: np.zeros(0))
    assert kept.nbytes == 10 * OVERHEAD
