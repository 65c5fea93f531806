"""Viewers: who asks for light, and how the workers' time is shared between them."""

from collections.abc import Collection, Hashable
from dataclasses import dataclass, field

FIRST_TASK = 0.1
"""Processor seconds that a task is taken to need before any has ended."""

MEMORY = 0.9
"""How much of the usual length of a task stays when one more has ended."""


@dataclass(frozen=True)
class Viewer:
    """One ``visit`` of a ``client``: what it was the last to ask for is dropped when it leaves.

    Clients share the workers evenly. A ``single`` viewer shows one view at a time: its newest replaces what the older
    ones wanted; else wants add up until they are forgotten. A ``patient`` one yields to all that are not.
    """

    client: Hashable = ""
    visit: int = 0
    single: bool = False
    patient: bool = False


GUEST = Viewer()
"""Somebody who looks once, and whom nobody else has to be told from."""


@dataclass(eq=False)
class Shares:
    """Fair shares of the workers: whoever was ``served`` fewest processor seconds is next (start-time fair queueing).

    Who begins to wait starts level with who is served now: time in which nothing was asked for saves nothing up.
    """

    served: dict[Hashable, float] = field(default_factory=dict)
    level: float = 0.0
    usual: float = FIRST_TASK

    def turns(self, waiting: Collection[Hashable]) -> list[Hashable]:
        """The clients that wait in the order of their turns; on a tie they keep theirs."""
        kept = {client: seconds for client, seconds in self.served.items() if seconds > self.level}
        self.served = kept | {client: kept.get(client, self.level) for client in waiting}
        return sorted(waiting, key=self.served.__getitem__)

    def begin(self, first: Hashable, clients: Collection[Hashable]) -> float:
        """A task for these clients begins, in the turn of the ``first``; returns what they are charged meanwhile."""
        self.level = self.served[first]
        self._charge(clients, self.usual)
        return self.usual

    def end(self, clients: Collection[Hashable], charged: float, seconds: float) -> None:
        """A task has ended that took so many ``seconds``: put right what they were ``charged`` when it began."""
        self._charge(clients, seconds - charged)
        self.usual = MEMORY * self.usual + (1.0 - MEMORY) * seconds

    def _charge(self, clients: Collection[Hashable], seconds: float) -> None:
        """Each of the clients pays an even part."""
        for client in clients:
            self.served[client] = self.served.get(client, self.level) + seconds / len(clients)
