"""An engine that answers no requests."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.render.engine import RenderEngine


@pytest.fixture
def engine(small_scene: Path, tmp_path: Path) -> Iterator[RenderEngine]:
    """An engine of the scene ``small`` that is not started."""
    with closing(RenderEngine([load_scene(small_scene)], tmp_path / "light", workers=1)) as engine:
        yield engine
