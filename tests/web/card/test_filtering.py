"""Light that converges, turned and filtered by a page's card, beside isogi's picture of it."""

from dataclasses import replace

import pytest

from tests.frame.conftest import SKY, Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import TURN, CardScene, Lab, difference, plain_light

SIZE = (72, 56)
TARGET = 0.1


def noisy_bench(make_bench: Make, lattice: dict[str, float]) -> Workbench:
    """A view of the orbital, baked to a tenth."""
    settings = {"lights": [SKY], "albedo": [0.8, 0.6, 0.4], "bounces": 2, "target_error": TARGET, "projected": False}
    bench = make_bench(load_scene("demo:orbital", **settings, **lattice))
    bench.bake(replace(bench.view(), width=SIZE[0], height=SIZE[1]))
    return bench


@pytest.mark.parametrize("lattice", [{}, {"lattice": 1.5, "chunk": 8}], ids=["plain", "fine"])
def test_a_turned_light_is_filtered_on_the_card(lab: Lab, make_bench: Make, lattice: dict[str, float]) -> None:
    bench = noisy_bench(make_bench, lattice)
    view = replace(bench.view(), width=SIZE[0], height=SIZE[1])
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, TARGET, raw=True)
    turned = replace(view, light=TURN)
    light, on = plain_light(bench.renderer, turned, TARGET)
    found = difference(card.picture(turned), light, on)
    assert found.surface > 500 and found.within >= 0.999 and found.rmse <= 0.002, found
    lab.ask(
        """card.drawing.refold();
      for (const run of card.drawing.texels.runs) run.raw.forEach((each) => { each.grainy = false; });"""
    )
    assert difference(card.picture(turned), light, on).rmse > 10 * found.rmse, "the filter makes a difference"


@pytest.mark.usefixtures("unfiltered")
def test_final_light_is_not_filtered(lab: Lab, make_bench: Make) -> None:
    bench = noisy_bench(make_bench, {})
    view = replace(bench.view(), width=SIZE[0], height=SIZE[1])
    CardScene(lab, bench.renderer, view, SIZE).light(view, TARGET, raw=True)
    assert lab.ask("return [card.drawing.texels.grainy, card.drawing.texels.runs.length > 0];") == [False, True]
