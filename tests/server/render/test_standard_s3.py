"""Servers on a bucket of a standard S3: the bytes of a folder, whoever bakes, is killed, or spoils
an object.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from isogi_core.storage.store import Store
from tests.server.buckets import chunks_at, engine_at, killed_when, picture

pytestmark = pytest.mark.usefixtures("inline")


def test_two_servers_on_a_bucket_leave_what_one_leaves(
    small_scene: Path, standard_s3: str, whole: tuple[bytes, dict[str, str]]
) -> None:
    one, other = engine_at(small_scene, standard_s3), engine_at(small_scene, standard_s3)
    with one as first, other as second, ThreadPoolExecutor(2) as threads:
        pictures = list(threads.map(picture, (first, second)))
    assert pictures == [whole[0], whole[0]]
    assert chunks_at(standard_s3) == whole[1]


@pytest.mark.kill
def test_what_a_killed_server_left_is_mended(
    small_scene: Path, standard_s3: str, whole: tuple[bytes, dict[str, str]], tmp_path: Path
) -> None:
    """And an object that was spoilt, and one that was lost."""
    command = [
        "render",
        str(small_scene),
        "-o",
        str(tmp_path / "frame.png"),
        "--store",
        standard_s3,
        "--workers",
        "1",
    ]
    view = [
        "--azimuth",
        "30",
        "--elevation",
        "20",
        "--distance",
        "3",
        "--fov",
        "30",
        "--width",
        "40",
        "--height",
        "40",
    ]
    killed_when(lambda: len(chunks_at(standard_s3)) > 0, *command, *view)
    store = Store(standard_s3)
    spoilt, *rest = sorted(chunks_at(standard_s3))
    store.put(spoilt, b"spoilt", store.get(spoilt))
    for lost in rest[:1]:
        store.delete(lost)
    with engine_at(small_scene, standard_s3) as engine:
        assert picture(engine) == whole[0]
    assert {key: chunks_at(standard_s3).get(key) for key in whole[1]} == whole[1]
