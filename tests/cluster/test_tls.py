"""A cluster that speaks TLS: with the commands of docs/cluster.md, over sockets of this machine."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cluster.processes import DASK, HEALTH, LONG, OWN, QUIET, ROOT, Cluster, final, named, reasons, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with"),
]
TEXT = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")


def make_certificates(folder: Path) -> Path:
    """Run the commands of the documentation in a new folder."""
    folder.mkdir()
    for command in re.findall(r"^openssl .*$", TEXT, re.MULTILINE):
        subprocess.run(shlex.split(command), cwd=folder, check=True, capture_output=True)
    return folder


def test_the_commands_of_the_documentation_name_them_all() -> None:
    started = [line for line in TEXT.splitlines() if line.startswith(("dask ", "isogi serve"))]
    assert len(started) == 3
    assert all(f"export {name}='{value}'" in TEXT for name, value in HEALTH.items())
    for line, options in zip(started, (DASK, DASK, OWN), strict=True):
        assert " ".join(named(options, Path())) in line


def test_all_processes_speak_tls_and_refuse_strangers(small_scene: Path, tmp_path: Path) -> None:
    ours, others = make_certificates(tmp_path / "ours"), make_certificates(tmp_path / "others")
    with Cluster(ours) as running:
        running.scheduler()
        for stranger in (named(DASK, others), QUIET):
            assert running.worker(*stranger).wait(LONG) != 0
        _, client = running.server(small_scene, str(tmp_path / "light"))
        until(lambda: "No worker has joined" in reasons(client))
        running.worker()
        until(lambda: reasons(client) == "")
        assert final(client)
