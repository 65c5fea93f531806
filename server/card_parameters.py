"""The parameters of what a page's graphics card draws from: layers of voxels, and chunks of light."""

import re
from typing import Annotated, NamedTuple

from pydantic import Field

from isogi_core.frame.card.chunk_light import CHUNKS
from isogi_core.frame.card.chunk_texels import is_inside
from isogi_core.model.view import Vec3
from isogi_core.prepared.prepared_scene import Index
from server.errors import ParameterError, UnknownPartError
from server.parameters import VERSION_PATTERN, LightTurn, Pitch, Roll, VariantParams, ViewParams, Yaw, read, reader
from server.values import Colour, Span

CHUNK = re.compile(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})(?:-([0-9a-f]{16}))?", re.ASCII)
"""A chunk by its place z.y.x, and the version that is asked for."""

LAYERS = re.compile(r"(\d{1,9})-(\d{1,9})", re.ASCII)
"""The first layer of voxels, and the first after the last."""


class ChunkName(NamedTuple):
    """A chunk of texels, and the version of it that an address names; None where it names none."""

    at: Index
    version: bytes | None

    @classmethod
    def of(cls, text: str, shape: Index) -> "ChunkName":
        """The chunk that a ``text`` names in a lattice of so many. Raises ParameterError and UnknownPartError."""
        found = CHUNK.fullmatch(text)
        if found is None:
            raise ParameterError(f"'{text[:40]}' names no chunk: write z.y.x, or z.y.x-version, of /card/chunks.")
        z, y, x = (int(place) for place in found.groups()[:3])
        if not is_inside((z, y, x), shape):
            most = " × ".join(map(str, shape))
            raise UnknownPartError(f"There is no chunk {z}.{y}.{x}: this scene has {most} along z, y, x.")
        return cls((z, y, x), None if found[4] is None else bytes.fromhex(found[4]))


def chunk_names(text: str, shape: Index) -> list[ChunkName]:
    """The chunks that a path names, with commas between. Raises ParameterError, and UnknownPartError where one is not
    in a lattice of so many chunks.
    """
    parts = text.split(",")
    if len(parts) > CHUNKS:
        raise ParameterError(f"{len(parts)} chunks are named: ask for {CHUNKS} at most.")
    return [ChunkName.of(part, shape) for part in parts]


def layers_of(text: str, depth: int, most: int) -> tuple[int, int]:
    """The layers that a path names, of so many. Raises UnknownPartError where there are none, or more than ``most``."""
    found = LAYERS.fullmatch(text)
    first, last = map(int, found.groups()) if found else (0, 0)
    if not first < last <= depth or last - first > most:
        raise UnknownPartError(
            f"There are no layers '{text[:40]}': name up to {most} from 0 to {depth}, as first-last."
        )
    return first, last


class VoxelParams(VariantParams):
    """The volume whose voxels are asked for."""

    version: str | None = Field(
        None,
        pattern=VERSION_PATTERN,
        description="What the document says: voxels of that version may be kept for ever.",
    )


class TransferParams(VariantParams):
    """The scene whose light is asked for."""

    max_error: Annotated[float | None, Span(0.0001, 1)] = Field(
        None, description="Relative error at which a texel is final; default: the scene's target_error."
    )


class FoldParams(TransferParams):
    """The light that chunks are lit by."""

    light: LightTurn = None
    yaw: Yaw = 0.0
    pitch: Pitch = 0.0
    roll: Roll = 0.0
    albedo: Annotated[Vec3 | None, Colour()] = Field(
        None, description="What share of the light the surface reflects; default: the scene's albedo."
    )

    @property
    def view(self) -> ViewParams:
        """A view in that light; ParameterError where the light is turned in two ways."""
        return read(ViewParams, self.model_dump(include=self.model_fields_set - {"max_error"}).items())


VoxelParamsDep = Annotated[VoxelParams, reader(VoxelParams)]
TransferParamsDep = Annotated[TransferParams, reader(TransferParams)]
FoldParamsDep = Annotated[FoldParams, reader(FoldParams)]
