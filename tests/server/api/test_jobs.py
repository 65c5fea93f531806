"""Jobs: how they begin, what becomes of them, and that who dismisses one has nothing more baked."""

import asyncio
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast

import httpx
import pytest

from isogi_core.errors import StoreError
from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.api.routes.jobs import SCHEMA
from isogi_server.errors import BusyError, UnknownJobError
from isogi_server.render.engine import RenderEngine
from isogi_server.render.jobs import Job, Jobs, Result, Status
from isogi_server.settings import Settings
from isogi_worker.baker import Baker
from isogi_worker.pool import WorkerPool
from tests.client.lab import Broken
from tests.live import live, serving
from tests.server.idle import Idle, idle_server
from tests.server.inline import LONG
from tests.server.jobs import until_over

SOON = 2.0
ASYNC = {"Prefer": "respond-async"}
FRAME = "/v1/scenes/small/frame"
VIEW: dict[str, Any] = {"width": 40, "height": 36, "azimuth": 211, "elevation": 12}
RESULT = Result("/there", "image/png", "A picture")


async def nothing(job: Job) -> list[Result]:
    return [RESULT]


async def endless(job: Job) -> list[Result]:
    job.report(0.25, "A quarter.")
    await asyncio.Event().wait()
    return []


async def settle() -> None:
    for _ in range(3):
        await asyncio.sleep(0)


async def test_a_job_runs_from_accepted_to_successful() -> None:
    jobs = Jobs(1)
    job = jobs.begin("test", "A test", nothing)
    assert (job.status, job.progress, job.started, job.expires) == (Status.ACCEPTED, 0, None, None)
    await settle()
    assert (job.status, job.progress, job.results) == (Status.SUCCESSFUL, 100, (RESULT,))
    assert job.started and job.finished and job.created <= job.started <= job.finished
    assert jobs.find(job.id) is job


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (StoreError("The store is full."), "The store is full."),
        (KeyError("secret"), "its log says why"),
    ],
)
async def test_a_job_that_fails_says_why_and_no_more_than_that(
    error: Exception, message: str
) -> None:
    async def fail(job: Job) -> list[Result]:
        job.report(0.5, "Half of it.")
        raise error

    job = Jobs(1).begin("test", "A test", fail)
    await settle()
    assert (job.status, job.progress) == (Status.FAILED, 50)
    assert message in job.message
    assert "secret" not in job.message


def test_progress_never_falls() -> None:
    job = Job("test", "A test")
    shares = []
    for share in (0.1, 0.5, 0.3, 0.999):
        job.report(share, "")
        shares.append(job.progress)
    assert shares == [10, 50, 50, 99]


async def test_jobs_are_limited_and_a_dismissed_one_makes_room() -> None:
    jobs = Jobs(2)
    first, _ = (jobs.begin("test", "A test", endless) for _ in range(2))
    await settle()
    with pytest.raises(BusyError, match="2 jobs are at work"):
        jobs.begin("test", "A test", nothing)
    assert (await jobs.dismiss(first.id)).status is Status.DISMISSED
    await settle()
    jobs.begin("test", "A test", nothing)
    await jobs.close()


async def test_a_job_is_dismissed_before_it_begins_too() -> None:
    jobs = Jobs(1)
    job = jobs.begin("test", "A test", endless)
    await jobs.dismiss(job.id)
    assert (job.status, job.started) == (Status.DISMISSED, None)


async def test_what_a_job_says_after_its_end_does_not_count() -> None:
    async def stubborn(job: Job) -> list[Result]:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            return [RESULT]
        return []

    jobs = Jobs(1)
    job = jobs.begin("test", "A test", stubborn)
    await settle()
    job = await jobs.dismiss(job.id)
    assert (job.status, job.progress, job.results) == (Status.DISMISSED, 0, ())


async def test_all_jobs_end_as_dismissed_where_the_server_stops() -> None:
    jobs = Jobs(2)
    running, over = (jobs.begin("test", "A test", work) for work in (endless, nothing))
    await settle()
    await jobs.close()
    assert (running.status, running.progress) == (Status.DISMISSED, 25)
    assert "stopped" in running.message
    assert over.status is Status.SUCCESSFUL


async def test_ended_jobs_are_forgotten_by_age_and_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("isogi_server.render.jobs.MOST_KEPT", 3)
    jobs = Jobs(9)
    running = jobs.begin("test", "A test", endless)
    over = [jobs.begin("test", "A test", nothing) for _ in range(5)]
    await settle()
    assert jobs.all() == [*reversed(over[2:]), running]
    monkeypatch.setattr(
        "isogi_server.render.jobs.now", lambda: datetime.now(UTC) + timedelta(minutes=61)
    )
    assert jobs.all() == [running]
    with pytest.raises(UnknownJobError):
        jobs.find(over[-1].id)
    await jobs.close()


def test_a_provisional_frame_is_answered_with_a_job_for_it(
    small_scene: Path, tmp_path: Path
) -> None:
    """From a store of its own: what other tests have asked for may have baked this view."""
    with serving(small_scene, tmp_path) as url, httpx.Client(base_url=url, timeout=60) as client:
        begun = client.get(FRAME, params=VIEW | {"f": "jpeg"}, headers=ASYNC)
        assert (begun.status_code, begun.headers["preference-applied"]) == (202, "respond-async")
        assert begun.headers["cache-control"] == "no-store"
        assert "Prefer" in begun.headers["vary"]
        address = begun.headers["location"]
        told = begun.json()
        assert (told["status"], told["processID"], told["type"]) == ("accepted", "frame", "process")
        assert address == f"/v1/jobs/{told['jobID']}"
        over = until_over(client, address)
        assert (over["status"], over["progress"]) == ("successful", 100)
        assert over["created"] <= over["started"] <= over["finished"] < over["expires"]
        (result,) = [link for link in over["links"] if link["rel"].endswith("/ogc/1.0/results")]
        picture = client.get(result["href"])
        assert picture.headers["isogi-provisional"] == "?0"
        assert picture.headers["content-type"] == result["type"] == "image/jpeg"
        assert "immutable" in picture.headers["cache-control"]
        assert picture.headers["vary"] == "Accept"
        again = client.get(FRAME, params=VIEW | {"f": "jpeg"}, headers=ASYNC)
        assert (again.status_code, again.content) == (200, picture.content)
        assert "preference-applied" not in again.headers
        assert told["jobID"] in [job["jobID"] for job in client.get("/v1/jobs").json()["jobs"]]
        assert client.delete(address).json()["status"] == "successful"
        assert client.get(address).status_code == 404


def test_a_wait_that_is_preferred_is_waited_and_said(live_server: str) -> None:
    view = VIEW | {"azimuth": 247}
    with httpx.Client(base_url=f"{live_server}/v1/scenes/small", timeout=60) as client:
        for path in ("/frame", "/coverage"):
            waited = client.get(path, params=view, headers={"Prefer": "wait=10, respond-async"})
            assert (waited.status_code, waited.headers["preference-applied"]) == (200, "wait=10")
        assert waited.json()["provisional"] is False
        given = client.get("/frame", params=view | {"wait_ms": 5}, headers={"Prefer": "wait=10"})
        assert "preference-applied" not in given.headers
        tag = client.get("/frame", params=view).headers["etag"]
        known = client.get(
            "/frame", params=view, headers={"Prefer": "wait=1", "If-None-Match": tag}
        )
        assert (known.status_code, known.headers["etag"]) == (304, tag)


@pytest.mark.parametrize(
    "job", ["none", "..%2f..", "%00", "a" * 4000, "00000000-0000-0000-0000-000000000000"]
)
@pytest.mark.parametrize("method", ["GET", "DELETE"])
def test_a_job_that_is_not_there_is_404(live_server: str, method: str, job: str) -> None:
    answer = httpx.request(method, f"{live_server}/v1/jobs/{job}")
    assert answer.status_code == 404
    assert len(answer.json()["detail"]) < 300


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/jobs/none"])
def test_jobs_read_no_parameters(live_server: str, path: str) -> None:
    assert httpx.get(f"{live_server}{path}", params={"limit": 3}).status_code == 422


@pytest.fixture(scope="module")
def idle(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Idle]:
    with idle_server(small_scene, tmp_path_factory.mktemp("dark"), jobs=2) as idle:
        yield idle


async def test_a_dismissed_job_has_nothing_more_baked(idle: Idle) -> None:
    async with httpx.AsyncClient(base_url=idle.url, timeout=60) as client:
        begun = await client.get(FRAME, params=VIEW, headers=ASYNC)
        address = begun.headers["location"]
        await idle.until(lambda: bool(idle.wanted), LONG)
        await asyncio.sleep(0.2)
        wants = idle.queue.requests.values()
        viewers = {each.viewer for request in wants for each in request.interests.values()}
        assert [viewer.patient for viewer in viewers] == [True]
        assert (await client.get(address)).json()["status"] == "running"
        other = await client.get(FRAME, params=VIEW | {"azimuth": 30}, headers=ASYNC)
        assert (await client.get(FRAME, params=VIEW, headers=ASYNC)).status_code == 429
        for each in (address, other.headers["location"]):
            assert (await client.delete(each)).json()["status"] == "dismissed"
        await idle.until(lambda: not idle.wanted, SOON)


def test_a_job_fails_where_its_light_cannot_be_baked(small_scene: Path, tmp_path: Path) -> None:
    baker = Baker()
    engine = RenderEngine([load_scene(small_scene)], str(tmp_path), baker=baker)
    engine.start_workers = lambda: None  # type: ignore[method-assign]
    path = "/v1/scenes/small/coverage?width=8&height=8&shading=lambert"
    with (
        live(create_app(engine, Settings()), path) as url,
        httpx.Client(base_url=url, timeout=60) as client,
    ):
        begun = client.get(FRAME, params=VIEW, headers=ASYNC)
        baker.use_pool(cast(WorkerPool, Broken()))
        over = until_over(client, begun.headers["location"])
    assert over["status"] == "failed"
    assert "cursed" in over["message"]
    assert over["links"][1:] == []


def test_what_may_be_left_out_may_be_null_in_the_schema() -> None:
    properties = SCHEMA["properties"]
    for name in (name for name, each in properties.items() if each["default"] is None):
        assert {"type": "null"} in properties[name]["anyOf"], name
    assert {"target_error", "deadline"} < properties.keys()
