"""The reader's limits: the processor's time, memory, one at a time; and what a hole in a library
could do inside.
"""

import asyncio
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from isogi_core.files.radiance import encode_rgbe
from isogi_server.uploads import uploads
from isogi_server.uploads.sandbox import lacking
from isogi_server.uploads.uploads import PYTHON_ROOT, Reader
from tests.server.asking import Ask
from tests.server.uploads import claims
from tests.server.uploads.files import ball
from tests.server.uploads.measured import GIGABYTE, read_measured
from tests.server.uploads.site import Open, client_of, opened


def nrrd_of(kind: str, side: int, data: bytes) -> bytes:
    """A NRRD file of a cube."""
    sizes = " ".join([str(side)] * 3)
    fields = (
        f"NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {sizes}\nencoding: raw\nendian: little\n\n"
    )
    return fields.encode() + data


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("kind", "dtype"), [("float", np.float32), ("uchar", np.uint8)])
def test_the_largest_upload_is_read_within_a_gigabyte(
    tmp_path: Path, kind: str, dtype: Any
) -> None:
    side = 400
    values = np.arange(side**3, dtype=np.uint32).astype(dtype)
    (tmp_path / "large.nrrd").write_bytes(nrrd_of(kind, side, values.tobytes()))
    answer, peak = read_measured(tmp_path / "large.nrrd")
    assert "id" in answer and peak < GIGABYTE


@pytest.mark.slow
@pytest.mark.long
def test_the_largest_probe_is_read_within_a_gigabyte(tmp_path: Path) -> None:
    row = np.random.default_rng(1).random((1, 8192, 3))
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4096 +X 8192\n"
    (tmp_path / "large.hdr").write_bytes(head + encode_rgbe(row) * 4096)
    answer, peak = read_measured(tmp_path / "large.hdr", "environment")
    assert "id" in answer and peak < GIGABYTE


def readers() -> list[psutil.Process]:
    """The readers of uploads that this process has started, and that still run."""
    children = psutil.Process().children()
    known = [(child, child.as_dict(["cmdline"])["cmdline"] or []) for child in children]
    return [child for child, command in known if "isogi_server.uploads.reader" in command]


def test_a_start_that_takes_long_is_no_reason_to_refuse(
    ask: Ask, open_app: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a machine with other work: the reader has no processor for a while."""
    read = Reader.read

    async def held_up(reader: Reader, seconds: float) -> str:
        (process,) = readers()
        process.suspend()
        asyncio.get_running_loop().call_later(1.5, process.resume)
        return await read(reader, seconds)

    monkeypatch.setattr(Reader, "read", held_up)
    begun = time.monotonic()
    answer = ask(open_app(reading_seconds=0.1), "POST", "/v1/volumes", content=ball())
    assert time.monotonic() - begun > 1.5
    assert answer.status_code == 201, answer.text


async def test_one_upload_is_read_at_a_time(
    open_app: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = [0]
    most = [0]
    read = Reader.read

    async def counted(reader: Reader, seconds: float) -> str:
        at_once[0] += 1
        most[0] = max(most[0], at_once[0])
        await asyncio.sleep(0.3)
        try:
            return await read(reader, seconds)
        finally:
            at_once[0] -= 1

    monkeypatch.setattr(Reader, "read", counted)
    async with client_of(open_app()) as client:
        answers = await asyncio.gather(
            *(client.post("/v1/volumes", content=ball(side)) for side in (8, 9))
        )
    assert [answer.status_code for answer in answers] == [201, 201] and most == [1]


async def test_a_reader_that_is_not_needed_any_more_is_gone() -> None:
    """Its upload never came to its end."""
    with tempfile.TemporaryFile() as body, tempfile.TemporaryFile() as out:
        async with Reader.started(body, out, "a", 8):
            (process,) = readers()
    assert not process.is_running()


REFUSALS = {
    "extended.mrc": "ends before its last voxel",
    "backward.mrc": "has -1024 bytes",
    "virtual.h5": "are in other datasets",
    "external.h5": "are in other datasets",
    "chunks.h5": "Chunks of",
    "deflated.dcm": "inflates to more than",
    "frames.dcm": "are the most that may be",
    "extension.nii": "ends before its last voxel",
}
"""What is said of files that are refused before anything large is read."""


@pytest.mark.slow
@pytest.mark.long
def test_a_small_file_that_claims_much_takes_little(tmp_path: Path) -> None:
    """Of all kinds. A tile that claims to be larger than its page is read as far as it goes."""
    paths = claims.written(tmp_path)
    assert REFUSALS.keys() <= {path.name for path in paths}
    for path in paths:
        begun = time.monotonic()
        answer, peak = read_measured(path)
        assert ("refused" in answer) is (path.name != "tiles.tif"), (path.name, answer)
        assert REFUSALS.get(path.name, "") in answer.get("refused", ""), (path.name, answer)
        assert peak < GIGABYTE / (4 if path.name in REFUSALS else 2), (path.name, peak, answer)
        assert time.monotonic() - begun < 20, path.name


@pytest.mark.slow
def test_a_picture_of_microscopes_may_be_sent(tmp_path: Path) -> None:
    """Its description is XML, whose reader must be loaded before files cannot be opened any
    more.
    """
    tifffile = pytest.importorskip("tifffile")
    values = np.arange(4 * 5 * 6, dtype=np.uint8).reshape(4, 5, 6)
    tifffile.imwrite(
        tmp_path / "a.ome.tif", values, photometric="minisblack", metadata={"axes": "ZYX"}
    )
    answer, _ = read_measured(tmp_path / "a.ome.tif")
    assert "id" in answer, answer


ATTEMPTS = """
import ctypes, json, os, socket, sys, threading
from isogi_server.uploads import sandbox

def succeeds(attempt):
    try:
        attempt()
    except (OSError, RuntimeError):
        return False
    return True

def fork():
    if not os.fork():
        os._exit(0)

folder, port, victim = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
plain = socket.socket()
attempts = {
    "open": lambda: open(folder + "/secret"),
    "make": lambda: os.mkdir(folder + "/made"),
    "rename": lambda: os.rename(folder + "/secret", folder + "/moved"),
    "unlink": lambda: os.unlink(folder + "/other"),
    "connect": lambda: plain.connect(("127.0.0.1", port)),
    "kill": lambda: os.kill(victim, 0),
    "fork": fork,
    "thread": threading.Thread(target=int).start,
    "socket": socket.socket,
    "pipe": os.pipe,
}
"""
PATHS = {"open", "make", "rename", "unlink"}


def allowed(give_up: str, folder: Path) -> set[str]:
    """The attempts that succeed in a process which ran ``give_up`` of the sandbox."""
    for name in ("secret", "other"):
        (folder / name).write_text("x")
    script = (
        f"{ATTEMPTS}\n{give_up}\nprint(json.dumps([name for name, each in "
        "attempts.items() if succeeds(each)]))"
    )
    with (
        subprocess.Popen(["sleep", "600"]) as victim,
        socket.create_server(("127.0.0.1", 0)) as listener,
    ):
        arguments = [str(folder), str(listener.getsockname()[1]), str(victim.pid)]
        command = [sys.executable, "-c", script, *arguments]
        given = {"PYTHONPATH": str(PYTHON_ROOT)}
        done = subprocess.run(command, env=given, capture_output=True, text=True, check=False)
        victim.kill()
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout))


@pytest.mark.skipif("seccomp" in lacking(), reason="no seccomp here")
def test_nothing_can_be_done_from_inside_the_reader(tmp_path: Path) -> None:
    assert allowed("", tmp_path) == {*PATHS, "connect", "kill", "fork", "thread", "socket", "pipe"}
    assert allowed("sandbox.give_up_calls()", tmp_path) == set()
    assert allowed("sandbox.confine()", tmp_path) == set()


@pytest.mark.skipif("Landlock" in lacking(), reason="no Landlock here")
def test_landlock_alone_keeps_files_out_of_reach(tmp_path: Path) -> None:
    assert not allowed("sandbox.give_up_paths()", tmp_path) & PATHS


def test_readyz_says_what_the_sandbox_lacks(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "lacking", lambda: "Uploads are read without Landlock.")
    with opened(small_scene, tmp_path) as site:
        answer = site.client.get("/readyz").json()
    assert answer == {
        "ready": True,
        "bakes": True,
        "reasons": ["Uploads are read without Landlock."],
    }
