"""Prewarms over HTTP: jobs that yield, are dismissed, outlive the server, and leave the same
bytes.
"""

import asyncio
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.api.prewarm_jobs import Prewarm
from isogi_server.cli.prewarm import prewarm
from isogi_server.prewarm.order import order_of
from isogi_server.prewarm.record import recorded_prewarms
from isogi_server.settings import Settings
from isogi_worker.bake_requests import GUEST_VIEWER
from tests.server.idle import Idle, idle_server
from tests.server.inline import LONG, chunks_in
from tests.server.jobs import baking, until_over
from tests.server.sockets import wait_for

ORDER: dict[str, Any] = {"isovalues": [0.5], "views": 3, "width": 24, "height": 20}
PREWARM = "/v1/scenes/blocks/prewarm"


@pytest.fixture(scope="module")
def alone(
    blocks: Path, all_inline: None, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """The chunks that the command leaves where nothing disturbs it."""
    store = tmp_path_factory.mktemp("alone")
    prewarm(str(blocks), order_of(ORDER), Settings(store=str(store), workers=1))
    return chunks_in(store)


def test_a_prewarm_job_leaves_final_views_and_a_summary(
    blocks: Path, tmp_path: Path, alone: dict[str, str]
) -> None:
    with baking(blocks, tmp_path) as client:
        ahead = until_over(
            client, client.post(PREWARM, json=ORDER | {"dry_run": True}).headers["location"]
        )
        assert (ahead["status"], chunks_in(tmp_path)) == ("successful", {})
        told = client.get(f"/v1/jobs/{ahead['jobID']}/results").json()
        begun = client.post(PREWARM, json=ORDER)
        assert (begun.status_code, begun.headers["cache-control"]) == (202, "private, no-store")
        address = begun.headers["location"]
        assert address == f"/v1/jobs/{begun.json()['jobID']}"
        assert begun.json()["processID"] == "prewarm"
        over = until_over(client, address)
        assert (over["status"], over["progress"]) == ("successful", 100)
        (link,) = [each for each in over["links"] if each["rel"].endswith("/results")]
        summary = client.get(link["href"]).json()
        assert (summary["final"], summary["stopped"], summary["texels"]) == (
            1.0,
            "target",
            told["texels"],
        )
        assert summary["file"] == f"{tmp_path}/jobs/{over['jobID']}.json"
        assert json.loads(Path(summary["file"]).read_text())["summary"] == summary
        assert chunks_in(tmp_path) == alone
        again = until_over(client, client.post(PREWARM, json=ORDER).headers["location"])
        assert again["jobID"] == over["jobID"]
        assert client.get(f"{address}/results").json()["paths"] == 0
        metrics = client.get("/metrics").text
    assert 'isogi_jobs{status="successful"} 2.0' in metrics
    assert 'isogi_jobs{status="running"} 0.0' in metrics


@pytest.mark.parametrize(
    ("body", "why"),
    [
        *[
            ("{", "no JSON"),
            ("[" * 30000, "no JSON"),
            ("[1]", "JSON object"),
            ('{"paint": 1}', "no parameter 'paint'"),
        ],
        *[
            (f'{{"views": {number}}}', "views must be a whole number")
            for number in ("NaN", "1e999")
        ],
        ('{"isovalues": ["0.2:0.8:0.0001"], "views": 9999}', "100,000 views at most"),
    ],
)
def test_what_makes_no_sense_is_422_and_begins_nothing(idle: Idle, body: str, why: str) -> None:
    answer = httpx.post(f"{idle.url}{PREWARM}", content=body)
    assert answer.status_code == 422 and why in answer.json()["detail"]
    assert httpx.get(f"{idle.url}/v1/jobs").json()["jobs"] == []


@pytest.fixture
def idle(blocks: Path, tmp_path: Path) -> Iterator[Idle]:
    with idle_server(blocks, tmp_path) as idle:
        yield idle


def test_unknown_scenes_parameters_and_results_are_refused(idle: Idle) -> None:
    assert httpx.post(f"{idle.url}/v1/scenes/none/prewarm").status_code == 404
    assert httpx.post(f"{idle.url}{PREWARM}?views=3").status_code == 422
    assert httpx.get(f"{idle.url}/v1/jobs/none/results").status_code == 404
    job = httpx.post(f"{idle.url}{PREWARM}", json=ORDER).headers["location"]
    assert "no document" in httpx.get(f"{idle.url}{job}/results").json()["detail"]


def test_a_prewarm_yields_to_people_and_is_dismissed_soon(idle: Idle, tmp_path: Path) -> None:
    async def visit() -> None:
        async with httpx.AsyncClient(base_url=idle.url, timeout=60) as client:
            begun = (await client.post(PREWARM, json=ORDER)).json()
            assert (await client.post(PREWARM, json=ORDER)).json()["jobID"] == begun["jobID"]
            await idle.until(lambda: bool(idle.wanted), LONG)
            wants = idle.queue.requests.values()
            assert all(
                interest.viewer.patient
                for request in wants
                for interest in request.interests.values()
            )
            await client.get(
                "/v1/scenes/blocks/frame", params={"width": 24, "height": 20, "isovalue": 0.5}
            )
            first = idle.queue.take()
            assert first is not None and any(
                not interest.viewer.patient for interest in first.interests.values()
            )
            assert "chunks" in (await client.get(f"/v1/jobs/{begun['jobID']}")).json()["message"]
            ended = await client.delete(f"/v1/jobs/{begun['jobID']}")
            assert (ended.status_code, ended.json()["status"]) == (200, "dismissed")
            assert all(
                client == GUEST_VIEWER.client or client == ("", "127.0.0.1")
                for _, client in idle.wanted
            )

    asyncio.run(visit())
    (record,) = recorded_prewarms(str(tmp_path))
    assert (record.status, record.unfinished) == ("dismissed", True)


def test_looking_at_many_views_ends_soon_where_it_is_dismissed(idle: Idle) -> None:
    order = {"isovalues": ["0.3:0.7:0.001"], "views": 200, "width": 64, "height": 64}
    job = httpx.post(f"{idle.url}{PREWARM}", json=order).headers["location"]
    assert wait_for(
        lambda: not httpx.get(f"{idle.url}{job}").json()["message"].startswith("Looking: 0 of"),
        LONG,
    )
    assert (
        httpx.get(
            f"{idle.url}/v1/scenes/blocks/frame", params={"width": 24, "height": 20}
        ).status_code
        == 200
    )
    assert httpx.delete(f"{idle.url}{job}", timeout=10).json()["status"] == "dismissed"


@pytest.mark.slow
def test_a_server_that_starts_again_takes_up_what_was_begun(
    blocks: Path, tmp_path: Path, alone: dict[str, str]
) -> None:
    with idle_server(blocks, tmp_path) as idle:
        kept = httpx.post(f"{idle.url}{PREWARM}", json=ORDER).json()["jobID"]
        gone = httpx.post(f"{idle.url}{PREWARM}", json=ORDER | {"isovalues": [0.6]}).headers[
            "location"
        ]
        httpx.delete(f"{idle.url}{gone}")
        assert wait_for(
            lambda: any(record.ahead for record in recorded_prewarms(str(tmp_path))), LONG
        )
    assert {record.status for record in recorded_prewarms(str(tmp_path))} == {
        "running",
        "dismissed",
    }
    abandon(tmp_path / "jobs" / f"{kept}.json")
    with baking(blocks, tmp_path) as client:
        over = until_over(client, f"/v1/jobs/{kept}")
        assert over["status"] == "successful"
        assert [job["jobID"] for job in client.get("/v1/jobs").json()["jobs"]] == [kept]
    assert chunks_in(tmp_path) == alone


def abandon(record: Path) -> None:
    """Have a record be that of a process which has ended."""
    document = json.loads(record.read_text())
    machine, _, name = document["worker"].split("/")
    record.write_text(json.dumps(document | {"worker": f"{machine}/{1 << 30}/{name}"}))


def test_what_another_server_works_on_is_left_to_it(blocks: Path, tmp_path: Path) -> None:
    with idle_server(blocks, tmp_path) as one:
        job = httpx.post(f"{one.url}{PREWARM}", json=ORDER).headers["location"]
        assert wait_for(
            lambda: any(record.ahead for record in recorded_prewarms(str(tmp_path))), LONG
        )
        (record,) = (tmp_path / "jobs").glob("*.json")
        document = json.loads(record.read_text())
        record.write_text(json.dumps(document | {"worker": "elsewhere/1/abc"}))
        with idle_server(blocks, tmp_path) as other:
            answer = httpx.get(f"{other.url}{job}")
            while answer.status_code == 503:
                answer = httpx.get(f"{other.url}{job}")
            assert answer.status_code == 404


def test_a_command_beside_a_server_leaves_the_same_light(
    blocks: Path, tmp_path: Path, alone: dict[str, str]
) -> None:
    load_scene(blocks)
    with baking(blocks, tmp_path) as client, ThreadPoolExecutor(1) as thread:
        job = client.post(PREWARM, json=ORDER).headers["location"]
        beside = thread.submit(
            prewarm, str(blocks), order_of(ORDER), Settings(store=str(tmp_path), workers=1)
        )
        assert until_over(client, job)["status"] == "successful"
        assert beside.result(LONG).final == 1.0
    assert chunks_in(tmp_path) == alone


def test_the_body_is_documented(idle: Idle) -> None:
    api = httpx.get(f"{idle.url}/openapi.json").json()
    body = api["paths"]["/v1/scenes/{scene}/prewarm"]["post"]["requestBody"]["content"][
        "application/json"
    ]
    assert body["schema"]["additionalProperties"] is False
    assert set(ORDER) < set(body["schema"]["properties"])
    assert "$ref" not in json.dumps(body)
    for example in body["examples"].values():
        told = {name: value for name, value in example["value"].items() if name != "dry_run"}
        assert order_of(told)


async def test_a_frame_that_takes_too_long_is_an_error() -> None:
    """Its TimeoutError is no end of a wait, after which it would be waited for again."""

    async def frame(*_: Any) -> None:
        raise TimeoutError("of a disk")

    service: Any = SimpleNamespace(frame=frame, rank=lambda *_: None, attended=False)
    nothing: Any = None
    work = Prewarm(service, nothing, nothing)
    asking = asyncio.to_thread(work._frame_of, asyncio.get_running_loop(), nothing)
    try:
        with pytest.raises(TimeoutError, match="of a disk"):
            await asyncio.wait_for(asking, 10)
    finally:
        work.cancelled.set()
