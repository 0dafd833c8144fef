"""Reference values of survival.rs and renewal.rs: lifelines (curve, quantiles), statsmodels (curve), SciPy and closed forms.  Writes survival.json."""
import json
import pathlib

import numpy as np
from lifelines import KaplanMeierFitter
from lifelines.utils import qth_survival_times
from scipy import stats
from statsmodels.duration.survfunc import SurvfuncRight

OUT = pathlib.Path(__file__).with_name("survival.json")


def curve(seed, n, limit):
    rng = np.random.default_rng(seed)
    # Rounded times have ties; a few failures are censored before the limit.
    times = np.round(3 + rng.gamma(4, 1.5, n), 1)
    failed = rng.random(n) < .1
    times = np.where(failed, np.round(times * rng.random(n), 1), times)
    events = (times < limit) & ~failed
    times = np.minimum(times, limit)
    fit = KaplanMeierFitter().fit(times, events)
    ours = SurvfuncRight(times, events.astype(int))
    at = ours.surv_times
    band = fit.confidence_interval_.loc[at].to_numpy()
    assert np.allclose(fit.survival_function_.loc[at].to_numpy()[:, 0], ours.surv_prob)
    quantiles = {}
    for q in (.5, .9):
        ends = qth_survival_times(1 - q, fit.confidence_interval_).to_numpy().ravel()
        quantiles[str(q)] = [float(x) if np.isfinite(x) else None for x in (fit.percentile(1 - q), *ends)]
    return dict(times=times.tolist(), events=events.tolist(), at=at.tolist(), survival=ours.surv_prob.tolist(), low=band[:, 0].tolist(),
                high=band[:, 1].tolist(), at_risk=[int(n) for n in ours.n_risk], quantiles=quantiles)


def fieller(seed, n):
    rng = np.random.default_rng(seed)
    success = rng.random(n) < .8
    time = np.where(success, 6 + rng.exponential(2, n), 15.)
    r, t = success.mean(), time.mean()
    v = np.cov(success.astype(float), time)
    f = stats.t.ppf(.975, n - 1) ** 2 / n
    low, high = sorted(np.roots([t * t - f * v[1, 1], -2 * (r * t - f * v[0, 1]), r * r - f * v[0, 0]]))
    return dict(rewards=success.tolist(), times=time.tolist(), rate=r / t, low=low, high=high)


def tolerance():
    found = []
    for n in (60, 93, 200, 1000):
        for content, confidence in ((.9, .95), (.95, .95), (.99, .9)):
            s = [k for k in range(1, n + 1) if stats.beta.cdf(content, k, n - k + 1) <= 1 - confidence]
            found.append(dict(n=n, content=content, confidence=confidence, limit=s[0] if s else None))
    return found


OUT.write_text(json.dumps(dict(curves=[curve(1, 60, 15.), curve(2, 200, 9.), curve(3, 40, 30.)], rates=[fieller(4, 30), fieller(5, 400)],
                               tolerance=tolerance())) + "\n")
