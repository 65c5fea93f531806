"""Messages of all kinds to streams: none may end the server, or leave a traceback in its log.

    python -m benchmarks.service fuzz [--messages 10000] [--seed 1] [--json]

Messages are good ones, changed: other types, numbers and names, cut, doubled, with characters that
are none, or bytes. A stream that the server closes is opened anew.
"""

import itertools
import json
import random
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import click
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part

NAMES = (
    "isovalue",
    "azimuth",
    "elevation",
    "distance",
    "width",
    "height",
    "shading",
    "f",
    "light",
    "wait_ms",
    "albedo",
)
ODD: tuple[Any, ...] = (
    *(
        None,
        True,
        -1,
        0,
        1e308,
        -1e308,
        2**70,
        float("nan"),
        float("inf"),
        "",
        "nan",
        "\ud800",
        "x" * 5000,
        "1,2,3",
    ),
    *([], {}, [[]], {"a": {}}, "gi", "png", 70, 0.5, "0.5", "../..", "<script>", "\x00"),
)
GAP = 1 / 400
"""Seconds between two messages: streams take 600 a second."""


def message(chance: random.Random) -> str | bytes:
    """One message."""
    view = {chance.choice(NAMES): chance.choice(ODD) for _ in range(chance.randrange(4))}
    if chance.random() < 0.5:
        small = {"width": 16, "height": 16}
    else:
        small = {}
    good: dict[str, Any] = {
        "id": chance.randrange(1000),
        "view": {**small, **view},
        "moving": chance.random() < 0.5,
    }
    kind = chance.randrange(8)
    if kind == 0:
        good[chance.choice(("id", "view", "moving", "shown", "took", "more"))] = chance.choice(ODD)
    text = json.dumps({"shown": good["id"]} if kind == 1 else good)
    if kind == 2:
        place = chance.randrange(len(text))
        return (
            text[:place]
            + chance.choice(("", "{", "\\ud800", "\u0000", "9" * 400, text))
            + text[place + 1 :]
        )
    if kind == 3:
        return chance.choice(
            (b"\xff\xfe", b"", text.encode(), bytes(chance.randrange(256) for _ in range(40)))
        )
    if kind == 4 and chance.random() < 0.1:
        return "[" * 3000
    return text


def drained(stream: ClientConnection, told: Counter[str]) -> None:
    """Count what has come."""
    try:
        while True:
            came = stream.recv(GAP)
            told[
                "pictures"
                if isinstance(came, bytes)
                else "problems"
                if '"problem"' in came
                else "facts"
            ] += 1
    except TimeoutError:
        pass


def fuzzed(served: Served, messages: int, seed: int) -> Counter[str]:
    """What came of so many messages, to one stream after another."""
    chance = random.Random(seed)
    told = Counter[str]()
    address = served.stream
    texts = (message(chance) for _ in range(messages))
    while (first := next(texts, None)) is not None:
        try:
            with connect(address) as stream:
                for text in itertools.chain([first], texts):
                    stream.send(text)
                    drained(stream, told)
        except ConnectionClosed as closed:
            told[f"closed with {closed.rcvd.code if closed.rcvd else 'nothing'}"] += 1
        except InvalidStatus as refused:
            told[f"refused with {refused.response.status_code}"] += 1
    return told


@part()
@click.argument("target", default="demo:orbital")
@click.option("--messages", default=10_000, show_default=True, help="Messages to send.")
@click.option("--seed", default=1, show_default=True, help="Of the messages.")
def fuzz(target: str, messages: int, seed: int) -> Measurement:
    """Messages of all kinds to streams, and whether the server stands."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "log")
        with (
            log.open("wb") as errors,
            serving(target, f"{folder}/light", 1, errors=errors) as served,
        ):
            told = fuzzed(served, messages, seed)
            alive = served.client.get("/livez").status_code == 200
        tracebacks = log.read_text(encoding="utf-8", errors="replace").count("Traceback")
    figures: Figures = {"messages": messages, **dict(sorted(told.items())), "server alive": alive}
    return Measurement(f"{messages} messages to streams", {**figures, "tracebacks": tracebacks})
