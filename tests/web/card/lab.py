"""A page with a card to test: Chromium's WebGL 2 in software, and a server of the page's files and of data."""

import http.server
import json
import threading
from base64 import b64decode, b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from playwright.sync_api import Browser, Page

WEB = Path(__file__).resolve().parents[3] / "web"
HERE = Path(__file__).resolve().parent
CARD_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SECONDS = 300


class Lab:
    """A page whose scripts are those of ``web``, and files of ``data`` that it may fetch as ``/data/NAME``."""

    def __init__(self, page: Page, address: str, data: dict[str, bytes]) -> None:
        self.page, self.data = page, data
        page.set_default_timeout(1000 * SECONDS)
        page.goto(address)
        page.evaluate("import('/bench/bench.js').then((bench) => { window.bench = bench; })")

    def ask(self, script: str, argument: Any = None) -> Any:
        """What an expression in the page is; it may wait, and has ``bench``."""
        return self.page.evaluate(f"async (given) => {{ {script} }}", argument)

    def floats(self, script: str, argument: Any = None) -> np.ndarray:
        """Float32 numbers that a script returns as text."""
        return np.frombuffer(b64decode(self.ask(script, argument)), np.float32)

    def put(self, name: str, content: bytes | dict[str, Any]) -> str:
        """Let the page fetch a file of this name."""
        self.data[name] = content if isinstance(content, bytes) else json.dumps(content).encode()
        return name


def packed(numbers: np.ndarray) -> str:
    """Float32 numbers as text, on their way to the page."""
    return b64encode(np.ascontiguousarray(numbers, np.float32).tobytes()).decode()


@contextmanager
def served(data: dict[str, bytes]) -> Iterator[str]:
    """The address of a server of the page's files, of this folder's, and of ``data``."""

    class Handler(http.server.BaseHTTPRequestHandler):
        KINDS: ClassVar[dict[str, str]] = {".js": "text/javascript", ".html": "text/html", ".glsl": "text/plain"}

        def do_GET(self) -> None:
            room, _, name = self.path.split("?")[0].lstrip("/").partition("/")
            content = data.get(name) if room == "data" else self.file(room, name)
            self.send_response(200 if content is not None else 404)
            self.send_header("Content-Type", self.KINDS.get(Path(self.path).suffix, "application/octet-stream"))
            self.end_headers()
            self.wfile.write(content or b"")

        def file(self, room: str, name: str) -> bytes | None:
            if room in ("x.html", "favicon.ico"):
                return b""
            path = {"web": WEB, "bench": HERE}[room] / name
            return path.read_bytes() if path.is_file() else None

        def log_message(self, *_: Any) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/x.html"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextmanager
def lab_in(browser: Browser) -> Iterator[Lab]:
    """A lab in a page of its own, whose console must stay free of errors."""
    complaints: list[str] = []
    data: dict[str, bytes] = {}
    with served(data) as address:
        page = browser.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
        yield Lab(page, address, data)
        page.close()
    assert complaints == []
