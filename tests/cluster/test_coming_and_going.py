"""Schedulers, workers and servers come and go; what is asked for is baked all the same."""

from pathlib import Path

import pytest

from tests.cluster.intruder import fallen, ports_of
from tests.cluster.processes import Cluster, end, final, metric, reasons, status, until

pytestmark = pytest.mark.cluster


def test_scheduler_workers_and_servers_come_and_go(small_scene: Path, tmp_path: Path) -> None:
    """And no port of theirs lets another user in."""
    with Cluster() as running:
        scheduler = running.scheduler()
        one, first = running.server(small_scene, str(tmp_path))
        until(lambda: "No worker has joined" in reasons(first))
        assert status(first, "/v1/scenes/small/frame", width=40, height=40, azimuth=30) == 200
        until(lambda: metric(first, "isogi_tasks_in_flight") > 0)

        end(scheduler)
        until(lambda: "cannot be reached at the moment" in reasons(first))
        until(lambda: metric(first, "isogi_tasks_in_flight") == 0)
        assert status(first, "/v1/scenes/small/frame", width=40, height=40, azimuth=30) == 200

        running.scheduler()
        worker = running.worker()
        until(lambda: reasons(first) == "")
        picture = final(first)
        assert metric(first, "isogi_tasks_failed_total") == 0.0
        assert metric(first, "isogi_worker_deaths_total") == 0.0

        _, second = running.server(small_scene, str(tmp_path))
        until(lambda: reasons(second) == "")
        before = metric(first, "isogi_paths_total")
        assert final(second) == picture
        assert metric(second, "isogi_paths_total") == 0.0

        running.worker()
        until(lambda: metric(second, "isogi_workers") == 2.0)
        ports = ports_of(*running.alive())
        assert len(ports) >= 9
        assert fallen(ports) == []
        end(worker)
        until(lambda: metric(second, "isogi_worker_deaths_total") == 1.0)
        final(second, azimuth=120.0)
        assert final(first, azimuth=120.0) == final(second, azimuth=120.0)
        assert metric(first, "isogi_paths_total") == before

        end(one)
        assert final(second, azimuth=210.0)
