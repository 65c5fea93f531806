"""What a hole in a library could do from inside the reader of uploads: nothing but answer."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from server.uploads import uploads
from server.uploads.sandbox import lacking
from server.uploads.uploads import PYTHON_ROOT
from tests.server.uploads.site import opened

ATTEMPTS = """
import ctypes, json, os, socket, sys, threading
from server.uploads import sandbox

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
    script = f"{ATTEMPTS}\n{give_up}\nprint(json.dumps([name for name, each in attempts.items() if succeeds(each)]))"
    with subprocess.Popen(["sleep", "600"]) as victim, socket.create_server(("127.0.0.1", 0)) as listener:
        arguments = [str(folder), str(listener.getsockname()[1]), str(victim.pid)]
        command, given = [sys.executable, "-c", script, *arguments], {"PYTHONPATH": str(PYTHON_ROOT)}
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


def test_readyz_says_what_the_sandbox_lacks(small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "lacking", lambda: "Uploads are read without Landlock.")
    with opened(small_scene, tmp_path) as site:
        answer = site.client.get("/readyz").json()
    assert answer == {"ready": True, "reasons": ["Uploads are read without Landlock."]}
