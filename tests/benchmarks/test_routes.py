"""The most that requests of each route take, and requests that Schemathesis makes of the API's own
document.
"""

from pathlib import Path

import pytest

from benchmarks.common.serving import serving
from benchmarks.service.hostile import PROGRAM, generated, program
from benchmarks.service.routes import COSTLIEST, routes
from isogi_server.api.app import create_app
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from tests.benchmarks.parts import figures
from tests.loaded import load_scene


def test_each_route_has_its_costliest_requests(tmp_path: Path) -> None:
    engine = RenderEngine([load_scene("demo:orbital")], tmp_path, workers=1)
    document = create_app(engine, Settings()).openapi()
    assert COSTLIEST.keys() == document["paths"].keys()


@pytest.mark.slow
@pytest.mark.long
def test_twelve_of_the_costliest_pictures_fit_into_memory() -> None:
    """Those that take most draw pictures, or list chunks."""
    drawn = [f"--only={path}" for path in ("/frame", "/coverage", "/events", "/card/chunks")]
    found = figures(routes, "demo:casting", "--at-once", "12", "--seconds", "5", *drawn)
    assert found["requests"] >= 13 and found["answered 5xx"] == 0
    assert 0.0 < found["highest memory of the server, MiB"] < 1500.0


@pytest.mark.long
@pytest.mark.slow
def test_twelve_of_the_costliest_requests_fit_into_memory() -> None:
    found = figures(routes, "demo:casting", "--at-once", "12", "--seconds", "20")
    assert found["requests"] > 30 and found["answered 5xx"] == 0
    assert 0.0 < found["highest memory of the server, MiB"] < 1500.0


@pytest.mark.slow
@pytest.mark.long
def test_no_generated_request_makes_the_server_fail(tmp_path: Path) -> None:
    assert program(), f"{PROGRAM} is a tool of development: make the environment again"
    with serving("demo:orbital", f"{tmp_path}/light", 1) as served:
        counts, lacking = generated(served, tmp_path, 150)
        assert not lacking and counts[200] > 0
        assert max(counts) < 500, counts
        assert served.client.get("/livez").status_code == 200
