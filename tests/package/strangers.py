"""A package of a stranger with a reader and a writer, and packages that are broken."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files import plugins
from isogi_core.files.formats import kinds
from isogi_server.exports import lit_files

STRANGER = Path(__file__).parent / "stranger"
"""The folder of a package as it lies when it is installed."""


def forget() -> None:
    """Have entry points looked for once more."""
    for found in (plugins.plugins, kinds.added_kinds, lit_files.writers):
        found.cache_clear()


@contextmanager
def installed(*folders: Path) -> Iterator[None]:
    """Have Python find the packages in some folders."""
    with pytest.MonkeyPatch.context() as patch:
        for folder in folders:
            patch.syspath_prepend(str(folder))
        forget()
        yield
    forget()


def write_package(folder: Path, name: str, code: str, group: str, value: str) -> Path:
    """Write a package of one module and one entry point into a folder of its own."""
    place = folder / name
    metadata = place / f"{name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (place / f"{name}.py").write_text(code)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[{group}]\nit = {value}\n")
    return place


def ball(n: int = 16) -> np.ndarray:
    """Bytes that fall from the middle, (n, n, n)."""
    z, y, x = np.mgrid[:n, :n, :n] - (n - 1) / 2
    return np.clip(250.0 - 25.0 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)


def brick(values: np.ndarray, spacing: tuple[float, float, float] = (1.0, 1.0, 2.0)) -> bytes:
    """A file of the stranger's kind."""
    z, y, x = values.shape
    words = " ".join(map(str, (x, y, z, *spacing)))
    return f"BRICK1 {words}\n".encode() + values.tobytes()
