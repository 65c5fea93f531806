"""Asking servers for frames until they are final, and reading answers."""

import io
import time
from collections.abc import Callable

import httpx
import numpy as np
from PIL import Image

Ask = Callable[..., httpx.Response]
"""What the fixture ``ask`` is."""

Told = Callable[..., str]
"""What the fixture ``told`` is."""

UPGRADE = {
    **{"Connection": "Upgrade", "Upgrade": "websocket"},
    **{"Sec-WebSocket-Key": "x3JJHMbDL1EzLkh9GBhXDw==", "Sec-WebSocket-Version": "13"},
}
"""Headers of a bare request for a web socket, whose answer is read as any other."""

SMALL: dict[str, str | int | float] = {"width": 40, "height": 40, "f": "npy"}
"""A small picture, as numbers."""


def final(client: httpx.Client, scene: str = "small", **query: str | float) -> httpx.Response:
    """The frame of a view once it is final, within two minutes."""
    deadline = time.monotonic() + 120
    while True:
        answer = client.get(
            f"/v1/scenes/{scene}/frame", params={"wait_ms": 5000, **query}, timeout=180
        )
        if answer.headers.get("isogi-provisional") == "?0":
            return answer
        assert answer.status_code in (200, 429), answer.text
        assert time.monotonic() < deadline, answer.headers
        time.sleep(0.05)


def numbers(answer: httpx.Response) -> np.ndarray:
    """The array that an answer holds in NumPy's format."""
    assert answer.status_code == 200, answer.text
    return np.asarray(np.load(io.BytesIO(answer.content), allow_pickle=False))


def pixels(answer: httpx.Response) -> np.ndarray:
    """The pixels of an answer's picture, as they are encoded."""
    assert answer.status_code == 200, answer.text
    return np.array(Image.open(io.BytesIO(answer.content)))
