"""Light among several surfaces that is baked for a turn: against a probe turned by hand, and
against paths.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from isogi_core.files.radiance import write_hdr
from isogi_core.plan.variants import turned_by
from tests.frame.conftest import Workbench, relative_rmse
from tests.frame.several.drawing import check, drawn
from tests.loaded import load_scene

LOBES = {
    "surfaces": [{"isovalue": 0.012, "albedo": [0.8, 0.3, 0.1]}],
    "isovalue": 0.06,
    "albedo": [0.2, 0.4, 0.8],
    "bounces": 2,
    "target_error": 0.05,
}


def test_turned_light_is_that_of_a_probe_turned_by_hand(tmp_path: Path) -> None:
    """Its columns are 5 degrees wide, so that 40 degrees move them exactly."""
    image = np.full((36, 72, 3), 0.3)
    image[8:12, 10:16] = (30.0, 25.0, 20.0)
    for name, turned in (("own.hdr", image), ("turned.hdr", np.roll(image, 8, axis=1))):
        write_hdr(tmp_path / name, turned)
    own, by_hand = (
        load_scene("demo:orbital", environment=str(tmp_path / name), **LOBES)
        for name in ("own.hdr", "turned.hdr")
    )
    one = Workbench(turned_by(own, (40.0, 0.0, 0.0), "turned"), tmp_path / "one")
    other = Workbench(by_hand, tmp_path / "other")
    view = one.view(size=24)
    # Each texel takes the same random numbers in the same light: both pictures have the same bits.
    frame = check(one, view)
    same = check(other, view)
    np.testing.assert_array_equal(frame.radiance, same.radiance)
    assert frame.measured == same.measured
    # The error that the picture reports is that of paths in the turned light.
    traced = drawn(one, replace(view, shading="path_traced", samples=1024))
    error = relative_rmse(frame, traced)
    assert frame.measured is not None and not frame.provisional
    assert error < 1.5 * frame.measured.high and frame.measured.likely <= 0.05
    unturned = drawn(
        Workbench(own, tmp_path / "own"), replace(view, shading="path_traced", samples=1024)
    )
    assert relative_rmse(frame, unturned) > 3.0 * error, "the turn is seen"
