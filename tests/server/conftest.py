"""Asking apps and servers, and running commands."""

import asyncio
import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from isogi_server.cli.command import run
from tests.server.asking import Ask, Told
from tests.server.inline import InlinePool


@pytest.fixture(scope="session")
def ask() -> Ask:
    """``ask(app, method, path, **more)``: one answer of an ASGI app, its lifespan not begun."""

    async def answer(app: FastAPI, method: str, path: str, more: dict[str, Any]) -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.request(method, path, **more)

    return lambda app, method, path, **more: asyncio.run(answer(app, method, path, more))


@pytest.fixture(scope="module")
def client(live_server: str) -> Iterator[httpx.Client]:
    """A client of ``live_server``."""
    with httpx.Client(base_url=live_server, timeout=180) as client:
        yield client


@pytest.fixture
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let engines and commands bake on a thread of this process, in place of workers."""
    monkeypatch.setattr("isogi_worker.pool.start_pool", InlinePool)


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Told:
    """``told(*words, status=0)``: what a command prints that ends so; where it fails, on stderr,
    but for its bars.
    """

    def told(*words: object, status: int = 0) -> str:
        capsys.readouterr()
        ended = run([str(word) for word in words])
        out, error = capsys.readouterr()
        assert ended == status, error
        if status == 0:
            return out
        return re.sub(r"[^\n]*\r", "", error)

    return told
