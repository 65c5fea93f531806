"""Variants of another material, or that hide labels: their names, what they share, and what is
refused.
"""

import asyncio
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import nrrd
import numpy as np
import pytest

from isogi_server.errors import BusyError, ParameterError
from isogi_server.render import variants as module
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change, SceneVariant
from isogi_server.render.variants import Variants
from tests.loaded import load_scene


@pytest.fixture
def engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RenderEngine]:
    """An engine of a scene, and of one in the light of a lamp, that is not started; its kernels
    count as compiled.
    """
    monkeypatch.setattr(module, "entries_of", lambda _: [])
    sun = {"type": "directional", "azimuth": 0, "elevation": 50, "irradiance": 1}
    scenes = [load_scene("demo:orbital"), load_scene("demo:casting", lights=[sun])]
    with closing(RenderEngine(scenes, tmp_path / "store", workers=1)) as engine:
        yield engine


def variant(engine: RenderEngine, change: Change, scene: str = "orbital") -> str:
    """The id of a variant of a scene."""
    return asyncio.run(Variants(engine, lambda name: name).of(engine.scenes[scene], change)).id


def test_a_material_is_named_in_the_variants_id(engine: RenderEngine) -> None:
    own = engine.scenes["orbital"]
    name = variant(engine, Change("studio", material=" glass, index=1.30"))
    assert name == "orbital@studio=glass,index=1.3"
    made = engine.scenes[name]
    assert made.volume is own.volume and made.surfaces.material.index == 1.3 and not made.bakes
    assert variant(engine, Change("studio", material="glass,index=1.3")) == name
    assert variant(engine, Change(material="diffuse")) == "orbital", "its own is no variant"
    assert variant(engine, Change(material="subsurface,mean_free_path=1e20")).endswith("path=1e20")


def test_other_parts_of_a_variant_are_kept_beside_a_material(engine: RenderEngine) -> None:
    cut = variant(engine, Change(cut="x>40", material="glass"))
    assert cut.startswith("orbital@=glass@") and engine.variant(cut) == SceneVariant(
        "orbital", material="glass", cut="x>40"
    )
    assert SceneVariant("seg", material="glass", hidden=(3,), time=2).id == "seg@=glass!3+2"
    scatters = SceneVariant("seg", material="subsurface")
    assert scatters.may_stand_in_for(replace(scatters, time=2))
    assert not SceneVariant("seg").may_stand_in_for(scatters)


@pytest.mark.parametrize(
    ("scene", "material", "reason"),
    [
        ("orbital", "jelly", "is not one of diffuse, glass, subsurface"),
        ("orbital", "glass,index=9", "is not a number from 1 to 4"),
        ("orbital", "glass,absorption=nan", "is not a number"),
        ("orbital", "glass,absorption=1,2", "give one, or three"),
        ("orbital", "glass@1", "give a word"),
        ("casting", "subsurface", "Lamps do not reach inside"),
    ],
)
def test_what_a_scene_cannot_be_of_is_told(
    engine: RenderEngine, scene: str, material: str, reason: str
) -> None:
    with pytest.raises(ParameterError, match=reason) as refused:
        variant(engine, Change(material=material), scene)
    assert refused.value.parameter == "material"


def test_kernels_that_were_never_compiled_come_first(
    engine: RenderEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = SimpleNamespace(loaded=False, stored=False)
    compiled = []
    monkeypatch.setattr(module, "entries_of", lambda _: [kernel])
    monkeypatch.setattr(module, "warm", compiled.append)
    with pytest.raises(BusyError, match="is being compiled"):
        variant(engine, Change(material="glass"))
    assert len(compiled) == 1 and set(engine.scenes) == {"orbital", "casting"}
    kernel.stored = True
    assert variant(engine, Change(material="glass")) == "orbital@=glass"


@pytest.fixture
def segmented(tmp_path: Path) -> RenderEngine:
    """An engine of a segmentation of two halves, labels 3 and 8, that is not started."""
    parts = np.zeros((9, 9, 9), np.uint8)
    parts[2:7, 2:7, 2:5], parts[2:7, 2:7, 5:7] = 3, 8
    nrrd.write(str(tmp_path / "seg.nrrd"), parts, index_order="C")
    scene = load_scene(tmp_path / "seg.nrrd", labels="all", environment="noon")
    return RenderEngine([scene], tmp_path / "store", workers=1)


def test_variants_that_hide_the_same_share_their_voxels(segmented: RenderEngine) -> None:
    own = segmented.scenes["seg"]
    variants = Variants(segmented, lambda name: name, most_cuts=2, room=0)
    without = asyncio.run(variants.of(own, Change(hide="3")))
    lit = asyncio.run(variants.of(own, Change("studio", hide=" 3")))
    assert without.volume is lit.volume and without.volume.digest != own.volume.digest
    assert (
        without.surfaces.colours is lit.surfaces.colours
        and without.plan.channels == own.plan.channels
    )
    cut = asyncio.run(variants.of(own, Change(cut="x>4", hide="3")))
    assert segmented.variant(cut.id).hidden == (3,) and not np.array_equal(
        cut.volume.voxels, without.volume.voxels
    )
    assert set(segmented.scenes) == {"seg", lit.id, cut.id}, (
        "those with voxels of their own are few"
    )


@pytest.mark.parametrize(
    ("hide", "reason"), [("4", "no voxel of label 4"), ("3,8", "are hidden: show one")]
)
def test_labels_that_cannot_be_hidden_are_told(
    segmented: RenderEngine, hide: str, reason: str
) -> None:
    with pytest.raises(ParameterError, match=reason):
        asyncio.run(
            Variants(segmented, lambda name: name).of(segmented.scenes["seg"], Change(hide=hide))
        )


def test_scenes_that_differ_in_labels_or_time_lend_light() -> None:
    own = SceneVariant("seg")
    noon = SceneVariant("seg", "noon")
    hides = replace(own, hidden=(3,))
    assert own.may_stand_in_for(hides) and hides.may_stand_in_for(replace(own, hidden=(8,), time=2))
    assert replace(noon, time=1).may_stand_in_for(replace(noon, hidden=(3,)))
    for other, scene in (
        (own, own),
        (noon, hides),
        (own, replace(hides, cut="x>1")),
        (SceneVariant("other"), hides),
    ):
        assert not other.may_stand_in_for(scene) and not scene.may_stand_in_for(other)
