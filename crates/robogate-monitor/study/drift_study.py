"""Compares drift detectors on one question: a success rate of 0.95 drops to 0.92, 0.90 or 0.85 after 1,000 cycles without a change.

Rows: the paper's rule and the detectors of river at their default settings, with mean number of cycles to a false alarm and
delays. Each row also has the delays of the mixture Shiryaev-Roberts e-detector, whose limit is chosen for the same mean number of
cycles to a false alarm (or more). The e-detector is an independent NumPy implementation with the same eight alternatives as the Rust
code, so it also verifies the figures of `robogate monitor simulate`.

The e-detector and the paper's rule know the rate of 0.95, as the monitor knows it from a reference, while river's detectors learn it from
the stream. The last rows show the e-detector with an exact 99.2 % bound learnt from the first 500 cycles.

Setup: python3 -m venv venv && venv/bin/pip install -r crates/robogate-monitor/study/requirements.txt
Run:   venv/bin/python crates/robogate-monitor/study/drift_study.py"""

import argparse
import math

import numpy as np
from river import drift
from river.drift import binary
from scipy.stats import beta

RATE, DROPS, BEFORE = 0.95, (0.92, 0.90, 0.85), 1_000
# Maximum lengths of streams without and with a change. A mean with cut streams is a lower bound.
LONGEST_QUIET, LONGEST_DELAY = 300_000, 20_000
ODDS = np.array([1.4, 1.8, 2.3, 3.0, 4.0, 6.0, 12.0, 30.0])
WEIGHTS = np.array([0.18, 0.18, 0.18, 0.18, 0.13, 0.08, 0.04, 0.03])


class Papers:
    """The paper's rule for many streams at once: failures among the last 100 cycles."""

    def __init__(self, n, failures):
        self.ring, self.t, self.failures = np.zeros((100, n), bool), 0, failures
        self.count = np.zeros(n, int)

    def update(self, failed, wanted=None):
        at = self.t % 100
        self.count += failed.astype(int) - self.ring[at]
        self.ring[at] = failed
        self.t += 1
        return (self.count >= self.failures) & (self.t >= 100)


class EDetectors:
    """The e-detector for many streams at once: M_k <- (1 + M_k) e_k, restarted when the mixture reaches the limit."""

    def __init__(self, n, limit, bound=1 - RATE):
        bound = np.broadcast_to(np.asarray(bound, float)[..., None], (n, 1))
        q = ODDS * bound / (1 - bound + ODDS * bound)
        self.no, self.yes = (1 - q) / (1 - bound), q / bound
        self.m, self.limit = np.zeros((n, len(ODDS))), limit

    def update(self, failed, wanted=None):
        self.m = (1 + self.m) * np.where(failed[:, None], self.yes, self.no)
        reached = self.m @ WEIGHTS >= self.limit
        self.m[reached] = 0
        return reached


class LearningEDetectors:
    """The e-detector with a bound learnt from each stream's first 500 cycles."""

    def __init__(self, n, limit):
        self.n, self.limit, self.t, self.failures, self.inner = n, limit, 0, np.zeros(n), None

    def update(self, failed, wanted=None):
        self.t += 1
        if self.t <= 500:
            self.failures += failed
            if self.t == 500:
                # One of six bounds with a joint confidence of 95 %.
                bound = beta.ppf(1 - 0.05 / 6, self.failures + 1, 500 - self.failures)
                self.inner = EDetectors(self.n, self.limit, bound)
            return np.zeros(self.n, bool)
        return self.inner.update(failed, wanted)


class Rivers:
    """river's detectors, one for each stream."""

    def __init__(self, n, make):
        self.all = [make() for _ in range(n)]

    def update(self, failed, wanted=None):
        called = np.zeros(len(self.all), bool)
        for i in range(len(self.all)) if wanted is None else np.flatnonzero(wanted):
            self.all[i].update(int(failed[i]))
            called[i] = self.all[i].drift_detected
        return called


def first(rules, n, rng, failing, longest, before=0):
    """Number of cycles until each of n streams raises an alarm, or `longest` without one."""
    for _ in range(before):
        rules.update(rng.random(n) < 1 - RATE)
    lengths = np.full(n, longest)
    open_ = np.ones(n, bool)
    for t in range(1, longest + 1):
        called = rules.update(rng.random(n) < failing, open_) & open_
        lengths[called] = t
        open_ &= ~called
        if not open_.any():
            break
    return lengths


def quiet(make, n, seed):
    return first(make(n), n, np.random.default_rng(seed), 1 - RATE, LONGEST_QUIET)


def delays(make, n, seed):
    return [first(make(n), n, np.random.default_rng(seed + 1 + i), 1 - to, LONGEST_DELAY, BEFORE) for i, to in enumerate(DROPS)]


def mean(lengths, longest):
    cut = "> " if (lengths >= longest).any() else ""
    return f"{cut}{lengths.mean():,.0f} ± {lengths.std(ddof=1) / math.sqrt(len(lengths)):,.0f}"


def limit_with(run_length, n, seed):
    """The smallest limit, in steps of 10 %, with an observed mean run length of at least `run_length`. It is at most
    `run_length`, because the mean run length is at least the limit."""
    limit = max(10.0, run_length / 2)
    while True:
        lengths = quiet(lambda n: EDetectors(n, limit), n, seed)
        if lengths.mean() >= run_length or limit >= run_length:
            return limit
        limit = min(1.1 * limit, max(run_length, 10.0))


def row(name, make, n, n_quiet, seed, matched):
    lengths = quiet(make, n_quiet, seed)
    own = [mean(d, LONGEST_DELAY) for d in delays(make, n, seed)]
    beside = ["", "", "", ""]
    if matched:
        limit = limit_with(lengths.mean(), n, seed + 100)
        beside = [f"{limit:,.0f}"] + [mean(d, LONGEST_DELAY) for d in delays(lambda n: EDetectors(n, limit), n, seed)]
    print(f"| {name} | {mean(lengths, LONGEST_QUIET)} | " + " | ".join(own + beside) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    n, seed = arguments.streams, arguments.seed
    heads = ["rule", "to a false alarm"] + [f"to {to}" for to in DROPS]
    heads += ["e-detector's limit at that run length"] + [f"its delay to {to}" for to in DROPS]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for name, make in {
        "paper, warning (10 of 100 failed)": lambda n: Papers(n, 10),
        "paper, critical (15 of 100 failed)": lambda n: Papers(n, 15),
    }.items():
        row(name, make, n, n, seed, True)
    for name, make in {
        "river ADWIN": drift.ADWIN,
        "river PageHinkley": drift.PageHinkley,
        "river KSWIN": lambda: drift.KSWIN(seed=1),
        "river DDM": binary.DDM,
        "river EDDM": binary.EDDM,
        "river HDDM_A": binary.HDDMA,
        "river HDDM_W": binary.HDDMW,
    }.items():
        row(name, lambda n, make=make: Rivers(n, make), n // 2, max(n // 10, 10), seed, True)
    for limit in (2_000, 50_000):
        row(f"e-detector, limit {limit:,}", lambda n: EDetectors(n, limit), n, n, seed, False)
        row(f"e-detector, limit {limit:,}, bound learnt from 500 cycles", lambda n: LearningEDetectors(n, limit), n, n // 4, seed, False)


main()
