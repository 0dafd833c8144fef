//! Synthetic cycles and baselines.

use std::sync::Arc;

use robogate_core::Stream;
use robogate_monitor::domain::Domain;
use robogate_monitor::{Baseline, Count, Cycle};

/// The failure modes of the cell.
const MODES: [&str; 5] = ["jammed", "dropped", "collision", "timeout", "other"];

/// The true rates of a cell.
#[derive(Clone, Copy)]
pub(crate) struct Cell {
    pub(crate) success: f64,
    pub(crate) drop: f64,
    pub(crate) collision: f64,
    /// Shares of the failure modes.
    pub(crate) modes: [f64; 5],
    /// Middle and half-width of the cycle time, in seconds.
    pub(crate) cycle_time: (f64, f64),
}

impl Cell {
    pub(crate) const NORMAL: Self = Self {
        success: 0.95,
        drop: 0.01,
        collision: 0.005,
        modes: [0.4, 0.3, 0.15, 0.1, 0.05],
        cycle_time: (4.0, 0.4),
    };

    /// Samples a cycle into `cycle`, whose names are kept.
    pub(crate) fn draw(&self, stream: &mut Stream, cycle: &mut Cycle) {
        cycle.time_s += self.cycle_time.0;
        cycle.success = stream.uniform() < self.success;
        for (event, rate) in [("drop", self.drop), ("collision", self.collision)] {
            let happened = stream.uniform() < rate;
            match cycle.events.get_mut(event) {
                Some(value) => *value = happened,
                None => drop(cycle.events.insert(event.to_owned(), happened)),
            }
        }
        let (middle, half) = self.cycle_time;
        cycle.cycle_time_s = Some(stream.between(middle - half, middle + half));
        let mut u = stream.uniform();
        let mode = self.modes.iter().position(|share| {
            u -= share;
            u < 0.0
        });
        cycle.failure_mode = (!cycle.success).then(|| MODES[mode.unwrap_or(4)].to_owned());
    }

    /// The baseline from `n` cycles with exactly these rates.
    pub(crate) fn baseline(&self, n: u64) -> Baseline {
        let count = |rate: f64| Some(Count { count: (rate * n as f64).round() as u64, of: n });
        let (middle, half) = self.cycle_time;
        let failures = |share: f64| (share * (1.0 - self.success) * n as f64).round() as u64;
        let time = |i: u64| middle - half + 2.0 * half * (i as f64 + 0.5) / n as f64;
        Baseline {
            success: count(self.success),
            events: [("drop", self.drop), ("collision", self.collision)]
                .into_iter()
                .filter_map(|(event, rate)| Some((event.to_owned(), count(rate)?)))
                .collect(),
            failure_modes: Some(MODES.into_iter().zip(self.modes.map(failures)).collect()),
            cycle_times_s: Some((0..n).map(time).collect()),
        }
    }
}

/// The validated region of a campaign over mass and shape, in which failures increase with the mass.
pub(crate) fn domain() -> Arc<Domain> {
    let json = r#"{
        "envelope": {"mass_kg": {"range": [0.1, 0.8]}, "shape": {"words": ["box", "can"]}},
        "risk": {"intercept": -6, "terms": [
            {"parameter": "mass_kg", "coefficient": 6},
            {"parameter": "shape", "coefficient": 2, "penalties": {"box": 0.04, "can": 0.08}}],
            "covariance": [0.1,0,0, 0,0.1,0, 0,0,0.1], "most_variance": 0.2}}"#;
    Arc::new(serde_json::from_str(json).unwrap())
}

pub(crate) fn cycle() -> Cycle {
    Cycle {
        id: "c".to_owned(),
        robot: "cell-1".to_owned(),
        recipe: "bracket".to_owned(),
        time_s: 1_760_000_000.0,
        success: true,
        failure_mode: None,
        events: Default::default(),
        cycle_time_s: None,
        parameters: Default::default(),
    }
}
