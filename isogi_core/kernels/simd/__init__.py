"""SIMD: vectors of float32 and float64 that live in registers, written as ordinary arithmetic.

Numba has no vector types. These modules define them (``types``), build their LLVM code (``llvm``),
and give them Python's operators (``operators``), mathematics (``maths``), access to arrays
(``memory``) and voxels (``voxels``). Most functions also take single numbers, so that one source
serves both.
"""
