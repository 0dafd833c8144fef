use crate::{all_close, count, float, floats, reference};
use robogate_stats::{Confidence, Trials, clopper_pearson, wilson};

#[test]
fn intervals_match_statsmodels() {
    for case in reference()["interval"].as_array().unwrap() {
        let trials = Trials::new(count(&case["k"]), count(&case["n"])).unwrap();
        let level = Confidence::new(float(&case["level"])).unwrap();
        let name = format!("{case}");
        let a = wilson(trials, level);
        let b = clopper_pearson(trials, level);
        // statsmodels subtracts near zero, so its Wilson ends have an absolute error there.
        for (ours, theirs) in [a.low, a.high].iter().zip(floats(&case["wilson"])) {
            assert!((ours - theirs).abs() < 1e-15 + 1e-11 * theirs, "{name}: {ours} {theirs}");
        }
        all_close(&name, &[b.low, b.high], &floats(&case["clopper_pearson"]), 1e-11);
    }
}
