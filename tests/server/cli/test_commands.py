"""The command line: what it prints, what it writes, and the status it leaves with."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from isogi_core.files.radiance import write_hdr
from isogi_core.model.view import Camera, View
from isogi_core.plan.assembly import load_scene
from isogi_core.storage.atomic_file import write_whole
from isogi_server.cli.arguments import VIEW_OPTIONS
from isogi_server.cli.command import WORK_OPTIONS, run
from isogi_server.cli.reel import Reel
from isogi_server.cli.render import rendered, stopped_by
from isogi_server.parameters import FrameParams, read
from isogi_server.progress import open_scene
from isogi_server.settings import Settings
from tests.server.asking import Told

SIZE = ["--width", "24", "--height", "20"]


def test_help_is_quick_to_import() -> None:
    heavy = ("numba", "numpy", "fastapi", "pydantic", "distributed", "zarr", "PIL")
    code = "import sys; from isogi_server.cli.command import run; run(['--help']);"
    code += f"print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")
    assert "serve" in done.stdout


def test_options_are_those_of_http_and_of_the_settings() -> None:
    http_only = {"wait_ms", "max_error", "f", "version", "strip"}
    of_the_target = {"environment", "cut", "time", "surfaces", "hide", "material", "smooth"}
    assert set(VIEW_OPTIONS) == set(FrameParams.model_fields) - http_only - of_the_target
    assert set(WORK_OPTIONS) <= set(Settings.model_fields)


@pytest.mark.parametrize("target", ["none.nhdr", "demo:none", "small.zarr#time=3"])
def test_a_file_in_place_of_a_command_is_served(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, target: str
) -> None:
    served: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "isogi_server.cli.serve.serve",
        lambda target, settings: served.append(f"{target} {settings.port}"),
    )
    monkeypatch.setattr("isogi_server.cli.command.start_fork_server", lambda: None)
    assert run([target, "--port", "8123"]) == 0
    assert served == [f"{target} 8123"]


def test_inspect_tells_facts_the_plan_and_what_it_saves(told: Told, small_scene: Path) -> None:
    lines = told("inspect", small_scene, "--plan").splitlines()
    for fact in (
        "24 × 20 × 16 voxels of float32",
        "0.5, from 0.2 to 0.8",
        "constant, sky",
        "left out",
        "█",
    ):
        assert any(fact in line for line in lines), fact
    scene = load_scene(small_scene)
    plan = scene.plan
    texels = scene.texels
    assert (
        f"texel         {plan.bytes_per_texel} bytes, instead of 300 for any scene in S1" in lines
    )
    assert sum(line.startswith("layer ") for line in lines) == len(plan.layers)
    shown = f"{texels.shown:,} of {texels.total:,} can be shown"
    assert any(line.startswith("texels ") and shown in line for line in lines)
    for each in scene.left_out:
        line = next(
            number for number, line in enumerate(lines) if line.startswith(f"  {each.what} ")
        )
        assert all(saved.unit in lines[line] for saved in each.saves)
        assert lines[line + 1].strip() == each.why


def test_inspect_as_json_is_what_http_says(told: Told, small_scene: Path, live_server: str) -> None:
    while "compiling" in httpx.get(f"{live_server}/readyz").json():  # which is a note of the plan
        time.sleep(0.1)
    document = json.loads(told("inspect", small_scene, "--json"))
    assert document.pop("stiffness")
    assert document == httpx.get(f"{live_server}/v1/scenes/small").json()


def test_a_command_is_given_other_light(told: Told, small_scene: Path, tmp_path: Path) -> None:
    write_hdr(tmp_path / "a&b.hdr", np.ones((4, 8, 3)))
    for given, light in (("overcast", "Overcast sky"), (tmp_path / "a&b.hdr", "probe a&b.hdr")):
        facts = json.loads(told("inspect", small_scene, "--environment", given, "--json"))
        assert [each["name"] for each in facts["lights"]] == [light]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("store")


def python(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Python in a process of its own, which has ended."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.usefixtures("inline")
def test_another_albedo_is_rendered_of_the_same_light(
    told: Told, small_scene: Path, tmp_path: Path
) -> None:
    scene = small_scene.with_name("dyed.toml")
    scene.write_text(f"albedo = 0.3\nalbedos = [0, 0.9]\n{small_scene.read_text()}")
    work = ("--workers", 1, "--store", tmp_path / "store", "--json")
    pictures = []
    for name, albedo in (("own.npy", ()), ("red.npy", ("--albedo", "0.9,0.3,0"))):
        facts = json.loads(told("render", scene, "-o", tmp_path / name, *SIZE, *albedo, *work))
        assert (facts["paths"] > 0) == (name == "own.npy"), "no path is taken for it"
        pictures.append(np.load(tmp_path / name)[..., :3].mean(axis=(0, 1)))
    np.testing.assert_allclose(pictures[1] / pictures[0], [3.0, 1.0, 0.0], rtol=0.05)


def test_render_writes_a_final_picture_and_tells_so(
    small_scene: Path, store: Path, tmp_path: Path
) -> None:
    output = tmp_path / "a.npy"
    done = python(
        "-m",
        "server",
        "render",
        small_scene,
        "-o",
        output,
        *SIZE,
        "--workers",
        1,
        "--store",
        store,
        "--json",
    )
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    planes = np.load(output)
    assert planes.shape == (20, 24, 9)
    surface = int((planes[..., 4] > 0).sum())
    assert facts["pixels"] == {
        "surface": surface,
        "final": surface,
        "converging": 0,
        "provisional": 0,
    }
    assert (facts["target_error"], facts["final"], facts["stopped"]) == (0.5, 1.0, "target")
    assert facts["paths"] >= 64 and 0.0 < facts["error"] <= 0.5
    assert (facts["provisional"], facts["format"], facts["file"]) == (False, "npy", str(output))
    assert "100 %" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["a.npy"]
    assert any("/c/" in path.as_posix() for path in store.rglob("*"))


@pytest.mark.usefixtures("inline")
def test_path_traced_is_answered_with_its_samples_and_error(
    told: Told, small_scene: Path, store: Path, tmp_path: Path
) -> None:
    output = tmp_path / "a.png"
    traced = ("--shading", "path_traced", "--samples", "16", "--target-error", "0.0001")
    line = told(
        "render",
        small_scene,
        "-o",
        output,
        *SIZE,
        *traced,
        "--workers",
        1,
        "--store",
        store,
        "--json",
    )
    facts = json.loads(line)
    assert (facts["stopped"], facts["provisional"]) == ("samples", True)
    assert 0.0001 < facts["error"] < 1.0
    assert rendered(facts).startswith(
        f"{output}: 24 × 20, all samples taken, error {facts['error']:.4f}"
    )


@pytest.mark.usefixtures("inline")
def test_render_in_no_time_says_how_far_it_came(
    told: Told, small_scene: Path, store: Path, tmp_path: Path
) -> None:
    output = tmp_path / "a.jpg"
    line = told(
        "render", small_scene, "-o", output, *SIZE, "--time", 0, "--workers", 1, "--store", store
    )
    assert line.startswith(f"{output}: 24 × 20, ")
    assert "of the surface at 0.5" in line
    assert Image.open(io.BytesIO(output.read_bytes())).format == "JPEG"


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize(
    ("most", "options", "said"),
    [
        (255, ["--isovalue", 255], "No surface at 255: values go from 0 to 255, choose an"),
        (255, ["--isovalue", 9, "--window", "x>-100"], "No surface at 9 in what the cut leaves"),
        (0, [], "No surface: all values are 0."),
    ],
)
def test_a_picture_without_a_surface_says_why(
    told: Told, store: Path, tmp_path: Path, most: int, options: list[str], said: str
) -> None:
    values = np.linspace(0, most, 512).reshape(8, 8, 8).round().astype(np.uint8)
    np.save(tmp_path / "ramp.npy", values)
    asked = ("render", tmp_path / "ramp.npy", "-o", tmp_path / "a.png", *SIZE, *options)
    assert said in told(*asked, "--workers", 1, "--store", store)
    facts = json.loads(told(*asked, "--workers", 1, "--store", store, "--json"))
    assert (facts["error"], facts["stopped"]) == (0.0, "target") and said in facts["note"]


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"interval": (0.015, 0.023)}, "provisional, between 0.0150 and 0.0230, error 0.0180"),
        ({"interval": None}, "provisional, not measured yet, error 0.0180"),
        ({"p99": 0.12}, "provisional, 1 % of pixels off by more than 0.1200, error 0.0180"),
        ({"error": 0.021}, "provisional, error 0.0210"),
    ],
)
def test_a_provisional_picture_below_its_target_says_why(known: dict[str, Any], said: str) -> None:
    facts = {"file": "a.png", "width": 9, "height": 9, "stopped": "time", "note": "", "final": 1.0}
    below = {"error": 0.018, "target_error": 0.02, "interval": (0.015, 0.019), "p99": 0.05}
    assert rendered({**facts, **below, **known}).startswith(f"a.png: 9 × 9, {said}")


def test_what_ended_without_a_deadline_does_not_name_the_time() -> None:
    """The check of the picture has taken all steps that there are."""
    camera = Camera((9.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    view = View(isovalue=0.5, camera=camera, width=1, height=1)
    ended = SimpleNamespace(final=False, view=view, provisional=False, given_up=True)
    assert stopped_by(ended) == "paths"  # type: ignore[arg-type]
    facts = {"file": "a.png", "width": 9, "height": 9, "stopped": "paths", "note": "", "final": 0.0}
    below = {"error": 0.018, "target_error": 0.02, "interval": (0.015, 0.03), "p99": 0.05}
    assert "after all paths that its pixels may take" in rendered({**facts, **below})


def test_an_output_that_cannot_be_written_is_said_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before any light is baked; and nothing is left of the trial."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr("isogi_server.cli.render.working", lambda *_: pytest.fail("it was begun"))
    (tmp_path / "a.png").write_bytes(b"old")
    assert run(["render", "demo:orbital", "-o", str(tmp_path / "a.png"), *SIZE]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.endswith(
        "a.png cannot be written (No space left on device): make room for 480 bytes, or name "
        "another place."
    )
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("a.png", b"old")]


def test_a_render_whose_store_is_full_fails_with_a_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = {"file": "a.png", "width": 9, "height": 9, "stopped": "time", "note": "", "final": 0.5}
    known = {"error": 0.5, "target_error": 0.02, "interval": None, "p99": None}
    full = {"trouble": "The store is full: make room, and baking goes on."}
    monkeypatch.setattr("isogi_server.cli.render.render", lambda *_: {**facts, **known, **full})
    assert run(["render", "demo:orbital", "-o", "a.png"]) == 1
    said = capsys.readouterr()
    assert "provisional" in said.out
    assert (
        said.err
        == "isogi: The light is not complete. The store is full: make room, and baking goes on.\n"
    )


FILM = ["film", "demo:orbital", "--length", "1", "--fps", "2", "--width", "32", "--height", "32"]


@pytest.mark.parametrize(
    ("command", "output"),
    [
        (["export", "demo:orbital"], "a.ply"),
        (["export", "demo:orbital", "--yaw", "0:180:90"], "a.nrrd"),
        (FILM, "a.gif"),
        (FILM, "pictures"),
        (["publish", "demo:orbital", *SIZE], "page"),
        (["publish", "demo:orbital", "--interactive"], "page"),
        (["publish", "demo:orbital", "--interactive"], "page.html"),
    ],
)
def test_long_work_checks_its_output_first(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: list[str],
    output: str,
) -> None:
    """On a full disk, before any light is baked; and nothing is left of the trial."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    for module in ("reel", "prewarm", "publish_live"):
        monkeypatch.setattr(
            f"isogi_server.cli.{module}.working", lambda *_, **__: pytest.fail("begun")
        )
    assert run([*command, "-o", str(tmp_path / output)]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "cannot be written (No space left on device): make room" in error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("work", ["export", "film", "publish"])
def test_work_whose_store_is_full_fails_with_a_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], work: str
) -> None:
    facts = {"file": "a", "trouble": "The store is full: make room, and baking goes on."}
    monkeypatch.setattr(f"isogi_server.cli.{work}.{work}", lambda *_: facts)
    assert run([work, "demo:orbital", "-o", "a", "--json"]) == 1
    said = capsys.readouterr()
    assert json.loads(said.out) == facts
    assert (
        said.err
        == "isogi: The light is not complete. The store is full: make room, and baking goes on.\n"
    )


def test_pictures_tell_why_no_more_light_came(tmp_path: Path) -> None:
    """A film within a limit of time, whose store is full."""
    scene = open_scene("demo:orbital", Settings())
    shot = read(FrameParams, {"width": "8", "height": "8", "f": "png"}.items())
    reel = Reel(tmp_path, scene, {"a.png": shot})
    engine = SimpleNamespace(
        store=SimpleNamespace(read_only=False),
        trouble=lambda: "",
        baker=SimpleNamespace(paused=lambda: "The store is full."),
    )
    reel.keep("a.png", b"", {"error": 0.5, "final": False})
    reel.note_trouble(engine)  # type: ignore[arg-type]
    assert reel.summary()["trouble"] == "The store is full."
    reel.keep("a.png", b"", {"error": 0.01, "final": True})
    reel.note_trouble(engine)  # type: ignore[arg-type]
    assert reel.summary()["trouble"] == ""


def test_a_full_disk_is_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("isogi_server.cli.render.render", full)
    assert run(["render", "demo:orbital", "-o", "a.png"]) == 1
    assert capsys.readouterr().err == (
        "isogi: The output cannot be written (No space left on device): make room, and run the "
        "command again.\n"
    )


def test_a_write_that_fails_leaves_the_old_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
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
    command = [sys.executable, "-m", "isogi_server", "serve", str(small_scene), "--port", "0"]
    command += ["--workers", "1", "--store", str(store)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        line = process.stdout.readline()
        yield process, line.removeprefix("isogi is ready at ").strip()
        process.kill()


def test_serve_is_ready_when_it_says_so_and_stops_cleanly(
    serving: tuple[subprocess.Popen[str], str],
) -> None:
    """By Ctrl-C; SIGTERM comes to a server at work in ``tests/server/api/guards/test_stop.py``."""
    process, url = serving
    assert httpx.get(f"{url}bakez").status_code == 200
    assert httpx.get(f"{url}v1/scenes/small/frame?width=8&height=8").status_code == 200
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    assert (process.returncode, out, error) == (0, "", "")


def test_a_reference_is_grown_in_its_file(told: Told, small_scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    command = ["reference", small_scene, "-o", path, *SIZE, "--json", "--samples"]
    first, second, third = (json.loads(told(*command, samples)) for samples in (16, 64, 32))
    assert [each["samples"] for each in (first, second, third)] == [16, 64, 64] and second == third
    assert first["noise"] > second["noise"] > 0.0 and first["bounces"] == 19
    with np.load(path) as file:
        assert file["mean"].shape == (20, 24, 3) and int(file["on"].sum()) == first["surface"]
    assert [each.name for each in tmp_path.iterdir()] == ["a.npz"]


STOPPED_WHILE_IT_STARTS = """
import errno, os, signal, sys, time
from isogi_server.cli.command import run
from isogi_server.render.engine import RenderEngine

def start(engine, *_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)
    raise OSError(errno.EBADF, os.strerror(errno.EBADF))

RenderEngine.open = RenderEngine.start = start
RenderEngine.start_workers = lambda engine: None
sys.exit(run(["serve", sys.argv[1], "--port", "0", "--store", sys.argv[2]]))
"""

INTERRUPTED = """
import os, signal, sys
from importlib import import_module
from isogi_worker.fork_server import PRELOADED_MODULES

class Interrupt:
    def find_spec(self, name, *_):
        if name == "isogi_worker.tasks":
            os.kill(os.getpid(), signal.SIGINT)
            print("interrupted")

sys.meta_path.insert(0, Interrupt())
for name in PRELOADED_MODULES:
    import_module(name)
"""


def test_a_server_that_is_stopped_early_says_one_line(small_scene: Path, tmp_path: Path) -> None:
    done = python("-c", STOPPED_WHILE_IT_STARTS, str(small_scene), str(tmp_path))
    said = [
        line for line in done.stderr.splitlines() if line and "compiling" not in line
    ]  # a bar may be there
    assert (done.returncode, done.stdout, said) == (0, "", ["isogi: stopped before it was ready"])


def test_an_interrupt_does_not_end_the_fork_server() -> None:
    done = python("-c", INTERRUPTED)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
