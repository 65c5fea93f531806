"""A plain file server: what published pages are put on."""

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A plain file server that prints nothing; it has ``pages`` besides the folder's."""

    pages: dict[str, bytes]

    def __init__(self, *given: Any, pages: dict[str, bytes], **options: Any) -> None:
        self.pages = pages
        super().__init__(*given, **options)

    def do_GET(self) -> None:
        """Answer with a page, or a file."""
        page = self.pages.get(self.path)
        if page is None:
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, *_: Any) -> None:
        """Print nothing."""


@contextmanager
def shared(folder: Path, pages: dict[str, bytes] | None = None) -> Iterator[str]:
    """The address of a folder on a plain file server, and of ``pages`` by their paths."""
    handler = partial(Quiet, directory=str(folder), pages=pages or {})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()
    thread.join()
