"""The table of knobs: the parameters of a view and its picture, over HTTP and as options of
commands.

Parameters, options, their help, and the defaults and ranges in a scene's document all derive from
KNOBS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from isogi_core.model.choices import (
    MAX_GLOW_STRENGTH,
    MOST_SMOOTH,
    OVERLAYS,
    PROJECTIONS,
    VIEW_SHADINGS,
)
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.material import SHINE_HELP, SHINE_KINDS, SHINE_KNOBS, SHINE_RANGES
from isogi_server.values import Choice, Colour, Ground, Isovalue, Kind, Planes, Row, Span, Words

if TYPE_CHECKING:
    from isogi_core.plan.scene import Scene

LONGEST_SIDE = 16383
"""Pixels along a side of a picture, at most: the limit of WebP."""

LONGEST_WAIT = 10_000
"""Milliseconds that a request may wait for baking."""

MOST_STEPS = 1 << 20
"""Steps of a series in time, at most."""

OF_SCENE = "the scene's"


@dataclass(frozen=True)
class Knob:
    """A parameter: its ``name``, the ``kind`` of its values, and a line of ``help`` without its
    end.

    If left out, it takes its ``default``, or the value that ``otherwise`` describes if that is
    None. Numbers have the ``unit``.
    """

    name: str
    kind: Kind
    help: str
    default: Any = None
    unit: str = ""
    otherwise: str = OF_SCENE
    own: Callable[[Scene], Any] | None = None
    """Returns the value in views of a scene that leave it out; None for a scene that does not
    have this knob.
    """

    @property
    def text(self) -> str:
        """Return a line of help: purpose, possible values and default."""
        if self.default in (None, ...):
            usual = self.otherwise
        else:
            usual = self.default
        if isinstance(usual, str):
            shown = usual
        else:
            shown = f"{usual:g}"
        return f"{self.help}{self._values()}{shown and f'; default: {shown}'}."

    def _values(self) -> str:
        """Return the range or the words in parentheses; empty for other kinds."""
        match self.kind:
            case Span(low, high):
                return f" ({low:,.7g} to {high:,.7g}{' ' if self.unit else ''}{self.unit})"
            case Choice(words):
                return f" ({', '.join(words)})"
        return ""

    def default_of(self, scene: Scene) -> Any:
        """Return the value in views of a ``scene`` that leave it out; None if the scene does
        not have this knob.
        """
        if self.own is None:
            return self.default
        return self.own(scene)


XYZ = Row(("x", "y", "z"))
ANGLE = Span(-360, 360)
PICTURE_SIDE = Span(1, LONGEST_SIDE, whole=True)


def _none(_: Scene) -> None:
    """Give no default: the parameter belongs to a single request."""


def _albedo(scene: Scene) -> float | str | None:
    """Return the albedo of views: one number if it is grey, else text; None if views may not
    choose it.
    """
    own = scene.surfaces.albedo
    if scene.surfaces.albedos is None:
        return None
    if len({*own}) == 1:
        return own[0]
    return ",".join(f"{share:.6g}" for share in own)


def _smooth(scene: Scene) -> float | None:
    """Return the smoothing of the scene; None for labels, which are not smoothed."""
    if scene.volume.segmented:
        return None
    return float(scene.source.document.get("smooth", 0.0))


def _shine(name: str) -> Callable[[Scene], Any]:
    """Return a function that gives this number of a scene's shine; None if the scene has none."""
    return lambda scene: getattr(scene.surfaces.shine, SHINE_KNOBS[name], None)


KNOB_GROUPS = {
    "Volume": (
        Knob(
            "environment",
            Words(40, "studio"),
            (
                f"Light in place of the scene's: {', '.join(ENVIRONMENTS)}, or the id of an "
                "uploaded environment"
            ),
        ),
        Knob(
            "cut",
            Planes(),
            (
                "Planes across the volume's axes, in world units, such as x>40;z<10, that take "
                "matter away: light enters there"
            ),
            otherwise="",
        ),
        Knob(
            "time",
            Span(0, MOST_STEPS, whole=True),
            "Step of a series in time, each with separate light",
            own=lambda scene: scene.volume.moment[0] if scene.volume.moment[1] > 1 else None,
        ),
        Knob(
            "smooth",
            Span(0, MOST_SMOOTH),
            "Width of a Gaussian that smooths the volume, with separate light for each width",
            unit="voxels",
            own=_smooth,
        ),
        Knob(
            "surfaces",
            Words(100, "0.4,off"),
            (
                "The share of rays that pass each pinned surface, 0 to 1, or off to hide it, "
                "such as 0.4,off"
            ),
        ),
        Knob(
            "hide",
            Words(2000, "3,4"),
            "Labels of a segmentation to hide, by their values, such as 3,4, or none",
        ),
        Knob(
            "material",
            Words(200, "glass,index=1.3"),
            "Material of the surface: diffuse, glass or subsurface, with its index, "
            "absorption or mean_free_path,"
            " such as glass,index=1.3",
        ),
    ),
    "Options": (
        Knob(
            "isovalue",
            Isovalue(),
            "Value of the surface, in the volume's units, within the scene's range",
            own=lambda scene: scene.isovalue,
        ),
        Knob(
            "projection",
            Choice(PROJECTIONS),
            (
                "How rays leave the camera: from the eye, or in parallel; the target has the same "
                "size in both"
            ),
            own=lambda scene: scene.settings.projection,
        ),
    ),
    "Camera": (
        Knob("azimuth", ANGLE, "Where to look from: 0 from +x, 90 from +y", 30.0, "degrees"),
        Knob("elevation", Span(-90, 90), "Where to look from, above the xy plane", 20.0, "degrees"),
        Knob(
            "distance",
            Span(0.01, 1e7),
            "From the target, in radii of the volume's bounding sphere",
            3.4,
        ),
        Knob("fov", Span(0.01, 179), "Vertical field of view", 30.0, "degrees"),
        Knob(
            "eye",
            XYZ,
            "World x,y,z of the eye, instead of azimuth, elevation and distance",
            otherwise="",
        ),
        Knob(
            "target",
            XYZ,
            "World x,y,z in the middle of the picture",
            otherwise="the volume's centre",
        ),
        Knob(
            "up",
            XYZ,
            "World x,y,z that points up",
            otherwise="0,0,1 with eye, else the orbit's",
        ),
        Knob(
            "window",
            Planes(),
            "Planes that hide matter from the eye, in world units: x>40, or a normal such as "
            "0,1,-1<12.5, separated by ;. Light is unchanged; cut faces show the volume's values",
            otherwise="",
        ),
    ),
    "Light": (
        Knob("yaw", ANGLE, "Turns the light about z", 0.0, "degrees"),
        Knob("pitch", ANGLE, "Then about y", 0.0, "degrees"),
        Knob("roll", ANGLE, "Then about x", 0.0, "degrees"),
        Knob(
            "light",
            Row(("w", "x", "y", "z")),
            "Quaternion w,x,y,z that turns the light, instead of yaw, pitch and roll",
            otherwise="",
        ),
    ),
    "Picture": (
        Knob(
            "albedo",
            Colour(),
            (
                "Share of the light that the surface reflects, one number or r,g,b, within the "
                "scene's albedos"
            ),
            own=_albedo,
        ),
        Knob(
            "shine",
            Choice(SHINE_KINDS),
            "Kind of the surface's shine, if the scene has one",
            own=_shine("shine"),
        ),
        *(
            Knob(name, Span(*span), SHINE_HELP[name], own=_shine(name))
            for name, span in SHINE_RANGES.items()
        ),
        Knob(
            "glow",
            Span(0, MAX_GLOW_STRENGTH),
            "Brightness of glowing parts, relative to the scene's, if something glows",
            1.0,
            own=lambda scene: 1.0 if scene.lighting.glowing.any else None,
        ),
        Knob("width", PICTURE_SIDE, "Width of the picture", 512, "pixels"),
        Knob("height", PICTURE_SIDE, "Height of the picture", 512, "pixels"),
        Knob(
            "shading",
            Choice(VIEW_SHADINGS),
            "How the surface is lit; gi: by global illumination",
            "gi",
        ),
        Knob(
            "exposure",
            Span(1e-36, 1e36),
            "Factor on radiance before the tone curve",
            own=lambda scene: scene.default_exposure,
        ),
        Knob(
            "antialias",
            Choice(("on", "off")),
            "Make pixels at edges the mean of 8 to 16 samples",
            otherwise="on, off in npy",
        ),
        Knob(
            "background",
            Ground(),
            "Behind the surface: light, dark, transparent (not in jpeg), or sRGB such as #ffffff",
            "light",
            own=_none,
        ),
        Knob(
            "samples",
            Span(1, 4096, whole=True),
            "Least paths per pixel, for path_traced only",
            16,
            own=_none,
        ),
        Knob(
            "overlay",
            Choice(OVERLAYS),
            "Marks over the picture: provisional hatches pixels that are not final; error colours "
            "each pixel by its estimated relative error on a log scale (the scene's error_scale), "
            "and hatches pixels without light",
            "none",
            own=_none,
        ),
    ),
    "Work": (
        Knob(
            "wait_ms",
            Span(0, LONGEST_WAIT, whole=True),
            "Longest wait for baking",
            0,
            "milliseconds",
            own=_none,
        ),
        Knob(
            "max_error",
            Span(0.0001, 1),
            "Relative error at which light is final",
            otherwise="the scene's target_error",
        ),
    ),
}
"""The knobs by subject. Groups are headings of help, except for Volume and Work, whose options
are listed elsewhere.
"""

KNOBS = {knob.name: knob for group in KNOB_GROUPS.values() for knob in group}
