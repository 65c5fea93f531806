"""Locations of Zarr hierarchies: folders of this machine, and URLs."""

import hashlib
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from zarr.abc.store import Store
from zarr.storage import LocalStore, ObjectStore

from isogi_core.errors import VolumeError
from isogi_core.files.scene_file import ZARR_METADATA
from isogi_core.storage.object_store import call_options, retry_options
from isogi_core.storage.url import BUCKET_SCHEMES, SECRET_PARTS, StoreUrl


def stamp_of(files: Iterable[Path]) -> str:
    """Digest (hex) of the ``files``' names, sizes and times of change. Raises OSError where one is missing."""
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        state = path.stat()
        digest.update(f"{path} {state.st_size} {state.st_mtime_ns} {state.st_ctime_ns}\0".encode())
    return digest.hexdigest()


CALL_SECONDS = 30.0
"""Seconds for one call to a URL."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """A hierarchy in a ``store``, the chosen path ``inside`` it, and the display ``name`` of the whole.

    ``stamp`` names the state of its objects; see ``Grid``.
    """

    name: str
    inside: str
    store: Store
    stamp: Callable[[], str]


def hierarchy_at(location: Path | str) -> Hierarchy:
    """The hierarchy that contains a folder or a URL.

    Raises VolumeError where there is none, for links out of the folder, and for URLs that hold a secret.
    """
    if isinstance(location, str):
        return _remote(location)
    root = root_of(location)
    check_links(root)
    inside = location.relative_to(root).as_posix().removeprefix(".")
    return Hierarchy(str(root), inside, LocalStore(root, read_only=True), partial(_stamp_of_folder, root))


def root_of(path: Path) -> Path:
    """The outermost folder of the Zarr hierarchy that contains ``path``."""
    if not path.is_dir():
        raise VolumeError(f"There is no Zarr array '{path}': check the volume's path.")
    if not _is_zarr(path):
        raise VolumeError(f"'{path}' is a folder that holds no Zarr array: give a .zarr folder, or a NRRD file.")
    while _is_zarr(path.parent):
        path = path.parent
    return path


def _is_zarr(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ZARR_METADATA)


def check_links(root: Path) -> None:
    """Raise VolumeError where something below ``root`` is a link out of it."""
    real = root.resolve()
    for folder, folders, files in os.walk(root):
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink() and not path.resolve().is_relative_to(real):
                raise VolumeError(f"'{path}' is a link out of the volume's folder: put a copy in its place.")


def _remote(url: str) -> Hierarchy:
    """The hierarchy at a URL; the part up to ``.zarr`` is its root, where there is one."""
    scheme = url.partition("://")[0].lower()
    if scheme not in BUCKET_SCHEMES or SECRET_PARTS.search(url):
        known = "it must begin with s3://, gs://, az:// or https:// and hold no password or key"
        raise VolumeError(f"The volume's URL cannot be used ({known}): put credentials into the environment.")
    found = re.match(r"(.+\.zarr)(?:/(.*))?$", url.rstrip("/"))
    root, inside = (found[1], found[2] or "") if found else (url.rstrip("/"), "")
    try:
        from obstore import store as stores  # noqa: PLC0415 (an extra)
    except ImportError:
        raise VolumeError(f"'{url}' needs a library that is not installed: pip install 'isogi[s3]'.") from None
    connect: Any = getattr(stores, "from_url")  # noqa: B009 (it has a signature for each scheme)
    store_url = StoreUrl(root, seconds=CALL_SECONDS)
    try:
        store = connect(root, client_options=call_options(store_url), retry_config=retry_options(store_url))
    except Exception as error:  # of many kinds, for what the environment lacks
        reason = type(error).__name__
        raise VolumeError(f"'{url}' cannot be reached ({reason}): check it, and the environment.") from None
    return Hierarchy(root, inside, ObjectStore(store, read_only=True), partial(_stamp_of_objects, root, store))


def _stamp_of_folder(root: Path) -> str:
    """Digest (hex) of all files below ``root``."""
    return stamp_of(sorted(Path(folder) / name for folder, _, names in os.walk(root) for name in names))


def _stamp_of_objects(root: str, store: Any) -> str:
    """Digest (hex) of all objects at a URL; of the metadata alone where they cannot be listed, as over plain HTTP."""
    import obstore  # noqa: PLC0415 (an extra)

    try:
        found = [each for page in obstore.list(store) for each in page]
    except Exception:  # a server that lists nothing
        found = [head for name in ZARR_METADATA if (head := _head(store, name)) is not None]
    facts = sorted(f"{each['path']} {each['size']} {each['e_tag']} {each['last_modified']}" for each in found)
    return hashlib.blake2b("\0".join([root, *facts]).encode(), digest_size=16).hexdigest()


def _head(store: Any, name: str) -> Any:
    """The store's metadata of an object; None where there is none."""
    import obstore  # noqa: PLC0415 (an extra)

    try:
        return obstore.head(store, name)
    except FileNotFoundError:
        return None
