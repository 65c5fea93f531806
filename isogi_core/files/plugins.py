"""Plug-ins: readers and writers of other packages, found by their entry points.

A package lists records, `Kind`s of files or `Writer`s, under the groups READER_GROUP and
WRITER_GROUP. What cannot be loaded is left out, with a sentence that is said if a file has no
reader.
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
"""What modules of other packages may raise when they are loaded."""


@dataclass(frozen=True)
class Writer:
    """A kind of files that light is written to, told by the ``suffix`` of a file's name.

    ``encode`` is the function ``module:function`` that takes a `LitMesh`, or a `LitVolume` if
    ``of_volume`` is set, and returns the bytes of the file. A vertex of a mesh takes about
    ``vertex_bytes`` of it. The function takes the path too and writes there itself if the kind
    ``is_folder``.
    """

    suffix: str
    encode: str
    of_volume: bool = False
    vertex_bytes: int = 200
    is_folder: bool = False
    package: str = ""

    def open(self) -> Any:
        """Load the function."""
        return named(self.encode)


class Plugin(NamedTuple):
    """A ``record`` of another ``package``, which lies in a ``folder``."""

    package: str
    folder: Path
    record: Any


class Plugins(NamedTuple):
    """Records that were found, and a sentence for each entry that gives none."""

    found: tuple[Plugin, ...]
    faults: tuple[str, ...]


def named(place: str, folder: str = "") -> Any:
    """Load what ``module:name`` names; a module that begins with a dot is in a ``folder``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module, folder or None), name)


@cache
def plugins(group: str, record: type) -> Plugins:
    """Find the records, of one type, of a group of entry points, once for this process."""
    found: list[Plugin] = []
    faults: list[str] = []
    for entry in sorted(entry_points(group=group), key=lambda each: (package_of(each), each.name)):
        package = package_of(entry)
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
def blamed(package: str, what: str, kind: type[IsogiError]) -> Iterator[None]:
    """Raise an error of this ``kind``, which names the ``package``, for whatever goes wrong in the
    code of a plug-in; ``what`` says what cannot be done by it. Errors of isogi pass, and those of a
    lack of memory, and all of isogi's own code, whose package is empty.
    """
    try:
        yield
    except (IsogiError, MemoryError):
        raise
    except LOAD_FAULTS as error:
        if not package:
            raise
        raise kind(failure_of(package, what, line_of(error))) from error


def failure_of(package: str, what: str, wrong: str) -> str:
    """Say ``what`` cannot be done by a plug-in, what went ``wrong``, and what to do."""
    return f"{what} by the plug-in {package} ({wrong}): update that package, or tell its authors."


def package_of(entry: EntryPoint) -> str:
    """Name the package of an entry point as it is installed."""
    return entry.dist.name if entry.dist is not None else entry.module


def fault_of(package: str, wrong: str) -> str:
    """Say what is wrong with a plug-in, and what to do."""
    return f"The plug-in {package} {wrong}: update or remove that package."
