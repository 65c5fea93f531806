"""Connections of streams, over uvicorn's own: what a client breaks there is no error of the server's."""

from typing import Any

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

NO_TEXT = 1007
"""The code that a stream is closed with whose text is no UTF-8 (RFC 6455, 7.4)."""


UNREADABLE = b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class StreamConnection(WebSocketsSansIOProtocol):
    """A stream's connection that leaves nothing in the log for what its client sends, or for being refused."""

    def data_received(self, data: bytes) -> None:
        """Read; refuse a handshake that cannot be read, such as one with too many headers, and close."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_initiated:
            self.handshake_initiated = self.close_sent = True
            self.transport.write(UNREADABLE)
            self.transport.close()

    async def send(self, message: Any) -> None:
        """Send a message; with the end of a refusal the handshake is complete."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body", False):
            self.handshake_complete = True

    def send_receive_event_to_app(self) -> None:
        """Hand over a whole message; close where its text is no UTF-8."""
        if self.curr_msg_data_type == "text" and not is_text(b"".join(self.frames)):
            self.conn.send_close(NO_TEXT)
            self.handle_parser_exception()
            return
        super().send_receive_event_to_app()


def is_text(data: bytes) -> bool:
    """Whether these bytes are UTF-8."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True
