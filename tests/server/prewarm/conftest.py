"""A scene of several chunks with one layer of light, which is baked in seconds."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.server.inline import InlinePool

SCENE = """\
volume = "small.nrrd"
isovalue = 0.5
isovalues = [0.2, 0.8]
bounces = 2
target_error = 0.1
research = { chunk = 8 }
[[lights]]
type = "constant"
"""


@pytest.fixture(scope="session")
def blocks(small_scene: Path) -> Path:
    """The scene file: 18 chunks, lit from all sides."""
    path = small_scene.with_name("blocks.toml")
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def all_inline() -> Iterator[None]:
    """Have all bakes of a module run on a thread of this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isogi_worker.pool.start_pool", InlinePool)
        yield
