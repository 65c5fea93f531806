"""What views may choose between, and how bright they may show what glows; for help too, which loads
no NumPy.
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
"""How many times as bright as a scene says views may show what glows, at most."""

MOST_SMOOTH = 8.0
"""Greatest standard deviation of the Gaussian that smooths a volume, in voxels."""
