"""The page judged by axe-core: no finding of any kind, in either scheme, in any state."""

import pytest
from playwright.sync_api import Browser, Page

from tests.web.visits import BROWSER, FINAL_MS, findings, open_final, wait_final

pytestmark = BROWSER


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_finding(browser: Browser, live_server: str, scheme: str) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900}, color_scheme=scheme)  # type: ignore[arg-type]
    page = context.new_page()
    turn = 97 if scheme == "light" else 263  # from where no other test looks
    page.goto(f"{live_server}/?azimuth={turn}&compare=phong&overlay=error")
    page.wait_for_selector(
        "#stage[data-state=provisional], #stage[data-state=final]", timeout=FINAL_MS
    )
    assert findings(page) == [], "while provisional"
    wait_final(page)
    for summary in page.locator("#controls summary").all():
        if summary.is_visible():
            summary.click()
    page.click("#share-button" if scheme == "light" else "#save-button")
    assert findings(page) == [], "when final"
    page.click("#help-button")
    assert findings(page) == [], "with the help open"
    context.close()


def test_the_search_for_findings_finds_some(page: Page, live_server: str) -> None:
    open_final(page, live_server)
    page.evaluate("document.querySelector('#isovalue-number').removeAttribute('aria-label')")
    assert [finding.split(":")[0] for finding in findings(page)] == ["label"]
