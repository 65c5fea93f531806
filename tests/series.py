"""A small scene whose volume is a series in time."""

from pathlib import Path

import numpy as np

STEPS = 4
SCENE = """\
volume = "series.npy#time=0"
isovalue = 0.5
isovalues = [0.2, 0.8]
bounces = 1
lattice = 0.5
target_error = 0.5
lights = [{ type = "sky", sun_azimuth = 30, sun_elevation = 50 }]
"""


def write_series(folder: Path) -> Path:
    """A scene of two balls that come apart in four steps."""
    z, y, x = np.mgrid[:16, :20, :24]
    near = np.exp(-(((y - 9.5) / 5) ** 2) - ((z - 7.5) / 4) ** 2)
    places = [(9.5 - time, 13.5 + time) for time in range(STEPS)]
    steps = [sum(near * np.exp(-(((x - place) / 5) ** 2)) for place in both) for both in places]
    np.save(folder / "series.npy", np.array(steps, np.float32))
    (folder / "series.toml").write_text(SCENE)
    return folder / "series.toml"
