"""docs/client.md: its examples run, against a live server, in their order."""

import contextlib
import io
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

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
    done = subprocess.run(["bash", "-eu", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    picture, _, events, _, job, jobs, dismissed = done.stdout.split("+++\n")[1:]
    assert "preference-applied: wait=5" in picture.lower()
    assert size_of(tmp_path / "frame.png") == (160, 120, 1)
    assert "event: final" in events
    assert '"processID":"frame"' in job
    assert '"jobs":[{' in jobs
    assert re.search(r'"status":"(dismissed|successful)"', dismissed)
