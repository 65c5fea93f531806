"""Variants of a segmentation that hide labels: their names, their voxels, and the light that stands in for theirs."""

import asyncio
from dataclasses import replace
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_core.storage.store import Store
from server.errors import ParameterError
from server.render.engine import RenderEngine
from server.render.scene_variant import Change, SceneVariant
from server.render.variants import Variants


@pytest.fixture
def engine(tmp_path: Path) -> RenderEngine:
    """An engine of a segmentation of two halves, labels 3 and 8, that is not started."""
    parts = np.zeros((9, 9, 9), np.uint8)
    parts[2:7, 2:7, 2:5], parts[2:7, 2:7, 5:7] = 3, 8
    nrrd.write(str(tmp_path / "seg.nrrd"), parts, index_order="C")
    scene = load_scene(tmp_path / "seg.nrrd", labels="all", environment="noon")
    return RenderEngine([scene], Store(f"file://{tmp_path}/store"), workers=1)


def test_variants_that_hide_the_same_share_their_voxels(engine: RenderEngine) -> None:
    own = engine.scenes["seg"]
    variants = Variants(engine, lambda name: name, most_cuts=2, room=0)
    without = asyncio.run(variants.of(own, Change(hide="3")))
    lit = asyncio.run(variants.of(own, Change("studio", hide=" 3")))
    assert without.volume is lit.volume and without.volume.digest != own.volume.digest
    assert without.surfaces.colours is lit.surfaces.colours and without.plan.channels == own.plan.channels
    cut = asyncio.run(variants.of(own, Change(cut="x>4", hide="3")))
    assert engine.variant(cut.id).hidden == (3,) and not np.array_equal(cut.volume.voxels, without.volume.voxels)
    assert set(engine.scenes) == {"seg", lit.id, cut.id}, "those with voxels of their own are few"


@pytest.mark.parametrize(("hide", "reason"), [("4", "no voxel of label 4"), ("3,8", "are hidden: show one")])
def test_labels_that_cannot_be_hidden_are_told(engine: RenderEngine, hide: str, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        asyncio.run(Variants(engine, lambda name: name).of(engine.scenes["seg"], Change(hide=hide)))


def test_scenes_that_differ_in_labels_or_time_lend_light() -> None:
    own, noon = SceneVariant("seg"), SceneVariant("seg", "noon")
    hides = replace(own, hidden=(3,))
    assert own.may_lend(hides) and hides.may_lend(replace(own, hidden=(8,), time=2))
    assert replace(noon, time=1).may_lend(replace(noon, hidden=(3,)))
    for other, scene in ((own, own), (noon, hides), (own, replace(hides, cut="x>1")), (SceneVariant("other"), hides)):
        assert not other.may_lend(scene) and not scene.may_lend(other)
