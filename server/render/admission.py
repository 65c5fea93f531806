"""Admission: how much of one kind is let in at once, and whose turn ends where many ask."""

import asyncio
from collections import Counter
from collections.abc import Coroutine, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from server.errors import BusyError

Result = TypeVar("Result")

PLACE_LOST = "Another client needed this place, and you have {places} more: ask again in a while."


@dataclass(eq=False)
class Place:
    """A place of an ``owner``, ``used`` last at this time of the event loop; ``lost`` once another client took it.

    The owner has ``others`` then.
    """

    owner: Hashable
    used: float
    lost: bool = False
    others: int = 0
    _task: "asyncio.Task[Any] | None" = None

    def use(self) -> None:
        """Note that its owner needs it now."""
        self.used = asyncio.get_running_loop().time()

    def lose(self, others: int) -> None:
        """Have it lost, and the work that needs it cancelled."""
        self.lost, self.others = True, others
        if self._task:
            self._task.cancel()

    def check(self) -> None:
        """Raise BusyError where it was lost."""
        if self.lost:
            raise BusyError(PLACE_LOST.format(places=self.others))

    async def keep(self, work: Coroutine[Any, Any, Result]) -> Result:
        """What some work comes to that needs the place. Raises BusyError once that is lost; the work has ended then."""
        if self.lost:
            work.close()
            self.check()
        self._task = task = asyncio.current_task()
        assert task
        before = task.cancelling()
        try:
            return await work
        except asyncio.CancelledError:
            if self.lost and task.uncancel() <= before:
                self.check()
            raise
        finally:
            self._task = None


class AdmissionLimit:
    """Lets ``most`` in at once; ``what`` names them in the sentence for one that is too many.

    Where all places are taken, a newcomer takes one of the owner that has most of them, if that leaves the owner no
    fewer than the newcomer has. The idlest place goes; where each is of some ``work``, the newest, in which least is
    lost. So one owner may have all places, until others ask.
    """

    def __init__(self, most: int, what: str, work: bool = False) -> None:
        self.most, self.what = most, what
        self._work = work
        self._places: list[Place] = []

    @property
    def open(self) -> int:
        """How many are inside."""
        return len(self._places)

    @contextmanager
    def admitted(self, owner: Hashable) -> Iterator[Place]:
        """The place of one of them, for the block. Raises BusyError where there is none for this owner."""
        place = self.enter(owner)
        try:
            yield place
        finally:
            self.leave(place)

    def enter(self, owner: Hashable) -> Place:
        """A place, until ``leave``. Raises BusyError where there is none for this owner."""
        if len(self._places) >= self.most:
            self._make_room(owner)
        place = Place(owner, asyncio.get_running_loop().time())
        self._places.append(place)
        return place

    def leave(self, place: Place) -> None:
        """Give a place back, unless it was lost."""
        if place in self._places:
            self._places.remove(place)

    def _make_room(self, owner: Hashable) -> None:
        counts = Counter(each.owner for each in self._places)
        most = max(counts.values(), default=0)
        if most < counts[owner] + 2:
            raise BusyError(f"{self.open} {self.what} already: ask again in a second.")
        of_greediest = [each for each in self._places if counts[each.owner] == most]
        given_up = of_greediest[-1] if self._work else min(of_greediest, key=lambda each: each.used)
        self._places.remove(given_up)
        given_up.lose(most - 1)
