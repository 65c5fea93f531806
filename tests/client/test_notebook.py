"""docs/notebook.ipynb: its cells run, against a live server, and what they end with shows itself."""

import ast
import importlib.util
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_client import Frame, Isogi, srgb_of

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"
HERE = "http://127.0.0.1:8000"
NO_WIDGET = importlib.util.find_spec("anywidget") is None


def cells() -> list[str]:
    """The code of the notebook's cells."""
    document = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]


def shown(code: str, names: dict[str, Any]) -> Any:
    """What a cell ends with, once it has run; None where that is no expression."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, str(NOTEBOOK), "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)


def test_the_cells_run(own_server: str, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for code in cells():
        if NO_WIDGET and ("isogi_widget" in code or "viewer" in code):
            continue
        ended = shown(code.replace(HERE, own_server), names)
        if isinstance(ended, Frame):
            assert ended._repr_png_().startswith(b"\x89PNG")
        elif hasattr(ended, "_repr_html_"):
            assert "data:image/webp;base64,UklGR" in ended._repr_html_()
    assert "12 of 12 frames" in capsys.readouterr().err
    assert np.asarray(names["numbers"]).shape == (240, 320, 9)
    assert np.asarray(names["frame"]).shape == (240, 320, 3)
    names["isogi"].close()


def test_radiance_is_shown_as_srgb() -> None:
    assert srgb_of(np.array([-1, 0, 0.002, 0.2158605, 1, 7])).tolist() == [0, 0, 7, 128, 255, 255]


@pytest.mark.skipif(NO_WIDGET, reason="anywidget is not installed")
def test_a_viewer_follows_its_knobs(own_server: str) -> None:
    from isogi_widget import Viewer

    with Isogi(own_server) as isogi:
        viewer = Viewer(isogi, isogi.scenes()[0]["id"], width=32, height=24)
        seen = [wait_for_another(viewer, b"")]
        viewer.azimuth += 90.0
        seen.append(wait_for_another(viewer, seen[0]))
        assert seen[1].startswith(b"\xff\xd8") and "final" in viewer.told
        assert viewer.view["azimuth"] == viewer.azimuth
        viewer.close()


def wait_for_another(viewer: Any, picture: bytes) -> bytes:
    """The viewer's picture, once it is another one."""
    deadline = time.monotonic() + 60
    while viewer.picture == picture:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return bytes(viewer.picture)
