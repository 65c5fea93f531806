"""Vector types for SIMD: f32×N, f64×N, i32×N, u32×N and masks,
and the widths that suit the processor.
"""

from typing import Any

import llvmlite.binding as llvm
import numba
from numba import types

FEATURE_LANES = {"avx512f": 16, "avx2": 8}
"""Float32 lanes of a register, by the processor feature that provides it; the widest first."""

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
"""Prefixes of LLVM's names of processors with these features."""


def register_lanes() -> int | None:
    """Return the number of float32 lanes in a register of the processor that Numba compiles for;
    None if SIMD does not pay there.

    Numba's settings NUMBA_CPU_NAME and NUMBA_CPU_FEATURES choose that processor, else it is this
    machine's.
    """
    if numba.config.DISABLE_JIT:
        return None
    name = numba.config.CPU_NAME
    features = numba.config.CPU_FEATURES
    # Compile for this machine: ask LLVM for its features.
    if features is None and name in (None, "", "host"):
        host = llvm.get_host_cpu_features()
        return next((lanes for feature, lanes in FEATURE_LANES.items() if host.get(feature)), None)
    # Compile for given features.
    if features:
        return next(
            (lanes for feature, lanes in FEATURE_LANES.items() if f"+{feature}" in features), None
        )
    # Compile for a processor that is given by its name alone, or for this one if no features are
    # allowed but those of its name.
    name = name or llvm.get_host_cpu_name()
    wide = any(name.startswith(cpu) for cpu in AVX512_CPUS)
    if wide:
        return 16
    if any(name.startswith(cpu) for cpu in AVX2_CPUS):
        return 8
    return None


REGISTER_LANES = register_lanes()
"""Float32 lanes of a register, or None if SIMD does not pay."""

RAY_WIDTH = 2 * REGISTER_LANES if REGISTER_LANES else 1
"""Lanes of the vectors in which rays are traced: two registers of float32; 1 without SIMD."""

PATH_WIDTH = 1 if numba.config.DISABLE_JIT else REGISTER_LANES or 4
"""Lanes of the vectors in which paths are computed: two registers of float64; 4 lanes if SIMD
does not pay for rays, 1 without Numba.
"""

SCALARS = {
    types.float32: types.float64,
    types.float64: types.float64,
    types.int32: types.int64,
    types.uint32: types.uint64,
    types.boolean: types.boolean,
}
"""The type to which single numbers are converted next to vectors of an element type."""


class Vector(types.Type):
    """Numba's type of a vector of ``count`` elements of the type ``number``, one of ``SCALARS``."""

    def __init__(self, number: Any, count: int) -> None:
        """Name the type after its element and count, by which Numba compares types."""
        self.number = number
        self.count = count
        super().__init__(f"{number}x{count}")

    @property
    def scalar(self) -> Any:
        """The type to which a single number is converted next to this vector."""
        return SCALARS[self.number]

    def of(self, number: Any) -> "Vector":
        """Return the type of vectors with as many elements of the type ``number``."""
        return Vector(number, self.count)

    @property
    def mask(self) -> "Vector":
        """The type of masks with as many lanes."""
        return self.of(types.boolean)
