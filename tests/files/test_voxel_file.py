"""Resident pages of mapped voxels are let go above the budget, and come back with the same bytes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.volume_copies import new_voxels

SCRIPT = """
import sys, time
from pathlib import Path
from isogi_core.files.mappings import file_bytes
from isogi_core.files.volume_copies import read_voxels
import numpy as np
import pytest
from isogi_core.kernels._pages import bound_pages
getattr(bound_pages, "ready", None)  # libraries are loaded
before = file_bytes()
voxels, _ = read_voxels(Path(sys.argv[1]))
first = float(voxels.sum(dtype=np.float64))
deadline = time.monotonic() + 60
while file_bytes() - before > 24 << 20 and time.monotonic() < deadline:
    time.sleep(0.01)
assert file_bytes() - before <= 24 << 20, file_bytes() - before
assert float(voxels.sum(dtype=np.float64)) == first
voxels[0, 0, :8] += 1.0  # is of this process alone
print(first)
"""


@pytest.mark.slow
def test_pages_above_the_budget_are_let_go(tmp_path: Path) -> None:
    path, rng = tmp_path / "v.voxels", np.random.default_rng(2)
    planes = rng.random((64, 512, 512), np.float32)
    with new_voxels(path) as draft:
        for plane in planes:
            draft.write(plane)
        draft.seal(planes.shape, {})
    before = path.read_bytes()
    command = [sys.executable, "-c", SCRIPT, str(path)]
    done = subprocess.run(command, env={**os.environ, "ISOGI_VOLUME_MB": "16"}, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert float(done.stdout) == planes.sum(dtype=np.float64)
    assert path.read_bytes() == before
