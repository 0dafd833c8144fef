use robogate_core::FailureMode;
use robogate_gate::{Ending, Evaluation, Requirements, Sampling};
use serde_json::Value;

use crate::common::{failed, invalid, judge, requirements, sampled, times};

struct Row {
    good: usize,
    bad: usize,
    invalid: usize,
    demand: String,
    confidence: String,
    verdict: String,
}

fn rows() -> Vec<Row> {
    let rows: Vec<Row> = include_str!("../verdicts.md")
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
            let [good, bad, invalid, demand, confidence, verdict] = cells[..] else { return None };
            Some(Row {
                good: good.parse().ok()?,
                bad: bad.parse().ok()?,
                invalid: invalid.parse().ok()?,
                demand: demand.to_owned(),
                confidence: confidence.to_owned(),
                verdict: verdict.to_owned(),
            })
        })
        .collect();
    assert!(rows.len() > 40, "the table was not read: {} rows", rows.len());
    rows
}

fn gate(demand: &str, confidence: &str) -> Requirements {
    let [metric, sense, limit] = demand.split(' ').collect::<Vec<_>>()[..] else { panic!("{demand}") };
    let key = if sense == ">=" { "at_least" } else { "at_most" };
    let mode = if confidence == "point" {
        "mode = \"point\"".to_owned()
    } else {
        format!("mode = \"confidence\"\nconfidence = {confidence}")
    };
    requirements(&format!("name = \"row\"\n{mode}\n[[requirement]]\nmetric = \"{metric}\"\n{key} = {limit}\n"))
}

fn judged(demand: &str, confidence: &str, [good, bad, unknown]: [usize; 3]) -> Evaluation {
    let mode = if demand.contains(":collision ") {
        FailureMode::constant("collision")
    } else {
        FailureMode::constant("grasp_miss")
    };
    let endings = times(good, &Ending::Success).chain(times(bad, &failed(mode))).chain(times(unknown, &invalid()));
    judge(&gate(demand, confidence), &sampled(endings), Sampling::Fixed)
}

#[test]
fn verdict_table_matches() {
    for row in rows() {
        let found = judged(&row.demand, &row.confidence, [row.good, row.bad, row.invalid]);
        let Row { good, bad, invalid, demand, confidence, verdict } = &row;
        assert_eq!(
            found.verdict.as_str(),
            verdict,
            "{good} good, {bad} bad, {invalid} invalid, {demand} at {confidence}: {:?} {:?}",
            found.because,
            found.results
        );
    }
}

#[test]
fn statistics_match_scipy() {
    let reference: Value = serde_json::from_str(include_str!("../reference/reference.json")).unwrap();
    let cases = reference["counts"].as_array().unwrap();
    assert!(cases.len() > 20);
    for case in cases {
        let count = |key: &str| case[key].as_u64().unwrap() as usize;
        let demand = case["demand"].as_str().unwrap();
        let found = judged(demand, "0.95", [count("good"), count("bad"), count("invalid")]);
        let result = &found.results[0];
        let close = |name: &str, ours: f64, theirs: f64| {
            assert!((ours - theirs).abs() <= 1e-10 * theirs.abs().max(1e-3), "{case} {name}: {ours} against {theirs}");
        };
        close("p_met", result.p_met.unwrap(), case["p_met"].as_f64().unwrap());
        close("p_violated", result.p_violated.unwrap(), case["p_violated"].as_f64().unwrap());
        let [low, high] = [0, 1].map(|i| case["interval"][i].as_f64().unwrap());
        let [low, high] = if demand.contains("<=") { [1.0 - high, 1.0 - low] } else { [low, high] };
        let ours = result.interval.unwrap();
        close("low", ours[0], low);
        close("high", ours[1], high);
    }
}
