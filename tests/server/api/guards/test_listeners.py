"""A listener that comes to its end resets nobody that waits for it."""

import socket

from server.cli.serve import queued


def test_connections_that_wait_are_taken_before_the_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        waiting = [socket.create_connection(listener.getsockname()) for _ in range(3)]
        listener.setblocking(False)
        last = list(queued(listener))
        listener.close()
        for client, accepted in zip(waiting, last, strict=True):
            with client, accepted:
                accepted.sendall(b"welcome")
                assert client.recv(16) == b"welcome"
