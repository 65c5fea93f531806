"""Readers and writers of other packages: a stranger's works as isogi's do, and a broken one is said
in a sentence and breaks nothing else.
"""

import gzip
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from isogi_core.errors import ViewError, VolumeError
from isogi_core.files.formats.opening import open_file
from isogi_server.cli.command import cli
from isogi_server.exports.lit_files import checked_suffix, write_file
from tests.package.strangers import STRANGER, ball, brick, installed, write_package

DOCS = Path(__file__).resolve().parents[2] / "docs" / "plugins.md"


@pytest.fixture
def stranger() -> Iterator[None]:
    with installed(STRANGER):
        yield


@pytest.mark.usefixtures("stranger")
@pytest.mark.parametrize("name", ["f.brick", "f.other"])
def test_a_strangers_reader_opens_files(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(brick(ball()))
    grid = open_file(tmp_path / name, {})
    np.testing.assert_array_equal(grid.whole(), ball())
    assert tuple(grid.spacing) == (1.0, 1.0, 2.0) and grid.unit == "mm"
    assert grid.read_as == "brick of uint8; it does not say where it lies; read by isogi-brick"
    before = grid.stamp()
    (tmp_path / name).write_bytes(brick(ball(17)))
    assert grid.stamp() != before


def test_without_the_package_the_file_is_unknown(tmp_path: Path) -> None:
    (tmp_path / "f.brick").write_bytes(brick(ball()))
    with pytest.raises(VolumeError, match="is no volume that is known here"):
        open_file(tmp_path / "f.brick", {})


@pytest.mark.usefixtures("stranger")
def test_a_strangers_reader_says_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "f.brick").write_bytes(b"BRICK1 4 4\n")
    with pytest.raises(VolumeError, match="cut off in its first line: write it again"):
        open_file(tmp_path / "f.brick", {})
    (tmp_path / "f.brick").write_bytes(brick(ball())[:-9])
    with pytest.raises(VolumeError, match=r"f\.brick"):
        open_file(tmp_path / "f.brick", {}).whole()
    (tmp_path / "f.brick").write_bytes(gzip.compress(brick(ball())))
    with pytest.raises(VolumeError, match=r"seems to be brick, packed by gzip .*: unpack it first"):
        open_file(tmp_path / "f.brick", {})


@pytest.mark.light
@pytest.mark.usefixtures("stranger")
def test_a_stranger_works_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "f.brick").write_bytes(brick(ball()))
    seen = CliRunner().invoke(cli, ["inspect", str(tmp_path / "f.brick"), "--json"])
    assert seen.exit_code == 0 and "read by isogi-brick" in seen.stdout, seen.output
    work = ["--isovalue", "150", "--target-error", "0.5", "--workers", "1"]
    asked = [str(tmp_path / "f.brick"), *work, "--store", str(tmp_path / "light")]
    size = ["--width", "24", "--height", "18"]
    picture = tmp_path / "f.npy"
    done = CliRunner().invoke(cli, ["render", *asked, *size, "-o", str(picture)])
    assert done.exit_code == 0, done.output
    hit = np.load(picture)
    assert (hit[..., 3] > 0).any() and (hit[hit[..., 3] > 0][:, :3] > 0).any()
    points = tmp_path / "f.points.json"
    done = CliRunner().invoke(cli, ["export", *asked, "-o", str(points)])
    assert done.exit_code == 0, done.output
    rows = np.array([json.loads(line) for line in points.read_text().splitlines()])
    away = np.linalg.norm(rows[:, :3] / (1, 1, 2) - 7.5, axis=1)
    assert rows.shape[1] == 6 and np.abs(away - 4.0).max() < 0.1


def test_the_docs_show_the_reader_that_is_tested() -> None:
    code = (STRANGER / "isogi_brick.py").read_text(encoding="utf-8")
    assert code in DOCS.read_text(encoding="utf-8")
    body = code.split("def points_of")[0]
    assert sum(bool(line.strip()) for line in body.splitlines()) <= 30


KIND = "from isogi.plugins import *\n"
BROKEN = {
    "fails_to_load": ("import nothing_of_that_name\n", "K", "cannot be loaded .*nothing_of_that"),
    "leaves": ("raise SystemExit(3)\n", "K", "cannot be loaded .*SystemExit: 3"),
    "no_kind": ("K = 5\n", "K", "names no Kind by 'no_kind:K'"),
    "letters": (
        KIND + "K = Kind('a', suffixes='.abc', reader='letters:f')\n",
        "K",
        r"cannot be loaded .*suffixes is a tuple of texts: give \('.abc',\)",
    ),
    "no_test": (
        KIND + "K = Kind('a', lambda content: 1 / 0, reader='no_test:f')\n",
        "K",
        "fails to tell kinds .*ZeroDivisionError",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plugin_breaks_no_other_kind(tmp_path: Path, name: str) -> None:
    code, value, said = BROKEN[name]
    place = write_package(tmp_path, name, code, "isogi.readers", f"{name}:{value}")
    np.save(tmp_path / "f.npy", ball())
    (tmp_path / "f.brick").write_bytes(brick(ball()))
    (tmp_path / "f.abc").write_bytes(bytes(9))
    with installed(place, STRANGER):
        np.testing.assert_array_equal(open_file(tmp_path / "f.npy", {}).whole(), ball())
        np.testing.assert_array_equal(open_file(tmp_path / "f.brick", {}).whole(), ball())
        fault = f"The plug-in {name} {said}.*: update or remove that package."
        with pytest.raises(VolumeError, match=fault) as error:
            open_file(tmp_path / "f.abc", {})
        assert str(error.value).count("The plug-in") == 1


FAULTY = {
    "lacks": ("", "AttributeError"),
    "raises": ("def f(source):\n    return {}['a']\n", "KeyError: 'a'"),
    "gives_an_array": ("def f(source):\n    return [1]\n", "it gives list"),
    "too_few": (
        "import numpy as np\ndef f(source):\n    one = np.ones((3, 3, 2))\n"
        "    return Grid((4, 3, 2), np.dtype('u1'), (1, 1, 1), lambda: iter([one]))\n",
        "its slabs do not make up 4 × 3 × 2",
    ),
    "too_many": (
        "import numpy as np\ndef f(source):\n    one = np.ones((3, 3, 2))\n"
        "    return Grid((4, 3, 2), np.dtype('u1'), (1, 1, 1), lambda: iter([one, one]))\n",
        "its slabs do not make up 4 × 3 × 2",
    ),
    "fails_late": (
        "import numpy as np\ndef f(source):\n"
        "    return Grid((4, 3, 2), np.dtype('u1'), (1, 1, 1), lambda: iter([1 / 0]))\n",
        "ZeroDivisionError",
    ),
}


@pytest.mark.parametrize("name", FAULTY)
def test_a_reader_that_fails_is_named(tmp_path: Path, name: str) -> None:
    code, said = FAULTY[name]
    code = f"{KIND}K = Kind('abc', suffixes=('.abc',), reader='{name}:f')\n{code}"
    place = write_package(tmp_path, name, code, "isogi.readers", f"{name}:K")
    (tmp_path / "f.abc").write_bytes(b"123")
    sentence = rf"cannot be read as abc by the plug-in {name} \({said}.*\): update that package"
    with installed(place), pytest.raises(VolumeError, match=sentence):
        open_file(tmp_path / "f.abc", {}).whole()


def test_a_plugin_reads_what_isogi_only_names(tmp_path: Path) -> None:
    code = (
        f"{KIND}K = Kind('VDB', marked(b' BDV'), reader='vdb:f')\nimport numpy as np\n"
        "def f(source):\n    return Grid.of(np.ones((2, 3, 4)))\n"
    )
    place = write_package(tmp_path, "vdb", code, "isogi.readers", "vdb:K")
    (tmp_path / "f.vdb").write_bytes(b" BDV\0\0\0\0")
    with pytest.raises(VolumeError, match="seems to be a sparse grid of OpenVDB"):
        open_file(tmp_path / "f.vdb", {})
    with installed(place):
        assert open_file(tmp_path / "f.vdb", {}).shape == (2, 3, 4)


def test_a_plugin_takes_no_kind_of_isogi(tmp_path: Path) -> None:
    code = f"{KIND}K = Kind('all', lambda content: True, suffixes=('.npy',), reader='greedy:f')\n"
    place = write_package(tmp_path, "greedy", code, "isogi.readers", "greedy:K")
    np.save(tmp_path / "f.npy", ball())
    with installed(place):
        assert open_file(tmp_path / "f.npy", {}).read_as.startswith("NumPy")


def test_a_writer_that_fails_is_named(tmp_path: Path) -> None:
    code = f"{KIND}W = Writer('.abc', 'pens:f')\ndef f(mesh):\n    return 'a text'\n"
    place = write_package(tmp_path, "pens", code, "isogi.writers", "pens:W")
    other = write_package(tmp_path, "torn", "raise KeyError(1)\n", "isogi.writers", "torn:W")
    with pytest.raises(ViewError, match=r"end it in .ply, .*\.zarr\.$"):
        checked_suffix(tmp_path / "f.abc")
    with installed(place, other):
        assert checked_suffix(tmp_path / "f.abc") == ".abc"
        with pytest.raises(ViewError, match=r"plug-in pens \(it gives str, not bytes\): update"):
            write_file(tmp_path / "f.abc", None)  # type: ignore[arg-type]
        with pytest.raises(ViewError, match=r"The plug-in torn cannot be loaded .*KeyError"):
            checked_suffix(tmp_path / "f.xyz")
    assert not (tmp_path / "f.abc").exists()
