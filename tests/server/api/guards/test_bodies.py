"""Limits on bodies, told and untold."""

from collections.abc import AsyncIterator, Callable

import httpx
import pytest
from fastapi import FastAPI

from server.api.requests import SmallBodies

Ask = Callable[..., httpx.Response]
LIMIT = 100


async def chunks(length: int) -> AsyncIterator[bytes]:
    for _ in range(length):
        yield b"x"


@pytest.mark.parametrize("told", [True, False])
def test_one_byte_more_is_413(ask: Ask, guarded: Callable[..., FastAPI], told: bool) -> None:
    app = guarded(SmallBodies, limit=LIMIT)
    most, more = (b"x" * n if told else chunks(n) for n in (LIMIT, LIMIT + 1))
    assert ask(app, "POST", "/length", content=most).json() == LIMIT
    answer = ask(app, "POST", "/length", content=more)
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"
    assert str(LIMIT) in answer.json()["detail"]


def test_a_body_with_two_lengths_is_refused(ask: Ask, guarded: Callable[..., FastAPI]) -> None:
    headers = {"Content-Length": "1", "Transfer-Encoding": "chunked"}
    answer = ask(guarded(SmallBodies, limit=LIMIT), "POST", "/length", content=b"x", headers=headers)
    assert (answer.status_code, answer.headers["connection"]) == (400, "close")
