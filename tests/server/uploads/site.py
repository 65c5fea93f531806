"""A server on a real socket that takes uploads, and bakes on a thread of this process."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.storage.store import Store
from isogi_server.api.app import create_app
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import SceneVariant
from isogi_server.settings import Settings
from isogi_worker import pool
from tests.live import live
from tests.server.inline import InlinePool
from tests.server.uploads.files import ball

Open = Callable[..., FastAPI]
"""Makes an app that takes uploads, with the settings that it is given."""


def client_of(app: FastAPI) -> httpx.AsyncClient:
    """A client of an app, without a socket."""
    return httpx.AsyncClient(
        transport=httpx.ASGITransport(app), base_url="http://localhost", timeout=120
    )


PATIENT = {"reading_seconds": 120}
"""For machines that are busy with other tests."""


class Poster:
    """Takes note of the scenes that it is to show."""

    def __init__(self) -> None:
        self.store = Store("memory://poster")
        self.scenes: dict[str, Scene] = {}
        self.refusal: Exception | None = None

    @property
    def own_scenes(self) -> list[Scene]:
        return list(self.scenes.values())

    def variant(self, scene: str) -> SceneVariant:
        return SceneVariant(scene)

    def admit(self, scene: Scene) -> None:
        if self.refusal:
            raise self.refusal
        self.scenes = {**self.scenes, scene.id: scene}

    def dismiss(self, scene: str) -> None:
        self.scenes = {name: each for name, each in self.scenes.items() if name != scene}


class Site:
    """A server that takes uploads: its engine, a client, and the folder."""

    def __init__(self, engine: RenderEngine, client: httpx.Client, folder: Path) -> None:
        self.engine = engine
        self.client = client
        self.folder = folder

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
        patch.setattr(pool, "start_pool", InlinePool)
        engine = RenderEngine([load_scene(scene)], str(folder / "light"))
        app = create_app(engine, Settings(uploads_mb=64, uploads=str(volumes), **PATIENT))  # type: ignore[arg-type]
        with live(app) as url, httpx.Client(base_url=url, timeout=120) as client:
            yield Site(engine, client, volumes)


@pytest.fixture(scope="module")
def site(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site that the tests of a module share; rooms whose tests ask for it import it into their
    conftest.
    """
    with opened(small_scene, tmp_path_factory.mktemp("site")) as site:
        yield site
