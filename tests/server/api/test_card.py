"""What a page draws from by itself, over a real socket: the document, voxels, and light of
chunks.
"""

import asyncio
import gzip
import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.asyncio.client import connect

from isogi_core.frame import surface_renderer
from isogi_core.frame.card.blurred_surroundings import blurred_surroundings
from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.gbuffer import GBuffer, trace
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_server.api.app import create_app
from isogi_server.parameters import FrameParams, read
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from isogi_server.views import view_of
from tests.baking import bake_each_texel
from tests.card_twin import Twin, blocks_in, voxels_of
from tests.live import live, serving
from tests.server.asking import final, numbers
from tests.server.inline import EngineWithoutWorkers
from tests.server.sockets import wait_for

CARD = "/v1/scenes/card/card"
VIEW: dict[str, Any] = {"width": 56, "height": 50, "azimuth": 40, "max_error": 0.5}
FOR_EVER = "max-age=31536000, immutable"
ZERO = "0" * 16


@pytest.fixture(scope="module")
def scene_file(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small scene without lobes, so that its frames show nothing but light of texels."""
    folder = tmp_path_factory.mktemp("card")
    (folder / "small.nrrd").write_bytes((small_scene.parent / "small.nrrd").read_bytes())
    text = small_scene.read_text().replace(
        "bounces = 1", "bounces = 1\nprojected = false\nresearch = { lobes = 0 }"
    )
    (folder / "card.toml").write_text(text)
    return folder / "card.toml"


@pytest.fixture(scope="module")
def client(scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A client of a server whose first view is baked until no texel is filtered any more."""
    store = tmp_path_factory.mktemp("store")
    bake_whole_view(load_scene(scene_file), store)
    with serving(scene_file, store) as url, httpx.Client(base_url=url, timeout=300) as found:
        final(found, "card", **VIEW)
        yield found


def bake_whole_view(scene: Scene, store: Path) -> None:
    """Bake each texel of the first view to its own error."""
    view = view_of(scene, read(FrameParams, VIEW.items()), Settings())
    with closing(RenderEngine([scene], str(store), workers=1)) as engine:
        engine.start()
        bake_each_texel(engine, scene.id, view)


@pytest.fixture(scope="module")
def scene(scene_file: Path) -> Scene:
    return load_scene(scene_file)


def document(client: httpx.Client, path: str = CARD, **more: Any) -> dict[str, Any]:
    answer = client.get(path, params={**VIEW, **more})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def voxels(client: httpx.Client, facts: dict[str, Any]) -> bytes:
    """The codes of all slabs, by the addresses in the document."""
    return b"".join(
        client.get(f"/v1/scenes/card/{slab['href']}").content for slab in facts["volume"]["slabs"]
    )


def chunks(client: httpx.Client, **more: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = document(client, f"{CARD}/chunks", **more)["chunks"]
    return found


def gradient(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The gradient of the tricubic B-spline through voxels at points (m, 3), x first, by its 64
    weights.
    """
    last = np.array(values.shape[::-1]) - 1
    base = np.clip(np.floor(points), 0, last - 1).astype(int)
    f = points - base
    weight = (
        np.array(
            [(1 - f) ** 3, 4 - 6 * f**2 + 3 * f**3, 4 - 6 * (1 - f) ** 2 + 3 * (1 - f) ** 3, f**3]
        )
        / 6
    )
    slope = np.array(
        [-0.5 * (1 - f) ** 2, 1.5 * f**2 - 2 * f, -1.5 * (1 - f) ** 2 + 2 * (1 - f), 0.5 * f**2]
    )
    found = np.zeros_like(points)
    for k, j, i in np.ndindex(4, 4, 4):
        x, y, z = np.clip(base + np.array([i, j, k]) - 1, 0, last).T
        w = [weight[n][:, a] for a, n in enumerate((i, j, k))]
        s = [slope[n][:, a] for a, n in enumerate((i, j, k))]
        value = values[z, y, x]
        found += value[:, None] * np.stack(
            [s[0] * w[1] * w[2], w[0] * s[1] * w[2], w[0] * w[1] * s[2]], axis=1
        )
    return found


@pytest.mark.parametrize("what", ["light", "transfer"])
@pytest.mark.parametrize("turn", [{}, {"yaw": 70, "pitch": -20}], ids=["as it is", "turned"])
def test_a_twin_draws_the_frame_of_the_answers_alone(
    client: httpx.Client, what: str, turn: dict[str, int]
) -> None:
    facts = document(client)["scene"]
    query = turn if what == "light" else {}
    named = ",".join(f"{each['at']}-{each['version']}" for each in chunks(client))
    twin = Twin(facts, matrix_of(turn))
    twin.take(
        client.get(
            f"/v1/scenes/card/{facts['links'][what]}{named}", params={**query, "max_error": 0.5}
        ).content
    )
    planes = numbers(client.get("/v1/scenes/card/frame", params={**VIEW, **turn, "f": "npy"}))
    on = planes[..., 3] > 0
    points = planes[on][:, 6:9].astype(float) / facts["grid"]["spacing"]
    normals = -gradient(voxels_of(facts, voxels(client, facts)), points) / facts["grid"]["spacing"]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = np.array([twin.shade(p, n) for p, n in zip(points, normals, strict=True)])
    apart = np.abs(twin.develop(found) - twin.develop(planes[on][:, :3].astype(float))).max(axis=1)
    assert len(apart) > 200 and apart.max() <= 2


def matrix_of(turn: dict[str, int]) -> np.ndarray:
    """The rotation by yaw about z, then pitch about y."""
    (cy, sy), (cp, sp) = (
        (np.cos(a), np.sin(a)) for a in np.radians([turn.get("yaw", 0), turn.get("pitch", 0)])
    )
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(yaw @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]))


def test_the_document_tells_the_scenes_own_numbers(client: httpx.Client, scene: Scene) -> None:
    found = document(client)
    assert (found["drawable"], found["because"], found["reason"], found["format"]) == (
        True,
        [],
        "",
        3,
    )
    facts = found["scene"]
    volume = scene.volume
    assert facts["grid"] | {"size": [24, 20, 16], "spacing": list(volume.spacing)} == facts["grid"]
    lattice = {"size": list(scene.lattice_shape[::-1]), "chunk": scene.settings.chunk}
    assert facts["lattice"] | lattice == facts["lattice"]
    assert (facts["exposure"], facts["target"]) == (scene.default_exposure, scene.target_error)
    assert facts["isovalues"] == list(scene.isovalues)
    level = np.float32((0.5 - facts["values"]["offset"]) / facts["values"]["scale"])
    assert level == np.float32(float(volume.normalise_isovalue(0.5)))
    assert [layer["kind"] for layer in facts["plan"]["layers"]] == [
        layer.kind for layer in scene.plan.layers
    ]
    assert facts["plan"]["columns"] == sum(term["order"] ** 2 for term in facts["light"]["terms"])
    assert facts["light"]["lobes"] == [] and len(facts["light"]["sky"][0]) == 9


def test_the_light_of_the_document_does_not_turn(client: httpx.Client) -> None:
    one = document(client)
    other = document(client, yaw=90, azimuth=10, isovalue=0.6)
    assert one["scene"]["light"] == other["scene"]["light"]
    assert one["scene"]["model"] == other["scene"]["model"]
    assert one["version"] == document(client, yaw=90, azimuth=10)["version"]
    assert one["version"] != document(client, environment="studio")["version"]
    assert document(client, environment="studio")["scene"]["light"] != one["scene"]["light"]


def test_the_document_is_not_sent_again(client: httpx.Client) -> None:
    answer = client.get(CARD)
    tag = answer.headers["etag"]
    assert (
        tag.strip('"') == answer.json()["version"] and answer.headers["cache-control"] == "no-cache"
    )
    assert client.get(CARD, headers={"If-None-Match": tag}).status_code == 304
    turned = client.get(CARD, params={"yaw": 90}, headers={"If-None-Match": tag})
    assert turned.status_code == 304, "light turns on the card"
    other = client.get(CARD, params={"environment": "studio"}, headers={"If-None-Match": tag})
    assert other.status_code == 200


def test_voxels_are_those_of_the_kernels(client: httpx.Client, scene: Scene) -> None:
    facts = document(client)["scene"]
    data = voxels(client, facts)
    assert len(data) == facts["volume"]["bytes"] and facts["volume"]["type"] == "float32"
    assert np.array_equal(voxels_of(facts, data).astype(np.float32), scene.volume.voxels)
    part = client.get(f"{CARD}/volume/3-5").content
    assert part == scene.volume.voxels[3:5].astype("<f4").tobytes()


def test_voxels_of_a_cut_are_its_own(client: httpx.Client) -> None:
    whole = document(client)["scene"]
    cut = document(client, cut="x>12")["scene"]
    assert cut["volume"]["slabs"][0]["href"] != whole["volume"]["slabs"][0]["href"]
    assert voxels(client, cut) != voxels(client, whole)


@pytest.mark.parametrize("what", ["volume", "light", "transfer"])
@pytest.mark.usefixtures("unfiltered")
def test_bytes_at_a_versions_address_are_kept_for_ever(client: httpx.Client, what: str) -> None:
    """Light that is filtered depends on chunks beside it, which the version does not name."""
    facts = document(client)["scene"]
    first = chunks(client)[0]
    if what == "volume":
        named = facts["volume"]["slabs"][0]["href"]
        other = f"card/volume/0-4?version={'0' * 32}"
    else:
        named, other = (
            f"card/{what}/{first['at']}-{version}?max_error=0.5"
            for version in (first["version"], ZERO)
        )
    assert client.get(f"/v1/scenes/card/{named}").headers["cache-control"] == FOR_EVER
    assert client.get(f"/v1/scenes/card/{other}").headers["cache-control"] == "no-cache"
    plain = other.partition("-0" if what != "volume" else "?")[0]
    assert client.get(f"/v1/scenes/card/{plain}").headers["cache-control"] == "no-cache"


@pytest.mark.parametrize("what", ["volume/0-16", "light/0.0.0", "transfer/0.0.0"])
def test_bytes_are_compressed_and_not_sent_again(client: httpx.Client, what: str) -> None:
    packed = client.get(f"{CARD}/{what}", headers={"Accept-Encoding": "gzip"})
    plain = client.get(f"{CARD}/{what}", headers={"Accept-Encoding": "gzip;q=0"})
    assert packed.headers["content-encoding"] == "gzip" and "content-encoding" not in plain.headers
    assert int(packed.headers["content-length"]) < len(plain.content)
    assert (
        packed.content == plain.content
        and gzip.decompress(gzip.compress(plain.content)) == plain.content
    )
    assert (
        packed.headers["etag"] != plain.headers["etag"]
        and plain.headers["vary"] == "Accept-Encoding"
    )
    for answer, encoding in ((packed, "gzip"), (plain, "identity")):
        headers = {"Accept-Encoding": encoding, "If-None-Match": answer.headers["etag"]}
        again = client.get(f"{CARD}/{what}", headers=headers)
        assert (again.status_code, again.content) == (304, b"")


def test_several_chunks_come_in_the_order_asked_for(client: httpx.Client) -> None:
    names = [each["at"] for each in chunks(client)]
    both = client.get(f"{CARD}/light/{','.join(reversed(names))}").content
    assert [".".join(map(str, each.at)) for each in blocks_in(both)] == names[::-1]
    assert both == b"".join(client.get(f"{CARD}/light/{name}").content for name in reversed(names))


def test_records_and_transfer_have_the_same_order(client: httpx.Client) -> None:
    facts = document(client)["scene"]
    first = chunks(client)[0]["at"]
    folded, raw = (client.get(f"{CARD}/{what}/{first}").content for what in ("light", "transfer"))
    (one,) = blocks_in(folded)
    (other,) = blocks_in(raw, facts["plan"]["channels"] * facts["plan"]["columns"] + 2)
    assert (one.masks, one.version, one.at) == (other.masks, other.version, other.at)
    assert np.array_equal(one.words, other.words) and (one.kind, other.kind) == (0, 1)
    assert len(one.words) > 10


def test_a_view_that_was_not_baked_has_its_light_requested(client: httpx.Client) -> None:
    view = {"isovalue": 0.31, "azimuth": 200}
    before = chunks(client, **view)
    assert not all(each["final"] for each in before)
    assert wait_for(lambda: all(each["final"] for each in chunks(client, **view)), 30)
    now = chunks(client, **view)
    assert {each["at"] for each in now} == {each["at"] for each in before}
    versions = {each["at"]: each["version"] for each in before}
    assert any(each["version"] != versions[each["at"]] for each in now)


def test_chunks_of_a_large_view_are_looked_at_by_few_rays(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as a million, and they find the same chunks."""
    cast = list[int]()

    def traced(view: View, *given: Any) -> GBuffer:
        cast.append(view.width * view.height)
        return trace(view, *given)

    monkeypatch.setattr(surface_renderer, "trace", traced)
    for size in ((2048, 2048), (16383, 128)):
        assert chunks(client, azimuth=71, width=size[0], height=size[1])
    assert len(cast) == 2 and (1 << 20) >= max(cast) > min(cast) > 0.98 * (1 << 20)
    few, many = (
        {each["at"] for each in chunks(client, azimuth=71, width=side, height=side)}
        for side in (1024, 2048)
    )
    assert few == many


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("light/9.0.0", 404, "There is no chunk 9.0.0"),
        ("transfer/0.0.9", 404, "There is no chunk 0.0.9"),
        ("light/0.0", 422, "names no chunk"),
        ("light/0.0.0-12", 422, "names no chunk"),
        ("light/" + ",".join(["0.0.0"] * 65), 422, "ask for 64 at most"),
        ("volume/0-17", 404, "There are no layers '0-17'"),
        ("volume/4-4", 404, "There are no layers"),
        ("volume/all", 404, "There are no layers 'all'"),
        ("colours/0-1", 404, "no colours by data"),
        ("surroundings", 404, "mirrors no surroundings"),
        ("volume/0-4?azimuth=3", 422, "no parameter 'azimuth'"),
        ("transfer/0.0.0?yaw=3", 422, "no parameter 'yaw'"),
        ("light/0.0.0?yaw=3&light=1,0,0,0", 422, "given twice"),
        ("chunks?isovalue=7", 422, "isovalue"),
        ("chunks?wait_ms=7", 422, "a list comes at once"),
    ],
)
def test_what_is_not_there_is_refused_in_a_sentence(
    client: httpx.Client, path: str, status: int, words: str
) -> None:
    answer = client.get(f"{CARD}/{path}")
    assert answer.status_code == status, answer.text
    assert (
        answer.headers["content-type"] == "application/problem+json"
        and words in answer.json()["detail"]
    )


def test_an_unknown_scene_has_no_card(client: httpx.Client) -> None:
    for path in (
        "card",
        "card/chunks",
        "card/volume/0-1",
        "card/light/0.0.0",
        "card/transfer/0.0.0",
    ):
        assert client.get(f"/v1/scenes/none/{path}").status_code == 404


def stream_of(client: httpx.Client) -> connect:
    return connect(
        str(client.base_url).replace("http", "ws").rstrip("/") + "/v1/scenes/card/stream",
        max_size=None,
    )


async def test_a_stream_names_the_chunks_of_a_view_at_rest(client: httpx.Client) -> None:
    async def heard(**more: Any) -> Any:
        async with stream_of(client) as socket:
            await socket.send(json.dumps({"id": 1, "view": VIEW, **more}))
            return json.loads(await socket.recv())

    assert (await heard(chunks=True))["chunks"] == chunks(client)
    assert "chunks" not in await heard()
    assert "chunks" not in await heard(chunks=True, moving=True)


async def test_a_stream_sends_no_pictures_that_nobody_wants(client: httpx.Client) -> None:
    async with stream_of(client) as socket:
        for number in (1, 2, 3):
            view = {**VIEW, "azimuth": 40 + number}
            await socket.send(
                json.dumps({"id": number, "view": view, "moving": True, "pictures": False})
            )
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(socket.recv(), 0.3)
        await socket.send(json.dumps({"id": 4, "view": VIEW}))
        assert json.loads(await socket.recv())["id"] == 4


def test_the_addresses_are_documented(client: httpx.Client) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    parts = ("/volume/{layers}", "/colours/{layers}", "/light/{chunks}", "/transfer/{chunks}")
    parts = (*parts, "/surroundings")
    for name in ("", "/chunks", *parts):
        operation = paths[f"/v1/scenes/{{scene}}/card{name}"]["get"]
        assert operation["summary"] and {"200", "403", "404", "422", "429", "503"} <= set(
            operation["responses"]
        )


def test_surroundings_come_from_the_address_in_the_document(
    scene_file: Path, tmp_path: Path
) -> None:
    """Of a scene that shines, and for ever at their version."""
    path = scene_file.with_name("shiny.toml")
    path.write_text(scene_file.read_text() + '\n[shine]\nkind = "metal"\nroughness = 0.4\n')
    scene = load_scene(path)
    app = create_app(EngineWithoutWorkers([scene], str(tmp_path)), Settings())
    with live(app) as url, httpx.Client(base_url=url, timeout=300) as found:
        answer = found.get(f"/v1/scenes/{scene.id}/card").json()
        assert answer["drawable"], answer["reason"]
        shine = answer["scene"]["shine"]
        assert (shine["kind"], shine["roughness"], shine["strength"]) == ("metal", 0.4, 1.0)
        assert shine["albedo"] == pytest.approx(scene.surfaces.albedo)
        facts = shine["surroundings"]
        parts = found.get(f"/v1/scenes/{scene.id}/{facts['href']}")
        assert parts.headers["cache-control"] == FOR_EVER
        halves = np.frombuffer(parts.content, "<f2")
        sizes = [6 * (facts["rows"] >> level) ** 2 for level in range(facts["levels"])]
        assert (2 * len(halves), len(halves)) == (facts["bytes"], sum(sizes))
        levels = blurred_surroundings(scene.lighting.environment).levels
        assert np.array_equal(halves[: sizes[0]], levels[0].ravel())
        assert np.array_equal(halves[-sizes[-1] :], levels[-1].ravel())
        dull = found.get(f"/v1/scenes/{scene.id}/card", params={"strength": 0}).json()["scene"]
        assert dull["shine"] == {**shine, "strength": 0.0}, "any lobe mirrors the same"


def test_colours_come_from_the_addresses_in_the_document(scene_file: Path, tmp_path: Path) -> None:
    """As the scene has them, and for ever at their version."""
    table = '\n[[volumes]]\nuse = "colour"\nof = "gradient"\n'
    path = scene_file.with_name("painted.toml")
    path.write_text(scene_file.read_text() + table)
    scene = load_scene(path)
    assert scene.surfaces.colours is not None
    app = create_app(EngineWithoutWorkers([scene], str(tmp_path)), Settings())
    with live(app) as url, httpx.Client(base_url=url, timeout=300) as found:
        answer = found.get(f"/v1/scenes/{scene.id}/card").json()
        assert answer["drawable"], answer["reason"]
        facts = answer["scene"]["colours"]
        parts = [found.get(f"/v1/scenes/{scene.id}/{each['href']}") for each in facts["slabs"]]
        assert all(each.headers["cache-control"] == FOR_EVER for each in parts)
        data = np.frombuffer(b"".join(each.content for each in parts), np.uint8)
        expected = ColourCodes.of(scene)
        assert expected is not None and len(data) == facts["bytes"] == expected.nbytes
        assert data.tobytes() == expected.layers(0, len(expected.colours.places)).tobytes()
        np.testing.assert_allclose(facts["table"], expected.colours.table)
        assert facts["brightest"] == pytest.approx(expected.colours.brightest)


TOKEN = {"token": "correct horse battery"}


@pytest.mark.parametrize(
    ("given", "handed"),
    [
        (TOKEN, False),
        ({**TOKEN, "hand_out_voxels": True}, True),
        ({"hand_out_voxels": False}, False),
    ],
)
def test_a_server_may_keep_its_voxels(
    scene_file: Path, tmp_path: Path, given: dict[str, Any], handed: bool
) -> None:
    app = create_app(
        EngineWithoutWorkers([load_scene(scene_file)], str(tmp_path)), Settings(**given)
    )
    headers = {"Authorization": f"Bearer {TOKEN['token']}"}
    with live(app) as url, httpx.Client(base_url=url, headers=headers, timeout=300) as found:
        facts = found.get(CARD).json()
        assert (facts["drawable"], facts["because"]) == (
            (True, []) if handed else (False, ["voxels kept"])
        )
        assert (facts["scene"] is not None) == handed
        assert found.get(f"{CARD}/colours/0-1").status_code == (404 if handed else 403)
        assert found.get(f"{CARD}/surroundings").status_code == (404 if handed else 403)
        for path in ("volume/0-1", "light/0.0.0", "transfer/0.0.0"):
            answer = found.get(f"{CARD}/{path}")
            assert answer.status_code == (200 if handed else 403)
            assert handed or "hand_out_voxels" in answer.json()["detail"]
        for form, status in (("npy", 200 if handed else 403), ("png", 200)):
            slice_ = {"axis": "z", "at": 3, "f": form}
            assert found.get("/v1/scenes/card/slice", params=slice_).status_code == status
        for form in ("nrrd", "vti", "glb"):
            answer = found.post("/v1/scenes/card/export", params={"f": form, "deadline": 0})
            withheld = not handed and form != "glb"
            assert (answer.status_code == 403) is withheld, answer.text
