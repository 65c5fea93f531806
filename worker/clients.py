"""Clients of Dask's scheduler, which whoever made them closes."""

from contextlib import suppress

from distributed import Client, LocalCluster

SOON = 1.0
"""Seconds that closing may take of one that could not be made."""


class OwnClient(Client):
    """A client that the garbage collector never closes.

    Dask's own does so, for which it takes a lock; and where the collector comes while the same thread makes a client
    or a cluster, and holds that lock, it waits for ever. One that finds no scheduler is such garbage.
    """

    def __init__(self, address: "str | LocalCluster | None", timeout: str) -> None:
        """Join a scheduler by its address, or a cluster; OSError where none is found within the ``timeout``."""
        try:
            super().__init__(address, timeout=timeout, set_as_default=False)  # type: ignore[no-untyped-call]
        except BaseException:
            with suppress(Exception):
                self.close(timeout=SOON)  # type: ignore[no-untyped-call]
            raise

    def __del__(self) -> None:
        """Close nothing."""
