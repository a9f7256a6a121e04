"""Compiled sums of squares of a run without going through its samples; `moments` gives them names and explains them.

A *block* is a row of neighbouring samples of one half-cycle. Within it the rate-free force h is a function of the
displacement x alone; where that function is smooth enough, it is the polynomial through its values at `N_NODES`
Chebyshev points. With l_j the Lagrange polynomials, r = y - c - sum_j a_j l_j(x) - gamma |v| sum_j h_j l_j(x), where c
is the block's mean force and a_j = h_j - c, so sums of r^2 and of (r_i - r_(i-1))^2 are forms in a and h whose
coefficients belong to the data alone.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shj_bayes.model.kernel import CONTINUOUS, elastic_below, fill_branch, held_at, knee_of, saturate

N_NODES = 16
NODES = np.cos(math.pi * (np.arange(N_NODES) + 0.5) / N_NODES)
# l_j(t) = sum_k _LAGRANGE[k, j] T_k(t)
_LAGRANGE = np.cos(np.outer(np.arange(N_NODES), np.arccos(NODES))) * 2.0 / N_NODES
_LAGRANGE[0] /= 2.0
N_SCALARS, N_VECTORS, N_MATRICES = 10, 9, 3
N_PRODUCTS = N_NODES * (N_NODES // 2 + 1)  # of the values at the nodes, each pair once (see `_wound`)
# A block is its polynomial where that errs by 1e-11 of Fy at most. What the 16 points miss is s^-16 of the largest bend
# (what Eq. (1) differs from its straight parts by) in an ellipse of sharpness s around the block, if no singular point
# is in it. The two figures were found by trying (``test_moments`` tries them again).
SHARP_ENOUGH = 4.6e10  # s^16 beta: near the knee the bend is of the order of Fy / beta
TAIL = 2e-10  # 4 s^-15 / (s - 1) times the bend, |u|^beta / beta or its inverse, where that is small
TAIL_SHARPNESS = np.array([5.0, 3.5, 2.5, 1.8, 1.4])
TAIL_REACH = 0.5 * (TAIL_SHARPNESS + 1.0 / TAIL_SHARPNESS)  # half-axis of the ellipse in half-widths of the block
N_SHAPE = 6 + TAIL_REACH.size
NEGLIGIBLE = 1e-13  # |u|^beta / beta below which Eq. (1) counts as analytic at u = e/Fy = 0
_SUMS = {"contract", "reassoc", "nsz"}  # the order of additions is free, infinities and NaN keep their meaning


@njit(error_model="numpy", fastmath=_SUMS)
def _lagrange(t, cheb, out):  # type: ignore[no-untyped-def]
    """Fill `out` with all l_j(t)."""
    cheb[0] = 1.0
    cheb[1] = t
    for k in range(2, N_NODES):
        cheb[k] = 2.0 * t * cheb[k - 1] - cheb[k - 2]
    out[:] = 0.0
    for k in range(N_NODES):
        for j in range(N_NODES):
            out[j] += cheb[k] * _LAGRANGE[k, j]


@njit(error_model="numpy")
def _place(x, low, high):  # type: ignore[no-untyped-def]
    """Position of x in a block, -1 to 1."""
    half = 0.5 * (high - low)
    return min(max((x - 0.5 * (low + high)) / half, -1.0), 1.0) if half > 0.0 else 0.0


@njit(error_model="numpy", fastmath=_SUMS)
def _add_samples(channels, first, a, b, bounds, scalars, vectors, matrices):  # type: ignore[no-untyped-def]
    """Add samples a to b to the sums of their block; `first` is the first sample of the half-cycle."""
    x, v, y, counts, follows = channels
    low, high = bounds
    cheb, ell, ell_v = np.zeros(N_NODES), np.zeros(N_NODES), np.zeros(N_NODES)
    last, last_v, d, d_v = np.zeros(N_NODES), np.zeros(N_NODES), np.zeros(N_NODES), np.zeros(N_NODES)
    total, n = 0.0, 0.0
    for i in range(a, b):
        total += counts[i] * y[i]
        n += counts[i]
    scalars[0] = total / n if n > 0.0 else 0.0
    for i in range(max(a - 1, first), b):
        _lagrange(_place(x[i], low, high), cheb, ell)
        for j in range(N_NODES):
            ell_v[j] = v[i] * ell[j]
        if i >= a and counts[i] > 0.0:
            r = y[i] - scalars[0]
            scalars[1] += r * r
            scalars[2] += r
            scalars[3] += r * v[i]
            scalars[4] += 1.0
            scalars[5] += v[i]
            scalars[6] += v[i] * v[i]
            for j in range(N_NODES):
                vectors[0, j] += r * ell[j]
                vectors[1, j] += r * ell_v[j]
                vectors[2, j] += ell[j]
                vectors[3, j] += ell_v[j]
                vectors[4, j] += v[i] * ell_v[j]
        if i >= a and i > first and follows[i] > 0.0:
            dy = y[i] - y[i - 1]
            dv = v[i] - v[i - 1]
            scalars[7] += dy * dy
            scalars[8] += dy * dv
            scalars[9] += dv * dv
            for j in range(N_NODES):
                d[j] = ell[j] - last[j]
                d_v[j] = ell_v[j] - last_v[j]
                vectors[5, j] += dy * d[j]
                vectors[6, j] += dy * d_v[j]
                vectors[7, j] += dv * d[j]
                vectors[8, j] += dv * d_v[j]
            for k in range(N_NODES):
                for j in range(N_NODES):
                    matrices[0, k, j] += d[k] * d[j]
                    matrices[1, k, j] += d[k] * d_v[j] + d_v[k] * d[j]
                    matrices[2, k, j] += d_v[k] * d_v[j]
        last[:] = ell
        last_v[:] = ell_v


@njit(error_model="numpy", fastmath=_SUMS)
def _add_block(low, high, child, scalars, vectors, matrices):  # type: ignore[no-untyped-def]
    """Add the sums of a part of a block: a polynomial over the block is one over the part, so nothing is lost."""
    c_low, c_high, c_scalars, c_vectors, c_matrices = child
    cheb = np.empty(N_NODES)
    moved = np.empty((N_NODES, N_NODES))
    half_way = np.empty((N_NODES, N_NODES))
    for i in range(N_NODES):
        node = 0.5 * (c_low + c_high) + 0.5 * (c_high - c_low) * NODES[i]
        _lagrange(_place(node, low, high), cheb, moved[i])
    shift = c_scalars[0] - scalars[0]
    scalars[1] += c_scalars[1] + 2.0 * shift * c_scalars[2] + shift * shift * c_scalars[4]
    scalars[2] += c_scalars[2] + shift * c_scalars[4]
    scalars[3] += c_scalars[3] + shift * c_scalars[5]
    for q in range(4, N_SCALARS):
        scalars[q] += c_scalars[q]
    for q in range(N_VECTORS):
        for i in range(N_NODES):
            w = c_vectors[q, i] + (shift * c_vectors[q + 2, i] if q < 2 else 0.0)
            for j in range(N_NODES):
                vectors[q, j] += w * moved[i, j]
    for q in range(N_MATRICES):
        half_way[:] = 0.0
        for i in range(N_NODES):
            for k in range(N_NODES):
                for j in range(N_NODES):
                    half_way[i, j] += c_matrices[q, i, k] * moved[k, j]
        for i in range(N_NODES):
            for k in range(N_NODES):
                for j in range(N_NODES):
                    matrices[q, k, j] += moved[i, k] * half_way[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def build(channels, half_start, blocks, of_half):  # type: ignore[no-untyped-def]
    """Find range and sums of every block, parts before wholes; `blocks` holds begin, end, next block beside, leaf."""
    n = blocks.shape[0]
    bounds = np.empty((n, 2))
    scalars = np.zeros((n, N_SCALARS))
    vectors = np.zeros((n, N_VECTORS, N_NODES))
    matrices = np.zeros((n, N_MATRICES, N_NODES, N_NODES))
    for k in range(of_half.size - 1):
        first = half_start[k]
        for i in range(of_half[k + 1] - 1, of_half[k] - 1, -1):
            own = (scalars[i], vectors[i], matrices[i])
            if blocks[i, 3] == 1:
                a, b = blocks[i, 0], blocks[i, 1]
                part = channels[0][max(a - 1, first) : b]
                bounds[i, 0], bounds[i, 1] = part.min(), part.max()
                _add_samples(channels, first, a, b, (bounds[i, 0], bounds[i, 1]), *own)
                continue
            p = i + 1
            q = blocks[p, 2]
            bounds[i, 0] = min(bounds[p, 0], bounds[q, 0])
            bounds[i, 1] = max(bounds[p, 1], bounds[q, 1])
            weight = scalars[p, 4] + scalars[q, 4]
            if weight > 0.0:
                scalars[i, 0] = (scalars[p, 0] * scalars[p, 4] + scalars[q, 0] * scalars[q, 4]) / weight
            for part_of in (p, q):
                child = (
                    bounds[part_of, 0],
                    bounds[part_of, 1],
                    scalars[part_of],
                    vectors[part_of],
                    matrices[part_of],
                )
                _add_block(bounds[i, 0], bounds[i, 1], child, *own)
    return bounds, scalars, vectors, _wound(matrices)


@njit(error_model="numpy")
def _wound(matrices):  # type: ignore[no-untyped-def]
    """Write symmetric matrices as their diagonals wound around, each of full length: half of the numbers, no short row.

    Diagonal s holds the elements (j, j + s modulo N_NODES); those beyond the middle are the same again, hence twice.
    """
    out = np.empty((matrices.shape[0], N_MATRICES, N_PRODUCTS))
    for i in range(out.shape[0]):
        for q in range(N_MATRICES):
            for s in range(N_NODES // 2 + 1):
                weight = 1.0 if s in (0, N_NODES // 2) else 2.0
                for j in range(N_NODES):
                    out[i, q, s * N_NODES + j] = weight * matrices[i, q, j, (j + s) % N_NODES]
    return out


@njit(error_model="numpy", fastmath={"contract"})
def _fill_nodes(out, x, origin, reset, stiffness, capacity, beta, knee, sense):  # type: ignore[no-untyped-def]
    """As `fill_branch`, for a number of points that the compiler knows: twice as fast."""
    per_capacity = 1.0 / capacity
    for i in range(N_NODES):
        e = stiffness * (x[i] - origin) + reset
        held = saturate(e, capacity, per_capacity, beta, knee)
        out[i] = e if e * sense < 0.0 else held


@njit(error_model="numpy", fastmath=_SUMS)
def _by_nodes(h, gamma, scalars, vectors, matrices, twice):  # type: ignore[no-untyped-def]
    """Give the sums of squares and of squared differences of a block from the force at its nodes."""
    c = scalars[0]
    squares = 0.0
    linear = 0.0
    for j in range(N_NODES):
        f = h[j]
        a = f - c
        squares += a * (a * vectors[2, j] - 2.0 * vectors[0, j])
        squares += gamma * f * (2.0 * (a * vectors[3, j] - vectors[1, j]) + gamma * f * vectors[4, j])
        at_rest = vectors[5, j] + gamma * vectors[6, j]
        linear += a * (at_rest - gamma * c * (vectors[7, j] + gamma * vectors[8, j]))
        twice[j] = a
        twice[j + N_NODES] = a
    quadratic = 0.0
    for j in range(N_NODES):  # in this order 16 sums grow side by side: 2.4 times as fast as one long loop
        along = 0.0
        for s in range(N_NODES // 2 + 1):
            i = s * N_NODES + j
            along += twice[j + s] * (matrices[0, i] + gamma * (matrices[1, i] + gamma * matrices[2, i]))
        quadratic += twice[j] * along
    differences = scalars[7] - 2.0 * gamma * c * scalars[8] + gamma * gamma * c * c * scalars[9]
    return scalars[1] + squares, differences - 2.0 * linear + quadratic


@njit(error_model="numpy", fastmath=_SUMS)
def _by_samples(force, v, y, counts, follows, gamma):  # type: ignore[no-untyped-def]
    """Give the sums of squares and of squared differences of samples; `force` is overwritten."""
    squares = 0.0
    differences = 0.0
    for i in range(force.size):
        r = y[i] - force[i] * (1.0 + gamma * v[i])
        force[i] = r
        squares += counts[i] * r * r
    for i in range(1, force.size):
        d = force[i] - force[i - 1]
        differences += follows[i] * d * d
    return squares, differences


@njit(error_model="numpy")
def calm_below(beta):  # type: ignore[no-untyped-def]
    """|e|/Fy up to which Eq. (1), in a block around 0, is the polynomial through its nodes to 1e-11 of Fy.

    |u|^beta is not analytic at 0, but smooth: its polynomial is good much further out than an ellipse says. The
    formulas lie below the largest |u| that serves at each beta, found by trying (``test_moments`` tries it again).
    """
    if beta < 3.0:
        return 0.0
    return 0.0201 * (beta / 3.0) ** 2.39 if beta < 11.0 else max(0.45, math.exp(-20.5 / beta))


@njit(error_model="numpy")
def _beyond(u1, u2, real, square, limit):  # type: ignore[no-untyped-def]
    """Whether the distances from u1 and u2 to a point (real part, square of the imaginary one) sum up to the limit.

    Written without square roots, of which the search through the blocks would take more than all forms together.
    """
    a = (u1 - real) * (u1 - real) + square
    b = (u2 - real) * (u2 - real) + square
    rest = limit * limit - a - b
    return rest <= 0.0 or 4.0 * a * b >= rest * rest


@njit(error_model="numpy")
def shape_of(beta):  # type: ignore[no-untyped-def]
    """Give what `is_polynomial` needs to know of Eq. (1) with this beta, shape (N_SHAPE,).

    The singular points are +-exp(+-i pi / beta), and 0, where |u|^beta counts only beyond the height `NEGLIGIBLE`, and
    not at all in a block that `calm_below` holds: real part and square of the imaginary part of the first, the second,
    its square, and the last; then the half-axes' factor of an ellipse that is sharp enough; then for each of
    `TAIL_SHARPNESS` how far an ellipse may reach.
    """
    out = np.empty(N_SHAPE)
    out[0] = abs(math.cos(math.pi / beta))
    out[1] = math.sin(math.pi / beta) ** 2
    out[2] = (NEGLIGIBLE * beta) ** (1.0 / beta)
    out[3] = out[2] * out[2]
    out[4] = calm_below(beta)
    sharpness = (SHARP_ENOUGH / beta) ** (1.0 / N_NODES)
    out[5] = 0.5 * (sharpness + 1.0 / sharpness)
    for i in range(TAIL_REACH.size):
        height = 0.25 * TAIL * beta * TAIL_SHARPNESS[i] ** (N_NODES - 1) * (TAIL_SHARPNESS[i] - 1.0)
        out[6 + i] = min(height, 0.5) ** (1.0 / beta)
    return out


@njit(error_model="numpy")
def is_polynomial(u1, u2, shape, sense):  # type: ignore[no-untyped-def]
    """Say whether Eq. (1) from u1 to u2 (in Fy) is its polynomial to 1e-11 of Fy; `shape` is `shape_of` beta."""
    if u1 * sense < 0.0 and u2 * sense < 0.0:
        return True  # the continuous rule on its way down is a straight line
    if max(-u1, u2) <= shape[4]:
        return True
    limit = shape[5] * (u2 - u1)
    nearer = math.copysign(shape[0], u1 + u2)  # of the two on either side
    if _beyond(u1, u2, nearer, shape[1], limit) and _beyond(u1, u2, 0.0, shape[3], limit):
        return True
    if u1 * u2 <= 0.0:
        return False
    centre, half = 0.5 * abs(u1 + u2), 0.5 * (u2 - u1)
    for i in range(TAIL_REACH.size):
        reach = TAIL_REACH[i] * half
        if (centre + reach <= shape[6 + i] and reach - centre < shape[2]) or (centre - reach) * shape[6 + i] >= 1.0:
            return True
    return False


@njit(error_model="numpy")
def _ends_of_stretches(points, weight, pair, half, turning, resets, law, knee, senses):  # type: ignore[no-untyped-def]
    """Sum of squares at the ends of stretches, and of squared differences across reversals."""
    squares, differences, before = 0.0, 0.0, 0.0
    for p in range(weight.size):
        k = half[p]
        e = law[0] * (points[0, p] - turning[k]) + resets[k]
        r = points[2, p] - held_at(e, senses[k], law[1], law[2], knee) * (1.0 + law[3] * points[1, p])
        squares += weight[p] * r * r
        if pair[p] > 0:
            differences += (r - before) ** 2
        before = r
    return squares, differences


@njit(cache=True, nogil=True, error_model="numpy")
def sums_of_many(motion, tree, sums, packed, ends, laws, start_force, variant):  # type: ignore[no-untyped-def]  # noqa: PLR0915
    """Give the sums for each row of `laws` (K, Fy, beta, gamma).

    Columns: squares, squared differences, squares at the ends of stretches, and the squares without any law, against
    which the rounding error of the first is to be judged.
    """
    turning, direction = motion
    blocks, of_half = tree
    bounds, scalars, vectors, matrices = sums
    columns, offset = packed
    points, weight, pair, half = ends
    m, n_half = laws.shape[0], turning.size
    out = np.zeros((m, 4))
    senses = np.zeros(n_half)
    if variant == CONTINUOUS:
        senses[:] = direction
    resets = np.empty((m, n_half))
    knees = [knee_of(laws[j, 2]) for j in range(m)]
    elastic, shapes = np.empty(m), np.empty((m, N_SHAPE))
    for j in range(m):
        elastic[j] = elastic_below(laws[j, 2])
        shapes[j] = shape_of(laws[j, 2])
        resets[j, 0] = start_force
        for k in range(n_half - 1):
            e = laws[j, 0] * (turning[k + 1] - turning[k]) + resets[j, k]
            resets[j, k + 1] = held_at(e, senses[k], laws[j, 1], laws[j, 2], knees[j])
        out[j, 2], out[j, 1] = _ends_of_stretches(
            points, weight, pair, half, turning, resets[j], laws[j], knees[j], senses
        )
    following = np.empty(m, dtype=np.int64)
    nodes, h, twice = np.empty(N_NODES), np.empty(N_NODES), np.empty(2 * N_NODES)
    force = np.empty(max(1, np.max(offset[1:] - offset[:-1])))
    for k in range(n_half):
        following[:] = of_half[k]
        for i in range(of_half[k], of_half[k + 1]):
            low, high = bounds[i, 0], bounds[i, 1]
            for q in range(N_NODES):
                nodes[q] = 0.5 * (low + high) + 0.5 * (high - low) * NODES[q]
            for j in range(m):  # block by block, so that its sums are fetched once for all parameter sets
                if following[j] != i:
                    continue
                stiffness, capacity, beta, gamma = laws[j, 0], laws[j, 1], laws[j, 2], laws[j, 3]
                u1 = (stiffness * (low - turning[k]) + resets[j, k]) / capacity
                u2 = (stiffness * (high - turning[k]) + resets[j, k]) / capacity
                following[j] = blocks[i, 2]
                if max(u1, -u2) * elastic[j] > 1.0 and not u1 * senses[k] < 0.0:
                    f = math.copysign(capacity, u1)
                    b = f - scalars[i, 0]
                    g = gamma * f
                    out[j, 0] += scalars[i, 1] - 2.0 * (b * scalars[i, 2] + g * scalars[i, 3])
                    out[j, 0] += b * (b * scalars[i, 4] + 2.0 * g * scalars[i, 5]) + g * g * scalars[i, 6]
                    out[j, 1] += scalars[i, 7] - 2.0 * g * scalars[i, 8] + g * g * scalars[i, 9]
                    out[j, 3] += scalars[i, 1]
                elif is_polynomial(u1, u2, shapes[j], senses[k]):
                    _fill_nodes(h, nodes, turning[k], resets[j, k], stiffness, capacity, beta, knees[j], senses[k])
                    squares, differences = _by_nodes(h, gamma, scalars[i], vectors[i], matrices[i], twice)
                    out[j, 0] += squares
                    out[j, 1] += differences
                    out[j, 3] += scalars[i, 1]
                elif blocks[i, 3] == 1:
                    p, q = offset[i], offset[i + 1]
                    own = force[: q - p]
                    x = columns[0, p:q]
                    fill_branch(own, x, turning[k], resets[j, k], stiffness, capacity, beta, knees[j], senses[k])
                    squares, differences = _by_samples(
                        own, columns[1, p:q], columns[2, p:q], columns[3, p:q], columns[4, p:q], gamma
                    )
                    out[j, 0] += squares
                    out[j, 1] += differences
                else:
                    following[j] = i + 1
    return out
