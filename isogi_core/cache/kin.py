"""Kin of a layer: the same light to another order, or of another precision, that an earlier plan left in the store.

What is true of a texel's first bands stays true when a plan asks for more of them or for fewer, or more or less
precisely, for its paths are the same. A larger layer serves in place of a smaller one; a smaller one is shown
until the larger is baked.
"""

from collections.abc import Iterable, Iterator, Set
from dataclasses import replace

from isogi_core.bake.recipe import Recipe
from isogi_core.cache.layer import LayerStore
from isogi_core.cache.root import Root, Where
from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.plan import Layer, ScenePlan

DIRECTED = 2
"""The least order of direct light that is shown in place of more: band 0 alone has no direction."""


def adopt(plan: ScenePlan, recipe: Recipe, root: Where) -> ScenePlan:
    """The plan, with layers that the store at ``root`` lacks replaced by the least larger ones that it has."""
    root = Root.of(root)
    there = frozenset(root.layers())
    return replace(plan, layers=tuple(adopted(layer, recipe, root, there) for layer in plan.layers))


def adopted(layer: Layer, recipe: Recipe, root: Root, there: Set[str]) -> Layer:
    """The layer, or the least larger one where the store has light of that and none of the layer.

    ``there`` are the digests of what is kept at ``root``.
    """
    candidates = (layer, *sorted(larger(layer), key=lambda kin: kin.bytes_per_texel))
    return next((store.layer for store in present(candidates, recipe, root, there)), layer)


def former(layer: Layer, recipe: Recipe, root: Where, shown: float | None = None) -> LayerStore | None:
    """The largest of the smaller layers that the store at ``root`` has light of, with texels where those are."""
    root = Root.of(root)
    return next(present(smaller(layer), recipe, root, frozenset(root.layers()), shown), None)


def present(
    layers: Iterable[Layer], recipe: Recipe, root: Root, there: Set[str], shown: float | None = None
) -> Iterator[LayerStore]:
    """The stores of those of the ``layers`` that have light; only what is ``there`` is looked at."""
    stores = (LayerStore(root, recipe, layer, shown) for layer in layers)
    return (store for store in stores if store.digest in there and store.exists)


def larger(layer: Layer) -> Iterator[Layer]:
    """Layers that hold all that ``layer`` holds, and more."""
    orders = range(layer.order, MAX_ORDER + 1) if layer.kind in ("direct", "indirect") else (layer.order,)
    kin = (kin for order in orders for kin in precisions(layer, order))
    return (other for other in kin if other != layer and holds(other, layer))


def smaller(layer: Layer) -> Iterator[Layer]:
    """Layers that hold the first bands of ``layer``, or all of them less precisely; the most bands first."""
    least = DIRECTED if layer.kind == "direct" else 1
    lower = range(layer.order - 1, least - 1, -1)
    kin = (kin for order in (layer.order, *lower) for kin in precisions(layer, order))
    return (other for other in kin if not (other.order == layer.order and holds(other, layer)))


def precisions(layer: Layer, order: int) -> Iterator[Layer]:
    """The layer to another ``order``, in every precision; the most precise first."""
    yield replace(layer, order=order, half=False, coarse=None)
    for coarse in (None, *range(order - 1, 0, -1)):
        yield replace(layer, order=order, half=True, coarse=coarse)


def holds(kin: Layer, layer: Layer) -> bool:
    """Whether ``kin``, of no lower order, keeps each coefficient of ``layer`` as precisely, or more so."""
    return kin.floats >= layer.floats and (layer.half or not kin.half)
