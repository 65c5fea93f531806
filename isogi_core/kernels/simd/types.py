"""Vector types for SIMD: f32×N, f64×N, i32×N, u32×N and masks; how many lanes the processor's
registers hold.
"""

from typing import Any

import llvmlite.binding as llvm
import numba
from numba import types

FEATURE_LANES = {"avx512f": 16, "avx2": 8}
AVX512_CPUS = (
    "skylake-avx512",
    "cascadelake",
    "cooperlake",
    "icelake",
    "sapphirerapids",
    "znver4",
    "znver5",
)
AVX2_CPUS = ("haswell", "broadwell", "skylake", "znver1", "znver2", "znver3", "alderlake")


def register_lanes() -> int | None:
    """Float32 lanes of a register of the processor that Numba compiles for; None where SIMD does
    not pay.
    """
    if numba.config.DISABLE_JIT:
        return None
    name = numba.config.CPU_NAME
    features = numba.config.CPU_FEATURES
    if features is None and name in (None, "", "host"):
        host = llvm.get_host_cpu_features()
        return next((lanes for feature, lanes in FEATURE_LANES.items() if host.get(feature)), None)
    if features:
        return next(
            (lanes for feature, lanes in FEATURE_LANES.items() if f"+{feature}" in features), None
        )
    wide = any(name.startswith(cpu) for cpu in AVX512_CPUS)
    if wide:
        return 16
    if any(name.startswith(cpu) for cpu in AVX2_CPUS):
        return 8
    return None


REGISTER_LANES = register_lanes()
"""Float32 lanes of a register, or None."""

RAY_WIDTH = 2 * REGISTER_LANES if REGISTER_LANES else 1
"""Lanes of the vectors that rays are traced in: two registers of float32. 1 where there is no
SIMD.
"""

PATH_WIDTH = 1 if numba.config.DISABLE_JIT else REGISTER_LANES or 4
"""Lanes of the vectors that paths are worked out in: two registers of float64."""

SCALARS = {
    types.float32: types.float64,
    types.float64: types.float64,
    types.int32: types.int64,
    types.uint32: types.uint64,
    types.boolean: types.boolean,
}
"""By a vector's element: the type in which single numbers meet it."""


class Vector(types.Type):
    """Numba's type of a vector of ``count`` elements of the type ``number``, one of ``SCALARS``."""

    def __init__(self, number: Any, count: int) -> None:
        self.number = number
        self.count = count
        super().__init__(f"{number}x{count}")

    @property
    def scalar(self) -> Any:
        """The type in which a single number meets this vector."""
        return SCALARS[self.number]

    def of(self, number: Any) -> "Vector":
        """The vector of as many elements of another type."""
        return Vector(number, self.count)

    @property
    def mask(self) -> "Vector":
        """The mask of as many lanes."""
        return self.of(types.boolean)
