"""A card in a page: what it refuses, how it is lost and comes back, what it does while it is slow,
what it filters.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.looks import seen_chunks
from isogi_core.model.view import View
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench
from tests.loaded import load_scene
from tests.web.card.conftest import Make
from tests.web.card.lab import (
    IDENTITY,
    TURN,
    CardScene,
    Lab,
    difference,
    lab_in,
    plain_light,
    toned,
    view_of,
)

SIZE = (48, 48)


@pytest.fixture(scope="module")
def bench(make_bench: Make) -> Workbench:
    """The orbital under a sky; ``view_at`` is baked."""
    bench = make_bench(
        load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.3, projected=False)
    )
    bench.bake(view_at(bench))
    return bench


def view_at(bench: Workbench, **settings: Any) -> View:
    return bench.view(size=SIZE[0], **settings)


REFUSAL = """const { Refusal, openDevice } = await import("/web/card/device.js");
  try { openDevice(document.createElement("canvas")); }
  catch (error) { return [error instanceof Refusal, error.message]; }"""


def test_a_processor_is_found_by_its_time(lab: Lab) -> None:
    """By the time of a small picture, whatever it is called; a card's is stubbed."""
    script = """const { Card } = await import("/web/card/card.js");
      const card = Card.open(document.createElement("canvas"));
      const { gl } = card.device;
      const slow = await card.isQuick();
      gl.drawArrays = () => {};
      const quick = await card.isQuick();
      return [slow, quick, gl.getError()];"""
    assert lab.ask(script) == [False, True, 0]


def test_without_webgl_the_reason_is_a_sentence(browser: Browser) -> None:
    with lab_in(browser) as lab:
        lab.ask("HTMLCanvasElement.prototype.getContext = () => null;")
        refused, reason = lab.ask(REFUSAL)
        assert refused and reason == "This browser has no WebGL 2: the server draws."


def test_a_card_without_targets_of_floats_is_refused(browser: Browser) -> None:
    with lab_in(browser) as lab:
        lab.ask("""const { getExtension } = WebGL2RenderingContext.prototype;
          WebGL2RenderingContext.prototype.getExtension = function (name) {
            return name.startsWith("EXT_color_buffer") ? null : getExtension.call(this, name);
          };""")
        refused, reason = lab.ask(REFUSAL)
        assert refused and "cannot draw into textures of floats: the server draws." in reason


def test_a_card_with_small_textures_refuses_a_volume(lab: Lab, bench: Workbench) -> None:
    scene = CardScene(lab, bench.renderer, view_at(bench), SIZE)
    longest = max(bench.scene.volume.size)
    found = lab.ask(
        """card.device.most3d = given - 1;
        const { document, volume } = card.drawing;
        try {
          await card.load(document, [volume.source.buffer]);
        } catch (error) {
          return error.message;
        }""",
        longest,
    )
    assert str(longest) in found and "server draws" in found
    assert scene.picture(view_at(bench)).covers.sum() > 100, "the scene before is still drawn"


def test_a_card_without_memory_refuses_a_scene(lab: Lab, bench: Workbench) -> None:
    scene = CardScene(lab, bench.renderer, view_at(bench), SIZE)
    found = lab.ask("""const { gl } = card.device, { document, volume } = card.drawing;
        const { Refusal } = await import("/web/card/device.js");
        gl.getError = () => gl.OUT_OF_MEMORY;
        try { await card.load(document, [volume.source.buffer]); }
        catch (error) { return [error instanceof Refusal, error.message]; }
        finally { delete gl.getError; }""")
    assert found == [True, "The graphics card has no memory left for this scene: the server draws."]
    assert scene.picture(view_at(bench)).covers.sum() > 100, "the scene before is still drawn"


def test_the_newest_scene_is_the_one_that_is_drawn(lab: Lab, bench: Workbench) -> None:
    """Voxels of a scene that was asked for before may come late."""
    CardScene(lab, bench.renderer, view_at(bench), SIZE)
    script = """const { document, volume } = card.drawing, slabs = [volume.source.buffer];
        let come;
        const late = new Promise((done) => { come = () => done(slabs); });
        const first = card.load({ ...document, isovalues: "first" }, late);
        await card.load({ ...document, isovalues: "second" }, slabs);
        come();
        await first;
        return card.drawing.document.isovalues;"""
    assert lab.ask(script) == "second"


LOSE = """const context = card.device.gl.getExtension("WEBGL_lose_context"), said = [];
  card.onlost = () => said.push("lost");
  const restored = new Promise((done) => {
    card.onrestored = () => { said.push("restored"); done(); };
  });
  const lost = new Promise((done) => card.canvas.addEventListener("webglcontextlost", done));
  context.loseContext();
  await lost;
  said.push(card.draw(given), card.refine());
  await new Promise((done) => setTimeout(done, 50));
  context.restoreContext();
  await restored;
  return said;"""


def test_a_lost_card_comes_back_with_all_it_had(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, 0.3, raw=True)
    before = card.picture(view)
    turned = card.picture(replace(view, light=TURN))
    assert lab.ask(LOSE, view_of(view)) == ["lost", False, False, "restored"]
    after = card.picture(view)
    assert np.array_equal(after.light, before.light) and np.array_equal(after.covers, before.covers)
    assert np.array_equal(card.picture(replace(view, light=TURN)).light, turned.light)


def test_only_what_lacks_is_asked_for(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    seen = seen_chunks(bench.renderer, view, Goal.checked(0.3), bench.renderer.tiles)
    listed = [{"at": ".".join(map(str, each.at)), "version": each.version.hex()} for each in seen]
    listed.append({"at": "0.0.0", "version": "0" * 16})

    def lacking(turn: tuple[float, ...] = IDENTITY) -> dict[str, list[str]]:
        return lab.ask(
            "return card.lacking(given.listed, given.turn);", {"listed": listed, "turn": turn}
        )

    names = [f"{each['at']}-{each['version']}" for each in listed[:-1]]
    assert lacking() == {"light": names, "transfer": []}
    card.light(view, 0.3)
    assert lacking() == {"light": [], "transfer": names}
    assert lacking(TURN) == {"light": names, "transfer": names}, "what was folded by another light"
    card.light(view, 0.3, raw=True)
    assert lacking() == lacking(TURN) == {"light": [], "transfer": []}
    listed[0]["version"] = "f" * 16
    assert lacking()["light"] == [f"{listed[0]['at']}-{'f' * 16}"], "what has grown"


@pytest.mark.long
@pytest.mark.usefixtures("unfiltered")
def test_texels_that_a_card_has_no_rows_for_go_oldest_first(lab: Lab, bench: Workbench) -> None:
    """Light of four views goes onto a card that has rows for about one; the newest is whole, and
    drawn.
    """
    views = [view_at(bench, azimuth=azimuth) for azimuth in (40.0, 130.0, 220.0, 310.0)]
    card = CardScene(lab, bench.renderer, views[0], SIZE)
    for view in views:
        bench.bake(view)
    sizes = []
    named = []
    for view in views:
        seen = seen_chunks(bench.renderer, view, Goal.checked(0.3), bench.renderer.tiles)
        named.append({".".join(map(str, each.at)) for each in seen})
        card.light(view, 0.3)
        sizes.append(lab.ask("return card.drawing.texels.rows;"))
    script = """card.device.most2d = given;
        await card.load(card.drawing.document, [card.drawing.volume.source.buffer]);"""
    lab.ask(script, max(sizes[0], 2))
    for view in views:
        card.light(view, 0.3)
    here = set(lab.ask("return [...card.drawing.texels.chunks.keys()];"))
    assert named[3] <= here and not set.union(*named) <= here
    found = difference(card.picture(views[3]), *plain_light(bench.renderer, views[3], 0.3))
    assert found.within >= 0.999, found


def test_what_lacks_light_is_hatched_where_marks_are_asked_for(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    other = view_at(bench, azimuth=75.0)
    bench.bake(other)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, 0.3)
    plain = card.picture(other)
    marked = card.picture(other, marked=True)
    changed = np.abs(marked.light - plain.light).max(axis=2) > 1e-6
    assert 0.02 < changed.sum() / plain.covers.sum() < 0.9 and not changed[plain.covers == 0].any()
    same = card.picture(view, marked=True)
    assert np.array_equal(same.light, card.picture(view).light), (
        "nothing lacks where all light is there"
    )
    y, x = np.indices(changed.shape)
    veil = np.where((x + y) % 12 < 6, 0.55, 0.15)[..., None]
    expected = (1.0 - veil) * toned(plain.light) + veil * np.array([0.95, 0.42, 0.05])
    assert np.abs(toned(marked.light) - expected)[changed].max() < 0.01


def test_an_isovalue_slides_without_new_data(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench, shading="lambert")
    card = CardScene(lab, bench.renderer, view, SIZE)
    low, high = bench.scene.isovalues
    for share in (0.2, 0.3, 0.15):
        shown = replace(view, isovalue=low + share * (high - low))
        frame = bench.renderer.render(shown)
        found = difference(card.picture(shown), frame.radiance, frame.state > 0)
        assert found.surface > 50 and found.within > 0.998, (share, found)


def test_a_slow_card_draws_fewer_pixels(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    CardScene(lab, bench.renderer, view, SIZE)
    script = """let time = 0;
      card.pace.clock = { now: () => time, after: () => {} };
      card.pace.share = 1;
      const { gl } = card.device, { clientWaitSync } = gl;
      const pause = () => new Promise((done) => setTimeout(done, 5));
      const widths = [];
      for (let i = 0; i < 6; i++) {
        while (!card.draw(given.view)) await pause();
        widths.push(card.last.size[0]);
        gl.clientWaitSync = () => gl.TIMEOUT_EXPIRED;
        time += given.ms;
        card.pace.busy;
        gl.clientWaitSync = clientWaitSync;
      }
      while (card.last.samples < 2) {
        card.refine();
        await pause();
      }
      return [...widths, card.last.size[0]];"""
    slow = lab.ask(script, {"view": view_of(view), "ms": 400})
    assert slow[0] == slow[-1] == SIZE[0] and min(slow[:-1]) < 0.5 * SIZE[0]
    assert slow[:-1] == sorted(slow[:-1], reverse=True)


@pytest.mark.long
def test_bands_of_a_picture_leave_no_seam(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, 0.3)
    whole = card.picture(view, rest=True)
    lab.ask("card.pace.rowsOf = (size, left) => Math.min(given, left);", 7)
    banded = card.picture(view, rest=True)
    np.testing.assert_array_equal(banded.light, whole.light)
    np.testing.assert_array_equal(banded.covers, whole.covers)


def test_a_still_view_is_drawn_in_all_pixels(lab: Lab, bench: Workbench) -> None:
    view = view_at(bench)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, 0.3)
    whole = card.picture(view, rest=True)
    script = """const pause = () => new Promise((done) => setTimeout(done, 5));
      while (card.pace.busy) await pause();
      card.pace.share = 0.4;
      card.draw(given);
      const size = card.last.size;
      while (card.refine()) await pause();
      return [size, card.last.size, card.last.samples, card.refine()];"""
    small, large, samples, more = lab.ask(script, view_of(view))
    assert (small, large, more) == ([19, 19], list(SIZE), False) and samples == 17
    again = lab.floats(
        "return bench.packed(bench.readFloats(card.device.gl, card.drawing.picture.targets[1], "
        "48, 48));"
    )
    np.testing.assert_array_equal(again.reshape(48, 48, 4)[..., :3], whole.light)


def test_the_screen_shows_what_isogi_develops(lab: Lab, make_bench: Make) -> None:
    """Exposure, tone curve, sRGB and ground, on the canvas itself."""
    from isogi_core.frame.film import develop, ground_of

    bench = make_bench(
        load_scene(
            "demo:orbital", lights=[CONSTANT], bounces=1, target_error=LOOSE, projected=False
        )
    )
    view = view_at(bench)
    frame = bench.bake(view)
    card = CardScene(lab, bench.renderer, view, SIZE)
    card.light(view, LOOSE)
    for exposure, ground in ((1.0, "dark"), (2.5, "light")):
        card.picture(view, exposure=exposure, ground=ground_of(ground))
        script = """card.drawing.show(card.last.view, card.last.size);
          const { gl } = card.device;
          const found = new Uint8Array(4 * 48 * 48);
          const rows = new Float32Array(found.length);
          gl.bindFramebuffer(gl.FRAMEBUFFER, null);
          gl.readPixels(0, 0, 48, 48, gl.RGBA, gl.UNSIGNED_BYTE, found);
          for (let y = 0; y < 48; y++)
            rows.set(found.subarray(192 * y, 192 * (y + 1)), 192 * (47 - y));
          return bench.packed(rows);"""
        shown = lab.floats(script).reshape(48, 48, 4)[..., :3]
        plain = replace(frame, radiance=plain_light(bench.renderer, view, LOOSE)[0], edges=None)
        assert np.abs(shown - develop(plain, exposure, background=ground)).max() <= 2


WRONG = {
    "texels are read elsewhere": (
        "irradiance_ratio.glsl",
        "q = p * density",
        "q = p.zyx * density",
    ),
    "light is too bright": ("view.glsl", "return unit * albedo", "return 2.0 * unit * albedo"),
}
SPOIL = """const { readShader } = await import("/web/card/programs.js");
  window.spoiled = async (name) => {
    const text = await readShader(name);
    if (!given.file.startsWith(name)) return text;
    if (!text.includes(given.from)) throw new Error(`${given.file} has no ${given.from}`);
    return text.replaceAll(given.from, given.to);
  };
  window.mend = () => { delete window.spoiled; };"""
CHECK = """const { shareThatDiffers } = await import("/web/live/check.js");
  const server = new Uint8Array(await bench.bytes("server"));
  return shareThatDiffers(card.read(), server, card.canvas, given);"""


@pytest.mark.parametrize(
    "wrong",
    [
        None,
        "light is too bright",
        pytest.param("texels are read elsewhere", marks=pytest.mark.long),
    ],
)
def test_a_driver_that_draws_wrongly_is_found(
    lab: Lab, make_bench: Make, wrong: str | None
) -> None:
    """The card's picture at rest beside the server's, away from edges."""
    from isogi_core.frame.film import develop, ground_of

    settings = {"lights": [CONSTANT], "bounces": 1, "target_error": 0.05, "projected": False}
    bench = make_bench(load_scene("demo:orbital", **settings))
    view = bench.view(size=200)
    shown = develop(bench.bake(view), 1.0, background="dark")
    opaque = np.full((*shown.shape[:2], 1), 255)
    lab.put("server", np.concatenate([shown, opaque], axis=2).astype(np.uint8).tobytes())
    if wrong:
        lab.ask(SPOIL, dict(zip(("file", "from", "to"), WRONG[wrong], strict=True)))
    try:
        card = CardScene(lab, bench.renderer, view, (200, 200))
        card.light(view, 0.05)
        card.picture(view, rest=True, ground=ground_of("dark"))
        share = lab.ask(CHECK, 0.05)
    finally:
        lab.ask("window.mend?.();")
    assert share > 0.01 if wrong else share < 0.003, share


WIDE = (72, 56)
TENTH = 0.1


def noisy_bench(make_bench: Make, lattice: dict[str, float]) -> Workbench:
    """A view of the orbital, baked to a tenth."""
    settings = {
        "lights": [SKY],
        "albedo": [0.8, 0.6, 0.4],
        "bounces": 2,
        "target_error": TENTH,
        "projected": False,
    }
    bench = make_bench(load_scene("demo:orbital", **settings, **lattice))
    bench.bake(replace(bench.view(), width=WIDE[0], height=WIDE[1]))
    return bench


@pytest.mark.parametrize(
    "lattice",
    [
        pytest.param({}, id="plain"),
        pytest.param({"lattice": 1.5, "chunk": 8}, id="fine", marks=pytest.mark.long),
    ],
)
def test_a_turned_light_is_filtered_on_the_card(
    lab: Lab, make_bench: Make, lattice: dict[str, float]
) -> None:
    bench = noisy_bench(make_bench, lattice)
    view = replace(bench.view(), width=WIDE[0], height=WIDE[1])
    card = CardScene(lab, bench.renderer, view, WIDE)
    card.light(view, TENTH, raw=True)
    turned = replace(view, light=TURN)
    light, on = plain_light(bench.renderer, turned, TENTH)
    found = difference(card.picture(turned), light, on)
    assert found.surface > 500 and found.within >= 0.999 and found.rmse <= 0.002, found
    lab.ask(
        """card.drawing.refold();
      for (const run of card.drawing.texels.runs)
        run.raw.forEach((each) => { each.grainy = false; });"""
    )
    assert difference(card.picture(turned), light, on).rmse > 10 * found.rmse, (
        "the filter makes a difference"
    )


@pytest.mark.usefixtures("unfiltered")
def test_final_light_is_not_filtered(lab: Lab, make_bench: Make) -> None:
    bench = noisy_bench(make_bench, {})
    view = replace(bench.view(), width=WIDE[0], height=WIDE[1])
    CardScene(lab, bench.renderer, view, WIDE).light(view, TENTH, raw=True)
    assert lab.ask("return [card.drawing.texels.grainy, card.drawing.texels.runs.length > 0];") == [
        False,
        True,
    ]
