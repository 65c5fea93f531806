"""A prewarm that is killed half-way goes on: nothing is baked twice, and its light is that of an
undisturbed one.
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from isogi_core.bake.bake_spec import spec_for
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_server.cli.prewarm import prewarm
from isogi_server.prewarm.order import order_of
from isogi_server.prewarm.record import Summary
from isogi_server.settings import Settings
from tests.server.asking import Told
from tests.server.inline import LONG, chunks_in
from tests.server.sockets import wait_for

ROOT = Path(__file__).resolve().parents[3]
TARGET = "0.0005"


def paths_in(scene: Path, store: Path) -> int:
    """The paths of all light in a store; each brings light to all of its layers."""
    found = ChunkStore(store, spec_for(PreparedScene(load_scene(scene)), "gi"))
    indices = [
        tuple(map(int, path.parts[-4:-1])) for path in Path(found.layers[0].path).glob("c/*/*/*/0")
    ]
    chunks = [found.read((z, y, x)) for z, y, x in indices]
    return sum(int(chunk.light.samples.clip(0).sum()) for chunk in chunks if chunk is not None)


def has_stored(store: Path) -> bool:
    """Whether a prewarm has written light. Light that still climbs is written every few seconds, so
    that the prewarm must take longer than that.
    """
    return len(chunks_in(store)) >= 6


def kill_once(scene: Path, store: Path) -> None:
    """Begin a prewarm as a process, and kill it once it has stored light; its workers end with
    it.
    """
    command = [
        sys.executable,
        "-m",
        "server",
        "prewarm",
        str(scene),
        "--store",
        str(store),
        "--workers",
        "1",
    ]
    order = ["--isovalue", "0.5", "--all-directions", "--target-error", TARGET]
    process = subprocess.Popen(
        [*command, *order], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    assert (
        wait_for(lambda: process.poll() is not None or has_stored(store), LONG)
        and process.poll() is None
    )
    family = psutil.Process(process.pid).children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert psutil.wait_procs(family, timeout=LONG)[1] == []


@pytest.fixture(scope="module")
def scene(blocks: Path) -> Path:
    """The scene, whose pictures ask for more samples than texels have at first."""
    path = blocks.with_name("sky.toml")
    settings = (
        blocks.read_text()
        .replace('"constant"', '"sky"')
        .replace("error = 0.1", f"error = {TARGET}")
    )
    path.write_text(f"projected = false\n{settings}")
    return path


@pytest.fixture(scope="module")
def whole(
    scene: Path, all_inline: None, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Summary]:
    """A store that a prewarm has filled undisturbed, and how that ended."""
    store = tmp_path_factory.mktemp("whole")
    order = order_of({"isovalues": ["0.5"], "all_directions": True, "target_error": TARGET})
    return store, prewarm(str(scene), order, Settings(store=str(store), workers=1))


@pytest.mark.kill
def test_a_prewarm_that_is_killed_goes_on(
    scene: Path,
    whole: tuple[Path, Summary],
    tmp_path: Path,
    told: Told,
) -> None:
    store, undisturbed = whole
    assert undisturbed.paths == paths_in(scene, store)
    killed = tmp_path / "killed"
    kill_once(scene, killed)
    before = paths_in(scene, killed)
    assert 0 < before < undisturbed.paths
    (record,) = (killed / "jobs").glob("*.json")
    assert json.loads(record.read_text())["status"] == "running"
    rest = Summary.model_validate_json(
        told("prewarm", scene, "--continue", "--store", killed, "--workers", "1", "--json")
    )
    assert (rest.final, rest.stopped) == (1.0, "target")
    assert before + rest.paths == undisturbed.paths
    assert chunks_in(killed) == chunks_in(store)
    assert json.loads(record.read_text())["status"] == "successful"
