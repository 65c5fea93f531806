"""Each fault at each point of a chunk's life, and a chunk that kills whoever bakes it."""

import json
from pathlib import Path

import httpx
import pytest

from isogi_core.bake.noise import Goal
from tests.baking import bake_each_texel
from tests.faults.bench import LONG, Bench, bake_here, objects_in
from tests.faults.failpoints import FAULTS, POINTS
from tests.server.sockets import wait_for

pytestmark = pytest.mark.kill


def test_every_fault_at_every_point_costs_time_and_nothing_else(
    bench: Bench, tmp_path: Path
) -> None:
    """Nothing is given up, all views become final, and the store holds what an undisturbed bake
    leaves.

    At each point all faults come to one view, each to a chunk of its own.
    """
    for point in POINTS:
        view = bench.view()
        demands = bench.demands(view)
        assert len(demands) >= len(FAULTS)
        tokens = [
            bench.arm(point, f"{fault}@{'_'.join(map(str, demand.index))}")
            for fault, demand in zip(FAULTS, demands, strict=False)
        ]
        frame = bake_each_texel(bench.engine, bench.scene.id, view)
        assert wait_for(lambda: bench.engine.baker.unwritten == 0, LONG), "light is written late"
        assert not [token.name for token in tokens if token.exists()], "they were not reached"
        assert not frame.provisional, f"{point}: {bench.engine.trouble()}"
        bake_here(bench, demands, tmp_path)
    tally = bench.engine.baker.tally()
    assert (tally.given_up, tally.waiting) == (0, 0)
    assert tally.deaths >= len(POINTS)
    assert objects_in(bench.store) == objects_in(tmp_path)


def metric(bench: Bench, name: str) -> float:
    lines = httpx.get(f"{bench.url}/metrics").text.splitlines()
    return float(next(line.split()[-1] for line in lines if line.startswith(f"{name} ")))


def test_a_chunk_that_kills_its_workers_fails_alone(bench: Bench) -> None:
    view = bench.view()
    before = bench.engine.baker.tally()
    kept = set(objects_in(bench.store))
    demands = {demand.index: demand for demand in bench.demands(view)}
    poison = max(demands, key=lambda index: demands[index].weight)
    place = f"{bench.url}/v1/scenes/{bench.scene.id}"
    knobs = {"isovalue": view.isovalue, "azimuth": 20, "elevation": 15, "distance": 3, "fov": 30}
    knobs |= {"width": view.width, "height": view.height}
    arm = bench.arm("before_bake", f"kill@{'_'.join(map(str, poison))}", "always")
    with httpx.stream("GET", f"{place}/events", params=knobs, timeout=LONG) as answer:
        last = "".join(answer.iter_text()).strip().split("\n\n")[-1]
    arm.unlink()
    told = f"Chunk {poison} of orbital cannot be baked: the process that was to bake it died."
    assert (
        "event: failed" in last
        and told in json.loads(last.split("data: ")[1].splitlines()[0])["detail"]
    )
    tally = bench.engine.baker.tally()
    assert (tally.given_up, tally.waiting) == (1, 0)
    beside = len(demands)  # chunks of the same task fail once, and are tried alone
    assert 3 <= tally.failed - before.failed <= 3 + beside, "three tries (docs/faults.md)"
    assert metric(bench, "isogi_chunks_given_up") == 1
    assert told in httpx.get(f"{bench.url}/readyz").text
    coverage = httpx.get(f"{place}/coverage", params=knobs).json()
    frame = httpx.get(f"{place}/frame", params=knobs)
    assert frame.status_code == 200 and frame.headers["isogi-provisional"] == "?1"
    lacking = bench.engine.survey(
        bench.scene.id, view, Goal.checked(bench.scene.target_error)
    ).demands
    assert [demand.index for demand in lacking] == [poison], coverage
    assert {key.split("/c/")[1] for key in set(objects_in(bench.store)) - kept}.isdisjoint(
        {"/".join(map(str, poison))}
    )
