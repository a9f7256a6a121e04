"""Compiled sampler of the hierarchy: slice sampling with the device values integrated out in closed form.

Coordinates are updated one at a time by slice sampling (Neal 2003), which has no step size to tune wrongly. The
hyperparameters are updated with the set values held and, every other sweep, with the standardised set values held
(ancillarity-sufficiency interweaving, Yu and Meng 2011); without the second update a chain stalls wherever the
sets are alike or say little about their own spread.
"""

import math
from functools import partial

import numpy as np
from numba import njit

from shj_bayes.model.kernel import exp2, log2

MEAN, LOG_SPREAD, C_S, C_TAU0, C_OMEGA, A_M, A_S, A_TAU0, A_OMEGA = range(9)
_ROOT_HALF = math.sqrt(0.5)
_PER_LN2 = 1.0 / math.log(2.0)
_LOWEST, _SMALLEST = -1000.0, 1e-300  # powers of two and likelihoods below these count as 0
_MAX_STEPS = 40
# Compiled without counting who refers to the arrays: they belong to the caller, nothing is made here, and the atomic
# counting would take three quarters of an evaluation.
_uncounted = partial(njit, cache=True, error_model="numpy", _nrt=False)


@_uncounted()
def _mass_of_pieces(start, stop, mu, tau, first, second, weight):  # type: ignore[no-untyped-def]
    """Integral of adjoining constant pieces against a normal, with the error function of the nearer tail."""
    scale = _ROOT_HALF / tau
    total = 0.0
    if first[start] > mu:
        edge = math.erfc((first[start] - mu) * scale)
        for i in range(start, stop):
            if edge == 0.0:
                break
            following = math.erfc((second[i] - mu) * scale)
            total += weight[i] * (edge - following)
            edge = following
        return 0.5 * total
    if second[stop - 1] < mu:
        edge = math.erfc((mu - second[stop - 1]) * scale)
        for i in range(stop - 1, start - 1, -1):
            if edge == 0.0:
                break
            following = math.erfc((mu - first[i]) * scale)
            total += weight[i] * (edge - following)
            edge = following
        return 0.5 * total
    edge = math.erf((first[start] - mu) * scale)
    for i in range(start, stop):
        following = math.erf((second[i] - mu) * scale)
        total += weight[i] * (following - edge)
        edge = following
    return 0.5 * total


@_uncounted(fastmath={"contract"})
def _fill_components(out, begin, end, mu, tau, centre, sd, weight):  # type: ignore[no-untyped-def]
    """Fill `out` with the densities of normal components, each widened by tau; a loop of vector instructions."""
    for i in range(begin, end):
        precision = 1.0 / (tau * tau + sd[i] * sd[i])
        power = -0.5 * _PER_LN2 * (centre[i] - mu) * (centre[i] - mu) * precision
        density = exp2(max(power, _LOWEST)) * math.sqrt(precision) * weight[i]
        out[i] = density if power > _LOWEST else 0.0


@_uncounted(fastmath={"contract", "reassoc", "nsz"})
def _sum_of_logs(values, begin, end):  # type: ignore[no-untyped-def]
    """Sum of natural logarithms of positive normal doubles."""
    total = 0.0
    for i in range(begin, end):
        total += log2(values[i])
    return total / _PER_LN2


@_uncounted()
def log_likelihood_of_set(s, mu, log_tau, lots, set_start, device_start, pieces, first, second, weight, work):  # type: ignore[no-untyped-def]  # noqa: PLR0913, PLR0917
    """Log likelihood of all devices of set ``s`` given its mean and log spread, device values integrated out.

    ``work`` is memory for a number for each component and one for each device.
    """
    tau = math.exp(log_tau)
    of_lot = 0.0
    if lots[s, 0] > 0.0:  # so many normal devices of one error
        variance = tau * tau + lots[s, 2]
        gap = lots[s, 1] - mu
        of_lot = -0.5 * (lots[s, 0] * math.log(variance) + (lots[s, 3] + lots[s, 0] * gap * gap) / variance)
    begin, end = set_start[s], set_start[s + 1]
    if begin == end:
        return of_lot
    # All components at once, also those of pieces (not used): a loop for each device would be too short for vectors.
    _fill_components(work, device_start[begin], device_start[end], mu, tau, first, second, weight)
    of_device = first.size
    for d in range(begin, end):
        value = 0.0
        if pieces[d]:
            value = _mass_of_pieces(device_start[d], device_start[d + 1], mu, tau, first, second, weight)
        else:
            for i in range(device_start[d], device_start[d + 1]):
                value += work[i]
        if not value > _SMALLEST:
            return -np.inf
        work[of_device + d] = value
    return of_lot + _sum_of_logs(work, of_device + begin, of_device + end)


@_uncounted()
def _log_prior_scale(code, x, prior):  # type: ignore[no-untyped-def]
    """Log prior of log S, log tau0 or log omega, with the factor of the logarithm."""
    if code in (C_S, A_S):  # half Student-t, 4 degrees of freedom
        r = math.exp(x) / prior[2]
        return x - 2.5 * math.log1p(0.25 * r * r)
    if code in (C_TAU0, A_TAU0):
        r = x - prior[3]
        if prior[4] > 0.0:
            return -0.5 * (r / prior[4]) ** 2
        return r - math.log1p(math.exp(2.0 * r)) if r < 300.0 else -r
    r = math.exp(x) / prior[5]
    return x - 0.5 * r * r


@_uncounted()
def _target(code, s, x, mu, lt, hyper, z, data, prior):  # type: ignore[no-untyped-def]
    """Log density, up to a constant, of one coordinate at ``x`` given everything else.

    ``hyper`` holds M, log S, log tau0, log omega; ``z`` the standardised set values during A_* updates.
    """
    n = mu.size
    if code == MEAN:
        r = (x - hyper[0]) * math.exp(-hyper[1])
        return log_likelihood_of_set(s, x, lt[s], *data) - 0.5 * r * r
    if code == LOG_SPREAD:
        r = (x - hyper[2]) * math.exp(-hyper[3])
        return log_likelihood_of_set(s, mu[s], x, *data) - 0.5 * r * r
    if code in (C_S, C_TAU0, C_OMEGA):
        total = _log_prior_scale(code, x, prior)
        centre = hyper[0] if code == C_S else (x if code == C_TAU0 else hyper[2])
        log_scale = hyper[3] if code == C_TAU0 else x
        precision = math.exp(-log_scale)
        for k in range(n):
            r = ((mu[k] if code == C_S else lt[k]) - centre) * precision
            total -= 0.5 * r * r + log_scale
        return total
    if code == A_M:
        r = (x - prior[0]) / prior[1]
        total = -0.5 * r * r
    else:
        total = _log_prior_scale(code, x, prior)
    centre = x if code in (A_M, A_TAU0) else (hyper[0] if code == A_S else hyper[2])
    scale = math.exp(x if code in (A_S, A_OMEGA) else (hyper[1] if code == A_M else hyper[3]))
    for k in range(n):
        moved = centre + scale * z[k]
        m, t = (moved, lt[k]) if code in (A_M, A_S) else (mu[k], moved)
        total += log_likelihood_of_set(k, m, t, *data)
        if total == -np.inf:
            return total
    return total


@njit(cache=True, error_model="numpy")
def _slice(code, s, x0, width, mu, lt, hyper, z, data, prior, rng):  # type: ignore[no-untyped-def]  # noqa: PLR0913, PLR0917
    """One slice-sampling update (stepping out, shrinking; Neal 2003, figures 3 and 5)."""
    level = _target(code, s, x0, mu, lt, hyper, z, data, prior) - rng.standard_exponential()
    left = x0 - width * rng.random()
    right = left + width
    before = int(rng.random() * _MAX_STEPS)
    after = _MAX_STEPS - 1 - before
    while before > 0 and _target(code, s, left, mu, lt, hyper, z, data, prior) > level:
        left -= width
        before -= 1
    while after > 0 and _target(code, s, right, mu, lt, hyper, z, data, prior) > level:
        right += width
        after -= 1
    while True:
        x = left + (right - left) * rng.random()
        if _target(code, s, x, mu, lt, hyper, z, data, prior) >= level:
            return x
        if right - left < 1e-14 * (1.0 + abs(x0)):
            return x0
        if x < x0:
            left = x
        else:
            right = x


@njit(cache=True, error_model="numpy")
def _update_hyper(mu, lt, hyper, z, width, interweave, data, prior, rng):  # type: ignore[no-untyped-def]
    """Update M, S, tau0 and omega, with the second kind of update when ``interweave``."""
    n = mu.size
    precision = n * math.exp(-2.0 * hyper[1]) + 1.0 / prior[1] ** 2
    mean = (mu.sum() * math.exp(-2.0 * hyper[1]) + prior[0] / prior[1] ** 2) / precision
    hyper[0] = mean + rng.standard_normal() / math.sqrt(precision)
    for h in range(1, 4):
        hyper[h] = _slice(C_S + h - 1, 0, hyper[h], width[h], mu, lt, hyper, z, data, prior, rng)
    for h in range(4 if interweave else 0):
        for k in range(n):
            if h < 2:
                z[k] = (mu[k] - hyper[0]) * math.exp(-hyper[1])
            else:
                z[k] = (lt[k] - hyper[2]) * math.exp(-hyper[3])
        hyper[h] = _slice(A_M + h, 0, hyper[h], width[h], mu, lt, hyper, z, data, prior, rng)
        for k in range(n):
            if h < 2:
                mu[k] = hyper[0] + math.exp(hyper[1]) * z[k]
            else:
                lt[k] = hyper[2] + math.exp(hyper[3]) * z[k]


@njit(cache=True, nogil=True, error_model="numpy")
def run_chain(mu, lt, hyper, data, prior, n_warm, n_keep, thin, rng):  # type: ignore[no-untyped-def]
    """Run one chain; returns draws of the set means, log spreads and hyperparameters.

    Slice widths are set from the visited range during warm-up and held afterwards; any width is correct.
    """
    n = mu.size
    z = np.zeros(n)
    width_mu, width_lt = np.full(n, math.exp(hyper[2])), np.ones(n)
    width = np.array([math.exp(hyper[1]), 1.0, 1.0, 1.0])
    low, high = np.full((3, n), np.inf), np.full((3, n), -np.inf)
    low_h, high_h = np.full(4, np.inf), np.full(4, -np.inf)
    out_mu, out_lt, out_hyper = np.empty((n_keep, n)), np.empty((n_keep, n)), np.empty((n_keep, 4))
    for sweep in range(-n_warm, n_keep * thin):
        for s in range(n):
            lt[s] = _slice(LOG_SPREAD, s, lt[s], width_lt[s], mu, lt, hyper, z, data, prior, rng)
            mu[s] = _slice(MEAN, s, mu[s], width_mu[s], mu, lt, hyper, z, data, prior, rng)
        _update_hyper(mu, lt, hyper, z, width, sweep % 2 == 0, data, prior, rng)
        if sweep < 0:
            for s in range(n):
                low[0, s], high[0, s] = min(low[0, s], mu[s]), max(high[0, s], mu[s])
                low[1, s], high[1, s] = min(low[1, s], lt[s]), max(high[1, s], lt[s])
            low_h, high_h = np.minimum(low_h, hyper), np.maximum(high_h, hyper)
            if (sweep + n_warm) % 100 == 99:
                width_mu, width_lt = 0.4 * (high[0] - low[0]), 0.4 * (high[1] - low[1])
                width = 0.4 * (high_h - low_h)
                low[:], high[:] = np.inf, -np.inf
                low_h, high_h = np.full(4, np.inf), np.full(4, -np.inf)
        elif sweep % thin == thin - 1:
            out_mu[sweep // thin], out_lt[sweep // thin], out_hyper[sweep // thin] = mu, lt, hyper
    return out_mu, out_lt, out_hyper
