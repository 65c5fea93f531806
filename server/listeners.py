"""Listening sockets that come to their end without a connection being reset.

A listener that is closed resets what has connected and was not accepted yet. Looking for such before it is closed
leaves a moment in which one more may come; so newcomers are kept out first, and the last are let in then.
"""

import ctypes
import socket
import struct
import sys
from collections.abc import Iterator

HANDSHAKE = 0.1
"""Seconds within which a handshake ends that had begun when newcomers were kept out."""

SO_ATTACH_FILTER = 26
LOAD_BYTE, JUMP_IF_SET, RETURN = 0x30, 0x45, 0x06
FLAGS, SYN = 13, 0x02
"""The byte of a TCP segment that holds its flags, and the one that asks for a connection."""

NEWCOMERS_DROPPED = ((LOAD_BYTE, 0, 0, FLAGS), (JUMP_IF_SET, 0, 1, SYN), (RETURN, 0, 0, 0), (RETURN, 0, 0, 0xFFFFFFFF))
"""A classic packet filter (code, jump if true, jump if false, value): drops what asks for a connection."""


def keep_newcomers_out(listener: socket.socket) -> None:
    """Accept no connections but those whose handshake has begun; who comes later asks again within a second.

    That finds the port closed then, or the next server at it. Does nothing on systems other than Linux.
    """
    if sys.platform != "linux":
        return
    steps = b"".join(struct.pack("HBBI", *step) for step in NEWCOMERS_DROPPED)
    code = ctypes.create_string_buffer(steps, len(steps))
    listener.setsockopt(
        socket.SOL_SOCKET, SO_ATTACH_FILTER, struct.pack("HP", len(NEWCOMERS_DROPPED), ctypes.addressof(code))
    )


def queued(listener: socket.socket) -> Iterator[socket.socket]:
    """Connections that wait to be accepted: they would be reset when the listener is closed."""
    while True:
        try:
            yield listener.accept()[0]
        except OSError:
            return
