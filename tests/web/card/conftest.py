"""A browser that draws WebGL by its processor, and a page in it with a card."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserType

from isogi_core.plan.scene import Scene
from tests.frame.conftest import Workbench
from tests.web.card.lab import CARD_FLAGS, Lab, lab_in
from tests.web.visits import CHROMIUM

Make = Callable[[Scene], Workbench]


@pytest.fixture(scope="module")
def browser(browsers: BrowserType) -> Iterator[Browser]:
    """Chromium with SwiftShader in a card's place."""
    if not CHROMIUM.exists():
        pytest.skip(f"no Chromium at {CHROMIUM}: install Debian's chromium")
    chromium = browsers.launch(executable_path=str(CHROMIUM), args=["--no-sandbox", *CARD_FLAGS])
    yield chromium
    chromium.close()


@pytest.fixture(scope="module")
def lab(browser: Browser) -> Iterator[Lab]:
    """A page with a card, for all tests of a file."""
    with lab_in(browser) as opened:
        yield opened


@pytest.fixture(scope="module")
def make_bench(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Make the workbench of a scene, with nothing baked yet."""

    def make(folder: Path, scene: Scene) -> Workbench:
        return Workbench(scene, folder / scene.bake_digest)

    return partial(make, tmp_path_factory.mktemp("card"))
