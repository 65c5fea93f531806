"""Vectors: 3-tuples of float64, which live in registers. Functions without branches take tuples
of SIMD vectors too.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.memory import load, store
from isogi_core.kernels.simd.types import PATH_WIDTH

SMALLEST_NORMAL = 2.0**-1022
"""Smallest normal float64, which stands for 0 in a divisor."""


@kernel()
def add(a, b):
    """Return the sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel()
def sub(a, b):
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel()
def scale(a, t):
    """Return t·a for a number t."""
    return a[0] * t, a[1] * t, a[2] * t


@kernel()
def times(a, b):
    """Return the product of two vectors, or colours, component by component."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel()
def madd(o, t, d):
    """Return the point o + t·d, as along a ray from o in direction d."""
    return o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]


@kernel()
def dot(a, b):
    """Return the scalar product Σ aᵢ bᵢ."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a, b):
    """Return the vector product a × b, right-handed."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel()
def is_zero(a):
    """Return True if all components of a are 0."""
    return a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0


@kernel()
def length(a):
    """Return the Euclidean length √(a·a)."""
    return math.sqrt(dot(a, a))


@kernel()
def normalize(a):
    """Return the unit vector a/|a|, or (0, 0, 0) if a has no direction: zero, infinite or NaN.

    The vector is first scaled by its largest component, so that squares neither overflow nor
    vanish.
    """
    largest = max(abs(a[0]), abs(a[1]), abs(a[2]), SMALLEST_NORMAL)
    x, y, z = a[0] / largest, a[1] / largest, a[2] / largest
    size = math.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        return 0.0, 0.0, 0.0
    return x / size, y / size, z / size


@kernel(exact=True)
def orthonormal_basis(n):
    """Return tangents (s, t) that make (s, t, n) right-handed and orthonormal; n is a unit vector.

    It has no branch and no pole. Source: Duff et al., "Building an Orthonormal Basis, Revisited",
    JCGT 6(1), 2017, listing 3.
    """
    sign = math.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (
        b,
        sign + n[1] * n[1] * a,
        -n[1],
    )


@kernel()
def column(vectors, m):
    """Return column ``m`` of a (3, n) array as a tuple."""
    return vectors[0, m], vectors[1, m], vectors[2, m]


@kernel()
def put_column(vectors, m, v):
    """Write the vector ``v`` to column ``m`` of a (3, n) array."""
    vectors[0, m], vectors[1, m], vectors[2, m] = v


@kernel()
def load_columns(vectors, m):
    """Return PATH_WIDTH columns of a (3, n) array from ``m`` on, as f64×N."""
    return (
        load(vectors[0], m, PATH_WIDTH),
        load(vectors[1], m, PATH_WIDTH),
        load(vectors[2], m, PATH_WIDTH),
    )


@kernel()
def store_columns(vectors, m, v):
    """Write a tuple of f64×N to PATH_WIDTH columns of a (3, n) array from ``m`` on."""
    store(vectors[0], m, v[0])
    store(vectors[1], m, v[1])
    store(vectors[2], m, v[2])
