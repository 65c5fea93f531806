"""Fixtures that several rooms share."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real volumes and probes; the test skips, saying why, where it is absent."""
    folder = Path(os.environ.get("ISOGI_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real volumes at {folder}: set ISOGI_SHARED_DATA to a folder that has them")
    return folder
