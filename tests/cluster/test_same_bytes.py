"""In this process or in a cluster, by one thread or by several workers: the same view leaves the same bytes.

Workers of the server's own are held against a thread of this process in ``tests/worker/test_kill.py``.
"""

from contextlib import closing
from pathlib import Path

import pytest
from distributed import LocalCluster

from isogi_core.plan.assembly import load_scene
from server.render.engine import RenderEngine
from tests.server.inline import InlinePool, chunks_in, view_of
from worker import pool

pytestmark = pytest.mark.cluster
LONG = 240.0
WORKERS = 2


def baked(scene_file: Path, store: Path, scheduler: str | None = None) -> dict[str, str]:
    """The digests of the chunks that a view leaves in an empty store."""
    scene = load_scene(scene_file)
    with closing(RenderEngine([scene], str(store), 1, scheduler)) as engine:
        engine.start()
        assert not engine.frame(scene.id, view_of(scene), wait=LONG).provisional
    return chunks_in(store)


def test_however_many_bake_the_bytes_are_the_same(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(pool, "WorkerPool", InlinePool)
        alone = baked(small_scene, tmp_path / "alone")
    assert alone
    address = "127.0.0.1:0"
    with LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=address, silence_logs=50) as others:
        assert baked(small_scene, tmp_path / "joined", others.scheduler_address) == alone
