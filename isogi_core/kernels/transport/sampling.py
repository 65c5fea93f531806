"""Sampling of directions: ``sample_x`` with its density ``x_pdf`` and its inverse ``invert_x``;
refraction.

Uniform random numbers are arguments, so that sampling is a pure function; ``invert_x`` returns
them. Local directions have z along the normal. Densities are per steradian, or per unit area of the
square. Kernels without branches take vectors of numbers as well.

At a smooth dielectric interface directions are unit vectors of the world; ``n`` is the normal on
the side that light comes from, and ``ratio`` the index of refraction on the other side over that on
this side. Source: Born and Wolf, "Principles of Optics", section 1.5.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import where
from isogi_core.kernels.tracing.vec import madd, normalize, orthonormal_basis, scale

BELOW_ONE = 1.0 - 2.0**-53
"""Largest float64 below 1."""

# Minimax polynomials in x² of cos and sin on [-π/4, π/4], lowest term first (fdlibm's k_cos.c and
# k_sin.c).
COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip


@kernel(exact=True)
def polynomial(a, x):
    """Return a₀ + a₁ x + … + a₅ x⁵."""
    return a[0] + x * (a[1] + x * (a[2] + x * (a[3] + x * (a[4] + x * a[5]))))


@kernel(exact=True)
def cosine_and_sine(angle):
    """Return (cos, sin) of an angle in [-π/4, π/4],
    with an error of at most one unit in the last place.
    """
    square = angle * angle
    cosine = 1.0 - (0.5 * square - square * square * polynomial(COSINE, square))
    return cosine, angle + angle * square * polynomial(SINE, square)


@kernel()
def cosine_and_sine_of_turn(part):
    """Return (cos, sin) of an angle that is this ``part``, in [0, 1], of a full turn."""
    # Reduce to an eighth of a turn to either side of the nearest quarter.
    quarter = int(4.0 * part + 0.5)
    cosine, sine = cosine_and_sine(2.0 * math.pi * (part - 0.25 * quarter))
    if quarter & 1:
        cosine, sine = -sine, cosine
    if quarter & 2:
        cosine, sine = -cosine, -sine
    return cosine, sine


@kernel(exact=True)
def sample_disc(u, v):
    """Return a point (x, y) of the unit disc, uniform, from (u, v) in [0, 1)²; the map keeps strata
    compact.

    Source: Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997.
    """
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    # In each quarter of the square the larger coordinate becomes the radius, their ratio the angle.
    wide = abs(a) > abs(b)
    radius = where(wide, a, b)
    other = where(wide, b, a)
    cosine, sine = cosine_and_sine(0.25 * math.pi * (other / where(radius != 0.0, radius, 1.0)))
    along, across = radius * cosine, radius * sine
    return where(wide, along, across), where(wide, across, along)


@kernel()
def disc_pdf(x, y):
    """Return the density of ``sample_disc`` per unit area: 1/π inside, 0 outside."""
    if x * x + y * y <= 1.0:
        return 1.0 / math.pi
    return 0.0


@kernel()
def invert_disc(x, y):
    """Return the (u, v) in [0, 1]² that ``sample_disc`` maps to (x, y)."""
    radius = math.sqrt(x * x + y * y)
    # The larger coordinate has the sign of the quarter; the angle gives the other coordinate.
    if abs(x) > abs(y):
        a = math.copysign(radius, x)
        if x > 0.0:
            b = math.atan2(y, x)
        else:
            b = math.atan2(-y, -x)
        b *= a * 4.0 / math.pi
    else:
        b = math.copysign(radius, y)
        if y > 0.0:
            a = math.atan2(x, y)
        else:
            a = math.atan2(-x, -y)
        a *= b * 4.0 / math.pi
    return 0.5 * (a + 1.0), 0.5 * (b + 1.0)


@kernel(exact=True)
def sample_cosine_hemisphere(u, v):
    """Return a unit direction about +z with density cosθ/π from (u, v) in [0, 1)²: a point of
    the disc, lifted to the sphere (Malley's method).
    """
    x, y = sample_disc(u, v)
    height = 1.0 - x * x - y * y
    return x, y, math.sqrt(where(height > 0.0, height, 0.0))


@kernel(exact=True)
def about(n, d):
    """Return the direction ``d``, given about +z,
    rotated so that +z becomes the unit vector ``n``.
    """
    s, t = orthonormal_basis(n)
    return (
        n[0] * d[2] + s[0] * d[0] + t[0] * d[1],
        n[1] * d[2] + s[1] * d[0] + t[1] * d[1],
        n[2] * d[2] + s[2] * d[0] + t[2] * d[1],
    )


@kernel()
def cosine_hemisphere_pdf(cos_theta):
    """Return the density of ``sample_cosine_hemisphere`` per steradian: max(cosθ, 0)/π."""
    return max(cos_theta, 0.0) / math.pi


@kernel()
def invert_cosine_hemisphere(d):
    """Return the (u, v) that ``sample_cosine_hemisphere`` maps to the unit direction d."""
    return invert_disc(d[0], d[1])


@kernel()
def sample_uniform_sphere(u, v):
    """Return a unit direction, uniform over the sphere, from (u, v) in [0, 1)²:
    z = 1 - 2u, φ = 2πv (Archimedes).
    """
    radius = 2.0 * math.sqrt(max(0.0, u * (1.0 - u)))
    angle = 2.0 * math.pi * v
    return radius * math.cos(angle), radius * math.sin(angle), 1.0 - 2.0 * u


@kernel()
def uniform_sphere_pdf():
    """Return the density of ``sample_uniform_sphere`` per steradian: 1/4π."""
    return 0.25 / math.pi


@kernel()
def invert_uniform_sphere(d):
    """Return the (u, v) that ``sample_uniform_sphere`` maps to the unit direction d."""
    return 0.5 * (1.0 - d[2]), _turn(d[0], d[1])


@kernel()
def _turn(x, y):
    """Return the azimuth of (x, y), from +x towards +y, as a fraction of a turn in [0, 1)."""
    turn = math.atan2(y, x) / (2.0 * math.pi)
    if turn < 0.0:
        return min(turn + 1.0, BELOW_ONE)
    return turn


@kernel()
def direction_to_latlong(d):
    """Return the place (row, column) of a direction in a lat-long image, as fractions of its height
    and width.

    Row in [0, 1] is θ/π down from +z, column in [0, 1) is φ/2π from +x towards +y; d need not be a
    unit vector.
    """
    return math.atan2(math.sqrt(d[0] * d[0] + d[1] * d[1]), d[2]) / math.pi, _turn(d[0], d[1])


@kernel()
def find_interval(cdf, guide, u):
    """Return the last i ≤ n - 1 with cdf[i] ≤ u, for u in [0, 1); an interval of width 0 is never
    found.

    ``cdf`` (n + 1,) are cumulative shares from 0 to 1. ``guide`` (n + 1,) are the intervals of u =
    0, 1/n, …, 1: few steps lead from one of them to the next. Source: Chen and Asau, "On Generating
    Random Variates from an Empirical Distribution", 1974.
    """
    parts = guide.shape[0] - 1
    part = min(int(u * parts), parts - 1)
    low = guide[part]
    high = guide[part + 1] + 1
    while high - low > 1:
        middle = (low + high) // 2
        if cdf[middle] <= u:
            low = middle
        else:
            high = middle
    return low


@kernel()
def share_of_interval(cdf, i, u):
    """Return the place of u in interval i of the ``cdf``, from 0 at its beginning to 1."""
    width = cdf[i + 1] - cdf[i]
    if width > 0.0:
        return max((u - cdf[i]) / width, 0.0)
    return 0.5


@kernel()
def refracted_cosine(cosine, ratio):
    """Return the cosine of the refracted ray to the normal by Snell's law, for a ray at
    ``cosine``; 0 under total reflection.
    """
    square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio)
    return math.sqrt(square) if square > 0.0 else 0.0


@kernel()
def fresnel(cosine, ratio):
    """Return the reflectance of unpolarised light at ``cosine`` to the normal: ½ (r_s² + r_p²),
    1 beyond the critical angle.
    """
    other = refracted_cosine(cosine, ratio)
    if not other > 0.0:
        return 1.0
    across = (cosine - ratio * other) / (cosine + ratio * other)
    along = (ratio * cosine - other) / (ratio * cosine + other)
    return 0.5 * (across * across + along * along)


@kernel()
def mirror(w, n, cosine):
    """Return the mirror direction of ``w`` at ``cosine`` = -w·n."""
    return normalize(madd(w, 2.0 * cosine, n))


@kernel()
def refract(w, n, cosine, ratio):
    """Return the refracted direction of ``w`` at ``cosine`` = -w·n, up to the critical angle."""
    other = refracted_cosine(cosine, ratio)
    return normalize(madd(scale(w, 1.0 / ratio), cosine / ratio - other, n))
