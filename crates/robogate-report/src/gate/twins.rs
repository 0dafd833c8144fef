//! The control arm of a gate as rows of a table.

use robogate_gate::TwinFamily;
use robogate_stats::format::{count, fixed};

/// One family of perturbations as a row of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TwinRow {
    /// The family.
    pub family: String,
    /// The number of pairs and of failures of each kind.
    pub pairs: String,
    /// The difference in percentage points, with its sign.
    pub difference: String,
    /// Its interval in percentage points.
    pub interval: String,
    /// The effect in words.
    pub effect: String,
}

impl TwinRow {
    /// The heads of the columns, in the order of the fields.
    pub const HEADS: [&'static str; 5] =
        ["perturbation", "pairs", "difference", "95 % interval, all together", "effect"];

    /// The row of a family.
    pub fn of(family: &TwinFamily) -> Self {
        let points = |x: f64| format!("{}{}", if x > 0.0 { "+" } else { "" }, fixed(100.0 * x, 1));
        let invalid = match family.invalid {
            0 => String::new(),
            n => format!(", {} with an invalid episode", count(n)),
        };
        let twins = match family.shared_twins {
            0 => String::new(),
            n => format!(" of {} twins", count(n)),
        };
        Self {
            family: family.family.clone(),
            pairs: format!(
                "{} pairs{twins}: {} fail with it only, {} in both, {} without it only{invalid}",
                count(family.pairs),
                count(family.new_failures),
                count(family.already_failing),
                count(family.recovered)
            ),
            difference: family.difference.map_or_else(|| "-".to_owned(), points),
            interval: format!("{} to {}", points(family.interval_95[0]), points(family.interval_95[1])),
            effect: family.effect.as_str().to_owned(),
        }
    }

    /// The cells in the order of the columns.
    pub fn cells(self) -> [String; 5] {
        [self.family, self.pairs, self.difference, self.interval, self.effect]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robogate_gate::Effect;

    #[test]
    fn shared_twins_are_named() {
        let mut family = TwinFamily {
            family: "camera".to_owned(),
            pairs: 200,
            shared_twins: 40,
            invalid: 0,
            both: 100,
            new_failures: 50,
            recovered: 0,
            already_failing: 50,
            difference: Some(-0.25),
            interval_95: [-0.39, -0.11],
            adjusted_p: 0.001,
            effect: Effect::Harmful,
        };
        assert!(TwinRow::of(&family).pairs.starts_with("200 pairs of 40 twins: 50 fail with it only"));
        family.shared_twins = 0;
        assert!(TwinRow::of(&family).pairs.starts_with("200 pairs: 50 fail with it only"));
    }
}
