"""The folder of compiled kernels: named after their sources, and pruned when sources have changed
often.
"""

import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm
import numba

KEPT_FOLDERS = 8
"""Folders of other sources that are kept besides the folder in use: the ones used last."""

SETTINGS = (
    *(
        "BOUNDSCHECK",
        "OPT",
        "LOOP_VECTORIZE",
        "SLP_VECTORIZE",
        "USING_SVML",
        "ENABLE_AVX",
        "DEBUGINFO_DEFAULT",
    ),
    *(
        "EXTEND_VARIABLE_LIFETIMES",
        "LLVM_REFPRUNE_PASS",
        "LLVM_REFPRUNE_FLAGS",
        "NRT_STATS",
        "ENABLE_PROFILING",
    ),
)
"""Settings of Numba, from the environment, that change machine code."""

IN_USE = "in-use"
"""File in a folder that its users hold a shared lock on."""


def sources_digest() -> str:
    """Digest of every kernel source, where and from when it is, the compiler and the processor, as
    hex.
    """
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(f"{path} {path.stat().st_mtime_ns}".encode())
        digest.update(path.read_bytes())
    cpu = numba.config.CPU_NAME or llvm.get_host_cpu_name()
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    settings = [str(getattr(numba.config, name, None)) for name in SETTINGS]
    digest.update(
        f"{numba.__version__} {llvmlite.__version__} {settings} {cpu} {features}".encode()
    )
    return digest.hexdigest()


def cache_folder() -> Path:
    """Where compiled kernels are kept: ``$ISOGI_KERNEL_CACHE`` or the user's cache folder."""
    root = os.environ.get("ISOGI_KERNEL_CACHE")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (Path(root) if root else base / "isogi" / "kernels") / sources_digest()


def hold(folder: Path) -> int:
    """Mark ``folder``, which is made where it is missing, as used now and until this process ends.

    Returns the open file that the mark hangs on.
    """
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        mark = os.open(folder / IN_USE, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(mark, fcntl.LOCK_SH)
        if is_at(mark, folder / IN_USE):
            os.utime(folder / IN_USE)
            return mark
        os.close(mark)


def prune_folders(folder: Path) -> None:
    """Remove the siblings of ``folder`` but the ``KEPT_FOLDERS`` used last, and but folders that a
    process holds.

    What another process removes meanwhile, or another user owns, is passed over.
    """
    others = [each for each in folder.parent.iterdir() if each != folder and each.is_dir()]
    for old in sorted(others, key=last_used)[: max(len(others) - KEPT_FOLDERS, 0)]:
        with suppress(OSError), locked(old / IN_USE, wait=False) as ours:
            if ours:
                shutil.rmtree(old, ignore_errors=True)


@contextmanager
def locked(path: Path, wait: bool = True) -> Iterator[bool]:
    """Lock the file ``path`` against all other threads and processes; yields whether the lock was
    free.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


def last_used(folder: Path) -> float:
    """When a process began to use ``folder``, in seconds; where none has said so, when it was made;
    0 if it is gone.
    """
    for path in (folder / IN_USE, folder):
        with suppress(OSError):
            return path.stat().st_mtime
    return 0.0


def is_at(file: int, path: Path) -> bool:
    """Whether the open ``file`` is the one at ``path``: it may have been removed, and made again,
    since.
    """
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
