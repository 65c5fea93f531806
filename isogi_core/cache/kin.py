"""Kin of a layer: the same light to another order, or of another precision, that an earlier plan left in the store.

What is true of a texel's first bands stays true when a plan asks for more of them or for fewer, for its paths are
the same. A larger layer serves in place of a smaller one; a smaller one is shown until the larger is baked.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

from isogi_core.bake.recipe import Recipe
from isogi_core.cache.layer import LayerStore
from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.plan import Layer, ScenePlan

DIRECTED = 2
"""The least order of a layer that is shown in place of a larger one: band 0 alone has no direction."""


def adopt(plan: ScenePlan, recipe: Recipe, root: str | Path) -> ScenePlan:
    """The plan, with layers that the store under ``root`` lacks replaced by the least larger ones that it has."""
    return replace(plan, layers=tuple(adopted(layer, recipe, root) for layer in plan.layers))


def adopted(layer: Layer, recipe: Recipe, root: str | Path) -> Layer:
    """The layer, or the least larger one where the store under ``root`` has that and not the layer itself."""
    candidates = (layer, *sorted(larger(layer), key=lambda kin: kin.bytes_per_texel))
    return next((kin for kin in candidates if LayerStore(root, recipe, kin).exists), layer)


def former(layer: Layer, recipe: Recipe, root: str | Path) -> LayerStore | None:
    """The largest of the smaller layers that the store under ``root`` has."""
    stores = (LayerStore(root, recipe, kin) for kin in smaller(layer))
    return next((store for store in stores if store.exists), None)


def larger(layer: Layer) -> Iterator[Layer]:
    """Layers that hold all that ``layer`` holds, and more."""
    orders = range(layer.order, MAX_ORDER + 1) if layer.kind in ("direct", "indirect") else (layer.order,)
    precisions = {(layer.half, layer.coarse), (layer.half, None), (False, None)}
    for order, (half, coarse) in product(orders, precisions):
        kin = replace(layer, order=order, half=half, coarse=coarse)
        if kin != layer:
            yield kin


def smaller(layer: Layer) -> Iterator[Layer]:
    """Layers that hold the first bands of ``layer``, the most of them first."""
    for order in range(layer.order - 1, DIRECTED - 1, -1):
        yield replace(layer, order=order)
