"""The benchmark of the cluster, small: the same bytes, a speed of each, and how they compare."""

import importlib
import json

import pytest
from click.testing import CliRunner

pytestmark = pytest.mark.slow


def test_cluster() -> None:
    arguments = ["demo:orbital", "--size", "24", "--tasks", "2", "--rounds", "1", "--workers", "1", "--same", "1"]
    main = importlib.import_module("benchmarks.cluster").main
    done = CliRunner().invoke(main, [*arguments, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    bytes_left = {value for name, value in found.items() if name.startswith("SHA-256")}
    assert len(bytes_left) == 1 and found["tasks"] == 2
    for kind in ("embedded 1", "joined 1"):
        ratio = found[f"{kind}: paths a second"] / found["bare copies 1: paths a second"]
        assert found[f"{kind} / bare copies"] == pytest.approx(ratio)
        assert (
            found[f"{kind} / bare copies, by processor seconds"]
            > 0.0
            < found[f"most memory of a worker of {kind}, MiB"]
        )
    assert "round 1 of 1" in done.stderr
