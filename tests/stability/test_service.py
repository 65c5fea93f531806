"""Hard volumes through the service: every endpoint, and what ``isogi inspect`` says of them."""

import asyncio
import io
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlencode

import httpx
import nrrd
import numpy as np
import pytest
from fastapi import FastAPI
from PIL import Image

from isogi_core.model.choices import VIEW_SHADINGS
from isogi_server.api.app import create_app
from isogi_server.cli.command import run, settings_from
from isogi_worker.baker import Baker
from isogi_worker.pool import WorkerPool
from tests.loaded import load_scene
from tests.server.inline import EngineWithoutWorkers, InlinePool
from tests.stability.scenes import CONSTANT
from tests.stability.volumes import REFUSED, VOLUMES, Specimen

SOME = (
    *("mask", "offset of 1e9 in single floats", "subnormal", "constant", "hot voxels of ±1e300"),
    *("infinities in half", "4096 × 2 × 2", "spacing of 1e-30"),
)
"""Specimens that go through the service."""

PAGES = ("/", "/v1/scenes", "/livez", "/docs")
"""Endpoints that are of no single scene; /readyz is not among them, as no workers are hired."""

SMALL = {"width": 12, "height": 12}

NO_NUMBER = re.compile(r"(?<![a-z])(nan|inf|infinity)(?![a-z])", re.IGNORECASE)


def save(specimen: Specimen, path: Path) -> Path:
    """Write a specimen as a NRRD file, in the nearest type that this knows."""
    array = specimen.make()
    array = array.astype({"f2": "f4", "b1": "u1"}.get(array.dtype.str[1:], array.dtype))
    header = {
        "spacings": list(specimen.spacing),
        "endian": "big" if array.dtype.byteorder == ">" else "little",
    }
    nrrd.write(str(path), array, header, index_order="C")
    return path


@contextmanager
def service(specimen: Specimen, folder: Path) -> Iterator[FastAPI]:
    """An app of the scene ``s`` of a specimen, whose light is soon baked on a thread of this
    process.
    """
    settings = {
        "lights": [dict(CONSTANT)],
        "target_error": 0.5,
        "bounces": 1,
        "isovalue": specimen.isovalues[0],
    }
    scene = load_scene(save(specimen, folder / "s.nrrd"), **settings)
    baker = Baker()
    with (
        closing(InlinePool()) as workers,
        closing(EngineWithoutWorkers([scene], str(folder / "light"), baker=baker)) as engine,
    ):
        baker.use_pool(cast(WorkerPool, workers))
        yield create_app(engine, settings_from())


def answers(app: FastAPI, paths: Sequence[str]) -> list[httpx.Response]:
    """The answers of an app, once it has started, to GET requests, one after the other."""

    async def ask() -> list[httpx.Response]:
        await app.state.service.start()
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return [await client.get(path) for path in paths]

    return asyncio.run(ask())


def assert_finite(answer: httpx.Response) -> None:
    """Assert that all numbers of an answer are finite: in its headers, and in its picture, array or
    JSON.
    """
    assert not [value for value in answer.headers.values() if NO_NUMBER.search(value)], answer.url
    kind = answer.headers.get("content-type", "")
    if kind.startswith("image/"):
        assert np.asarray(Image.open(io.BytesIO(answer.content))).size, answer.url
    elif kind == "application/x-npy":
        assert np.isfinite(np.load(io.BytesIO(answer.content))).all(), answer.url
    elif "json" in kind:
        strict_json(answer.text)


def strict_json(text: str) -> Any:
    """A JSON document; fails where it has a number that JSON lacks."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON: {text}"))


def is_sentence(text: str) -> bool:
    """Whether a text is one line that ends in a full stop, or in a question."""
    return len(text) > 10 and "\n" not in text and text.rstrip()[-1] in ".?"


@pytest.mark.parametrize("name", SOME)
def test_every_endpoint_answers_hard_volumes_in_finite_numbers(name: str, tmp_path: Path) -> None:
    """In every shading and every format of pictures."""
    scene = "/v1/scenes/s"
    frames = [{"shading": shading, "f": "npy"} for shading in VIEW_SHADINGS]
    frames += [
        {"f": form, "wait_ms": "300", "overlay": "provisional"} for form in ("png", "jpeg", "webp")
    ]
    paths = [*PAGES, scene, f"{scene}/coverage?{urlencode(SMALL)}"]
    paths += [f"{scene}/frame?{urlencode({**SMALL, **frame})}" for frame in frames]
    with service(VOLUMES[name], tmp_path) as app:
        for answer in answers(app, paths):
            assert answer.status_code == 200, answer.text
            assert_finite(answer)


@pytest.mark.parametrize("name", SOME)
def test_inspect_describes_every_hard_volume_in_json(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["inspect", str(save(VOLUMES[name], tmp_path / "s.nrrd")), "--json"]) == 0
    assert strict_json(capsys.readouterr().out)


@pytest.mark.parametrize("name", REFUSED)
def test_inspect_refuses_what_is_no_volume_in_a_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["inspect", str(save(REFUSED[name], tmp_path / "s.nrrd")), "--json"]) == 2
    said = capsys.readouterr().err.strip()
    assert is_sentence(said)
    assert REFUSED[name].refused in said
