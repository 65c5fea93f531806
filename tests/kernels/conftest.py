"""What all tests of kernels share."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from isogi_core.kernels import _jit
from tests.scale import PYTHON


class House:
    """A package ``isogi_core.kernels`` of small modules, with the compiler's own, and an empty
    cache.
    """

    def __init__(self, place: Path) -> None:
        self.place = place
        self.cache = place / "cache"
        self.kernels = place / "isogi_core" / "kernels"
        self.kernels.mkdir(parents=True)
        for name in ("_jit.py", "_compilation.py", "_compiler.py", "_cache_folder.py"):
            shutil.copy(Path(_jit.__file__).with_name(name), self.kernels)
        for package in (self.kernels, self.kernels.parent):
            (package / "__init__.py").touch()

    def write(self, name: str, text: str, seconds: float = 1.0) -> None:
        """Write a module of kernels, as if so many ``seconds`` after 1970."""
        (self.kernels / name).write_text(text)
        os.utime(self.kernels / name, (seconds, seconds))

    def ask(self, script: str, *before: str, **variables: str) -> str:
        """What a script writes in a process of its own, started by the command ``before``."""
        (self.place / "ask.py").write_text(script)
        environment = {
            **os.environ,
            "ISOGI_KERNEL_CACHE": str(self.cache),
            "PYTHONPATH": str(self.place),
            **variables,
        }
        command = [*before, sys.executable, "ask.py"]
        done = subprocess.run(
            command, env=environment, cwd=self.place, capture_output=True, text=True, check=True
        )
        return done.stdout


@pytest.fixture
def house(tmp_path: Path) -> House:
    return House(tmp_path)


@pytest.fixture(autouse=PYTHON)
def silence() -> Iterator[None]:
    """Kernels that Python runs say no more of a division by zero than compiled ones do."""
    with np.errstate(all="ignore"):
        yield
