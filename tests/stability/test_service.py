"""Hard volumes through the service: every endpoint, numbers that are none, and what ``isogi inspect`` says of them."""

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
from isogi_core.model.volume import make_volume
from server.api.app import create_app
from server.cli.command import run, settings_from
from server.inspect.inspection import SurfaceSchema, stiffness_schema
from server.parameters import FrameParams, ViewParams
from server.values import Row, Span
from tests.loaded import load_scene
from tests.server.inline import EngineWithoutWorkers, InlinePool
from tests.stability.scenes import CONSTANT, scene_of
from tests.stability.volumes import REFUSED, VOLUMES, Specimen, ball, body, grid, ramp
from worker import pool
from worker.baker import Baker
from worker.pool import WorkerPool

SOME = (
    *("mask", "offset of 1e9 in single floats", "subnormal", "constant", "hot voxels of ±1e300"),
    *("infinities in half", "4096 × 2 × 2", "spacing of 1e-30"),
)
"""Specimens that go through the service."""

PAGES = ("/", "/v1/scenes", "/livez", "/docs")
"""Endpoints that are of no single scene; /readyz is not among them, as no workers are hired."""

SMALL = {"width": 12, "height": 12}

NO_NUMBER = re.compile(r"(?<![a-z])(nan|inf|infinity)(?![a-z])", re.IGNORECASE)

HOSTILE = (
    *("nan", "NaN", "-nan", "inf", "-inf", "Infinity", "1e999", "-1e999", "1e-", "e5", "1_0", "0x10", "0b1"),
    *("", " ", " 1", "1 ", "1,0", "1;2", "+", "--1", ".", "٣", "½", "None", "null", "true", "[]", "1e5e5", "9" * 70),
)
"""What is no number."""


def save(specimen: Specimen, path: Path) -> Path:
    """Write a specimen as a NRRD file, in the nearest type that this knows."""
    array = specimen.make()
    array = array.astype({"f2": "f4", "b1": "u1"}.get(array.dtype.str[1:], array.dtype))
    header = {"spacings": list(specimen.spacing), "endian": "big" if array.dtype.byteorder == ">" else "little"}
    nrrd.write(str(path), array, header, index_order="C")
    return path


@contextmanager
def service(specimen: Specimen, folder: Path) -> Iterator[FastAPI]:
    """An app of the scene ``s`` of a specimen, whose light is soon baked on a thread of this process."""
    settings = {"lights": [dict(CONSTANT)], "target_error": 0.5, "bounces": 1, "isovalue": specimen.isovalues[0]}
    scene, baker = load_scene(save(specimen, folder / "s.nrrd"), **settings), Baker()
    with (
        closing(InlinePool()) as workers,
        closing(EngineWithoutWorkers([scene], str(folder / "light"), baker=baker)) as engine,
    ):
        baker.employ(cast(WorkerPool, workers))
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
    """Assert that all numbers of an answer are finite: in its headers, and in its picture, array or JSON."""
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
    frames += [{"f": form, "wait_ms": "300", "overlay": "provisional"} for form in ("png", "jpeg", "webp")]
    paths = [*PAGES, scene, f"{scene}/coverage?{urlencode(SMALL)}"]
    paths += [f"{scene}/frame?{urlencode({**SMALL, **frame})}" for frame in frames]
    with service(VOLUMES[name], tmp_path) as app:
        for answer in answers(app, paths):
            assert answer.status_code == 200, answer.text
            assert_finite(answer)


def hostile_queries() -> Iterator[dict[str, str]]:
    """Each numeric parameter with each thing that is no number; of rows, one number among good ones."""
    for name, field in FrameParams.model_fields.items():
        rows = [part for part in field.metadata if isinstance(part, Row)]
        if name == "isovalue" or any(isinstance(part, Span) for part in field.metadata):
            yield from ({name: text} for text in HOSTILE)
        elif rows:
            others = ["0"] * (len(rows[0].names) - 1)
            yield from ({name: ",".join([text, *others])} for text in HOSTILE if text != "1,0")


@pytest.mark.slow
def test_what_is_no_number_is_422_in_every_parameter(tmp_path: Path) -> None:
    """Of frames and of coverage, with a sentence."""
    queries = [{**query, **({"shading": "path_traced"} if "samples" in query else {})} for query in hostile_queries()]
    views = [query for query in queries if set(ViewParams.model_fields) >= set(query)]
    paths = [f"/v1/scenes/s/frame?{urlencode(query)}" for query in queries]
    paths += [f"/v1/scenes/s/coverage?{urlencode(query)}" for query in views]
    assert len(paths) > 900
    with service(VOLUMES["mask"], tmp_path) as app:
        for answer in answers(app, paths):
            assert answer.status_code == 422, answer.url
            assert_finite(answer)
            assert is_sentence(strict_json(answer.text)["detail"]), answer.text


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


@pytest.mark.slow
def test_render_writes_files_of_finite_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command line."""
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)
    specimen, output = VOLUMES["mask"], tmp_path / "frame.npy"
    where = ["--store", str(tmp_path / "light"), "--workers", "1", "--width", "32", "--height", "32"]
    file = str(save(specimen, tmp_path / "s.nrrd"))
    assert run(["render", file, "-o", str(output), f"--isovalue={specimen.isovalues[1]!r}", *where]) == 0
    pixels = np.load(output)
    assert pixels[..., 3].any()
    assert np.isfinite(pixels).all()


def facts_of(voxels: np.ndarray, isovalue: float = 0.5) -> SurfaceSchema:
    """How stiff ``isogi inspect`` says that a volume's surface is."""
    found = stiffness_schema(scene_of(make_volume(voxels), isovalue))
    return found.surfaces[found.own]


def ball_with_a_ramp(side: int, centre: tuple[float, float, float], radius: float, width: float) -> np.ndarray:
    """A ball whose skin is a ramp of so many voxels."""
    return ramp(ball(grid(side, side, side), centre, radius), width)


@pytest.mark.parametrize("width", [3.0, 4.0, 8.0])
def test_no_cell_of_a_ball_with_a_soft_skin_is_called_stiff(width: float) -> None:
    found = facts_of(ball_with_a_ramp(48, (0.3, 0.1, -0.2), 0.3 * 48, width))
    assert found.cells > 0
    assert (found.steep, found.plateau, found.noisy) == (0.0, 0.0, 0.0)


def test_every_cell_of_a_mask_is_called_steep() -> None:
    """And nine of ten of a ramp of one voxel."""
    assert facts_of(ramp(body(), 0.0)).steep == 1.0
    assert facts_of(ramp(body(), 1.0)).steep >= 0.9


def test_the_surface_of_a_tread_is_said_to_lie_on_a_plateau() -> None:
    """All of it, where the isovalue is a tread's own value."""
    treads = np.floor(np.indices((32, 32, 32))[0] / 8.0)
    assert [facts_of(treads, float(tread)).plateau for tread in range(3)] == [1.0, 1.0, 1.0]


def test_nine_of_ten_cells_of_white_noise_are_called_noisy() -> None:
    assert facts_of(np.random.default_rng(5).normal(size=(32, 32, 32)), 0.0).noisy >= 0.9


@pytest.mark.parametrize("end", [0, 23])
@pytest.mark.parametrize("axis", range(3), ids="xyz")
def test_the_face_of_the_box_that_a_surface_meets_is_named(axis: int, end: int) -> None:
    """And no other, for a ball that is moved through it."""
    centre = [0.0, 0.0, 0.0]
    centre[axis] = 12.0 if end else -12.0
    met = facts_of(ball_with_a_ramp(24, (centre[0], centre[1], centre[2]), 6.0, 4.0)).box
    assert set(met) == {f"{'xyz'[axis]} = {end}"}
