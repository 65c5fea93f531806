"""Small pure functions on scalars, tuples and arrays, compiled by Numba. Nothing here knows what a
scene is.
"""
