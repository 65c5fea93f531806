"""Commands that cannot be done: one line that says why, status 2, and nothing written."""

import re
import shlex
from pathlib import Path

import pytest

from tests.server.asking import Told

PAGE = "publish SCENE -o page --interactive --store ../store"
PREWARM = "prewarm SCENE --store light"
LINES = [
    *[
        (line, "isogi: ")
        for line in ("paint", "render", "render demo:orbital", "inspect", "serve a b")
    ],
    ("exprot demo:casting", "There is no command 'exprot': did you mean 'export'?"),
    (
        "render demo:casting --isovlaue 3",
        "There is no option '--isovlaue': did you mean '--isovalue'?",
    ),
    ("serve --prot 3", "There is no option '--prot': did you mean '--port'?"),
    ("serve --port abc", "port is a whole number, not 'abc'."),
    ("serve --port 99999", "port is at most 65535, not "),
    ("serve --qqqqqqqq", "There is no option '--qqqqqqqq': --help lists all."),
    *[(f"serve demo:orbital --host {host}", "ISOGI_TOKEN") for host in ("0.0.0.0", "::")],
    ("serve demo:orbital --host unix:/run/isogi.sock", "isogi listens at addresses"),
    *[(f"inspect {root}", "is the root of all folders") for root in ("/", "/tmp/..", "//")],
    ("serve --sharp-mb 5", "sharp_mb is called projected_mb now"),
    ("serve --head-seconds 5", "head_seconds is no setting any more, isogi keeps it at 10"),
    ("inspect SCENE --environment moon", "no environment 'moon'"),
    *[
        (f"render SCENE -o a.png --isovalue '{text}'", "isovalue")
        for text in ("nan", "inf", "0.9", "x", "0_5", "")
    ],
    *[(f"render SCENE -o a.png --width={text}", "width") for text in ("0", "-1", "1.5", "99999")],
    *[
        (f"render SCENE -o a.png --target-error {text}", "target-error")
        for text in ("0", "nan", "2")
    ],
    *[(f"render SCENE -o a.png --time={text}", "time") for text in ("-1", "nan", "soon")],
    ("render SCENE -o a.png --shading oil", "shading"),
    ("render SCENE -o a.png --samples 4", "samples"),
    ("render SCENE -o a.png --fov 180", "fov"),
    ("render SCENE -o a.png --eye 1,2", "eye"),
    ("render SCENE -o a.png --workers 0", "workers"),
    *[
        (f"render SCENE -o {name}", name.rpartition("/")[2])
        for name in ("a.gif", "a", "none/a.png")
    ],
    ("reference SCENE -o a.png", "end it in .npz"),
    ("reference SCENE -o gone/a.npz", "gone"),
    ("reference SCENE -o a.npz --samples 8 --target-error 0.1", "keep one"),
    ("reference SCENE -o a.npz --isovalue 9", "isovalue"),
    ("reference SCENE -o a.npz --shading gi", "shading"),
    ("convert demo:casting -o v.ome.zarr", "is no volume of a file"),
    ("convert v.npy -o v.nrrd", "ends in .ome.zarr"),
    ("convert absent.npy -o v.ome.zarr", "There is no file"),
    ("export SCENE -o a.stl", "nd it in .ply, .glb, .obj, .usdz, .vti, .nrrd, .nii.gz, .zarr"),
    ("export SCENE -o no/a.ply", "no folder no"),
    ("export SCENE -o a.ply --isovalue 0.3:0.5", "mesh is of one isovalue"),
    ("export SCENE -o a.vti", "et lattice = 1"),
    ("export SCENE -o a.ply --yaw 0:90", "first:last:step"),
    ("export SCENE -o a.ply --yaw 0:360:0.1", "1,000 at most"),
    ("film SCENE -o a.avi", "end it in .gif, .webp, .mp4"),
    ("film SCENE -o no/a.gif", "folder"),
    ("publish SCENE -o out --megabytes 4", "--interactive"),
    (f"{PAGE} --window 'x>4'", "window"),
    (f"{PAGE} --azimuth 0:90:30", "azimuth 0:90:30"),
    (f"{PAGE} --time 5", "--time"),
    (f"{PAGE} --isovalue 0.1:0.6", "isovalue"),
    (f"{PAGE} --background '#102030'", "light or dark"),
    (f"{PAGE} --isovalue 0.4:0.6 --target-error 0.3 --megabytes 0.1", "the page alone"),
    (f"{PAGE.replace('SCENE', 'demo:orbital#material=subsurface')}", "Publish pictures"),
    *[
        (f"store prune . {words}", "isogi: ")
        for words in ("", "--older-than soon", "--keep-gb=-1", "--older-than=-1d")
    ],
    *[(f"{PREWARM} --continue {words}", "--continue") for words in ("--views 3", "--dry-run")],
    (f"{PREWARM} --detach", "--detach"),
    ("prewarm SCENE --server http://127.0.0.1:1 --workers 2", "--workers"),
    (f"{PREWARM} --isovalue 0.4:0.9:0.1", "isovalue must be a number from 0.2 to 0.8"),
    (f"{PREWARM} --isovalue 0.4:0.5", "isovalues 0.4:0.5 means every isovalue between"),
    (f"{PREWARM} --views none", "views"),
    (f"{PREWARM} --deadline soon", "deadline"),
]


@pytest.mark.parametrize(("line", "words"), LINES, ids=[line for line, _ in LINES])
def test_what_cannot_be_done_is_told_and_writes_nothing(
    told: Told,
    inline: None,
    small_scene: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    line: str,
    words: str,
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.delenv("ISOGI_TOKEN", raising=False)
    *bars, said = told(
        *(word.replace("SCENE", str(small_scene)) for word in shlex.split(line)), status=2
    ).splitlines()
    assert said.startswith("isogi: ") and words in said
    assert not [bar for bar in bars if not re.search(r", \d\d:\d\d", bar)], "one line, but for bars"
    assert not any(Path().iterdir())


@pytest.mark.parametrize("command", ["inspect", "prewarm", "render", "serve", "reference"])
@pytest.mark.parametrize("target", ["none.nrrd", "none.nhdr", "none.toml", "demo:none", "folder"])
def test_a_target_that_is_missing_is_told(
    told: Told, tmp_path: Path, command: str, target: str
) -> None:
    (tmp_path / "folder").mkdir()
    if target.startswith("demo:"):
        path = target
    else:
        path = str(tmp_path / target)
    output = {"render": "a.png", "reference": "a.npz"}.get(command)
    if output:
        more = ["-o", str(tmp_path / output)]
    else:
        more = []
    assert Path(path).name in told(command, path, *more, status=2)
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


HEADER = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {sizes}\nencoding: raw\n\n"


@pytest.mark.parametrize(
    ("sizes", "held"),
    [("8 8 8", 100), ("8 8 8", 0), ("100000 100000 100000", 512), ("0 8 8", 0), ("-8 8 8", 512)],
)
def test_a_volume_that_is_cut_short_or_lies_is_told(
    told: Told, tmp_path: Path, sizes: str, held: int
) -> None:
    volume = tmp_path / "lie.nrrd"
    volume.write_bytes(HEADER.format(sizes=sizes).encode() + b"\x07" * held)
    assert "lie.nrrd" in told("inspect", volume, status=2)
    told("render", volume, "-o", tmp_path / "lie.png", status=2)
    assert not (tmp_path / "lie.png").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("prot = 8123", "There is no setting 'prot': did you mean 'port'?"),
        ("colour = 1", "colour"),
        ("port =", "isogi-server.toml"),
        ("sharp_mb = 5", "sharp_mb is called projected_mb now"),
        ("max_body_bytes = 5", "max_body_bytes is no setting any more, isogi keeps it at 65536"),
        (None, "isogi-server.toml"),
    ],
)
def test_a_file_of_settings_that_is_wrong_is_told(
    told: Told, tmp_path: Path, text: str | None, words: str
) -> None:
    if text is not None:
        (tmp_path / "isogi-server.toml").write_text(text)
    assert words in told("serve", "--config", tmp_path / "isogi-server.toml", status=2)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ISOGI_PORT", "many", "port"),
        ("ISOGI_SHARP_MB", "5", "sharp_mb is called projected_mb now"),
        ("ISOGI_STREAM_RATE", "5", "stream_rate is no setting any more, isogi keeps it at 600"),
        ("ISOGI_TOKEN", "hunter2", "token"),
    ],
)
def test_a_variable_that_is_wrong_is_told_without_its_secret(
    told: Told, monkeypatch: pytest.MonkeyPatch, name: str, value: str, words: str
) -> None:
    monkeypatch.setenv(name, value)
    said = told("serve", "demo:orbital", status=2)
    assert words in said and "hunter2" not in said


def test_a_file_is_not_blamed_for_a_variable(
    told: Told, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "isogi-server.toml").write_text("port = 8123")
    monkeypatch.setenv("ISOGI_SHARP_MB", "5")
    said = told("serve", "--config", tmp_path / "isogi-server.toml", status=2)
    assert "ISOGI_SHARP_MB: sharp_mb is called" in said and ".toml" not in said


def test_a_port_in_use_is_a_failure(told: Told, small_scene: Path, live_server: str) -> None:
    port = live_server.rpartition(":")[2]
    said = told("serve", small_scene, "--port", port, status=1)
    assert said == f"isogi: Cannot listen on 127.0.0.1 port {port}: Address already in use.\n"
