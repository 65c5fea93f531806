"""A visitor who looks at one view after the other until each is final, whatever becomes of the
server.
"""

import hashlib
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

SMALL_SCENE = 'volume = "demo:orbital"\nlattice = 0.5\nbounces = 2\ntarget_error = 0.1\n'
"""A scene whose tasks take tenths of a second."""


def small_scene(folder: Path) -> str:
    """The scene file of SMALL_SCENE."""
    scene = folder / "small.toml"
    scene.write_text(SMALL_SCENE, encoding="utf-8")
    return str(scene)


def view(number: int) -> dict[str, Any]:
    """The knobs of one view after the other: of other isosurfaces, from other sides."""
    isovalue = 0.02 + 0.0007 * (number * 19 % 48)
    return {
        "isovalue": isovalue,
        "azimuth": 67 * number % 360,
        "width": 48,
        "height": 48,
        "f": "npy",
    }


class Visitor:
    """Asks the server at ``url`` in a thread of its own, until it is told that it is ``enough``.

    ``finals`` are the SHA-256 of the final pictures, in the order of the views; ``answers`` counts
    them all by status.
    """

    def __init__(self, url: str) -> None:
        """Ask nothing yet."""
        self.url = url
        self.finals: list[str] = []
        self.answers: Counter[int] = Counter()
        self.enough = threading.Event()
        self._thread = threading.Thread(target=self._run, name="visitor", daemon=True)

    def __enter__(self) -> "Visitor":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """See the view to its end, and leave."""
        self.enough.set()
        self._thread.join()

    @property
    def errors(self) -> int:
        """Answers that say that the server failed."""
        return sum(count for status, count in self.answers.items() if status >= 500)

    def see(self, number: int) -> str:
        """Look at a view until it is final; its SHA-256."""
        while True:
            try:
                answer = httpx.get(
                    f"{self.url}/frame", params=view(number) | {"wait_ms": 2000}, timeout=60.0
                )
            except httpx.TransportError:
                time.sleep(0.05)
                continue
            self.answers[answer.status_code] += 1
            if answer.headers.get("isogi-provisional") == "?0":
                return hashlib.sha256(answer.content).hexdigest()

    def _run(self) -> None:
        while not self.enough.is_set():
            self.finals.append(self.see(len(self.finals)))
