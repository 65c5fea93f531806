"""Which kernels the frames of a scene do without."""

from isogi_core.model.environment import Environment
from isogi_core.model.lamps import Lamps


def uncalled(rotating: bool, environment: Environment, lamps: Lamps, lobes: int) -> tuple[str, ...]:
    """Names of those that no frame calls: constant light, and light that stays in place, are not turned."""
    called = {"rotate": rotating and bool(environment.image.any()), "project_lamps": lamps.any}
    called |= {"light_lobes": lobes > 0, "add_lobes": lobes > 0}
    return tuple(name for name, needed in called.items() if not needed)
