"""The folder of compiled kernels: named after their sources, and pruned when sources have changed
often.
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

CACHE_VARIABLE = "ISOGI_KERNEL_CACHE"
"""Environment variable of the folder of compiled kernels, of all sources."""

LOCK_SUFFIX = ".lock"
"""Suffix of the files that are locked while a kernel is compiled."""

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
    root = os.environ.get(CACHE_VARIABLE)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (Path(root) if root else base / "isogi" / "kernels") / sources_digest()


class OpenFolder(NamedTuple):
    """The ``folder`` that this process keeps compiled kernels in, held open by the file ``mark``.

    It stands in for ``read_only``, if any: a folder that cannot be written.
    """

    folder: Path
    mark: int
    read_only: Path | None = None


def open_folder() -> OpenFolder:
    """Hold the folder of compiled kernels. Raises OSError if there is no room for temporary files
    either.

    If it cannot be written, as one in a read-only image, a folder of temporary files takes its
    place for this process and those that it starts: with links to all kernels that are there, and
    room for those that are not.
    """
    wanted = cache_folder()
    with suppress(OSError):
        mark = hold(wanted)
        if is_writable(wanted):
            return OpenFolder(wanted, mark)
        os.close(mark)
    root = private_root()
    folder = root / wanted.name
    mark = hold(folder)
    link_files(wanted, folder)
    os.environ[CACHE_VARIABLE] = str(root)
    return OpenFolder(folder, mark, wanted)


def is_writable(folder: Path) -> bool:
    """Whether files can be made in ``folder`` and in each folder in it."""
    return all(os.access(each, os.W_OK) for each in (folder, *folder.iterdir()) if each.is_dir())


def private_root() -> Path:
    """A folder of temporary files that this user alone can write, the same in each process.

    Kernels are machine code: a folder of this name that is another user's is passed over for a new
    one.
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
    """Put links into ``folder`` to all files below ``source`` but locks, in folders like theirs.

    Compilers replace files whole, so that none writes through a link.
    """
    for path in source.rglob("*"):
        link = folder / path.relative_to(source)
        if path.is_file() and path.name != IN_USE and path.suffix != LOCK_SUFFIX:
            link.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                link.symlink_to(path)


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
