"""Blocks that are known: packed once for all that ask, until what they show is baked on."""

from collections.abc import Sequence

import pytest

from isogi_core.frame.card import blocks
from isogi_core.frame.card.blocks import fold_chunks, known_light, known_transfer, look_at, seen_chunks
from isogi_core.frame.known_blocks import KnownBlocks, Packed
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.prepared.prepared_scene import Index
from tests.frame.card.benches import SCENES, TILES, Make
from tests.frame.conftest import Workbench
from tests.loaded import load_scene

TARGET = 0.02


@pytest.fixture
def bench(workbench: Make) -> Workbench:
    """A scene whose light is grainy, so that blocks depend on chunks beside."""
    found = workbench(load_scene("demo:orbital", bounces=2, target_error=TARGET, **SCENES["albedos"]))
    found.bake(found.view(size=40), 0.6)
    return found


@pytest.fixture
def folded(monkeypatch: pytest.MonkeyPatch) -> list[Index]:
    """Every chunk that is folded, as often as it is."""
    counted: list[Index] = []

    def counting(renderer: object, view: View, chunks: Sequence[Index], *more: object) -> Packed:
        counted.extend(chunks)
        return fold_chunks(renderer, view, chunks, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(blocks, "fold_chunks", counting)
    return counted


def seen(bench: Workbench) -> list[Index]:
    return [each.at for each in seen_chunks(bench.renderer, bench.view(size=40), TARGET, TILES)]


def data(packed: Packed) -> list[bytes]:
    return [each.data for each in packed.blocks]


def test_chunks_are_folded_once_for_all_visitors(bench: Workbench, folded: list[Index]) -> None:
    view, at = bench.view(size=40), seen(bench)
    once = known_light(bench.renderer, view, at[:5], TARGET, TILES)
    again = known_light(bench.renderer, view, [*at[::-1], at[0]], TARGET, TILES)
    assert sorted(folded) == sorted(at)
    assert once.blocks == again.blocks[-2:-7:-1] and again.blocks[-1] is once.blocks[0]
    assert data(again)[:-1] == data(fold_chunks(bench.renderer, view, at[::-1], TARGET, TILES))
    assert not again.alone


@pytest.mark.parametrize("change", ["light", "albedo", "target"])
def test_other_light_is_folded_by_itself(bench: Workbench, folded: list[Index], change: str) -> None:
    view, at = bench.view(size=40), seen(bench)[:3]
    known_light(bench.renderer, view, at, TARGET, TILES)
    more = {"light": {"light": quaternion_from_angles(70.0, 0.0, 0.0)}, "albedo": {"albedo": (0.3, 0.3, 0.3)}}
    other, target = bench.view(size=40, **more.get(change, {})), 0.3 if change == "target" else TARGET
    found = known_light(bench.renderer, other, at, target, TILES)
    assert len(folded) == 6
    assert data(found) == data(fold_chunks(bench.renderer, other, at, target, TILES))


def test_what_is_baked_on_is_folded_once_more(bench: Workbench, folded: list[Index]) -> None:
    """So are the chunks beside, whose light is filtered by it."""
    view, at = bench.view(size=40), seen(bench)
    known_light(bench.renderer, view, at, TARGET, TILES)
    folded.clear()
    bench.bake(bench.view(size=16), 0.3)
    found = known_light(bench.renderer, view, at, TARGET, TILES)
    assert folded
    assert data(found) == data(fold_chunks(bench.renderer, view, at, TARGET, TILES))


def test_transfer_is_known_whatever_the_light(bench: Workbench) -> None:
    at = seen(bench)[:4]
    once, again = (known_transfer(bench.renderer, at, TARGET, TILES) for _ in range(2))
    assert once.blocks == again.blocks
    assert once.blocks != known_light(bench.renderer, bench.view(size=40), at, TARGET, TILES).blocks


def test_known_blocks_take_few_bytes(bench: Workbench, folded: list[Index]) -> None:
    """The oldest go, and are folded once more."""
    view, at = bench.view(size=40), seen(bench)
    bench.renderer.blocks = known = KnownBlocks(100_000)
    for each in at:
        known_light(bench.renderer, view, [each], TARGET, TILES)
        assert known.nbytes <= 100_000
    known_light(bench.renderer, view, [at[0]], TARGET, TILES)
    assert folded.count(at[0]) == 2 and folded.count(at[-1]) == 1


def test_a_look_at_final_light_is_kept_until_more_is_baked(bench: Workbench) -> None:
    view = bench.view(size=40)
    once = look_at(bench.renderer, view, 0.9, TILES)
    assert once.frame is None and look_at(bench.renderer, view, 0.9, TILES) is once
    bench.bake(bench.view(size=16), 0.3)
    again = look_at(bench.renderer, view, 0.9, TILES)
    assert again.seen != once.seen and [each.at for each in again.seen] == [each.at for each in once.seen]


def test_a_look_at_light_to_come_is_not_kept(bench: Workbench) -> None:
    view = bench.view(azimuth=220.0, size=40)
    once, again = (look_at(bench.renderer, view, 0.9, TILES) for _ in range(2))
    assert once.frame is not None and again.frame is not once.frame and again.seen == once.seen
