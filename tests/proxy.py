"""A way to a server that delays, drops and resets: what networks do between a program and an object
store.
"""

import random
import select
import socket
import struct
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Literal

Harm = Literal["pass", "delay", "drop", "reset", "cut", "silence"]
"""What becomes of an answer: it passes; each piece of it comes later; the connection ends before
it, in order or by a reset, or in the middle of it; or nothing of it ever comes. The request has
arrived, and is done."""

PIECE = 1 << 14
"""Bytes that are passed on at a time, at most."""

LINGER_NOT = struct.pack("ii", 1, 0)
"""Makes a socket that is closed send a reset."""


class Proxy:
    """A proxy to ``target``, a host and a port, while the ``with`` block runs; its own ``address``
    is alike.

    Each answer suffers one of the ``harms``, which may be changed at any time, by chance of a
    ``seed``. ``delay`` is in seconds. ``suffered`` lists what became of each.
    """

    def __init__(self, target: tuple[str, int], seed: int = 0, delay: float = 0.05) -> None:
        self.harms: tuple[Harm, ...] = ("pass",)
        self.suffered: list[Harm] = []
        self._target = target
        self._random = random.Random(seed)
        self._delay = delay
        self._closing = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._accept, daemon=True)

    def __enter__(self) -> "Proxy":
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._closing.set()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    @property
    def address(self) -> str:
        """Where it listens, as a URL."""
        host, port = self._listener.getsockname()
        return f"http://{host}:{port}"

    def _accept(self) -> None:
        with suppress(OSError):
            while not self._closing.is_set():
                client, _ = self._listener.accept()
                threading.Thread(
                    target=self._serve, args=[client], name="proxy", daemon=True
                ).start()

    def _serve(self, client: socket.socket) -> None:
        """Pass on requests, and their answers as far as harm leaves them, until either side
        ends.
        """
        harm: Harm | None = None
        with client, suppress(OSError), socket.create_connection(self._target) as server:
            while not self._closing.is_set():
                ready, _, _ = select.select([client, server], [], [], 1.0)
                data = ready[0].recv(PIECE) if ready else None
                if data == b"":
                    return
                if data and ready[0] is client:
                    server.sendall(data)
                    harm = None
                elif data:
                    harm = harm or self._choose()
                    if not self._answer(client, data, harm):
                        return

    def _choose(self) -> Harm:
        """What the next answer suffers."""
        harm = self._random.choice(self.harms)
        self.suffered.append(harm)
        return harm

    def _answer(self, client: socket.socket, data: bytes, harm: Harm) -> bool:
        """Pass a piece of an answer on, or what the harm leaves of it; whether the connection goes
        on.
        """
        if harm == "delay":
            time.sleep(self._delay)
        elif harm == "silence":
            self._closing.wait()
        elif harm == "cut":
            client.sendall(data[: len(data) // 2])
        elif harm == "reset":
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_NOT)
        if going := harm in ("pass", "delay"):
            client.sendall(data)
        return going
