"""DICOM's segmentations: labels of bits, fractions and numbers, with names and colours, empty frames left out."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import LabelName, on_right_angles
from tests.files.formats.dicom_files import dataset
from tests.files.formats.phantom import affine, letter
from tests.loaded import load_scene

pytest.importorskip("pydicom")

LPS = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine()
F = letter()
PARTS = np.zeros(F.shape, np.uint16)
PARTS[2:9, 3:10, 2:8] = 1
PARTS[5:8, 3:10, 2:8] = 3
PARTS[2, 3, 2] = 0
LIVER, VEIN = (39000, 43000, 44000), (20000, 40000, 20000)


def item(**facts: Any) -> Any:
    from pydicom.dataset import Dataset

    made = Dataset()
    for name, value in facts.items():
        setattr(made, name, value)
    return made


def write(path: Path, kind: str, frames: list[tuple[int, int, np.ndarray]], **changes: Any) -> Path:
    """A segmentation of ``frames``: the layer and the segment of each, and its pixels."""
    from pydicom.pixels import pack_bits

    pixels = np.stack([each for _, _, each in frames])
    bits = 1 if kind == "BINARY" else 8
    data = pack_bits(pixels.astype(np.uint8)) if bits == 1 else pixels.astype(np.uint8).tobytes()
    made = dataset(F[0], LPS, 0, NumberOfFrames=len(frames), PixelData=bytes(data) + b"\0" * (len(data) % 2))
    for name in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        delattr(made, name)
    made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66.4"
    made.BitsAllocated = made.BitsStored = bits
    made.HighBit, made.PixelRepresentation, made.SegmentationType = bits - 1, 0, kind
    steps = np.linalg.norm(LPS[:3, :3], axis=0)
    pose = [f"{x:.9g}" for x in (LPS[:3, :2] / steps[:2]).T.ravel()]
    measures = item(PixelSpacing=[f"{steps[1]:.9g}", f"{steps[0]:.9g}"], SpacingBetweenSlices=f"{steps[2]:.9g}")
    shared = item(PixelMeasuresSequence=[measures], PlaneOrientationSequence=[item(ImageOrientationPatient=pose)])
    made.SharedFunctionalGroupsSequence = [shared]
    made.PerFrameFunctionalGroupsSequence = [_groups(layer, segment) for layer, segment, _ in frames]
    named = [(1, "Liver", LIVER), (3, "Hepatic vein", VEIN), (7, "Nothing of it is there", None)]
    made.SegmentSequence = [
        item(SegmentNumber=n, SegmentLabel=name, **({"RecommendedDisplayCIELabValue": list(lab)} if lab else {}))
        for n, name, lab in named
    ]
    for name, value in changes.items():
        setattr(made, name, value)
    made.save_as(path, enforce_file_format=True)
    return path


def _groups(layer: int, segment: int) -> Any:
    at = [f"{x:.9g}" for x in LPS[:3, 3] + layer * LPS[:3, 2]]
    made = item(PlanePositionSequence=[item(ImagePositionPatient=at)])
    if segment:
        made.SegmentIdentificationSequence = [item(ReferencedSegmentNumber=segment)]
    return made


def bits() -> list[tuple[int, int, np.ndarray]]:
    """A frame for each segment in each layer where it is, in no order."""
    found = [(z, n, PARTS[z] == n) for z in range(len(PARTS)) for n in (1, 3) if (PARTS[z] == n).any()]
    return [found[n] for n in np.random.default_rng(4).permutation(len(found))]


def fractions() -> list[tuple[int, int, np.ndarray]]:
    """Fractions of 200: half and more is within."""
    random = np.random.default_rng(5)
    within, without = (random.integers(*ends, F.shape) for ends in ((100, 201), (0, 100)))
    return [(z, n, np.where(PARTS[z] == n, within[z], without[z])) for z, n, _ in bits()]


def numbers() -> list[tuple[int, int, np.ndarray]]:
    return [(z, 0, PARTS[z]) for z in reversed(range(2, 9))]


@pytest.mark.parametrize(
    ("kind", "frames", "more"),
    [
        ("BINARY", bits, {}),
        ("FRACTIONAL", fractions, {"MaximumFractionalValue": 200}),
        ("LABELMAP", numbers, {"PhotometricInterpretation": "PALETTE COLOR"}),
    ],
)
def test_frames_of_segments_become_labels(tmp_path: Path, kind: str, frames: Any, more: dict[str, Any]) -> None:
    path = write(tmp_path / "seg.dcm", kind, frames(), **more)
    with path.open("rb") as file:
        for grid in (open_file(path, {}), open_upload(file, "seg.dcm", 10**6)):
            straight = on_right_angles(grid)
            np.testing.assert_array_equal(straight.whole(), PARTS[2:9])
            assert straight.dtype == np.uint16 and grid.unit == "mm" and not grid.notes
            assert grid.labels is not None
            assert [(each.value, each.name) for each in grid.labels][:2] == [(1, "Liver"), (3, "Hepatic vein")]
            assert grid.read_as.startswith("DICOM segmentation of uint16; placed by")
            at = straight.affine.array @ [0.0, 0.0, 0.0, 1.0]  # type: ignore[union-attr]
            np.testing.assert_allclose(at, (affine() @ (0, 0, 2, 1))[:3], atol=1e-4)


def test_layers_in_which_nothing_is_are_no_holes(tmp_path: Path) -> None:
    """Frames 4 and 6 are left out, so that most steps are of two layers: how far apart layers lie is said."""
    kept = [(z, n, each) for z, n, each in bits() if z in (2, 5, 7, 8)]
    grid = open_file(write(tmp_path / "seg.dcm", "BINARY", kept), {})
    wanted = PARTS[2:9].copy()
    wanted[[1, 2, 4]] = 0
    np.testing.assert_array_equal(grid.whole(), wanted)
    assert not grid.notes


def test_of_segments_that_overlap_the_last_is_shown(tmp_path: Path) -> None:
    both = [(z, n, np.ones(F.shape[1:], bool)) for z in (2, 3) for n in (3, 1)]
    assert set(open_file(write(tmp_path / "seg.dcm", "BINARY", both), {}).whole().ravel()) == {3}


def test_colours_are_those_that_the_file_recommends(tmp_path: Path) -> None:
    """Compared with colours worked out by hand: white, mid grey, and the sRGB red whose CIELab is known."""
    labs = {
        "#ffffff": (65535, 32896, 32896),
        "#777777": (32768, 32896, 32896),
        "#ff0000": (round(54.29 / 100 * 65535), round((80.81 + 128) / 255 * 65535), round((69.89 + 128) / 255 * 65535)),
    }
    parts = [
        item(SegmentNumber=n, SegmentLabel=c, RecommendedDisplayCIELabValue=list(labs[c]))
        for n, c in enumerate(labs, 1)
    ]
    path = write(tmp_path / "seg.dcm", "BINARY", bits(), SegmentSequence=parts)
    found = open_file(path, {}).labels or ()
    for each in found:
        told, wanted = (np.array(list(bytes.fromhex(text[1:]))) for text in (each.colour, each.name))
        assert np.abs(told.astype(int) - wanted).max() <= 1
    assert len(found) == 3


def test_a_segmentation_is_shown_by_its_labels(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path / "seg.dcm", "BINARY", bits()))
    assert scene.surfaces.colours is not None
    assert [label.name for label in scene.surfaces.colours.scale.labels] == ["Liver", "Hepatic vein"]
    assert scene.isovalue == 0.5


def test_unknown_segments_and_uneven_layers_are_told(tmp_path: Path) -> None:
    parts = [item(SegmentNumber=0, SegmentLabel="Background"), item(SegmentNumber=1)]
    grid = open_file(write(tmp_path / "a.dcm", "BINARY", bits(), SegmentSequence=parts), {})
    assert grid.labels == (LabelName(1),)
    apart = write(tmp_path / "b.dcm", "BINARY", [(z, 1, np.ones(F.shape[1:], bool)) for z in (0, 1, 2)])
    import pydicom

    made = pydicom.dcmread(apart)
    group = made.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0]
    group.ImagePositionPatient = [f"{x:.9g}" for x in LPS[:3, 3] + 0.6 * LPS[:3, 2]]
    made.save_as(apart)
    with pytest.raises(VolumeError, match="unevenly spaced: save it in even ones"):
        open_file(apart, {})
