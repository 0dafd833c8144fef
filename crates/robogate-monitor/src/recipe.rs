//! One recipe: the paper's window, a detector for each metric, and their alarms.

mod unreported;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::sync::Arc;

use robogate_stats::Trials;
use serde::{Deserialize, Serialize};

use crate::alarm::{Alarm, Happening, Level};
use crate::baseline::Baseline;
use crate::block_sums::{BlockSums, Inflation};
use crate::cycle::{Cycle, ParameterValue};
use crate::detector::{Evidence, Factors};
use crate::domain::{Domain, Judged, Validated};
use crate::explanation;
use crate::factors::{Binned, risk_of};
use crate::history::{History, Symbols};
use crate::learning::{Learning, Tally};
use crate::metric::Metric;
use crate::modes::ModeList;
use crate::paper::PaperWindow;
use crate::series::{Observed, Series, SeriesPoint};
use crate::settings::Settings;

/// One recipe with its detectors.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// By the index of the metric.
    pub(crate) factors: Vec<Option<Factors>>,
    pub(crate) binned: Option<Binned>,
    domain: Option<Arc<Domain>>,
    /// Whether the settings leave the mix of failure modes to be learnt.
    learns_modes: bool,
    pub(crate) state: RecipeState,
}

/// The state of a recipe. Equal states and cycles give identical alarms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecipeState {
    /// A hash of baseline and validated region in the settings.
    pub(crate) given: u64,
    /// The monitored events, in the order of their indices. A store of an earlier version has none.
    #[serde(default)]
    events: Vec<String>,
    pub(crate) baseline: Baseline,
    pub(crate) learning: Learning,
    #[serde(default = "ModeList::unnamed")]
    pub(crate) modes: ModeList,
    /// By the index of the metric.
    pub(crate) evidence: Vec<Option<[Evidence; 2]>>,
    /// The sums of blocks of cycles, by the index of the metric. A store of an earlier version has none.
    #[serde(default)]
    sums: Vec<BlockSums>,
    /// How the cycles depend on each other, by the index of the metric.
    #[serde(default)]
    pub(crate) inflation: Vec<Option<Inflation>>,
    /// The cycle after which each detector started.
    pub(crate) began: Vec<u64>,
    pub(crate) standing: Vec<[Option<Standing>; 2]>,
    pub(crate) paper: Option<PaperWindow>,
    #[serde(rename = "paper_said")]
    pub(crate) paper_level: Option<Level>,
    pub(crate) cycles: u64,
    pub(crate) successes: u64,
    pub(crate) raised: u64,
    pub(crate) history: History,
    /// One tally for each parameter of the envelope, in its order, and one for combinations.
    pub(crate) outside: Vec<OutsideTally>,
    /// A parameter that cycles report and the envelope does not have.
    #[serde(default)]
    foreign: Option<String>,
    /// The events that cycles report.
    #[serde(default)]
    reported_events: BTreeSet<String>,
    pub(crate) robots: BTreeMap<String, RobotState>,
    /// The course of the success rate and of the evidence.
    #[serde(default)]
    pub(crate) series: Series,
}

/// An active alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standing {
    /// The recipe's cycle at which it was raised.
    pub raised: u64,
    /// The last cycle at which the evidence reached its limit.
    pub last: u64,
    /// How often the evidence reached its limit.
    pub times: u64,
}

/// Cycles in which one parameter lay outside the validated region.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct OutsideTally {
    /// Number of such cycles since the detectors started.
    pub cycles: u64,
    /// The last such cycle, numbered within the recipe.
    pub last: u64,
    /// The lowest and highest value.
    pub numbers: Option<[f64; 2]>,
    /// The first category.
    pub word: Option<String>,
    /// Whether any cycle reported the parameter. A store of an earlier version says no.
    #[serde(default)]
    pub reported: bool,
}

impl OutsideTally {
    fn add(&mut self, cycle: u64, value: Option<&ParameterValue>) {
        self.cycles += 1;
        self.last = cycle;
        match value {
            Some(ParameterValue::Number(x)) => {
                let [low, high] = self.numbers.unwrap_or([*x, *x]);
                self.numbers = Some([low.min(*x), high.max(*x)]);
            }
            Some(ParameterValue::Word(word)) if self.word.is_none() => self.word = Some(word.clone()),
            _ => {}
        }
    }
}

impl RecipeState {
    fn forget(&mut self) {
        self.evidence.fill(None);
        self.standing.fill([None; 2]);
    }
}

impl RobotState {
    fn forget(&mut self) {
        self.evidence = None;
        self.standing = [None; 2];
    }
}

/// Cycles of one robot in one recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RobotTally {
    /// Number of successful cycles.
    pub successes: u64,
    /// Number of all cycles.
    pub cycles: u64,
}

/// The state of one detector.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectorView {
    /// The metric.
    pub metric: Metric,
    /// Its name in data.
    pub name: Cow<'static, str>,
    /// Its label.
    pub label: Cow<'static, str>,
    /// Evidence and limit for a warning and a critical alarm, or the reason why the detector does not run.
    pub levels: Result<[(f64, f64); 2], &'static str>,
    /// The active alarm of each level.
    pub standing: [Option<Standing>; 2],
}

impl DetectorView {
    fn of(
        metric: Metric,
        settings: &Settings,
        levels: Result<[(f64, f64); 2], &'static str>,
        standing: [Option<Standing>; 2],
    ) -> Self {
        Self { metric, name: metric.name(settings), label: metric.label(settings), levels, standing }
    }
}

/// The state of one robot in one recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RobotState {
    pub(crate) tally: RobotTally,
    /// Its index in the order of the robots' first cycles.
    pub(crate) place: u16,
    pub(crate) evidence: Option<[Evidence; 2]>,
    pub(crate) standing: [Option<Standing>; 2],
}

/// A learnt rate is not tightened while the evidence for a change exceeds this share of the limit of a warning.
const QUIET: f64 = 0.1;

/// The index of robots beyond the limit.
const NO_PLACE: u16 = u16::MAX;

/// A change of a detector's alarm.
enum Transition {
    Raised,
    Cleared(Standing),
}

/// Updates a detector with a symbol, for one level.
fn update(
    (factors, evidence): (&Factors, &mut Evidence),
    code: u8,
    limit: f64,
    standing: &mut Option<Standing>,
    now: u64,
    clear_after: u64,
) -> Option<Transition> {
    if evidence.update(factors, code) >= limit {
        evidence.restart();
        if let Some(standing) = standing {
            standing.last = now;
            standing.times += 1;
            return None;
        }
        *standing = Some(Standing { raised: now, last: now, times: 1 });
        return Some(Transition::Raised);
    }
    let stood = standing.filter(|stood| now.saturating_sub(stood.last) >= clear_after)?;
    *standing = None;
    Some(Transition::Cleared(stood))
}

impl Recipe {
    /// Creates a recipe without cycles.
    pub fn new(name: &str, settings: &Settings) -> Self {
        let mut state = RecipeState {
            given: given(name, settings),
            baseline: settings.baseline_of(name).clone(),
            learning: Learning::default(),
            events: Vec::new(),
            modes: ModeList::default(),
            evidence: Vec::new(),
            sums: Vec::new(),
            inflation: Vec::new(),
            began: Vec::new(),
            standing: Vec::new(),
            paper: None,
            paper_level: None,
            cycles: 0,
            successes: 0,
            raised: 0,
            history: History::new(settings.history_cycles as usize),
            outside: Vec::new(),
            foreign: None,
            reported_events: BTreeSet::new(),
            robots: BTreeMap::new(),
            series: Series::default(),
        };
        state.modes.include(state.baseline.failure_modes.as_ref());
        Self::restore(name, state, settings)
    }

    /// Restores a recipe from its state.
    ///
    /// If the settings define another baseline or validated region than before, learning and all evidence start again
    /// from zero. The same happens to evidence that does not match the settings, and to all evidence if the events are
    /// others. Counts are kept.
    pub fn restore(name: &str, mut state: RecipeState, settings: &Settings) -> Self {
        let given = given(name, settings);
        if state.given != given {
            state.given = given;
            state.baseline = settings.baseline_of(name).clone();
            state.learning = Learning::default();
            state.modes.include(state.baseline.failure_modes.as_ref());
            state.forget();
            (state.paper, state.paper_level) = (None, None);
            state.robots.values_mut().for_each(RobotState::forget);
        }
        let detectors = Metric::FIXED.len() + settings.events.len();
        let lengths = [state.evidence.len(), state.began.len(), state.standing.len()];
        if !state.events.iter().eq(settings.events.keys()) || lengths != [detectors; 3] {
            state.events = settings.events.keys().cloned().collect();
            state.learning.events = vec![Tally::default(); settings.events.len()];
            // The codes of events in the history are indices too.
            state.history = History::new(settings.history_cycles as usize);
            (state.evidence, state.standing) = (vec![None; detectors], vec![[None; 2]; detectors]);
            state.began = vec![state.cycles; detectors];
        }
        if [state.sums.len(), state.inflation.len()] != [detectors; 2] {
            (state.sums, state.inflation) = (vec![BlockSums::default(); detectors], vec![None; detectors]);
        }
        if !state.history.fits(settings.history_cycles as usize) {
            state.history = History::new(settings.history_cycles as usize);
        }
        let domain = settings.domain_of(name).cloned();
        let parameters = domain.as_ref().map_or(0, |domain| domain.envelope.len() + 1);
        if state.outside.len() != parameters {
            state.outside = vec![OutsideTally::default(); parameters];
        }
        let learns_modes = settings.baseline_of(name).failure_modes.is_none();
        let mut recipe = Self { factors: vec![None; detectors], binned: None, domain, learns_modes, state };
        for metric in Metric::all(settings) {
            recipe.begin(metric, settings);
        }
        if recipe.state.paper.is_none() {
            recipe.state.paper =
                recipe.state.baseline.success_rate().map(|rate| PaperWindow::new(&settings.paper, rate));
        }
        recipe
    }

    /// The state, for [`Self::restore`].
    pub fn state(&self) -> &RecipeState {
        &self.state
    }

    /// Builds a metric's detector, if the baseline allows one.
    fn begin(&mut self, metric: Metric, settings: &Settings) {
        let i = metric.index();
        if metric == Metric::CycleTime {
            self.binned = self.state.baseline.binned();
        }
        let factors = self.new_factors(metric, settings).ok();
        let kept = self.state.evidence[i].take().zip(factors.as_ref());
        self.state.evidence[i] = match kept {
            Some((evidence, factors)) if evidence.iter().all(|e| e.fits(factors)) => Some(evidence),
            _ => factors.as_ref().map(|factors| {
                self.state.began[i] = self.state.cycles;
                [Evidence::none(factors), Evidence::none(factors)]
            }),
        };
        self.factors[i] = factors;
        if let (Metric::Robot, Some(factors)) = (metric, &self.factors[i]) {
            for robot in self.state.robots.values_mut() {
                robot.evidence = robot.evidence.take().filter(|both| both.iter().all(|e| e.fits(factors)));
            }
        }
    }

    fn new_factors(&self, metric: Metric, settings: &Settings) -> Result<Factors, &'static str> {
        match (metric, &self.domain) {
            (Metric::Outside | Metric::Risk, None) => Err("there is no reference with a validated region"),
            (Metric::Risk, Some(domain)) if domain.risk.is_none() => Err("the reference has no risk model"),
            (Metric::FailureModes, _) => {
                self.state.baseline.mode_factors(&self.state.modes, settings, self.learns_modes)
            }
            _ => {
                let share = self.state.learning.error_share(metric);
                let inflation = self.inflation(metric).map_or(1.0, |found| found.ratio);
                let factors = self.state.baseline.factors_at(metric, settings, share, inflation);
                let factors = factors.map_err(|why| match self.state.baseline.factors_at(metric, settings, share, 1.0) {
                    Ok(_) => "its cycles depend on each other so much that the baseline counts for too few to detect a change",
                    Err(_) => why,
                })?;
                Ok(if inflation > 1.0 { factors.tempered(inflation) } else { factors })
            }
        }
    }

    /// How the cycles depend on each other in a metric. `None` if they may be independent.
    pub fn inflation(&self, metric: Metric) -> Option<Inflation> {
        // The failures of a robot come in the same batches and shifts as those of its recipe.
        let of = if metric == Metric::Robot { Metric::Success } else { metric };
        self.state.inflation.get(of.index()).copied().flatten()
    }

    /// Adds the score of a cycle to the sums of blocks, and looks for dependence now and then.
    fn add_to_sums(&mut self, symbols: &Symbols, settings: &Settings) {
        let bins = self.binned.as_ref().map_or(1, |binned| binned.edges.len()).max(1);
        for metric in Metric::all(settings).filter(|metric| !matches!(metric, Metric::FailureModes | Metric::Robot)) {
            let Some(code) = symbols.code(metric) else { continue };
            let rank = f64::from(code) / bins as f64;
            let score = match metric {
                Metric::CycleTime => rank,
                Metric::CycleTimeSpread => (2.0 * rank - 1.0).abs(),
                Metric::Risk => risk_of(code),
                _ => f64::from(code),
            };
            let i = metric.index();
            self.state.sums[i].add(score);
            let (sums, known) = (&self.state.sums[i], self.state.inflation[i]);
            if !sums.is_due() {
                continue;
            }
            let stands = self.state.standing[i].iter().any(Option::is_some);
            let found = if stands { sums.inflation_in_alarm(known) } else { sums.inflation(known) };
            if found != known {
                self.state.inflation[i] = found;
                let ratio = |of: Option<Inflation>| of.map_or(1.0, |of| of.ratio);
                self.divide(metric, ratio(found) / ratio(known), settings);
            }
        }
    }

    /// Rebuilds a metric's detector for another inflation, and divides the evidence so far.
    fn divide(&mut self, metric: Metric, by: f64, settings: &Settings) {
        let i = metric.index();
        self.state.evidence[i].iter_mut().flatten().for_each(|evidence| evidence.divide(by));
        self.begin(metric, settings);
        if metric == Metric::Success {
            let robots = self.state.robots.values_mut().filter_map(|robot| robot.evidence.as_mut());
            robots.flatten().for_each(|evidence| evidence.divide(by));
            self.begin(Metric::Robot, settings);
        }
    }

    /// Processes one cycle. Passes raised and cleared alarms to `emit`. Returns how the parameters compare with the
    /// validated region.
    ///
    /// Memory is allocated only at an alarm, for a new robot, event or failure mode, and when learning ends.
    pub fn observe(&mut self, cycle: &Cycle, settings: &Settings, emit: &mut dyn FnMut(Alarm)) -> Judged {
        self.state.cycles += 1;
        self.note_events(cycle);
        let judged = self.judge(cycle);
        let robot = self.count_robot(cycle, settings);
        let binned = self.binned.as_ref();
        let mode = cycle.mode().map(|mode| {
            // While the mix is being learnt, every new mode gets its own code.
            if self.state.baseline.failure_modes.is_none() {
                self.state.modes.add(mode);
            }
            self.state.modes.code(mode)
        });
        let bin = |time| binned.map_or(crate::history::ABSENT, |binned| binned.bin(time));
        let symbols = Symbols::of(cycle, settings.events.keys(), robot, judged, mode, bin);
        self.state.successes += u64::from(cycle.success);
        self.state.history.push(symbols);
        if let Some(window) = &mut self.state.paper {
            self.state.paper_level = window.update(cycle.success);
        }
        for metric in Metric::all(settings) {
            match symbols.code(metric) {
                Some(code) if metric == Metric::Robot => self.update_robot(code, cycle, settings, emit),
                Some(code) => self.update_metric(metric, code, cycle, settings, emit),
                None => {}
            }
        }
        self.add_to_sums(&symbols, settings);
        self.learn(&symbols, settings);
        let observed =
            Observed { cycle: self.state.cycles, outside: judged.outside, by_detector: self.evidence_shares(settings) };
        self.state.series.push(cycle, settings.events.keys(), &observed);
        judged
    }

    /// The evidence of each detector for a warning as a share of its limit, by the index of the metric. 1 while an alarm is
    /// active.
    fn evidence_shares<const N: usize>(&self, settings: &Settings) -> [f32; N] {
        let mut shares = [0.0; N];
        for metric in Metric::all(settings) {
            let i = metric.index();
            let share = if self.state.standing[i].iter().any(Option::is_some) {
                1.0
            } else {
                match (&self.state.evidence[i], &self.factors[i]) {
                    (Some(evidence), Some(factors)) => {
                        evidence[Level::Warning as usize].value(factors) / settings.limit(metric, Level::Warning)
                    }
                    _ => 0.0,
                }
            };
            if let Some(place) = shares.get_mut(i) {
                *place = share as f32;
            }
        }
        shares
    }

    /// The course of all metrics and of the evidence, oldest first.
    pub fn series(&self) -> &[SeriesPoint] {
        self.state.series.points()
    }

    fn judge(&mut self, cycle: &Cycle) -> Judged {
        let Some(domain) = &self.domain else { return Judged::default() };
        let (tallies, now) = (&mut self.state.outside, self.state.cycles);
        let judged = domain.judge(cycle, |place, value, outside| {
            if let Some(tally) = tallies.get_mut(place) {
                tally.reported = true;
                if outside {
                    tally.add(now, Some(value));
                }
            }
        });
        let foreign = |name: &&String| !domain.envelope.contains_key(*name);
        if self.state.foreign.is_none() {
            self.state.foreign = cycle.parameters.keys().find(foreign).cloned();
        }
        if judged.by_combination
            && let Some(tally) = tallies.last_mut()
        {
            tally.add(now, None);
        }
        judged
    }

    /// Counts a cycle of the robot and returns its index.
    fn count_robot(&mut self, cycle: &Cycle, settings: &Settings) -> u16 {
        let robots = &mut self.state.robots;
        if !robots.contains_key(cycle.robot.as_str()) && robots.len() < settings.most_robots as usize {
            let place = u16::try_from(robots.len()).unwrap_or(NO_PLACE);
            let fresh = RobotState { tally: RobotTally::default(), place, evidence: None, standing: [None; 2] };
            robots.insert(cycle.robot.clone(), fresh);
        }
        let Some(robot) = robots.get_mut(cycle.robot.as_str()) else { return NO_PLACE };
        robot.tally.cycles += 1;
        robot.tally.successes += u64::from(cycle.success);
        robot.place
    }

    /// Updates the robot's detector, if the recipe has several robots.
    ///
    /// A robot's evidence grows only with its own cycles, so all robots of all recipes share one part of the false
    /// alarms.
    fn update_robot(&mut self, code: u8, cycle: &Cycle, settings: &Settings, emit: &mut dyn FnMut(Alarm)) {
        let metric = Metric::Robot;
        let (now, several) = (self.state.cycles, self.state.robots.len() > 1);
        for level in Level::ALL {
            let Some(factors) = &self.factors[metric.index()] else { return };
            let Some(robot) = self.state.robots.get_mut(cycle.robot.as_str()).filter(|_| several) else { return };
            let none = || [Evidence::none(factors), Evidence::none(factors)];
            let evidence = &mut robot.evidence.get_or_insert_with(none)[level as usize];
            let (standing, limit) = (&mut robot.standing[level as usize], settings.limit(metric, level));
            let transition = update((factors, evidence), code, limit, standing, now, settings.clear_after_cycles);
            self.emit_transition(transition, metric, level, cycle, settings, emit);
        }
    }

    fn emit_transition(
        &mut self,
        transition: Option<Transition>,
        metric: Metric,
        level: Level,
        cycle: &Cycle,
        settings: &Settings,
        emit: &mut dyn FnMut(Alarm),
    ) {
        match transition {
            Some(Transition::Raised) => {
                self.state.raised += 1;
                emit(explanation::raised(self, metric, level, cycle, settings));
            }
            Some(Transition::Cleared(stood)) => emit(explanation::cleared(self, metric, level, cycle, settings, stood)),
            None => {}
        }
    }

    fn update_metric(
        &mut self,
        metric: Metric,
        code: u8,
        cycle: &Cycle,
        settings: &Settings,
        emit: &mut dyn FnMut(Alarm),
    ) {
        let (i, now) = (metric.index(), self.state.cycles);
        for level in Level::ALL {
            let (Some(factors), Some(evidence)) = (&self.factors[i], &mut self.state.evidence[i]) else { return };
            let (standing, limit) = (&mut self.state.standing[i][level as usize], settings.limit(metric, level));
            let detector = (factors, &mut evidence[level as usize]);
            let transition = update(detector, code, limit, standing, now, settings.clear_after_cycles);
            self.emit_transition(transition, metric, level, cycle, settings, emit);
        }
    }

    fn learn(&mut self, symbols: &Symbols, settings: &Settings) {
        let mut learnt = 0_u32;
        let first = !self.state.learning.has_learnt_success();
        let (state, factors) = (&mut self.state, &self.factors);
        let quiet = |metric: Metric| {
            let i = metric.index();
            let both = state.evidence[i].as_ref().zip(factors[i].as_ref());
            let level = Level::Warning;
            let limit = QUIET * settings.limit(metric, level);
            let standing = state.standing[i].iter().any(Option::is_some);
            !standing && both.is_none_or(|(evidence, factors)| evidence[level as usize].value(factors) < limit)
        };
        state.learning.update(symbols, &mut state.baseline, &state.modes, settings, quiet, |metric| {
            learnt |= 1 << metric.index();
        });
        for metric in Metric::all(settings).filter(|metric| learnt & (1 << metric.index()) != 0) {
            self.begin(metric, settings);
            if metric == Metric::Success {
                if first {
                    let rate = self.state.baseline.success_rate();
                    self.state.paper = rate.map(|rate| PaperWindow::new(&settings.paper, rate));
                }
                self.begin(Metric::Risk, settings);
                self.begin(Metric::Robot, settings);
            }
        }
    }

    /// Discards the evidence and the active alarms, after the cause was repaired. The baseline is kept.
    pub fn restart(&mut self) {
        self.state.evidence.iter_mut().flatten().flatten().for_each(Evidence::restart);
        self.state.standing.fill([None; 2]);
        self.state.began.fill(self.state.cycles);
        // The sums contain the cycles of the cause.
        self.state.sums.fill(BlockSums::default());
        for tally in &mut self.state.outside {
            *tally = OutsideTally { reported: tally.reported, ..OutsideTally::default() };
        }
        self.state.robots.values_mut().for_each(RobotState::forget);
    }

    /// Each parameter of the envelope with its validated values and its cycles outside since the detectors started. The
    /// last item, without a name, counts combinations outside.
    pub fn outside(&self) -> impl Iterator<Item = (Option<(&str, &Validated)>, &OutsideTally)> {
        let named = self.domain.iter().flat_map(|domain| &domain.envelope);
        let named = named.map(|(name, validated)| Some((name.as_str(), validated)));
        named.chain(std::iter::once(None)).zip(&self.state.outside)
    }

    /// The baseline, including the learnt parts.
    pub fn baseline(&self) -> &Baseline {
        &self.state.baseline
    }

    /// Successes and number of all cycles.
    pub fn trials(&self) -> Trials {
        Trials::new(self.state.successes, self.state.cycles).unwrap_or(Trials::NONE)
    }

    /// Successes and number of cycles in the paper's window. `None` while the baseline is being learnt.
    pub fn window(&self) -> Trials {
        let (successes, n) = self.state.paper.as_ref().map_or((0, 0), PaperWindow::counts);
        Trials::new(successes, n).unwrap_or(Trials::NONE)
    }

    /// The level of the paper's rule.
    pub fn paper_level(&self) -> Option<Level> {
        self.state.paper_level
    }

    /// Number of alarms raised so far.
    pub fn raised(&self) -> u64 {
        self.state.raised
    }

    /// The cycles of each robot, by name.
    pub fn robots(&self) -> impl Iterator<Item = (&str, RobotTally)> {
        self.state.robots.iter().map(|(name, robot)| (name.as_str(), robot.tally))
    }

    /// The state of each detector.
    pub fn detectors(&self, settings: &Settings) -> Vec<DetectorView> {
        let view = |metric: Metric| {
            let i = metric.index();
            if metric == Metric::Robot {
                return self.robot_detector(settings);
            }
            let levels = match (&self.factors[i], &self.state.evidence[i]) {
                (Some(_), Some(_)) if self.lacks_parameters(metric) => {
                    Err("no cycle reported a parameter of the validated region")
                }
                (None, _) if self.lacks_event(metric, settings) => Err("no cycle reported this event"),
                (Some(factors), Some(evidence)) => {
                    Ok(Level::ALL.map(|level| (evidence[level as usize].value(factors), settings.limit(metric, level))))
                }
                _ => Err(self.new_factors(metric, settings).err().unwrap_or("the detector has not started")),
            };
            DetectorView::of(metric, settings, levels, self.state.standing[i])
        };
        Metric::all(settings).map(view).collect()
    }

    /// The highest evidence of any robot, and the oldest active alarm of a robot.
    fn robot_detector(&self, settings: &Settings) -> DetectorView {
        let metric = Metric::Robot;
        let robots = || self.state.robots.values();
        let levels = match &self.factors[metric.index()] {
            _ if self.state.robots.len() < 2 => Err("the recipe has one robot only"),
            None => Err(self.new_factors(metric, settings).err().unwrap_or("the detector has not started")),
            Some(factors) => Ok(Level::ALL.map(|level| {
                let evidence =
                    robots().filter_map(|robot| Some(robot.evidence.as_ref()?[level as usize].value(factors)));
                (evidence.fold(0.0, f64::max), settings.limit(metric, level))
            })),
        };
        let first = |level: Level| {
            let standing = robots().filter_map(|robot| robot.standing[level as usize]);
            standing.min_by_key(|standing| standing.raised)
        };
        DetectorView::of(metric, settings, levels, Level::ALL.map(first))
    }

    /// The most severe active level of the detectors. The paper's rule has no guarantee: see [`Self::paper_level`].
    pub fn level(&self) -> Option<Level> {
        let robots = self.state.robots.values().map(|robot| &robot.standing);
        let all = || self.state.standing.iter().chain(robots.clone());
        let stands = |level: Level| all().any(|both| both[level as usize].is_some());
        Level::ALL.into_iter().rev().find(|level| stands(*level))
    }
}

/// A hash of the settings of a recipe: FNV-1a over numbers and text. It is not cryptographic.
fn given(name: &str, settings: &Settings) -> u64 {
    struct Fnv(u64);
    impl Fnv {
        fn add(&mut self, word: u64) {
            self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
            // Mix the high bits into the low ones.
            self.0 ^= self.0 >> 29;
        }
    }
    impl std::fmt::Write for Fnv {
        fn write_str(&mut self, text: &str) -> std::fmt::Result {
            text.bytes().for_each(|byte| self.add(byte.into()));
            Ok(())
        }
    }
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    let Baseline { success, events, failure_modes, cycle_times_s } = settings.baseline_of(name);
    // Writing to the hash cannot fail.
    let _ = write!(hash, "{success:?}{events:?}{failure_modes:?}{:?}", settings.domain_of(name));
    cycle_times_s.iter().flatten().for_each(|time| hash.add(time.to_bits()));
    hash.0
}

/// The id of a raised or cleared alarm.
pub(crate) fn happening_id(recipe: &Recipe, cycle: &Cycle, metric: &str, level: Level, h: Happening) -> String {
    let happening = match h {
        Happening::Raised => "raised",
        Happening::Cleared => "cleared",
    };
    format!("{}/{}/{metric}/{}/{happening}", cycle.recipe, recipe.state.cycles, level.as_str())
}

#[cfg(test)]
mod tests {
    use robogate_core::Seed;
    use serde_json::{Value, json};

    use super::*;
    use crate::{Count, OTHER_MODE};

    /// A failed cycle.
    fn failed(mode: &str) -> Cycle {
        let text = json!({
            "id": "c", "robot": "r", "recipe": "x", "time_s": 1.0, "success": false, "failure_mode": mode
        });
        serde_json::from_value(text).unwrap()
    }

    #[test]
    fn version_0_1_states_can_be_read() {
        let success = Some(Count { count: 950, of: 1_000 });
        let counts = ["grasp_miss", "grip_loss", "collision", "timeout", OTHER_MODE].into_iter().zip([9, 8, 7, 6, 5]);
        let baseline = Baseline { success, failure_modes: Some(counts.collect()), ..Baseline::default() };
        let settings = Settings { baseline, ..Settings::default() };
        let mut recipe = Recipe::new("x", &settings);
        recipe.observe(&failed("timeout"), &settings, &mut |_| {});
        let mut old = serde_json::to_value(recipe.state()).unwrap();
        // The format of version 0.1: no list of modes, and counts in a fixed order.
        old.as_object_mut().unwrap().remove("modes");
        old["baseline"]["failure_modes"] = json!([9, 8, 7, 6, 5]);
        old["learning"]["modes"] = json!([0, 0, 0, 0, 0]);
        let state: RecipeState = serde_json::from_value(old).unwrap();
        let mut restored = Recipe::restore("x", state, &settings);
        assert_eq!(restored.baseline(), recipe.baseline());
        assert_eq!(restored.state().modes.name(3), "timeout");
        restored.observe(&failed("spilled"), &settings, &mut |_| {});
        let written: Value = serde_json::to_value(restored.state()).unwrap();
        assert_eq!(written["modes"], json!(["grasp_miss", "grip_loss", "collision", "timeout", "other"]));
    }

    #[test]
    fn version_0_2_states_can_be_read() {
        let success = Some(Count { count: 950, of: 1_000 });
        let settings = Settings { baseline: Baseline { success, ..Baseline::default() }, ..Settings::default() };
        let mut recipe = Recipe::new("x", &settings);
        recipe.observe(&failed("timeout"), &settings, &mut |_| {});
        let mut old = serde_json::to_value(recipe.state()).unwrap();
        // The format of version 0.2: no list of events, two events among the metrics, seven codes for a cycle.
        old.as_object_mut().unwrap().remove("events");
        old["evidence"] = json!([null, null, null, null, null, null, null, null, null]);
        old["standing"] = json!(vec![[Value::Null, Value::Null]; 9]);
        old["began"] = json!(vec![0; 9]);
        old["baseline"] = json!({"success": {"count": 950, "of": 1_000}, "drop": {"count": 1, "of": 100}});
        old["learning"].as_object_mut().unwrap().remove("events");
        old["history"]["ring"][0]["codes"] = json!([1, 0, 0, 255, 3, 255, 255]);
        let state: RecipeState = serde_json::from_value(old).unwrap();
        let mut restored = Recipe::restore("x", state, &settings);
        assert_eq!((restored.trials(), restored.baseline().success), (recipe.trials(), success));
        assert!(restored.detectors(&settings)[0].levels.is_ok());
        let mut cycle = failed("timeout");
        cycle.events.insert("drop".to_owned(), true);
        restored.observe(&cycle, &settings, &mut |_| {});
        let again = serde_json::from_str(&serde_json::to_string(restored.state()).unwrap()).unwrap();
        assert_eq!(Recipe::restore("x", again, &settings), restored);
    }

    #[test]
    fn new_modes_are_learnt() {
        let settings = Settings { learn_failures: 4, ..Settings::default() };
        let mut recipe = Recipe::new("x", &settings);
        for mode in ["jammed", "spilled", "jammed", "jammed", "burnt"] {
            recipe.observe(&failed(mode), &settings, &mut |_| {});
        }
        let learnt = recipe.baseline().failure_modes.clone().unwrap();
        assert_eq!((learnt.of("jammed"), learnt.of("spilled"), learnt.total()), (3, 1, 4));
        assert_eq!(recipe.state().modes.code("burnt"), recipe.state().modes.code(OTHER_MODE));
    }

    #[test]
    fn dependence_is_found_in_metrics_of_every_second_cycle() {
        let settings = Settings::default();
        let dropped = Metric::all(&settings).find(|metric| metric.name(&settings) == "event:drop").unwrap();
        let mut recipe = Recipe::new("x", &settings);
        let mut cycle = Cycle { success: true, failure_mode: None, ..failed("timeout") };
        for i in 0..2_000_u32 {
            // Drops in batches of 16 reports. The recipe has an odd number of cycles at each report.
            cycle.events.clear();
            if i % 2 == 0 {
                cycle.events.insert("drop".to_owned(), i / 32 % 2 == 1);
            }
            recipe.observe(&cycle, &settings, &mut |_| {});
        }
        assert_eq!(recipe.inflation(dropped).map(|found| found.cycles), Some(16));
    }

    #[test]
    fn rare_modes_raise_no_alarm() {
        let settings = Settings::default();
        let mut recipe = Recipe::new("x", &settings);
        let mut stream = Seed::campaign(42).stream("rare modes");
        let mut alarms = Vec::new();
        for _ in 0..4_000 {
            let rare = stream.uniform() < 0.3;
            let mode = if rare { format!("rare-{}", stream.below(60)) } else { "jammed".to_owned() };
            recipe.observe(&failed(&mode), &settings, &mut |alarm| alarms.push(alarm));
        }
        alarms.retain(|alarm| alarm.metric == "failure_modes" && alarm.level == Level::Critical);
        assert_eq!(alarms, []);
    }
}
