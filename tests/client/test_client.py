"""The client against a live server: views, waits and jobs, what it does while a server is away, and
what it raises.
"""

import ast
import http.server
import io
import json
import sys
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from httpx_retries import RetryTransport
from PIL import Image

import isogi.client as isogi_client
from isogi.client import (
    Bar,
    BusyError,
    Facts,
    Isogi,
    JobError,
    NotFinalError,
    NotFoundError,
    Progress,
    RefusedError,
    ServerError,
    TargetWarning,
    TimeLeft,
    TokenError,
    UnreachableError,
    angle,
    distance,
    nrrd_of,
)
from isogi_worker.pool import WorkerPool
from tests.client.lab import TOKEN, Broken, Faults, Lab, lab_of
from tests.loaded import load_scene

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"
VIEW: dict[str, Any] = {"width": 40, "height": 30}


@pytest.fixture(scope="module")
def lab(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with lab_of(small_scene, tmp_path_factory.mktemp("lab")) as lab:
        yield lab


@pytest.fixture
def faults(lab: Lab) -> Faults:
    lab.faults.refusals = lab.faults.cut = 0
    lab.faults.asked.clear()
    return lab.faults


@pytest.fixture(scope="module")
def isogi(lab: Lab) -> Iterator[Isogi]:
    with Isogi(lab.url, TOKEN) as isogi:
        yield isogi


def test_it_needs_no_other_part_of_isogi() -> None:
    tree = ast.parse(Path(isogi_client.__file__).read_text(encoding="utf-8"))
    names = [
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    ]
    names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    others = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names)
    assert others == {"httpx", "httpx_retries", "httpx_sse", "numpy", "PIL"}


def test_scenes_and_their_facts(isogi: Isogi) -> None:
    assert [scene["id"] for scene in isogi.scenes()] == ["small"]
    assert isogi.scene("small")["volume"]["size"] == [24, 20, 16]


def test_a_frame_comes_at_once_and_says_how_good_it_is(isogi: Isogi) -> None:
    frame = isogi.frame("small", azimuth=10, isovalue=np.float64(0.4), eye=None, **VIEW)
    assert frame.image.size == (40, 30)
    facts = frame.facts
    assert facts.etag and facts.timing and "primary" in facts.timing
    assert sum(facts.coverage.values()) == pytest.approx(1.0, abs=0.003)
    assert facts.chunks["final"] <= facts.chunks["needed"]


def test_a_final_frame_is_the_one_that_the_server_has_in_the_end(isogi: Isogi) -> None:
    told: list[Facts] = []
    frame = isogi.frame(
        "small", wait="final", progress=told.append, f="npy", antialias="off", azimuth=50, **VIEW
    )
    assert not frame.facts.provisional
    assert told[-1] == frame.facts
    assert [facts.coverage["final"] for facts in told] == sorted(
        facts.coverage["final"] for facts in told
    )
    again = isogi.frame("small", f="npy", azimuth=50, **VIEW)
    assert again.content == frame.content
    planes = frame.planes
    assert frame.array.shape[2] == 9 and "npy, " in repr(frame) and "\n" not in repr(frame)
    assert planes.rgb.shape == planes.position.shape == (30, 40, 3)
    assert planes.mask.any() and not planes.mask.all()
    assert (planes.state[planes.mask] == 3).all()
    assert (planes.rgb[planes.mask] > 0.0).all()
    assert (planes.error[~planes.mask] == 0.0).all()
    assert not isogi.coverage("small", azimuth=50, **VIEW).provisional


def test_waiting_some_seconds_asks_until_then(isogi: Isogi, faults: Faults) -> None:
    frame = isogi.frame("small", wait=60, azimuth=90, **VIEW)
    assert not frame.facts.provisional
    assert {path.rsplit("/")[-1] for path, _ in faults.asked} == {"frame"}


def test_a_path_traced_frame_is_asked_for_once(isogi: Isogi, faults: Faults) -> None:
    frame = isogi.frame(
        "small", wait=60, shading="path_traced", samples=8, max_error=0.0001, **VIEW
    )
    assert frame.facts.provisional and frame.facts.error > 0.0001
    assert len(faults.asked) == 1
    with pytest.raises(NotFinalError, match="ask for more samples"):
        isogi.frame(
            "small", wait="final", shading="path_traced", samples=8, max_error=0.0001, **VIEW
        )


@pytest.mark.parametrize(("f", "suffix"), [("png", ".png"), ("jpeg", ".jpg"), ("webp", ".webp")])
def test_pictures_are_saved_and_shown(isogi: Isogi, tmp_path: Path, f: str, suffix: str) -> None:
    frame = isogi.frame("small", f=f, **VIEW)
    assert frame.save(tmp_path / f"a{suffix}").read_bytes() == frame.content
    shown = frame._repr_png_()
    assert shown and np.array_equal(Image.open(io.BytesIO(shown)), frame.image)
    with pytest.raises(ValueError, match=f"This frame is {f}"):
        frame.save(tmp_path / "a.npy")
    with pytest.raises(ValueError, match="ask for f='npy'"):
        _ = frame.planes


def test_a_point_has_the_planes_of_its_pixel(isogi: Isogi) -> None:
    planes = isogi.frame("small", f="npy", shading="lambert", **VIEW).planes
    point = isogi.point("small", 20.5, 15.5, shading="lambert", **VIEW)
    assert point is not None and point.value == 0.5
    assert np.array(point) == pytest.approx(planes.position[15, 20])
    assert point.light == pytest.approx(planes.rgb[15, 20])
    assert isogi.point("small", 0, 0, shading="lambert", **VIEW) is None


def test_distances_and_angles_of_points() -> None:
    a, b, c = (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 4.0, 0.0)
    assert (distance(a, c), distance(a, a)) == (5.0, 0.0)
    assert (angle(a, b, c), angle(a, b, (-1e-9, 0, 0)), angle(a, b, a)) == (90.0, 180.0, 0.0)
    assert angle(a, c, b) == pytest.approx(np.degrees(np.arctan(3 / 4)))
    assert np.isnan(angle(a, a, c))


def test_numbers_are_no_picture(isogi: Isogi) -> None:
    frame = isogi.frame("small", f="npy", **VIEW)
    assert Image.open(io.BytesIO(frame._repr_png_())).size == frame.planes.mask.shape[::-1]
    with pytest.raises(ValueError, match="ask for f='png'"):
        _ = frame.image


def test_a_view_is_watched_to_its_end(isogi: Isogi) -> None:
    events = list(isogi.watch("small", azimuth=130, **VIEW))
    assert [event.kind for event in events].count("final") == 1
    assert events[-1].facts and not events[-1].facts.provisional
    assert events[0].kind == "refined"


def test_a_watch_that_is_cut_goes_on_where_it_was(isogi: Isogi, faults: Faults) -> None:
    faults.cut = 1
    events = list(isogi.watch("small", azimuth=170, **VIEW))
    assert events[-1].kind == "final"
    told = [event.id for event in events if event.kind != "progress"]
    assert len(told) == len(set(told))
    asked = [headers.get(b"last-event-id", b"").decode() for _, headers in faults.asked]
    assert asked == ["", events[0].id]


def test_a_server_that_is_not_ready_is_asked_again(isogi: Isogi, faults: Faults) -> None:
    faults.refusals = 2
    assert isogi.scenes()
    assert len(faults.asked) == 3


def test_patience_ends(lab: Lab, faults: Faults) -> None:
    faults.refusals = 1000
    with (
        Isogi(lab.url, TOKEN, patience=0.2) as hurried,
        pytest.raises(BusyError, match="Not yet") as caught,
    ):
        hurried.scenes()
    faults.refusals = 0
    assert caught.value.status == 503
    assert len(faults.asked) < 5


def test_a_token_is_shown_and_its_lack_is_told(
    lab: Lab, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Isogi(lab.url) as stranger, pytest.raises(TokenError, match="token") as caught:
        stranger.scenes()
    assert caught.value.status == 401
    monkeypatch.setenv("ISOGI_TOKEN", TOKEN)
    with Isogi(lab.url) as known:
        assert known.scenes()


def test_what_is_refused_says_why(isogi: Isogi) -> None:
    with pytest.raises(RefusedError, match="isovalue must be a number") as caught:
        isogi.frame("small", isovalue="nan")
    assert (caught.value.status, caught.value.problem["parameter"]) == (422, "isovalue")
    for name in ("none", "../small", "a b"):
        with pytest.raises(NotFoundError):
            isogi.scene(name)
    with pytest.raises(RefusedError, match="no parameter 'colour'"):
        list(isogi.watch("small", colour=1))
    with pytest.raises(TypeError, match="wait="):
        isogi.frame("small", wait_ms=5)


def test_where_nobody_answers_that_is_said_at_once() -> None:
    with (
        Isogi("http://127.0.0.1:9", patience=60) as lost,
        pytest.raises(UnreachableError, match="Does it run"),
    ):
        lost.scenes()


def test_a_view_that_cannot_become_final_ends_with_the_reason(
    small_scene: Path, tmp_path: Path
) -> None:
    with lab_of(small_scene, tmp_path, bakes=False) as lab, Isogi(lab.url, TOKEN) as isogi:
        lab.baker.use_pool(cast(WorkerPool, Broken()))
        with pytest.raises(NotFinalError, match="cursed"):
            isogi.frame("small", wait="final", **VIEW)
        assert isogi.frame("small", **VIEW).facts.provisional


def test_waiting_goes_on_through_a_restart(small_scene: Path, tmp_path: Path) -> None:
    listening = threading.Event()
    with ThreadPoolExecutor(1) as waiting:
        with lab_of(small_scene, tmp_path, bakes=False) as first:
            isogi = Isogi(first.url, TOKEN)
            asked = waiting.submit(
                isogi.frame, "small", wait="final", progress=lambda _: listening.set(), **VIEW
            )
            assert listening.wait(60)
        assert not asked.done()
        with isogi, lab_of(small_scene, tmp_path, port=urlsplit(first.url).port or 0):
            assert not asked.result(60).facts.provisional


def test_an_error_above_what_was_asked_for_is_told(isogi: Isogi) -> None:
    facts = {"isogi-provisional": "?0", "isogi-coverage": "final=1.000", "isogi-error": "0.03000"}
    over = Facts.of_headers({**facts, "isogi-chunks": "needed=3, final=3"})
    with pytest.warns(TargetWarning, match="is 0.03 and not 0.02"):
        isogi_client.tell_target(over, "0.02")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        isogi_client.tell_target(over, "0.04")
        isogi_client.tell_target(over, None)


def test_facts_tell_the_tail_of_the_errors() -> None:
    facts = {
        "isogi-provisional": "?0",
        "isogi-coverage": "final=1.000",
        "isogi-chunks": "needed=3, final=3",
    }
    error = "0.018; noise=0.006; low=0.015; high=0.021; controls=256"
    known = Facts.of_headers(
        {**facts, "isogi-error": f"{error}; p99=0.062; p99-low=0.051; p99-high=0.079"}
    )
    assert (known.p99, known.p99_interval, known.interval) == (
        0.062,
        (0.051, 0.079),
        (0.015, 0.021),
    )
    unknown = Facts.of_headers({**facts, "isogi-error": error})
    assert (unknown.p99, unknown.p99_interval, unknown.controls) == (None, None, 256)


def test_facts_for_a_person() -> None:
    facts = Facts(
        True, {"final": 0.7}, 0.0183, {"needed": 240, "final": 182}, TimeLeft(20.0, 39.6, 80.0)
    )
    assert str(facts) == "182 of 240 chunks final, error about 1.8 %, about 40 s"
    assert (
        str(Facts(False, {"final": 1.0}, 1.0, {"needed": 1, "final": 1}))
        == "1 of 1 chunks final, error about 100 %"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (70, "70"),
        (0.1, "0.1"),
        (np.float64(2.5), "2.5"),
        ((1, 2, 3), "1,2,3"),
        (np.array([0.5, 1.0]), "0.5,1.0"),
    ],
)
def test_values_are_written_as_the_server_reads_them(value: Any, text: str) -> None:
    assert isogi_client.query({"eye": value, "up": None}) == {"eye": text}


def test_an_upload_is_sent_again_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server is busy at first."""
    volume = tmp_path / "a.nrrd"
    bodies = []
    volume.write_bytes(np.random.default_rng(1).bytes((5 << 20) // 2))

    def answer(request: httpx.Request) -> httpx.Response:
        assert request.headers["content-length"] == str(volume.stat().st_size)
        assert request.url.raw_path == b"/v1/volumes?name=A+ball"
        bodies.append(request.read())
        if len(bodies) == 1:
            return httpx.Response(429, json={"detail": "Two are read already."})
        return httpx.Response(201, json={"id": "ball"})

    stub = partial(RetryTransport, transport=httpx.MockTransport(answer))
    monkeypatch.setattr(isogi_client, "RetryTransport", stub)
    with Isogi() as isogi:
        assert isogi.upload(volume, name="A ball") == {"id": "ball"}
    assert bodies == [volume.read_bytes()] * 2


def test_arrays_are_sent_as_nrrd(tmp_path: Path) -> None:
    for array in [np.arange(24).reshape(2, 3, 4).astype(kind) for kind in (">i2", "f2", "u4")]:
        (tmp_path / "sent.nrrd").write_bytes(nrrd_of(array, (1, 2, 0.5)))
        volume = load_scene(tmp_path / "sent.nrrd").volume
        assert volume.shape == (2, 3, 4) and volume.spacing == (1.0, 2.0, 0.5)
    for wrong in (np.ones((3, 4)), np.ones((2, 2, 2), complex)):
        with pytest.raises(ValueError, match="A volume is an array"):
            nrrd_of(wrong, (1, 1, 1))
    with pytest.raises(ValueError, match="three distances above 0"):
        nrrd_of(np.ones((2, 2, 2)), (1, 0, 1))


ORDER: dict[str, Any] = {
    "isovalues": [0.75, "0.76:0.78:0.02"],
    "views": 2,
    "width": 24,
    "height": 20,
}
"""Of isovalues that no other test of this module looks at."""


def test_a_prewarm_is_asked_about_and_waited_for(isogi: Isogi) -> None:
    ahead = isogi.prewarm("small", dry_run=True, **ORDER).wait()
    assert (ahead["stopped"], ahead["views"], ahead["final"]) == ("dry run", 6, 0.0)
    told: list[Progress] = []
    job = isogi.prewarm("small", **ORDER)
    summary = job.wait(told.append)
    assert (summary["stopped"], summary["final"], summary["texels"]) == (
        "target",
        1.0,
        ahead["texels"],
    )
    assert told[-1] == Progress("successful", "This is done.", 100) and told[-1].over
    assert isogi.job(job.id).summary() == summary
    assert job.address.endswith(f"/v1/jobs/{job.id}")
    assert (
        not isogi.frame(
            "small", isovalue=0.78, azimuth=0.0, elevation=30.0, width=24, height=20
        ).facts.error
        > 0.5
    )


def test_an_export_is_a_file_and_leaves_no_job(isogi: Isogi, tmp_path: Path) -> None:
    told: list[Progress] = []
    path = isogi.export("small", tmp_path / "a.glb", isovalue=0.5, yaw=40, progress=told.append)
    assert path.read_bytes().startswith(b"glTF") and told[-1].status == "successful"
    assert all(job["processID"] != "export" for job in isogi._json("GET", "/v1/jobs")["jobs"])
    with pytest.raises(RefusedError, match="glb, usdz"):
        isogi.export("small", tmp_path / "a.stl")


def test_an_export_that_is_asked_for_again_has_the_same_key(
    isogi: Isogi, tmp_path: Path, lab: Lab
) -> None:
    """So that a server whose answer was lost begins no second job."""
    for times in (2, 0):
        lab.faults.refusals = times
        isogi.export("small", tmp_path / "a.glb", isovalue=0.5, yaw=40)
    keys = [
        headers[b"idempotency-key"]
        for path, headers in lab.faults.asked
        if path.endswith("/export") and b"idempotency-key" in headers
    ][-4:]
    assert len(keys) == 4
    assert keys[0] == keys[1] == keys[2] != keys[3]


def test_a_prewarm_that_is_refused_says_why(isogi: Isogi) -> None:
    with pytest.raises(RefusedError, match="no parameter 'paint'") as caught:
        isogi.prewarm("small", paint=1)
    assert caught.value.problem["parameter"] == "paint"
    with pytest.raises(NotFoundError):
        isogi.prewarm("none")
    with pytest.raises(NotFoundError):
        isogi.job("none")


def test_a_job_that_is_dismissed_or_fails_says_so(small_scene: Path, tmp_path: Path) -> None:
    with lab_of(small_scene, tmp_path, bakes=False) as lab, Isogi(lab.url, TOKEN) as isogi:
        job = isogi.prewarm("small", **ORDER)
        with pytest.raises(NotFoundError, match="no document"):
            job.summary()
        job.dismiss()
        with pytest.raises(JobError, match="dismissed"):
            job.wait()
        lab.baker.use_pool(cast(WorkerPool, Broken()))
        with pytest.raises(JobError, match="cursed"):
            isogi.prewarm("small", **ORDER).wait()


class Elsewhere(http.server.BaseHTTPRequestHandler):
    """A server that notes what it is shown, and answers with a document of too many lists."""

    shown: ClassVar[list[str | None]] = []

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""

    def do_GET(self) -> None:
        """Answer, also to what is refused."""
        self.shown.append(self.headers.get("Authorization"))
        body = b"[" * 100_000 + b"]" * 100_000
        self.send_response(404 if "refused" in self.path else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """The address of such a server."""
    Elsewhere.shown.clear()
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_the_token_is_shown_to_no_other_server(elsewhere: str) -> None:
    with Isogi("http://127.0.0.1:1", TOKEN, patience=0.1) as isogi:
        for path in ("/v1/scenes", "/", "?a=b"):
            with pytest.raises(RefusedError, match="is no address of the server at"):
                isogi.read(f"{elsewhere}{path}")
    assert Elsewhere.shown == []
    with Isogi(elsewhere, TOKEN) as isogi:
        assert isogi.read(f"{elsewhere}/v1/scenes/small/card")
        assert isogi.read("v1/scenes/small/card")
    assert Elsewhere.shown == [f"Bearer {TOKEN}"] * 2


def test_a_document_that_is_too_deep_is_a_sentence(elsewhere: str) -> None:
    with Isogi(elsewhere) as isogi:
        with pytest.raises(ServerError, match="no JSON document that can be read"):
            isogi.scenes()
        with pytest.raises(NotFoundError, match="The server answered 404"):
            isogi.scene("refused")


def test_a_bar_is_quiet(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    """Nothing of what is done at once, nothing twice, and nothing left at the end."""
    bar = Bar()
    bar(3, 3)
    assert capsys.readouterr() == ("", "")
    bar(1, 3)
    bar(1, 3)
    drawn = capsys.readouterr().err
    assert drawn.count("1 of 3 frames") == 1
    bar(3, 3)
    assert capsys.readouterr().err.strip(" \r") == ""
    monkeypatch.setitem(sys.modules, "ipykernel", object())
    bar(1, 3)
    assert capsys.readouterr() == (drawn, ""), "as any other output of a cell"


def test_the_notebook_leaves_its_view_open() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    code = ["".join(each["source"]) for each in cells if each["cell_type"] == "code"]
    assert not any("close()" in each for each in code)


def test_facts_of_a_frame_say_that_it_shows_no_surface() -> None:
    headers = {
        "isogi-provisional": "?0",
        "isogi-coverage": "final=1.000, converging=0.000, provisional=0.000",
        "isogi-error": "0.00000; noise=0.00000; predicted",
        "isogi-chunks": "needed=0, final=0",
        "isogi-surface": "0",
    }
    facts = Facts.of_headers(headers)
    assert (facts.surface, facts.error, str(facts)) == (0, 0.0, "no surface in view")
    document = {"provisional": False, "coverage": {}, "error": 0.0, "chunks": {}}
    known = Facts.of_document({**document, "pixels": {"surface": 7}})
    assert known.surface == 7 and Facts.of_document(document).surface is None
