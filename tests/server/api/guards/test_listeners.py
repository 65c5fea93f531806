"""A listener that comes to its end resets nobody."""

import errno
import socket
import sys
import threading
import time

import pytest

from server.api.connections import keep_newcomers_out, queued

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="packet filters are Linux's")


def test_newcomers_are_kept_out_and_the_queued_are_let_in() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as early:
        listener.setblocking(False)
        keep_newcomers_out(listener)
        with socket.socket() as late:
            late.settimeout(0.2)
            with pytest.raises(TimeoutError):
                late.connect(listener.getsockname())
        (last,) = queued(listener)
        listener.close()
        with last:
            last.sendall(b"welcome")
        assert early.recv(16) == b"welcome"


def test_who_is_kept_out_finds_the_port_closed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        keep_newcomers_out(listener)
        closing = threading.Timer(0.2, listener.close)
        closing.start()
        begun = time.monotonic()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(listener.getsockname(), 10)
        assert time.monotonic() - begun > 0.2
        closing.join()


def test_a_handshake_that_had_begun_comes_to_its_end() -> None:
    """Its last segment asks for nothing: the filter lets it pass, and data after it."""
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.socket() as client:
        client.setblocking(False)
        assert client.connect_ex(listener.getsockname()) in (0, errno.EINPROGRESS)
        keep_newcomers_out(listener)
        client.settimeout(5)
        client.sendall(b"hello")
        with listener.accept()[0] as accepted:
            assert accepted.recv(16) == b"hello"
