//! The rule of the paper (section 9.5): the success rate of the last 100 cycles of a recipe, with a WARNING at a
//! decline of 5 % and a CRITICAL at 10 %.
//!
//! The paper does not define whether the decline is absolute (0.95 to 0.90) or relative (0.95 to 0.9025), nor its
//! reference. Here the reference is the observed rate of the baseline, [`Decline`] selects absolute or relative, and a
//! decline of exactly the threshold counts. The thresholds are converted to integer numbers of failures once, so that
//! rounding has no effect.
//!
//! Limitation: at a true rate of 0.95, the absolute rule raises a warning about every 1,150 cycles. Its false-alarm
//! rate is not bounded, unlike that of the detectors. It raises no alarm before the window is full.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alarm::Level;

/// The kind of decline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Decline {
    /// In percentage points: 0.95 - 0.90 is a decline of 0.05.
    #[default]
    Absolute,
    /// Relative to the baseline: 1 - 0.9025 / 0.95 is a decline of 0.05.
    Relative,
}

/// The settings of the rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PaperRule {
    /// Cycles of the moving window.
    pub window: u32,
    /// Decline that raises a warning.
    pub warning: f64,
    /// Decline that raises a critical alarm.
    pub critical: f64,
    /// The kind of decline.
    pub decline: Decline,
}

impl Default for PaperRule {
    fn default() -> Self {
        Self { window: 100, warning: 0.05, critical: 0.10, decline: Decline::Absolute }
    }
}

impl PaperRule {
    /// The smallest number of failures in a full window that is a decline of `decline` from `baseline`. Greater than
    /// the window's length if there is none.
    pub fn failures_at(&self, baseline: f64, decline: f64) -> u32 {
        let lost = match self.decline {
            Decline::Absolute => decline,
            Decline::Relative => decline * baseline,
        };
        // failures / window ≥ 1 - baseline + lost. The slack is far below one failure and far above rounding errors.
        let failures = f64::from(self.window) * (1.0 - baseline + lost) - 1e-6;
        failures.ceil().clamp(0.0, f64::from(self.window) + 1.0) as u32
    }
}

/// The moving window of one recipe.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PaperWindow {
    failed: Vec<bool>,
    next: usize,
    full: bool,
    failures: u32,
    warning_at: u32,
    critical_at: u32,
}

impl PaperWindow {
    /// Creates an empty window. `baseline` is the success rate from which a decline is measured.
    pub fn new(rule: &PaperRule, baseline: f64) -> Self {
        Self {
            failed: vec![false; rule.window.max(1) as usize],
            next: 0,
            full: false,
            failures: 0,
            warning_at: rule.failures_at(baseline, rule.warning),
            critical_at: rule.failures_at(baseline, rule.critical),
        }
    }

    /// Adds one cycle and returns the level of the rule.
    pub fn update(&mut self, success: bool) -> Option<Level> {
        if let Some(oldest) = self.failed.get_mut(self.next) {
            self.failures = self.failures.saturating_sub(u32::from(self.full && *oldest));
            *oldest = !success;
            self.failures += u32::from(!success);
        }
        self.next += 1;
        if self.next == self.failed.len() {
            self.next = 0;
            self.full = true;
        }
        self.level()
    }

    /// The level of the rule. `None` below a warning, and until the window is full.
    pub fn level(&self) -> Option<Level> {
        match self.failures {
            _ if !self.full => None,
            f if f >= self.critical_at => Some(Level::Critical),
            f if f >= self.warning_at => Some(Level::Warning),
            _ => None,
        }
    }

    /// Successes and cycles in the window.
    pub fn counts(&self) -> (u64, u64) {
        let n = if self.full { self.failed.len() } else { self.next } as u64;
        (n - u64::from(self.failures), n)
    }

    /// The numbers of failures in a full window that raise a warning and a critical alarm.
    pub fn limits(&self) -> (u32, u32) {
        (self.warning_at, self.critical_at)
    }
}
