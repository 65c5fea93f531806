"""The documents of ``isogi inspect``: a scene's facts, and how stiff its volume is at each isovalue."""

from pydantic import BaseModel

from server.facts import SceneFacts


class ErrorFacts(BaseModel):
    """A relative error: most likely, and the range that it is likely in."""

    low: float
    likely: float
    high: float


class SurfaceFacts(BaseModel):
    """The surface of one isovalue: how many cells it passes, and what share of them is stiff, and how.

    ``steep``: the field leaps from one plateau to another; ``plateau``: it hardly changes; ``noisy``: normals stray;
    ``holes``: beside a voxel that is no number. ``box`` names the faces of the box that the surface meets, each with
    the share of the cells that do. ``error`` is what light is expected to err by for being interpolated between
    texels, null where there is no surface.
    """

    isovalue: float
    cells: int
    steep: float
    plateau: float
    noisy: float
    holes: float
    box: dict[str, float]
    error: ErrorFacts | None


class Remark(BaseModel):
    """Something that a person should know of a volume: what it means, what isogi does about it, what they can do."""

    about: str
    means: str
    does: str | None = None
    can: list[str] = []


class StiffnessFacts(BaseModel):
    """How stiff a volume is: its surfaces by ascending isovalue, and which of them is the scene's ``own``.

    ``void`` is the share of the texels that can be shown that can hold no light, ``steps`` how many values the file's
    type tells apart between the least and the greatest, outliers left out. ``mark`` is a value that looks like a
    mark of missing data, null where none does. ``remarks`` are about the scene's own surface.
    """

    surfaces: list[SurfaceFacts]
    own: int
    void: float
    steps: float
    mark: float | None
    remarks: list[Remark] = []


class InspectionFacts(SceneFacts):
    """A scene's document, and how stiff its volume is."""

    stiffness: StiffnessFacts
