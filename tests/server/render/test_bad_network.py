"""Servers whose way to a standard S3 delays, drops, resets and says nothing: no light is lost, and
nothing hangs.
"""

import os
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from isogi_core.errors import StoreError
from isogi_core.plan.assembly import load_scene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_server.render.engine import RenderEngine
from tests.cluster.processes import until
from tests.proxy import Harm, Proxy
from tests.server.buckets import chunks_at, killed_when
from tests.server.inline import LONG, view_of

BAD: tuple[Harm, ...] = (*("pass",) * 7, "delay", "delay", "drop", "reset", "cut")
CALL = 1.0
"""Seconds that one call may take."""


@pytest.fixture(autouse=True)
def forgiving(hasty: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Soon try again what was given up."""
    monkeypatch.setattr("isogi_worker.queue.FORGET_AFTER", 2.0)
    monkeypatch.setattr("isogi_worker.queue.EXPIRY_CHECK_SECONDS", 0.1)
    monkeypatch.setattr("isogi_core.storage.store.CHECKED", 0.05)


@pytest.fixture
def proxy(standard_s3: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """The way to the bucket, for all that is begun while it is there."""
    there = urlsplit(os.environ["AWS_ENDPOINT_URL"])
    with Proxy((str(there.hostname), int(there.port or 0)), seed=3) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.address)
        yield proxy


def drawn(engine: RenderEngine) -> bytes:
    """The final picture of a view, asked for until the store lets it be one."""
    deadline = time.monotonic() + LONG
    while True:
        try:
            frame = engine.frame("small", view_of(engine.scenes["small"]), wait=2.0)
            if not frame.provisional:
                return frame.radiance.tobytes()
        except StoreError as error:
            assert "the store at s3://" in str(error).lower() and "\n" not in str(error)
        assert time.monotonic() < deadline


def started(scene: Path, store: str, seconds: float = 5.0, retries: int = 2) -> RenderEngine:
    """An engine over a store, once that lets it begin."""
    engine = RenderEngine([load_scene(scene)], Store(StoreUrl(store, seconds, retries)))
    deadline = time.monotonic() + LONG
    while True:
        try:
            engine.start()
            return engine
        except StoreError:
            assert time.monotonic() < deadline


def test_what_a_bad_network_bakes_is_what_a_folder_has(
    small_scene: Path, standard_s3: str, proxy: Proxy, whole: tuple[bytes, dict[str, str]]
) -> None:
    """Answers are cut off or lost whose writes were done; a retry finds the object that it wrote
    itself.
    """
    proxy.harms = BAD
    with closing(started(small_scene, standard_s3)) as engine:
        assert drawn(engine) == whole[0]
    with closing(started(small_scene, standard_s3)) as engine:
        assert drawn(engine) == whole[0]
    assert {*proxy.suffered} >= {*BAD}
    proxy.harms = ("pass",)
    assert chunks_at(standard_s3) == whole[1]


@pytest.mark.parametrize("harm", ["silence", "drop", "reset", "cut"])
def test_a_network_that_is_down_is_told_within_a_call(
    small_scene: Path,
    standard_s3: str,
    proxy: Proxy,
    whole: tuple[bytes, dict[str, str]],
    harm: Harm,
) -> None:
    with closing(started(small_scene, standard_s3, CALL, retries=1)) as engine:
        proxy.harms = (harm,)
        begun = time.monotonic()
        with pytest.raises(
            StoreError, match=r"^(The|Cannot \w+.* the) store at s3://\S+:? [a-z ]+\.$"
        ):
            engine.frame("small", view_of(engine.scenes["small"]), wait=2.0)
        assert time.monotonic() - begun < 5.0 * CALL
        proxy.harms = ("pass",)
        assert drawn(engine) == whole[0]
    assert chunks_at(standard_s3) == whole[1]


@pytest.mark.long
def test_a_silent_network_holds_no_thread_for_ever(
    small_scene: Path, standard_s3: str, proxy: Proxy
) -> None:
    """Where an engine is closed while its store says nothing, each call comes to an end."""
    with closing(started(small_scene, standard_s3, CALL, retries=1)) as engine:
        proxy.harms = ("silence",)
        with pytest.raises(StoreError):
            engine.frame("small", view_of(engine.scenes["small"]), wait=1.0)
        assert calling()
        begun = time.monotonic()
    assert time.monotonic() - begun < 5.0 * CALL
    until(lambda: not calling(), 10.0 * CALL)


def calling() -> list[str]:
    """The threads that wait for an object store."""
    stacks = sys._current_frames()
    threads = [each for each in threading.enumerate() if each.ident in stacks]
    return [
        each.name
        for each in threads
        if any(
            frame.filename.endswith("object_store.py")
            for frame in traceback.extract_stack(stacks[each.ident or 0])
        )
    ]


@pytest.mark.kill
@pytest.mark.long
def test_a_prewarm_that_is_killed_on_a_bad_network_is_mended(
    small_scene: Path,
    standard_s3: str,
    proxy: Proxy,
    whole: tuple[bytes, dict[str, str]],
    tmp_path: Path,
) -> None:
    proxy.harms = BAD
    command = ["prewarm", str(small_scene), "--store", standard_s3, "--workers", "1"]
    killed_when(lambda: len(proxy.suffered) > 40, *command, "--views", "2")
    with closing(started(small_scene, standard_s3)) as engine:
        assert drawn(engine) == whole[0]
    proxy.harms = ("pass",)
    assert {key: chunks_at(standard_s3).get(key) for key in whole[1]} == whole[1]
