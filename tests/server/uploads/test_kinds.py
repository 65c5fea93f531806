"""Files of every kind are read by the confined reader, which can open no file and load no library
any more.
"""

import gzip
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import LabelName, on_right_angles
from isogi_core.model.volume import Orientation
from isogi_server.uploads.folder import read_volume
from isogi_server.uploads.uploads import PYTHON_ROOT
from tests.files.formats.every_kind import F, written
from tests.files.formats.phantom import ORIGIN, STEPS
from tests.loaded import load_scene


def installed() -> list[str]:
    """Folders of libraries that this process has beside its environment's own."""
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def read_confined(path: Path, folder: Path) -> Path:
    """The canonical file that the reader makes of a file."""
    with path.open("rb") as upload, tempfile.TemporaryFile(dir=folder) as out:
        arguments = [path.name, str(upload.fileno()), str(out.fileno()), "volume", str(1 << 16)]
        done = subprocess.run(
            [sys.executable, "-P", "-m", "isogi_server.uploads.reader", *arguments],
            input=b"60\n",
            capture_output=True,
            pass_fds=[upload.fileno(), out.fileno()],
            env={
                "PYTHONPATH": os.pathsep.join([str(PYTHON_ROOT), *installed()]),
                "PATH": os.environ["PATH"],
            },
            check=True,
        )
        answer = json.loads(done.stdout)
        assert "id" in answer, answer
        out.seek(0)
        kept = folder / f"{answer['id']}.nrrd"
        kept.write_bytes(out.read())
        return kept


@pytest.mark.long
@pytest.mark.slow
def test_files_of_every_kind_are_read_confined(tmp_path: Path) -> None:
    for path in written(tmp_path / "files"):
        kept = read_confined(path, tmp_path)
        facts = read_volume(kept)
        grid = on_right_angles(open_file(kept, {}))
        assert facts and facts.name == path.name and facts.size == (16, 20, 12)
        np.testing.assert_array_equal(np.sort(grid.whole(), axis=None), np.sort(F, axis=None))


def test_an_uploaded_series_shows_its_first_step(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    nib.save(
        nib.Nifti1Image(np.stack([F.T, F.T + 1, F.T + 2], axis=-1), np.eye(4)),
        tmp_path / "bold.nii",
    )
    kept = read_confined(tmp_path / "bold.nii", tmp_path)
    facts = read_volume(kept)
    assert facts and facts.name == "bold.nii, first of 3 steps"
    np.testing.assert_array_equal(
        np.sort(open_file(kept, {}).whole(), axis=None), np.sort(F, axis=None)
    )


def test_an_uploaded_file_lies_where_it_did(tmp_path: Path) -> None:
    pytest.importorskip("nibabel")
    path = next(path for path in written(tmp_path / "files") if path.name == "f.nii.gz")
    grid = on_right_angles(open_file(read_confined(path, tmp_path), {}))
    orientation = Orientation.of(grid)
    assert orientation.letters == "RAS"
    np.testing.assert_array_equal(grid.whole(), F)
    last = np.array((15.0, 19.0, 11.0)) * STEPS
    np.testing.assert_allclose(orientation.to_world(last), np.array(ORIGIN) + last)


PARTS = np.pad(np.array([[[1, 1, 2], [1, 0, 2]], [[1, 2, 2], [1, 2, 2]]], np.uint8), 3)
SEGMENTS = {
    **{"Segment0_Name": "Liver", "Segment0_LabelValue": "1", "Segment0_Color": "1 0.5 0"},
    **{"Segment1_Name": "Vein", "Segment1_LabelValue": "2"},
}


def test_an_uploaded_segmentation_is_one_of_labels(tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "parts.seg.nrrd"), PARTS, SEGMENTS, index_order="C")
    kept = read_confined(tmp_path / "parts.seg.nrrd", tmp_path)
    scene = load_scene(kept)
    assert scene.surfaces.colours is not None and scene.isovalue == 0.5
    assert [label.name for label in scene.surfaces.colours.scale.labels] == ["Liver", "Vein"]
    assert open_file(kept, {}).labels == (LabelName(1, "Liver", "#ff8000"), LabelName(2, "Vein"))


def test_a_segmentation_without_a_label_is_refused(tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "none.seg.nrrd"), 0 * PARTS, SEGMENTS, index_order="C")
    with pytest.raises(AssertionError, match="no label: every voxel is 0"):
        read_confined(tmp_path / "none.seg.nrrd", tmp_path)


def test_a_skewed_segmentation_is_uploaded_as_values(tmp_path: Path) -> None:
    """Between two labels is neither."""
    skewed = {
        "space": "RAS",
        "space directions": [[1, 0, 0], [0.5, 1, 0], [0, 0, 1]],
        "space origin": [0, 0, 0],
    }
    nrrd.write(str(tmp_path / "skew.seg.nrrd"), PARTS, {**SEGMENTS, **skewed}, index_order="C")
    assert open_file(read_confined(tmp_path / "skew.seg.nrrd", tmp_path), {}).labels is None


def test_an_uploaded_crystal_repeats_as_its_file_does(tmp_path: Path) -> None:
    path = next(path for path in written(tmp_path / "files") if path.name == "ELFCAR.gz")
    (tmp_path / "oblique.gz").write_bytes(
        gzip.compress(gzip.decompress(path.read_bytes()).replace(b"\n0 25.0 0", b"\n8 25.0 0", 1))
    )
    for each, name in ((path, "ELFCAR"), (tmp_path / "oblique.gz", "oblique")):
        kept = read_confined(each, tmp_path)
        facts = read_volume(kept)
        assert facts is not None
        assert facts.size == (16, 20, 12)
        uploaded, placed = load_scene(kept).volume, load_scene(each).volume
        assert uploaded.cell is not None
        assert uploaded.cell == placed.cell, name
        np.testing.assert_allclose(uploaded.voxels, placed.voxels, atol=1e-6)
        assert uploaded.orientation.unit == "Å"


def test_an_uploaded_cube_starts_at_its_isovalue(tmp_path: Path) -> None:
    path = next(path for path in written(tmp_path / "files") if path.name == "f.cube")
    path.write_text(path.read_text().replace("for a test", "isovalue = 123.5", 1))
    assert load_scene(read_confined(path, tmp_path)).isovalue == 123.5
