"""Tracing: rays against isosurfaces of a trilinear field, one by one and in SIMD lanes."""
