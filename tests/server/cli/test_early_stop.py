"""Ctrl-C while a server or its fork server starts: one line, and no traceback."""

import subprocess
import sys
from pathlib import Path

STOPPED_WHILE_IT_STARTS = """
import errno, os, signal, sys, time
from server.cli.command import run
from server.render.engine import RenderEngine

def start(engine, *_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)
    raise OSError(errno.EBADF, os.strerror(errno.EBADF))

RenderEngine.open = RenderEngine.start = start
RenderEngine.hire = lambda engine: None
sys.exit(run(["serve", sys.argv[1], "--port", "0", "--store", sys.argv[2]]))
"""

INTERRUPTED = """
import os, signal, sys
from importlib import import_module
from worker.fork_server import PRELOADED_MODULES

class Interrupt:
    def find_spec(self, name, *_):
        if name == "worker.tasks":
            os.kill(os.getpid(), signal.SIGINT)
            print("interrupted")

sys.meta_path.insert(0, Interrupt())
for name in PRELOADED_MODULES:
    import_module(name)
"""


def ended(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A Python process that came to its end."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_a_server_that_is_stopped_early_says_one_line(small_scene: Path, tmp_path: Path) -> None:
    done = ended(STOPPED_WHILE_IT_STARTS, str(small_scene), str(tmp_path))
    said = [line for line in done.stderr.splitlines() if line and "compiling" not in line]  # a bar may be there
    assert (done.returncode, done.stdout, said) == (0, "", ["isogi: stopped before it was ready"])


def test_an_interrupt_does_not_end_the_fork_server() -> None:
    done = ended(INTERRUPTED)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
