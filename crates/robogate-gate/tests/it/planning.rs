use robogate_gate::{GateError, GatePlan, Requirements, Sampling};
use serde_json::Value;

use crate::common::{baseline, label, requirements, suite, task};

fn plan(requirements: &Requirements, sampling: Sampling, rounds: u64) -> Result<GatePlan, GateError> {
    let labels: Vec<_> = (0..68).map(label).collect();
    let baseline = baseline(&suite(68, []), 1.0, 4.1, 0.0);
    GatePlan::of(requirements, Some(&baseline), &labels, sampling, rounds)
}

#[test]
fn point_gate_follows_binomial_distribution() {
    // Reference values of SciPy: a pass in 31 % at a true rate of 0.90, and a fail in 12 % at 0.95.
    let reference: Value = serde_json::from_str(include_str!("../reference/reference.json")).unwrap();
    let plan = plan(&Requirements::open("paper", &task()).unwrap(), Sampling::Fixed, 1).unwrap();
    let success = &plan.demands[0];
    for case in reference["paper"].as_array().unwrap() {
        let rate = case["rate"].as_f64().unwrap();
        if let Some(at) = success.at.iter().find(|at| (at.rate - rate).abs() < 1e-9) {
            assert!((at.met - case["passes"].as_f64().unwrap()).abs() < 1e-10, "{at:?}");
        }
    }
    let near = |rate: f64| success.at.iter().find(|at| (at.rate - rate).abs() < 1e-9).unwrap();
    assert!((near(0.90).met - 0.31).abs() < 0.005);
}

#[test]
fn error_rates_hold_at_limit() {
    let plan = plan(&Requirements::open("default", &task()).unwrap(), Sampling::Sequential, 20).unwrap();
    for demand in plan.demands.iter().filter(|d| !d.at.is_empty()) {
        let at = demand.at.iter().find(|at| (at.rate - demand.bound.limit).abs() < 1e-9).unwrap();
        assert!(at.met <= 0.05 && at.violated <= 0.01, "{} {at:?}", demand.id);
        assert!((at.met + at.violated + at.open - 1.0).abs() < 1e-9);
    }
    let fewest: Vec<Option<u64>> = plan.demands.iter().map(|d| d.fewest_rounds).collect();
    assert_eq!(fewest, [Some(1), Some(3), Some(7), Some(3), Some(3)]);
}

#[test]
fn insufficient_budgets_are_rejected() {
    let error = plan(&Requirements::open("default", &task()).unwrap(), Sampling::Sequential, 2).unwrap_err();
    assert!(matches!(error, GateError::BudgetTooSmall { budget: 136, .. }), "{error}");
    assert!(error.to_string().contains("--rounds"), "{error}");
}

#[test]
fn group_requirements_count_group_episodes() {
    let gate = requirements(
        "name = \"g\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.8\ngroup = \"group-0\"\n",
    );
    let plan = plan(&gate, Sampling::Fixed, 1).unwrap();
    assert_eq!((plan.demands[0].per_round, plan.demands[0].fewest_rounds), (17, Some(1)));
}

#[test]
fn joint_plan_is_below_single_requirements() {
    let plan = plan(&Requirements::open("default", &task()).unwrap(), Sampling::Sequential, 20).unwrap();
    let at = |success: f64| plan.joint.iter().find(|row| (row.success - success).abs() < 1e-9).unwrap();
    // "At most 1 %" of collisions takes seven rounds without any.
    assert!((at(1.0).pass, at(1.0).episodes) == (1.0, 476.0), "{:?}", at(1.0));
    assert!(at(0.92).pass <= 0.05 && at(0.85).fail > 0.9, "{:?}", plan.joint);
    for pair in plan.joint.windows(2) {
        assert!(pair[0].pass + 0.05 >= pair[1].pass, "{pair:?}");
    }
    // The requirement on the cycle time is not simulated.
    assert_eq!(plan.joint_without, ["cycle_time_s"]);
}
