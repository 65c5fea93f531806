"""What light at voxels is the product of: coefficients of their transfer, and those of the turned environment."""

from collections.abc import Iterator

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View

WORDS = {"direct": "direct", "indirect": "reflected"}
"""How files name light by its kind; others keep their names."""

COLOURS = ("red", "green", "blue")


def term_names(spec: BakeSpec) -> list[str]:
    """A name for each term of a bake spec: direct or reflected light, numbered where kept for several albedos."""
    kinds = [spec.plan.layers[term.layers[0]].kind for term in spec.terms]
    return [
        WORDS.get(kind, kind) + ("" if term.node is None else str(term.node + 1))
        for kind, term in zip(kinds, spec.terms, strict=True)
    ]


def columns_of(spec: BakeSpec) -> dict[str, slice]:
    """The columns of each band of each term in the transfer of a spec's texels, by the names of arrays."""
    return {
        f"{name}_band{band}": slice(int(first) + band**2, int(first) + (band + 1) ** 2)
        for name, term, first in zip(term_names(spec), spec.terms, spec.firsts, strict=True)
        for band in range(term.order)
    }


def coefficient_count(spec: BakeSpec) -> int:
    """Numbers that a voxel has besides its light: its coefficients, and what comes straight from lobes."""
    return spec.channels * spec.columns + (len(COLOURS) if spec.lobes else 0)


def environments(renderer: Renderer, view: View, exposure: float) -> dict[str, np.ndarray]:
    """What each term's coefficients are multiplied by for red, green and blue, (3, n²): see ``coefficients_at``."""
    spec = renderer.caches.spec(view.shading)
    reflected = exposure * RotatedLight(spec, view).reflected
    return {
        f"environment_{name}": reflected[:, first : first + term.order**2].astype(np.float32)
        for name, term, first in zip(term_names(spec), spec.terms, spec.firsts, strict=True)
    }


def coefficients_at(renderer: Renderer, view: View, voxels: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of the transfer of texels at ``voxels`` (m, 3; z, y, x), zero elsewhere: (nz, ny, nx, 2 l + 1) for band l.

    One for each band, and for each colour where these differ. Radiance without what comes straight from lobes is the
    sum over terms and bands of coefficients times those of ``environments``.
    """
    caches, shape = renderer.caches, renderer.prepared.scene.volume.shape
    spec = caches.spec(view.shading)
    colours = [f"_{colour}" for colour in COLOURS] if spec.channels == len(COLOURS) else [""]
    columns = columns_of(spec)
    arrays = {
        f"{name}{colour}": np.zeros((*shape, own.stop - own.start), np.float32)
        for name, own in columns.items()
        for colour in colours
    }
    for rows, transfer in transfers(caches, view.shading, voxels):
        places = tuple(voxels[rows].T)
        for name, own in columns.items():
            for channel, colour in enumerate(colours):
                arrays[f"{name}{colour}"][places] = transfer[:, channel, own]
    return arrays


def transfers(caches: Caches, shading: str, voxels: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Some of the ``voxels`` at a time, by their numbers: the transfer of their texels (k, channels, columns)."""
    loader, lattice = caches.of(shading), caches.prepared.lattice
    chunks, bits = voxels // lattice.chunk, lattice.bits
    z, y, x = (voxels % lattice.chunk).T
    offsets = (z << 2 * bits) + (y << bits) + x
    found, groups = np.unique(chunks, axis=0, return_inverse=True)
    for number, (k, j, i) in enumerate(found.tolist()):
        rows = np.flatnonzero(groups.ravel() == number)
        loader.ensure([(k, j, i)])
        with loader.pool.hold([(k, j, i)]) as held:
            yield rows, loader.pool.transfer_at(int(held.slots[0]), offsets[rows])
