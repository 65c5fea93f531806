"""Gates: so many of a kind at once, and the next is told to come back."""

from collections.abc import Iterator
from contextlib import contextmanager

from server.errors import BusyError


class Gate:
    """Lets ``most`` through at once; ``what`` names them in the sentence for those that are too many."""

    def __init__(self, most: int, what: str) -> None:
        self.most, self.what = most, what
        self.open = 0

    @contextmanager
    def admitted(self) -> Iterator[None]:
        """Around one of them. Raises BusyError where as many are inside as may be."""
        if self.open >= self.most:
            raise BusyError(f"{self.open} {self.what} already: ask again in a second.")
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
