"""The one place that owns Numba's options and the folder of compiled kernels.

Numba's own cache looks at the file of a function alone: an edit of a helper in another file leaves
old machine code in use. Here the folder is named after a digest of all kernel sources, of Numba's
version and of the processor, so that what is loaded is always what is written.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import njit, types

# Not the whole of fastmath: `nnan` would make isnan() False, and the kernels ask.
FASTMATH = {"nsz", "contract"}
EXACT = {"nsz"}
ANY_ORDER = FASTMATH | {"reassoc"}


def sources_digest() -> str:
    """Digest of every kernel source, Numba's version and the processor's name and features, as hex."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    cpu = numba.config.CPU_NAME or llvm.get_host_cpu_name()
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    digest.update(f"{numba.__version__} {cpu} {features}".encode())
    return digest.hexdigest()


def cache_folder() -> Path:
    """Where compiled kernels are kept: ``$ISOGI_KERNEL_CACHE`` or the user's cache folder."""
    root = os.environ.get("ISOGI_KERNEL_CACHE")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (Path(root) if root else base / "isogi" / "kernels") / sources_digest()


numba.config.CACHE_DIR = str(cache_folder())


def kernel(
    signature: Any = None, exact: bool = False, any_order: bool = False, inline: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with the house's options.

    Without a signature the function is a helper, compiled where it is called; with one it is an
    entry kernel, compiled (or loaded) when its module is imported, and only for these types. What is
    ``exact`` gives the same bits wherever it is inlined: no product is fused with a sum. Sums in
    ``any_order`` fill vectors: their bits belong to the processor, and to nothing else. What is
    ``inline`` becomes part of its callers however long it is.
    """
    fastmath = EXACT if exact else ANY_ORDER if any_order else FASTMATH
    options = {"nogil": True, "error_model": "numpy", "fastmath": fastmath}
    if signature is None:
        return njit(forceinline=inline, **options)
    return njit(signature, cache=True, **options)


def record(cls: type, *members: Any) -> Any:
    """Numba's type of the NamedTuple ``cls`` whose members have the types ``members``."""
    return types.BaseTuple.from_types(members, cls)
