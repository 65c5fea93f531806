"""Embedded or in a cluster, with one, two or four workers: the same view leaves the same bytes."""

from contextlib import closing
from pathlib import Path

import pytest
from distributed import LocalCluster

from isogi_core.plan.assembly import load_scene
from server.render.engine import RenderEngine
from tests.server.inline import chunks_in, view_of

pytestmark = pytest.mark.slow
LONG = 240.0


def baked(scene_file: Path, store: Path, workers: int, scheduler: str | None = None) -> dict[str, str]:
    """The digests of the chunks that a view leaves in an empty store."""
    scene = load_scene(scene_file)
    with closing(RenderEngine([scene], str(store), workers, scheduler)) as engine:
        engine.start()
        assert not engine.frame(scene.id, view_of(scene), wait=LONG).provisional
    return chunks_in(store)


def test_however_many_bake_the_bytes_are_the_same(small_scene: Path, tmp_path: Path) -> None:
    alone = baked(small_scene, tmp_path / "alone", 1)
    assert alone
    assert baked(small_scene, tmp_path / "two", 2) == alone
    with LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as others:
        assert baked(small_scene, tmp_path / "four", 1, others.scheduler_address) == alone
