import json
import logging
import uuid
from pathlib import Path

import numpy as np
import pytest

from isogi_core.cache.costs import SAVE_EVERY, Cost, Costs
from isogi_core.storage.store import Store

GROUP = '{"zarr_format": 3, "node_type": "group", "attributes": %s}'


@pytest.fixture(params=["folder", "file://", "memory://"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    roots = {"folder": str(tmp_path / "light"), "file://": f"file://{tmp_path}/light"}
    return roots.get(request.param, f"memory://{uuid.uuid4().hex}")


def read(store: str | Path, digest: str = "digest") -> Costs:
    costs = Costs(store, digest)
    costs.read()
    return costs


def test_a_path_costs_its_chunks_rate_or_the_common_one(store: str) -> None:
    costs = read(store)
    assert costs.rate((0, 0, 0)) is None
    costs.add((0, 0, 1), Cost(8.0, 80, 5, 8.0))
    costs.add((0, 0, 2), Cost(4.0, 80, 5, 4.0))
    assert costs.rate((0, 0, 1)) == costs.rate((9, 9, 9)) == 0.05
    costs.add((0, 0, 1), Cost(3.0, 300, 0))
    assert costs.rate((0, 0, 1)) == costs.rate((0, 0, 2)) == pytest.approx(0.01)
    costs.add((0, 0, 2), Cost(40.0, 1000, 0))
    costs.add((0, 0, 3), Cost(98.0, 1016, 1, 8.0))
    costs.add((0, 0, 4), Cost(0.5, 0, 0))
    assert costs.rate((0, 0, 4)) == costs.rate((9, 9, 9)) == pytest.approx(0.04)
    assert costs.total == Cost(153.5, 2476, 11, 20.0)


def test_costs_are_known_after_a_restart(store: str) -> None:
    costs = read(store)
    costs.add((1, 20, 3), Cost(1.5, 100, 5, 0.1))
    costs.save()
    again = read(store)
    assert (again.rate((1, 20, 3)), again.total) == (pytest.approx(0.07), Cost(1.5, 100, 5, 0.1))
    assert read(store, "other").total == Cost()


def test_they_are_written_now_and_then(tmp_path: Path) -> None:
    now = 0.0
    costs = Costs(tmp_path, "digest", lambda: now)
    costs.save()
    costs.add((0, 0, 1), Cost(1.0, 100, 5, 0.5))
    costs.save(at_once=False)
    assert not list(tmp_path.iterdir())
    now = SAVE_EVERY
    costs.save(at_once=False)
    group = json.loads((tmp_path / "costs" / "digest" / "zarr.json").read_text())
    assert group["attributes"] == {"chunks": {"0/0/1": [1.0, 100, 5, 0.5]}}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        GROUP % "{}",
        *(GROUP % f'{{"chunks": {chunks}}}' for chunks in ("[]", '{"0/0": [1, 2, 3, 4]}', '{"0/0/1": [1]}')),
    ],
)
def test_what_is_damaged_counts_as_unknown(tmp_path: Path, text: str) -> None:
    (tmp_path / "costs" / "digest").mkdir(parents=True)
    (tmp_path / "costs" / "digest" / "zarr.json").write_text(text)
    assert read(tmp_path).total == Cost()


def test_what_could_not_be_kept_is_kept_later(tmp_path: Path) -> None:
    now, store = 0.0, tmp_path / "light"
    store.write_text("not a folder")
    costs = Costs(Store(store, clock=lambda: now), "digest", lambda: now)
    costs.add((0, 0, 1), Cost(1.0, 100, 5, 0.5))
    costs.save()
    store.unlink()
    costs.save(at_once=False)
    assert not store.exists()
    now = SAVE_EVERY
    costs.save(at_once=False)
    assert read(store).total == Cost(1.0, 100, 5, 0.5)


def test_the_common_rate_is_the_median_however_chunks_change() -> None:
    rng, costs, kept = np.random.default_rng(4), Costs("memory://median", "digest"), {}
    for index in rng.integers(0, 9, 40):
        cost = Cost(float(rng.random()), int(rng.integers(1, 100)))
        costs.add((0, 0, int(index)), cost)
        kept[int(index)] = kept.get(int(index), Cost()).plus(cost)
        assert costs.rate((9, 9, 9)) == pytest.approx(np.median([each.rate for each in kept.values()]))


def test_a_store_that_takes_no_costs_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "light").write_text("not a folder")
    costs = read(tmp_path / "light")
    costs.add((0, 0, 1), Cost(1.0, 100, 5, 0.5))
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        costs.save()
    assert "What the bake took cannot be kept" in caplog.text
