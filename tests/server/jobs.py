"""Jobs of a server that bakes: a client of it, and waiting for an end."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from tests.client.lab import TOKEN, lab_of
from tests.server.inline import LONG


@contextmanager
def baking(scene: Path, store: Path) -> Iterator[httpx.Client]:
    """A client of a server that bakes."""
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    with (
        lab_of(scene, store) as lab,
        httpx.Client(base_url=lab.url, headers=bearer, timeout=60) as client,
    ):
        yield client


def until_over(client: httpx.Client, address: str) -> dict[str, Any]:
    """The document of a job once it has ended; its progress has not fallen meanwhile."""
    deadline = time.monotonic() + LONG
    seen = [0]
    while True:
        facts: dict[str, Any] = client.get(address).json()
        seen.append(facts["progress"])
        assert seen == sorted(seen)
        if facts["status"] not in ("accepted", "running"):
            return facts
        assert time.monotonic() < deadline
        time.sleep(0.05)
