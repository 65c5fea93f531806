"""A server over an object store: while that is there, while it is away, and where it may only be
read.
"""

import json
import logging
import os
import pickle
import random
import shutil
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from isogi_core.errors import StoreAwayError
from isogi_core.plan.assembly import load_scene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.folder import Copies
from isogi_core.storage.store import Store
from isogi_server.api.app import create_app
from isogi_server.api.routes import frames as completion
from isogi_server.api.routes.events import resumed
from isogi_server.cli.command import run
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from isogi_worker import pool
from isogi_worker.pool import Done
from isogi_worker.tasks import BakeTask
from tests.live import live
from tests.s3 import ACCESS_KEY, SECRET_KEY, Call, Fault, S3Server
from tests.server.inline import LONG, InlinePool, chunks_in, view_of
from tests.server.sockets import wait_for

ROOT = Path(__file__).resolve().parents[3]
VIEW = {"width": 40, "height": 40}
OTHER = {**VIEW, "isovalue": 0.3}


@pytest.fixture(autouse=True)
def sent(hasty: None, monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """What travels to the workers; and the probe's findings stand for no time."""
    tasks = list[bytes]()
    submit = InlinePool.submit

    def noted(workers: InlinePool, task: BakeTask, done: Done) -> None:
        tasks.append(pickle.dumps(task))
        submit(workers, task, done)

    monkeypatch.setattr(InlinePool, "submit", noted)
    monkeypatch.setattr("isogi_server.render.stores.FINDING_SECONDS", 0.0)
    return tasks


@contextmanager
def server(scene: Path, store: str | Path, copies: Copies | None = None) -> Iterator[httpx.Client]:
    """A client of a server over the store, once it is ready."""
    opened = Store(StoreUrl(str(store), seconds=2.0, retries=0), copies=copies)
    with (
        live(create_app(RenderEngine([load_scene(scene)], opened), Settings())) as url,
        httpx.Client(base_url=url) as client,
    ):
        client.timeout = httpx.Timeout(LONG)
        yield client


def frame(client: httpx.Client, view: dict[str, Any], wait: float = 0.0) -> httpx.Response:
    """A frame of the only scene."""
    return client.get(
        "/v1/scenes/small/frame", params={**view, "f": "npy", "wait_ms": int(1000 * wait)}
    )


def final(client: httpx.Client, view: dict[str, Any]) -> bytes:
    """The frame once it is final; the store may be away at first."""
    assert wait_for(
        lambda: frame(client, view, wait=5.0).headers.get("isogi-provisional") == "?0", LONG
    )
    return frame(client, view).content


@pytest.fixture(scope="module")
def pictures(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Both views as they look over a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "start_pool", InlinePool)
        with server(small_scene, tmp_path_factory.mktemp("light")) as client:
            return [final(client, view) for view in (VIEW, OTHER)]


def test_light_comes_from_a_bucket_as_from_a_folder(
    small_scene: Path, s3: S3Server, pictures: list[bytes]
) -> None:
    with server(small_scene, s3.url) as client:
        assert final(client, VIEW) == pictures[0]
    with server(small_scene, s3.url) as client:
        assert "provisional=0.000" in frame(client, VIEW).headers["isogi-coverage"]
        assert client.get("/v1/scenes/small").json()["read_only"] is False


def test_light_is_final_after_answers_were_damaged(
    small_scene: Path, s3: S3Server, pictures: list[bytes], tmp_path: Path
) -> None:
    """A damaged answer is not kept as a copy, which the store would confirm for ever."""
    flipped: set[str] = set()

    def flip(call: Call) -> Fault | None:
        """Damage the first answer with each chunk, which is the one to a frame."""
        if call.method != "GET" or "/c/" not in call.key or call.key in flipped:
            return None
        flipped.add(call.key)
        return "flip"

    with server(small_scene, s3.url) as client:
        assert final(client, VIEW) == pictures[0]
        assert final(client, OTHER) == pictures[1]
    with server(small_scene, s3.url, Copies(s3.url, 1 << 24, tmp_path)) as client:
        s3.fault = flip
        assert frame(client, VIEW).status_code == frame(client, OTHER).status_code == 200
        assert flipped
        s3.fault = lambda _: None
        assert final(client, VIEW) == pictures[0]
        assert final(client, OTHER) == pictures[1]
    with server(small_scene, s3.url, Copies(s3.url, 1 << 24, tmp_path)) as client:
        assert final(client, VIEW) == pictures[0], "also after a restart"


DAMAGED_SECONDS = 60.0
ONE_IN = 100
"""One answer in ONE_IN is damaged for DAMAGED_SECONDS, and none after that."""

RECOVERY_SECONDS = 10.0
"""Seconds after the last damage within which pictures are final again."""


@pytest.mark.slow
@pytest.mark.long
def test_a_minute_of_damaged_answers_is_over_soon(
    small_scene: Path, s3: S3Server, pictures: list[bytes], tmp_path: Path
) -> None:
    """Meanwhile servers start and draw known and new views; the last server goes on afterwards."""
    chance = random.Random(7)
    flipped: list[str] = []

    def flip(call: Call) -> Fault | None:
        if call.method != "GET" or chance.random() * ONE_IN >= 1.0:
            return None
        flipped.append(call.key)
        return "flip"

    with server(small_scene, s3.url) as client:
        assert final(client, VIEW) == pictures[0]
        assert final(client, OTHER) == pictures[1]
    s3.fault = flip
    until = time.monotonic() + DAMAGED_SECONDS
    rounds = 0
    while time.monotonic() < until or not flipped:
        rounds += 1
        assert rounds < 1000
        with server(small_scene, s3.url, Copies(s3.url, 1 << 24, tmp_path)) as client:
            new = {**VIEW, "isovalue": 0.3 + 0.001 * rounds}
            for view in (VIEW, OTHER, new):
                assert frame(client, view).status_code in (200, 503)
            if time.monotonic() < until:
                continue
            s3.fault = lambda _: None
            for view, picture in ((VIEW, pictures[0]), (OTHER, pictures[1])):
                assert wait_for(
                    lambda: final_now(client, view),  # noqa: B023 (called before the next view)
                    RECOVERY_SECONDS,
                )
                assert frame(client, view).content == picture
    assert flipped and not s3.fault(s3.calls[-1])


def final_now(client: httpx.Client, view: dict[str, Any]) -> bool:
    """Return True if a view is final within a second."""
    return frame(client, view, wait=1.0).headers.get("isogi-provisional") == "?0"


def test_a_store_that_is_away_is_not_empty_and_baking_waits(
    small_scene: Path, s3: S3Server, pictures: list[bytes]
) -> None:
    with server(small_scene, s3.url) as client:
        s3.fault = lambda call: "no-bucket"
        answer = frame(client, VIEW)
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
        assert answer.headers["content-type"] == "application/problem+json"
        assert s3.url in answer.json()["detail"] and "is gone" in answer.json()["detail"]
        ready = client.get("/bakez")
        assert (ready.status_code, ready.json()["ready"]) == (
            503,
            False,
        ) and "is gone" in ready.json()["reasons"][0]
        assert client.get("/livez").status_code == 200
        s3.fault = lambda call: None
        assert final(client, VIEW) == pictures[0]
        s3.fault = lambda call: "drop"
        assert frame(client, VIEW).content == pictures[0], "what is in memory is shown on"
        assert frame(client, OTHER).headers["isogi-provisional"] == "?1"
        s3.fault = lambda call: None
        assert final(client, OTHER) == pictures[1]
        assert wait_for(lambda: client.get("/bakez").status_code == 200, LONG)


def test_a_store_that_hangs_holds_a_frame_for_one_call(
    small_scene: Path, s3: S3Server, pictures: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tries and checks of 6 seconds each once held it for 12, and one frame after the other."""
    monkeypatch.setattr("isogi_core.storage.store.CHECKED", 1.0)
    opened = Store(StoreUrl(s3.url, seconds=2.0, retries=2))
    app = create_app(RenderEngine([load_scene(small_scene)], opened), Settings())
    with live(app) as url, httpx.Client(base_url=url, timeout=LONG) as client:
        assert wait_for(lambda: client.get("/bakez").status_code == 200, LONG)
        s3.fault = lambda call: "hang"
        begun = time.monotonic()
        answers = [frame(client, VIEW) for _ in range(3)]
        assert time.monotonic() - begun < 6.0
        assert [answer.status_code for answer in answers] == 3 * [503]
        assert "does not answer" in answers[0].json()["detail"]
        s3.fault = lambda call: None
        assert final(client, VIEW) == pictures[0]


def test_a_bake_that_loses_its_store_waits_and_goes_on_by_itself(
    small_scene: Path, s3: S3Server, pictures: list[bytes]
) -> None:
    with server(small_scene, s3.url) as client:
        s3.fault = lambda call: 503 if call.method == "PUT" else None
        first = frame(client, VIEW)
        assert first.headers.get("isogi-provisional") == "?1", first.text
        assert wait_for(lambda: len([call for call in s3.calls if call.method == "PUT"]) > 12, LONG)
        assert "503 Service Unavailable" in client.get("/bakez").json()["reasons"][0]
        assert "isogi_chunks_given_up 0.0" in client.get("/metrics").text
        s3.fault = lambda call: None
        assert final(client, VIEW) == pictures[0]


def test_a_store_that_may_only_be_read_shows_what_it_has(
    small_scene: Path, s3: S3Server, pictures: list[bytes], sent: list[bytes]
) -> None:
    with server(small_scene, s3.url) as client:
        final(client, VIEW)
    kept = dict(s3.objects)
    sent.clear()
    s3.fault = lambda call: 403 if call.method in ("PUT", "DELETE", "POST") else None
    with server(small_scene, s3.url) as client:
        assert final(client, VIEW) == pictures[0]
        answer = frame(client, OTHER, wait=5.0)
        assert (answer.status_code, answer.headers["isogi-provisional"]) == (200, "?1")
        (reason,) = client.get("/bakez").json()["reasons"]
        facts = client.get("/v1/scenes/small").json()
        assert (
            "can only be read" in reason
            and facts["read_only"]
            and facts["plan"]["notes"][-1] == reason
        )
        events = client.get("/v1/scenes/small/events", params=OTHER).text
        assert "event: failed" in events and "can only be read" in events
        begun = client.get(
            "/v1/scenes/small/frame", params=OTHER, headers={"Prefer": "respond-async"}
        )
        link = begun.headers["location"]
        assert wait_for(lambda: client.get(link).json()["status"] == "failed", LONG)
        assert "can only be read" in client.get(link).json()["message"]
    assert s3.objects == kept and sent == []


async def test_listeners_are_told_that_light_cannot_be_read() -> None:
    async def rest() -> AsyncGenerator[bytes, None]:
        yield b"second"
        raise StoreAwayError("The store is gone.")

    *events, last = [each async for each in resumed(b"first", rest())]
    assert (
        events == [b"first", b"second"]
        and b"event: failed" in last
        and b"The store is gone." in last
    )


async def test_a_job_waits_for_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(completion, "AWAY", 0.0)
    told: list[str] = []
    shown: list[Any] = [StoreAwayError("The store is gone."), SimpleNamespace(final=True)]

    async def draw(*_: Any) -> Any:
        if isinstance(next_one := shown.pop(0), Exception):
            raise next_one
        return next_one

    engine = SimpleNamespace(bake_of=lambda *_: "bake")
    updates = SimpleNamespace(newest=lambda _: 0)
    nothing = {"rank": lambda *_: None, "leave": lambda _: None}
    service: Any = SimpleNamespace(engine=engine, updates=updates, frame=draw, **nothing)
    job: Any = SimpleNamespace(report=lambda share, message: told.append(message))
    order: Any = SimpleNamespace(scene="small", view=None)
    frame = await completion.complete(service, order, job)
    assert frame.final and told == ["The store is gone."]


def test_secrets_are_told_to_nobody(
    small_scene: Path, s3: S3Server, sent: list[bytes], caplog: pytest.LogCaptureFixture
) -> None:
    told = []
    with caplog.at_level(logging.DEBUG), server(small_scene, s3.url) as client:
        final(client, VIEW)
        for fault in (403, 500, "no-bucket", "drop"):
            s3.fault = lambda call, fault=fault: fault  # type: ignore[misc]
            paths = (
                "/bakez",
                "/metrics",
                "/v1/scenes/small",
                "/v1/scenes/small/frame?width=9&height=9&isovalue=0.4",
            )
            told += [client.get(path).text for path in paths]
    assert len(sent) > 0 and len(caplog.records) > 0
    told += [str(task) for task in sent] + [record.getMessage() for record in caplog.records]
    told += [json.dumps(call.__dict__) for call in s3.calls] + [
        data.decode("latin-1") for data in s3.objects.values()
    ]
    for secret in (SECRET_KEY, ACCESS_KEY):
        assert not [text for text in told if secret in text]


@pytest.mark.slow
def test_workers_use_the_credentials_of_their_own_environment(
    small_scene: Path, s3: S3Server, tmp_path: Path
) -> None:
    command = [
        sys.executable,
        "-m",
        "server",
        "render",
        str(small_scene),
        "-o",
        "frame.png",
        "--store",
        s3.url,
    ]
    done = subprocess.run(
        [*command, "--workers", "1", "--width", "24", "--height", "24", "--json"],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["final"] == 1.0
    assert [key for key in s3.objects if "/c/" in key]
    assert SECRET_KEY not in done.stdout + done.stderr


@pytest.mark.parametrize(
    "command", [["serve", "--port", "0"], ["render", "demo:orbital", "-o", "frame.png"]]
)
def test_a_password_on_the_command_line_is_wrong_use(
    command: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*command, "--store", "s3://me:hunter2@bucket/light"]) == 2
    out, error = capsys.readouterr()
    assert (
        out == ""
        and error.count("\n") == 1
        and "hunter2" not in error
        and "the environment" in error
    )


def test_a_store_that_is_not_there_is_told_in_one_line(
    tmp_path: Path, small_scene: Path, s3: S3Server
) -> None:
    s3.fault = lambda call: "no-bucket"
    with pytest.raises(
        StoreAwayError,
        match=r"^Cannot make a place for light at the store at s3://.*404 Not Found\.$",
    ):
        RenderEngine(
            [load_scene(small_scene)], Store(StoreUrl(s3.url, seconds=1.0, retries=0))
        ).start(with_workers=False)


def baked(scene: Path, store: Path, scheduler: str | None) -> dict[str, str]:
    """The chunks of a view, baked after the scene's folder went away where workers are joined."""
    shown = load_scene(scene)
    with closing(RenderEngine([shown], str(store), scheduler=scheduler)) as engine:
        engine.start(with_workers=False)
        if scheduler:
            scene.parent.rename(scene.parent.with_name("gone"))
        engine.start_workers()
        assert not engine.frame(shown.id, view_of(shown), wait=LONG).provisional
    return {
        name: digest
        for name, digest in chunks_in(store).items()
        if not name.startswith(("volumes", "files"))
    }


def test_workers_elsewhere_bake_the_same_without_the_files(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the scene was made of goes through the store."""
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    shutil.copytree(small_scene.parent, tmp_path / "scene")
    own = baked(small_scene, tmp_path / "own", None)
    joined = baked(
        tmp_path / "scene" / small_scene.name, tmp_path / "joined", "tcp://elsewhere:8786"
    )
    assert own and joined == own
    assert not (tmp_path / "own" / "volumes").exists()
    assert len(list((tmp_path / "joined" / "volumes").iterdir())) == 1
    assert len(list((tmp_path / "copies").glob("*.voxels"))) == 1
