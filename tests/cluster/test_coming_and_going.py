"""Processes of a cluster come and go, and refuse strangers; however many bake, the bytes are the
same.
"""

from contextlib import closing
from pathlib import Path

import pytest
from distributed import LocalCluster

from isogi_core.plan.assembly import load_scene
from isogi_server.render.engine import RenderEngine
from isogi_worker import pool
from tests.cluster.intruder import fallen, ports_of
from tests.cluster.processes import (
    DASK,
    DOCUMENTED,
    HEALTH,
    LONG,
    OWN,
    QUIET,
    Cluster,
    end,
    final,
    metric,
    named,
    reasons,
    status,
    until,
    write_certificates,
)
from tests.server.inline import InlinePool, chunks_in, view_of


@pytest.mark.cluster
@pytest.mark.long
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


def test_the_commands_of_the_documentation_name_them_all() -> None:
    started = [
        line for line in DOCUMENTED.splitlines() if line.startswith(("dask ", "isogi serve"))
    ]
    assert len(started) == 3
    assert all(f"export {name}='{value}'" in DOCUMENTED for name, value in HEALTH.items())
    for line, options in zip(started, (DASK, DASK, OWN), strict=True):
        assert " ".join(named(options, Path())) in line


@pytest.mark.cluster
def test_a_scheduler_refuses_strangers(tmp_path: Path) -> None:
    """A worker with the certificates of another authority, and one without any."""
    write_certificates(tmp_path)
    with Cluster() as running:
        running.scheduler()
        strangers = [running.worker(*known) for known in (named(DASK, tmp_path), QUIET)]
        assert all(stranger.wait(LONG) != 0 for stranger in strangers)


WORKERS = 2


def baked(scene_file: Path, store: Path, scheduler: str | None = None) -> dict[str, str]:
    """The digests of the chunks that a view leaves in an empty store."""
    scene = load_scene(scene_file)
    with closing(RenderEngine([scene], str(store), 1, scheduler)) as engine:
        engine.start()
        assert not engine.frame(scene.id, view_of(scene), wait=LONG).provisional
    return chunks_in(store)


@pytest.mark.long
@pytest.mark.cluster
def test_however_many_bake_the_bytes_are_the_same(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(pool, "start_pool", InlinePool)
        alone = baked(small_scene, tmp_path / "alone")
    assert alone
    address = "127.0.0.1:0"
    with LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, dashboard_address=address, silence_logs=50
    ) as others:
        assert baked(small_scene, tmp_path / "joined", others.scheduler_address) == alone
