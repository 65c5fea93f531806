"""Pages in the browser."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, ViewportSize, expect

from tests.server.uploads.site import site  # noqa: F401 (a fixture)

VIEWPORT: ViewportSize = {"width": 900, "height": 640}
PATIENCE_MS = 30_000  # for what a page does at once on an idle machine


def heard(page: Page) -> list[str]:
    """What a page will complain of in its console, but for requests that a test cuts off."""
    complaints: list[str] = []

    def note(text: str) -> None:
        if "net::ERR_FAILED" not in text:
            complaints.append(text)

    page.on("pageerror", lambda error: note(str(error)))
    page.on("console", lambda message: note(message.text) if message.type == "error" else None)
    return complaints


@contextmanager
def watched(browser: Browser) -> Iterator[tuple[Page, list[str]]]:
    """A page in a context of its own, and what it complains of."""
    context = browser.new_context(viewport=VIEWPORT)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    yield page, heard(page)
    page.unroute_all(behavior="ignoreErrors")  # the page asks on while it is closed
    context.close()


@pytest.fixture(scope="module")
def tab(browser: Browser) -> Iterator[tuple[Page, list[str]]]:
    """A page for all tests of a file, one after the other: to open one takes a third of a second of
    the processor.
    """
    with watched(browser) as opened:
        yield opened


@pytest.fixture
def page(tab: tuple[Page, list[str]]) -> Iterator[Page]:
    """A page that knows nothing of former tests, and whose console must stay free of errors."""
    page, complaints = tab
    yield page
    page.unroute_all(behavior="ignoreErrors")
    if page.url.startswith("http"):
        page.evaluate("localStorage.clear()")
    page.goto("about:blank")
    page.set_viewport_size(VIEWPORT)
    page.emulate_media(color_scheme="null")
    said = complaints.copy()
    complaints[:] = []
    assert said == []


@pytest.fixture
def fresh(browser: Browser) -> Iterator[Page]:
    """A page of one test alone, for what cannot be undone: scripts before all others, and sockets
    that are routed.
    """
    with watched(browser) as (page, complaints):
        yield page
    assert complaints == []


@pytest.fixture
def careless(browser: Browser) -> Iterator[Page]:
    """A page of one test alone, whose hands may ask for views that the server refuses with a
    sentence, such as a cut that leaves nothing.
    """
    with watched(browser) as (page, complaints):
        yield page
    assert [text for text in complaints if "status of 422" not in text] == []


@pytest.fixture(scope="module")
def steady(browser: Browser) -> Iterator[Page]:
    """A page that stays as it is from test to test of a file."""
    with watched(browser) as (page, complaints):
        yield page
    assert complaints == []
