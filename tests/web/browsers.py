"""Chromium, Firefox and WebKitGTK, driven alike: by Playwright, by WebDriver BiDi, by WebDriver.

Each draws WebGL in software, and has a window of its own in Xvfb where it needs one.
"""

import io
import json
import os
import re
import shutil
import subprocess
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from base64 import b64decode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from PIL import Image
from playwright.sync_api import Browser
from websockets.sync.client import ClientConnection, connect

Place = tuple[float, float]
Size = tuple[int, int]

SHIFT = "\ue008"
START_SECONDS = 120.0
COMMAND_SECONDS = 240.0
PAUSE_MS = 40
"""Between two moves of a drag."""

PROGRAMS = {
    "firefox": ("firefox-esr", "firefox"),
    "webkit": ("WebKitWebDriver",),
    "xvfb": ("Xvfb",),
}
MINI_BROWSERS = ("libexec/webkit2gtk-4.1/MiniBrowser", "lib*/*/webkit2gtk-4.1/MiniBrowser")
"""Where packages put the window that WebKitGTK's driver opens, below /usr."""

PREFERENCES: dict[str, bool | int | str] = {
    "app.update.enabled": False,
    "browser.aboutwelcome.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.safebrowsing.malware.enabled": False,
    "browser.safebrowsing.phishing.enabled": False,
    "browser.sessionstore.resume_from_crash": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "remote.active-protocols": 1,
    "services.settings.server": "data:,x",
    "toolkit.telemetry.reportingpolicy.firstRun": False,
    "webgl.force-enabled": True,
}
"""Settings of Firefox: it asks nothing of the network, and draws WebGL by its processor."""

CALLED = """(async () => JSON.stringify([await ({code})]))()"""


class Driven(ABC):
    """A browser with one tab."""

    @abstractmethod
    def goto(self, url: str) -> None:
        """Begin to load a page."""

    @abstractmethod
    def js(self, code: str) -> Any:
        """The value of an expression in the page."""

    @abstractmethod
    def shot(self) -> np.ndarray:
        """What the window shows, (h, w, 3) uint8."""

    @abstractmethod
    def resize(self, size: Size) -> None:
        """Give the page's window another size inside."""

    @abstractmethod
    def act(self, kind: str, actions: Sequence[dict[str, Any]]) -> None:
        """Perform actions of a ``key`` or a ``pointer``, as WebDriver has them."""

    def drag(self, places: Sequence[Place], shift: bool = False, release: bool = True) -> None:
        """Press at the first place, move through all of them, and let go."""
        if shift:
            self.act("key", [{"type": "keyDown", "value": SHIFT}])
        first, *others = [
            {"type": "pointerMove", "x": round(x), "y": round(y), "duration": 0} for x, y in places
        ]
        actions = [first, {"type": "pointerDown", "button": 0}]
        for each in others:
            actions += [each, {"type": "pause", "duration": PAUSE_MS}]
        if release:
            actions.append({"type": "pointerUp", "button": 0})
        self.act("pointer", actions)
        if shift:
            self.act("key", [{"type": "keyUp", "value": SHIFT}])

    def release(self) -> None:
        """Let the pointer go."""
        self.act("pointer", [{"type": "pointerUp", "button": 0}])

    def until(self, code: str, seconds: float = COMMAND_SECONDS) -> Any:
        """The value of an expression once it is true. Raises TimeoutError."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            # A page that is being loaded has no answer yet.
            with suppress(RuntimeError):
                if value := self.js(code):
                    return value
            time.sleep(0.1)
        raise TimeoutError(f"{code} was not true within {seconds} s")


class Chromium(Driven):
    """Chromium, by Playwright."""

    def __init__(self, browser: Browser, size: Size) -> None:
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.set_default_timeout(1000 * COMMAND_SECONDS)

    def goto(self, url: str) -> None:
        self.page.goto(url, wait_until="commit")

    def js(self, code: str) -> Any:
        from playwright.sync_api import Error

        try:
            return self.page.evaluate(code)
        except Error as error:
            raise RuntimeError(str(error)) from None

    def shot(self) -> np.ndarray:
        return decoded(self.page.screenshot())

    def resize(self, size: Size) -> None:
        self.page.set_viewport_size({"width": size[0], "height": size[1]})

    def act(self, kind: str, actions: Sequence[dict[str, Any]]) -> None:
        mouse = self.page.mouse
        does: dict[str, Callable[[dict[str, Any]], None]] = {
            "keyDown": lambda _: self.page.keyboard.down("Shift"),
            "keyUp": lambda _: self.page.keyboard.up("Shift"),
            "pointerMove": lambda action: mouse.move(action["x"], action["y"]),
            "pointerDown": lambda _: mouse.down(),
            "pointerUp": lambda _: mouse.up(),
            "pause": lambda action: time.sleep(action["duration"] / 1000),
        }
        for action in actions:
            does[action["type"]](action)


class Firefox(Driven):
    """Firefox, by WebDriver BiDi."""

    def __init__(self, socket: ClientConnection, size: Size) -> None:
        self.socket = socket
        self.number = 0
        self.ask("session.new", capabilities={})
        tree = self.ask("browsingContext.getTree")
        self.tab = tree["contexts"][0]["context"]
        self.resize(size)

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """What a command answers. Raises RuntimeError where it fails."""
        self.number += 1
        command = {"id": self.number, "method": method, "params": params}
        self.socket.send(json.dumps(command))
        while True:
            answer = json.loads(self.socket.recv(COMMAND_SECONDS))
            if answer.get("id") == self.number:
                break
        if answer["type"] == "error":
            raise RuntimeError(f"{method}: {answer['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def goto(self, url: str) -> None:
        self.ask("browsingContext.navigate", context=self.tab, url=url, wait="none")

    def js(self, code: str) -> Any:
        answer = self.ask(
            "script.evaluate",
            expression=CALLED.replace("{code}", code),
            target={"context": self.tab},
            awaitPromise=True,
        )
        if answer["type"] == "exception":
            raise RuntimeError(answer["exceptionDetails"]["text"])
        return json.loads(answer["result"]["value"])[0]

    def shot(self) -> np.ndarray:
        answer = self.ask("browsingContext.captureScreenshot", context=self.tab)
        return decoded(b64decode(answer["data"]))

    def resize(self, size: Size) -> None:
        viewport = {"width": size[0], "height": size[1]}
        self.ask("browsingContext.setViewport", context=self.tab, viewport=viewport)

    def act(self, kind: str, actions: Sequence[dict[str, Any]]) -> None:
        source = {"type": kind, "id": kind, "actions": list(actions)}
        self.ask("input.performActions", context=self.tab, actions=[source])


class WebKit(Driven):
    """WebKitGTK's MiniBrowser, by WebDriver."""

    def __init__(self, address: str, window: Path, size: Size) -> None:
        self.client = httpx.Client(base_url=address, timeout=COMMAND_SECONDS)
        options = {"binary": str(window), "args": ["--automation"]}
        wanted = {"alwaysMatch": {"webkitgtk:browserOptions": options}}
        answer = self.client.post("/session", json={"capabilities": wanted})
        self.session = answer.raise_for_status().json()["value"]["sessionId"]
        self.edge = (0, 0)
        self.resize(size)
        width, height = self.js("[innerWidth, innerHeight]")
        self.edge = (size[0] - width, size[1] - height)
        self.resize(size)

    def ask(self, method: str, path: str, **params: Any) -> Any:
        """What a command answers. Raises RuntimeError where it fails."""
        body = params if method == "POST" else None
        answer = self.client.request(method, f"/session/{self.session}/{path}", json=body)
        value = answer.json()["value"]
        if answer.is_error:
            raise RuntimeError(f"{path}: {value['message']}")
        return value

    def goto(self, url: str) -> None:
        self.ask("POST", "url", url=url)

    def js(self, code: str) -> Any:
        script = (
            "const done = arguments[arguments.length - 1];"
            f"{CALLED.replace('{code}', code)}"
            ".then(done, (error) => done(JSON.stringify({ error: String(error) })));"
        )
        value = json.loads(self.ask("POST", "execute/async", script=script, args=[]))
        if isinstance(value, dict):
            raise RuntimeError(value["error"])
        return value[0]

    def shot(self) -> np.ndarray:
        return decoded(b64decode(self.ask("GET", "screenshot")))

    def resize(self, size: Size) -> None:
        width, height = size[0] + self.edge[0], size[1] + self.edge[1]
        self.ask("POST", "window/rect", width=width, height=height)

    def act(self, kind: str, actions: Sequence[dict[str, Any]]) -> None:
        source = {"type": kind, "id": kind, "actions": list(actions)}
        self.ask("POST", "actions", actions=[source])


def decoded(content: bytes) -> np.ndarray:
    """A picture (h, w, 3) uint8."""
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


def missing(name: str) -> str:
    """What a browser lacks here; empty where it can be driven."""
    if name == "chromium":
        return ""
    for program in (name, "xvfb"):
        if found(program) is None:
            return f"no {' or '.join(PROGRAMS[program])}: install Debian's {PACKAGES[program]}"
    if name == "webkit" and mini_browser() is None:
        return "no MiniBrowser of WebKitGTK: install Debian's webkit2gtk-driver"
    return ""


PACKAGES = {"firefox": "firefox-esr", "webkit": "webkit2gtk-driver", "xvfb": "xvfb"}


def found(program: str) -> str | None:
    """Where a program is; None where it is not."""
    return next(filter(None, map(shutil.which, PROGRAMS[program])), None)


def mini_browser() -> Path | None:
    """The window that WebKitGTK's driver opens; None where there is none."""
    return next((path for each in MINI_BROWSERS for path in Path("/usr").glob(each)), None)


@contextmanager
def opened(name: str, browser: Browser, size: Size) -> Iterator[Driven]:
    """A browser of that ``name`` while the block runs; Chromium is a tab of ``browser``."""
    if name == "chromium":
        driven = Chromium(browser, size)
        yield driven
        driven.page.close()
        return
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home, screen() as display:
        environment = {
            **os.environ,
            "HOME": home,
            "DISPLAY": display,
            "GDK_BACKEND": "x11",
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "NO_AT_BRIDGE": "1",
        }
        with (
            firefox(home, environment, size)
            if name == "firefox"
            else webkit(environment, size) as driven
        ):
            yield driven


@contextmanager
def firefox(home: str, environment: dict[str, str], size: Size) -> Iterator[Driven]:
    """Firefox with a profile of its own."""
    lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in PREFERENCES.items()]
    (Path(home) / "user.js").write_text("\n".join(lines))
    words = ["--profile", home, "--remote-debugging-port", "0", "--no-remote", "about:blank"]
    with started([str(found("firefox")), *words], environment) as lines_of:
        port = lines_of.wait(r"BiDi listening on ws://127\.0\.0\.1:(\d+)")
        address = f"ws://127.0.0.1:{port}/session"
        with connect(address, max_size=None, open_timeout=START_SECONDS) as socket:
            driven = Firefox(socket, size)
            yield driven
            with suppress(Exception):
                driven.ask("browser.close")


@contextmanager
def webkit(environment: dict[str, str], size: Size) -> Iterator[Driven]:
    """WebKitGTK's MiniBrowser."""
    port = free_port()
    window = mini_browser()
    assert window is not None
    with started([str(found("webkit")), "-p", str(port)], environment):
        address = f"http://127.0.0.1:{port}"
        for _ in range(int(10 * START_SECONDS)):
            with suppress(httpx.HTTPError):
                httpx.get(f"{address}/status")
                break
            time.sleep(0.1)
        driven = WebKit(address, window, size)
        yield driven
        driven.client.request("DELETE", f"/session/{driven.session}")
        driven.client.close()


@contextmanager
def screen() -> Iterator[str]:
    """The name of a display that nobody sees."""
    words = ["-displayfd", "2", "-screen", "0", "1600x1200x24", "-nolisten", "tcp"]
    with started([str(found("xvfb")), *words], dict(os.environ)) as lines:
        number = lines.wait(r"^(\d+)$")
        yield f":{number}"


class Lines:
    """What a process writes, line by line."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        self.lines: list[str] = []
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    def close(self) -> None:
        """Wait for the last line, of a process that has ended."""
        assert self.process.stderr is not None
        self.thread.join(5)
        if not self.thread.is_alive():
            self.process.stderr.close()

    def wait(self, pattern: str) -> str:
        """The group of the first line that fits. Raises TimeoutError."""
        end = time.monotonic() + START_SECONDS
        while time.monotonic() < end:
            for line in list(self.lines):
                if match := re.search(pattern, line.strip()):
                    return match[1]
            time.sleep(0.05)
        raise TimeoutError(f"{self.process.args!r} wrote no {pattern}: {self.lines}")


@contextmanager
def started(words: Sequence[str], environment: dict[str, str]) -> Iterator[Lines]:
    """A process while the block runs, and what it writes."""
    process = subprocess.Popen(
        words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    lines = Lines(process)
    try:
        yield lines
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        lines.close()


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    import socket

    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return int(bound.getsockname()[1])
