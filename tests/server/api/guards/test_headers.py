"""The headers that every response carries."""

from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI

from server.api.requests import SafeHeaders

Ask = Callable[..., httpx.Response]


@pytest.fixture
def app(guarded: Callable[..., FastAPI]) -> FastAPI:
    return guarded(SafeHeaders)


def test_a_page_may_load_its_own_files_only(ask: Ask, app: FastAPI) -> None:
    headers = ask(app, "GET", "/page").headers
    assert "script-src 'self'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["cache-control"] == "no-cache"


def test_data_may_load_nothing_and_keeps_its_own_caching(ask: Ask, app: FastAPI) -> None:
    headers = ask(app, "GET", "/data").headers
    assert headers["content-security-policy"].startswith("default-src 'none';")
    assert headers["cache-control"] == "max-age=5"


@pytest.mark.parametrize("path", ["/page", "/data", "/nothing"])
def test_every_response_has_the_safe_headers(ask: Ask, app: FastAPI, path: str) -> None:
    headers = ask(app, "GET", path, headers={"Origin": "https://evil.example"}).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-opener-policy"] == "same-origin"
    assert "access-control-allow-origin" not in headers
