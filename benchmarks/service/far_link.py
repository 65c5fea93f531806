"""A link to a server that is far away: each byte takes its time, and all connections share the way
back.
"""

import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

PIECE = 1460
"""Bytes that are passed on at a time: what a packet holds."""


@dataclass
class FarLink:
    """A way to ``target``, a host and a port, with so many bytes a ``rate``, in bytes a second, and
    a round ``trip``, in seconds. ``down`` counts bytes that came from the server.
    """

    target: tuple[str, int]
    rate: float
    trip: float
    down: int = 0
    free: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def due(self, size: int) -> float:
        """When the last of ``size`` bytes from the server arrives: after those before it."""
        with self.lock:
            self.down += size
            self.free = max(self.free, time.monotonic()) + size / self.rate
            return self.free + 0.5 * self.trip

    def arrival(self, _size: int) -> float:
        """When bytes arrive that are sent to the server now."""
        return time.monotonic() + 0.5 * self.trip

    def serve(self, client: socket.socket) -> None:
        """Pass on what a connection brings, both ways, until either side ends."""
        time.sleep(self.trip)  # the handshake of TCP
        with client, suppress(OSError), socket.create_connection(self.target) as server:
            up = threading.Thread(target=self.carry, args=(client, server, self.arrival))
            up.start()
            self.carry(server, client, self.due)
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
            up.join()

    def carry(
        self, source: socket.socket, sink: socket.socket, due: Callable[[int], float]
    ) -> None:
        """Pass on what comes from a socket, each piece when it is due."""
        waiting: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()

        def deliver() -> None:
            while data := (piece := waiting.get())[1]:
                time.sleep(max(piece[0] - time.monotonic(), 0.0))
                with suppress(OSError):
                    sink.sendall(data)
            with suppress(OSError):
                sink.shutdown(socket.SHUT_WR)

        thread = threading.Thread(target=deliver)
        thread.start()
        with suppress(OSError):
            while data := source.recv(PIECE):
                waiting.put((due(len(data)), data))
        waiting.put((0.0, b""))
        thread.join()


@contextmanager
def far_link(target: tuple[str, int], rate: float, trip: float) -> Iterator[tuple[str, FarLink]]:
    """The address of a far link while the block runs, and what it counts."""
    link = FarLink(target, rate, trip)
    listener = socket.create_server(("127.0.0.1", 0))

    def accept() -> None:
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                threading.Thread(target=link.serve, args=(client,), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}", link
    finally:
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()
