"""Scene files that mean harm, or nothing: each is refused by a short sentence, within seconds."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.files.packed_files import in_short, open_regular, read_small

VOLUME = 'volume = "v.nrrd"\n'
LIGHT = '[[lights]]\ntype = "point"\nposition = [1, 2, 3]\nintensity = 1\n'
PROBE = '[[lights]]\ntype = "probe"\nfile = "{}"\n'
SECONDS = 2.0
LONGEST = 1000
TOGETHER = 120

CODE = """
import json, sys, time
from isogi_core.errors import IsogiError
from isogi_core.plan.assembly import load_scene
load_scene("demo:orbital")
for place in sys.argv[1:]:
    begun = time.monotonic()
    try:
        load_scene(place)
        said = ""
    except IsogiError as error:
        said = str(error)
    except BaseException as error:
        said = f"TRACEBACK {type(error).__name__}"
    print(json.dumps([place, said, time.monotonic() - begun]), flush=True)
"""

SCENES = {
    "lists in lists": VOLUME + "x = " + "[" * 50_000,
    "tables in tables": VOLUME + "x = " + "{a = " * 50_000,
    "dots": VOLUME + "[a" + ".a" * 5_000 + "]\n",
    "many digits": VOLUME + "isovalue = " + "9" * 5_000,
    "fewer digits": VOLUME + "bounces = " + "9" * 4_000,
    "hexadecimal digits": VOLUME + "isovalue = 0x" + "f" * 5_000,
    "a number among many": VOLUME + "missing = [" + "9" * 4_000 + "]",
    "a long list": VOLUME + "missing = [" + "1," * 200_000 + "]",
    "NUL in a name": 'volume = "v\\u0000.nrrd"',
    "5 MB in a name": f'volume = "{"x" * 5_000_000}"',
    "a long name": f'volume = "{"x" * 300}"',
    "a long path": f'volume = "{"x/" * 400}v"',
    "a long part": f'volume = "v.nrrd#time={"9" * 3_000}"',
    "5 MB in a key": f'{VOLUME}"{"k" * 5_000_000}" = 1',
    "5 MB in a cut": f'{VOLUME}cut = "{"9" * 5_000_000}>1"',
    "20 MB of comments": VOLUME + "# x\n" * 5_000_000,
    "100,000 lights": VOLUME + LIGHT * 100_000,
    "10,000 lights": VOLUME + LIGHT * 10_000,
    "10,000 masks": VOLUME + '[[volumes]]\nfile = "v.nrrd"\nuse = "mask"\n' * 10_000,
    "a loop of links": 'volume = "loop"',
    "the memory": 'volume = "/proc/self/mem"',
    "endless zeros": 'volume = "/dev/zero"',
    "a pipe": 'volume = "pipe.nrrd"',
    "a pipe as a mask": VOLUME + '[[volumes]]\nfile = "pipe.nrrd"\nuse = "mask"\n',
    "a probe of zeros": VOLUME + PROBE.format("/dev/zero"),
    "a probe of noise": VOLUME + PROBE.format("/dev/urandom"),
    "a probe from a pipe": VOLUME + PROBE.format("pipe.nrrd"),
    "a probe of memory": VOLUME + PROBE.format("/proc/self/mem"),
    "a probe with NUL": VOLUME + PROBE.format("a\\u0000b"),
    "chunks of nothing": 'volume = "nothing.zarr"',
    "a billion chunks": 'volume = "many.zarr"',
    "a huge array": 'volume = "huge.zarr"',
}


def zarr(folder: Path, **facts: Any) -> None:
    """The metadata of an array, without its chunks."""
    folder.mkdir()
    usual = {
        "zarr_format": 2,
        "shape": [8, 8, 8],
        "chunks": [4, 4, 4],
        "dtype": "<f4",
        "order": "C",
    }
    nothing = dict.fromkeys(("compressor", "filters"))
    (folder / ".zarray").write_text(json.dumps({**usual, **nothing, "fill_value": 0, **facts}))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, tuple[str, float]]:
    """What is said of each scene, and after how many seconds; the process is given up where one
    takes for ever.
    """
    folder = tmp_path_factory.mktemp("odd")
    nrrd.write(
        str(folder / "v.nrrd"), np.random.default_rng(1).random((12, 12, 12)).astype(np.float32)
    )
    os.mkfifo(folder / "pipe.nrrd")
    os.mkfifo(folder / "pipe.toml")
    (folder / "loop").symlink_to("loop")
    (folder / "loop.toml").symlink_to("loop.toml")
    zarr(folder / "nothing.zarr", chunks=[0, 4, 4])
    zarr(folder / "many.zarr", shape=[1000, 1000, 1000], chunks=[1, 1, 1])
    zarr(folder / "huge.zarr", shape=[2**40] * 3)
    places = {name: folder / f"{name}.toml" for name in SCENES}
    for name, path in places.items():
        path.write_text(SCENES[name])
    places |= {
        "a scene from a pipe": folder / "pipe.toml",
        "a scene that links to itself": folder / "loop.toml",
    }
    command = [sys.executable, "-c", CODE, *map(str, places.values())]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=TOGETHER,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    told = {
        place: (said, seconds) for place, said, seconds in map(json.loads, done.stdout.splitlines())
    }
    return {
        name: told.get(str(path), (f"DIED: {done.stderr[-300:]}", 0.0))
        for name, path in places.items()
    }


@pytest.mark.parametrize("name", [*SCENES, "a scene from a pipe", "a scene that links to itself"])
def test_an_odd_scene_is_refused_by_a_sentence(
    answers: Mapping[str, tuple[str, float]], name: str
) -> None:
    said, seconds = answers[name]
    assert said.endswith(".") and not said.startswith(("TRACEBACK", "DIED")), said[:300]
    assert len(said) < LONGEST and seconds < SECONDS, (len(said), seconds)


def test_a_few_thousand_lights_are_a_scene(tmp_path: Path) -> None:
    from isogi_core.plan.assembly import load_scene

    nrrd.write(
        str(tmp_path / "v.nrrd"), np.random.default_rng(1).random((12, 12, 12)).astype(np.float32)
    )
    (tmp_path / "a.toml").write_text(
        VOLUME + '[[lights]]\ntype = "constant"\nradiance = 1\n' * 4_000
    )
    assert len(load_scene(tmp_path / "a.toml").source.document["lights"]) == 4_000


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"12345")
    with open_regular(tmp_path / "file") as file:
        assert file.read() == read_small(tmp_path / "file", 5) == b"12345"
    for place in (
        tmp_path / "pipe",
        Path("/dev/zero"),
        Path("a\0b"),
        tmp_path,
        tmp_path / "none",
        tmp_path / ("x" * 300),
    ):
        with pytest.raises(OSError, match=r"\S"):
            open_regular(place)
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_small(tmp_path / "file", 4)


def test_values_are_repeated_in_short() -> None:
    assert in_short("a") == "'a'" and in_short(1.5) == "1.5"
    assert len(in_short("x" * 1000)) == 61
    assert in_short(16**5000) == "a number of many digits, or lists in lists"
