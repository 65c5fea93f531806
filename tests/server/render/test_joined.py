"""An engine whose workers stand elsewhere: what the scene was made of goes through the store."""

from contextlib import closing
from pathlib import Path

import pytest

from isogi_core.plan.assembly import load_scene
from server.render.engine import RenderEngine
from tests.server.inline import LONG, InlinePool, chunks_in, view_of
from worker import pool


@pytest.fixture(autouse=True)
def inline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))


def baked(scene: Path, store: Path, scheduler: str | None) -> dict[str, str]:
    """The chunks of a view, baked after the scene's folder went away where workers are joined."""
    shown = load_scene(scene)
    with closing(RenderEngine([shown], str(store), scheduler=scheduler)) as engine:
        engine.start(hire=False)
        if scheduler:
            scene.parent.rename(scene.parent.with_name("gone"))
        engine.hire()
        assert not engine.frame(shown.id, view_of(shown), wait=LONG).provisional
    return {name: digest for name, digest in chunks_in(store).items() if not name.startswith(("volumes", "files"))}


def test_workers_elsewhere_bake_the_same_without_the_files(small_scene: Path, tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    for path in small_scene.parent.iterdir():
        (tmp_path / "scene" / path.name).write_bytes(path.read_bytes())
    own = baked(small_scene, tmp_path / "own", None)
    joined = baked(tmp_path / "scene" / small_scene.name, tmp_path / "joined", "tcp://elsewhere:8786")
    assert own and joined == own
    assert not (tmp_path / "own" / "volumes").exists()
    assert len(list((tmp_path / "joined" / "volumes").iterdir())) == 1
    assert len(list((tmp_path / "copies").glob("*.voxels"))) == 1
