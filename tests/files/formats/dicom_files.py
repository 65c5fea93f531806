"""DICOM files of phantoms, written by pydicom."""

from pathlib import Path
from typing import Any

import numpy as np


def dataset(array: np.ndarray, lps: np.ndarray, number: int, **changes: Any) -> Any:
    """One slice: the pixels (rows, columns) of the layer ``number`` of a volume whose affine, (4,
    4), is ``lps``.
    """
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

    steps = np.linalg.norm(lps[:3, :3], axis=0)
    made: Any = Dataset()
    made.file_meta = FileMetaDataset()
    made.file_meta.MediaStorageSOPClassUID = made.SOPClassUID = CTImageStorage
    made.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    made.SOPInstanceUID = made.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.{number + 1}"
    made.SeriesInstanceUID = "1.2.4.1"
    made.SeriesNumber = 1
    made.SeriesDescription = "an F"
    made.InstanceNumber = number + 1
    made.Rows, made.Columns = array.shape
    made.ImageOrientationPatient = [f"{x:.9g}" for x in (lps[:3, :2] / steps[:2]).T.ravel()]
    made.ImagePositionPatient = [f"{x:.9g}" for x in lps[:3, 3] + number * lps[:3, 2]]
    made.PixelSpacing = [f"{steps[1]:.9g}", f"{steps[0]:.9g}"]
    made.SamplesPerPixel = 1
    made.PhotometricInterpretation = "MONOCHROME2"
    made.BitsAllocated = 16
    made.BitsStored = 16
    made.HighBit = 15
    made.PixelRepresentation = 1
    made.PixelData = array.astype("<i2").tobytes()
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def write_series(folder: Path, array: np.ndarray, lps: np.ndarray, **changes: Any) -> Path:
    """A folder with a file for each layer, named so that their order is none of theirs."""
    folder.mkdir(exist_ok=True)
    for number, layer in enumerate(array):
        made = dataset(layer, lps, number, **changes)
        made.save_as(folder / f"{(number * 7919) % 1000:03}.dcm", enforce_file_format=True)
    return folder
