"""The folder of compiled kernels: named after a digest of their sources;
folders of old sources are pruned.
"""

import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba

KEPT_FOLDERS = 8
"""Number of folders of other sources that are kept next to the one in use: those used last."""

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

CACHE_VARIABLE = "ISOGI_KERNEL_CACHE"
"""Environment variable that names the parent of the folders of compiled kernels."""

LOCK_SUFFIX = ".lock"
"""Suffix of the files that are locked while a kernel is compiled."""

IN_USE = "in-use"
"""Name of the file in a folder on which its users hold a shared lock."""


def sources_digest() -> str:
    """Return a digest of all kernel sources, their paths and times,
    the compiler and the processor; hex.
    """
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        # Numba compares times of sources with those in its index, so that these count too.
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
    """Return the folder for compiled kernels of these sources, in ``$ISOGI_KERNEL_CACHE`` or
    the user's cache folder.
    """
    root = os.environ.get(CACHE_VARIABLE)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (Path(root) if root else base / "isogi" / "kernels") / sources_digest()


class OpenFolder(NamedTuple):
    """The ``folder`` in which this process keeps compiled kernels, held by the open file ``mark``.

    ``read_only``, if any, is the folder that it replaces because that cannot be written.
    """

    folder: Path
    mark: int
    read_only: Path | None = None


def open_folder() -> OpenFolder:
    """Hold the folder of compiled kernels; raises OSError if no temporary files can be made either.

    If the folder cannot be written, as in a read-only image, a temporary folder takes its place for
    this process and those that it starts: with links to all kernels that are there, and room for
    others.
    """
    wanted = cache_folder()
    # Use the wanted folder if it can be written.
    with suppress(OSError):
        mark = hold(wanted)
        if is_writable(wanted):
            return OpenFolder(wanted, mark)
        os.close(mark)
    # Otherwise link its kernels into a private folder, also for the processes started from here.
    root = private_root()
    folder = root / wanted.name
    mark = hold(folder)
    link_files(wanted, folder)
    os.environ[CACHE_VARIABLE] = str(root)
    return OpenFolder(folder, mark, wanted)


def is_writable(folder: Path) -> bool:
    """Return True if files can be made in ``folder`` and in each folder directly in it."""
    return all(os.access(each, os.W_OK) for each in (folder, *folder.iterdir()) if each.is_dir())


def private_root() -> Path:
    """Return a temporary folder that only this user can write, the same for each process.

    Kernels are machine code that is executed: if another user owns the folder of this name, a new
    one is made.
    """
    root = Path(tempfile.gettempdir()) / f"isogi-kernels-{os.geteuid()}"
    with suppress(FileExistsError):
        root.mkdir(mode=0o700)
    found = root.lstat()
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    if ours and not stat.S_IMODE(found.st_mode) & 0o077:
        return root
    return Path(tempfile.mkdtemp(prefix="isogi-kernels-"))


def link_files(source: Path, folder: Path) -> None:
    """Link all files below ``source``, but for locks, into ``folder``, with the same subfolders.

    Compilers replace files whole, so that none writes through a link.
    """
    for path in source.rglob("*"):
        link = folder / path.relative_to(source)
        if path.is_file() and path.name != IN_USE and path.suffix != LOCK_SUFFIX:
            link.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                link.symlink_to(path)


def hold(folder: Path) -> int:
    """Mark ``folder`` as used now and until this process ends; it is made if missing.

    Returns the open file that holds the mark.
    """
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        mark = os.open(folder / IN_USE, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(mark, fcntl.LOCK_SH)
        # Another process may have pruned the folder before the lock was taken; then try again.
        if is_at(mark, folder / IN_USE):
            os.utime(folder / IN_USE)
            return mark
        os.close(mark)


def prune_folders(folder: Path) -> None:
    """Remove siblings of ``folder``, except the ``KEPT_FOLDERS`` used last and those that a process
    holds.

    Folders that another process removes meanwhile, or that another user owns, are skipped.
    """
    others = [each for each in folder.parent.iterdir() if each != folder and each.is_dir()]
    for old in sorted(others, key=last_used)[: max(len(others) - KEPT_FOLDERS, 0)]:
        with suppress(OSError), locked(old / IN_USE, wait=False) as ours:
            if ours:
                shutil.rmtree(old, ignore_errors=True)


@contextmanager
def locked(path: Path, wait: bool = True) -> Iterator[bool]:
    """Lock the file ``path`` against all other threads and processes; yield True if the lock was
    obtained.

    If ``wait`` is False and the lock is taken, yield False without waiting.
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
    """Return the time at which a process last began to use ``folder``, in seconds; when it was
    made if none did; 0 if it is gone.
    """
    for path in (folder / IN_USE, folder):
        with suppress(OSError):
            return path.stat().st_mtime
    return 0.0


def is_at(file: int, path: Path) -> bool:
    """Return True if the open ``file`` is the one at ``path``; it may have been removed and
    made again since.
    """
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
