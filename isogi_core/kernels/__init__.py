"""Small pure functions on scalars, tuples and arrays, compiled by Numba.
They know nothing of scenes.
"""
