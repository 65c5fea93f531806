"""The command line: what it prints, what it writes, and the status it leaves with."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from isogi_core.files.radiance import write_hdr
from isogi_core.plan.assembly import load_scene
from isogi_core.storage.atomic_file import write_whole
from server.cli.command import VIEW_OPTIONS, WORK_OPTIONS, run
from server.cli.render import rendered
from server.parameters import FrameParams
from server.settings import Settings

SIZE = ["--width", "24", "--height", "20"]


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The line on stderr of a command that ends with status 2."""
    assert run([str(argument) for argument in arguments]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert error.startswith("isogi: ")
    return error


def test_help_is_quick_to_import() -> None:
    heavy = ("numba", "numpy", "fastapi", "pydantic", "distributed", "zarr", "PIL")
    code = "import sys; from server.cli.command import run; run(['--help']);"
    code += f"print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")
    assert "serve" in done.stdout


def test_options_are_those_of_http_and_of_the_settings() -> None:
    http_only = {"wait_ms", "max_error", "f", "version", "strip"}
    of_the_target = {"environment", "cut", "time", "surfaces", "hide", "material"}
    assert set(VIEW_OPTIONS) == set(FrameParams.model_fields) - http_only - of_the_target
    assert set(WORK_OPTIONS) <= set(Settings.model_fields)


@pytest.mark.parametrize(
    "arguments",
    [
        ["paint"],
        ["render"],
        ["render", "demo:orbital"],
        ["serve", "--frob"],
        ["inspect"],
        ["serve", "a", "b"],
    ],
)
def test_wrong_use(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    refused(capsys, *arguments)


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (["exprot", "demo:casting"], "There is no command 'exprot': did you mean 'export'?"),
        (["render", "demo:casting", "--isovlaue", "3"], "There is no option '--isovlaue': did you mean '--isovalue'?"),
        (["serve", "--prot", "3"], "There is no option '--prot': did you mean '--port'?"),
        (["serve", "--qqqqqqqq"], "There is no option '--qqqqqqqq': --help lists all."),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest(
    capsys: pytest.CaptureFixture[str], arguments: list[str], answer: str
) -> None:
    assert refused(capsys, *arguments) == f"isogi: {answer}\n"


@pytest.mark.parametrize("target", ["none.nhdr", "demo:none", "small.zarr#time=3"])
def test_a_file_in_place_of_a_command_is_served(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, target: str) -> None:
    served: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("server.cli.serve.serve", lambda target, settings: served.append(f"{target} {settings.port}"))
    monkeypatch.setattr("server.cli.command.start_fork_server", lambda: None)
    assert run([target, "--port", "8123"]) == 0
    assert served == [f"{target} 8123"]


@pytest.mark.parametrize("command", ["inspect", "prewarm", "render", "serve", "reference"])
@pytest.mark.parametrize("target", ["none.nrrd", "none.nhdr", "none.toml", "demo:none", "folder"])
def test_a_missing_target(capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str, target: str) -> None:
    (tmp_path / "folder").mkdir()
    path = target if target.startswith("demo:") else str(tmp_path / target)
    output = {"render": "a.png", "reference": "a.npz"}.get(command)
    more = ["-o", str(tmp_path / output)] if output else []
    assert Path(path).name in refused(capsys, command, path, *more)
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


HEADER = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {sizes}\nencoding: raw\n\n"


@pytest.mark.parametrize(
    ("sizes", "held"),
    [("8 8 8", 100), ("8 8 8", 0), ("100000 100000 100000", 512), ("0 8 8", 0), ("-8 8 8", 512)],
)
def test_a_truncated_or_lying_volume(capsys: pytest.CaptureFixture[str], tmp_path: Path, sizes: str, held: int) -> None:
    volume = tmp_path / "lie.nrrd"
    volume.write_bytes(HEADER.format(sizes=sizes).encode() + b"\x07" * held)
    assert "lie.nrrd" in refused(capsys, "inspect", volume)
    refused(capsys, "render", volume, "-o", tmp_path / "lie.png")
    assert not (tmp_path / "lie.png").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *[("--isovalue", text) for text in ("nan", "inf", "0.9", "x", "0_5", "")],
        *[("--width", text) for text in ("0", "-1", "1.5", "99999")],
        *[("--target-error", text) for text in ("0", "nan", "2")],
        *[("--time", text) for text in ("-1", "nan", "soon")],
        *[("--shading", "oil"), ("--samples", "4"), ("--fov", "180"), ("--eye", "1,2"), ("--workers", "0")],
    ],
)
def test_bad_options_write_nothing(
    capsys: pytest.CaptureFixture[str], small_scene: Path, tmp_path: Path, option: str, value: str
) -> None:
    line = refused(capsys, "render", small_scene, "-o", tmp_path / "a.png", option, value)
    assert option.strip("-") in line
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.gif", "a", "none/a.png"])
def test_bad_outputs(capsys: pytest.CaptureFixture[str], small_scene: Path, tmp_path: Path, name: str) -> None:
    assert name.rpartition("/")[2] in refused(capsys, "render", small_scene, "-o", tmp_path / name)


def test_a_bad_setting_in_the_environment(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, small_scene: Path
) -> None:
    monkeypatch.setenv("ISOGI_PORT", "many")
    assert "port" in refused(capsys, "serve", small_scene)


def test_a_port_in_use_is_a_failure(capsys: pytest.CaptureFixture[str], small_scene: Path, live_server: str) -> None:
    port = live_server.rpartition(":")[2]
    assert run(["serve", str(small_scene), "--port", port]) == 1
    assert capsys.readouterr().err == f"isogi: Cannot listen on 127.0.0.1 port {port}: Address already in use.\n"


def test_inspect(capsys: pytest.CaptureFixture[str], small_scene: Path) -> None:
    assert run(["inspect", str(small_scene), "--plan"]) == 0
    text = capsys.readouterr().out
    for fact in ("24 × 20 × 16 voxels of float32", "0.5, from 0.2 to 0.8", "constant, sky", "left out", "█"):
        assert fact in text


def test_inspect_tells_the_plan_and_what_it_saves(capsys: pytest.CaptureFixture[str], small_scene: Path) -> None:
    assert run(["inspect", str(small_scene), "--plan"]) == 0
    lines = capsys.readouterr().out.splitlines()
    scene = load_scene(small_scene)
    plan, texels = scene.plan, scene.texels
    assert f"texel         {plan.bytes_per_texel} bytes, beside 300 for any scene in S1" in lines
    assert sum(line.startswith("layer ") for line in lines) == len(plan.layers)
    shown = f"{texels.shown:,} of {texels.total:,} can be shown"
    assert any(line.startswith("texels ") and shown in line for line in lines)
    for each in scene.left_out:
        line = next(number for number, line in enumerate(lines) if line.startswith(f"  {each.what} "))
        assert all(saved.unit in lines[line] for saved in each.saves)
        assert lines[line + 1].strip() == each.why


def test_inspect_as_json_is_what_http_says(
    capsys: pytest.CaptureFixture[str], small_scene: Path, live_server: str
) -> None:
    while "compiling" in httpx.get(f"{live_server}/readyz").json():  # which is a note of the plan
        time.sleep(0.1)
    assert run(["inspect", str(small_scene), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document.pop("stiffness")
    assert document == httpx.get(f"{live_server}/v1/scenes/small").json()


def test_a_command_is_given_other_light(capsys: pytest.CaptureFixture[str], small_scene: Path, tmp_path: Path) -> None:
    write_hdr(tmp_path / "a&b.hdr", np.ones((4, 8, 3)))
    for given, light in (("overcast", "Overcast sky"), (tmp_path / "a&b.hdr", "probe a&b.hdr")):
        assert run(["inspect", str(small_scene), "--environment", str(given), "--json"]) == 0
        assert [each["name"] for each in json.loads(capsys.readouterr().out)["lights"]] == [light]
    assert "no environment 'moon'" in refused(capsys, "inspect", small_scene, "--environment", "moon")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("store")


@pytest.fixture
def told(inline: None, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command prints that succeeds in this process, which bakes by itself."""

    def told(*arguments: object) -> str:
        capsys.readouterr()
        status = run([str(argument) for argument in arguments])
        out, error = capsys.readouterr()
        assert status == 0, error
        return out

    return told


def isogi(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "server", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_another_albedo_is_rendered_of_the_same_light(
    told: Callable[..., str], small_scene: Path, tmp_path: Path
) -> None:
    scene = small_scene.with_name("dyed.toml")
    scene.write_text(f"albedo = 0.3\nalbedos = [0, 0.9]\n{small_scene.read_text()}")
    work, pictures = ("--workers", 1, "--store", tmp_path / "store", "--json"), []
    for name, albedo in (("own.npy", ()), ("red.npy", ("--albedo", "0.9,0.3,0"))):
        facts = json.loads(told("render", scene, "-o", tmp_path / name, *SIZE, *albedo, *work))
        assert (facts["paths"] > 0) == (name == "own.npy"), "no path is taken for it"
        pictures.append(np.load(tmp_path / name)[..., :3].mean(axis=(0, 1)))
    np.testing.assert_allclose(pictures[1] / pictures[0], [3.0, 1.0, 0.0], rtol=0.05)


def test_render_writes_a_final_picture_and_tells_so(small_scene: Path, store: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.npy"
    done = isogi("render", small_scene, "-o", output, *SIZE, "--workers", 1, "--store", store, "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    planes = np.load(output)
    assert planes.shape == (20, 24, 9)
    surface = int((planes[..., 4] > 0).sum())
    assert facts["pixels"] == {"surface": surface, "final": surface, "converging": 0, "provisional": 0}
    assert (facts["target_error"], facts["final"], facts["stopped"]) == (0.5, 1.0, "target")
    assert facts["paths"] >= 64 and 0.0 < facts["error"] <= 0.5
    assert (facts["provisional"], facts["format"], facts["file"]) == (False, "npy", str(output))
    assert "100 %" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["a.npy"]
    assert any("/c/" in path.as_posix() for path in store.rglob("*"))


def test_path_traced_is_answered_with_its_samples_and_error(
    told: Callable[..., str], small_scene: Path, store: Path, tmp_path: Path
) -> None:
    output, traced = tmp_path / "a.png", ("--shading", "path_traced", "--samples", "16", "--target-error", "0.0001")
    line = told("render", small_scene, "-o", output, *SIZE, *traced, "--workers", 1, "--store", store, "--json")
    facts = json.loads(line)
    assert (facts["stopped"], facts["provisional"]) == ("samples", True)
    assert 0.0001 < facts["error"] < 1.0
    assert rendered(facts).startswith(f"{output}: 24 × 20, all samples taken, error {facts['error']:.4f}")


def test_render_in_no_time_says_how_far_it_came(
    told: Callable[..., str], small_scene: Path, store: Path, tmp_path: Path
) -> None:
    output = tmp_path / "a.jpg"
    line = told("render", small_scene, "-o", output, *SIZE, "--time", 0, "--workers", 1, "--store", store)
    assert line.startswith(f"{output}: 24 × 20, ")
    assert "of the surface at 0.5" in line
    assert Image.open(io.BytesIO(output.read_bytes())).format == "JPEG"


def test_a_write_that_fails_leaves_the_old_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(tmp_path / "a.png", b"new")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("a.png", b"old")]


@pytest.fixture
def serving(small_scene: Path, store: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A ``serve`` process and the address that it printed."""
    command = [sys.executable, "-m", "server", "serve", str(small_scene), "--port", "0"]
    command += ["--workers", "1", "--store", str(store)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        line = process.stdout.readline()
        yield process, line.removeprefix("isogi is ready at ").strip()
        process.kill()


def test_serve_is_ready_when_it_says_so_and_stops_cleanly(serving: tuple[subprocess.Popen[str], str]) -> None:
    """By Ctrl-C; SIGTERM comes to a server at work in ``tests/server/api/guards/test_stop.py``."""
    process, url = serving
    assert httpx.get(f"{url}readyz").status_code == 200
    assert httpx.get(f"{url}v1/scenes/small/frame?width=8&height=8").status_code == 200
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    assert (process.returncode, out, error) == (0, "", "")


def test_a_reference_is_grown_in_its_file(
    capsys: pytest.CaptureFixture[str], small_scene: Path, tmp_path: Path
) -> None:
    path, told = tmp_path / "a.npz", []
    for samples in ("16", "64", "32"):
        assert run(["reference", str(small_scene), "-o", str(path), *SIZE, "--samples", samples, "--json"]) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert [each["samples"] for each in told] == [16, 64, 64] and told[1] == told[2]
    assert told[0]["noise"] > told[1]["noise"] > 0.0 and told[0]["bounces"] == 19
    with np.load(path) as file:
        assert file["mean"].shape == (20, 24, 3) and int(file["on"].sum()) == told[0]["surface"]
    assert [each.name for each in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["-o", "a.png"], "end it in .npz"),
        (["-o", "gone/a.npz"], "gone"),
        (["-o", "a.npz", "--samples", "8", "--target-error", "0.1"], "keep one"),
        (["-o", "a.npz", "--isovalue", "9"], "isovalue"),
        (["-o", "a.npz", "--shading", "gi"], "shading"),
    ],
)
def test_a_reference_that_cannot_be(
    capsys: pytest.CaptureFixture[str],
    small_scene: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    word: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert word in refused(capsys, "reference", small_scene, *arguments)
    assert not list(tmp_path.iterdir())
