"""The folder of compiled kernels: who is using it, and which old ones go."""

import os
import shutil
import subprocess
import sys
import tempfile

import pytest

from isogi_core.kernels import _cache_folder as _folder

HOLD = """\
import sys
from pathlib import Path
from isogi_core.kernels._cache_folder import hold
hold(Path(sys.argv[1]))
sys.stdout.write("held")
sys.stdout.flush()
sys.stdin.read()
"""


@pytest.fixture
def folders(tmp_path):
    """Ten folders, each used a second after the one before it, and the next one, that is in use."""
    for n in range(11):
        os.close(_folder.hold(tmp_path / f"{n:02}"))
        (tmp_path / f"{n:02}" / "kernel.nbi").touch()
        os.utime(tmp_path / f"{n:02}" / _folder.IN_USE, (n, n))
    return tmp_path


def names(folder):
    return sorted(each.name for each in folder.iterdir())


@pytest.mark.parametrize("planted", ["open", "link", "file"])
def test_a_folder_that_others_may_write_is_passed_over(monkeypatch, tmp_path, planted):
    """Kernels are machine code: nobody else may put some where this user reads it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    usual = _folder.private_root()
    assert usual == _folder.private_root() and usual.stat().st_mode & 0o777 == 0o700
    usual.rmdir()
    if planted == "open":
        usual.mkdir()
        usual.chmod(0o777)
    elif planted == "link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        usual.symlink_to(tmp_path / "theirs")
    else:
        usual.touch(mode=0o600)
    found = _folder.private_root()
    assert found != usual and found.stat().st_mode & 0o777 == 0o700 and not any(found.iterdir())


@pytest.mark.parametrize(
    ("name", "value"), [("BOUNDSCHECK", 2), ("OPT", 0), ("CPU_NAME", "generic")]
)
def test_code_of_other_settings_has_a_folder_of_its_own(monkeypatch, name, value):
    usual = _folder.sources_digest()
    monkeypatch.setattr(_folder.numba.config, name, value)
    assert _folder.sources_digest() != usual


def test_every_setting_is_one_that_numba_has():
    assert all(hasattr(_folder.numba.config, name) for name in _folder.SETTINGS)


def test_the_oldest_go_and_the_own_one_stays(folders):
    _folder.prune_folders(folders / "00")
    own, *others = names(folders)
    assert own == "00" and others == [f"{n:02}" for n in range(11 - len(others), 11)]
    assert 4 <= len(others) < 10, "of ten"


def test_few_folders_all_stay(folders):
    _folder.prune_folders(folders / "00")
    before = names(folders)
    _folder.prune_folders(folders / "00")
    assert names(folders) == before


def test_an_unmarked_folder_counts_from_when_it_was_made(folders):
    (folders / "unmarked").mkdir()
    _folder.prune_folders(folders / "10")
    assert "unmarked" in names(folders)


def test_what_another_process_uses_stays_until_it_ends(folders):
    command = [sys.executable, "-c", HOLD, str(folders / "01")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as user:
        assert user.stdout.read(4) == b"held"
        os.utime(folders / "01" / _folder.IN_USE, (1, 1))
        _folder.prune_folders(folders / "10")
        assert names(folders)[:2] == ["01", "02"]
    _folder.prune_folders(folders / "10")
    assert names(folders)[:2] == ["02", "03"]


def test_using_a_folder_makes_it_the_newest(folders):
    os.close(_folder.hold(folders / "00"))
    _folder.prune_folders(folders / "10")
    assert "00" in names(folders)


def test_a_folder_removed_while_it_is_taken_is_made_again(tmp_path, monkeypatch):
    there = _folder.is_at

    def removed_once(file, path):
        monkeypatch.setattr(_folder, "is_at", there)
        path.unlink()
        path.parent.rmdir()
        return there(file, path)

    monkeypatch.setattr(_folder, "is_at", removed_once)
    os.close(_folder.hold(tmp_path / "own"))
    assert (tmp_path / "own" / _folder.IN_USE).exists()


def test_a_folder_that_goes_while_the_old_are_sought_is_skipped(folders, monkeypatch):
    list_all = type(folders).iterdir

    def gone_once_listed(folder):
        yield from list_all(folder)
        shutil.rmtree(folders / "03")

    monkeypatch.setattr(type(folders), "iterdir", gone_once_listed)
    monkeypatch.setattr(type(folders), "is_dir", lambda folder: True)
    _folder.prune_folders(folders / "10")
    monkeypatch.undo()
    assert names(folders) == ["01", "02", *(f"{n:02}" for n in range(4, 11))]


def test_a_folder_of_another_user_is_passed_over(folders, monkeypatch):
    lock = _folder.locked

    def refused(path, wait=True):
        if path.parent.name == "00":
            raise PermissionError(path)
        return lock(path, wait)

    monkeypatch.setattr(_folder, "KEPT_FOLDERS", 7)
    monkeypatch.setattr(_folder, "locked", refused)
    _folder.prune_folders(folders / "10")
    assert names(folders)[:2] == ["00", "03"]


def test_only_one_has_a_lock(tmp_path):
    with (
        _folder.locked(tmp_path / "lock") as first,
        _folder.locked(tmp_path / "lock", wait=False) as second,
    ):
        assert first and not second
    with _folder.locked(tmp_path / "lock", wait=False) as third:
        assert third
