"""Advice: what the stiffness of a scene's own surface means, what isogi does about it, and what a person can do."""

from collections.abc import Callable, Iterator

from server.inspect.facts import Remark, StiffnessFacts, SurfaceFacts
from server.inspect.shares import percent, span

WORTH = 0.05
"""Share of a surface that is worth a remark."""

MEETS = 0.0005
"""Share of a surface's cells at a face of the box that is worth one: noise alone puts a few there."""

FEW = 2**10
"""Steps of a type that make values coarse, where there are fewer of them."""

BETTER = 0.5
"""How much less of another surface is to be noisy for it to be named."""


def remarks(found: StiffnessFacts) -> list[Remark]:
    """What there is to say, the most important first."""
    own = found.surfaces[found.own]
    finders = SEEN if own.cells else (nothing,)
    return [remark for find in (*finders, *ALWAYS) for remark in find(found, own)]


def nothing(found: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That the scene's isovalue has no surface."""
    others = [surface.isovalue for surface in found.surfaces if surface.cells]
    can = [f"choose an isovalue from {others[0]:.6g} to {others[-1]:.6g}."] if others else []
    yield Remark(about="nothing", means=f"No surface passes any cell at {own.isovalue:.6g}.", can=can)


def error(_: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """What error is to be expected."""
    if own.error is not None:
        means = f"Expect the light at {own.isovalue:.6g} to err by about {span(own.error)} for being interpolated."
        calm = "" if max(own.steep, own.plateau, own.noisy) >= WORTH else " Nothing is stiff there."
        can = ["measure it for a view of yours: isogi report."]
        yield Remark(about="error", means=f"{means}{calm}", can=can)


def steep(_: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That the field leaps."""
    if own.steep >= WORTH:
        means = (
            f"{percent(own.steep)} of the surface lies on steps: within two voxels the value leaps from one plateau to"
            " another, and the texels around it have isosurfaces of their own that nobody sees."
        )
        does = "lights the texels at the edge of a plateau half-way of the step, where the surface is."
        yield Remark(about="steep", means=means, does=does, can=list(CURES))


def plateau(_: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That the field hardly changes."""
    if own.plateau >= WORTH:
        means = (
            f"{percent(own.plateau)} of the surface lies on a plateau: half of a cell's corners have the isovalue"
            " itself, or one has no gradient. The surface follows the voxels there, and rounding says where it lies."
        )
        does = "counts a voxel at the isovalue as outside, and leaves out void texels, such as have no gradient."
        can = ["choose an isovalue between two values that voxels have, and not one of them."]
        yield Remark(about="plateau", means=means, does=does, can=can)


def noisy(found: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That normals stray."""
    if own.noisy >= WORTH:
        means = (
            f"{percent(own.noisy)} of the surface is noisy, or has detail as fine as two voxels: normals stray by 26°"
            " or more within a cell, and texels side by side lie on surfaces that have little in common."
        )
        does = "takes normals from the gradient smoothed over 4 × 4 × 4 voxels; the surface stays as it is."
        cures = () if own.steep >= WORTH else CURES  # they are told once
        yield Remark(about="noisy", means=means, does=does, can=[*cures, *calmer(found, own)])


def calmer(found: StiffnessFacts, own: SurfaceFacts) -> Iterator[str]:
    """Another isovalue, the nearest with a surface of which far less is noisy."""
    others = [each for each in found.surfaces if each.cells and each.noisy <= BETTER * own.noisy]
    if others:
        best = min(others, key=lambda each: abs(each.isovalue - own.isovalue))
        yield f"choose another isovalue: {best.isovalue:.6g} is near, and far less noisy, {percent(best.noisy)}."


def holes(_: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That voxels beside the surface are no numbers."""
    if own.holes > 0.0:
        means = f"{percent(own.holes)} of the surface lies beside voxels that are no numbers."
        does = "shows no surface in the eight cells around such a voxel: there is a gap, and light passes."
        yield Remark(about="holes", means=means, does=does, can=["fill them in before, where gaps are not meant."])


def box(_: StiffnessFacts, own: SurfaceFacts) -> Iterator[Remark]:
    """That the surface meets the box."""
    met = [f"{face} ({percent(share)} of its cells)" for face, share in own.box.items() if share >= MEETS]
    if met:
        means = f"The surface meets the box at {', '.join(met)}: it is cut open there, and light enters."
        yield Remark(about="box", means=means, can=["pad the volume with voxels outside, where that is not meant."])


def void(found: StiffnessFacts, _: SurfaceFacts) -> Iterator[Remark]:
    """That texels can hold no light."""
    if found.void > 0.0:
        means = (
            f"{percent(found.void)} of the texels that can be shown have no gradient, no side of their own in a"
            " thin wall, or no room in a crease."
        )
        does = "never bakes them, and interpolates between the texels around that hold light."
        yield Remark(about="void", means=means, does=does)


def coarse(found: StiffnessFacts, _: SurfaceFacts) -> Iterator[Remark]:
    """That values are rounded so coarsely that slopes may be terraces."""
    if 0.0 < found.steps < FEW:
        means = f"Values come in only {found.steps:,.0f} steps: slopes gentler than one a voxel are terraces."
        yield Remark(about="coarse", means=means, can=["keep more digits, where the values come from."])


def mark(found: StiffnessFacts, _: SurfaceFacts) -> Iterator[Remark]:
    """That a value looks like a mark of missing data."""
    if found.mark is not None:
        means = f"Many voxels have the value {found.mark:.10g}, which is far from all others: it looks like a mark."
        can = [f"say so in the scene, missing = {found.mark:.10g}: these voxels are then holes."]
        yield Remark(about="missing", means=means, can=can)


CURES = (
    "smooth the volume by about a voxel before: steps become ramps, and noise goes.",
    "ask for a finer lattice, lattice = 2: eight times the texels, and a third to two thirds of the error.",
)
"""What helped on seven stiff surfaces, errors 5 to 15 %: a Gaussian of one voxel left 0.05 to 0.6 of them."""

Finder = Callable[[StiffnessFacts, SurfaceFacts], Iterator[Remark]]

SEEN: tuple[Finder, ...] = (error, steep, plateau, noisy, holes, box)
"""Each finds what is to be said of a surface that can be seen."""

ALWAYS: tuple[Finder, ...] = (void, coarse, mark)
"""Each finds what is to be said of a volume."""
