"""Values that views may choose between, and limits of their numbers. They are here so that help
texts need not load NumPy.
"""

VIEW_SHADINGS = (
    "gi",
    "vicinity",
    "lambert",
    "lambert_shadow",
    "lambert_fog",
    "phong",
    "phong_shadow",
    "path_traced",
)
OVERLAYS = ("none", "provisional", "error")
PROJECTIONS = ("perspective", "orthographic")

MAX_GLOW_STRENGTH = 16.0
"""Largest factor on the brightness of glows that views may ask for."""

MOST_SMOOTH = 8.0
"""Largest standard deviation, in voxels, of the Gaussian that smooths a volume."""
