"""Volumes over HTTP: sent, listed, found again, deleted, and refused with a sentence."""

import asyncio
import gzip
import re
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import StoreError
from isogi_server.errors import UploadFolderError
from isogi_server.settings import Settings
from isogi_server.uploads.folder import UploadFolder
from tests.server.asking import Ask
from tests.server.uploads.files import FIELDS, ball, headed, names
from tests.server.uploads.site import Open, Poster, client_of


def test_a_server_takes_none_unless_told(ask: Ask, open_app: Open, folder: Path) -> None:
    app = open_app(uploads_mb=0)
    answer = ask(app, "POST", "/v1/volumes", content=ball(40))
    assert answer.status_code == 403 and "--uploads-mb" in answer.json()["detail"]
    assert ask(app, "GET", "/v1/volumes").json() == {"volumes": [], "uploads": None}
    assert ask(app, "GET", "/v1/scenes").json()["uploads"] is None
    assert not folder.exists()


def test_uploads_are_on_where_nothing_is_said(ask: Ask, open_app: Open) -> None:
    app = open_app(uploads_mb=None)
    assert ask(app, "POST", "/v1/volumes", content=ball()).status_code == 201
    assert ask(app, "GET", "/v1/scenes").json()["uploads"]["quota_bytes"] == 2048 << 20


@pytest.mark.parametrize(
    "reached", [{"host": "0.0.0.0"}, {"allowed_hosts": ("render.lab.example",)}]
)
def test_uploads_are_off_where_others_reach_the_server(reached: dict[str, Any]) -> None:
    assert Settings(uploads_mb=None, **reached).upload_quota_mb == 0
    assert Settings(uploads_mb=7, **reached).upload_quota_mb == 7


def test_a_folder_in_use_turns_default_uploads_off(ask: Ask, open_app: Open) -> None:
    open_app()
    app = open_app(uploads_mb=None)
    answer = ask(app, "POST", "/v1/volumes", content=ball())
    assert (
        answer.status_code == 403
        and "Another server keeps its uploads in" in answer.json()["detail"]
    )
    assert ask(app, "GET", "/v1/scenes").json()["uploads"] is None
    with pytest.raises(UploadFolderError, match="Another server"):
        open_app(uploads_mb=64)


def test_a_volume_is_taken_shown_listed_found_again_and_deleted(
    ask: Ask, open_app: Open, folder: Path
) -> None:
    engine = Poster()
    app = open_app(engine)
    answer = ask(app, "POST", "/v1/volumes", params={"name": "Ein Ball é"}, content=ball())
    facts = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == facts["href"] == f"/v1/volumes/{facts['id']}"
    assert re.fullmatch(r"[a-z0-9_-]{1,64}", facts["id"])
    assert (facts["name"], facts["size"], facts["scene"]) == (
        "Ein Ball é",
        [12, 12, 12],
        f"/v1/scenes/{facts['id']}",
    )
    assert names(folder) == {f"{facts['id']}.nrrd"} == {path.name for path in folder.glob("*.nrrd")}
    assert facts["bytes"] == (folder / f"{facts['id']}.nrrd").stat().st_size

    again = ask(app, "POST", "/v1/volumes", params={"name": "other"}, content=ball(encoding="gzip"))
    assert (again.status_code, again.json()) == (200, facts)

    listed = ask(app, "GET", "/v1/volumes").json()
    assert listed["volumes"] == [facts] == [ask(app, "GET", facts["href"]).json()]
    free = listed["uploads"]["free_bytes"]
    beside = (64 << 20) - facts["bytes"] - free
    assert 1 << 17 <= beside <= 1 << 19, "its scene takes memory, too"
    assert listed["uploads"] == {
        "limit_bytes": 256 << 20,
        "limit_files": 8192,
        "quota_bytes": 64 << 20,
        "free_bytes": free,
    }
    (link,) = ask(app, "GET", "/v1/scenes").json()["scenes"]
    assert link == {key: facts[key] for key in ("id", "name")} | {
        "href": facts["scene"],
        "volume": facts["href"],
    }
    scene = engine.scenes[facts["id"]]
    assert (scene.name, scene.volume.size) == ("Ein Ball é", (12, 12, 12))

    app.state.service.uploads.close()
    later = open_app(found := Poster())
    assert ask(later, "GET", "/v1/volumes").json() == listed
    assert found.scenes[facts["id"]].digest == scene.digest

    assert ask(later, "DELETE", facts["href"]).status_code == 204
    assert not names(folder) and not found.scenes
    for method in ("GET", "DELETE"):
        assert ask(later, method, facts["href"]).status_code == 404


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is not a NRRD file"),
        (headed(FIELDS.replace("4 3 2", "4 3 9")), "fewer than the 108 bytes"),
        (
            headed(FIELDS.replace("raw", "gzip"), gzip.compress(bytes(1 << 20))),
            "more than the 24 bytes",
        ),
        (headed(FIELDS.replace("4 3 2", f"{2**31} {2**31} 2")), "cannot be"),
        (headed(FIELDS.replace("4 3 2", "1024 1024 1024")), "are the most that may be"),
        (
            headed(
                FIELDS.replace("uint8", "float") + "endian: little\n", bytes([0, 0, 192, 127] * 24)
            ),
            "no finite",
        ),
        (headed(FIELDS + "spacings: 1 nan 1\n"), "spacing"),
        (headed(FIELDS.replace("4 3 2", "24 1 1")), "at least 2 voxels"),
    ],
)
def test_what_cannot_be_shown_is_refused_and_leaves_nothing(
    ask: Ask, open_app: Open, folder: Path, content: bytes, said: str
) -> None:
    answer = ask(open_app(), "POST", "/v1/volumes", params={"name": "a.nrrd"}, content=content)
    assert answer.status_code == 422 and said in answer.json()["detail"], answer.text
    assert not names(folder)


@pytest.mark.slow
def test_a_file_is_asked_for_by_no_url_and_no_path(
    ask: Ask, open_app: Open, tmp_path: Path
) -> None:
    secret = tmp_path / "secret.raw"
    secret.write_bytes(bytes(range(24)))
    with socket.create_server(("127.0.0.1", 0)) as trap:
        trap.settimeout(0.2)
        app = open_app()
        for name in (f"http://127.0.0.1:{trap.getsockname()[1]}/v.raw", str(secret)):
            answer = ask(
                app, "POST", "/v1/volumes", content=headed(f"{FIELDS}data file: {name}\n", b"")
            )
            assert answer.status_code == 422 and "another file" in answer.json()["detail"]
        with pytest.raises(TimeoutError):
            trap.accept()


def test_a_file_that_takes_too_long_to_read_ends_its_reader(ask: Ask, open_app: Open) -> None:
    """Two terabytes of zeros to skip: the processor is taken away after a second or so."""
    bomb = headed(FIELDS.replace("raw", "gzip") + f"byte skip: {2**41}\n", b"")
    bomb += gzip.compress(bytes(1 << 24)) * 200
    answer = ask(open_app(reading_seconds=1.5), "POST", "/v1/volumes", content=bomb)
    assert answer.status_code in (422, 503)  # the latter where the machine is busy
    assert re.search("more time or memory|could not be read within", answer.json()["detail"])


def test_one_that_may_not_be_that_large_is_413(ask: Ask, open_app: Open, folder: Path) -> None:
    app = open_app(max_upload_mb=1)
    large = bytes((1 << 20) + 1)

    async def chunks() -> AsyncIterator[bytes]:
        yield large

    for content in (large, chunks()):
        answer = ask(app, "POST", "/v1/volumes", content=content)
        assert answer.status_code == 413 and str(1 << 20) in answer.json()["detail"]
    assert not names(folder)
    assert ask(app, "POST", "/v1/scenes", content=large).status_code == 413


@pytest.mark.slow
def test_the_quota_is_held(ask: Ask, open_app: Open, folder: Path) -> None:
    app = open_app(uploads_mb=1)
    first = ask(app, "POST", "/v1/volumes", content=ball(50)).json()
    answer = ask(app, "POST", "/v1/volumes", content=ball(56))
    assert answer.status_code == 507 and "delete volumes" in answer.json()["detail"]
    assert names(folder) == {f"{first['id']}.nrrd"}
    assert ask(app, "DELETE", first["href"]).status_code == 204
    assert ask(app, "POST", "/v1/volumes", content=ball(56)).status_code == 201


@pytest.mark.slow
def test_small_volumes_count_too_also_after_a_restart(
    ask: Ask, open_app: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("isogi_server.uploads.folder.SCENE_BYTES", 6 << 20)
    app = open_app(uploads_mb=19)
    answers = [
        ask(app, "POST", "/v1/volumes", content=ball(side)).status_code for side in (2, 3, 4, 5)
    ]
    assert answers == [201, 201, 201, 507]
    app.state.service.uploads.close()
    open_app(engine := Poster(), uploads_mb=13)
    assert len(engine.scenes) == 2


def test_a_volume_that_the_store_has_no_room_for_is_not_kept(
    ask: Ask, open_app: Open, folder: Path
) -> None:
    engine = Poster()
    engine.refusal = StoreError("The store is full.")
    answer = ask(open_app(engine), "POST", "/v1/volumes", content=ball())
    assert answer.status_code == 503 and not names(folder)


@pytest.mark.parametrize("name", ["a\nb", "a\x00", "x" * 81])
def test_a_name_is_one_line(ask: Ask, open_app: Open, name: str) -> None:
    answer = ask(open_app(), "POST", "/v1/volumes", params={"name": name}, content=ball())
    assert (answer.status_code, answer.json()["parameter"]) == (422, "name")


@pytest.mark.parametrize(
    "number", ["..", "%2e%2e%2flock", "lock", "0" * 20, "x" * 5000, "http:%2f%2fa"]
)
def test_an_id_is_looked_up_and_never_a_path(
    ask: Ask, open_app: Open, folder: Path, number: str
) -> None:
    app = open_app()
    for method in ("GET", "DELETE"):
        assert ask(app, method, f"/v1/volumes/{number}", follow_redirects=True).status_code in (
            404,
            405,
        )
    assert (folder / "lock").exists()


@pytest.mark.slow
async def test_a_third_upload_at_once_comes_back_later(open_app: Open, folder: Path) -> None:
    """Ends of the bodies come when two have begun."""
    begun = list[int]()
    together = asyncio.Event()

    async def body(side: int) -> AsyncIterator[bytes]:
        begun.append(side)
        if len(begun) == 2:
            together.set()
        await together.wait()
        yield ball(side)

    async with client_of(open_app()) as client:
        answers = await asyncio.gather(
            *(client.post("/v1/volumes", content=body(side)) for side in (8, 9, 10))
        )
    assert sorted(answer.status_code for answer in answers) == [201, 201, 429]
    assert [answer.headers["retry-after"] for answer in answers if answer.status_code == 429] == [
        "1"
    ]
    assert len(names(folder)) == 2


async def test_an_upload_that_stands_still_is_408(open_app: Open, folder: Path) -> None:
    async def half() -> AsyncIterator[bytes]:
        yield ball()[:100]
        await asyncio.sleep(60)

    async with client_of(open_app(body_seconds=1)) as client:
        assert (await client.post("/v1/volumes", content=half())).status_code == 408
    assert not names(folder)


@pytest.mark.slow
def test_a_kept_volume_that_cannot_be_shown_is_left(ask: Ask, open_app: Open, folder: Path) -> None:
    app = open_app()
    good, bad = (
        ask(app, "POST", "/v1/volumes", content=ball(side)).json()["id"] for side in (8, 9)
    )
    app.state.service.uploads.close()
    path = folder / f"{bad}.nrrd"
    path.write_bytes(path.read_bytes()[: -(9**3) * 4] + np.full(9**3, np.nan, np.float32).tobytes())
    engine = Poster()
    open_app(engine)
    assert set(engine.scenes) == {good} and names(folder) == {f"{good}.nrrd", f"{bad}.nrrd"}


def test_a_folder_that_cannot_be_had_is_told(open_app: Open, folder: Path) -> None:
    folder.parent.mkdir(exist_ok=True)
    folder.write_text("a file")
    with pytest.raises(Exception, match=r"folder of uploads .* cannot be used"):
        open_app()
    assert isinstance(UploadFolder(folder), UploadFolder)
