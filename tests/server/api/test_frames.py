"""Frames and coverage over a real socket: the response, and the store that it came from."""

import io
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from isogi_core.model.choices import VIEW_SHADINGS
from isogi_worker import queue
from tests.server.asking import final, numbers, pixels
from tests.server.sockets import wait_for

VIEW: dict[str, str | int | float] = {"width": 48, "height": 40, "azimuth": 40}
TIMING = re.compile(r"(\w+);dur=([\d.]+)")
STRICT = {"max_error": 0.001}
"""A target that no view of these tests has time to come to, whatever was baked before."""
ACCEPTED = {
    "png": "image/png",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "npy": "application/x-npy",
}


def frame(
    client: httpx.Client, headers: dict[str, str] | None = None, **more: str | float
) -> httpx.Response:
    return client.get("/v1/scenes/small/frame", params={**VIEW, **more}, headers=headers)


def final_frame(client: httpx.Client, **more: str | float) -> httpx.Response:
    """The view's final picture, when no work for this or another view is left that could still
    better its light.
    """
    # Light that an earlier test asked for and left is forgotten soon.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(queue, "FORGET_AFTER", 1.0)
        assert wait_for(lambda: idle(client), 120)
    return final(client, **{**VIEW, **more})


def idle(client: httpx.Client) -> bool:
    """Whether the workers have nothing left to do."""
    told = client.get("/metrics").text.splitlines()
    return {"isogi_queue_chunks 0.0", "isogi_tasks_in_flight 0.0"} <= set(told)


def pairs(header: str) -> dict[str, float]:
    return {name: float(value) for name, value in (pair.split("=") for pair in header.split(", "))}


def chunks(store: Path) -> dict[str, bytes]:
    """Every chunk object of the store, by its key."""
    files = (path for path in store.rglob("*") if path.is_file() and "/c/" in path.as_posix())
    return {path.relative_to(store).as_posix(): path.read_bytes() for path in files}


def test_a_frame_becomes_final_and_the_store_holds_its_chunks(
    client: httpx.Client, live_store: Path
) -> None:
    headers = final_frame(client).headers
    needed, final = pairs(headers["isogi-chunks"]).values()
    assert needed == final > 0
    assert pairs(headers["isogi-coverage"]) == {"final": 1, "converging": 0, "provisional": 0}
    assert 0 < float(headers["isogi-error"].partition(";")[0]) <= 0.5
    assert wait_for(lambda: len(chunks(live_store)) >= final, 30), "light is written once it rests"


def test_a_final_frame_writes_nothing_more_and_stays_the_same(
    client: httpx.Client, live_store: Path
) -> None:
    final_frame(client)
    stored = chunks(live_store)
    first = frame(client)
    second = frame(client)
    assert first.content == second.content
    assert first.headers["etag"] == second.headers["etag"]
    assert chunks(live_store) == stored


def test_a_new_view_is_served_at_once_marked_provisional(client: httpx.Client) -> None:
    answer = frame(client, isovalue=0.65, azimuth=200, wait_ms=0, **STRICT)
    assert answer.status_code == 200
    assert answer.headers["isogi-provisional"] == "?1"
    coverage = pairs(answer.headers["isogi-coverage"])
    assert coverage["final"] < 1
    assert sum(coverage.values()) == pytest.approx(1, abs=0.002)


def test_npy_holds_nine_planes(client: httpx.Client) -> None:
    answer = final_frame(client, f="npy")
    planes = numbers(answer)
    assert planes.shape == (40, 48, 9)
    assert planes.dtype == np.float32
    rgb, mask, state, error, position = np.split(planes, [3, 4, 5, 6], axis=2)
    hit = mask[..., 0] == 1
    assert 0 < hit.sum() < hit.size
    assert (state[hit] == 3).all()
    assert (rgb[hit] > 0).all()
    assert (error[hit] <= 0.5).all()
    assert ((position[hit] >= 0) & (position[hit] <= [23, 19, 15])).all()
    assert (planes[~hit] == 0).all()


@pytest.mark.parametrize("form", ["png", "jpeg", "webp"])
def test_pictures_hold_the_frame(client: httpx.Client, form: str) -> None:
    answer = final_frame(client, f=form)
    assert answer.headers["content-type"] == ACCEPTED[form]
    picture = Image.open(io.BytesIO(answer.content))
    assert (picture.format, picture.size) == (form.upper(), (48, 40))
    apart = (
        np.asarray(picture.convert("RGB"), float) - pixels(final_frame(client, f="png"))[..., :3]
    )
    assert np.abs(apart).mean() < (1 if form == "png" else 4)


@pytest.mark.parametrize("form", ACCEPTED)
def test_accept_chooses_and_f_beats_it(client: httpx.Client, form: str) -> None:
    accepted = frame(client, {"Accept": ACCEPTED[form]})
    assert accepted.headers["content-type"] == ACCEPTED[form]
    assert accepted.headers["vary"] == "Accept"
    assert frame(client, {"Accept": "text/html"}, f=form).headers["content-type"] == ACCEPTED[form]


def test_no_format_fits(client: httpx.Client) -> None:
    answer = frame(client, {"Accept": "text/html"})
    assert answer.status_code == 406
    assert answer.headers["content-type"] == "application/problem+json"


def test_an_unchanged_frame_is_304_with_its_headers(client: httpx.Client) -> None:
    full = final_frame(client)
    tag = full.headers["etag"]
    answer = frame(client, {"If-None-Match": f'"other", {tag}'})
    assert (answer.status_code, answer.content) == (304, b"")
    for name in (
        "etag",
        "vary",
        "cache-control",
        "isogi-provisional",
        "isogi-coverage",
        "isogi-chunks",
    ):
        assert answer.headers[name] == full.headers[name]
    assert "encode" not in answer.headers["server-timing"]
    assert "encode;dur=" in full.headers["server-timing"]


def test_a_final_frame_at_its_version_address_is_immutable(client: httpx.Client) -> None:
    final = final_frame(client)
    version = final.headers["etag"].strip('"')
    kept = "max-age=31536000, immutable"
    assert final.headers["cache-control"] == "no-cache"
    assert final.headers["cache-status"] == "isogi-light; hit"
    named = frame(client, version=version)
    assert (named.headers["cache-control"], named.content) == (kept, final.content)
    assert frame(client, version="0" * 32).headers["cache-control"] == "no-cache"
    fresh = frame(client, version=version, azimuth=77, **STRICT)
    assert fresh.headers["cache-control"] == "no-cache"
    assert fresh.headers["isogi-provisional"] == "?1"


def test_a_frame_that_is_not_final_tells_the_time_left(client: httpx.Client) -> None:
    assert "isogi-time-left" not in final_frame(client).headers
    strict = {"isovalue": 0.35, "azimuth": 100, **STRICT}
    answer = frame(client, **strict)
    assert answer.headers["isogi-provisional"] == "?1"
    low, likely, high = pairs(answer.headers["isogi-time-left"]).values()
    assert 0.0 <= low <= likely <= high and high > 0.0
    told = client.get("/v1/scenes/small/coverage", params={**VIEW, **strict}).json()
    assert told["time_left"].keys() == {"low", "likely", "high"} and not told["overdue"]


def test_no_stage_takes_longer_than_all_together(client: httpx.Client) -> None:
    view = {"isovalue": 0.55, "azimuth": 300, "max_error": 0.011}
    answer = frame(client, **view, wait_ms=10_000)
    seconds = {
        name: float(spent) for name, spent in TIMING.findall(answer.headers["server-timing"])
    }
    total = seconds.pop("total")
    drawing = {"primary", "texels", "load", "read", "light", "shade", "normals", "edges"}
    stages = {"queue", "demand", "bake", "encode"} | drawing
    assert seconds.keys() - {"filter"} == stages
    assert 0.5 * total < sum(seconds.values()) <= total


def test_the_etag_tells_views_apart(client: httpx.Client) -> None:
    tags = [
        frame(client, **more).headers["etag"]
        for more in ({}, {"isovalue": 0.51}, {"yaw": 20}, {"azimuth": 41})
    ]
    assert len(set(tags)) == 4


def test_head_has_the_headers_and_no_body(client: httpx.Client) -> None:
    full = final_frame(client)
    head = client.head("/v1/scenes/small/frame", params=VIEW)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["etag"] == full.headers["etag"]
    assert head.headers["content-length"] == str(len(full.content))


def test_two_spellings_of_one_view_are_one_frame(client: httpx.Client) -> None:
    turned = final_frame(client, yaw=90)
    spelt = frame(client, light="0.7071067811865476,0,0,0.7071067811865475")
    assert np.abs(pixels(turned).astype(int) - pixels(spelt)).max() <= 1


def test_the_picture_from_points_is_that_of_the_orbit(client: httpx.Client) -> None:
    radius = np.linalg.norm([23, 19, 15]) / 2
    orbit = final_frame(client, f="npy", elevation=0, azimuth=0, distance=4)
    points = frame(
        client, f="npy", eye=f"{11.5 + 4 * radius},9.5,7.5", target="11.5,9.5,7.5", up="0,0,1"
    )
    assert points.status_code == 422, "azimuth is among the view's parameters"
    query = {"f": "npy", "width": 48, "height": 40, "eye": f"{11.5 + 4 * radius},9.5,7.5"}
    points = client.get("/v1/scenes/small/frame", params=query)
    assert np.allclose(numbers(orbit)[..., 6:], numbers(points)[..., 6:], atol=1e-3)


def test_coverage_tells_what_the_frame_told(client: httpx.Client) -> None:
    headers = final_frame(client).headers
    state = numbers(frame(client, f="npy"))[..., 4]
    answer = client.get("/v1/scenes/small/coverage", params=VIEW).json()
    assert answer["chunks"] == pairs(headers["isogi-chunks"])
    assert answer["coverage"] == pairs(headers["isogi-coverage"])
    surface = int((state > 0).sum())
    assert answer["pixels"] == {
        "surface": surface,
        "final": surface,
        "converging": 0,
        "provisional": 0,
    }
    assert answer["error"] == pytest.approx(
        float(headers["isogi-error"].partition(";")[0]), abs=1e-5
    )
    assert answer["provisional"] is False
    tail = dict(
        part.split("=") for part in headers["isogi-error"].split("; ") if part.startswith("p99")
    )
    stated = [answer["p99"], *answer["p99_interval"]]
    assert stated == pytest.approx(
        [float(tail[name]) for name in ("p99", "p99-low", "p99-high")], abs=1e-5
    )
    assert stated[1] <= stated[0] <= stated[2]
    assert answer["time_left"] == {"low": 0.0, "likely": 0.0, "high": 0.0}


@pytest.mark.parametrize("shading", [each for each in VIEW_SHADINGS if each != "gi"])
def test_every_shading_gives_a_picture(client: httpx.Client, shading: str) -> None:
    planes = numbers(frame(client, shading=shading, f="npy", wait_ms=2000))
    assert np.isfinite(planes).all()
    assert planes[..., :3].max() > 0


def test_an_empty_picture_is_final(client: httpx.Client) -> None:
    query = {"f": "npy", "width": 8, "height": 8, "eye": "500,500,500", "target": "900,500,500"}
    answer = client.get("/v1/scenes/small/frame", params=query)
    assert answer.headers["isogi-provisional"] == "?0"
    assert answer.headers["isogi-chunks"] == "needed=0, final=0"
    assert (numbers(answer) == 0).all()


def test_a_background_is_in_the_picture_and_its_tag(client: httpx.Client) -> None:
    afar = {"distance": 100, "f": "png", "shading": "lambert"}
    answers = [
        frame(client, background=each, **afar)
        for each in ("dark", "light", "transparent", "#ff0000")
    ]
    corners = [Image.open(io.BytesIO(answer.content)).getpixel((0, 0)) for answer in answers]
    assert corners[1:] == [(203, 206, 209), (26, 29, 34, 0), (255, 0, 0)]
    assert len({answer.headers["etag"] for answer in answers}) == 4
    assert (
        "jpeg"
        in frame(client, **{**afar, "f": "jpeg", "background": "transparent"}).json()["detail"]
    )


def test_pictures_are_smooth_and_npy_tells_coverage_if_asked(client: httpx.Client) -> None:
    view = {"f": "png", "shading": "lambert", "overlay": "none", "background": "dark"}
    answers = [
        frame(client, **view, **asked) for asked in ({"antialias": "off"}, {"antialias": "on"}, {})
    ]
    plain, smooth, usual = map(pixels, answers)
    assert (
        np.array_equal(smooth, usual) and answers[1].headers["etag"] == answers[2].headers["etag"]
    )
    assert smooth.mean() == pytest.approx(plain.mean(), rel=0.05)
    assert len(np.unique(smooth)) > len(np.unique(plain))
    hits, shares = (
        numbers(frame(client, f="npy", shading="lambert", **asked))[..., 3]
        for asked in ({}, {"antialias": "on"})
    )
    assert set(np.unique(hits)) == {0, 1} and ((shares > 0) & (shares < 1)).any()


REFUSED = [
    *(
        "isovalue=0.81",
        "height=-3",
        "width=16384",
        "fov=180",
        "elevation=91",
        "light=0,0,0,0",
        "light=1,0,0",
    ),
    *(
        "shading=radiosity",
        "f=gif",
        "overlay=yes",
        "background=grey",
        "background=%2312345",
        "wait_ms=10001",
    ),
    *(
        "max_error=0",
        "exposure=-1",
        "samples=4",
        "colour=red",
        "eye=0,0,0",
        "isovalue=0.5&isovalue=0.5",
    ),
]


@pytest.mark.parametrize("query", REFUSED)
def test_bad_input_is_422_in_one_sentence(client: httpx.Client, query: str) -> None:
    answer = client.get(f"/v1/scenes/small/frame?azimuth=40&{query}")
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert (answer.status_code, body["status"], body["instance"]) == (
        422,
        422,
        "/v1/scenes/small/frame",
    )
    assert query.partition("=")[0] in body["detail"]
    assert body["detail"].endswith(".") and "\n" not in body["detail"]


@pytest.mark.parametrize(
    ("view", "words"),
    [
        ({"width": 2049, "height": 2048}, "4194304"),
        ({"width": 2048, "height": 2048, "shading": "path_traced", "samples": 4096}, "paths"),
    ],
)
def test_a_picture_that_takes_too_much_is_422(
    client: httpx.Client, view: dict[str, str | int], words: str
) -> None:
    answer = frame(client, **view)
    assert answer.status_code == 422 and words in answer.json()["detail"]


@pytest.mark.parametrize(
    "name", ["other", "..", "%2e%2e%2fsmall", "SMALL", "small%00", "http:%2f%2fexample.org"]
)
def test_an_unknown_scene_is_404(client: httpx.Client, name: str) -> None:
    answer = client.get(f"/v1/scenes/{name}/frame")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_many_clients_get_the_same_final_picture(client: httpx.Client) -> None:
    expected = final_frame(client).content
    with ThreadPoolExecutor(16) as pool:
        answers = list(pool.map(lambda _: frame(client), range(48)))
    assert {answer.status_code for answer in answers} == {200}
    assert {answer.content for answer in answers} == {expected}
