"""Volumes that come and go while an engine draws: on a real socket, baked on a thread of this
process.
"""

import gc
import threading
import weakref

import httpx
import pytest

from tests.server.asking import final
from tests.server.uploads.files import names
from tests.server.uploads.site import Site

VIEW = {"width": 48, "height": 48, "max_error": 0.5}


@pytest.mark.slow
def test_an_upload_is_a_scene_like_any_other(site: Site) -> None:
    facts = site.send(12)
    scene = site.client.get(facts["scene"]).raise_for_status().json()
    assert (scene["id"], scene["volume"]["size"]) == (facts["id"], facts["size"])
    assert scene["plan"]["left_out"]
    frame = final(site.client, facts["id"], **VIEW)
    assert float(frame.headers["isogi-error"].partition(";")[0]) < 0.5
    assert site.client.delete(facts["href"]).status_code == 204
    again = site.send(12)
    assert again["id"] == facts["id"]
    shown = site.client.get(f"{facts['scene']}/frame", params=VIEW)
    assert "provisional=0.000" in shown.headers["isogi-coverage"], (
        "the light of what came again is found in the store"
    )


@pytest.mark.slow
def test_what_is_deleted_while_it_is_drawn_ends_in_frames_or_404(site: Site) -> None:
    facts = site.send(16)
    statuses = []
    begun = threading.Semaphore(0)

    def look(azimuth: int) -> None:
        with httpx.Client(base_url=site.client.base_url, timeout=120) as client:
            while not statuses or statuses[-1] == 200:
                begun.release()
                asked = VIEW | {"azimuth": azimuth, "isovalue": 20.0, "wait_ms": 500}
                statuses.append(client.get(f"{facts['scene']}/frame", params=asked).status_code)

    volume = weakref.ref(site.engine.scenes[facts["id"]].volume)
    threads = [threading.Thread(target=look, args=(azimuth,)) for azimuth in (0, 90, 180)]
    for thread in threads:
        thread.start()
    for _ in threads:
        begun.acquire()
    assert site.client.delete(facts["href"]).status_code == 204
    for thread in threads:
        thread.join()
    assert set(statuses) <= {200, 404} and 404 in statuses
    assert f"{facts['id']}.nrrd" not in names(site.folder)
    assert facts["id"] not in {
        each["id"] for each in site.client.get("/v1/scenes").json()["scenes"]
    }
    gc.collect()
    assert volume() is None, "somebody still holds the voxels"


def test_who_listens_to_what_is_deleted_is_told(site: Site) -> None:
    facts = site.send(18)
    told: list[str] = []
    with site.client.stream(
        "GET", f"{facts['scene']}/events", params={"width": 48, "height": 48}
    ) as events:
        for line in events.iter_lines():
            told.append(line)
            if line == "event: refined" and facts["id"] in site.engine.scenes:
                site.client.delete(facts["href"]).raise_for_status()
    last = [line for line in told if line.startswith("event")][-1]
    assert last in ("event: failed", "event: final")
