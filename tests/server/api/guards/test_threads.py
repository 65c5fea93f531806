"""Threads of a server process: their number does not grow with what its visitors ask for."""

import subprocess
import sys
from pathlib import Path

import httpx
import psutil
import pytest

from isogi_core.plan.assembly import load_scene
from tests.s3 import S3Server

ROOT = Path(__file__).resolve().parents[4]
CUTS = 100
MOST_THREADS = 64


@pytest.mark.slow
@pytest.mark.long
def test_cuts_over_an_object_store_share_their_threads(small_scene: Path, s3: S3Server) -> None:
    """Each cut is a scene with layers of its own, and its slider moves."""
    (low, *_), (high, *_) = load_scene(small_scene).volume.world_bounds
    command = [sys.executable, "-m", "isogi_server", "serve", str(small_scene), "--port", "0"]
    command += ["--workers", "1", "--store", s3.url]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        url = process.stdout.readline().split()[-1]
        most = 0
        with httpx.Client(base_url=url, timeout=60) as client:
            for number in range(CUTS):
                x = low + (high - low) * (0.3 + 0.5 * number / CUTS)
                for isovalue in (0.5, 0.51):
                    view = {"width": 24, "height": 24, "cut": f"x>{x:.4f}", "isovalue": isovalue}
                    answer = client.get("v1/scenes/small/frame", params=view)
                    assert answer.status_code == 200, answer.text
                most = max(most, psutil.Process(process.pid).num_threads())
        process.terminate()
    assert 0 < most < MOST_THREADS
