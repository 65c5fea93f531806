"""``isogi store``: what its commands print, do and exit with."""

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.chunk_store import ChunkStore
from server.cli.command import run
from tests.cache.chunks import baked, file_of, spec_of

PLACES = ((1, 1, 1), (1, 2, 0))


@pytest.fixture(scope="module")
def look() -> BakeSpec:
    return spec_of()


@pytest.fixture
def store(tmp_path: Path, look: BakeSpec) -> ChunkStore:
    store = ChunkStore(tmp_path, look)
    for index in PLACES:
        store.save(baked(look, index))
    return store


def facts(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> dict[str, Any]:
    """What a command prints for a script."""
    capsys.readouterr()
    assert run(["store", *arguments, "--json"]) == status
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_store_is_verified_repaired_and_sound_again(
    store: ChunkStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = str(tmp_path)
    assert facts(capsys, "verify", where)["sound"]
    file_of(store.layers[0], PLACES[0]).write_bytes(b"cut")
    found = facts(capsys, "verify", where, status=1)
    key = file_of(store.layers[0], PLACES[0]).relative_to(tmp_path).as_posix()
    assert found["damaged"] == [{"key": key, "why": "its checksum is wrong"}]
    assert (found["chunks"], found["whole"], found["layers"]) == (4, 3, 2)
    assert run(["store", "verify", where]) == 1
    assert f"{key}: its checksum is wrong" in capsys.readouterr().out
    assert [each["key"] for each in facts(capsys, "repair", where)["put_away"]] == [key]
    assert facts(capsys, "verify", where)["quarantined"] == 1
    assert run(["store", "repair", where]) == 0
    assert "0 damaged objects put away" in capsys.readouterr().out


def test_the_store_of_the_settings_is_the_default(
    store: ChunkStore, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_STORE", str(tmp_path))
    assert facts(capsys, "verify")["store"] == str(tmp_path)
    monkeypatch.setenv("ISOGI_STORE", str(tmp_path / "none"))
    assert run(["store", "verify"]) == 1
    assert "There is no store at" in capsys.readouterr().err


def test_stats_tell_each_layer(store: ChunkStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = facts(capsys, "stats", str(tmp_path))
    assert [(layer["kind"], layer["chunks"], layer["texels"]["lit"]) for layer in found["layers"]] == [
        ("direct", 2, 80),
        ("indirect", 2, 80),
    ]
    assert found["bytes"] == sum(path.stat().st_size for path in tmp_path.glob("*/**/*") if path.is_file())
    assert all("texels" not in layer for layer in facts(capsys, "stats", str(tmp_path), "--quick")["layers"])
    assert run(["store", "stats", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "orbital, 39 × 39 × 39 texels" in text and "direct, order 2" in text and "80 texels lit" in text


def test_nothing_is_pruned_before_yes(store: ChunkStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in files:
        os.utime(path, (time.time() - 7200.0,) * 2)
    wish = ("prune", str(tmp_path), "--older-than", "1h")
    assert len(facts(capsys, *wish)["layers"]) == 2
    assert all(path.exists() for path in files)
    assert run(["store", *wish]) == 0
    assert "would be deleted; add --yes to do it" in capsys.readouterr().out
    assert len(facts(capsys, *wish, "--yes")["layers"]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["isogi.json"]


@pytest.mark.parametrize("arguments", [[], ["--older-than", "soon"], ["--keep-gb", "-1"], ["--older-than", "-1d"]])
def test_wrong_wishes_are_told(tmp_path: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["store", "prune", str(tmp_path), *arguments]) == 2
    assert capsys.readouterr().err.startswith("isogi: ")
