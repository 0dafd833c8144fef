"""Writes gate.json: differences of rates, joint p-values of repeated looks, and stratified evidence, each computed in
another way than the crate does.

- independent differences: the p-value of statsmodels (Miettinen and Nurminen), and their statistic from a numerical maximum
  of the constrained likelihood, solved by brentq
- paired differences: Tango's statistic from a numerical maximum of the constrained likelihood, solved by brentq
- joint p-values, and the limits that rise from look to look: the multivariate normal distribution of the looks (scipy)
- stratified evidence: the constrained maximum of the likelihood by SLSQP, everything else by direct sums and quadrature

Usage: python gate.py   (packages: requirements.txt)
"""

import json
import warnings
from pathlib import Path

import numpy as np
from scipy import integrate, optimize, stats
from statsmodels.stats.proportion import test_proportions_2indep

warnings.simplefilter("ignore")
random = np.random.default_rng(2026)


def miettinen_nurminen_z(x1, n1, x2, n2, d):
    """Score statistic of p1 - p2 = d."""

    def minus(p2):
        p1 = p2 + d
        terms = [(x1, p1), (n1 - x1, 1 - p1), (x2, p2), (n2 - x2, 1 - p2)]
        return -sum(k * np.log(max(p, 1e-300)) for k, p in terms if k > 0)

    low, high = max(0.0, -d), min(1.0, 1.0 - d)
    p2 = optimize.minimize_scalar(minus, bounds=(low, high), method="bounded", options={"xatol": 1e-13}).x
    p1, n = p2 + d, n1 + n2
    variance = (p1 * (1 - p1) / n1 + p2 * (1 - p2) / n2) * n / (n - 1)
    return (x1 / n1 - x2 / n2 - d) / np.sqrt(variance)


def independent(x1, n1, x2, n2):
    z = stats.norm.ppf(0.975)
    estimate = x1 / n1 - x2 / n2
    statistic = lambda d: miettinen_nurminen_z(x1, n1, x2, n2, d)
    low = optimize.brentq(lambda d: statistic(d) - z, max(estimate - 0.6, -0.95), estimate - 1e-6, xtol=1e-12)
    high = optimize.brentq(lambda d: statistic(d) + z, estimate + 1e-6, min(estimate + 0.6, 0.95), xtol=1e-12)
    p = test_proportions_2indep(x1, n1, x2, n2, method="score", compare="diff").pvalue
    return {"x1": x1, "n1": n1, "x2": x2, "n2": n2, "low": low, "high": high, "p": p}


def tango_z(b, c, n, d):
    """Score statistic of p1 - p2 = d; b: only the first."""

    def minus(q):  # q: probability of "only the first"; "only the second" is q - d
        terms = [(b, q), (c, q - d), (n - b - c, 1 - 2 * q + d)]
        return -sum(k * np.log(max(p, 1e-300)) for k, p in terms if k > 0)

    low, high = max(d, 0.0), (1 + d) / 2
    q = optimize.minimize_scalar(minus, bounds=(low, high), method="bounded", options={"xatol": 1e-13}).x
    variance = n * (2 * q - d - d * d)
    return (b - c - n * d) / np.sqrt(max(variance, 1e-300))


def paired(b, c, n):
    z = stats.norm.ppf(0.975)
    estimate = (b - c) / n
    low = optimize.brentq(lambda d: tango_z(b, c, n, d) - z, -1 + 1e-9, estimate - 1e-9, xtol=1e-12)
    high = optimize.brentq(lambda d: tango_z(b, c, n, d) + z, estimate + 1e-9, 1 - 1e-9, xtol=1e-12)
    p = 2 * stats.norm.sf(abs(tango_z(b, c, n, 0.0)))
    return {"b": b, "c": c, "n": n, "low": low, "high": high, "p": p}


def joint(p, looks):
    z = stats.norm.isf(p)
    k = np.arange(1, looks + 1)
    covariance = np.sqrt(np.minimum.outer(k, k) / np.maximum.outer(k, k))
    inside = stats.multivariate_normal(cov=covariance, allow_singular=True, maxpts=4_000_000, abseps=1e-7).cdf(
        np.full(looks, z)
    )
    return {"p": p, "looks": looks, "joint": 1 - inside}


def boundary(limit, looks):
    """Probability that a look k has a statistic above limit (k/K)^0.1."""
    k = np.arange(1, looks + 1)
    covariance = np.sqrt(np.minimum.outer(k, k) / np.maximum.outer(k, k))
    inside = stats.multivariate_normal(cov=covariance, allow_singular=True, maxpts=4_000_000, abseps=1e-7).cdf(
        limit * (k / looks) ** 0.1
    )
    return {"limit": limit, "looks": looks, "joint": 1 - inside}


def weights(p0):
    """Weights of "always", of all larger rates and of typical ones, and the failures of the typical ones relative to the limit's."""
    if p0 < 0.5:
        return 0.02, 0.90, 0.03, (0.2, 0.7)
    return (0.52, 0.22, 0.24, (0.15, 0.35)) if 1 - p0 <= 0.015 + 1e-9 else (0.05, 0.60, 0.30, (0.2, 0.7))


def mixture(k, n, p0, low, high):
    """Mean likelihood ratio over the rates from low to high."""
    log = lambda q: k * np.log(q / p0) + (n - k) * np.log((1 - q) / (1 - p0))
    value, _ = integrate.quad(lambda q: np.exp(log(q)), low, high, epsabs=0, epsrel=1e-11, limit=500)
    return value / (high - low)


def pooled(k, n, p0):
    always, broad, typical, (few, many) = weights(p0)
    spike = p0 ** (-n) if k == n else 0.0
    focus = mixture(k, n, p0, 1 - many * (1 - p0), 1 - few * (1 - p0))
    return always * spike + broad * mixture(k, n, p0, p0, 1) + typical * focus


def stratified(rounds, p0):
    rounds = np.array(rounds, dtype=bool)
    strata = rounds.shape[1]
    weight = sum(weights(p0)[:3])
    evidence = pooled(int(rounds.sum()), rounds.size, p0)
    bets = rounds[1:]
    k, n = bets.sum(axis=0).astype(float), float(len(bets))

    def minus(m):
        m = np.clip(m, 1e-12, 1 - 1e-12)
        return -(k * np.log(m) + (n - k) * np.log1p(-m)).sum()

    best = optimize.minimize(
        minus,
        np.full(strata, p0 * 0.99),
        method="SLSQP",
        bounds=[(1e-12, 1 - 1e-12)] * strata,
        constraints={"type": "ineq", "fun": lambda m: strata * p0 - m.sum()},
        options={"maxiter": 2000, "ftol": 1e-14},
    )
    for shrinkage, own, share in [(0.01, True, 0.7), (1.0, False, 0.3)]:
        log = 0.0
        for at in range(1, len(rounds)):
            before = rounds[:at]
            mean = (before.sum() + 0.5) / (before.size + 1)
            q = (before.sum(axis=0) + shrinkage * (0.5 if own else mean)) / (at + shrinkage)
            log += np.log(np.where(rounds[at], q, 1 - q)).sum()
        evidence += (1 - weight) * share * np.exp(log + best.fun)
    return {"rounds": rounds.astype(int).tolist(), "p0": p0, "ln_evidence": float(np.log(evidence))}


def scenarios():
    for rates, rounds, p0 in [
        ([1] * 9 + [0], 6, 0.8),
        ([0.9] * 8, 5, 0.7),
        ([1, 1, 1, 0.5, 0.2], 7, 0.6),
        ([1] * 12, 4, 0.98),
        ([0.95] * 12, 8, 0.92),
        ([1] * 12, 5, 0.99),
        ([1] * 11 + [0.7], 7, 0.99),
    ]:
        rates = np.array(rates)
        yield (random.random((rounds, len(rates))) < rates).tolist(), p0


out = {
    "independent": [
        independent(*case)
        for case in [(31, 50, 12, 47), (95, 100, 88, 100), (9, 10, 3, 12), (480, 500, 450, 500), (30, 40, 30, 40)]
    ],
    "paired": [paired(*case) for case in [(30, 12, 1000), (8, 2, 400), (55, 60, 2000), (100, 20, 500)]],
    "joint": [joint(*case) for case in [(0.01, 2), (0.0169, 5), (0.005, 5), (0.0116, 10), (0.001, 10)]],
    "boundary": [boundary(*case) for case in [(1.9, 2), (2.2, 3), (2.4, 5), (2.6, 10)]],
    "stratified": [stratified(rounds, p0) for rounds, p0 in scenarios()],
}
Path(__file__).with_name("gate.json").write_text(json.dumps(out, indent=1) + "\n")
