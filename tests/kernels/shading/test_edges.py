"""Light of samples between the middles of pixels."""

import numpy as np

from isogi_core.kernels.shading.edges import Shown, borrow_light

SIZE = 12


def test_samples_where_walls_meet_show_their_own_wall() -> None:
    """Two walls in one plane, white and black, meet along a steep line: the mean of a pixel's
    samples is the share of it that is white.
    """
    eye = (np.float32(6.0), np.float32(6.0), np.float32(-1e3))
    one = np.float32(1.0)

    def number(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x > 5.0 + y / SIZE).astype(np.int8)

    y, x = (part.ravel() + 0.5 for part in np.indices((SIZE, SIZE)))
    points = np.column_stack([x, y, np.zeros_like(x)]).astype(np.float32)
    light = np.repeat(1.0 - number(x, y)[:, None], 3, axis=1).astype(np.float32)
    rows = np.arange(SIZE * SIZE, dtype=np.int32).reshape(SIZE, SIZE)
    shown = Shown(rows, points, number(x, y), light, (one, one, one), eye, np.float32(1e6))

    rng = np.random.default_rng(5)
    places = rng.uniform(2.0, SIZE - 2.0, (4000, 2)).astype(np.float32)
    samples = np.column_stack([places, np.zeros(len(places), np.float32)])
    numbers = number(places[:, 0], places[:, 1])
    found = np.full((len(places), 3), np.nan, np.float32)
    each = np.arange(len(places), dtype=np.uint32)
    borrow_light(shown, places, each, samples, numbers, found)
    wrong = np.abs(found[:, 0] - (1 - numbers))
    # Of a sliver no pixel's middle may be near.
    assert (wrong < 0.01).mean() > 0.97 and np.isfinite(found).all()
    near = np.abs(places[:, 0] - 5.0 - places[:, 1] / SIZE) < 0.5
    assert np.abs(found[near, 0].mean() - (1 - numbers[near]).mean()) < 0.02
