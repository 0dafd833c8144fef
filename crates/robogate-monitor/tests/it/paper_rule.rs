//! Compares the paper's rule with exact rational arithmetic (`tests/reference/paper_rule.py`).

use robogate_monitor::Level;
use robogate_monitor::paper::{Decline, PaperRule, PaperWindow};

#[derive(serde::Deserialize)]
struct Recorded {
    successes: String,
    cases: Vec<Case>,
}

#[derive(serde::Deserialize)]
struct Case {
    window: u32,
    baseline: f64,
    warning: f64,
    critical: f64,
    decline: Decline,
    levels: String,
}

#[test]
fn recorded_stream_matches() {
    let recorded: Recorded = serde_json::from_str(include_str!("../reference/paper_rule.json")).unwrap();
    assert_eq!(recorded.cases.len(), 5);
    for case in recorded.cases {
        let Case { window, baseline, warning, critical, decline, levels } = case;
        let mut rule = PaperWindow::new(&PaperRule { window, warning, critical, decline }, baseline);
        let found: String = recorded
            .successes
            .chars()
            .map(|c| match rule.update(c == '1') {
                None => '-',
                Some(Level::Warning) => 'W',
                Some(Level::Critical) => 'C',
            })
            .collect();
        assert!(levels.contains('W') && levels.contains('C'));
        assert_eq!(found, levels, "{decline:?} from {baseline} over {window}");
    }
}

#[test]
fn limits_are_integer_failure_counts() {
    // 0.95 - 0.90 is less than 0.05 in floating point, so the rule counts failures instead.
    let rule = PaperRule::default();
    assert_eq!((rule.failures_at(0.95, 0.05), rule.failures_at(0.95, 0.10)), (10, 15));
}
