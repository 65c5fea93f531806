"""The caches of a scene: one for each look, opened when a frame first reads it."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from isogi_core.bake.look import LOOKS
from isogi_core.cache.caches import Caches
from isogi_core.cache.pages import PAGE
from isogi_core.errors import StoreError
from tests.cache.chunks import look_of

BUDGET = 1 << 22


def folders(root: Path) -> set[str]:
    """The layers that were opened."""
    return {path.parent.name for path in root.glob("*/zarr.json")}


def test_nothing_is_opened_before_it_is_read(tmp_path: Path) -> None:
    look = look_of()
    caches = Caches(look.recipe, tmp_path / "light", BUDGET)
    assert not (tmp_path / "light").exists()
    digests = [look.recipe.scene.layer_digest(layer) for layer in look.plan.layers]
    caches.of("vicinity")
    assert folders(tmp_path / "light") == {digests[0]}
    caches.of("gi")
    assert folders(tmp_path / "light") == set(digests)


def test_each_look_is_opened_once_with_a_pool_of_its_own(tmp_path: Path) -> None:
    caches = Caches(look_of().recipe, tmp_path, BUDGET)
    with ThreadPoolExecutor(8) as threads:
        loaders = set(threads.map(caches.of, ["gi", "vicinity"] * 8))
    assert len(loaders) == 2
    assert caches.of("gi") is caches.of("gi") is not caches.of("vicinity")
    assert {loader.pool.look.plan.representation for loader in loaders} == {"transfer", "vicinity"}
    assert all(loader.store.look is loader.pool.look for loader in loaders)


def test_looks_share_the_memory_so_that_each_has_room_for_as_many_texels(tmp_path: Path) -> None:
    caches = Caches(look_of().recipe, tmp_path, BUDGET)
    pools = [caches.of(name).pool for name in LOOKS]
    sizes = [sum(a.nbytes for a in (p.transfer, p.scatter, p.error, p.stamp, p.table)) for p in pools]
    assert 0.95 * BUDGET < sum(sizes) <= BUDGET
    rows = [len(pool.scatter) for pool in pools]
    assert max(rows) - min(rows) <= PAGE


def test_a_place_that_cannot_be_opened_is_an_error_each_time(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    caches = Caches(look_of().recipe, tmp_path / "file", BUDGET)
    for _ in range(2):
        with pytest.raises(StoreError, match="Cannot"):
            caches.of("gi")
