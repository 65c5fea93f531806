"""The probe of the store."""

import errno
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from isogi_core.storage import folder
from isogi_core.storage.store import Store
from server.render import workforce
from server.render.workforce import FINDING_SECONDS, StoreProbe
from tests.worker.clock import Clock


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow disk is waited for."""
    monkeypatch.setattr(workforce, "PROBE_SECONDS", 60.0)


def test_a_store_that_works_has_nothing_left_of_it(tmp_path: Path) -> None:
    assert StoreProbe(str(tmp_path)).reasons() == []
    assert StoreProbe(f"file://{tmp_path}").reasons() == []
    assert [path.name for path in tmp_path.rglob("*")] == ["isogi.json"]


def test_what_is_no_folder_is_told_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (reason,) = StoreProbe(str(tmp_path / "file")).reasons()
    assert str(tmp_path / "file") in reason and "\n" not in reason


def test_a_store_that_is_gone_is_told(tmp_path: Path) -> None:
    (tmp_path / "light").mkdir()
    probe = StoreProbe(Store(tmp_path / "light"), clock := Clock())
    assert probe.reasons() == []
    (tmp_path / "light").rename(tmp_path / "away")
    clock.now += FINDING_SECONDS
    assert "is gone: its isogi.json is missing" in probe.reasons()[0]
    (tmp_path / "away").rename(tmp_path / "light")
    clock.now += FINDING_SECONDS
    assert probe.reasons() == []


@pytest.mark.parametrize(("number", "told"), [(errno.ENOSPC, "the store is full"), (errno.EIO, "Input/output error")])
def test_a_store_that_takes_nothing_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, told: str
) -> None:
    place = Store(tmp_path)
    place.open()

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(folder, "partial_file", refuse)
    assert told in StoreProbe(place).reasons()[0]


def test_a_store_that_is_only_read_is_as_it_should_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = Store(tmp_path)
    place.open()

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(folder, "partial_file", refuse)
    assert StoreProbe(place).reasons() == []
    assert place.read_only


def test_a_finding_stands_for_a_while(tmp_path: Path) -> None:
    clock, store = Clock(), tmp_path / "store"
    probe = StoreProbe(str(store), clock)
    store.write_text("in the way")
    assert probe.reasons() != []
    store.unlink()
    assert probe.reasons() != []
    clock.now += FINDING_SECONDS
    assert probe.reasons() == []


def test_a_store_that_hangs_holds_no_probe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probe, hangs = StoreProbe(Store(tmp_path), clock := Clock()), threading.Event()
    assert probe.reasons() == []
    monkeypatch.setattr(workforce, "PROBE_SECONDS", 0.01)
    monkeypatch.setattr(Store, "check_writable", lambda _: hangs.wait(60))
    clock.now += FINDING_SECONDS
    assert probe.reasons() == [], "what was found before stands for a while"
    clock.now += FINDING_SECONDS
    assert probe.reasons() == [f"The store at {tmp_path} does not answer."]
    hangs.set()
    monkeypatch.setattr(workforce, "PROBE_SECONDS", 60.0)
    assert probe.reasons() == []
