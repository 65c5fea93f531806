"""``isogi store``: what its commands print, do and exit with."""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.chunk_store import ChunkStore
from isogi_server.cli.command import run
from tests.cache.chunks import baked, file_of, spec_of
from tests.server.asking import Told

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


Facts = Callable[..., dict[str, Any]]


@pytest.fixture
def facts(told: Told) -> Facts:
    """What a command prints for a script."""
    return lambda *words, status=0: json.loads(told("store", *words, "--json", status=status))


def test_a_store_is_verified_repaired_and_sound_again(
    store: ChunkStore, tmp_path: Path, told: Told, facts: Facts, capsys: pytest.CaptureFixture[str]
) -> None:
    assert facts("verify", tmp_path)["sound"]
    file = file_of(store.layers[0], PLACES[0])
    file.write_bytes(b"cut")
    key = file.relative_to(tmp_path).as_posix()
    assert run(["store", "verify", str(tmp_path), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["damaged"] == [{"key": key, "why": "its checksum is wrong"}]
    assert (found["chunks"], found["whole"], found["layers"]) == (4, 3, 2)
    assert run(["store", "verify", str(tmp_path)]) == 1
    assert f"{key}: its checksum is wrong" in capsys.readouterr().out
    assert [each["key"] for each in facts("repair", tmp_path)["put_away"]] == [key]
    assert facts("verify", tmp_path)["quarantined"] == 1
    assert "0 damaged objects put away" in told("store", "repair", tmp_path)


def test_the_store_of_the_settings_is_the_default(
    store: ChunkStore, tmp_path: Path, told: Told, facts: Facts, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_STORE", str(tmp_path))
    assert facts("verify")["store"] == str(tmp_path)
    monkeypatch.setenv("ISOGI_STORE", str(tmp_path / "none"))
    assert "There is no store at" in told("store", "verify", status=1)


def test_stats_tell_each_layer(store: ChunkStore, tmp_path: Path, told: Told, facts: Facts) -> None:
    found = facts("stats", tmp_path)
    layers = [(layer["kind"], layer["chunks"], layer["texels"]["lit"]) for layer in found["layers"]]
    assert layers == [("direct", 2, 80), ("indirect", 2, 80)]
    assert found["bytes"] == sum(
        path.stat().st_size for path in tmp_path.glob("*/**/*") if path.is_file()
    )
    assert all("texels" not in layer for layer in facts("stats", tmp_path, "--quick")["layers"])
    text = told("store", "stats", tmp_path)
    assert (
        "orbital, 39 × 39 × 39 texels" in text
        and "direct, order 2" in text
        and "80 texels lit" in text
    )


def test_nothing_is_pruned_before_yes(
    store: ChunkStore, tmp_path: Path, told: Told, facts: Facts
) -> None:
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in files:
        os.utime(path, (time.time() - 7200.0,) * 2)
    wish = ("prune", tmp_path, "--older-than", "1h")
    assert len(facts(*wish)["layers"]) == 2
    assert all(path.exists() for path in files)
    assert "would be deleted; add --yes to do it" in told("store", *wish)
    assert len(facts(*wish, "--yes")["layers"]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["isogi.json"]
