"""The pages for people, over a real socket."""

import posixpath
import re

import httpx
import pytest


@pytest.mark.smoke
def test_the_viewer_and_its_files(live_server: str) -> None:
    page = httpx.get(f"{live_server}/")
    assert page.headers["content-type"].startswith("text/html")
    assert "script-src 'self'" in page.headers["content-security-policy"]
    files = re.findall(r'(?:src|href)="(web/[^"]+)"', page.text)
    assert files
    for file in files:
        assert httpx.get(f"{live_server}/{file}").status_code == 200, file
    assert httpx.get(f"{live_server}/web/none.js").status_code == 404


def test_the_viewer_names_its_modules_at_once(live_server: str) -> None:
    """A browser would find them one import after the other."""
    named = re.findall(r"<(web/[^>]+)>; rel=modulepreload", httpx.get(f"{live_server}/").headers["link"])
    found, coming = {"web/main.js"}, ["web/main.js"]
    while coming:
        module = coming.pop()
        text = httpx.get(f"{live_server}/{module}").raise_for_status().text
        imports = re.findall(r'^(?:import|export|\}).* from "(\.[^"]+)"', text, re.MULTILINE)
        new = {posixpath.normpath(posixpath.join(posixpath.dirname(module), each)) for each in imports} - found
        found |= new
        coming += new
    assert len(found) > 20 and sorted(found) == named


def test_the_documentation_needs_nothing_from_elsewhere(live_server: str) -> None:
    page = httpx.get(f"{live_server}/docs")
    assert page.status_code == 200
    assert not [word for word in ("http://", "https://", "<script") if word in page.text]


def test_every_route_and_parameter_is_documented(live_server: str) -> None:
    page, api = httpx.get(f"{live_server}/docs").text, httpx.get(f"{live_server}/openapi.json").json()
    assert {"/v1/scenes", "/v1/scenes/{scene}/frame", "/readyz"} <= api["paths"].keys()
    for path, methods in api["paths"].items():
        for method, facts in methods.items():
            assert f"{method.upper()} {path}<" in page
            assert facts["description"]
            assert all(f"<code>{each['name']}</code>" in page for each in facts.get("parameters", []))


def test_head_is_where_get_is(live_server: str) -> None:
    paths = ("/", "/docs", "/openapi.json", "/web/style.css", "/v1/scenes", "/v1/scenes/small", "/livez", "/readyz")
    for path in paths:
        head, get = httpx.head(f"{live_server}{path}"), httpx.get(f"{live_server}{path}")
        assert (head.status_code, head.content) == (200, b""), path
        assert head.headers["content-length"] == get.headers["content-length"], path
