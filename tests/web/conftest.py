"""A browser, and a page in it."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.server.uploads.site import site  # noqa: F401 (a fixture)
from tests.web.visits import CHROMIUM, FLAGS

PATIENCE_MS = 30_000  # for what a page does at once on an idle machine


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        yield chromium
        chromium.close()


@contextmanager
def watched(browser: Browser) -> Iterator[Page]:
    """A page whose console must stay free of errors, and that talks to nobody but the server."""
    context = browser.new_context(viewport={"width": 900, "height": 640})
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    yield page
    page.unroute_all(behavior="ignoreErrors")  # the page asks on while it is closed
    context.close()
    cut_by_the_test = "net::ERR_FAILED"
    assert [text for text in complaints if cut_by_the_test not in text] == []


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that is new to each test."""
    with watched(browser) as page:
        yield page


@pytest.fixture(scope="module")
def steady(browser: Browser) -> Iterator[Page]:
    """A page that stays for all tests of a file: to open one takes a second of the processor."""
    with watched(browser) as page:
        yield page
