"""DICOM as scanners leave it: series shuffled, tilted or of packed bits, and segmentations."""

import gzip
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.dicom_stack import Slice, stack_of
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import Grid, LabelName, on_right_angles
from isogi_core.files.packing import Packing
from tests.files.formats.dicom_files import dataset, write_series
from tests.files.formats.phantom import affine, letter
from tests.loaded import load_scene

pytest.importorskip("pydicom")

LPS = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine()
F = letter()


def opened(path: Path, **chosen: Any) -> Grid:
    return on_right_angles(open_file(path, chosen))


def save(folder: Path, name: str, made: Any) -> None:
    folder.mkdir(exist_ok=True)
    made.save_as(folder / name, enforce_file_format=True)


def slices_of(folder: Path, layers: list[int], **changes: Any) -> Path:
    for place, number in enumerate(layers):
        save(folder, f"{place}.dcm", dataset(F[number], LPS, number, **changes))
    return folder


def test_shuffled_slices_are_sorted_by_where_they_lie(tmp_path: Path) -> None:
    grid = opened(write_series(tmp_path / "a", F, LPS, InstanceNumber=1))
    np.testing.assert_array_equal(grid.whole(), F)
    assert not grid.notes and grid.unit == "mm"


def test_a_missing_slice_is_a_layer_of_holes(tmp_path: Path) -> None:
    grid = opened(slices_of(tmp_path / "a", [n for n in range(12) if n != 5]))
    voxels = grid.whole()
    assert np.isnan(voxels[5]).all() and "1 of 12 slices are missing" in grid.notes[0]
    np.testing.assert_array_equal(np.delete(voxels, 5, 0), np.delete(F, 5, 0))


def test_doubled_slices_are_left_out_where_they_are_the_same(tmp_path: Path) -> None:
    folder = write_series(tmp_path / "a", F, LPS)
    save(folder, "again.dcm", dataset(F[3], LPS, 3))
    grid = opened(folder)
    np.testing.assert_array_equal(grid.whole(), F)
    assert "1 doubled" in grid.notes[0]
    save(folder, "other.dcm", dataset(F[4], LPS, 3, SOPInstanceUID="1.2.3.999"))
    with pytest.raises(VolumeError, match="13 slices at 12 places"):
        opened(folder)


def test_unevenly_spaced_slices_are_interpolated(tmp_path: Path) -> None:
    ramp = np.broadcast_to(np.arange(8, dtype=np.int16)[:, None, None] * 100, (8, 6, 5))
    for number in (0, 1, 2, 4, 5, 7):
        height = number + (0.5 if number == 4 else 0.0)
        value = np.round(ramp[number] + 100 * (height - number)).astype(np.int16)
        save(
            tmp_path / "a",
            f"{number}.dcm",
            dataset(value, LPS, number, ImagePositionPatient=[0, 0, height]),
        )
    grid = opened(tmp_path / "a")
    assert "unevenly spaced" in grid.notes[0]
    voxels = grid.whole()
    (_, _, step) = grid.spacing
    np.testing.assert_allclose(voxels[:, 3, 3], 100 * step * np.arange(len(voxels)), atol=1e-3)


def test_a_tilted_gantry_is_resampled_once(tmp_path: Path) -> None:
    tilted = LPS.copy()
    tilted[1, 2] = 0.5 * LPS[2, 2]
    smooth = np.add.outer(
        np.add.outer(np.arange(12) * 0.0, np.arange(20) * 3.0), np.arange(16) * 1.0
    )
    for number in range(12):
        shifted = smooth[number] + 3.0 * number * tilted[1, 2] / LPS[1, 1]
        save(
            tmp_path / "a",
            f"{number}.dcm",
            dataset(np.round(shifted * 8).astype(np.int16), tilted, number),
        )
    grid = opened(tmp_path / "a")
    assert "skewed" in grid.notes[0] and grid.affine is not None
    voxels = grid.whole()
    middle = voxels[:, voxels.shape[1] // 2, 8]
    assert np.isnan(voxels).any() and np.ptp(middle) <= 1.0  # what a tilt moved is where it was


def test_one_series_of_two_is_chosen(tmp_path: Path) -> None:
    folder = write_series(tmp_path / "a", F, LPS)
    for number in range(6):
        other = dataset(F[number] + 1, LPS, number, SeriesNumber=2, SeriesDescription="a scout")
        other.SeriesInstanceUID = "1.2.4.2"
        other.SOPInstanceUID = f"1.2.5.{number}"
        save(folder, f"x{number}.dcm", other)
    with pytest.raises(
        VolumeError, match=r"2 series.*#series=0: an F, 12 of 16 × 20; #series=1: a scout, 6"
    ):
        opened(folder)
    assert opened(folder, series=0).shape == (12, 20, 16)
    np.testing.assert_array_equal(opened(folder, series="1.2.4.2").whole(), F[:6] + 1)


def test_time_steps_are_chosen(tmp_path: Path) -> None:
    for time, number in np.ndindex(2, 12):
        made = dataset(F[number] + time, LPS, number, InstanceNumber=12 * time + number)
        made.SOPInstanceUID = f"1.2.6.{time}.{number}"
        save(tmp_path / "a", f"{time}-{number}.dcm", made)
    with pytest.raises(VolumeError, match="2 slices at each place"):
        opened(tmp_path / "a")
    np.testing.assert_array_equal(opened(tmp_path / "a", time=1).whole(), F + 1)


def test_slices_half_a_micrometre_apart_are_not_mixed() -> None:
    """Python and NumPy round the lower of the two heights differently."""
    pose = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    packing = Packing(np.dtype(np.int16))
    slices = [
        Slice(
            f"{height} {n}",
            f"{height} {n}",
            (n, 0),
            (0.0, 0.0, height),
            pose,
            (1.0, 1.0),
            None,
            packing,
        )
        for height, n in ((0.0025, 1), (0.0025, 4), (0.003, 2), (0.003, 3))
    ]
    stack, _ = stack_of("a series", slices, lambda count, _: 0)
    assert [layer[0][0] for layer in stack.layers] == ["0.0025 1", "0.003 2"]


def test_pixels_without_spacing_have_no_unit(tmp_path: Path) -> None:
    for number, layer in enumerate(F):
        made = dataset(layer, LPS, number)
        del made.PixelSpacing
        save(tmp_path / "a", f"{number}.dcm", made)
    grid = opened(tmp_path / "a")
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.unit == "" and "do not say how far apart their pixels are" in grid.notes[0]


def test_twelve_bits_of_sixteen_have_a_sign_of_their_own(tmp_path: Path) -> None:
    values = F - 500
    stored = (values.astype(np.int32) & 0xFFF) | 0x3000  # what is above may hold anything
    for number, layer in enumerate(stored):
        made = dataset(layer.astype("<u2").view("<i2"), LPS, number, BitsStored=12, HighBit=11)
        save(tmp_path / "a", f"{number}.dcm", made)
    np.testing.assert_array_equal(opened(tmp_path / "a").whole(), values)


def test_each_slice_has_its_own_slope(tmp_path: Path) -> None:
    for number in range(12):
        made = dataset(
            F[number], LPS, number, RescaleSlope=f"{number + 0.5}", RescaleIntercept="-10"
        )
        save(tmp_path / "a", f"{number}.dcm", made)
    expected = F * (np.arange(12) + 0.5)[:, None, None] - 10.0
    np.testing.assert_allclose(opened(tmp_path / "a").whole(), expected, rtol=1e-6)


@pytest.mark.parametrize("syntax", ["ImplicitVRLittleEndian", "ExplicitVRBigEndian", "RLELossless"])
def test_transfer_syntaxes_give_the_same_voxels(tmp_path: Path, syntax: str) -> None:
    import pydicom

    for number, layer in enumerate(F):
        made = dataset(layer, LPS, number)
        if syntax == "RLELossless":
            made.compress(pydicom.uid.RLELossless, generate_instance_uid=False)
        else:
            made.file_meta.TransferSyntaxUID = getattr(pydicom.uid, syntax)
            made.PixelData = layer.astype(">i2" if "Big" in syntax else "<i2").tobytes()
        save(tmp_path / "a", f"{number}.dcm", made)
    np.testing.assert_array_equal(opened(tmp_path / "a").whole(), F)


def test_slices_that_do_not_say_where_they_lie_are_in_order(tmp_path: Path) -> None:
    for number, layer in enumerate(F):
        made = dataset(layer, LPS, number)
        del made.ImagePositionPatient
        save(tmp_path / "a", f"{(number * 7) % 12}.dcm", made)
    grid = opened(tmp_path / "a")
    np.testing.assert_array_equal(grid.whole(), F)
    assert "do not say where they lie" in grid.notes[0]


def test_colours_are_shown_as_luminance(tmp_path: Path) -> None:
    for number in range(12):
        grey = np.repeat((F[number] // 4).astype(np.uint8)[..., None], 3, axis=-1)
        made = dataset(F[number], LPS, number, SamplesPerPixel=3, PhotometricInterpretation="RGB")
        made.PlanarConfiguration = 0
        made.PixelRepresentation = 0
        made.BitsAllocated = 8
        made.BitsStored = 8
        made.HighBit = 7
        made.PixelData = grey.tobytes()
        save(tmp_path / "a", f"{number}.dcm", made)
    grid = opened(tmp_path / "a")
    np.testing.assert_allclose(grid.whole(), F // 4, atol=1e-3)
    assert "colours" in grid.notes[0]


def files_of_pydicom() -> Path:
    pydicom = pytest.importorskip("pydicom")
    return Path(pydicom.__file__).parent / "data" / "test_files"


@pytest.mark.filterwarnings("ignore")
def test_all_files_of_pydicom_are_volumes_or_refused() -> None:
    told = (
        "is one slice|holds no DICOM image|list of a DICOM disk|cannot be read as DICOM"
        "|that is known here"
    )
    read = {}
    for path in (
        path
        for path in files_of_pydicom().rglob("*")
        if path.suffix in (".dcm", "") and path.is_file()
    ):
        try:
            read[path.name] = open_file(path, {}).whole()
        except VolumeError as error:
            assert re.search(told, str(error)), error
    assert len(read) >= 7
    assert all(voxels.ndim == 3 and np.isfinite(voxels).all() for voxels in read.values())


@pytest.mark.parametrize("name", ["rtdose.dcm", "rtdose_expb.dcm", "rtdose_rle.dcm"])
def test_a_dose_of_pydicom_is_in_its_unit(name: str) -> None:
    from pydicom import dcmread

    made = dcmread(files_of_pydicom() / name)
    grid = open_file(files_of_pydicom() / name, {})
    np.testing.assert_array_equal(grid.whole(), made.pixel_array * made.DoseGridScaling)
    assert grid.spacing == (10.0, 10.0, 5.0) and grid.affine is not None
    np.testing.assert_allclose(
        grid.affine.array[:, 3], np.array(made.ImagePositionPatient) * (-1.0, -1.0, 1.0)
    )


def test_a_series_of_pydicom_is_stacked_from_below() -> None:
    from pydicom import dcmread

    folder = files_of_pydicom() / "dicomdirtests" / "98892001" / "CT5N"
    slices = sorted(
        map(dcmread, folder.iterdir()), key=lambda each: float(each.ImagePositionPatient[2])
    )
    heights = np.diff([float(each.ImagePositionPatient[2]) for each in slices])
    grid = open_file(folder, {})
    values = [each.pixel_array * each.RescaleSlope + each.RescaleIntercept for each in slices]
    np.testing.assert_array_equal(grid.whole(), values)
    np.testing.assert_allclose(grid.spacing[2], heights)


@pytest.mark.parametrize(
    ("facts", "signed", "low", "high"),
    [
        ({"PixelPaddingValue": -2000}, True, -2000, -2000),
        ({"PixelPaddingValue": 0, "PixelPaddingRangeLimit": 9}, False, 0, 9),
        ({"PixelPaddingValue": 9, "PixelPaddingRangeLimit": 0}, False, 0, 9),
    ],
)
def test_padding_around_the_field_of_view_is_holes(
    tmp_path: Path, facts: dict[str, int], signed: bool, low: int, high: int
) -> None:
    z, y, x = np.ogrid[:12, :20, :16]
    outside = ((y - 9.5) ** 2 + (x - 7.5) ** 2 > 50) & (z >= 0)
    padded = np.where(outside, np.where(x % 2, low, high), np.maximum(F, 10)).astype(np.int16)
    kind = int(signed)
    grid = opened(
        write_series(
            tmp_path / "a", padded, LPS, PixelRepresentation=kind, RescaleIntercept="-1024", **facts
        )
    )
    np.testing.assert_array_equal(
        grid.whole(), np.where(outside, np.nan, np.maximum(F, 10) - 1024.0)
    )
    assert "(the padding value)" in grid.notes[0]


def test_padding_is_read_where_the_file_leaves_its_type_open(tmp_path: Path) -> None:
    from pydicom.uid import ImplicitVRLittleEndian

    for number, layer in enumerate(F):
        made = dataset(layer, LPS, number, PixelPaddingValue=0)
        made.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
        save(tmp_path, f"{number}.dcm", made)
    np.testing.assert_array_equal(opened(tmp_path).whole(), np.where(F == 0, np.nan, F))


# --- segmentations
# --------------------------------------------------------------------------------------------------


PARTS = np.zeros(F.shape, np.uint16)
PARTS[2:9, 3:10, 2:8] = 1
PARTS[5:8, 3:10, 2:8] = 3
PARTS[2, 3, 2] = 0
LIVER = (39000, 43000, 44000)
VEIN = (20000, 40000, 20000)


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
    if bits == 1:
        data = pack_bits(pixels.astype(np.uint8))
    else:
        data = pixels.astype(np.uint8).tobytes()
    made = dataset(
        F[0], LPS, 0, NumberOfFrames=len(frames), PixelData=bytes(data) + b"\0" * (len(data) % 2)
    )
    for name in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        delattr(made, name)
    made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66.4"
    made.BitsAllocated = made.BitsStored = bits
    made.HighBit = bits - 1
    made.PixelRepresentation = 0
    made.SegmentationType = kind
    steps = np.linalg.norm(LPS[:3, :3], axis=0)
    pose = [f"{x:.9g}" for x in (LPS[:3, :2] / steps[:2]).T.ravel()]
    measures = item(
        PixelSpacing=[f"{steps[1]:.9g}", f"{steps[0]:.9g}"], SpacingBetweenSlices=f"{steps[2]:.9g}"
    )
    shared = item(
        PixelMeasuresSequence=[measures],
        PlaneOrientationSequence=[item(ImageOrientationPatient=pose)],
    )
    made.SharedFunctionalGroupsSequence = [shared]
    made.PerFrameFunctionalGroupsSequence = [
        _groups(layer, segment) for layer, segment, _ in frames
    ]
    named = [(1, "Liver", LIVER), (3, "Hepatic vein", VEIN), (7, "Nothing of it is there", None)]
    made.SegmentSequence = [
        item(
            SegmentNumber=n,
            SegmentLabel=name,
            **({"RecommendedDisplayCIELabValue": list(lab)} if lab else {}),
        )
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
    found = [
        (z, n, PARTS[z] == n) for z in range(len(PARTS)) for n in (1, 3) if (PARTS[z] == n).any()
    ]
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
def test_frames_of_segments_become_labels(
    tmp_path: Path, kind: str, frames: Any, more: dict[str, Any]
) -> None:
    path = write(tmp_path / "seg.dcm", kind, frames(), **more)
    with path.open("rb") as file:
        for grid in (open_file(path, {}), open_upload(file, "seg.dcm", 10**6)):
            straight = on_right_angles(grid)
            np.testing.assert_array_equal(straight.whole(), PARTS[2:9])
            assert straight.dtype == np.uint16 and grid.unit == "mm" and not grid.notes
            assert grid.labels is not None
            assert [(each.value, each.name) for each in grid.labels][:2] == [
                (1, "Liver"),
                (3, "Hepatic vein"),
            ]
            assert grid.read_as.startswith("DICOM segmentation of uint16; placed by")
            at = straight.affine.array @ [0.0, 0.0, 0.0, 1.0]  # type: ignore[union-attr]
            np.testing.assert_allclose(at, (affine() @ (0, 0, 2, 1))[:3], atol=1e-4)


def test_layers_in_which_nothing_is_are_no_holes(tmp_path: Path) -> None:
    """Frames 4 and 6 are left out, so that most steps are of two layers: how far apart layers lie
    is said.
    """
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
    """Compared with colours worked out by hand: white, mid grey, and the sRGB red whose CIELab is
    known.
    """
    labs = {
        "#ffffff": (65535, 32896, 32896),
        "#777777": (32768, 32896, 32896),
        "#ff0000": (
            round(54.29 / 100 * 65535),
            round((80.81 + 128) / 255 * 65535),
            round((69.89 + 128) / 255 * 65535),
        ),
    }
    parts = [
        item(SegmentNumber=n, SegmentLabel=c, RecommendedDisplayCIELabValue=list(labs[c]))
        for n, c in enumerate(labs, 1)
    ]
    path = write(tmp_path / "seg.dcm", "BINARY", bits(), SegmentSequence=parts)
    found = open_file(path, {}).labels or ()
    for each in found:
        told, wanted = (
            np.array(list(bytes.fromhex(text[1:]))) for text in (each.colour, each.name)
        )
        assert np.abs(told.astype(int) - wanted).max() <= 1
    assert len(found) == 3


def test_a_segmentation_is_shown_by_its_labels(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path / "seg.dcm", "BINARY", bits()))
    assert scene.surfaces.colours is not None
    assert [label.name for label in scene.surfaces.colours.scale.labels] == [
        "Liver",
        "Hepatic vein",
    ]
    assert scene.isovalue == 0.5


def test_unknown_segments_and_uneven_layers_are_told(tmp_path: Path) -> None:
    parts = [item(SegmentNumber=0, SegmentLabel="Background"), item(SegmentNumber=1)]
    grid = open_file(write(tmp_path / "a.dcm", "BINARY", bits(), SegmentSequence=parts), {})
    assert grid.labels == (LabelName(1),)
    apart = write(
        tmp_path / "b.dcm", "BINARY", [(z, 1, np.ones(F.shape[1:], bool)) for z in (0, 1, 2)]
    )
    import pydicom

    made = pydicom.dcmread(apart)
    group = made.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0]
    group.ImagePositionPatient = [f"{x:.9g}" for x in LPS[:3, 3] + 0.6 * LPS[:3, 2]]
    made.save_as(apart)
    with pytest.raises(VolumeError, match="unevenly spaced: save it in even ones"):
        open_file(apart, {})


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_pixels_may_be_floats(tmp_path: Path, kind: str) -> None:
    """Their tags come before that of whole numbers, where reading of headers stops."""
    field = (F / 7.0).astype(kind)
    made = dataset(F[0], LPS, 0, NumberOfFrames=12)
    for name in ("PixelData", "BitsStored", "HighBit", "PixelRepresentation"):
        delattr(made, name)
    made.BitsAllocated = 8 * field.itemsize
    name = "FloatPixelData" if kind == "f4" else "DoubleFloatPixelData"
    setattr(made, name, field.tobytes())
    save(tmp_path, "f.dcm", made)
    grid = open_file(tmp_path / "f.dcm", {})
    assert grid.dtype == np.dtype(kind)
    np.testing.assert_array_equal(grid.whole(), field)


def mosaic(array: np.ndarray, lps: np.ndarray, count: Any = None) -> Any:
    """An image whose tiles are the layers of a volume, as Siemens writes them."""
    depth, rows, columns = array.shape
    across = int(np.ceil(np.sqrt(depth)))
    tiles = np.zeros((across, rows, across, columns), np.int16)
    for n, layer in enumerate(array):
        tiles[n // across, :, n % across] = layer
    pixels = tiles.reshape(across * rows, across * columns)
    # The position is that of a slice as large as the mosaic, with the same centre.
    off = (across - 1) / 2.0 * np.array([columns, rows, 0.0])
    place = lps.copy()
    place[:3, 3] = lps[:3, 3] - lps[:3, :3] @ off
    made = dataset(pixels, place, 0, ImageType=["ORIGINAL", "PRIMARY", "M", "MOSAIC"])
    made.SpacingBetweenSlices = float(np.linalg.norm(lps[:3, 2]))
    if count is not None:
        block = made.private_block(0x19, "SIEMENS MR HEADER", create=True)
        block.add_new(0x0A, "US", count)
    return made


def test_mosaics_are_unfolded(tmp_path: Path) -> None:
    save(tmp_path, "f.dcm", mosaic(F, LPS, len(F)))
    grid = open_file(tmp_path / "f.dcm", {})
    assert grid.affine is not None and "a mosaic of 12 slices" in grid.notes[-1]
    np.testing.assert_array_equal(grid.whole(), F)
    np.testing.assert_allclose(grid.affine.array, affine()[:3], atol=1e-6)
    save(tmp_path, "f.dcm", mosaic(F, LPS))
    with pytest.raises(VolumeError, match=r"mosaic that does not say .* by dcm2niix"):
        open_file(tmp_path / "f.dcm", {})


def test_a_mosaic_lies_as_nibabel_says(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    wrappers = pytest.importorskip("nibabel.nicom.dicomwrappers")
    pydicom = pytest.importorskip("pydicom")
    packed = Path(nib.__file__).parent / "nicom/tests/data/siemens_dwi_1000.dcm.gz"
    if not packed.is_file():
        pytest.skip("nibabel came without its files of tests")
    path = tmp_path / "f.dcm"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    grid = open_file(path, {})
    known = wrappers.wrapper_from_data(pydicom.dcmread(path))
    np.testing.assert_array_equal(grid.whole(), np.asarray(known.get_data()).transpose(2, 0, 1))
    assert grid.affine is not None
    lps = known.affine[:3][:, [1, 0, 2, 3]]
    np.testing.assert_allclose(grid.affine.array, np.diag([-1, -1, 1]) @ lps, atol=1e-9)


def test_one_slice_off_its_place_adds_no_layer(tmp_path: Path) -> None:
    for number, layer in enumerate(F):
        shift = 0.2 * (number == 7)
        place = [f"{x:.9g}" for x in LPS[:3, 3] + (number + shift) * LPS[:3, 2]]
        made = dataset(layer, LPS, number, ImagePositionPatient=place)
        save(tmp_path / "a", f"{number}.dcm", made)
    grid = open_file(tmp_path / "a", {})
    assert grid.shape == F.shape and "off their even places" in grid.notes[0]
    others = [n for n in range(12) if n != 7]
    np.testing.assert_allclose(grid.whole()[others], F[others], atol=1e-3)
    np.testing.assert_allclose(grid.whole()[7], (F[7] + 0.2 * F[6]) / 1.2, atol=0.1)


def test_the_list_of_a_disk_says_what_to_give(tmp_path: Path) -> None:
    listed = files_of_pydicom() / "dicomdirtests" / "DICOMDIR"
    if listed.is_file():
        with pytest.raises(VolumeError, match="list of a DICOM disk: give the folder"):
            open_file(listed, {})
