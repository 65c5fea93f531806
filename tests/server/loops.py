"""An event loop whose time passes while it has nothing to do, and only then: sleeps take none, and
never too long.
"""

import asyncio
import selectors

import pytest


class Jumping(selectors.DefaultSelector):
    """Goes on to the next timer at once."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """What is ready; the ``timeout`` passes where nothing else is to be done before."""
        self.now += timeout or 0.0
        return super().select(None if timeout is None else 0)


class IdleLoop(asyncio.SelectorEventLoop):
    """The loop; it is no use where threads work, for they take time that it does not know of."""

    def __init__(self) -> None:
        self._jumping = Jumping()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Seconds since the loop was made."""
        return self._jumping.now


IN_NO_TIME = pytest.mark.parametrize(
    "anyio_backend", [("asyncio", {"loop_factory": IdleLoop})], ids=["in no time"]
)
"""Has a coroutine that is a test run in such a loop."""
