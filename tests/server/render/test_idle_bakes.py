"""Texels that are baked while nobody waits for a picture."""

import threading
from collections.abc import Iterator

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import StoreError
from isogi_core.model.view import Camera, View
from isogi_server.render import idle_bakes
from isogi_server.render.idle_bakes import IdleBakes
from isogi_server.render.picture_checks import Picture
from isogi_worker.bake_requests import Viewer
from tests.server.sockets import wait_for

CAMERA = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 30.0)


def picture(isovalue: float) -> Picture:
    """A picture, told apart by its isovalue."""
    return Picture("scene", View(isovalue, CAMERA, width=4, height=4), Goal.checked(0.02))


class Bake:
    """A bake that goes on until it is ``done``."""

    def __init__(self, number: int) -> None:
        self.done = threading.Event()
        self.coming = frozenset({(0, 0, 0)})
        self.bake = "bake"
        self.chunks = [(0, 0, number)]

    def waiting(self) -> int:
        """The chunks that are left."""
        return 0 if self.done.is_set() else 1


class Bakery:
    """Notes which pictures are begun and which viewers leave; each picture has ``stages``, of the
    same chunk if it is ``stuck``.
    """

    def __init__(self) -> None:
        self.begun: list[Picture] = []
        self.bakes: list[Bake] = []
        self.left: list[Viewer] = []
        self.stages = 1
        self.stuck = False
        self.idle = IdleBakes(self.begin, self.left.append)  # type: ignore[arg-type]

    def begin(self, lit: Picture) -> Bake | None:
        """Begin a stage of a picture, if it has one more."""
        if lit.view.isovalue < 0.0:
            raise StoreError("The store is away.")
        if sum(each is lit for each in self.begun) == self.stages:
            return None
        self.begun.append(lit)
        self.bakes.append(Bake(0 if self.stuck else len(self.bakes)))
        return self.bakes[-1]


@pytest.fixture
def bakery(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bakery]:
    """Nobody waits after a tenth of a second."""
    monkeypatch.setattr(idle_bakes, "QUIET_SECONDS", 0.1)
    monkeypatch.setattr(idle_bakes, "RENEWAL_SECONDS", 0.01)
    found = Bakery()
    yield found
    found.idle.close()


def test_texels_are_baked_stage_after_stage(bakery: Bakery) -> None:
    """The next stage begins when the former one is done."""
    bakery.stages = 2
    bakery.idle.add(picture(1.0))
    assert wait_for(lambda: len(bakery.begun) == 1)
    bakery.bakes[0].done.set()
    assert wait_for(lambda: len(bakery.begun) == 2)
    assert not bakery.left


def test_chunks_that_stay_unlit_are_not_baked_for_ever(bakery: Bakery) -> None:
    """The same chunks again mean that nothing was gained; other pictures have their turn."""
    bakery.stages = 9
    bakery.stuck = True
    bakery.idle.add(picture(1.0))
    assert wait_for(lambda: len(bakery.begun) == 1)
    bakery.bakes[0].done.set()
    assert wait_for(lambda: len(bakery.begun) == 2)
    bakery.idle.add(picture(2.0))
    assert wait_for(lambda: len(bakery.begun) == 3)
    assert [each.view.isovalue for each in bakery.begun] == [1.0, 1.0, 2.0]


def test_somebody_who_waits_comes_first(bakery: Bakery) -> None:
    """The bake is left, and taken up again later."""
    first = picture(1.0)
    bakery.idle.add(first)
    assert wait_for(lambda: len(bakery.begun) == 1)
    bakery.stages = 2
    bakery.idle.disturb()
    assert wait_for(lambda: len(bakery.left) == 1)
    assert bakery.left[0].patient, "nobody waits for it"
    assert wait_for(lambda: bakery.begun == [first, first])


def test_the_newest_pictures_are_baked_first(
    bakery: Bakery, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Older ones are forgotten."""
    monkeypatch.setattr(idle_bakes, "MOST_PICTURES", 3)
    pictures = [picture(float(number)) for number in range(5)]
    for each in pictures:
        bakery.idle.add(each)
    for number in range(3):
        assert wait_for(lambda count=number + 1: len(bakery.begun) == count)
        bakery.bakes[-1].done.set()
    assert bakery.begun == pictures[:1:-1]


def test_a_picture_that_fails_does_not_stop_the_others(bakery: Bakery) -> None:
    """As when the store is away."""
    bakery.idle.add(picture(1.0))
    bakery.idle.add(picture(-1.0))
    assert wait_for(lambda: len(bakery.begun) == 1)
    assert bakery.begun[0].view.isovalue == 1.0


def test_nothing_begins_after_the_end(bakery: Bakery) -> None:
    """Closing ends a bake at work, too."""
    bakery.idle.add(picture(1.0))
    assert wait_for(lambda: len(bakery.begun) == 1)
    bakery.idle.close()
    bakery.idle.add(picture(2.0))
    assert len(bakery.begun) == 1
