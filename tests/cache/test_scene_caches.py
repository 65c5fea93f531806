"""The caches of a scene: one for each look, opened when a frame first reads it."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from isogi_core.bake.bake_spec import SPECS
from isogi_core.cache.page_pool import PAGE_TEXELS
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import StoreError
from tests.cache.chunks import spec_of

BUDGET = 1 << 22


def folders(store: Path) -> set[str]:
    """The layers that were opened."""
    return {path.parent.name for path in store.glob("*/zarr.json")}


def test_nothing_is_opened_before_it_is_read(tmp_path: Path) -> None:
    spec = spec_of()
    caches = Caches(spec.prepared, tmp_path / "light", BUDGET)
    assert not (tmp_path / "light").exists()
    digests = [spec.prepared.scene.layer_digest(layer) for layer in spec.plan.layers]
    caches.of("vicinity")
    assert folders(tmp_path / "light") == {digests[0]}
    caches.of("gi")
    assert folders(tmp_path / "light") == set(digests)


def test_each_spec_is_opened_once_with_a_pool_of_its_own(tmp_path: Path) -> None:
    caches = Caches(spec_of().prepared, tmp_path, BUDGET)
    with ThreadPoolExecutor(8) as threads:
        loaders = set(threads.map(caches.of, ["gi", "vicinity"] * 8))
    assert len(loaders) == 2
    assert caches.of("gi") is caches.of("gi") is not caches.of("vicinity")
    assert {loader.pool.spec.plan.representation for loader in loaders} == {"transfer", "vicinity"}
    assert all(loader.chunk_store.spec is loader.pool.spec for loader in loaders)


def test_specs_share_memory_by_equal_numbers_of_texels(tmp_path: Path) -> None:
    caches = Caches(spec_of().prepared, tmp_path, BUDGET)
    pools = [caches.of(name).pool for name in SPECS]
    sizes = [sum(a.nbytes for a in (p.transfer, p.scatter, p.error, p.stamp, p.table)) for p in pools]
    assert 0.95 * BUDGET < sum(sizes) <= BUDGET
    rows = [len(pool.scatter) for pool in pools]
    assert max(rows) - min(rows) <= PAGE_TEXELS


def test_a_place_that_cannot_be_opened_is_an_error_each_time(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    caches = Caches(spec_of().prepared, tmp_path / "file", BUDGET)
    for _ in range(2):
        with pytest.raises(StoreError, match="Cannot"):
            caches.of("gi")
