"""An app that takes uploads, around a studio that shows them to nobody."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from isogi_core.cache.root import Root
from isogi_core.model.scene import Scene
from server.app import create_app
from server.settings import Settings
from server.uploads.uploads import Uploads
from tests.server.uploads.site import PATIENT


class Poster:
    """Takes note of the scenes that it is to show."""

    def __init__(self) -> None:
        self.root = Root("memory://poster")
        self.scenes: dict[str, Scene] = {}
        self.refusal: Exception | None = None

    def admit(self, scene: Scene) -> None:
        if self.refusal:
            raise self.refusal
        self.scenes = {**self.scenes, scene.id: scene}

    def dismiss(self, scene: str) -> None:
        self.scenes = {name: each for name, each in self.scenes.items() if name != scene}


Open = Callable[..., FastAPI]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "volumes"


@pytest.fixture
def open_app(folder: Path) -> Iterator[Open]:
    """Makes an app with these settings that has found what is in the folder."""
    opened: list[Uploads] = []

    def open_app(studio: Poster | None = None, **settings: Any) -> FastAPI:
        told = Settings(**{"uploads_mb": 1, "uploads": str(folder), **PATIENT, **settings})
        app = create_app(studio or Poster(), told)  # type: ignore[arg-type]
        opened.append(app.state.service.uploads)
        opened[-1].open()
        return app

    yield open_app
    for uploads in opened:
        uploads.close()
