//! `robogate analyze`: the analysis of a dictionary in the terminal or as one document.

use std::path::{Path, PathBuf};

use clap::Args;
use robogate_analysis::{
    Analysis, AnalysisError, AnalysisOptions, CriticalThreshold, DEFAULT_TARGET, Envelope, Finding, MarginalEffect,
    PairMap, Population, Regression, RiskModel, Source, Zone,
};
use robogate_gate::Sampling;
use robogate_report::{Headline, analysis_json_with, condition, limits, low_side, predictor_about};
use robogate_stats::format::{counted, p_value, percent_or_dash};

use crate::commands::report::evidence;
use crate::exit::{Exit, INFRASTRUCTURE, USAGE};
use crate::terminal::{self, bar, bold, dim, grouped, line, percent, wrapped};
use crate::twins::{self, NominalArguments};
use robogate_session::open_source;
use robogate_session::text::quoted;

/// Analyze a dictionary: where the policy fails, the effects of the parameters, and their confidence intervals.
#[derive(Debug, Args)]
pub(crate) struct Analyze {
    /// A run's folder, a dictionary (Parquet), an exported CSV or JSON Lines file, or a published JSON dictionary
    dictionary: PathBuf,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Map two more parameters; the frontier is solved for the first
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate that the advice aims at, between 0 and 1
    #[arg(long, value_name = "RATE", default_value_t = DEFAULT_TARGET)]
    target: f64,
    #[command(flatten)]
    groups: Groups,
    #[command(flatten)]
    nominal: NominalArguments,
}

/// The columns that mark dependent rows.
#[derive(Debug, Args)]
pub(crate) struct Groups {
    /// Set the columns whose equal values mark rows that depend on each other, such as day,operator; default: found by name
    /// (case, scenario, seed, day, session, operator, robot, unit, ...) and by equal settings
    #[arg(long = "groups", value_name = "COLUMN,...", value_delimiter = ',')]
    pub(crate) columns: Vec<String>,
}

impl Analyze {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = open_source(&self.dictionary)?;
        let analysis = analyse(&source, &self.dictionary, &options(&self.pair, self.target, &self.groups))?;
        let twins = self.nominal.twins(&source, Sampling::Fixed)?;
        if self.json {
            line(analysis_json_with(&analysis, twins.as_ref()));
        } else {
            print(&analysis);
            twins.iter().for_each(twins::print);
        }
        Ok(evidence(&analysis))
    }
}

/// The options `--pair A B`, `--target RATE` and `--groups COLUMN,...`.
pub(crate) fn options(names: &[String], target_rate: f64, groups: &Groups) -> AnalysisOptions {
    let pairs = names.chunks_exact(2).map(|pair| (pair[0].clone(), pair[1].clone())).collect();
    AnalysisOptions { pairs, target_rate, groups: groups.columns.clone(), ..AnalysisOptions::default() }
}

/// Analyzes a source. Its errors get their exit codes.
pub(crate) fn analyse(source: &Source, path: &Path, options: &AnalysisOptions) -> Result<Analysis, Exit> {
    Analysis::with(source, path, options).map_err(|error| {
        let code = if matches!(error, AnalysisError::Io { .. }) { INFRASTRUCTURE } else { USAGE };
        Exit { code, error: error.into() }
    })
}

fn print(analysis: &Analysis) {
    answer(analysis);
    conditions(analysis);
    stages(analysis);
    for envelope in &analysis.envelopes {
        pair(envelope);
    }
    influence(analysis);
    by_influence(analysis).for_each(parameter);
    thresholds(analysis);
    modes(analysis);
    danger(analysis);
    if let Finding::Estimated(model) = &analysis.interactions {
        regression("Model with interactions", model);
    }
    risk(&analysis.risk);
    replay(analysis);
    line("");
    line(bold("Limits"));
    limits(analysis).iter().for_each(|limit| wrapped(limit));
}

pub(crate) fn heading(title: impl std::fmt::Display) {
    line("");
    line(bold(title));
}

pub(crate) fn interval([low, high]: [f64; 2]) -> String {
    format!("{:>5.1} to {:>5.1} %", 100.0 * low, 100.0 * high)
}

fn answer(analysis: &Analysis) {
    let subject = &analysis.subject;
    line(format_args!(
        "{} {}, {} policy, {}: {}",
        bold("RoboGate"),
        subject.robot,
        subject.policy,
        subject.engine,
        counted(subject.episodes, "episode")
    ));
    line("");
    let headline = Headline::of(analysis);
    terminal::headline(&headline.answer);
    for (title, lines) in [
        ("Where it fails", &headline.where_it_fails),
        ("What to do", &headline.what_to_do),
        ("Uncertainty", &headline.uncertainty),
    ] {
        if !lines.is_empty() {
            heading(title);
            lines.iter().for_each(|text| wrapped(text));
        }
    }
    line("");
    wrapped(&format!("Unless stated otherwise, figures apply to {}.", analysis.population.describe()));
}

fn stages(analysis: &Analysis) {
    heading("Stages");
    for stage in &analysis.success.stages {
        line(format_args!(
            "  {:<10} {:>8} of {:>9}  {:>8}  Wilson {}  exact {}",
            stage.stage,
            grouped(stage.rate.successes),
            grouped(stage.rate.n),
            percent_or_dash(stage.rate.rate),
            interval(stage.rate.wilson_95),
            interval(stage.rate.clopper_pearson_95)
        ));
        if stage.population == Population::FocusedDesign {
            line(dim(format_args!("             {}", stage.population.brief())));
            if let Some(found) = stage.weighted {
                line(format_args!(
                    "             weighted {} ({}), effective sample size {:.0}: {}",
                    percent(found.rate),
                    interval(found.interval_95),
                    found.effective_sample_size,
                    Population::FocusedRegion.brief()
                ));
            }
        }
        if stage.invalid > 0 {
            line(format_args!("             {} invalid episodes are left out of every rate", grouped(stage.invalid)));
        }
    }
    match &analysis.success.weighting {
        Some(Finding::Estimated(found)) => wrapped(&format!(
            "All {} rows count in every figure: {}. {} of them have points that were chosen.",
            grouped(found.rows),
            found.method,
            grouped(found.chosen)
        )),
        Some(Finding::CannotBeEstimated { because }) => {
            wrapped(&format!("Rows whose points were chosen are left out because {because}."));
        }
        None => {}
    }
}

/// The conditions under which the policy significantly fails more often, as a table.
fn conditions(analysis: &Analysis) {
    let failing = &analysis.conditions.failing;
    if failing.is_empty() {
        return;
    }
    heading("Where it fails, by condition");
    for of in failing {
        line(format_args!("  {}", condition(of)));
        line(format_args!(
            "    {:>8} episodes  {:>7} ({})  elsewhere {:>7}  p {}",
            grouped(of.inside.n),
            percent_or_dash(of.inside.rate),
            interval(of.inside.wilson_95),
            percent_or_dash(of.outside.rate),
            p_value(of.adjusted_p.max(f64::MIN_POSITIVE).ln())
        ));
    }
}

fn pair(envelope: &Envelope) {
    match &envelope.map {
        Finding::Estimated(map) => {
            heading(format_args!("Success in percent, {} by row, {} by column", map.y.parameter, map.x.parameter));
            cells(map);
        }
        Finding::CannotBeEstimated { because } => wrapped(&format!("No map: {because}.")),
    }
    match &envelope.frontier {
        Finding::Estimated(frontier) => {
            wrapped(&format!("frontier {}", frontier.closed_form));
            let valid = match frontier.valid_for {
                Some([low, high]) => format!("valid for {} {low:.4} to {high:.4}", frontier.y),
                None => "outside the observed ranges".to_owned(),
            };
            let pole = frontier.pole.map_or_else(String::new, |pole| format!("; pole at {} {pole:.4}", frontier.y));
            line(dim(format_args!("           {valid}{pole}")));
            if frontier.contradicted {
                wrapped(&format!(
                    "Do not rely on this frontier: where the model predicts 40 to 60 % success, the observed rate is {} ({}).",
                    percent_or_dash(frontier.near.rate),
                    interval(frontier.near.wilson_95)
                ));
            }
            frontier.regression.warnings.iter().for_each(|warning| wrapped(warning));
        }
        Finding::CannotBeEstimated { because } => {
            wrapped(&format!("The frontier cannot be estimated because {because}."));
        }
    }
}

fn cells(map: &PairMap) {
    let nx = map.x.cells();
    let label = |axis: &robogate_analysis::Axis, at: usize| match (axis.levels.get(at), axis.edges.get(at)) {
        (Some(level), _) => level.chars().take(11).collect(),
        (None, Some(edge)) => format!("{edge:.3}"),
        _ => String::new(),
    };
    for row in (0..map.y.cells()).rev() {
        let mut text = format!("  {:>11} ", label(&map.y, row));
        for cell in &map.cells[row * nx..(row + 1) * nx] {
            let mark = match cell.zone {
                Zone::Safe => '+',
                Zone::Boundary => '=',
                Zone::Danger => '!',
                Zone::Undecided => '?',
                Zone::TooFewEpisodes => ' ',
            };
            text.push_str(&match cell.model.map(|model| model.rate).or(cell.rate.rate) {
                Some(rate) => format!("{:>6.0}{mark}", 100.0 * rate),
                None => format!("{:>6} ", "-"),
            });
        }
        line(text);
    }
    let across: String =
        (0..nx).map(|i| format!("{:>7}", label(&map.x, i).chars().take(6).collect::<String>())).collect();
    line(dim(format_args!("  {:>11} {across}", "from")));
    wrapped(match map.length_scale {
        Some(_) => {
            "Rates of a smooth model. Its 95 % interval (pointwise) is in danger (!, up to 30 %), between (=), safe (+, from 70 %) or \
             undecided (?)."
        }
        None => {
            "! significantly in danger (up to 30 %), = between, + safe (from 70 %), ? undecided, no mark: too few episodes. Zones \
             use simultaneous 95 % intervals for all cells."
        }
    });
}

/// The marginal effects, the most influential parameter first.
pub(crate) fn by_influence(analysis: &Analysis) -> impl Iterator<Item = &MarginalEffect> {
    let of = |name: &str| analysis.marginal_effects.iter().find(|effect| effect.parameter == name);
    let tested = |name: &str| analysis.effects.ranked.iter().any(|effect| effect.parameter == name);
    let ranked: Vec<&MarginalEffect> =
        analysis.effects.ranked.iter().filter_map(|effect| of(&effect.parameter)).collect();
    let others = analysis.marginal_effects.iter().filter(move |effect| !tested(&effect.parameter));
    ranked.into_iter().chain(others)
}

/// The parameters with their influence on success and the shapes of significant effects.
pub(crate) fn influence(analysis: &Analysis) {
    let effects = &analysis.effects;
    if effects.ranked.is_empty() {
        return;
    }
    heading("Influence on success (permutation tests, adjusted by Holm)");
    for effect in &effects.ranked {
        let p = p_value(effect.adjusted_p.max(f64::MIN_POSITIVE).ln());
        let text = format!("  {:<16} explains {:>7}  p {p:>8}", effect.parameter, percent(effect.influence));
        match effect.shape.estimated() {
            Some(shape) => {
                line(text);
                wrapped(&format!(
                    "{} {}, elsewhere {}",
                    percent_or_dash(shape.low.rate),
                    low_side(&effect.parameter, shape),
                    percent_or_dash(shape.high.rate)
                ));
            }
            None => line(dim(text)),
        }
    }
    for pair in &effects.interactions {
        let p = p_value(pair.adjusted_p.max(f64::MIN_POSITIVE).ln());
        line(format_args!("  {} x {}: interaction, p {p}", pair.parameters[0], pair.parameters[1]));
    }
}

fn parameter(effect: &MarginalEffect) {
    let correlation = match effect.correlation.estimated() {
        Some(robogate_analysis::Correlation::Number { point_biserial, .. }) => {
            format!("correlation {point_biserial:+.3}")
        }
        Some(robogate_analysis::Correlation::Category { cramers_v, .. }) => format!("Cramer's V {cramers_v:.3}"),
        None => format!("no correlation: {}", effect.correlation.because().unwrap_or_default()),
    };
    heading(format_args!("Success by {} ({correlation})", effect.parameter));
    for cell in effect.cells.iter().take(40) {
        let label = match cell.range {
            Some([low, high]) => format!("{low:>7.3} to {high:>7.3}"),
            None => format!("{:>18}", cell.label.chars().take(18).collect::<String>()),
        };
        let Some(rate) = cell.rate.rate else {
            line(dim(format_args!("  {label}       -  no valid episode")));
            continue;
        };
        let text = format!(
            "  {label} {:>8}  {}  {} {:>9}  {}",
            percent(rate),
            bar(rate, 20),
            interval(cell.rate.wilson_95),
            grouped(cell.rate.n),
            cell.zone.as_str()
        );
        if cell.zone.is_classified() { line(text) } else { line(dim(text)) }
    }
    if effect.cells.len() > 40 {
        line(dim(format_args!("  and {} more levels (--json)", effect.cells.len() - 40)));
    }
}

fn thresholds(analysis: &Analysis) {
    if !analysis.marginal_effects.is_empty() {
        heading("Where success crosses 50 % (1,000 bootstrap replicates)");
    }
    for effect in &analysis.marginal_effects {
        let name = &effect.parameter;
        match &effect.threshold {
            Finding::Estimated(CriticalThreshold::Crosses { at, rising, low, high, se, .. }) => {
                let end = |x: &Option<f64>| x.map_or_else(|| "beyond".to_owned(), |x| format!("{x:.4}"));
                line(format_args!(
                    "  {name:<16} {at:>9.4}  95 % {} to {}, se {}, {}",
                    end(low),
                    end(high),
                    se.map_or_else(|| "-".to_owned(), |se| format!("{se:.4}")),
                    if *rising { "rising" } else { "falling" }
                ));
            }
            Finding::Estimated(CriticalThreshold::CrossesMoreThanOnce { between }) => {
                line(format_args!("  {name:<16} crosses more than once ({} ranges)", between.len()));
            }
            Finding::Estimated(CriticalThreshold::DoesNotCross { stays_above, crossing_share }) => line(format_args!(
                "  {name:<16} does not cross: stays {} 50 % ({} of replicates cross)",
                if *stays_above { "above" } else { "below" },
                percent(*crossing_share)
            )),
            Finding::CannotBeEstimated { because } => line(dim(format_args!("  {name:<16} {because}"))),
        }
    }
}

fn modes(analysis: &Analysis) {
    heading(format_args!("Failures ({})", grouped(analysis.failure_modes.failures)));
    for mode in &analysis.failure_modes.modes {
        let share = mode.share.unwrap_or(0.0);
        line(format_args!(
            "  {:<12} {:>9} {:>8}  {}  {}",
            mode.mode,
            grouped(mode.failures),
            percent_or_dash(mode.share),
            bar(share, 20),
            interval(mode.interval_95)
        ));
    }
    if let (Finding::CannotBeEstimated { because }, false) =
        (&analysis.failure_modes.dominant, analysis.failure_modes.not_recorded.is_empty())
    {
        wrapped(&format!("The dominant failure mode is uncertain because {because}."));
    }
    for effect in &analysis.marginal_effects {
        let Some(found) = effect.transitions.estimated() else { continue };
        for change in &found.changes {
            let [low, high] = change.between;
            line(format_args!(
                "  with rising {}, the dominant mode changes from {} to {} between {low:.4} and {high:.4}",
                effect.parameter, change.from, change.to
            ));
        }
    }
}

fn danger(analysis: &Analysis) {
    let zones = &analysis.danger_zones;
    heading(format_args!(
        "Bins and levels below {:.0} % success (Holm over {} bins and levels)",
        100.0 * zones.limit,
        grouped(zones.tested)
    ));
    for zone in zones.zones.iter().take(24) {
        let cell = match zone.range {
            Some([low, high]) => format!("{low:.3} to {high:.3}"),
            None => zone.cell.clone(),
        };
        let text = format!(
            "  {:<16} {cell:<18} {:>7} {:>9}  p (Holm) {:>8}  {}",
            zone.parameter,
            percent_or_dash(zone.rate.rate),
            grouped(zone.rate.n),
            p_value(zone.holm_p.max(f64::MIN_POSITIVE).ln()),
            if zone.significant { "significant" } else { "not significant" }
        );
        if zone.significant { line(text) } else { line(dim(text)) }
    }
    match zones.zones.len() {
        0 => line("  none observed"),
        n if n > 24 => line(dim(format_args!("  and {} more (--json)", n - 24))),
        _ => {}
    }
}

fn regression(title: &str, model: &Regression) {
    heading(format_args!(
        "{title}: log-odds of {} per standard deviation, {} rows",
        model.outcome,
        grouped(model.rows)
    ));
    for term in &model.terms {
        match &term.estimate {
            Finding::Estimated(e) => line(format_args!(
                "  {:<24} {:>9.4}  se {:>7.4}  z {:>8.2}  p {:>9}",
                term.term,
                e.coefficient,
                e.se,
                e.z,
                p_value(e.ln_p)
            )),
            Finding::CannotBeEstimated { because } => {
                line(dim(format_args!("  {:<24} left out: {because}", term.term)))
            }
        }
    }
    model.warnings.iter().for_each(|warning| wrapped(warning));
}

fn risk(risk: &Finding<RiskModel>) {
    let risk = match risk {
        Finding::Estimated(risk) => risk,
        Finding::CannotBeEstimated { because } => {
            heading("Risk model");
            wrapped(&format!("It cannot be estimated because {because}."));
            return;
        }
    };
    heading("Risk model");
    match &risk.predictor {
        Finding::Estimated(model) => {
            wrapped(&predictor_about(model));
            if let Finding::Estimated(f) = &model.calibration_cross_validated {
                line(format_args!(
                    "  cross-validated  AUC {}, Brier {:.4} (overall rate {:.4}), ECE {:.4}",
                    model.auc_cross_validated.map_or_else(|| "-".to_owned(), |auc| format!("{auc:.3}")),
                    f.brier,
                    f.base_rate_brier,
                    f.expected_calibration_error
                ));
            }
        }
        Finding::CannotBeEstimated { because } => wrapped(&format!("The logistic model predicts, because {because}.")),
    }
    regression("Logistic risk model", &risk.regression);
    match &risk.roc {
        Finding::Estimated(roc) => {
            let ends = |[low, high]: [f64; 2]| format!("{low:.3} to {high:.3}");
            if let Some(auc) = roc.auc_cross_validated {
                line(format_args!("  AUC cross-validated {auc:.3} ({})", ends(roc.auc_cross_validated_95)));
            }
            line(format_args!("  AUC in sample       {:.3} ({})", roc.auc_in_sample, ends(roc.auc_in_sample_95)));
        }
        Finding::CannotBeEstimated { because } => wrapped(&format!("No AUC: {because}.")),
    }
    for (which, found) in
        [("cross-validated", &risk.calibration_cross_validated), ("in sample", &risk.calibration_in_sample)]
    {
        if let Finding::Estimated(f) = found {
            line(format_args!(
                "  {which:<16} Brier {:.4} (overall rate {:.4}), log loss {}, ECE {:.4}",
                f.brier,
                f.base_rate_brier,
                f.log_loss.map_or_else(|| "infinite".to_owned(), |l| format!("{l:.4}")),
                f.expected_calibration_error
            ));
        }
    }
}

fn replay(analysis: &Analysis) {
    for group in &analysis.replay {
        heading(&group.title);
        for episode in &group.episodes {
            line(format_args!("  {:>8}  {:<22} {}", episode.index, episode.outcome, episode.figure));
        }
    }
    if analysis.subject.replayable && !analysis.replay.is_empty() {
        line(dim(format_args!(
            "  replay one with: robogate replay {} INDEX",
            quoted(Path::new(&analysis.subject.path))
        )));
    }
}
