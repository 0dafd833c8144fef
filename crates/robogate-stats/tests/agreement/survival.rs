//! Compares survival curves, quantiles, tolerance limits and rewards per time with lifelines, statsmodels and SciPy
//! (`tests/reference/survival.py`).

use robogate_stats::Confidence;
use robogate_stats::renewal::reward_rate;
use robogate_stats::survival::{kaplan_meier, quantile_time, tolerance_limit};
use serde_json::Value;

use super::{all_close, bools, close, count, float, floats, list};

fn reference() -> Value {
    serde_json::from_str(include_str!("../reference/survival.json")).unwrap()
}

#[test]
fn curves_match_lifelines() {
    for curve in list(&reference()["curves"]) {
        let steps = kaplan_meier(&floats(&curve["times"]), &bools(&curve["events"]), Confidence::P95);
        // A step without events has none here.
        let at: Vec<usize> = (0..list(&curve["at"]).len())
            .filter(|i| steps.iter().any(|step| step.time.to_bits() == float(&curve["at"][i]).to_bits()))
            .collect();
        assert_eq!(at.len(), steps.len());
        let of = |name: &str| at.iter().map(|i| float(&curve[name][i])).collect::<Vec<f64>>();
        let ours = |of: fn(&robogate_stats::survival::SurvivalStep) -> f64| steps.iter().map(of).collect::<Vec<f64>>();
        all_close("survival", &ours(|step| step.survival), &of("survival"), 1e-12);
        all_close("at risk", &ours(|step| step.at_risk as f64), &of("at_risk"), 1e-12);
        // lifelines gives 0 and 1 where the curve is 0.
        let open = steps.iter().take_while(|step| step.survival > 0.0).count();
        all_close("low", &ours(|step| step.interval.low)[..open], &of("low")[..open], 1e-9);
        all_close("high", &ours(|step| step.interval.high)[..open], &of("high")[..open], 1e-9);
        for (q, name) in [(0.5, "0.5"), (0.9, "0.9")] {
            let found = quantile_time(&steps, q);
            let expected: Vec<Option<f64>> = list(&curve["quantiles"][name]).iter().map(Value::as_f64).collect();
            let mut ends = [found.low, found.high];
            // An end beyond the last time is open.
            ends.sort_by(|a, b| a.unwrap_or(f64::INFINITY).total_cmp(&b.unwrap_or(f64::INFINITY)));
            // Where the curve is 0 it has no variance: lifelines ends the interval there, and it is open here.
            let zero = steps.last().filter(|step| step.survival <= 0.0).map(|step| step.time);
            let mut theirs = [expected[1], expected[2]].map(|end| end.filter(|_| end != zero));
            theirs.sort_by(|a, b| a.unwrap_or(f64::INFINITY).total_cmp(&b.unwrap_or(f64::INFINITY)));
            assert_eq!((found.at, ends), (expected[0], theirs), "{name}");
        }
    }
}

#[test]
fn tolerance_limits_match_scipy() {
    for case in list(&reference()["tolerance"]) {
        let found = tolerance_limit(count(&case["n"]), float(&case["content"]), float(&case["confidence"]));
        assert_eq!(found, case["limit"].as_u64(), "{case}");
    }
}

#[test]
fn reward_rates_match_fieller() {
    for case in list(&reference()["rates"]) {
        let rewards: Vec<f64> = bools(&case["rewards"]).into_iter().map(|y| f64::from(u8::from(y))).collect();
        let found = reward_rate(&rewards, &floats(&case["times"]), Confidence::P95).unwrap();
        close("rate", found.rate, float(&case["rate"]), 1e-12);
        close("low", found.interval.low, float(&case["low"]), 1e-9);
        close("high", found.interval.high, float(&case["high"]), 1e-9);
    }
}
