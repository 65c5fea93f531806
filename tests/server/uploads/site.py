"""A server on a real socket that takes uploads, and bakes on a thread of this process."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from isogi_core.model.scene import load_scene
from server.app import create_app
from server.settings import Settings
from server.studio import Studio
from tests.live import live
from tests.server.inline import InlinePool
from tests.server.uploads.files import ball
from worker import pool

PATIENT = {"reading_seconds": 120}
"""For machines that are busy with other tests."""


class Site:
    """A server that takes uploads: its studio, a client, and the folder."""

    def __init__(self, studio: Studio, client: httpx.Client, folder: Path) -> None:
        self.studio, self.client, self.folder = studio, client, folder

    def send(self, side: int) -> dict[str, str]:
        """A ball that is there now."""
        answer = self.client.post("/v1/volumes", content=ball(side)).raise_for_status()
        facts: dict[str, str] = answer.json()
        return facts


@contextmanager
def opened(scene: Path, folder: Path) -> Iterator[Site]:
    """A site that shows a scene; its light and its uploads are in the folder."""
    volumes = folder / "volumes"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "WorkerPool", InlinePool)
        studio = Studio([load_scene(scene)], str(folder / "light"))
        app = create_app(studio, Settings(uploads_mb=8, uploads=str(volumes), **PATIENT))  # type: ignore[arg-type]
        with live(app) as url, httpx.Client(base_url=url, timeout=120) as client:
            yield Site(studio, client, volumes)
