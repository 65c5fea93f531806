"""The simulation: nothing is lost in it, nothing is baked for nobody, and a seed tells all of
it.
"""

from dataclasses import replace

import pytest

from benchmarks.scaling.simulator.cluster import Conditions
from benchmarks.scaling.simulator.light import place_of
from benchmarks.scaling.simulator.recording import Recording, load
from benchmarks.scaling.simulator.run import Site, Visits, batch, visit
from benchmarks.scaling.simulator.visitors import Habits

HABITS = Habits(views=2, arrive=2.0, turns=2, think=1.0, patience=1e6, together=0.7)
HARD = Conditions(4, latency=0.005, fail=0.02, tries=2, deaths=200.0)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A few chunks of the casting."""
    whole = load("casting")
    return replace(whole, views=tuple(view[:12] for view in whole.views))


def told(found: Visits) -> Visits:
    """What was simulated, and not measured."""
    return replace(found, baker=0.0)


def check_nothing_is_left(place: Site, visitors: int) -> None:
    """No request is open, given up or in flight: neither of the hall, nor of a scene that one
    visitor alone looked at.
    """
    told = place.baker.tally()
    assert (told.waiting, told.given_up, told.in_flight) == (0, 0, 0)
    chunks = [place_of(chunk) for chunk in range(len(place.light.recording.ladders))]
    for scene in ("hall", *(f"own {number}" for number in range(visitors))):
        assert place.baker.open(scene, chunks) == 0
        assert not place.baker.failures(scene, chunks)


@pytest.mark.parametrize("conditions", [Conditions(1), Conditions(8), HARD])
@pytest.mark.parametrize("visitors", [1, 6])
def test_every_want_ends_and_nobody_starves(
    recording: Recording, conditions: Conditions, visitors: int
) -> None:
    found, place = visit(recording, conditions, visitors, HABITS)
    assert found.views == 2 * visitors
    assert found.done_share == 1.0 or found.given_up > 0
    assert not found.late
    check_nothing_is_left(place, visitors)
    assert place.baker.tally().done == found.tasks


def test_nothing_is_baked_once_all_have_left_early(recording: Recording) -> None:
    found, place = visit(recording, Conditions(1), 5, replace(HABITS, patience=0.2))
    assert found.done_share < 1.0
    assert not found.late
    check_nothing_is_left(place, 5)


def test_what_is_baked_is_all_that_there_is_whoever_bakes_it(recording: Recording) -> None:
    few = batch(recording, Conditions(1), 1)
    many = batch(recording, Conditions(16), 1)
    assert few.seconds == pytest.approx(many.seconds)
    assert few.makespan > 2.0 * many.makespan


def test_workers_that_die_leave_their_tasks_to_others(recording: Recording) -> None:
    found, place = visit(recording, replace(HARD, fail=0.0, deaths=2000.0), 3, HABITS)
    assert place.cluster.deaths > 0 and found.again > 0
    assert found.done_share == 1.0


def test_a_seed_tells_all_of_it(recording: Recording) -> None:
    first, second, other = (told(visit(recording, HARD, 4, HABITS, seed)[0]) for seed in (7, 7, 8))
    assert first == second
    assert first != other
