"""Points over a real socket: what is told of a pixel is what the picture of the same view has there."""

import io
from collections.abc import Iterator

import httpx
import numpy as np
import pytest
from PIL import Image

from tests.server.sockets import wait_for

VIEW: dict[str, str | int | float] = {"width": 48, "height": 40, "azimuth": 40}


@pytest.fixture(scope="module")
def client(live_server: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=live_server, timeout=180) as client:
        yield client


def get(client: httpx.Client, what: str, **more: str | float) -> httpx.Response:
    return client.get(f"/v1/scenes/small/{what}", params={**VIEW, **more})


@pytest.mark.parametrize("shading", ["gi", "lambert"])
def test_a_point_is_the_pixel_of_the_frame(client: httpx.Client, shading: str) -> None:
    view: dict[str, str | float] = {"shading": shading, "isovalue": 0.4}
    assert wait_for(lambda: get(client, "frame", wait_ms=5000, **view).headers["isogi-provisional"] == "?0", 120)
    planes = np.load(io.BytesIO(get(client, "frame", f="npy", **view).content))
    picture = np.array(Image.open(io.BytesIO(get(client, "frame", antialias="off", **view).content)))
    on = np.argwhere(planes[..., 3] > 0)
    assert len(on) > 100
    for row, column in on[:: len(on) // 5].tolist():
        point = get(client, "point", x=column + 0.3, y=row + 0.9, **view).json()
        light, (mask, state, error), position = np.split(planes[row, column], [3, 6])
        assert point["hit"] and mask == 1
        assert point["light"] == pytest.approx(light, rel=1e-6)
        assert point["position"] == pytest.approx(position, abs=1e-5)
        assert point["error"] == pytest.approx(error, rel=1e-5)
        assert ["provisional", "converging", "final"][int(state) - 1] == point["state"]
        assert point["displayed"] == f"#{picture[row, column].tobytes().hex()}"
        assert (point["value"], point["wall"], point["sides"], point["unit"]) == (0.4, None, "", "")
        assert point["voxel"] == pytest.approx(position, abs=1e-5), "this volume's spacing is 1"
        assert np.linalg.norm(point["normal"]) == pytest.approx(1.0, abs=1e-5)


def test_off_the_surface_nothing_is_hit(client: httpx.Client) -> None:
    answer = get(client, "point", x=0, y=0, shading="lambert")
    assert answer.status_code == 200
    told = answer.json()
    assert (told.pop("hit"), told.pop("unit")) == (False, "")
    assert set(told.values()) == {None}


@pytest.mark.parametrize(
    ("place", "parameter", "words"),
    [
        ({"x": 48, "y": 3}, "x", "outside a picture of 48"),
        ({"x": 3, "y": 40.5}, "y", "outside a picture of 40"),
        ({"x": -1, "y": 3}, "x", "must be a number from 0"),
        ({"x": 3}, "y", "is missing"),
        ({"x": 3, "y": 3, "overlay": "error"}, "overlay", "no parameter"),
    ],
)
def test_a_place_outside_is_refused(
    client: httpx.Client, place: dict[str, float | str], parameter: str, words: str
) -> None:
    answer = get(client, "point", **place)
    assert answer.status_code == 422
    assert answer.json()["parameter"] == parameter
    assert words in answer.json()["detail"]


def test_the_document_says_that_both_are_needed(client: httpx.Client) -> None:
    operation = client.get("/openapi.json").json()["paths"]["/v1/scenes/{scene}/point"]["get"]
    assert {each["name"] for each in operation["parameters"] if each.get("required")} >= {"x", "y"}
    assert not any(each.get("required") for each in operation["parameters"] if each["name"] in VIEW)


def values() -> np.ndarray:
    """The voxels (z, y, x) of the scene ``small``, by its formula."""
    z, y, x = np.mgrid[:16, :20, :24]
    return sum(np.exp(-(((x - middle) / 5) ** 2) - ((y - 9.5) / 5) ** 2 - ((z - 7.5) / 4) ** 2) for middle in (8, 16))


def cut(client: httpx.Client, headers: dict[str, str] | None = None, **asked: str | float) -> httpx.Response:
    return client.get("/v1/scenes/small/slice", params=asked, headers=headers)


def test_a_slice_shows_the_values_of_its_plane(client: httpx.Client) -> None:
    field = values()
    planes = {"z": 0.75 * field[7] + 0.25 * field[8], "y": field[:, 19], "x": field[:, :, 0]}
    for (axis, plane), at in zip(planes.items(), (7.25, 19, 0), strict=True):
        answer = cut(client, axis=axis, at=at)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
        picture = np.array(Image.open(io.BytesIO(answer.content)))
        share = (plane[::-1] - field.min()) / np.ptp(field)
        assert picture.dtype == np.uint8 and np.abs(picture - 255 * share).max() <= 1.0
    near = np.array(Image.open(io.BytesIO(cut(client, axis="z", at=7.25, low=0.4, high=0.6).content)))
    assert np.abs(near - 255 * np.clip((planes["z"][::-1] - 0.4) / 0.2, 0, 1)).max() <= 1.0


def test_a_slice_that_is_known_is_not_sent_again(client: httpx.Client) -> None:
    tag = cut(client, axis="x", at=3).headers["etag"]
    again = cut(client, {"If-None-Match": tag}, axis="x", at=3)
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    others = [{"axis": "x", "at": 4}, {"axis": "y", "at": 3}, {"axis": "x", "at": 3, "low": 0.1}]
    assert tag not in {cut(client, **other).headers["etag"] for other in others}  # type: ignore[arg-type]


def test_the_values_of_a_slice_are_told_as_they_are(client: httpx.Client) -> None:
    for axis, plane in {"z": values()[5], "y": values()[:, 7], "x": values()[:, :, 23]}.items():
        at = {"z": 5, "y": 7, "x": 23}[axis]
        answer = cut(client, axis=axis, at=at, f="npy")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-npy")
        told = np.load(io.BytesIO(answer.content))
        assert told.dtype == np.dtype("<f4") and np.abs(told - plane[::-1]).max() < 1e-6
    tags = [cut(client, axis="x", at=3, f=form).headers["etag"] for form in ("png", "npy")]
    assert len(set(tags)) == 2
    assert cut(client, {"If-None-Match": tags[1]}, axis="x", at=3, f="npy").status_code == 304


def test_values_are_packed_where_the_client_takes_that(client: httpx.Client) -> None:
    answers = [
        cut(client, {"Accept-Encoding": header}, axis="z", at=2, f="npy") for header in ("gzip, br", "gzip;q=0", "br")
    ]
    assert [answer.headers.get("content-encoding") for answer in answers] == ["gzip", None, None]
    assert len({answer.content for answer in answers}) == 1, "unpacked by the client"
    assert answers[0].headers["etag"] != answers[1].headers["etag"] == answers[2].headers["etag"]
    assert {answer.headers["vary"] for answer in answers} == {"Accept-Encoding"}


@pytest.mark.parametrize(
    ("asked", "parameter", "words"),
    [
        ({"axis": "z", "at": 1, "f": "npy", "high": 9}, "high", "does not read high"),
        ({"axis": "z", "at": 1, "f": "jpeg"}, "f", "png, npy"),
        ({"axis": "z", "at": 1, "time": 1}, "time", "no series in time"),
        ({"axis": "z", "at": 16}, "at", "z goes from 0 to 15"),
        ({"axis": "w", "at": 1}, "axis", "x, y"),
        ({"axis": "z"}, "at", "is missing"),
        ({"axis": "z", "at": 1, "low": 0.5, "high": 0.5}, "low", "not below high"),
        ({"axis": "z", "at": 1, "low": 9}, "low", "not below high"),
    ],
)
def test_a_slice_without_meaning_is_refused(
    client: httpx.Client, asked: dict[str, str | float], parameter: str, words: str
) -> None:
    answer = cut(client, **asked)
    assert answer.status_code == 422
    assert answer.json()["parameter"] == parameter
    assert words in answer.json()["detail"]
