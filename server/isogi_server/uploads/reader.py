"""The reader of uploads: a separate process for one file, which may be hostile.

``python -m isogi_server.uploads.reader NAME BODY OUT KIND VOXELS`` waits for a line on stdin: the
seconds of processor time that reading may take. It comes once the file at the descriptor BODY is
complete.
The process writes a canonical file to the descriptor OUT, and one line of JSON to stdout, with the
id or a sentence that says why the file is refused.

Its memory and time are limited, and it gives up all rights that it does not need before it reads
the file (see ``sandbox``). So no path, URL or socket that the file names can be reached, and an
error in a library that the file exploits does no harm outside.
"""

import contextlib
import json
import math
import os
import resource
import sys
import time
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import LightError, VolumeError
from isogi_core.files.formats.opening import HEAD_BYTES, libraries_for, open_upload
from isogi_core.files.grid import Grid, on_right_angles
from isogi_core.files.plugins import LOAD_FAULTS
from isogi_core.files.probes import EXR_LIBRARY, EXR_MAGIC
from isogi_core.model.environment import resample
from isogi_core.model.value_survey import survey
from isogi_core.plan.volumes.labels import Segmentation
from isogi_server.uploads.folder import ENVIRONMENT_KIND, MAX_HEADER_BYTES, write, write_environment
from isogi_server.uploads.sandbox import confine

LIBRARY_BYTES = 128 << 20
"""Bytes of memory that loaded libraries need, in addition to voxels."""

PER_VOXEL = 12
"""Bytes of memory for each voxel that is allowed: 8 bytes as in the file, and what checks take.

For the 64 million voxels that uploads may have by default this comes to 1 GB, with Python and its
libraries.
"""

LONGEST_SENTENCE = 500


def main(name: str, body: int, out: int, kind: str, voxels: int, seconds: float) -> dict[str, str]:
    """Read the file at the descriptor ``body``, of at most ``voxels`` voxels and in ``seconds``
    of processor time, and write it to ``out``. Return the answer to the server.
    """
    # Load libraries first, then limit and confine the process, and only then read the file.
    rehearse(os.pread(body, HEAD_BYTES, 0))
    limit(voxels, seconds)
    confine()
    os.lseek(body, 0, os.SEEK_SET)
    with open(body, "rb", closefd=False) as upload, open(out, "wb", closefd=False) as canonical:
        try:
            if kind == ENVIRONMENT_KIND:
                return {"id": write_environment(canonical, upload.read(), name)}
            found = open_upload(upload, name or "upload", voxels)
            grid = found if any(found.periodic) else on_right_angles(found)
            name = named_after(found, name)
            check_size(grid, voxels)
            # Check the size before voxels are loaded, and refuse now what the server could not
            # show.
            grid = grid.loaded()
            survey(grid, "above")
            if grid.labels is not None:
                # Labels that cannot be shown raise VolumeError.
                Segmentation(grid, ()).labels  # noqa: B018
            return {"id": write(canonical, grid, name)}
        except (VolumeError, LightError) as error:
            return {"refused": str(error)}
        except MemoryError:
            return {
                "refused": (
                    "The file needs more memory than an upload may take: save a smaller part of it."
                )
            }
        except Exception as error:
            return {
                "refused": (
                    f"The file cannot be read ({type(error).__name__}: {error}): save it again."
                )
            }


def named_after(grid: Grid, name: str) -> str:
    """Return the name of a volume; it says so if the volume is the first step of a series in
    time.
    """
    if grid.unchosen:
        return f"{name or 'volume'}, first of {grid.moment[1]} steps"
    return name


def check_size(grid: Grid, voxels: int) -> None:
    """Raise VolumeError if a grid, resampled to right angles, has more than ``voxels`` voxels."""
    if grid.size > voxels:
        raise VolumeError(
            f"The volume has {grid.size} voxels, and {voxels} are the most that may be: save a "
            "smaller part."
        )


def rehearse(head: bytes) -> None:
    """Import all modules that reading a file may need, by its first bytes, ``head``: no file can
    be opened, and no module imported, after ``limit`` and ``confine``.
    """
    # Use NumPy and isogi once on made-up data, as some of their modules are imported on first use.
    survey(Grid.of(np.array([0.0, 1.0, np.nan, 1e30] * 2).reshape(2, 2, 2)), "above")
    resample(np.ones((4, 8, 3)), 2, 4)
    # Import the libraries of this kind of file.
    if head.startswith(EXR_MAGIC):
        libraries = [EXR_LIBRARY]
    else:
        libraries = libraries_for(head)
    for name in libraries:
        # A module that fails to load, such as that of a plug-in, may belong to another kind.
        with contextlib.suppress(*LOAD_FAULTS):
            import_module(name)


def limit(voxels: int, seconds: float) -> None:
    """Limit memory, time and file size of this process from now on; it can open no more files."""
    # Beyond what the start of the process took: files that are open stay open.
    limits = {
        resource.RLIMIT_AS: mapped_bytes() + LIBRARY_BYTES + PER_VOXEL * voxels,
        resource.RLIMIT_CPU: math.ceil(time.process_time() + seconds),
        resource.RLIMIT_FSIZE: MAX_HEADER_BYTES + 8 * voxels,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NOFILE: 0,
    }
    for what, most in limits.items():
        _, ceiling = resource.getrlimit(what)
        if ceiling == resource.RLIM_INFINITY:
            least = most
        else:
            least = min(most, ceiling)
        resource.setrlimit(what, (least, least))


def mapped_bytes() -> int:
    """Return the bytes of this process's address space; 1 GB if the system does not report them."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except OSError:
        return 1 << 30


def line_of(answer: dict[str, Any]) -> str:
    """Return an answer as one line of JSON, with values cut to LONGEST_SENTENCE characters."""
    return json.dumps({key: str(value)[:LONGEST_SENTENCE] for key, value in answer.items()})


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    os.umask(0o077)
    NAME, BODY, OUT, KIND, VOXELS = sys.argv[1:]
    if SECONDS := sys.stdin.readline():
        with contextlib.suppress(BrokenPipeError):
            # Some libraries print to stdout: let the answer alone go there.
            ANSWER = os.fdopen(os.dup(1), "w")
            os.dup2(2, 1)
            FACTS = main(NAME, int(BODY), int(OUT), KIND, int(VOXELS), float(SECONDS))
            print(line_of(FACTS), file=ANSWER, flush=True)
