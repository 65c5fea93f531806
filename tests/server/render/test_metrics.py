"""What is counted, and what /metrics tells of it."""

import json
import logging
import re
from pathlib import Path

import httpx
import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect

from isogi_core.errors import DamagedChunkError, StoreAwayError
from isogi_core.storage.calls import CountedBackend
from isogi_core.storage.folder import Folder
from isogi_core.storage.store import Store
from isogi_server.errors import BusyError, ForbiddenError, ParameterError
from isogi_server.problems import refusal
from isogi_server.render.metrics import Metrics, StoreCollector
from tests.server.sockets import wait_for

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "metrics.md"
BAKING = {
    *(
        "isogi_queue_chunks",
        "isogi_queue_age_seconds",
        "isogi_tasks_in_flight",
        "isogi_chunks_given_up",
    ),
    *(
        "isogi_workers",
        "isogi_workers_utilization",
        "isogi_worker_deaths_total",
        "isogi_paths_total",
    ),
    *("isogi_tasks_done_total", "isogi_tasks_failed_total", "isogi_tasks_duplicate_total"),
    *("isogi_chunks_healed_total", "isogi_texels_kept_total"),
}


def test_errors_are_counted_by_class_while_they_are_logged() -> None:
    metrics = Metrics()
    log = logging.getLogger("isogi.cache")
    with metrics.counting_errors():
        log.warning("%s", DamagedChunkError("Chunk (0, 0, 0) is damaged."))
        log.warning("baking chunk %s failed: %s", (0, 0, 0), DamagedChunkError("again"))
        log.warning("%s", "no error")
        try:
            _ = 1 / 0
        except ZeroDivisionError:
            log.exception("failed")
    log.warning("%s", DamagedChunkError("nobody counts any more"))
    value = metrics.registry.get_sample_value
    assert value("isogi_errors_total", {"kind": "DamagedChunkError"}) == 2
    assert value("isogi_errors_total", {"kind": "ZeroDivisionError"}) == 1
    assert value("isogi_errors_total", {"kind": "str"}) is None


def read(live_server: str) -> dict[str, float]:
    """Samples by name and labels."""
    answer = httpx.get(f"{live_server}/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    families = text_string_to_metric_families(answer.text)
    samples = (sample for family in families for sample in family.samples)
    return {" ".join((sample.name, *sample.labels.values())): sample.value for sample in samples}


def test_a_frame_and_its_baking_are_told(live_server: str) -> None:
    """Baking is counted from the server's start, as other tests may have left this view nothing to
    bake.

    What nobody waits for any more is not baked: where the machine is slow, the frame is asked for
    again.
    """
    before = read(live_server)
    asked = 0
    view = {
        "width": 16,
        "height": 16,
        "wait_ms": 10_000,
        "isovalue": 0.273,
        "azimuth": 123,
        "max_error": 0.01,
    }

    def told() -> bool:
        nonlocal asked
        asked += 1
        assert (
            httpx.get(f"{live_server}/v1/scenes/small/frame", params=view, timeout=60).status_code
            == 200
        )
        after = read(live_server)
        return all(after[name] > 0.0 for name in ("isogi_tasks_done_total", "isogi_paths_total"))

    assert wait_for(told, 120)
    after = read(live_server)
    frames = "isogi_requests_total GET /v1/scenes/{scene}/frame 200"
    primary = "isogi_frame_stage_seconds_count primary"
    assert after[frames] == before.get(frames, 0) + asked
    assert after[primary] > before.get(primary, 0)
    assert set(after) >= BAKING
    assert after["isogi_workers"] == 1
    assert after["process_resident_memory_bytes"] > 1e6


async def test_pictures_of_a_stream_are_counted_as_those_of_requests(live_server: str) -> None:
    view = {"width": 16, "height": 16}
    address = live_server.replace("http", "ws") + "/v1/scenes/small/stream"
    before = read(live_server)
    async with connect(address) as socket:
        for number, moving in enumerate((True, False)):
            await socket.send(json.dumps({"id": number, "view": view, "moving": moving}))
            final = False
            while not final:
                final = json.loads(await socket.recv())["final"] or moving
                await socket.recv()
                await socket.send(json.dumps({"shown": number}))
    after = read(live_server)

    def more(name: str) -> float:
        return after.get(name, 0.0) - before.get(name, 0.0)

    drafts = more("isogi_frames_total provisional draft") + more("isogi_frames_total final draft")
    assert (drafts, more("isogi_frames_total final stream")) == (1, 1)
    assert more("isogi_frame_stage_seconds_count encode") == 2 + more(
        "isogi_frames_total provisional stream"
    )


def test_the_document_names_all_that_is_told(live_server: str) -> None:
    text = httpx.get(f"{live_server}/metrics").text
    families = [each for each in text_string_to_metric_families(text) if "isogi_" in each.name]
    told = {
        each.name: each.documentation for each in families if not each.name.endswith("_created")
    }
    rows = re.findall(
        r"^\| `(isogi_\w+)(?:{[^}]*})?` \| (.*) \|$", DOCUMENT.read_text(encoding="utf-8"), re.M
    )
    names = {name.removesuffix("_total"): about for name, about in rows}
    assert names == told


def test_calls_to_the_store_are_told_by_kind(tmp_path: Path) -> None:
    class Broken(Folder):
        def delete(self, key: str) -> None:
            raise OSError(5, "broken")

    store = Store(tmp_path)
    registry = CollectorRegistry()
    registry.register(StoreCollector(store.calls))
    value = registry.get_sample_value
    store.put("a/b", b"light", None)
    assert store.read("a/b") == b"light"
    assert value("isogi_store_calls_total", {"call": "put"}) >= 1
    read = value("isogi_store_calls_total", {"call": "get"})
    store.read("a/b")
    assert value("isogi_store_calls_total", {"call": "get"}) == read + 1
    assert value("isogi_store_seconds_total", {"call": "get"}) > 0.0
    broken = CountedBackend(Broken(tmp_path, "isogi.json"), store.calls)
    with pytest.raises(OSError, match="broken"):
        broken.delete("a/b")
    assert value("isogi_store_failures_total", {"call": "delete"}) == 1
    assert value("isogi_store_failures_total", {"call": "get"}) == 0


def test_refusals_threads_and_the_quota_are_told(live_server: str) -> None:
    before = read(live_server)
    size = {"axis": "x", "at": 3}
    assert httpx.post(f"{live_server}/v1/volumes", content=b"NRRD0004").status_code == 403
    assert httpx.get(f"{live_server}/v1/scenes/none/slice", params=size).status_code == 404
    after = read(live_server)
    refused = {name: after[name] - before.get(name, 0) for name in after if "refusals_t" in name}
    assert {name: count for name, count in refused.items() if count} == {
        "isogi_refusals_total forbidden": 1
    }
    assert after["isogi_threads"] >= 4
    assert after["isogi_uploads_quota_bytes"] == after["isogi_uploads_free_bytes"] == 0
    assert after["isogi_store_calls_total get"] > 0


def test_each_refusal_has_a_reason() -> None:
    assert [refusal(each) for each in (BusyError("Wait."), BusyError("Wait.", "streams"))] == [
        "late",
        "streams",
    ]
    assert refusal(StoreAwayError("gone")) == "store"
    assert refusal(ForbiddenError("no")) == "forbidden"
    assert refusal(ParameterError("wrong")) == ""
