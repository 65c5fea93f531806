"""What results of views depend on, by which a renderer keeps them."""

from typing import Any

from isogi_core.model.view import View


def is_checked(view: View) -> bool:
    """Whether control pixels tell the total error of a view: of global illumination, at rest."""
    return view.shading == "gi" and not view.moving


def surface_key(view: View) -> tuple[Any, ...]:
    """What the surface in a picture depends on."""
    return view.isovalue, view.camera, view.width, view.height, view.strip, view.window


def check_key(view: View, target: float) -> tuple[Any, ...]:
    """What the check of a picture depends on."""
    return "PictureCheck", surface_key(view), view.light, view.albedo, view.shine, view.glow, target
