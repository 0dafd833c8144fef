//! Simulates false-alarm rates and detection delays of the monitor for given success rates.
//!
//! Streams of independent cycles are sampled from a seed, so the same question gives the same figures. False alarms are
//! counted over one long stream without a change. The delay is the time to the first alarm in a stream whose rate drops
//! after a period without a change. Each mean has its standard error.

use robogate_core::Seed;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alarm::Level;
use crate::baseline::Baseline;
use crate::detector::{Evidence, Factors};
use crate::metric::Metric;
use crate::paper::PaperWindow;
use crate::settings::Settings;

/// The settings of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// The true success rate before a change.
    pub rate: f64,
    /// True success rates after the change.
    pub drops: Vec<f64>,
    /// Cycles per day.
    pub cycles_per_day: f64,
    /// Number of streams for each delay, and of cycles without a change in units of 1,000.
    pub streams: u32,
    /// The seed.
    pub seed: u64,
}

/// The figures of one rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figures {
    /// `paper` or `detector`.
    pub rule: String,
    /// The level.
    pub level: Level,
    /// Lower bound of the mean number of cycles to a false alarm. `None` for a rule without a bound.
    pub promised_cycles: Option<f64>,
    /// Mean number of cycles from the start to the first false alarm.
    pub cycles_to_false_alarm: Mean,
    /// False alarms per day without a change, if each alarm is cleared and can be raised again.
    pub false_alarms_per_day: f64,
    /// The delay of each drop.
    pub delays: Vec<Delay>,
}

/// The detection delay of a drop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Delay {
    /// Success rate after the drop.
    pub to: f64,
    /// Cycles from the drop to the first alarm after it.
    pub cycles: Mean,
}

/// A mean over simulated streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Mean {
    /// The mean. It is a lower bound if some streams were cut.
    pub mean: f64,
    /// Its standard error.
    pub se: f64,
    /// Streams that ended before an alarm. They count with their length.
    pub cut: u32,
}

impl Mean {
    /// Computes the mean of run lengths.
    pub fn of(lengths: &[f64], cut: u32) -> Self {
        let n = lengths.len().max(1) as f64;
        let mean = lengths.iter().sum::<f64>() / n;
        let variance = lengths.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        Self { mean, se: (variance / n).sqrt(), cut }
    }
}

/// Cycles without a change before each drop.
const BEFORE: u32 = 1_000;
/// Maximum number of cycles of a stream.
const LONGEST: u32 = 2_000_000;

/// A rule on one stream of successes.
trait Runner {
    /// Resets the rule.
    fn fresh(&mut self);
    /// Adds one cycle.
    fn update(&mut self, success: bool) -> Now;
}

/// The result of a rule for a cycle.
#[derive(Clone, Copy)]
struct Now {
    /// The alarm condition is met at this cycle, whether or not an alarm is active.
    calls: bool,
    /// A new alarm is raised.
    raised: bool,
}

struct Detector<'a> {
    factors: &'a Factors,
    evidence: Evidence,
    limit: f64,
    clear_after: u64,
    /// Cycles since the alarm condition was last met, while the alarm is active.
    standing: Option<u64>,
}

impl Runner for Detector<'_> {
    fn fresh(&mut self) {
        self.evidence.restart();
        self.standing = None;
    }

    fn update(&mut self, success: bool) -> Now {
        let calls = self.evidence.update(self.factors, u8::from(!success)) >= self.limit;
        let raised = calls && self.standing.is_none();
        self.standing = match self.standing {
            _ if calls => Some(0),
            Some(quiet) if quiet + 1 < self.clear_after => Some(quiet + 1),
            _ => None,
        };
        if calls {
            self.evidence.restart();
        }
        Now { calls, raised }
    }
}

struct Paper {
    empty: PaperWindow,
    window: PaperWindow,
    level: Level,
    above: bool,
}

impl Runner for Paper {
    fn fresh(&mut self) {
        self.window.clone_from(&self.empty);
        self.above = false;
    }

    fn update(&mut self, success: bool) -> Now {
        let calls = self.window.update(success) >= Some(self.level);
        let before = std::mem::replace(&mut self.above, calls);
        Now { calls, raised: calls && !before }
    }
}

/// Simulates the paper's rule and the detector of the failure rate, at both levels.
///
/// The detector has the same limit as among all metrics. `None` if the baseline allows no detector.
pub fn simulate(question: &Question, settings: &Settings, baseline: &Baseline) -> Option<Vec<Figures>> {
    let factors = baseline.factors(Metric::Success, settings).ok()?;
    let rate = baseline.success_rate()?;
    let mut all = Vec::new();
    for level in Level::ALL {
        let window = PaperWindow::new(&settings.paper, rate);
        let mut paper = Paper { empty: window.clone(), window, level, above: false };
        all.push(figures(question, &mut paper, "paper", level, None));
        let limit = settings.limit(Metric::Success, level);
        let evidence = Evidence::none(&factors);
        let clear_after = settings.clear_after_cycles;
        let mut detector = Detector { factors: &factors, evidence, limit, clear_after, standing: None };
        all.push(figures(question, &mut detector, "detector", level, Some(settings.promise(level))));
    }
    Some(all)
}

fn figures(question: &Question, runner: &mut dyn Runner, rule: &str, level: Level, promised: Option<f64>) -> Figures {
    let long = u64::from(question.streams) * 1_000;
    let mut stream = Seed::campaign(question.seed).stream("no change");
    runner.fresh();
    let raised = (0..long).filter(|_| runner.update(stream.uniform() < question.rate).raised).count();
    let delays = question.drops.iter().map(|to| Delay { to: *to, cycles: delay(question, runner, *to) }).collect();
    Figures {
        rule: rule.to_owned(),
        level,
        promised_cycles: promised,
        cycles_to_false_alarm: first_alarms(question, runner),
        false_alarms_per_day: raised as f64 / long as f64 * question.cycles_per_day,
        delays,
    }
}

/// Run lengths from the start to the first false alarm.
fn first_alarms(question: &Question, runner: &mut dyn Runner) -> Mean {
    let mut cut = 0;
    let lengths: Vec<f64> = (0..question.streams.div_ceil(10))
        .map(|i| {
            let mut stream = Seed::campaign(question.seed).episode(u64::from(i)).stream("run length");
            runner.fresh();
            let length = (1..=LONGEST).find(|_| runner.update(stream.uniform() < question.rate).calls);
            cut += u32::from(length.is_none());
            f64::from(length.unwrap_or(LONGEST))
        })
        .collect();
    Mean::of(&lengths, cut)
}

fn delay(question: &Question, runner: &mut dyn Runner, to: f64) -> Mean {
    let mut cut = 0;
    let lengths: Vec<f64> = (0..question.streams)
        .map(|i| {
            let mut stream = Seed::campaign(question.seed).episode(u64::from(i)).stream("delay");
            runner.fresh();
            for _ in 0..BEFORE {
                runner.update(stream.uniform() < question.rate);
            }
            let length = (1..=LONGEST).find(|_| runner.update(stream.uniform() < to).calls);
            cut += u32::from(length.is_none());
            f64::from(length.unwrap_or(LONGEST))
        })
        .collect();
    Mean::of(&lengths, cut)
}
