"""The service in this process: specimens as files, an app that bakes on a thread, and strict readings of answers."""

import asyncio
import io
import json
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, cast

import httpx
import nrrd
import numpy as np
from fastapi import FastAPI
from PIL import Image

from benchmarks.stability.specimen import Specimen
from benchmarks.stability.stage import CONSTANT
from isogi_core.model.scene import Scene, load_scene
from server.app import create_app
from server.cli import settings_from
from server.studio import Studio
from worker.baker import Baker
from worker.pool import Done, WorkerPool
from worker.tasks import BakeResult, BakeTask, bake

NO_NUMBER = re.compile(r"(?<![a-z])(nan|inf|infinity)(?![a-z])", re.IGNORECASE)


class Desk:
    """A worker pool that is a thread of this process."""

    room, workers, deaths, trouble = 2, 1, 0, ""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1)

    def submit(self, task: BakeTask, done: Done) -> None:
        """Bake; ``done`` is told the result, or the error."""

        def ended(future: "Future[BakeResult]") -> None:
            error = future.exception()
            done(None if error else future.result(), error)

        self._thread.submit(bake, task).add_done_callback(ended)

    def attend(self, stir: Callable[[], None]) -> None:
        """Have nothing to tell: the thread stays."""

    def step_back(self, seconds: float) -> bool:
        """Stay: a thread shares the session of its process."""
        return True

    def close(self) -> None:
        """End when the task at hand is done."""
        self._thread.shutdown()


def save(specimen: Specimen, path: Path) -> Path:
    """Write a specimen as a NRRD file, in the nearest type that this knows."""
    array = specimen.make()
    array = array.astype({"f2": "f4", "b1": "u1"}.get(array.dtype.str[1:], array.dtype))
    header = {"spacings": list(specimen.spacing), "endian": "big" if array.dtype.byteorder == ">" else "little"}
    nrrd.write(str(path), array, header, index_order="C")
    return path


def scene_of_file(specimen: Specimen, path: Path) -> Scene:
    """The scene of a specimen's file, with light that is soon baked."""
    settings = {"lights": [dict(CONSTANT)], "target_error": 0.5, "bounces": 1, "isovalue": specimen.isovalues[0]}
    return load_scene(path, **{**settings, **specimen.settings})


class Alone(Studio):
    """A studio that hires nobody."""

    def start(self, hire: bool = False) -> None:
        """Open the stores, and have the kernels ready."""
        super().start(hire)


@contextmanager
def service(scenes: Sequence[Scene], store: Path) -> Iterator[FastAPI]:
    """An app of these scenes, whose light is baked at a desk."""
    baker = Baker()
    with closing(Desk()) as desk, closing(Alone(scenes, str(store), baker=baker)) as studio:
        baker.employ(cast(WorkerPool, desk))
        yield create_app(studio, settings_from())


def ask(app: FastAPI, paths: Sequence[str]) -> list[httpx.Response]:
    """The answers of an app, once it has started, to GET requests, one after the other."""

    async def answers() -> list[httpx.Response]:
        await app.state.service.start()
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return [await client.get(path) for path in paths]

    return asyncio.run(answers())


def faults(answer: httpx.Response, *statuses: int) -> int:
    """What is wrong with an answer: its status, numbers in headers and body that are none, a refusal without reason."""
    wrong = int(answer.status_code not in statuses)
    wrong += sum(bool(NO_NUMBER.search(value)) for value in answer.headers.values())
    return wrong + faults_of_body(answer)


def faults_of_body(answer: httpx.Response) -> int:
    """What is wrong with a body, by its type."""
    kind = answer.headers.get("content-type", "")
    if kind.startswith("image/"):
        return int(not np.asarray(Image.open(io.BytesIO(answer.content))).size)
    if kind == "application/x-npy":
        return int((~np.isfinite(np.load(io.BytesIO(answer.content)))).sum())
    if "json" not in kind:
        return 0
    try:
        body = strict_json(answer.text)
    except ValueError:
        return 1
    return int("problem" in kind and not is_sentence(body.get("detail", "")))


def strict_json(text: str) -> Any:
    """A JSON document; ValueError where it has a number that JSON lacks."""

    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


def is_sentence(text: str) -> bool:
    """Whether a text is one line that ends in a full stop, or in a question."""
    return len(text) > 10 and "\n" not in text and text.rstrip()[-1] in ".?"
