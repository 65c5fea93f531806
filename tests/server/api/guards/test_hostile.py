"""Requests that mean harm, on a real socket: every answer is a documented one, and nothing is given
away.
"""

import json
import socket
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from isogi_server.parameters import FrameParams
from tests.server.sockets import answer, status

NUMBERS = [
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "Infinity",
        "1e999",
        "-1e999",
        "1e-999x",
        "1_0",
        "0x10",
        "1e",
        "--1",
        "+-1",
    ),
    *("1,5", " 1", "1 ", "", "null", "true", "[]", "٣", "１", "9" * 40, "-" + "9" * 40),
    "9" * 5000,
]
"""Spellings of numbers that no numeric parameter takes."""

WORDS = ("shading", "f", "overlay", "strip")
HOSTS = [
    *(
        "evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "localhost.",
    ),
    *(
        "127.0.0.1@evil.example",
        "[::2]",
        "0.0.0.0",
        "127.1",
        "2130706433",
        "",
        "127.0.0.1, evil.example",
    ),
]
SECRET = "nobody reads this"
CLIMBS = [
    "..",
    "%2e%2e",
    "%2E.",
    ".%2e",
    "..;",
    "%252e%252e",
    "....",
    "..%00",
    "..\\",
    "%c0%ae%c0%ae",
]
JOINTS = ["/", "%2f", "%5c", "//"]


def paths(secret: Path) -> list[str]:
    """40 ways out of the folder of the page's files, and URLs and files as ids of scenes."""
    steps = [
        f"/web/{joint.join([climb] * 12)}{joint}{secret}" for climb in CLIMBS for joint in JOINTS
    ]
    names = [
        f"file://{secret}",
        f"file:{secret}",
        str(secret).replace("/", "%2f"),
        "s3://bucket/key",
        "%00",
        ".",
    ]
    return [
        *steps,
        *(f"/v1/scenes/{name}/frame" for name in names),
        *(f"/v1/scenes/{name}" for name in names),
    ]


def said(url: str, *lines: str) -> bytes:
    """What the server answers to these very lines."""
    where = urlsplit(url)
    with socket.create_connection((str(where.hostname), where.port or 80), 30) as client:
        client.sendall(("\r\n".join([*lines, "Connection: close", "", ""])).encode("utf-8"))
        return answer(client)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    (tmp_path / "secret.txt").write_text(SECRET)
    return tmp_path / "secret.txt"


def test_no_path_leads_out(live_server: str, secret: Path) -> None:
    spellings = paths(secret)
    assert len(spellings) >= 50
    for path in spellings:
        told = said(live_server, f"GET {path} HTTP/1.1", "Host: localhost")
        assert status(told) in (400, 404, 422), path
        assert SECRET.encode() not in told, path
        assert b"application/problem+json" in told, path


@pytest.mark.parametrize("host", HOSTS)
def test_no_other_host_is_served(live_server: str, host: str) -> None:
    for path in ("/", "/livez", "/v1/scenes", "/metrics"):
        told = said(live_server, f"GET {path} HTTP/1.1", f"Host: {host}")
        assert status(told) in (400, 421), path
        assert b"small" not in told


@pytest.mark.parametrize("name", [name for name in FrameParams.model_fields if name not in WORDS])
def test_numbers_that_are_none_are_422(live_server: str, name: str) -> None:
    with httpx.Client(base_url=f"{live_server}/v1/scenes/small") as client:
        for number in NUMBERS:
            for path in ("frame", "coverage"):
                reply = client.get(path, params={name: number})
                assert reply.status_code == 422, (path, name, number[:40], reply.text)
                assert strict(reply.text)["status"] == 422
                assert len(reply.text) < 1500


def test_a_scene_asked_for_by_url_opens_no_connection(live_server: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as trap:
        trap.settimeout(0.3)
        port = trap.getsockname()[1]
        for name in (
            f"http:%2f%2f127.0.0.1:{port}%2fa",
            f"http://127.0.0.1:{port}/a",
            f"127.0.0.1:{port}",
        ):
            assert httpx.get(f"{live_server}/v1/scenes/{name}").status_code == 404
        with pytest.raises(TimeoutError):
            trap.accept()


@pytest.mark.parametrize("header", ["Origin: https://evil.example", "Sec-Fetch-Site: cross-site"])
def test_foreign_pages_change_nothing_here(live_server: str, live_store: Path, header: str) -> None:
    before = sorted(live_store.rglob("*"))
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
        for path in ("/v1/scenes", "/v1/scenes/small/frame", "/v1/scenes/small/prewarm"):
            told = said(
                live_server,
                f"{method} {path} HTTP/1.1",
                "Host: localhost",
                header,
                "Content-Length: 0",
            )
            assert status(told) == 403
    assert sorted(live_store.rglob("*")) == before


def strict(text: str) -> dict[str, object]:
    """JSON without NaN and infinities."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    document: dict[str, object] = json.loads(text, parse_constant=refuse)
    return document


DOCUMENTS = (
    "/livez",
    "/readyz",
    "/openapi.json",
    "/v1/scenes",
    "/v1/scenes/small",
    "/v1/scenes/small/coverage",
)


@pytest.mark.parametrize("path", DOCUMENTS)
def test_documents_hold_no_nan(live_server: str, path: str) -> None:
    assert strict(httpx.get(f"{live_server}{path}").text)


def test_what_guards_answer_is_documented(live_server: str) -> None:
    api = httpx.get(f"{live_server}/openapi.json").json()
    for methods in api["paths"].values():
        for operation in methods.values():
            assert {"401", "403", "413", "421"} <= operation["responses"].keys()


def test_every_response_carries_the_safe_headers(live_server: str) -> None:
    for path in (
        "/",
        "/docs",
        "/web/main.js",
        "/livez",
        "/metrics",
        "/v1/scenes/small/frame?width=8&height=8",
        "/no",
    ):
        headers = httpx.get(
            f"{live_server}{path}", headers={"Origin": "https://evil.example"}
        ).headers
        assert headers["x-content-type-options"] == "nosniff", path
        assert headers["referrer-policy"] == "no-referrer", path
        assert headers["cross-origin-opener-policy"] == "same-origin", path
        assert "default-src 'none'" in headers["content-security-policy"], path
        assert "access-control-allow-origin" not in headers, path
        assert "server" not in headers, path
