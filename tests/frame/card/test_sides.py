"""Light of several surfaces for cards: chunks of all sides, and what they depend on."""

from dataclasses import replace
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import NoRoomError
from isogi_core.frame.card import looks
from isogi_core.frame.card.looks import Look
from isogi_core.frame.card.sides import (
    chunks_of_sides,
    known_light_of_sides,
    look_at_sides,
    seen_on_sides,
)
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.frame.several.peeling_renderer import PeelingRenderer
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.plan.variants import Side
from isogi_core.prepared.prepared_scene import Index
from tests.card_twin import blocks_in
from tests.frame.conftest import LOOSE, SKY, Workbench
from tests.frame.several.drawing import bake
from tests.loaded import load_scene

HALO = {"isovalue": 0.012, "albedo": 0.6, "clear": 0.65}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital in a clear shell."""
    scene = load_scene(
        "demo:orbital", isovalue=0.06, lights=[SKY], bounces=1, target_error=0.3, surfaces=[HALO]
    )
    return Workbench(scene, tmp_path_factory.mktemp("sides"))


def view_at(bench: Workbench, isovalue: float = 0.06) -> View:
    """A small view of an isovalue."""
    return bench.view(size=24, isovalue=isovalue)


def look(bench: Workbench, view: View) -> Look:
    """The look of a view."""
    return look_at_sides(bench.renderer, view, Goal.checked(LOOSE), bench.renderer.tiles)


def versions_of(bench: Workbench, isovalue: float) -> dict[Index, bytes]:
    """The versions of all chunks in sight, baked by then."""
    view = view_at(bench, isovalue)
    bake(bench, view)
    return {each.at: each.version for each in look(bench, view).seen}


def test_a_view_names_the_chunks_of_all_sides_that_it_shows(bench: Workbench) -> None:
    view = view_at(bench)
    deep = bench.prepared.chunks[0]
    assert chunks_of_sides(bench.scene, bench.prepared.chunks)[0] == 4 * deep
    shown = {part.side.peeled for part in parts_of(bench.renderer.render(view))}
    assert {each.at[0] // deep for each in look(bench, view).seen} == shown


def test_a_view_that_lacks_light_asks_for_it(bench: Workbench) -> None:
    fresh = Workbench(bench.scene, bench.folder / "fresh")
    view = view_at(fresh)
    found = look(fresh, view)
    assert found.frame is not None and found.frame.stages
    assert not any(any(each.version) for each in found.seen)
    bake(fresh, view)
    assert look(fresh, view).frame is None


def test_light_of_pinned_surfaces_has_a_version_at_each_isovalue(bench: Workbench) -> None:
    deep = bench.prepared.chunks[0]
    some, others = versions_of(bench, 0.06), versions_of(bench, 0.07)
    pinned = [at for at in some.keys() & others.keys() if at[0] >= 2 * deep]
    assert pinned and all(some[at] != others[at] for at in pinned)


def test_blocks_are_those_that_the_list_names(bench: Workbench) -> None:
    view = view_at(bench, 0.07)
    bake(bench, view)
    seen = look(bench, view).seen
    chunks = [each.at for each in seen]
    goal, tiles = Goal.checked(LOOSE), bench.renderer.tiles
    found = known_light_of_sides(bench.renderer, view, chunks, goal, tiles)
    blocks = blocks_in(b"".join(each.data for each in found.blocks))
    assert [block.at for block in blocks] == chunks
    assert [bytes.fromhex(block.version) for block in blocks] == [each.version for each in seen]
    assert all(len(block.records) for block in blocks)
    again = known_light_of_sides(bench.renderer, view, chunks[:1], goal, tiles)
    assert again.blocks[0] is found.blocks[0], "each is folded once"
    other = known_light_of_sides(bench.renderer, replace(view, isovalue=0.06), chunks, goal, tiles)
    same = [one is two for one, two in zip(found.blocks, other.blocks, strict=True)]
    deep = bench.prepared.chunks[0]
    assert same == [at[0] < 2 * deep for at in chunks], "the sliding surface has the same light"


def test_a_list_of_chunks_draws_no_picture(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = Workbench(bench.scene, bench.folder / "undrawn")
    view = view_at(fresh)
    seen = look(fresh, view).seen
    assert not all(each.final for each in seen)
    monkeypatch.setattr(PeelingRenderer, "draw", None)
    assert seen_on_sides(fresh.renderer, view, Goal.checked(LOOSE), Tiles()) == seen


def test_a_version_is_that_of_the_light_that_was_read(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light of all sides comes right after that of the first was found lacking."""
    fresh = Workbench(bench.scene, bench.folder / "meanwhile")
    view = view_at(fresh)
    before = look(fresh, view).seen

    def read(*given: Any) -> Reading:
        found = read_texels(*given)
        bake(fresh, view)
        return found

    monkeypatch.setattr(looks, "read_texels", read)
    found = look(fresh, view).seen
    after = look(fresh, view).seen
    assert set(found) & set(before) and set(found) & set(after)
    assert set(found) <= {*before, *after}


@pytest.mark.parametrize("times", [1, 2])
def test_cards_keep_to_the_memory_of_light(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    """Light of other isovalues makes room once; what still takes too much is refused."""
    view = view_at(bench)
    bake(bench, view)
    goal, tiles = Goal.checked(LOOSE), Tiles()
    seen = look(bench, view).seen
    chunks = [each.at for each in seen]
    blocks = known_light_of_sides(bench.renderer, view, chunks, goal, tiles).blocks
    peeling = bench.renderer.peeling
    assert peeling is not None
    full: list[NoRoomError] = []

    def check(_: PeelingRenderer) -> None:
        if full:
            raise full.pop()

    monkeypatch.setattr(PeelingRenderer, "check_room", check)
    for find, expected in (
        (lambda: seen_on_sides(bench.renderer, view, goal, tiles), seen),
        (lambda: known_light_of_sides(bench.renderer, view, chunks, goal, tiles).blocks, blocks),
    ):
        before = peeling.renderer_of(Side(1), view.isovalue)
        full.extend(times * [NoRoomError("full")])
        if times == 1:
            assert find() == expected
        else:
            with pytest.raises(NoRoomError, match="full"):
                find()
        assert not full and peeling.renderer_of(Side(1), view.isovalue) is not before
