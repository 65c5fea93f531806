"""Light that turns over a view at rest, by the transfer of the view's points."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame import frame as frames
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays import own_light
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.rays.pixel_rays import Paths
from isogi_core.frame.rays.point_transfer import PointTransfer, ViewTransfer, transfer_key
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shot import Shot
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import IDENTITY, View
from tests.frame.conftest import SKY, Workbench, true_error
from tests.loaded import load_scene

TARGET = 0.03
SIZE = 96
GOAL = Goal.checked(TARGET)


def workbench(folder: Path, **settings: Any) -> Workbench:
    """A surface without light, of many more texels than its pictures have pixels."""
    scene = load_scene(
        "demo:orbital", lights=[SKY], bounces=2, lattice=2, target_error=TARGET, **settings
    )
    return Workbench(scene, folder)


@pytest.fixture
def bench(tmp_path: Path) -> Workbench:
    """The plain scene."""
    return workbench(tmp_path)


@pytest.fixture(autouse=True)
def dear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texels of small volumes count, although a person hardly waits for them."""
    monkeypatch.setattr(frames, "QUICK_TEXELS", 0)


def turned(view: View, degrees: float) -> View:
    """The view under its light, turned about the z axis."""
    half = math.radians(degrees) / 2.0
    return replace(view, light=(math.cos(half), 0.0, 0.0, math.sin(half)))


def settled(bench: Workbench, view: View) -> Frame:
    """The picture of a view when its check has ended; nothing is baked."""
    return bench.settled(view, TARGET)


def known(frame: Frame) -> PictureState:
    """The state of a picture's check."""
    assert frame.quality.known is not None
    return frame.quality.known


def shot_of(bench: Workbench, view: View) -> Shot:
    """The shot of a view."""
    renderer = bench.renderer
    return renderer.surface.shot(view, renderer.gbuffer(view), GOAL, renderer.tiles)


def kept_transfer(bench: Workbench, view: View) -> ViewTransfer:
    """The transfer of a view's points."""
    found = bench.renderer.surface.kept.held(transfer_key(view))
    assert isinstance(found, ViewTransfer)
    return found


def test_light_that_turned_is_that_of_the_transfer(bench: Workbench) -> None:
    """The first light is traced by paths. All others are final too, with the error that is told."""
    view = bench.view(size=SIZE)
    assert known(settled(bench, view)).lit_by == "paths"
    for degrees in (40.0, 80.0):
        frame = settled(bench, turned(view, degrees))
        assert known(frame).lit_by == "transfer" and frame.goes_without_texels and not frame.stages
        assert frame.final and frame.total.high <= TARGET
        assert true_error(bench, frame) < 1.2 * TARGET
    assert not bench.layers, "nothing was baked"


def test_a_further_turn_is_lit_at_once(bench: Workbench) -> None:
    """The first step of its check lights all pixels, without any path for them."""
    view = bench.view(size=SIZE)
    settled(bench, view)
    settled(bench, turned(view, 40.0))
    traced = kept_transfer(bench, view).newest
    assert bench.renderer.refine(turned(view, 80.0), GOAL)
    frame = bench.renderer.render(turned(view, 80.0), GOAL)
    assert not frame.provisional and not len(known(frame).own.places)
    assert kept_transfer(bench, view).newest is traced
    assert true_error(bench, frame) < 4.0 * TARGET


def test_the_first_light_comes_back_as_it_was(bench: Workbench) -> None:
    """Its picture is kept, and stays one of paths."""
    view = bench.view(size=SIZE)
    before = settled(bench, view)
    settled(bench, turned(view, 40.0))
    after = settled(bench, view)
    assert after.version == before.version
    assert (after.radiance == before.radiance).all()


def test_pictures_by_transfer_come_again(bench: Workbench) -> None:
    """A server that was started anew shows the same pictures after the same views."""
    view = bench.view(size=SIZE)

    def last(one: Workbench) -> Frame:
        settled(one, view)
        return settled(one, turned(view, 40.0))

    once = last(bench)
    again = last(bench.again())
    assert once.version == again.version
    assert (once.radiance == again.radiance).all()


def test_growing_in_steps_gives_the_same_sums(bench: Workbench) -> None:
    """Samples follow those before, whichever way they are split."""
    shot = shot_of(bench, bench.view(size=32))
    stepwise = PointTransfer().grown(shot, 16).grown(shot, 64)
    whole = PointTransfer().grown(shot, 64)
    assert stepwise.samples == whole.samples == 64
    for few, many in zip(stepwise.sums, whole.sums, strict=True):
        assert (few == many).all()


def test_the_transfer_lights_points_as_paths_do(bench: Workbench) -> None:
    """The mean light of all points is that of paths which gather it, lobes apart."""
    view = turned(bench.view(size=32), 70.0)
    shot = shot_of(bench, view)
    found = PointTransfer().grown(shot, 256).lit(shot).light
    lobes = shot.light.spec.unit * bench.renderer.surface.lobes(shot.light, shot.gbuffer).lit
    sums = np.zeros((len(found), 2, 3))
    Paths(shot.light, shot.gbuffer, shot.tiles).add(sums, 0, 0, 256)
    traced = sums.mean(axis=(0, 1)) / 256
    assert found.mean(axis=0) + lobes[:, :3].mean(axis=0) == pytest.approx(traced, rel=0.02)


def test_a_transfer_that_spares_nothing_is_not_used_again(bench: Workbench) -> None:
    """If all points took light of their own under the first rotation, paths alone light the next
    ones of that target; a looser target may still use it.
    """
    view = bench.view(size=SIZE)
    settled(bench, view)
    shot = shot_of(bench, turned(view, 40.0))
    transfer = kept_transfer(bench, view)
    transfer.grow(shot, 16)
    assert transfer.nbytes > 0 and transfer.serves(shot)
    transfer.give_up(shot)
    assert transfer.nbytes == 0 and not transfer.serves(shot)
    assert transfer.serves(replace(shot, goal=Goal.checked(2.0 * TARGET)))
    frame = settled(bench, turned(view, 80.0))
    assert frame.final and known(frame).lit_by == "paths"


def test_a_later_rotation_gives_no_transfer_up(bench: Workbench) -> None:
    """A dark one may take light of its own for all points, and costs the others nothing."""
    view = bench.view(size=32)
    settled(bench, view)
    first = shot_of(bench, turned(view, 40.0))
    transfer = ViewTransfer(view.light)
    traced = transfer.grow(first, 16)
    transfer.give_up(shot_of(bench, turned(view, 170.0)))
    assert transfer.newest is traced and transfer.serves(first)


def test_a_check_whose_points_all_take_light_gives_up(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its picture still comes to the target."""
    monkeypatch.setattr(own_light, "FEW_LEFT", 1.1)
    view = bench.view(size=SIZE)
    settled(bench, view)
    strict = Goal.checked(TARGET / 3.0)
    frame = bench.settled(turned(view, 40.0), strict.error)
    assert known(frame).lit_by == "transfer" and frame.final
    assert len(known(frame).own.places) == len(frame.gbuffer.pixels)
    assert kept_transfer(bench, view).vain == strict.error


def test_little_memory_keeps_no_transfer(tmp_path: Path) -> None:
    """Paths light each turn of the light then."""
    bench = workbench(tmp_path)
    bench.renderer = Renderer(bench.caches, Tiles(), most=1 << 18)
    view = bench.view(size=SIZE)
    settled(bench, view)
    frame = settled(bench, turned(view, 40.0))
    assert frame.final and known(frame).lit_by == "paths"


def test_a_transfer_that_memory_lost_begins_anew(bench: Workbench) -> None:
    """The picture shows no fewer paths than before."""
    view = bench.view(size=SIZE)
    settled(bench, view)
    renderer = bench.renderer
    goal = Goal.checked(TARGET / 10.0)
    counts = list[int]()
    while renderer.refine(turned(view, 40.0), goal) and len(counts) < 4:
        counts.append(known(renderer.render(turned(view, 40.0), goal)).transferred)
        renderer.surface.kept.drop(transfer_key(view))
    assert counts[:2] == [16, 64] and counts == sorted(counts)


def test_threads_share_the_paths(bench: Workbench) -> None:
    """Two that ask for a transfer at once trace it once."""
    shot = shot_of(bench, turned(bench.view(size=32), 40.0))
    transfer = ViewTransfer(IDENTITY)
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(lambda _: transfer.grow(shot, 64), range(2)))
    assert found[0] is found[1] and found[0].samples == 64


def test_light_that_turns_once_texels_came_is_transferred(bench: Workbench) -> None:
    """Idle workers may have baked the texels of the view meanwhile."""
    view = bench.view(size=SIZE)
    settled(bench, view)
    bench.bake(view)
    frame = settled(bench, turned(view, 40.0))
    assert known(frame).lit_by == "transfer" and frame.final


def test_colours_by_data_keep_no_transfer(tmp_path: Path) -> None:
    """Light that the colours of other points reflect is no product with one light."""
    bench = workbench(tmp_path, volumes=[{"use": "colour", "of": "gradient", "map": "coolwarm"}])
    view = bench.view(size=SIZE)
    settled(bench, view)
    frame = settled(bench, turned(view, 40.0))
    assert known(frame).lit_by != "transfer"


def test_texels_of_a_view_by_transfer_can_be_asked_for(bench: Workbench) -> None:
    """While nobody waits, they are baked for views that move."""
    view = bench.view(size=SIZE)
    settled(bench, view)
    settled(bench, turned(view, 40.0))
    checks = bench.renderer.surface.checks
    checks.require_texels(turned(view, 40.0), GOAL)
    frame = bench.renderer.render(turned(view, 40.0), GOAL)
    assert known(frame).lit_by == "texels" and frame.stages and frame.provisional
    assert known(frame).goal == GOAL, "texels begin at the first level"
