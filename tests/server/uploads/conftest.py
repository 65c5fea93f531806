"""An app that takes uploads, around an engine that shows them to nobody."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from isogi_server.api.app import create_app
from tests.server.sockets import settings_of
from tests.server.uploads.site import (
    PATIENT,
    Open,
    Poster,
    site,  # noqa: F401 (a fixture)
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "volumes"


@pytest.fixture
def open_app(folder: Path) -> Iterator[Open]:
    """Makes an app with these settings that has found what is in the folder."""
    with ExitStack() as opened:

        def open_app(engine: Poster | None = None, **settings: Any) -> FastAPI:
            told = settings_of(**{"uploads_mb": 64, "uploads": str(folder), **PATIENT, **settings})
            app = create_app(engine or Poster(), told)  # type: ignore[arg-type]
            opened.callback(app.state.service.uploads.close)
            app.state.service.uploads.open()
            return app

        yield open_app
