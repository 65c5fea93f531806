"""A cluster that speaks TLS: with the commands of docs/cluster.md, over sockets of this machine."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cluster.processes import LONG, ROOT, Cluster, final, reasons, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with"),
]
TEXT = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")


def make_certificates(folder: Path) -> dict[str, str]:
    """Run the commands of the documentation in a folder; the environment that it tells, its files there."""
    for command in re.findall(r"^openssl .*$", TEXT, re.MULTILINE):
        subprocess.run(shlex.split(command), cwd=folder, check=True, capture_output=True)
    settings = re.findall(r"(DASK_\w+)=(\S+)", TEXT)
    return {name: value if value == "true" else str(folder / value) for name, value in settings}


def test_all_processes_speak_tls_and_refuse_strangers(small_scene: Path, tmp_path: Path) -> None:
    ours, others = tmp_path / "ours", tmp_path / "others"
    ours.mkdir()
    others.mkdir()
    environment, stranger = make_certificates(ours), make_certificates(others)
    assert len(environment) == 8
    with Cluster(environment, "tls") as running:
        running.scheduler()
        for settings in (stranger, dict.fromkeys(environment, "")):
            refused = running.worker(environment=settings)
            assert refused.wait(LONG) != 0
        _, client = running.server(small_scene, str(tmp_path / "light"))
        until(lambda: "No worker has joined" in reasons(client))
        running.worker()
        until(lambda: reasons(client) == "")
        assert final(client)
