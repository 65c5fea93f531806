"""Names that an installation puts next to other people's modules."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"isogi", "isogi_core", "isogi_worker", "isogi_server", "isogi_web", "isogi_report"}
FORMER_MODULES = {"isogi_client.py", "isogi_widget.py"}


@pytest.mark.slow
def test_a_wheel_has_names_of_isogi_alone(tmp_path: Path) -> None:
    """Built from a clean copy of what git knows, with the page's files."""
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=False)
    if archive.returncode:
        pytest.skip("not a checkout of git")
    copy = tmp_path / "copy"
    copy.mkdir()
    subprocess.run(["tar", "-x", "-C", str(copy)], input=archive.stdout, check=True)
    command = [sys.executable, "-m", "uv", "build", "--wheel", "--quiet", "-o", str(tmp_path)]
    built = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("isogi-*.whl")
    files = zipfile.ZipFile(wheel).namelist()
    names = {each.split("/")[0] for each in files if ".dist-info/" not in each}
    assert names == PACKAGES | FORMER_MODULES
    assert {"isogi_web/index.html", "isogi_web/main.js", "isogi/py.typed"} <= set(files)
