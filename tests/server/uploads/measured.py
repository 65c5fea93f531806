"""The reader of uploads in a process that says how much memory it took."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from isogi_server.uploads.uploads import reader_environment

CODE = """
import json, sys, warnings
warnings.simplefilter("ignore")
status = open("/proc/self/status")  # the reader itself can open nothing any more
from isogi_server.uploads import reader
_, body, out, kind, voxels = sys.argv
answer = reader.main("a file", int(body), int(out), kind, int(voxels), 60)
status.seek(0)
peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
print(json.dumps([answer, peak >> 10]))
"""
GIGABYTE = 1024
"""Megabytes that any reader may take."""

MOST = 64 << 20
"""Voxels that an upload may have by default."""


def read_measured(path: Path, kind: str = "volume") -> tuple[dict[str, str], int]:
    """What the reader answers to a file of a kind, and the most memory that it took, in
    megabytes.
    """
    with path.open("rb") as body, tempfile.TemporaryFile(dir=path.parent) as out:
        files = body.fileno(), out.fileno()
        command = [sys.executable, "-c", CODE, *map(str, files), kind, str(MOST)]
        done = subprocess.run(
            command, capture_output=True, pass_fds=files, env=reader_environment(), check=False
        )
    assert done.returncode == 0, (path, done.returncode, done.stderr)
    answer, peak = json.loads(done.stdout)
    return answer, peak
