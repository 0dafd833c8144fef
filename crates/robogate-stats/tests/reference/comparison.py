"""Prints the error and the pairs of the sequential comparison of two policies, exactly, by recursion over the numbers of
discordant pairs: docs/results/comparison-power.md has the tables.

A look rejects "worse by 5 points or more" where its statistic reaches C (k/K)^(shape - 1/2). Up to 300 pairs the statistic is
that of the exact unconditional p-value, above that Tango's. Pocock's limits have the shape 0.5.

Usage: python comparison.py   (packages: requirements.txt; one minute)
"""

import numpy as np
from scipy.optimize import brentq
from scipy.signal import fftconvolve
from scipy.special import gammaln
from scipy.stats import norm

MARGIN, ROUNDS, PER_ROUND, ALPHA, EXACT = 0.05, 20, 68, 0.05, 300
MOST = 260  # discordant pairs of each kind
B, C = np.meshgrid(np.arange(MOST), np.arange(MOST), indexing="ij")
LN_FACTORIAL = gammaln(np.arange(3000) + 1)


def statistic(b, c, n):
    linear = -b - c - (2 * n - c + b) * MARGIN
    q = (np.sqrt(np.maximum(linear**2 - 8 * n * b * MARGIN * (1 + MARGIN), 0)) - linear) / (4 * n)
    variance = n * (2 * q - MARGIN * (1 + MARGIN))
    excess = c - b + n * MARGIN
    return np.where(variance > 1e-12, excess / np.sqrt(np.maximum(variance, 1e-300)), np.sign(excess) * 1e9)


def tables(n, only_first, only_second):
    """Probabilities of all tables of n pairs."""
    rest = n - B - C
    with np.errstate(divide="ignore", invalid="ignore"):
        ln = LN_FACTORIAL[n] - LN_FACTORIAL[B] - LN_FACTORIAL[C] - LN_FACTORIAL[np.maximum(rest, 0)]
        ln += np.where(B > 0, B * np.log(only_first), 0) + np.where(C > 0, C * np.log(max(only_second, 1e-300)), 0)
        ln += rest * np.log(1 - only_first - only_second)
    return np.where(rest >= 0, np.exp(ln), 0)


def crossing(limit, shape):
    """Probability that Brownian motion crosses the limits, by the density on a grid of 0.02 standard deviations."""
    step = 0.02
    grid = np.arange(-40, 20, step)
    kernel = norm.pdf(np.arange(-8, 8 + step / 2, step)) * step
    density, crossed = norm.pdf(grid), 0.0
    for k in range(1, ROUNDS + 1):
        if k > 1:
            density = fftconvolve(density, kernel, mode="same").clip(0)
        top = limit * (k / ROUNDS) ** (shape - 0.5) * np.sqrt(k)
        above = np.clip((grid - top) / step + 0.5, 0, 1)
        crossed += (density * above).sum() * step
        density = density * (1 - above)
    return crossed


def regions(shape):
    limit = brentq(lambda limit: crossing(limit, shape) - ALPHA, 1.6, 4)
    found = []
    for k in range(1, ROUNDS + 1):
        n, z = PER_ROUND * k, limit * (k / ROUNDS) ** (shape - 0.5)
        possible, values = B + C <= n, statistic(B, C, n)
        if n <= EXACT:
            nuisance = [tables(n, q, q - MARGIN) for q in MARGIN + np.linspace(0, 1, 41) ** 2 * 0.35]
            order = np.unique(values[possible & (values > 1)])[::-1]
            tail = lambda v: max(p[(values >= v - 1e-12) & possible].sum() for p in nuisance)
            low, high = -1, len(order) - 1
            while low < high:
                middle = (low + high + 1) // 2
                low, high = (middle, high) if tail(order[middle]) <= norm.sf(z) else (low, middle - 1)
            found.append((values >= order[low] - 1e-12) & possible if low >= 0 else np.zeros_like(possible))
        else:
            found.append((values >= z) & possible)
    return limit, found


def run(regions, only_first, only_second):
    """Probability of "not worse" and mean number of pairs."""
    step, current, met, pairs = tables(PER_ROUND, only_first, only_second), None, 0.0, 0.0
    for k, region in enumerate(regions, start=1):
        current = step if current is None else fftconvolve(current, step)[:MOST, :MOST].clip(0)
        hit = current[region].sum()
        met, pairs = met + hit, pairs + PER_ROUND * k * hit
        current = np.where(region, 0, current)
    return met, pairs + PER_ROUND * ROUNDS * (1 - met)


pocock, rising = regions(0.5), regions(0.6)
print(f"constants: {pocock[0]:.3f} and {rising[0]:.3f}")
print("\n| pairs that disagree, of 100 | error, equal limits | error, rising limits |\n|---:|---:|---:|")
for q in [0.05, 0.0525, 0.055, 0.06, 0.07, 0.08, 0.1, 0.125, 0.175, 0.25]:
    errors = [run(found, q, q - MARGIN)[0] for _, found in (pocock, rising)]
    print(f"| {100 * (2 * q - MARGIN):.1f} | " + " | ".join(f"{100 * e:.2f} %" for e in errors) + " |")
print("\n| difference, points | pairs that disagree, of 100 | shown, equal | shown, rising | pairs, equal | pairs, rising |")
print("|---:|---:|---:|---:|---:|---:|")
for difference, disagree in [(0, 0.02), (0, 0.05), (0, 0.1), (0.05, 0.1), (0.1, 0.15), (-0.0125, 0.1), (-0.025, 0.1)]:
    (a, m), (b, n) = [run(f, (disagree - difference) / 2, (disagree + difference) / 2) for _, f in (pocock, rising)]
    print(f"| {100 * difference:+.2f} | {100 * disagree:.0f} | {100 * a:.1f} % | {100 * b:.1f} % | {m:.0f} | {n:.0f} |")
