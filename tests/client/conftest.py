from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.live import serving


@pytest.fixture(scope="session")
def own_server(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """As ``live_server``, which other tests find without the light that these have it bake."""
    with serving(small_scene, tmp_path_factory.mktemp("store")) as url:
        yield url
