"""Bakes: what the baker is to know of a look of a scene."""

from dataclasses import replace
from functools import partial

from isogi_core.cache.caches import Caches
from isogi_core.cache.costs import Costs
from isogi_core.cache.parcels import Parcels
from worker.baker import Bake


def bake_name(scene: str, look: str) -> str:
    """The name of a look of a scene among all bakes; the scene's own where it is its own."""
    return scene if look == "gi" else f"{scene} ({look})"


def make_bake(caches: Caches, name: str, parcels: Parcels | None, shown: float | None = None) -> Bake:
    """The bake of a look, by its name; workers that were joined, and lack the scene's files, have ``parcels``.

    Sharp where an isosurface is ``shown``, a normalised isovalue.
    """
    look, root = replace(caches.look(name), shown=shown), caches.root
    scene, plan = look.recipe.scene, replace(look.plan, left_out=(), notes=())
    layers = frozenset(scene.layer_digest(layer, shown) for layer in plan.layers)
    arrived = partial(caches.refresh, name, shown=shown)
    costs = Costs(root, look.digest)
    costs.read()
    return Bake(scene.source, plan, look.digest, layers, root.place, arrived, costs, parcels, shown)
