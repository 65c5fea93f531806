"""What is measured beside pictures, as JSON: a point of the surface, and the size of all of it."""

from pydantic import BaseModel

from server.schemas import Triple


class PointSchema(BaseModel):
    """What one pixel shows; all but ``hit`` and ``unit`` is null where it shows no surface.

    ``position`` and the outward unit ``normal`` are in the world, whose lengths have the ``unit``, empty where
    unknown; ``sides`` are the sides of a patient on which the coordinates lie, "LAS", empty elsewhere. ``voxel`` are
    voxel indices, x first. ``value`` is the volume's there, null on the ``wall`` with that number. ``light`` is linear
    RGB, ``displayed`` the same as a picture shows it, sRGB; ``state`` is final, converging or provisional, and
    ``error`` the relative error of this pixel.
    """

    hit: bool
    unit: str
    position: Triple | None = None
    sides: str | None = None
    voxel: Triple | None = None
    value: float | None = None
    wall: int | None = None
    normal: Triple | None = None
    light: Triple | None = None
    displayed: str | None = None
    state: str | None = None
    error: float | None = None


class SizeSchema(BaseModel):
    """Area of a surface, and volume of the solid, in squares and cubes of the ``unit``, which is empty where unknown.

    ``area`` is 0 where there is no surface. ``area_error`` and ``volume_error`` are what the voxels' size leaves open,
    in the same units. ``is_open`` is whether the solid reaches a side of the volume, where it is taken to end.
    """

    isovalue: float
    unit: str
    area: float
    area_error: float
    volume: float
    volume_error: float
    is_open: bool
