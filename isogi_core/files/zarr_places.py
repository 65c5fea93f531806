"""Places of Zarr hierarchies: folders of this machine, and URLs that a person names."""

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from zarr.abc.store import Store
from zarr.storage import LocalStore, ObjectStore

from isogi_core.cache.bucket import calls, retries
from isogi_core.cache.place import BUCKETS, SECRET, Place
from isogi_core.errors import VolumeError
from isogi_core.files.stamps import stamp_of

METADATA = ("zarr.json", ".zgroup", ".zarray", ".zattrs")
"""Files some of which every Zarr group and array has."""

SECONDS = 30.0
"""Time for one call to a URL."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """A hierarchy in a ``store``, and the path ``inside`` it that is meant; ``name`` is the whole, for a person.

    ``stamp`` names the state that its objects are in; see ``Grid``.
    """

    name: str
    inside: str
    store: Store
    stamp: Callable[[], str]


def hierarchy_at(place: Path | str) -> Hierarchy:
    """The hierarchy that a folder, or a URL, is in.

    Raises VolumeError where there is none, for links that lead out of the folder, and for URLs that hold a secret.
    """
    if isinstance(place, str):
        return _remote(place)
    root = root_of(place)
    check_links(root)
    inside = place.relative_to(root).as_posix().removeprefix(".")
    return Hierarchy(str(root), inside, LocalStore(root, read_only=True), partial(_stamp_of_folder, root))


def root_of(path: Path) -> Path:
    """The outermost folder of the Zarr hierarchy that ``path`` is in."""
    if not path.is_dir():
        raise VolumeError(f"There is no Zarr array '{path}': check the volume's path.")
    if not _is_zarr(path):
        raise VolumeError(f"'{path}' is a folder that holds no Zarr array: give a .zarr folder, or a NRRD file.")
    while _is_zarr(path.parent):
        path = path.parent
    return path


def _is_zarr(folder: Path) -> bool:
    return any((folder / name).is_file() for name in METADATA)


def check_links(root: Path) -> None:
    """VolumeError where something below ``root`` is a link that leads out of it."""
    real = root.resolve()
    for folder, folders, files in os.walk(root):
        for name in (*folders, *files):
            place = Path(folder) / name
            if place.is_symlink() and not place.resolve().is_relative_to(real):
                raise VolumeError(f"'{place}' is a link out of the volume's folder: put a copy in its place.")


def _remote(url: str) -> Hierarchy:
    """The hierarchy at a URL: what ends in ``.zarr`` is its root, where anything does."""
    scheme = url.partition("://")[0].lower()
    if scheme not in BUCKETS or SECRET.search(url):
        known = "it must begin with s3://, gs://, az:// or https:// and hold no password or key"
        raise VolumeError(f"The volume's URL cannot be used ({known}): put credentials into the environment.")
    found = re.match(r"(.+\.zarr)(?:/(.*))?$", url.rstrip("/"))
    root, inside = (found[1], found[2] or "") if found else (url.rstrip("/"), "")
    try:
        from obstore import store as stores  # noqa: PLC0415 (an extra)
    except ImportError:
        raise VolumeError(f"'{url}' needs a library that is not installed: pip install 'isogi[s3]'.") from None
    connect: Any = getattr(stores, "from_url")  # noqa: B009 (it has a signature for each scheme)
    place = Place(root, seconds=SECONDS)
    try:
        store = connect(root, client_options=calls(place), retry_config=retries(place))
    except Exception as error:  # what the environment lacks is told in many ways
        told = type(error).__name__
        raise VolumeError(f"'{url}' cannot be reached ({told}): check it, and the environment.") from None
    return Hierarchy(root, inside, ObjectStore(store, read_only=True), partial(_stamp_of_objects, root, store))


def _stamp_of_folder(root: Path) -> str:
    """Hex name of all files below ``root``."""
    return stamp_of(sorted(Path(folder) / name for folder, _, names in os.walk(root) for name in names))


def _stamp_of_objects(root: str, store: Any) -> str:
    """Hex name of all objects at a URL; of the metadata alone where they cannot be listed, as over plain HTTP."""
    import obstore  # noqa: PLC0415 (an extra)

    try:
        found = [each for page in obstore.list(store) for each in page]
    except Exception:  # a server that lists nothing
        found = [head for name in METADATA if (head := _head(store, name)) is not None]
    told = sorted(f"{each['path']} {each['size']} {each['e_tag']} {each['last_modified']}" for each in found)
    return hashlib.blake2b("\0".join([root, *told]).encode(), digest_size=16).hexdigest()


def _head(store: Any, name: str) -> Any:
    """What a store tells of an object; None where it has none such."""
    import obstore  # noqa: PLC0415 (an extra)

    try:
        return obstore.head(store, name)
    except FileNotFoundError:
        return None
