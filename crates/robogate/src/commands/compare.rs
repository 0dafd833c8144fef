//! `robogate compare`: comparison of robots, policies or simulators.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{
    AnalysisError, Comparison, ComparisonError, ComparisonOptions, Finding, PairedComparison, SharedCurve, Source,
};
use robogate_report::{
    ComparisonHeadline, comparison_html_with, comparison_json, comparison_limits, comparison_markdown,
};
use robogate_stats::format::{p_value, percent_or_dash, points};

use crate::arguments::ReopeningArguments;
use crate::commands::analyze::{Groups, heading, interval};
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INVALID, OrExit, USAGE};
use crate::place;
use crate::terminal::{bar, bold, dim, grouped, line, note, percent, wrapped};
use crate::watch;
use robogate_session::open_source;

/// Compare dictionaries of different robots, policies or simulators, and find where all of them fail.
#[derive(Debug, Args)]
pub(crate) struct Compare {
    /// Two or more folders of runs, dictionaries (Parquet) or published JSON dictionaries
    #[arg(required = true, value_name = "RUN_OR_FILE")]
    dictionaries: Vec<PathBuf>,
    /// Compare scenario by scenario; all of them must have the same design
    #[arg(long)]
    paired: bool,
    /// Compare dictionaries with different parameter spaces: only their rows in the shared ranges
    #[arg(long, conflicts_with = "paired")]
    common: bool,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Write a self-contained HTML page to this file
    #[arg(long = "out", alias = "html", value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write a Markdown page to this file
    #[arg(long, value_name = "FILE")]
    md: Option<PathBuf>,
    /// Set the names of the dictionaries, in their order; default: chosen from their provenance
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    names: Vec<String>,
    /// Map two shared parameters
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate below which a cell is a danger zone, in (0, 1)
    #[arg(long, value_name = "RATE", default_value_t = 0.4)]
    danger: f64,
    /// Set the reach of a robot in metres, if its dictionary does not record it
    #[arg(long, value_name = "NAME=METRES", value_parser = named_length)]
    reach: Vec<(String, f64)>,
    /// Set the distance from base to workspace in metres, for dictionaries that do not record it
    #[arg(long, value_name = "METRES")]
    workspace: Option<f64>,
    /// Set the number of scenarios with different outcomes to list for each direction
    #[arg(long, value_name = "N", default_value_t = 10, requires = "paired")]
    flips: usize,
    #[command(flatten)]
    groups: Groups,
    /// Leave out the recorded episodes
    #[arg(long)]
    no_replay: bool,
    #[command(flatten)]
    opening: ReopeningArguments,
}

fn named_length(text: &str) -> Result<(String, f64), String> {
    let (name, metres) = text.rsplit_once('=').ok_or("expected NAME=METRES, for example ur3e=0.5")?;
    let metres = metres.trim().parse().map_err(|_| format!("`{metres}` is not a valid length in metres"))?;
    Ok((name.trim().to_owned(), metres))
}

impl Compare {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_twice()?;
        place::check_different(("--out", self.html.as_deref()), ("--md", self.md.as_deref()))?;
        let open = |path: &PathBuf| open_source(path).map(|source| (source, path.clone()));
        let sources: Vec<(Source, PathBuf)> = self.dictionaries.iter().map(open).collect::<Result<_, _>>()?;
        let options = ComparisonOptions {
            names: self.names.clone(),
            danger_limit: self.danger,
            pair: self.pair.first().cloned().zip(self.pair.get(1).cloned()),
            reach_m: self.reach.clone(),
            workspace_m: self.workspace,
            paired: self.paired,
            common: self.common,
            max_flips: self.flips,
            groups: self.groups.columns.clone(),
        };
        let comparison = Comparison::of(&sources, &options).map_err(exit)?;
        if let Some(file) = &self.html {
            let watch = if self.no_replay {
                None
            } else {
                Some(watch::compared(&comparison, &sources, &self.opening.choice()).or_usage()?)
            };
            let watch = watch.as_ref().filter(|watch| !watch.items.is_empty());
            write(file, &comparison_html_with(&comparison, watch))?;
        }
        if let Some(file) = &self.md {
            write(file, &comparison_markdown(&comparison))?;
        }
        if self.json {
            line(comparison_json(&comparison));
        } else {
            print(&comparison);
        }
        Ok(if comparison.has_evidence() { DONE } else { INVALID })
    }

    /// Returns an error if a path is given twice, in any spelling, or if a page would overwrite a dictionary.
    fn check_twice(&self) -> Result<(), Exit> {
        let full = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        for (i, path) in self.dictionaries.iter().enumerate() {
            if self.dictionaries[..i].iter().any(|before| full(before) == full(path)) {
                let error = anyhow!("{} is given twice\nHint: remove one of them", path.display());
                return Err(Exit { code: USAGE, error });
            }
            if let Some(page) = [&self.html, &self.md].into_iter().flatten().find(|page| full(page) == full(path)) {
                let error = anyhow!("{} is a dictionary, which the page would overwrite", page.display());
                return Err(Exit { code: USAGE, error });
            }
        }
        Ok(())
    }
}

pub(super) fn exit(error: ComparisonError) -> Exit {
    let broken = matches!(error, ComparisonError::Analysis(AnalysisError::Io { .. }));
    Exit { code: if broken { INFRASTRUCTURE } else { USAGE }, error: error.into() }
}

pub(super) fn write(file: &Path, text: &str) -> Result<(), Exit> {
    std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
    note(format_args!("{}: {} KB", file.display(), text.len().div_ceil(1024)));
    Ok(())
}

/// Pads or cuts a text to exactly `width` columns.
fn fit(text: &str, width: usize) -> String {
    let n = text.chars().count();
    if n <= width {
        return format!("{text}{}", " ".repeat(width - n));
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

fn points_interval([low, high]: [f64; 2]) -> String {
    format!("{:>6} to {:>6}", points(low), points(high))
}

fn print(of: &Comparison) {
    let names: Vec<&str> = of.datasets.iter().map(|d| d.name.as_str()).collect();
    line(format_args!("{} compares {}", bold("RoboGate"), names.join(", ")));
    line("");
    line(bold("Result"));
    let headline = ComparisonHeadline::of(of);
    wrapped(&headline.answer);
    for (title, lines) in [("What differs", &headline.what_differs), ("What they share", &headline.what_they_share)] {
        if !lines.is_empty() {
            heading(title);
            lines.iter().for_each(|text| wrapped(text));
        }
    }
    rates(of);
    differences(of);
    of.paired.iter().for_each(paired);
    modes(of);
    of.marginal_effects.iter().for_each(|curve| marginal_effect(curve, &of.compared));
    not_shared(of);
    universal(of);
    sensitivity(of);
    reach(of);
    heading("Limits");
    comparison_limits(of).iter().for_each(|limit| wrapped(limit));
}

fn rates(of: &Comparison) {
    heading("Success rates");
    for d in &of.datasets {
        let rate = &d.success.rate;
        line(format_args!(
            "  {} {:>7} {} {} {:>8}  {}",
            fit(&d.name, 22),
            percent_or_dash(rate.rate),
            bar(rate.rate.unwrap_or(0.0), 20),
            interval(rate.wilson_95),
            grouped(rate.n),
            dim(if d.excluded_because.is_some() { "not compared" } else { d.population.brief() })
        ));
        if let Some(because) = &d.excluded_because {
            wrapped(&format!("{}: {because}.", d.name));
        }
        let bounds = &d.success.bounds;
        if let (1.., Some(worst), Some(best)) = (bounds.invalid, bounds.worst_case, bounds.best_case) {
            let n = grouped(bounds.invalid);
            line(format_args!("  {:<22} {n} invalid: the rate could be {} to {}", "", percent(worst), percent(best)));
        }
    }
}

fn differences(of: &Comparison) {
    if of.differences.is_empty() {
        return;
    }
    heading("Differences in points (95 % for all pairs together)");
    for d in &of.differences {
        let text = format!(
            "  {} {:>7}  {}  {:<11}  p {:>8}  {}",
            fit(&format!("{} - {}", d.first, d.second), 28),
            points(d.difference),
            points_interval(d.interval_95),
            d.test(),
            p_value(d.adjusted_p.max(f64::MIN_POSITIVE).ln()),
            if d.is_significant() {
                "significant"
            } else if d.is_tie() {
                "tie"
            } else {
                ""
            }
        );
        if d.is_significant() { line(text) } else { line(dim(text.trim_end())) }
    }
    if of.differences.iter().any(|d| d.valid_pairs.is_some()) {
        wrapped("paired: the same scenarios in both. Interval and p-value come from one score test, so they agree.");
    }
}

fn paired(pair: &PairedComparison) {
    heading(format_args!("{} and {}, scenario by scenario", pair.first, pair.second));
    line(format_args!("  {} of {} scenarios are valid in both", grouped(pair.valid_pairs), grouped(pair.scenarios)));
    pair.how_paired().iter().for_each(|text| wrapped(text));
    for (name, rate) in [(&pair.first, &pair.first_rate), (&pair.second, &pair.second_rate)] {
        line(format_args!(
            "  {} {:>7} {} {}",
            fit(name, 22),
            percent_or_dash(rate.rate),
            bar(rate.rate.unwrap_or(0.0), 20),
            interval(rate.wilson_95)
        ));
    }
    if let Some(difference) = pair.difference {
        line(format_args!(
            "  {} {:>7}  {} points, p {}, for all pairs {}{}",
            fit("difference", 22),
            points(difference),
            points_interval(pair.difference_95),
            p_value(pair.ln_p),
            p_value(pair.adjusted_p.max(f64::MIN_POSITIVE).ln()),
            if pair.is_tie() { ", tie" } else { "" }
        ));
    }
    line(format_args!(
        "  both {}, only {} {}, only {} {}, neither {}",
        grouped(pair.both),
        pair.first,
        grouped(pair.first_only),
        pair.second,
        grouped(pair.second_only),
        grouped(pair.neither)
    ));
    if pair.invalid.either > 0 {
        let bounds = pair.invalid.difference_bounds.map_or_else(|| "-".to_owned(), points_interval);
        wrapped(&format!(
            "{} invalid in {}, {} in {}: left out of every rate. Their outcomes could put the difference over all scenarios anywhere within {} points.",
            grouped(pair.invalid.first),
            pair.first,
            grouped(pair.invalid.second),
            pair.second,
            bounds.split_whitespace().collect::<Vec<_>>().join(" ")
        ));
    }
    line("");
    line(format_args!("  outcomes: {} in rows, {} in columns", pair.first, pair.second));
    let heads: String = pair.outcomes.outcomes.iter().map(|word| format!("{word:>12}")).collect();
    line(dim(format_args!("  {:<12}{heads}", "")));
    for (word, counts) in pair.outcomes.outcomes.iter().zip(&pair.outcomes.counts) {
        let counts: String = counts.iter().map(|n| format!("{:>12}", grouped(*n))).collect();
        line(format_args!("  {word:<12}{counts}"));
    }
    disagreement(pair);
    flips(pair);
}

fn disagreement(pair: &PairedComparison) {
    let map = match &pair.disagreement {
        Finding::Estimated(map) => map,
        Finding::CannotBeEstimated { because } => {
            wrapped(&format!("No map: {because}."));
            return;
        }
    };
    line("");
    line(format_args!(
        "  scenarios with different outcomes, in percent: {} by row, {} by column",
        map.y.parameter, map.x.parameter
    ));
    let from = |axis: &robogate_analysis::Axis, at: usize| match (axis.levels.get(at), axis.edges.get(at)) {
        (Some(level), _) => level.chars().take(8).collect(),
        (None, Some(edge)) => format!("{edge:.3}"),
        _ => String::new(),
    };
    let nx = map.x.cells();
    for row in (0..map.y.cells()).rev() {
        let cells: String = map.cells[row * nx..(row + 1) * nx]
            .iter()
            .map(|cell| {
                let mark = match cell.first_only.cmp(&cell.second_only) {
                    _ if cell.differ.successes == 0 => ' ',
                    std::cmp::Ordering::Greater => 'a',
                    std::cmp::Ordering::Less => 'b',
                    std::cmp::Ordering::Equal => '=',
                };
                let mark = if cell.holm_p <= 0.05 { mark.to_ascii_uppercase() } else { mark };
                cell.differ.rate.map_or_else(|| format!("{:>6} ", "-"), |rate| format!("{:>6.0}{mark}", 100.0 * rate))
            })
            .collect();
        line(format_args!("  {:>11} {cells}", from(&map.y, row)));
    }
    let across: String =
        (0..nx).map(|i| format!("{:>7}", from(&map.x, i).chars().take(6).collect::<String>())).collect();
    line(dim(format_args!("  {:>11} {across}", "from")));
    wrapped(&format!(
        "a: {} ahead, b: {} ahead, =: neither; upper case: significant (McNemar, Holm over the cells)",
        pair.first, pair.second
    ));
}

fn flips(pair: &PairedComparison) {
    let all = pair.first_only + pair.second_only;
    if all == 0 {
        return;
    }
    line("");
    line(format_args!(
        "  scenarios with different outcomes: {} of {} (list more with --flips)",
        pair.flips.len(),
        grouped(all)
    ));
    for flip in &pair.flips {
        line(format_args!("  {:>8}  {} -> {}", flip.index, fit(&flip.first, 11), flip.second));
        line(dim(format_args!("            {}", fit(&flip.describe(), 86).trim_end())));
    }
    if let Some(flip) = pair.flips.iter().find(|flip| !flip.replay.is_empty()) {
        line("  replay one with");
        flip.replay.iter().for_each(|command| line(format_args!("    {command}")));
    }
}

fn modes(of: &Comparison) {
    heading("Failure modes, share of failures (95 % for all modes together)");
    for d in &of.datasets {
        line(format_args!("  {} {} failures", fit(&d.name, 22), grouped(d.failure_modes.failures)));
        for mode in d.failure_modes.modes.iter().filter(|mode| mode.failures > 0) {
            line(format_args!(
                "    {:<20} {:>7} {} {} {:>9}",
                mode.mode,
                percent_or_dash(mode.share),
                bar(mode.share.unwrap_or(0.0), 20),
                interval(mode.interval_95),
                grouped(mode.failures)
            ));
        }
    }
}

/// The names of datasets on one line.
const MAX_COLUMNS: usize = 3;

fn marginal_effect(curve: &SharedCurve, names: &[String]) {
    heading(format_args!("Success by {}", curve.parameter));
    for (block, names) in names.chunks(MAX_COLUMNS).enumerate() {
        let heads: String = names.iter().map(|name| format!("  {}", fit(name, 25))).collect();
        line(dim(format_args!("  {:<18}{}", "", heads.trim_end())));
        for cell in curve.cells.iter().take(40) {
            let label = match cell.range {
                Some([low, high]) => format!("{low:>7.3} to {high:>7.3}"),
                None => fit(&cell.label, 18),
            };
            let rates = &cell.rates[block * MAX_COLUMNS..][..names.len()];
            let rates: String = rates
                .iter()
                .map(|rate| match rate.rate {
                    Some(share) => format!("  {:>7} {}", percent(share), interval(rate.wilson_95)),
                    None => format!("  {:>7} {:>17}", "-", ""),
                })
                .collect();
            line(format_args!("  {label}{}", rates.trim_end()));
        }
        if curve.cells.len() > 40 {
            line(dim(format_args!("  and {} more levels (--json)", curve.cells.len() - 40)));
        }
    }
    if let Some(remark) = &curve.remark {
        wrapped(remark);
    }
}

fn not_shared(of: &Comparison) {
    if of.parameters.not_shared.is_empty() {
        return;
    }
    heading("Parameters that are not shared");
    for parameter in &of.parameters.not_shared {
        wrapped(&format!("{}: {} ({})", parameter.parameter, parameter.because, parameter.datasets.join(", ")));
    }
}

fn universal(of: &Comparison) {
    let zones = &of.universal_zones;
    heading(format_args!(
        "Where all of them are below {:.0} % (Holm over {} cells; {} with too few episodes)",
        100.0 * zones.limit,
        grouped(zones.tested),
        grouped(zones.too_few_episodes)
    ));
    for zone in zones.zones.iter().take(16) {
        let rates: Vec<String> = zone.rates.iter().map(|rate| percent_or_dash(rate.rate)).collect();
        let text = format!(
            "  {} {}  p (Holm) {:>8}  {}",
            fit(&zone.describe(), 38),
            fit(&rates.join(" / "), 24),
            p_value(zone.holm_p.max(f64::MIN_POSITIVE).ln()),
            if zone.significant { "significant" } else { "" }
        );
        if zone.significant { line(text) } else { line(dim(text.trim_end())) }
    }
    match zones.zones.len() {
        0 if zones.tested == 0 => line("  no cell has enough episodes of every dataset"),
        0 => line("  none observed"),
        n if n > 16 => line(dim(format_args!("  and {} more (--json)", n - 16))),
        _ => {}
    }
}

fn sensitivity(of: &Comparison) {
    let found = match &of.sensitivity {
        Finding::Estimated(found) => found,
        Finding::CannotBeEstimated { because } => {
            heading("Effect of one parameter");
            wrapped(&format!("It cannot be estimated because {because}."));
            return;
        }
    };
    let label = parameter_label(&found.parameter);
    heading(format_args!("Effect of {label}: slope of the log-odds of success over ln({label})"));
    for effect in &found.effects {
        match &effect.slope {
            Finding::Estimated(slope) => {
                let end = |end: Option<f64>| end.map_or_else(|| "unbounded".to_owned(), |end| format!("{end:.2}"));
                line(format_args!(
                    "  {} {:>7.3}  95 % {:>6} to {:>6}  odds x {:.3} per doubling  p {:>8}{}",
                    fit(&effect.name, 20),
                    slope.per_log_unit,
                    end(slope.interval_95[0]),
                    end(slope.interval_95[1]),
                    slope.odds_per_doubling,
                    p_value(slope.ln_p),
                    if slope.penalised { " (Firth)" } else { "" }
                ));
            }
            Finding::CannotBeEstimated { because } => {
                wrapped(&format!("{}: cannot be estimated because {because}.", effect.name));
            }
        }
        for (which, [low, high], rate) in [("lowest", found.low, &effect.low), ("highest", found.high, &effect.high)] {
            line(dim(format_args!(
                "    {which:<7} {} {:>8} {} {:>8}",
                value_with_unit(&format!("{low:.3} to {high:.3}"), &found.parameter),
                percent_or_dash(rate.rate),
                interval(rate.wilson_95),
                grouped(rate.n)
            )));
        }
    }
}

fn reach(of: &Comparison) {
    heading("Workspace and reach");
    let metres = |m: Option<f64>| m.map_or_else(|| "unknown".to_owned(), |m| format!("{m:.3} m"));
    for row in &of.reach {
        line(format_args!(
            "  {} reach {:>7}, work at {:>7}, ratio {:>7}  {:>7} {}{}",
            fit(&row.name, 16),
            metres(row.reach_m),
            metres(row.workspace_m),
            row.ratio.map_or_else(|| "unknown".to_owned(), |r| format!("{r:.3}")),
            percent_or_dash(row.rate.rate),
            interval(row.rate.wilson_95),
            if row.given { " *" } else { "" }
        ));
    }
    if of.reach.iter().any(|row| row.given) {
        line(dim("  * from the command line"));
    }
    if of.reach.iter().any(|row| row.ratio.is_none()) {
        line(dim("  give unknown values with --reach NAME=METRES and --workspace METRES"));
    }
}
