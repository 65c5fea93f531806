"""Fixtures that several rooms share."""

import gc
import logging
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import httpx
import nrrd
import numpy as np
import pytest

from isogi_core.frame import texel_reading
from isogi_core.model.demo import demo_volume
from tests.live import serving_with_a_worker
from tests.s3 import BUCKET, S3Server, environment_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserType

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One process more than there are cores, at most 5: tests of pages and servers wait more than
    they work.
    """
    return min((os.cpu_count() or 1) + 1, 5)


FIXTURES = {"browser": "browser", "live_server": "live", "standard_s3": "s3"}
"""Fixtures, and the marker that a test gets which uses one."""

ROOMS = {
    "benchmarks": "benchmark",
    **dict.fromkeys(["bake", "frame", "kernels", "report"], "light"),
    **dict.fromkeys(["server/exports", "server/prewarm", "server/render"], "light"),
    **dict.fromkeys(
        [
            "client",
            "cluster",
            "faults",
            "package",
            "server/api",
            "server/cli",
            "server/uploads",
            "worker",
        ],
        "live",
    ),
    "stability": "stability",
}
"""Folders, and the marker that each test in one gets."""

LONGEST = (
    *(
        "web/card/test_published.py",
        "worker/test_dask_pool.py",
        "docs/test_commands.py",
        "benchmarks/test_service.py",
    ),
    *(
        "web/card/test_pictures.py",
        "web/test_page.py",
        "web/test_slices.py",
        "web/test_live.py",
        "web/test_stale.py",
    ),
    *("web/test_lights.py", "web/test_manners.py", "web/test_upload.py"),
)
"""Files whose tests take longest, which run first: processes that share the files then end at about
the same time.
"""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by the fixtures they use and the folder they are in, before ``-m`` chooses; begin
    with ``LONGEST``.
    """
    for item in items:
        for marker in markers_of(item):
            item.add_marker(marker)
    places = {HERE / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))


def markers_of(item: pytest.Item) -> set[str]:
    """The markers that a test gets by itself."""
    folder = f"{item.path.relative_to(HERE).parent}/"
    by_folder = {marker for room, marker in ROOMS.items() if folder.startswith(f"{room}/")}
    return by_folder | {
        FIXTURES[name] for name in FIXTURES.keys() & set(getattr(item, "fixturenames", ()))
    }


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage while tests are collected, and never among the half a million objects
    that are left.

    Servers look for it while tests run.
    """
    gc.disable()
    yield
    gc.freeze()
    gc.enable()


@pytest.fixture
def anyio_backend() -> str:
    """What runs tests that are coroutines, each in a loop of its own."""
    return "asyncio"


@pytest.fixture(scope="session", autouse=True)
def no_uploads_unless_asked_for() -> Iterator[None]:
    """Leave the user's folder of uploads alone: one server has it at a time, and tests start
    many.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISOGI_UPLOADS_MB", "0")
        yield


@pytest.fixture(scope="session", autouse=True)
def one_list_of_authorities() -> Iterator[None]:
    """Let clients share what they trust: each of them reads all certificates of the web, and tests
    make thousands.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "httpx._transports.default.create_ssl_context", lru_cache(httpx.create_ssl_context)
        )
        yield


@pytest.fixture(scope="session", autouse=True)
def patient_clients() -> Iterator[None]:
    """Let clients wait where they set no time: beside other tests an answer takes longer than
    httpx's five seconds.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("httpx._config.DEFAULT_TIMEOUT_CONFIG.read", 60.0)
        yield


@pytest.fixture(scope="session", autouse=True)
def one_volume_of_each_demo() -> Iterator[None]:
    """Let scenes share their demo's volume, which nobody changes: to make it takes longer than most
    tests of it.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isogi_core.plan.volumes.opening.demo_volume", lru_cache(demo_volume))
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real volumes and probes; the test skips, saying why, where it is absent."""
    folder = Path(os.environ.get("ISOGI_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real volumes at {folder}: set ISOGI_SHARED_DATA to a folder that has them")
    return folder


@pytest.fixture(scope="module")
def browsers() -> "Iterator[BrowserType]":
    """What opens browsers: one at a time in a process. Its event loop ends with it, so that other
    files have theirs.
    """
    from playwright.sync_api import sync_playwright  # which few tests need, and takes a while

    with sync_playwright() as playwright:
        yield playwright.chromium


@pytest.fixture(scope="module")
def browser(browsers: "BrowserType") -> "Iterator[Browser]":
    """A browser, one for each file of tests."""
    from tests.web.visits import CHROMIUM, FLAGS

    chromium = browsers.launch(executable_path=str(CHROMIUM), args=FLAGS)
    yield chromium
    chromium.close()


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch) -> Iterator[S3Server]:
    """An object store that this process, and those that it starts, have the keys of."""
    with S3Server() as server:
        for name, value in server.environment.items():
            monkeypatch.setenv(name, value)
        yield server


@pytest.fixture(scope="session")
def motos() -> Iterator[str]:
    """The address of moto's server: a standard S3, that somebody else has made; with an empty
    bucket.
    """
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    logging.getLogger("werkzeug").setLevel(logging.WARNING)
    server.start()
    host, port = server.get_host_and_port()
    httpx.put(f"http://{host}:{port}/{BUCKET}").raise_for_status()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def standard_s3(motos: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """A place in a bucket of a standard S3, that this process, and those that it starts, have the
    keys of.
    """
    for name, value in environment_of(motos).items():
        monkeypatch.setenv(name, value)
    return f"s3://{BUCKET}/light-{uuid4().hex}"


SMALL_SCENE = """\
volume = "small.nrrd"
isovalue = 0.5
isovalues = [0.2, 0.8]
bounces = 1
lattice = 0.5
target_error = 0.5
[[lights]]
type = "constant"
radiance = 0.5
[[lights]]
type = "sky"
sun_azimuth = 30
sun_elevation = 50
"""


@pytest.fixture(scope="session")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene file whose light bakes in seconds: two balls that touch, 24 × 20 × 16 voxels."""
    folder = tmp_path_factory.mktemp("scene")
    z, y, x = np.mgrid[:16, :20, :24]
    balls = [
        np.exp(-(((x - cx) / 5) ** 2) - ((y - 9.5) / 5) ** 2 - ((z - 7.5) / 4) ** 2)
        for cx in (8, 16)
    ]
    nrrd.write(str(folder / "small.nrrd"), sum(balls).astype(np.float32), index_order="C")
    (folder / "small.toml").write_text(SMALL_SCENE)
    return folder / "small.toml"


@pytest.fixture(scope="session")
def live_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that ``live_server`` bakes into."""
    return tmp_path_factory.mktemp("store")


@pytest.fixture(scope="session")
def live_server(small_scene: Path, live_store: Path) -> Iterator[str]:
    """Base URL of a ready isogi on a real socket, with one worker and the scene ``small``."""
    with serving_with_a_worker(small_scene, live_store) as url:
        yield url


@pytest.fixture
def unfiltered(monkeypatch: pytest.MonkeyPatch) -> None:
    """No light is so grainy that it is filtered: what is drawn of whole chunks is what a view
    draws, to the bit.
    """
    none = property(lambda reading: np.zeros(len(reading.samples), np.bool_))
    monkeypatch.setattr(texel_reading.Reading, "grainy", none)
