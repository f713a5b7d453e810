"""The unit vector that a symmetric positive 4 x 4 matrix shrinks most: the solution of the DLT."""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel

MAX_ITERATIONS = 16  # numerics: then rotations finish
CONVERGED2 = 1e-22  # numerics: squared error, relative to the squared length of the vector
TINY2 = 1e-26  # numerics: the same for a vector that no longer changes but for rounding
SHRINKING2 = 1e-2  # numerics: squared factor by which changes must shrink to foresee the rest
SINGULAR = 1e-18  # numerics: pivots below this share of the trace are rounding errors
JACOBI_SWEEPS = 12  # numerics: of 4 x 4 numbers


@kernel
def null_vector(m: Floats, scratch: Floats, out: Floats) -> None:
    """Write the eigenvector of the smallest eigenvalue of `m` `(4, 4)` to `out` `(4,)`.

    Inverse iteration on an LDL factorisation converges in two or three rounds where the views
    agree; where they do not, Jacobi rotations finish. `scratch` is `(2, 4, 4)`.
    """
    floor = SINGULAR * (m[0, 0] + m[1, 1] + m[2, 2] + m[3, 3])
    i0 = 1.0 / max(m[0, 0], floor)
    l10, l20, l30 = m[0, 1] * i0, m[0, 2] * i0, m[0, 3] * i0
    i1 = 1.0 / max(m[1, 1] - l10 * m[0, 1], floor)
    t21 = m[1, 2] - l20 * m[0, 1]
    t31 = m[1, 3] - l30 * m[0, 1]
    l21, l31 = t21 * i1, t31 * i1
    i2 = 1.0 / max(m[2, 2] - l20 * m[0, 2] - l21 * t21, floor)
    t32 = m[2, 3] - l30 * m[0, 2] - l31 * t21
    l32 = t32 * i2
    i3 = 1.0 / max(m[3, 3] - l30 * m[0, 3] - l31 * t31 - l32 * t32, floor)

    # Scaled to a last coordinate of 1, as the DLT wants it: a division less than a unit vector.
    x = y = z = previous = 0.0
    for _ in range(MAX_ITERATIONS):
        b = y - l10 * x
        c = z - l20 * x - l21 * b
        w = (1.0 - l30 * x - l31 * b - l32 * c) * i3
        nz = c * i2 - l32 * w
        ny = b * i1 - l21 * nz - l31 * w
        nx = x * i0 - l10 * ny - l20 * nz - l30 * w
        scale = 1.0 / w
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        change = (nx - x) ** 2 + (ny - y) ** 2 + (nz - z) ** 2
        x, y, z = nx, ny, nz
        size = 1.0 + x * x + y * y + z * z
        # Changes shrink by a constant factor, so the next one will be about change^2 / previous.
        shrinking = change < SHRINKING2 * previous
        if change <= TINY2 * size or (shrinking and change**2 <= CONVERGED2 * size * previous):
            out[0], out[1], out[2], out[3] = x, y, z, 1.0
            return
        previous = change
    _jacobi(m, scratch, out)


@kernel
def _jacobi(m: Floats, scratch: Floats, out: Floats) -> None:
    a, vectors = scratch[0], scratch[1]
    for i in range(4):
        for j in range(4):
            a[i, j] = m[min(i, j), max(i, j)]
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(JACOBI_SWEEPS):
        for p in range(3):
            for q in range(p + 1, 4):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                t = t if theta >= 0 else -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(4):
                    kp, kq = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * kp - s * kq, s * kp + c * kq
                for k in range(4):
                    pk, qk = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * pk - s * qk, s * pk + c * qk
                for k in range(4):
                    kp, kq = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * kp - s * kq, s * kp + c * kq
    smallest = 0
    for i in range(1, 4):
        if a[i, i] < a[smallest, smallest]:
            smallest = i
    for k in range(4):
        out[k] = vectors[k, smallest]
