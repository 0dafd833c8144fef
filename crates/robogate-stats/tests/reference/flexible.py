"""Compares the flexible risk model with scikit-learn's HistGradientBoosting and an additive model (pyGAM) on ten laws of success.

    python flexible.py write DIR     writes DIR/NAME.train.csv and DIR/NAME.test.csv (20,000 rows with the true chance of success)
    cargo run --release -p robogate-stats --example flexible -- DIR > DIR/ours.csv
    python flexible.py compare DIR   prints the table of docs/results/risk-model.md

All seeds are fixed.  Packages: numpy, scikit-learn, pygam.
"""
import csv
import sys

import numpy as np

TEST = 20_000


def logistic(t):
    return 1 / (1 + np.exp(-t))


def words(x, n):
    return np.floor(x * n)


# Name, rows for training, columns, chance of success of rows x in [0, 1)^d.
LAWS = [
    ("linear", 2000, 6, lambda x: logistic(2.5 - 3 * x[:, 0] - 2 * x[:, 1] + 1.5 * x[:, 2])),
    ("smooth additive", 2000, 7, lambda x: logistic(1 + 3 * np.sin(6 * x[:, 0]) - 8 * (x[:, 1] - .5) ** 2 + 2 * np.sqrt(x[:, 2]) - 1.5 * x[:, 3])),
    ("delay and mass x friction", 2000, 5, lambda x: (.97 - .39 * x[:, 0]) * np.where(x[:, 1] > .4 + .6 * x[:, 2], .25, 1)),
    ("cliff", 2000, 6, lambda x: np.where(x[:, 0] + .5 * x[:, 1] < .9, .95, .1)),
    ("jump in one", 2000, 5, lambda x: np.where(x[:, 0] < .7, .93, .3)),
    ("islands", 2000, 4, lambda x: np.where(np.sin(9 * x[:, 0]) * np.sin(9 * x[:, 1]) > .2, .2, .9)),
    ("competing risks", 2000, 8, lambda x: logistic(14 * (x[:, 0] * (.4 + .6 * x[:, 1]) - .45 * x[:, 2])) * logistic(16 * (.8 - x[:, 3])) * np.where(x[:, 4] > .85, .6, 1)),
    ("categories", 2000, 5, lambda x: logistic(np.array([2., .5, -1., 1.5, -2.])[words(x[:, 0], 5).astype(int)] + 2 * (words(x[:, 1], 2) - .5) * (x[:, 2] - .5) * 6)),
    ("rare failures", 2000, 6, lambda x: 1 - .005 - .25 * (x[:, 0] > .85) * x[:, 1]),
    ("no effect", 2000, 6, lambda x: np.full(len(x), .8)),
]


def rows(name, n, d, law, stream):
    rng = np.random.default_rng([len(name), ord(name[0]), ord(name[-1]), stream])
    x = rng.random((n, d))
    p = law(x)
    return x, p, rng.random(n) < p


def columns(name, x):
    if name != "categories":
        return x
    return np.c_[[words(x[:, 0], 5) == k for k in range(5)] + [words(x[:, 1], 2) == 1] + [x[:, j] for j in range(2, x.shape[1])]].T.astype(float)


def write(folder):
    for name, n, d, law in LAWS:
        for part, count, stream in (("train", n, 1), ("test", TEST, 2)):
            x, p, y = rows(name, count, d, law, stream)
            with open(f"{folder}/{name}.{part}.csv", "w", newline="") as file:
                csv.writer(file).writerows([*map(repr, map(float, row)), int(s)] for row, s in zip(columns(name, x), y))


def scores(p, y, truth):
    order = np.argsort(p, kind="stable")
    bins = np.array_split(order, 10)
    ece = sum(len(b) * abs(p[b].mean() - truth[b].mean()) for b in bins) / len(p)
    return ((p - y) ** 2).mean(), ece


def compare(folder):
    from pygam import LogisticGAM
    from sklearn.ensemble import HistGradientBoostingClassifier
    ours = {row[0]: np.array(row[2:], float) for row in csv.reader(open(f"{folder}/ours.csv", newline=""))}
    shares = {row[0]: row[1] for row in csv.reader(open(f"{folder}/ours.csv", newline=""))}
    print("| law | floor | this model (share of boosting) | HistGradientBoosting | GAM | ratio to the better | calibration error |")
    print("|---|---|---|---|---|---|---|")
    for name, n, d, law in LAWS:
        x, _, y = rows(name, n, d, law, 1)
        tx, tp, ty = rows(name, TEST, d, law, 2)
        x, tx = columns(name, x), columns(name, tx)
        boosting = HistGradientBoostingClassifier(random_state=0).fit(x, y).predict_proba(tx)[:, 1]
        gam = LogisticGAM(verbose=False).gridsearch(x, y, lam=np.logspace(-1, 3, 5), progress=False).predict_proba(tx)
        b = [scores(p, ty, tp) for p in (ours[name], boosting, gam)]
        floor = ((tp - ty) ** 2).mean()
        print(f"| {name} | {floor:.4f} | {b[0][0]:.4f} ({shares[name]}) | {b[1][0]:.4f} | {b[2][0]:.4f} | {b[0][0] / min(b[1][0], b[2][0]):.3f} | "
              f"{b[0][1]:.4f} (HGB {b[1][1]:.4f}, GAM {b[2][1]:.4f}) |", flush=True)


if __name__ == "__main__":
    {"write": write, "compare": compare}[sys.argv[1]](sys.argv[2])
