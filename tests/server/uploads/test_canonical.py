"""Canonical files: what goes in comes out, and what isogi did not write is none."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.grid import Grid, LabelName
from isogi_core.files.nrrd import open_nrrd, read_nrrd
from server.uploads.folder import NRRD_TYPES, SCENE_BYTES, read_volume, write

RAMP = np.arange(24).reshape(2, 3, 4)


def kept(folder: Path, array: np.ndarray, name: str = "a") -> Path:
    """The canonical file of an array, under its id."""
    file = io.BytesIO()
    number = write(file, Grid.of(array, (1.0, 2.0, 0.1)), name)
    path = folder / f"{number}.nrrd"
    path.write_bytes(file.getvalue())
    return path


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kind", NRRD_TYPES)
def test_a_volume_is_read_as_it_was(tmp_path: Path, kind: str, order: str) -> None:
    path = kept(tmp_path, RAMP.astype(np.dtype(kind).newbyteorder(order)))
    array, spacing = read_nrrd(path)
    np.testing.assert_array_equal(array, RAMP)
    assert (array.dtype.newbyteorder("="), spacing) == (np.dtype(kind), (1.0, 2.0, 0.1))
    facts = read_volume(path)
    assert facts and (facts.id, facts.size, facts.bytes) == (path.stem, (4, 3, 2), path.stat().st_size)


def test_the_id_is_of_the_voxels_and_not_of_order_layout_or_name(tmp_path: Path) -> None:
    same = [RAMP.astype("<i2"), RAMP.astype(">i2"), np.asfortranarray(RAMP.astype("<i2"))]
    assert len({kept(tmp_path, array, name).stem for array, name in zip(same, "abc", strict=True)}) == 1
    assert kept(tmp_path, RAMP.astype("<i4")).stem != kept(tmp_path, same[0]).stem


@pytest.mark.parametrize("name", ["Zwei Kugeln é 球", "a\\nb: c", "<script>", "sizes: 1 1 1", "%41", "x" * 80])
def test_a_name_is_kept_whatever_is_in_it(tmp_path: Path, name: str) -> None:
    facts = read_volume(kept(tmp_path, RAMP.astype("u1"), name))
    assert facts and facts.name == name


def test_what_has_no_name_is_called_after_its_id(tmp_path: Path) -> None:
    facts = read_volume(kept(tmp_path, RAMP.astype("u1"), ""))
    assert facts and facts.name == f"volume {facts.id[:6]}"


def test_the_quota_counts_what_the_server_holds(tmp_path: Path) -> None:
    ramp = np.arange(1000).reshape(10, 10, 10)
    small, wide = (read_volume(kept(tmp_path, ramp.astype(kind))) for kind in ("u1", "f8"))
    assert small and small.held == SCENE_BYTES + 4 * 1000
    assert wide and wide.held - SCENE_BYTES == wide.bytes > 8 * 1000


LABELS = (
    LabelName(1, "Leber é", "#dd8265"),
    LabelName(2, "odd\nSegment7_Name:=x\\ne", ""),
    LabelName(9, "x" * 300, "#000001"),
)


def labelled(folder: Path, labels: tuple[LabelName, ...] | None) -> Path:
    file = io.BytesIO()
    grid = replace(Grid.of(RAMP.astype("u1"), (1.0, 2.0, 0.1)), labels=labels)
    path = folder / f"{write(file, grid, 'a')}.nrrd"
    path.write_bytes(file.getvalue())
    return path


def test_labels_keep_their_names_and_colours(tmp_path: Path) -> None:
    """What a name may not hold is left out of it: it makes no line of its own."""
    path = labelled(tmp_path, LABELS)
    assert read_volume(path)
    odd = LabelName(2, "oddSegment7_Name:=xne", "")
    assert open_nrrd(path).labels == (LABELS[0], odd, LabelName(9, "x" * 64, "#000001"))
    bare = labelled(tmp_path, None)
    assert open_nrrd(bare).labels is None and bare.stem != path.stem
    assert bare == kept(tmp_path, RAMP.astype("u1"))
    assert open_nrrd(labelled(tmp_path, ())).labels is not None
    many = labelled(tmp_path, tuple(LabelName(n, "ä" * 64, "#123456") for n in range(1, 400)))
    assert read_volume(many) and len(open_nrrd(many).labels or ()) == 255


def test_what_isogi_did_not_write_is_none(tmp_path: Path) -> None:
    whole = kept(tmp_path, RAMP.astype("u1")).read_bytes()
    others = [whole[:-1], whole + b"x", whole.replace(b"raw", b"gzip"), b"", whole.replace(b"uint8", b"uint9")]
    detached = whole.replace(b"name:=a", b"data file: /etc/passwd")
    for text in (*others, detached):
        (tmp_path / "a.nrrd").write_bytes(text)
        assert read_volume(tmp_path / "a.nrrd") is None, text
