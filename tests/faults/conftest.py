"""Fixtures of the tests of faults."""

from collections.abc import Iterator
from itertools import count

import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from tests.faults.bench import Bench
from tests.faults.failpoints import FOLDER, run_failing_worker
from tests.live import live


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    scene = load_scene(
        "demo:orbital", lattice=0.5, bounces=1, order=2, indirect_order=2, target_error=0.3
    )
    store = tmp_path_factory.mktemp("light")
    armed = tmp_path_factory.mktemp("failpoints")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isogi_worker.local_pool.run_worker", run_failing_worker)
        patch.setenv(FOLDER, str(armed))
        engine = RenderEngine([scene], str(store), workers=1)
        with live(create_app(engine, Settings())) as url:
            yield Bench(engine, scene, url, store, armed, (0.03 + 0.0004 * n for n in count()))
