"""Colours by data and labels that a page's card draws beside isogi's, and what is sent of them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.film import develop, ground_of
from isogi_core.model.view import View, read_window
from isogi_core.plan.scene import Scene
from isogi_server.answers import card_scene
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import CardScene, Lab, difference, light_of, plain_light

pytestmark = pytest.mark.usefixtures("unfiltered")

SIZE = (72, 56)
KEPT = {"bounces": 2, "target_error": LOOSE, "projected": False}
Z, Y, X = np.indices((20, 24, 28)).astype(float)
BALL = (X - 13.5) ** 2 + (Y - 11.5) ** 2 + (Z - 9.5) ** 2 < 7.4**2
PARTS = np.where(X + 0.4 * Z < 15, 3, np.where(Y < 12, 7, 9))
"""Three labels that meet on a line."""

LABELS = [
    {"value": value, "colour": colour}
    for value, colour in ((3, [0.8, 0.2, 0.2]), (7, [0.2, 0.7, 0.2]), (9, [0.3, 0.3, 0.9]))
]


def by_gradient(_: Path, **settings: Any) -> Scene:
    """The orbital in colours of its gradient, for some isovalues."""
    table = {"use": "colour", "of": "gradient", "map": "coolwarm"}
    more = {"volumes": [table], "isovalues": [0.05, 0.4], **KEPT, **settings}
    return load_scene("demo:orbital", **{"lights": [SKY], **more})


def by_file(folder: Path, **settings: Any) -> Scene:
    """The orbital in colours of a coarser file, which covers a part of it and has holes."""
    values = np.random.default_rng(3).random((12, 14, 16), np.float32)
    values[3:6, 4:9, 2:8] = np.nan
    header = {"spacings": [4.0, 4.0, 4.0]}
    nrrd.write(str(folder / "c.nrrd"), values, header, index_order="C")
    table = {"use": "colour", "file": str(folder / "c.nrrd"), "outside": [0.9, 0.2, 0.1]}
    return load_scene("demo:orbital", **{"lights": [SKY], "volumes": [table], **KEPT, **settings})


def by_labels(folder: Path, **settings: Any) -> Scene:
    """A ball of three labels."""
    parts = np.where(BALL, PARTS, 0).astype(np.uint8)
    nrrd.write(str(folder / "v.nrrd"), parts, index_order="C")
    more = {"labels": LABELS, "isovalues": [0.4, 0.6], **KEPT, **settings}
    return load_scene(folder / "v.nrrd", **{"lights": [SKY], **more})


SCENES: dict[str, Callable[..., Scene]] = {
    "gradient": by_gradient,
    "file": by_file,
    "labels": by_labels,
}


def coloured_bench(make_bench: Make, scene: Scene, **settings: Any) -> tuple[Workbench, View]:
    """The baked workbench of a scene, and a view of it."""
    bench = make_bench(scene)
    view = replace(bench.view(**settings), width=SIZE[0], height=SIZE[1])
    bench.bake(view)
    return bench, view


def coloured_light(bench: Workbench, view: View) -> tuple[np.ndarray, np.ndarray]:
    """The light of isogi's frame in its colours, before lobes, and the pixels of the surface."""
    light, on = plain_light(bench.renderer, view, LOOSE)
    gbuffer = bench.renderer.gbuffer(view)
    tints = light_of(bench.renderer, view).tints(gbuffer, bench.renderer.tiles)
    light.reshape(-1, 3)[gbuffer.pixels] *= tints
    return light, on


@pytest.mark.parametrize("name", SCENES)
def test_colours_are_isogis(lab: Lab, make_bench: Make, tmp_path: Path, name: str) -> None:
    bench, view = coloured_bench(make_bench, SCENES[name](tmp_path))
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    light, on = coloured_light(bench, view)
    plain = plain_light(bench.renderer, view, LOOSE)[0]
    assert np.abs(light - plain)[on].mean() > 0.1 * plain[on].mean(), "colours are seen"
    found = difference(card.picture(view), light, on)
    assert found.surface > 400
    assert found.within >= 0.999 and found.rmse <= 0.003, found


def test_faces_of_a_window_show_labels(lab: Lab, make_bench: Make, tmp_path: Path) -> None:
    bench, _ = coloured_bench(make_bench, by_labels(tmp_path))
    view = replace(bench.view(elevation=60.0), width=SIZE[0], height=SIZE[1])
    view = replace(view, window=read_window("z>9.3"))
    bench.bake(view)
    frame = bench.renderer.render(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    pixels = bench.renderer.gbuffer(view).faces.pixels
    expected = frame.radiance.reshape(-1, 3)[pixels]
    shown = card.picture(view).light.reshape(-1, 3)[pixels]
    assert len(pixels) > 300 and np.ptp(expected / expected.max(), axis=0).min() > 0.2
    near = np.abs(shown - expected).max(axis=1) < 0.005 * expected.max()
    assert near.mean() > 0.995, near.mean()


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.long] * (each != "file")) for each in SCENES]
)
def test_the_check_at_rest_takes_a_coloured_card(
    lab: Lab, make_bench: Make, tmp_path: Path, name: str
) -> None:
    """Fewer than 1 % of the inner pixels differ from the server's final picture."""
    settings = {"bounces": 1, "target_error": 0.05}
    bench = make_bench(SCENES[name](tmp_path, **settings))
    view = bench.view(size=200)
    shown = develop(bench.bake(view), 1.0, background="dark")
    opaque = np.full((*shown.shape[:2], 1), 255)
    lab.put("server", np.concatenate([shown, opaque], axis=2).astype(np.uint8).tobytes())
    card = CardScene(lab, bench.renderer, view, (200, 200), lobes=True)
    card.light(view, 0.05)
    card.picture(view, rest=True, ground=ground_of("dark"))
    share = lab.ask(
        """const { shareThatDiffers } = await import("/web/live/check.js");
        const server = new Uint8Array(await bench.bytes("server"));
        return shareThatDiffers(card.read(), server, card.canvas, given);""",
        0.05,
    )
    assert share < 0.01, share


def test_a_lost_card_comes_back_in_colours(lab: Lab, make_bench: Make, tmp_path: Path) -> None:
    bench, view = coloured_bench(make_bench, by_gradient(tmp_path))
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    before = card.picture(view)
    lab.ask("""const loss = card.device.gl.getExtension("WEBGL_lose_context");
      const back = new Promise((done) => { card.onrestored = done; });
      loss.loseContext();
      setTimeout(() => loss.restoreContext(), 100);
      await back;""")
    np.testing.assert_array_equal(card.picture(view).light, before.light)


def test_codes_that_no_surface_shows_are_zero(tmp_path: Path) -> None:
    """All that surfaces between the ends show is sent; the rest compresses to nothing."""
    scene = by_gradient(tmp_path)
    codes = ColourCodes.of(scene)
    assert codes is not None
    whole = codes.colours.places
    depth = len(whole)
    sent = np.concatenate([codes.layers(a, min(a + 3, depth)) for a in range(0, depth, 3)])
    assert sent.shape == whole.shape and np.isin(sent, (0, *np.unique(whole))).all()
    low, high = codes.ends
    voxels = scene.volume.voxels
    corners = np.stack(
        [
            voxels[k : k - 1 or None, j : j - 1 or None, i : i - 1 or None]
            for k, j, i in np.ndindex(2, 2, 2)
        ]
    )
    shown = (corners.min(axis=0) <= high) & (corners.max(axis=0) >= low)
    for k, j, i in np.ndindex(2, 2, 2):
        part = tuple(slice(x, x - 1 or None) for x in (k, j, i))
        np.testing.assert_array_equal(sent[part][shown], whole[part][shown])
    assert (sent == 0).mean() > 0.5


def test_codes_by_other_voxels_have_another_version(tmp_path: Path) -> None:
    """By a version an answer is kept for ever, and voxels decide which codes are 0."""
    scene = by_gradient(tmp_path)
    voxels = np.roll(scene.volume.voxels, 3, axis=0)
    moved = replace(scene, volume=replace(scene.volume, voxels=voxels, digest="of those moved"))
    one, other = ColourCodes.of(scene), ColourCodes.of(moved)
    assert one is not None and other is not None
    depth = len(voxels)
    assert (one.layers(0, depth) != other.layers(0, depth)).any()
    assert one.version != other.version


def test_the_table_of_labels_is_short(make_bench: Make, tmp_path: Path) -> None:
    bench = make_bench(by_labels(tmp_path, lights=[CONSTANT]))
    found = card_scene(bench.renderer, bench.view(), ()).colours
    assert found is not None and found.kind == "labels" and len(found.table) == 4
    assert found.size == (28, 24, 20) and found.bytes == 3 * BALL.size
