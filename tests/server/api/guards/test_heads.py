"""HEAD."""

from collections.abc import Callable

import httpx
from fastapi import FastAPI

from server.api.requests import HeadAsGet


def test_head_is_get_without_a_body(ask: Callable[..., httpx.Response], guarded: Callable[..., FastAPI]) -> None:
    app = guarded(HeadAsGet)
    head, get = ask(app, "HEAD", "/page"), ask(app, "GET", "/page")
    assert (head.status_code, head.content) == (200, b"")
    assert dict(head.headers) == dict(get.headers)
