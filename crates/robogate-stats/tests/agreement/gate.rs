use crate::{close, count, float, floats, list, reference};
use robogate_stats::anytime::{Bounds, ln_evidence_above, ln_evidence_below};
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::compare::Pairs;
use robogate_stats::operating::{RateTest, Schedule, characteristic};
use robogate_stats::{Trials, non_inferiority};

#[test]
fn anytime_evidence_matches_integral() {
    for case in list(&reference()["anytime"]) {
        let (k, n, p0) = (count(&case["k"]), count(&case["n"]), float(&case["p0"]));
        let trials = Trials::new(k, n).unwrap();
        let ours = ln_evidence_above(trials, p0);
        assert!((ours - float(&case["above"])).abs() < 1e-8, "{case}: {ours}");
        let mirrored = ln_evidence_below(Trials::new(n - k, n).unwrap(), 1.0 - p0);
        assert!((mirrored - ours).abs() < 1e-9, "{case}: {mirrored}");
        if let Some(low) = case["low"].as_f64() {
            let mut bounds = Bounds::new(0.05);
            bounds.look(trials);
            assert!((bounds.interval().low - low).abs() < 1e-8, "{case}: {:?}", bounds.interval());
        }
    }
}

#[test]
fn bounded_mean_matches_reference() {
    let all = &reference()["bounded_mean"];
    let values = floats(&all["values"]);
    let looks: Vec<usize> = list(&all["looks"]).iter().map(|l| count(l) as usize).collect();
    let data = BoundedMean::new(&values, &looks, float(&all["ceiling"])).unwrap();
    for case in list(&all["cases"]) {
        let m = float(&case["m"]);
        assert!((data.ln_evidence_below(m) - float(&case["below"])).abs() < 1e-9, "{case}");
        assert!((data.ln_evidence_above(m) - float(&case["above"])).abs() < 1e-9, "{case}");
    }
}

#[test]
fn operating_characteristic_matches_reference() {
    for case in list(&reference()["operating"]) {
        let get = |key: &str| float(&case[key]);
        let test = RateTest { at_least: get("p0"), alpha: get("alpha"), beta: get("beta") };
        let schedule = Schedule::Rounds { per_round: count(&case["per_round"]), rounds: count(&case["rounds"]) };
        let ours = characteristic(test, schedule, get("p"));
        for (name, value) in [("met", ours.met), ("violated", ours.violated), ("open", ours.open)] {
            assert!((value - get(name)).abs() < 1e-9, "{case}: {name} {value}");
        }
        close(&format!("{case}"), ours.trials, get("trials"), 1e-9);
    }
}

#[test]
fn non_inferiority_matches_enumeration() {
    for case in list(&reference()["non_inferiority"]) {
        let pairs = Pairs {
            both: count(&case["both"]),
            first_only: count(&case["first_only"]),
            second_only: count(&case["second_only"]),
            neither: 0,
        };
        let margin = float(&case["margin"]);
        let name = format!("{case}");
        close(&name, non_inferiority::tango(pairs, margin).unwrap().exp(), float(&case["tango_p"]), 1e-6);
        if let Some(p) = case["exact_p"].as_f64() {
            close(&name, non_inferiority::exact(pairs, margin).unwrap().exp(), p, 1e-6);
        }
    }
}
