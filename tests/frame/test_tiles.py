"""Tiles: every piece once, on several threads, and none that nobody waits for."""

import gc
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest

from isogi_core.errors import Cancelled
from isogi_core.frame.tiles import Tiles


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize(("total", "size"), [(0, 4), (1, 4), (4, 4), (37, 4), (3, 100)])
def test_every_place_is_in_one_piece(threads: int, total: int, size: int) -> None:
    tiles = Tiles(threads)
    pieces = []
    tiles.run(lambda a, b: pieces.append((a, b)), total, size)
    places = [place for a, b in sorted(pieces) for place in range(a, b)]
    assert places == list(range(total)) and all(0 < b - a <= size for a, b in pieces)
    tiles.close()


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_all_threads_work_and_the_callers_is_one(threads: int) -> None:
    tiles = Tiles(threads)
    workers = set()
    together = threading.Barrier(threads)

    def piece(a: int, b: int) -> None:
        workers.add(threading.get_ident())
        together.wait(10)

    tiles.run(piece, 4 * threads, 1)
    assert len(workers) == threads and threading.get_ident() in workers


def test_tiles_do_not_wait_for_a_busy_helper() -> None:
    tiles = Tiles(2)
    go = threading.Event()
    begun = threading.Barrier(3)

    def hold(a: int, b: int) -> None:
        begun.wait(10)
        go.wait(10)

    with ThreadPoolExecutor(1) as other:
        held = other.submit(tiles.run, hold, 2, 1)
        begun.wait(10)
        pieces: list[int] = []
        tiles.run(lambda a, b: pieces.append(a), 5, 1)
        assert sorted(pieces) == [0, 1, 2, 3, 4]
        go.set()
        held.result(10)


@pytest.mark.parametrize("failing", ["tile_0", "tile_1", "MainThread"])
def test_an_error_of_any_thread_comes_out_after_the_others(failing: str) -> None:
    tiles = Tiles(3)
    together = threading.Barrier(3)
    ended = []

    def piece(a: int, b: int) -> None:
        together.wait(10)
        if (name := threading.current_thread().name) == failing:
            raise ValueError(name)
        time.sleep(0.1)
        ended.append(a)

    with pytest.raises(ValueError, match=failing):
        tiles.run(piece, 3, 1)
    assert len(ended) == 2


class Array:
    """Stands for an array that a piece works on."""


def fail_beside(tiles: Tiles) -> "weakref.ref[Array]":
    """Have a helper's piece fail; the array that it worked on."""
    array = Array()
    failed = threading.Event()

    def piece(first: int, last: int) -> None:
        if threading.current_thread() is threading.main_thread():
            assert failed.wait(10)
            return
        failed.set()
        raise ValueError(f"{array} at {first} to {last}")

    with suppress(ValueError):
        tiles.run(piece, 2, 1)
    return weakref.ref(array)


def test_what_has_failed_is_freed_at_once() -> None:
    tiles = Tiles(2)
    gc.disable()
    try:
        left = fail_beside(tiles)
        tiles.run(lambda first, last: None, 2, 1)
        tiles.close()
        assert left() is None
    finally:
        gc.enable()


def test_no_piece_is_begun_after_one_has_failed() -> None:
    tiles = Tiles(2)
    together = threading.Barrier(2)
    begun = []

    def piece(a: int, b: int) -> None:
        begun.append(a)
        together.wait(10)
        if a == 0:
            raise ValueError("the first")
        time.sleep(0.5)

    with pytest.raises(ValueError, match="the first"):
        tiles.run(piece, 9, 1)
    assert sorted(begun) == [0, 1]


def test_cancelled_work_stops_between_pieces() -> None:
    tiles = Tiles(1)
    cancelled = threading.Event()
    pieces = []

    def piece(a: int, b: int) -> None:
        pieces.append(a)
        if a == 2:
            cancelled.set()

    with pytest.raises(Cancelled):
        tiles.cancelled_by(cancelled).run(piece, 9, 1)
    assert pieces == [0, 1, 2]


@pytest.mark.parametrize("which", [0, 1])
def test_tiles_bound_twice_end_with_either_event(which: int) -> None:
    tiles = Tiles(2)
    events = (threading.Event(), threading.Event())
    bound = tiles.cancelled_by(events[0]).cancelled_by(events[1])
    bound.check()
    events[which].set()
    for work in (bound.check, lambda: bound.run(lambda a, b: None, 3, 1)):
        with pytest.raises(Cancelled):
            work()
    tiles.cancelled_by(events[1 - which]).check()
    tiles.run(lambda a, b: None, 3, 1)


@pytest.mark.parametrize("total", [0, 1, 7, 1000])
def test_even_pieces_have_the_number_asked_for(total: int) -> None:
    size = Tiles(2).even(total, 3)
    assert size >= 1 and -(-total // size) <= 6
