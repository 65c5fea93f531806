"""SIMD: vectors of float32 and float64 that live in registers, written as ordinary arithmetic."""
