"""Fair turns: of all that wait, the client that was served least is next (start-time fair queueing).

P. Goyal, H. M. Vin, H. Cheng: Start-time Fair Queuing, SIGCOMM 1996. Workers share their processor seconds by it, and
clients of the server the threads that render.
"""

import math
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field

FIRST_TASK_SECONDS = 0.1
"""Processor seconds that a task is assumed to need before any has ended."""

PAST_TASKS_WEIGHT = 0.9
"""Weight of the past in the running mean of a task's length."""


@dataclass(eq=False)
class Account:
    """The seconds ``spent`` on one client, over its ``weight``, on a queue's own clock."""

    weight: float = 1.0
    spent: float = 0.0


@dataclass(eq=False)
class FairClock:
    """The clock of a queue: it is at the turn of the client that was served last.

    A client saves nothing up while it asks for nothing, and is at most ``debt`` seconds ahead of the clock for the
    work that it had done: nobody waits longer than this for the past.
    """

    debt: float = math.inf
    now: float = 0.0

    def join(self, account: Account) -> None:
        """Let a client that begins to wait start level with the one that is served now."""
        account.spent = max(account.spent, self.now)

    def serve(self, turn: float) -> None:
        """Begin work whose client had spent so much (``turn``) when it was chosen."""
        self.now = max(self.now, turn)

    def charge(self, account: Account, seconds: float) -> None:
        """Charge a client with seconds of work, or give some back."""
        account.spent = min(account.spent + seconds / account.weight, self.now + self.debt)

    def is_ahead(self, account: Account) -> bool:
        """Whether a client was served more than the one that is served now."""
        return account.spent > self.now


@dataclass(eq=False)
class Shares:
    """Fair shares of the workers: the ``accounts`` of clients, and processor seconds that a task ``usual``-ly takes."""

    accounts: dict[Hashable, Account] = field(default_factory=dict)
    clock: FairClock = field(default_factory=FairClock)
    usual: float = FIRST_TASK_SECONDS

    def turns(self, waiting: Collection[Hashable]) -> list[Hashable]:
        """Sort waiting clients by the processor seconds they were served; ties keep their order."""
        self.accounts = {client: each for client, each in self.accounts.items() if self.clock.is_ahead(each)}
        return sorted(waiting, key=lambda client: self._account(client).spent)

    def begin(self, first: Hashable, clients: Collection[Hashable]) -> float:
        """Begin a task for these clients, in the turn of the ``first``; returns the seconds charged in advance."""
        self.clock.serve(self._account(first).spent)
        self._charge(clients, self.usual)
        return self.usual

    def end(self, clients: Collection[Hashable], charged: float, seconds: float) -> None:
        """End a task that took so many ``seconds``: correct what the clients were ``charged`` when it began."""
        self._charge(clients, seconds - charged)
        self.usual = PAST_TASKS_WEIGHT * self.usual + (1.0 - PAST_TASKS_WEIGHT) * seconds

    def _account(self, client: Hashable) -> Account:
        """The account of a client; one without an account begins level with the client that is served now."""
        if client not in self.accounts:
            self.accounts[client] = Account(spent=self.clock.now)
        return self.accounts[client]

    def _charge(self, clients: Collection[Hashable], seconds: float) -> None:
        """Charge each of the clients an even part."""
        for client in clients:
            self.clock.charge(self._account(client), seconds / len(clients))
