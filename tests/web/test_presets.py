"""Presets of the isovalue: chips of the scene, and chips that a person keeps."""

import re

import pytest
from playwright.sync_api import Page, Route, expect

from tests.web.visits import BROWSER, slide

PRESETS = [
    {"name": "shell", "isovalue": 0.3, "suggested": False},
    {"name": "0.62", "isovalue": 0.62, "suggested": True},
]

pytestmark = BROWSER


@pytest.fixture
def shown(page: Page, live_server: str) -> Page:
    """The page of a scene with two presets."""

    def with_presets(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "presets": PRESETS})

    page.route("**/v1/scenes/small", with_presets)
    page.goto(f"{live_server}/?shading=lambert")
    page.wait_for_selector("#presets .chip")
    return page


def chips(page: Page) -> list[str]:
    return page.locator("#presets .chip").all_inner_texts()


def test_a_chip_sets_the_isovalue_and_is_pressed_while_it_is_set(shown: Page) -> None:
    assert chips(shown) == ["start 0.5", "shell 0.3", "0.62"]
    shell, found = shown.get_by_role("button", name="shell 0.3"), shown.get_by_role("button", name="0.62")
    expect(shown.get_by_role("button", name="start 0.5")).to_have_attribute("aria-pressed", "true")
    shell.click()
    expect(shown.locator("#isovalue-number")).to_have_value("0.3")
    expect(shell).to_have_attribute("aria-pressed", "true")
    found.press("Enter")
    expect(shown.locator("#isovalue-number")).to_have_value("0.62")
    expect(shell).to_have_attribute("aria-pressed", "false")
    expect(found).to_have_attribute("title", re.compile("found in the volume"))


def test_an_isovalue_is_kept_over_a_reload_until_it_is_forgotten(shown: Page) -> None:
    expect(shown.locator("#presets .keep")).to_be_disabled()
    slide(shown, "isovalue", 0.4)
    isovalue = shown.input_value("#isovalue-number")
    shown.get_by_role("button", name=f"Keep isovalue {isovalue}").click()
    expect(shown.locator("#presets .keep")).to_be_focused()
    assert chips(shown)[-1] == f"★ {isovalue}"
    shown.reload()
    chip = shown.get_by_role("button", name=f"★ {isovalue}")
    shown.get_by_role("button", name="shell 0.3").click()
    chip.click()
    expect(shown.locator("#isovalue-number")).to_have_value(isovalue)
    shown.get_by_role("button", name=f"Forget isovalue {isovalue}").click()
    expect(chip).to_have_count(0)
    shown.reload()
    shown.wait_for_selector("#presets .chip")
    assert len(chips(shown)) == 3
