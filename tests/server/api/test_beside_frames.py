"""What a server tells beside frames, over a real socket: points, slices, the size of the surface,
and its sky.
"""

from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from isogi.client import Isogi
from isogi_core.frame import surface_renderer
from isogi_core.frame.gbuffer import GBuffer, trace
from isogi_core.frame.panorama import paint_panorama
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.isosurface_mesh import surface_size
from tests.server.asking import final, numbers, pixels

VIEW: dict[str, str | int | float] = {"width": 48, "height": 40, "azimuth": 40}


def get(
    client: httpx.Client, what: str, headers: dict[str, str] | None = None, **query: str | float
) -> httpx.Response:
    return client.get(f"/v1/scenes/small/{what}", params=query, headers=headers)


@pytest.mark.parametrize("shading", ["gi", "lambert"])
def test_a_point_is_the_pixel_of_the_frame(client: httpx.Client, shading: str) -> None:
    view: dict[str, str | float] = {**VIEW, "shading": shading, "isovalue": 0.4}
    final(client, **view)
    planes = numbers(get(client, "frame", f="npy", **view))
    picture = pixels(get(client, "frame", antialias="off", **view))
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


def test_a_point_of_a_picture_that_nobody_drew_casts_one_ray(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is what the picture shows there, once that is drawn, too."""
    cast = list[int]()

    def traced(view: View, *given: Any) -> GBuffer:
        cast.append(view.width * view.height)
        return trace(view, *given)

    monkeypatch.setattr(surface_renderer, "trace", traced)
    view: dict[str, Any] = {"width": 600, "height": 400, "azimuth": 83, "shading": "lambert"}
    alone = get(client, "point", x=317.2, y=203.9, **view).json()
    assert cast == [1] and alone["hit"]
    planes = numbers(get(client, "frame", f="npy", **view))
    assert cast == [1, 600 * 400]
    light, _, position = np.split(planes[203, 317], [3, 6])
    assert alone["position"] == pytest.approx(position, abs=1e-5)
    assert alone["light"] == pytest.approx(light, rel=1e-5)
    drawn = get(client, "point", x=317.2, y=203.9, **view).json()
    assert cast == [1, 600 * 400] and drawn["position"] == alone["position"]


def test_off_the_surface_nothing_is_hit(client: httpx.Client) -> None:
    told = get(client, "point", x=0, y=0, shading="lambert", **VIEW).raise_for_status().json()
    assert (told.pop("hit"), told.pop("unit")) == (False, "")
    assert set(told.values()) == {None}


def test_the_document_says_that_both_are_needed(client: httpx.Client) -> None:
    operation = client.get("/openapi.json").json()["paths"]["/v1/scenes/{scene}/point"]["get"]
    assert {each["name"] for each in operation["parameters"] if each.get("required")} == {
        "scene",
        "x",
        "y",
    }


def values() -> np.ndarray:
    """The voxels (z, y, x) of the scene ``small``, by its formula."""
    z, y, x = np.mgrid[:16, :20, :24]
    return sum(
        np.exp(-(((x - middle) / 5) ** 2) - ((y - 9.5) / 5) ** 2 - ((z - 7.5) / 4) ** 2)
        for middle in (8, 16)
    )


def test_a_slice_shows_the_values_of_its_plane(client: httpx.Client) -> None:
    field = values()
    planes = {"z": 0.75 * field[7] + 0.25 * field[8], "y": field[:, 19], "x": field[:, :, 0]}
    for (axis, plane), at in zip(planes.items(), (7.25, 19, 0), strict=True):
        answer = get(client, "slice", axis=axis, at=at)
        assert answer.headers["content-type"] == "image/png"
        share = (plane[::-1] - field.min()) / np.ptp(field)
        assert (picture := pixels(answer)).dtype == np.uint8 and np.abs(
            picture - 255 * share
        ).max() <= 1.0
    near = pixels(get(client, "slice", axis="z", at=7.25, low=0.4, high=0.6))
    assert np.abs(near - 255 * np.clip((planes["z"][::-1] - 0.4) / 0.2, 0, 1)).max() <= 1.0


@pytest.mark.parametrize(
    ("axis", "at", "plane"), [("z", 5, np.s_[5]), ("y", 7, np.s_[:, 7]), ("x", 23, np.s_[..., 23])]
)
def test_the_values_of_a_slice_are_told_as_they_are(
    client: httpx.Client, axis: str, at: int, plane: object
) -> None:
    answer = get(client, "slice", axis=axis, at=at, f="npy")
    assert answer.headers["content-type"] == "application/x-npy"
    told = numbers(answer)
    assert told.dtype == np.dtype("<f4") and np.abs(told - values()[plane][::-1]).max() < 1e-6


def test_values_are_packed_where_the_client_takes_that(client: httpx.Client) -> None:
    packed, *plain = (
        get(client, "slice", {"Accept-Encoding": header}, axis="z", at=2, f="npy")
        for header in ("gzip, br", "gzip;q=0", "br")
    )
    assert [answer.headers.get("content-encoding") for answer in (packed, *plain)] == [
        "gzip",
        None,
        None,
    ]
    assert len({answer.content for answer in (packed, *plain)}) == 1, "unpacked by the client"
    assert packed.headers["etag"] != plain[0].headers["etag"] == plain[1].headers["etag"]
    assert {answer.headers["vary"] for answer in (packed, *plain)} == {"Accept-Encoding"}


def size(client: httpx.Client, **query: str | float) -> dict[str, float]:
    """Area and volume of the surface."""
    found: dict[str, float] = get(client, "size", **query).raise_for_status().json()
    return found


def test_the_size_is_that_of_the_scenes_surface(
    client: httpx.Client, live_server: str, small_scene: Path
) -> None:
    volume = load_scene(small_scene).volume
    steps = volume.orientation.affine(volume.spacing)[:, :3]
    wanted = surface_size(volume.voxels, volume.normalise_isovalue(0.4), steps)
    with Isogi(live_server) as isogi:
        found = isogi.size("small", isovalue=0.4)
    assert found == {**vars(wanted), "isovalue": 0.4, "unit": volume.orientation.unit}
    assert 0.0 < found["area_error"] < 0.1 * found["area"]
    assert size(client)["isovalue"] == 0.5, "the scene's own is measured where none is given"


def test_both_parts_of_a_cut_make_the_whole(client: httpx.Client) -> None:
    """They share a layer of voxels, at which faces of cuts lie."""
    whole = size(client)
    low = size(client, cut="x>11")
    high = size(client, cut="x<11")
    assert low["volume"] + high["volume"] == pytest.approx(whole["volume"], rel=0.03)
    assert whole["area"] < low["area"] + high["area"] < 1.6 * whole["area"], "each has a face more"


@pytest.mark.parametrize(
    "settings", [{}, {"environment": "gallery"}], ids=["own light", "named light"]
)
def test_the_sky_is_the_panorama_of_its_light(
    client: httpx.Client, small_scene: Path, settings: dict[str, str]
) -> None:
    answer = get(client, "sky", width=64, **settings)
    lighting = load_scene(small_scene, **settings).lighting
    assert answer.headers["content-type"] == "image/png"
    assert np.array_equal(
        pixels(answer)[..., :3], paint_panorama(lighting.environment, lighting.lamps, 64)
    )


@pytest.mark.parametrize("form", ["png", "jpeg", "webp"])
def test_a_sky_comes_in_each_format(client: httpx.Client, form: str) -> None:
    answer = get(client, "sky", f=form)
    assert answer.headers["content-type"] == f"image/{form}"
    assert pixels(answer).shape[:2] == (128, 256)


def test_a_sky_at_its_version_address_is_immutable(client: httpx.Client) -> None:
    plain = get(client, "sky")
    kept, other = (
        get(client, "sky", version=each) for each in (plain.headers["etag"].strip('"'), "0" * 32)
    )
    assert kept.headers["cache-control"] == "max-age=31536000, immutable"
    assert plain.headers["cache-control"] == other.headers["cache-control"] == "no-cache"
    assert other.status_code == 200


@pytest.mark.parametrize(
    ("what", "query", "others"),
    [
        ("sky", {}, [{"width": 64}, {"f": "webp"}]),
        ("slice", {"axis": "x", "at": 3}, [{"at": 4}, {"axis": "y"}, {"low": 0.1}, {"f": "npy"}]),
        ("slice", {"axis": "x", "at": 3, "f": "npy"}, [{"at": 4}]),
    ],
)
def test_what_a_client_has_is_not_sent_again(
    client: httpx.Client,
    what: str,
    query: dict[str, str | float],
    others: list[dict[str, str | float]],
) -> None:
    tag = get(client, what, **query).headers["etag"]
    again = get(client, what, {"If-None-Match": tag}, **query)
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert len(
        {tag, *(get(client, what, **query | other).headers["etag"] for other in others)}
    ) == 1 + len(others)


POINT = "point?width=48&height=40"
SLICE = "slice?axis=z"


@pytest.mark.parametrize(
    ("path", "parameter", "words"),
    [
        (f"{POINT}&x=48&y=3", "x", "outside a picture of 48"),
        (f"{POINT}&x=3&y=40.5", "y", "outside a picture of 40"),
        (f"{POINT}&x=-1&y=3", "x", "must be a number from 0"),
        (f"{POINT}&x=3", "y", "is missing"),
        (f"{POINT}&x=3&y=3&overlay=error", "overlay", "no parameter"),
        (f"{SLICE}&at=1&f=npy&high=9", "high", "does not read high"),
        (f"{SLICE}&at=1&f=jpeg", "f", "png, npy"),
        (f"{SLICE}&at=1&time=1", "time", "no series in time"),
        (f"{SLICE}&at=16", "at", "z goes from 0 to 15"),
        ("slice?axis=w&at=1", "axis", "x, y"),
        (SLICE, "at", "is missing"),
        (f"{SLICE}&at=1&low=0.5&high=0.5", "low", "not below high"),
        (f"{SLICE}&at=1&low=9", "low", "not below high"),
        ("size?isovalue=9", "isovalue", "isovalue"),
        ("size?azimuth=9", "azimuth", "no parameter"),
        ("sky?width=15", "width", "from 16 to 512"),
        ("sky?width=513", "width", "from 16 to 512"),
        ("sky?f=npy", "f", "png"),
        ("sky?version=x", "version", "version"),
        ("sky?yaw=0", "yaw", "no parameter"),
        ("sky?environment=moon", "environment", "must be one of overcast, studio"),
    ],
)
def test_what_has_no_meaning_is_refused(
    client: httpx.Client, path: str, parameter: str, words: str
) -> None:
    answer = client.get(f"/v1/scenes/small/{path}")
    assert answer.status_code == 422 and answer.json()["parameter"] == parameter
    assert words in answer.json()["detail"]


def test_an_unknown_scene_has_no_sky(client: httpx.Client) -> None:
    assert client.get("/v1/scenes/none/sky").status_code == 404
