"""Health over a real socket."""

import httpx


def test_live(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/livez")
    assert answer.status_code == 200
    assert answer.json()["alive"] is True


def test_ready(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/readyz")
    assert (answer.status_code, answer.json()) == (200, {"ready": True, "reasons": []})
    assert answer.headers["cache-control"] == "no-cache"
