"""Area and volume of the surface over HTTP: those of the volume's own numbers, with cuts, and what is refused."""

from pathlib import Path
from typing import Any

import httpx
import pytest

from isogi_client import Isogi
from isogi_core.prepared.isosurface_mesh import surface_size
from tests.loaded import load_scene


def size(server: str, **query: str | float) -> dict[str, Any]:
    answer = httpx.get(f"{server}/v1/scenes/small/size", params=query, timeout=180).raise_for_status()
    found: dict[str, Any] = answer.json()
    return found


def test_it_is_the_size_of_the_scenes_surface(live_server: str, small_scene: Path) -> None:
    volume = load_scene(small_scene).volume
    steps = volume.orientation.affine(volume.spacing)[:, :3]
    wanted = surface_size(volume.voxels, volume.normalise_isovalue(0.4), steps)
    with Isogi(live_server) as isogi:
        found = isogi.size("small", isovalue=0.4)
    assert found == {**vars(wanted), "isovalue": 0.4, "unit": volume.orientation.unit}
    assert 0.0 < found["area_error"] < 0.1 * found["area"]
    assert size(live_server)["isovalue"] == 0.5, "the scene's own is measured where none is given"


def test_both_parts_of_a_cut_make_the_whole(live_server: str) -> None:
    """They share a layer of voxels, at which faces of cuts lie."""
    whole, low, high = size(live_server), size(live_server, cut="x>11"), size(live_server, cut="x<11")
    assert low["volume"] + high["volume"] == pytest.approx(whole["volume"], rel=0.03)
    assert whole["area"] < low["area"] + high["area"] < 1.6 * whole["area"], "each has a face more"


@pytest.mark.parametrize(("query", "word"), [({"isovalue": 9}, "isovalue"), ({"azimuth": 9}, "azimuth")])
def test_what_does_not_fit_is_refused(live_server: str, query: dict[str, float], word: str) -> None:
    answer = httpx.get(f"{live_server}/v1/scenes/small/size", params=query, timeout=180)
    assert answer.status_code == 422 and word in answer.json()["detail"]
