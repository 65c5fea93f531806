"""Mapped files: the system takes their pages back, arrays in files keep what is written to them."""

import errno
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files import mappings
from isogi_core.files.mappings import scratch
from isogi_core.files.volume_copies import new_voxels

MIB = 1 << 20

READING = """
import ctypes, sys
from pathlib import Path
import numpy as np
from isogi_core.files.volume_copies import read_voxels
MADV_PAGEOUT = 21
def file_bytes():
    return int(Path("/proc/self/statm").read_text().split()[2]) * 4096
voxels, _ = read_voxels(Path(sys.argv[1]))
before, flat = file_bytes(), voxels.ravel()
flat.sum()
read = file_bytes() - before
first = flat.ctypes.data // 4096 * 4096
ctypes.CDLL(None).madvise(ctypes.c_void_p(first), ctypes.c_size_t(flat.nbytes), MADV_PAGEOUT)
left = file_bytes() - before
places = np.random.default_rng(1).integers(0, flat.size, 2000)
assert np.array_equal(flat[places], (places % 1000003).astype(np.float32))
voxels[0, 0, :8] += 1.0  # is of this process alone
print(read, left)
"""

WRITING = """
import sys
from pathlib import Path
import numpy as np
from isogi_core.files.mappings import scratch
kept = []
for round in range(8):
    kept = [scratch(Path(sys.argv[1]), 1 << 19, np.int32) for _ in range(8)]
    for number, array in enumerate(kept):
        array[:] = np.arange(1 << 19) + number
    for number, array in enumerate(kept):
        assert np.array_equal(array, np.arange(1 << 19) + number)
    del array
print(sum(1 for _ in Path(sys.argv[1]).iterdir()))
"""


def run(script: str, path: Path, budget: int) -> str:
    """What a script prints, in a process of its own with a budget of so many megabytes."""
    environment = {**os.environ, "ISOGI_VOLUME_MB": str(budget)}
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], env=environment, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    assert done.stderr == b""
    return done.stdout.decode()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone reports pages of files")
def test_the_system_may_take_back_pages_of_volumes(tmp_path: Path) -> None:
    path = tmp_path / "v.voxels"
    shape = (64, 1024, 1024)
    with new_voxels(path) as draft:
        for z in range(shape[0]):
            first = z * shape[1] * shape[2]
            draft.write(
                (np.arange(first, first + shape[1] * shape[2]) % 1000003)
                .astype(np.float32)
                .reshape(shape[1:])
            )
        draft.seal(shape, {})
    before = hashlib.sha256(path.read_bytes()).digest()
    read, left = map(int, run(READING, path, 16).split())
    assert read > 250 * MIB, "of 256"
    assert left < 16 * MIB
    assert hashlib.sha256(path.read_bytes()).digest() == before


def test_what_is_written_to_files_outlives_its_pages(tmp_path: Path) -> None:
    assert run(WRITING, tmp_path, 4) == "0\n", "and the files have no names"


def test_a_full_disk_leaves_arrays_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(mappings.os, "posix_fallocate", full)
    array = scratch(tmp_path, 1000, np.float32)
    array[:] = 7.0
    assert array.base is None and array.sum() == 7000.0
