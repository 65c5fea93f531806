"""docs/client.md and docs/notebook.ipynb: their examples run, against a live server, in their
order.
"""

import ast
import contextlib
import importlib.util
import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from isogi.client import Frame, Isogi, srgb_of
from tests.server.sockets import wait_for

PAGE = Path(__file__).resolve().parents[2] / "docs" / "client.md"
HERE = "http://127.0.0.1:8000"


def blocks(kind: str) -> list[str]:
    """The page's blocks of code of a kind."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def size_of(path: Path) -> tuple[int, int, int]:
    """Width, height and pictures of a file."""
    with Image.open(path) as image:
        return *image.size, getattr(image, "n_frames", 1)


def test_python(own_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    said = io.StringIO()
    code = "".join(blocks("python"))
    assert code.count(HERE) == 1
    with contextlib.redirect_stdout(said):
        exec(compile(code.replace(HERE, own_server), str(PAGE), "exec"), names)
    if "viewer" in names:
        names["viewer"].close()
    names["isogi"].close()
    lines = said.getvalue().splitlines()
    assert lines[0].startswith("[24, 20, 16] 0.5 ")
    assert re.fullmatch(r"(\d+) of \1 chunks final, error [\d.]+ %", lines[1])
    assert re.fullmatch(r"[\d.]+ of unshadowed light, noise of a pixel [\d.]+%", lines[2])
    assert re.fullmatch(r"0\.5 at \([\d., ]+\) , light \([\d., ]+\), error [\d.]+%", lines[3])
    assert lines[4] == "5.0 90.0"
    assert re.fullmatch(r"\d+ texels, about \d+ seconds", lines[5])
    assert re.fullmatch(r"100% of 12 views final, worst error 0\.\d+", lines[6])
    assert lines[-1].startswith("final ")
    assert names["ratio"].min() > 0.0
    assert names["highest"] <= 16.0
    assert size_of(tmp_path / "object.png") == (320, 240, 1)
    assert size_of(tmp_path / "isovalues.png") == (480, 120, 1)
    assert size_of(tmp_path / "turn.gif") == (160, 120, 8)


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl on this machine")
def test_shell(own_server: str, tmp_path: Path) -> None:
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    script = "\n".join(f"echo '+++'\n{line}\necho" for line in lines)
    script = script.replace(HERE, own_server).replace("/scenes/engine/", "/scenes/small/")
    done = subprocess.run(
        ["bash", "-eu", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    picture, _, events, _, job, jobs, dismissed = done.stdout.split("+++\n")[1:]
    assert "preference-applied: wait=5" in picture.lower()
    assert size_of(tmp_path / "frame.png") == (160, 120, 1)
    assert "event: final" in events
    assert '"processID":"frame"' in job
    assert '"jobs":[{' in jobs
    assert re.search(r'"status":"(dismissed|successful)"', dismissed)


NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"
NO_WIDGET = importlib.util.find_spec("anywidget") is None


def cells() -> list[str]:
    """The code of the notebook's cells."""
    document = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]


def shown(code: str, names: dict[str, Any]) -> Any:
    """What a cell ends with, once it has run; None where that is no expression."""
    tree = ast.parse(code)
    if isinstance(tree.body[-1], ast.Expr):
        last = tree.body.pop()
    else:
        last = None
    exec(compile(tree, str(NOTEBOOK), "exec"), names)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)


def test_the_cells_run(own_server: str, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for code in cells():
        if NO_WIDGET and ("isogi.widget" in code or "viewer" in code):
            continue
        ended = shown(code.replace(HERE, own_server), names)
        if isinstance(ended, Frame):
            assert ended._repr_png_().startswith(b"\x89PNG")
        elif hasattr(ended, "_repr_html_"):
            assert "data:image/webp;base64,UklGR" in ended._repr_html_()
    assert "of 12 frames" in capsys.readouterr().err
    assert np.asarray(names["numbers"]).shape == (240, 320, 9)
    assert np.asarray(names["frame"]).shape == (240, 320, 3)
    names["isogi"].close()


def test_radiance_is_shown_as_srgb() -> None:
    assert srgb_of(np.array([-1, 0, 0.002, 0.2158605, 1, 7])).tolist() == [0, 0, 7, 128, 255, 255]


@pytest.mark.skipif(NO_WIDGET, reason="anywidget is not installed")
def test_a_viewer_follows_its_knobs(own_server: str) -> None:
    from isogi.widget import Viewer

    with Isogi(own_server) as isogi:
        viewer = Viewer(isogi, isogi.scenes()[0]["id"], width=32, height=24)
        assert wait_for(lambda: bool(viewer.picture), 60)
        first = bytes(viewer.picture)
        viewer.azimuth += 90.0
        assert wait_for(lambda: viewer.picture != first, 60)
        assert viewer.picture.startswith(b"\xff\xd8") and "final" in viewer.told
        assert viewer.view["azimuth"] == viewer.azimuth
        viewer.close()
