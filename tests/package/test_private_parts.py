"""Private parts of libraries that isogi uses: each library has an upper bound in pyproject.toml,
and a row here that says what to look at before the bound is raised.
"""

import importlib
import tomllib
from typing import NamedTuple

import pytest

from tests.package.imports import ROOT, imports_of_product


class Private(NamedTuple):
    """The bound of a library whose parts were read, the modules of it that are no public API, other
    private names that are used, and what to run with a new version.
    """

    bound: str
    modules: tuple[str, ...]
    names: tuple[str, ...]
    look_at: str


LIBRARIES = {
    "numba": Private(
        "0.69",
        ("numba.core", "numba.np"),
        (
            "numba.core.codegen:JITCodeLibrary._finalize_dynamic_globals",
            "numba.core.codegen:JITCodeLibrary._optimize_final_module",
            "numba.core.codegen:JITCodeLibrary._verify_declare_only_symbols",
            "numba.core.compiler:CompilerBase.define_pipelines",
            "numba.core.typed_passes:NopythonTypeInference",
        ),
        "isogi_core/kernels/_compiler.py, _jit.py and simd/llvm.py; run tests/kernels, "
        "tests.kernels.transport.path_bytes and `python -m benchmarks.speed paths`",
    ),
    "uvicorn": Private(
        "0.55",
        ("uvicorn.protocols", "uvicorn.server"),
        (
            "uvicorn.protocols.http.h11_impl:H11Protocol.data_received",
            "uvicorn.protocols.http.h11_impl:H11Protocol.handle_websocket_upgrade",
            "uvicorn.protocols.http.h11_impl:H11Protocol.on_response_complete",
            "uvicorn.protocols.http.h11_impl:H11Protocol.send_400_response",
            "uvicorn.protocols.websockets.websockets_sansio_impl:"
            "WebSocketsSansIOProtocol.keepalive_timeout",
            "uvicorn.protocols.websockets.websockets_sansio_impl:"
            "WebSocketsSansIOProtocol.send_receive_event_to_app",
            "uvicorn.server:Server.shutdown",
        ),
        "api/connections.py and cli/serve.py in server/isogi_server; run tests/server/api/guards",
    ),
    "zarr": Private(
        "3.5",
        ("zarr.core", "zarr.storage._common"),
        (
            "zarr.core.buffer:default_buffer_prototype",
            "zarr.core.sync:sync",
            "zarr.storage._common:make_store",
        ),
        "isogi_core/storage/folder.py and store.py; run tests/storage, tests/cache and "
        "tests/files/test_zarr_volume.py",
    ),
}


@pytest.mark.parametrize("library", LIBRARIES)
def test_who_raises_a_bound_reads_what_is_private(library: str) -> None:
    known = LIBRARIES[library]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (given,) = [each for each in project["dependencies"] if each.startswith(f"{library}>")]
    assert given.endswith(f",<{known.bound}"), (
        f"{given}: {library} was read below {known.bound}. Look at {known.look_at}. "
        f"Then write the new bound into this table."
    )


@pytest.mark.parametrize("library", LIBRARIES)
def test_private_names_are_there(library: str) -> None:
    for name in LIBRARIES[library].names:
        module, _, path = name.partition(":")
        found = importlib.import_module(module)
        for part in path.split("."):
            assert hasattr(found, part), f"{name} is gone: look at {LIBRARIES[library].look_at}"
            found = getattr(found, part)


def is_private(module: str) -> bool:
    """Whether a part of a module's name begins with an underscore."""
    return any(part.startswith("_") for part in module.split("."))


def test_other_libraries_are_used_by_public_modules_alone() -> None:
    allowed = tuple(module for each in LIBRARIES.values() for module in each.modules)
    others = {each for _, each in imports_of_product() if not each.startswith("isogi")}
    found = {each for each in others if is_private(each)}
    assert {each for each in found if not each.startswith((*allowed, "__future__"))} == set()
