"""Schedulers, workers and servers come and go; what is asked for is baked all the same."""

from pathlib import Path

import pytest

from tests.cluster.intruder import fallen, ports_of
from tests.cluster.processes import Cluster, cluster, end, final, metric, reasons, status, until

pytestmark = pytest.mark.slow


def test_scheduler_workers_and_servers_come_and_go(small_scene: Path, tmp_path: Path) -> None:
    """And no port of theirs lets another user in."""
    with cluster(workers=0) as running:
        one, first = running.server(small_scene, str(tmp_path))
        until(lambda: "No worker has joined" in reasons(first))
        assert status(first, "/v1/scenes/small/frame", width=16, height=16) == 200

        worker = running.worker()
        until(lambda: reasons(first) == "")
        picture = final(first)

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


def test_a_scheduler_that_is_started_again_is_joined_again(small_scene: Path, tmp_path: Path) -> None:
    with Cluster() as running:
        scheduler = running.scheduler()
        _, client = running.server(small_scene, str(tmp_path))
        until(lambda: "No worker has joined" in reasons(client))
        assert status(client, "/v1/scenes/small/frame", width=40, height=40, azimuth=30) == 200
        until(lambda: metric(client, "isogi_tasks_in_flight") > 0)

        end(scheduler)
        until(lambda: "cannot be reached at the moment" in reasons(client))
        until(lambda: metric(client, "isogi_tasks_in_flight") == 0)
        assert status(client, "/v1/scenes/small/frame", width=40, height=40, azimuth=30) == 200

        running.scheduler()
        running.worker()
        until(lambda: reasons(client) == "")
        assert final(client)
        assert metric(client, "isogi_tasks_failed_total") == 0.0
        assert metric(client, "isogi_worker_deaths_total") == 0.0
