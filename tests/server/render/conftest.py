"""What tests of engines share."""

from pathlib import Path

import pytest

from tests.server.buckets import engine_at, picture
from tests.server.inline import InlinePool, chunks_in
from worker import pool


@pytest.fixture(scope="module")
def whole(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, dict[str, str]]:
    """A view as one server over a folder leaves it, and its chunks."""
    folder = tmp_path_factory.mktemp("light")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "WorkerPool", InlinePool)
        with engine_at(small_scene, str(folder)) as engine:
            return picture(engine), chunks_in(folder)
