"""What tests of engines share."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from isogi_core.plan.scene import Scene
from isogi_server.render.engine import RenderEngine
from isogi_worker import pool
from tests.server.buckets import Begin, engine_at, picture
from tests.server.inline import InlinePool, chunks_in


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """The folder that engines of a test keep light in."""
    return tmp_path / "light"


@pytest.fixture
def begin(scene: Scene, store: Path) -> Iterator[Begin]:
    """Begins engines of a module's scene on one store; they are closed when the test ends."""
    with ExitStack() as engines:

        def begin(**more: Any) -> RenderEngine:
            engine = engines.enter_context(closing(RenderEngine([scene], store, **more)))
            engine.start()
            return engine

        yield begin


@pytest.fixture
def engine(begin: Begin, inline: None) -> RenderEngine:
    """An engine of a module's scene, begun, that bakes on a thread of this process."""
    return begin()


@pytest.fixture
def hasty(inline: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bake on a thread of this process, look often whether the store is back, and try again at once
    what failed.
    """
    monkeypatch.setattr("isogi_core.storage.store.CHECKED", 0.0)
    monkeypatch.setattr("isogi_core.storage.store.WRITE_RETRY_SECONDS", 0.0)
    monkeypatch.setattr("isogi_core.cache.scene_caches.ASK_AGAIN", 0.0)
    monkeypatch.setattr("isogi_worker.baker.SHORTEST_PAUSE", 0.01)
    monkeypatch.setattr("isogi_worker.baker.LONGEST_PAUSE", 0.01)


@pytest.fixture(scope="module")
def whole(
    small_scene: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[bytes, dict[str, str]]:
    """A view as one server over a folder leaves it, and its chunks."""
    folder = tmp_path_factory.mktemp("light")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "start_pool", InlinePool)
        with engine_at(small_scene, str(folder)) as engine:
            return picture(engine), chunks_in(folder)
