"""Running means: what something is taken to be from all that was measured of it, the newest counting most."""


def mixed(newest: float, before: float, fresh: float) -> float:
    """The mean with the ``newest``, which counts by the share ``fresh``, from that ``before``, 0 for unknown."""
    return fresh * newest + (1.0 - fresh) * (before or newest)
