"""Numbers that `isogi inspect` prints, typed back: the same surface, by the digest of its G-buffer,
however far from 0 the values lie and however near to each other.
"""

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_server.inspect.inspection import inspection_schema
from isogi_server.inspect.text import brief, full_text
from isogi_server.parameters import ViewParams, read
from isogi_server.settings import Settings
from isogi_server.views import view_of
from tests.loaded import load_scene

Z, Y, X = np.mgrid[:16, :18, :20]
SHARE = np.clip(1.0 - np.sqrt((X - 9.5) ** 2 + (Y - 8.5) ** 2 + (Z - 7.5) ** 2) / 9.0, 0.0, 1.0)
SHARE = SHARE + 0.2 * (SHARE > 0.45)
"""A ball in a ball, from 0 to 1.2."""

FIELDS = {
    "bytes": (0, 200, "u1"),
    "shares": (0.0, 1.0, "f4"),
    "celsius": (-3.0, 40.0, "f4"),
    "tiny": (0.0, 1e-30, "f4"),
    "huge": (0.0, 1e30, "f4"),
    "tiniest": (0.0, 1e-300, "f8"),
    "hugest": (0.0, 1e300, "f8"),
    "kelvin": (273.15, 0.01, "f4"),
    "far": (1e6, 8.0, "f4"),
    "farther": (1e9, 1e-4, "f8"),
    "below": (-1e9, 1e-4, "f8"),
    "2^60": (2**60, 2e6, "u8"),
}
"""Offset, scale and type of the values."""

OPENED = Settings()


def scene_of(folder: Path, name: str) -> Scene:
    """A scene whose values lie as FIELDS says."""
    offset, scale, kind = FIELDS[name]
    if np.dtype(kind).kind == "f":
        values = (offset + scale * SHARE).astype(kind)
    else:
        values = np.asarray(scale * SHARE, np.int64).astype(kind) + np.dtype(kind).type(offset)
    np.save(folder / "f.npy", values)
    return load_scene(folder / "f.npy")


def digest(prepared: PreparedScene, asked: str) -> str:
    """The digest of the G-buffer of a view whose isovalue is spelled as a person types it."""
    params = {"isovalue": asked, "azimuth": 40, "width": 48, "height": 36}
    view = view_of(prepared.scene, read(ViewParams, params.items()), OPENED)
    gbuffer = trace(view, prepared.surface(view.isovalue), Tiles())
    return hashlib.sha256(gbuffer.pixels.tobytes() + gbuffer.points.tobytes()).hexdigest()


def printed(scene: Scene) -> Iterator[tuple[str, float]]:
    """Each isovalue that both texts show, as it is printed, and the number that it stands for."""
    facts = inspection_schema(scene)
    text = " ".join(brief(scene, facts).split())
    start, others = re.findall(r" isovalue (\S+?),? [^;]*?(?:; also look at (.*?))?; solid", text)[
        0
    ]
    yield start, scene.isovalue
    presets = [each.isovalue for each in facts.presets if each.isovalue != scene.isovalue]
    yield from zip(others.split(", ") if others else [], presets, strict=True)
    text = full_text(scene, facts)
    start, low, high = re.findall(r"^isovalue +(\S+), from (\S+) to (\S+)$", text, re.MULTILINE)[0]
    ends = facts.ranges["isovalue"]
    yield from ((start, scene.isovalue), (low, ends.min), (high, ends.max))
    rows = re.findall(r"^>? +(\S+) +[\d,]+ +(?:[\d.]+ %|nothing)", text, re.MULTILINE)
    known = {each.spelled: each.isovalue for each in facts.stiffness.surfaces}
    assert len(rows) > 3 and set(rows) <= set(known)
    yield from ((row, known[row]) for row in rows)


@pytest.mark.parametrize("name", FIELDS)
def test_printed_isovalues_give_the_same_surface(tmp_path: Path, name: str) -> None:
    prepared = PreparedScene(scene_of(tmp_path, name))
    found = dict(printed(prepared.scene))
    assert len(found) > 5
    digests = {text: digest(prepared, text) for text in found}
    assert digests == {text: digest(prepared, repr(float(value))) for text, value in found.items()}
    # Numbers that differ are of surfaces that differ: a digest of nothing would prove nothing.
    assert len(set(digests.values())) > len(found) // 2


@pytest.mark.parametrize("name", FIELDS)
def test_edges_of_the_histogram_are_told_apart(tmp_path: Path, name: str) -> None:
    scene = scene_of(tmp_path, name)
    text = full_text(scene, inspection_schema(scene))
    edges = re.findall(r"^ *(\S+) █* +\d+$", text, re.MULTILINE)
    assert len(edges) > 10 and len(set(edges)) == len(edges)
