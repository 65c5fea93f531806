"""Plug-ins: readers and writers of other packages, found by their entry points.

A package lists records, `Kind`s of files or `Writer`s, under the groups READER_GROUP and
WRITER_GROUP. Entries that cannot be loaded are left out; if a file then has no reader or writer,
the message has a sentence for each of them.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, NamedTuple

from isogi_core.errors import IsogiError
from isogi_core.files.packed_files import line_of

READER_GROUP = "isogi.readers"
WRITER_GROUP = "isogi.writers"
"""Groups of entry points."""

LOAD_FAULTS: tuple[type[BaseException], ...] = (Exception, SystemExit)
"""Errors of other packages that are caught when their modules are loaded, or their code runs."""


@dataclass(frozen=True)
class Writer:
    """A kind of files to which light is written, chosen by the ``suffix`` of a file's name.

    - ``encode``: ``module:function`` of the function that takes a `LitMesh`, or a `LitVolume` if
      ``of_volume`` is set, and returns the bytes of the file. If ``is_folder`` is set, it takes
      the path first, and writes the folder itself.
    - ``vertex_bytes``: about the bytes of the file that a vertex of a mesh takes.
    - ``package``: the plug-in's package, for messages; empty for isogi's kinds.
    """

    suffix: str
    encode: str
    of_volume: bool = False
    vertex_bytes: int = 200
    is_folder: bool = False
    package: str = ""

    def open(self) -> Any:
        """Load the function ``encode``."""
        return load_object(self.encode)


class Plugin(NamedTuple):
    """A ``record`` of another ``package``, which is installed in a ``folder``."""

    package: str
    folder: Path
    record: Any


class Plugins(NamedTuple):
    """The records that were found, and a sentence on each entry that gave none."""

    found: tuple[Plugin, ...]
    faults: tuple[str, ...]


def load_object(place: str, folder: str = "") -> Any:
    """Import a module, and return one of its names, as ``place``, ``module:name``, says. A module
    that begins with a dot is in the package ``folder``.
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module, folder or None), name)


@cache
def plugins(group: str, record: type) -> Plugins:
    """Return the records of all packages in a ``group`` of entry points; an entry is a ``record``,
    or a list of them. Packages are searched once for this process.
    """
    found: list[Plugin] = []
    faults: list[str] = []
    for entry in sorted(entry_points(group=group), key=lambda each: (package_of(each), each.name)):
        package = package_of(entry)
        # A package that cannot be loaded must not keep others from their work.
        try:
            loaded = entry.load()
        except LOAD_FAULTS as error:
            faults.append(fault_of(package, f"cannot be loaded ({line_of(error)})"))
            continue
        records = loaded if isinstance(loaded, (list, tuple)) else [loaded]
        if not all(isinstance(each, record) for each in records):
            faults.append(fault_of(package, f"names no {record.__name__} by '{entry.value}'"))
            continue
        folder = Path(str(entry.dist.locate_file(""))) if entry.dist is not None else Path()
        found += [Plugin(package, folder, each) for each in records]
    return Plugins(tuple(found), tuple(faults))


@contextmanager
def blame_plugin(package: str, failed: str, kind: type[IsogiError]) -> Iterator[None]:
    """Turn errors of a plug-in's code in the block into errors of this ``kind``, which name the
    ``package``. ``failed`` is the beginning of the message, such as "'f.brick' cannot be read".

    Errors of isogi and lack of memory pass unchanged. If ``package`` is empty, the code is isogi's,
    and all errors pass.
    """
    try:
        yield
    except (IsogiError, MemoryError):
        raise
    except LOAD_FAULTS as error:
        if not package:
            raise
        raise kind(failure_of(package, failed, line_of(error))) from error


def failure_of(package: str, failed: str, wrong: str) -> str:
    """Return the message that something has ``failed`` in a plug-in, with the reason, ``wrong``,
    and advice.
    """
    return f"{failed} by the plug-in {package} ({wrong}): update that package, or tell its authors."


def package_of(entry: EntryPoint) -> str:
    """Return the name of the package of an entry point, by which it was installed."""
    return entry.dist.name if entry.dist is not None else entry.module


def fault_of(package: str, wrong: str) -> str:
    """Return the message of something ``wrong`` with a plug-in, and advice."""
    return f"The plug-in {package} {wrong}: update or remove that package."
