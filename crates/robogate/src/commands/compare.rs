//! `robogate compare`: robots, policies or simulators side by side.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{
    AnalysisError, Comparison, ComparisonError, ComparisonOptions, Finding, PairedComparison, SharedCurve, Source,
};
use robogate_report::{ComparisonHeadline, comparison_html, comparison_json, comparison_limits, comparison_markdown};

use crate::commands::analyze::{heading, interval, p_value, rate_of};
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INVALID, OrExit, USAGE};
use crate::terminal::{bar, bold, dim, grouped, line, note, percent, wrapped};

/// Say how dictionaries differ: robots, policies or simulators, and where all of them fail.
#[derive(Debug, Args)]
pub(crate) struct Compare {
    /// Runs' folders, dictionaries (Parquet) or published JSON dictionaries: two or more
    #[arg(required = true, value_name = "RUN_OR_FILE")]
    dictionaries: Vec<PathBuf>,
    /// Compare scenario by scenario: the same design in each of them
    #[arg(long)]
    paired: bool,
    /// Print everything as one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Write a self-contained page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write the same as Markdown
    #[arg(long, value_name = "FILE")]
    md: Option<PathBuf>,
    /// Names of the dictionaries in their order; default: what tells them apart
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    names: Vec<String>,
    /// Two shared parameters whose cells are looked at together
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// The success rate below which a cell is a danger
    #[arg(long, value_name = "RATE", default_value_t = 0.4)]
    danger: f64,
    /// A robot's reach in metres, where a dictionary does not carry it
    #[arg(long, value_name = "NAME=METRES", value_parser = named_length)]
    reach: Vec<(String, f64)>,
    /// Distance from base to workspace in metres, for dictionaries that do not carry it
    #[arg(long, value_name = "METRES")]
    workspace: Option<f64>,
    /// Flips listed for each direction
    #[arg(long, value_name = "N", default_value_t = 10, requires = "paired")]
    flips: usize,
}

fn named_length(text: &str) -> Result<(String, f64), String> {
    let (name, metres) = text.rsplit_once('=').ok_or("write it as NAME=METRES, as in ur3e=0.5")?;
    let metres = metres.trim().parse().map_err(|_| format!("`{metres}` is no number of metres"))?;
    Ok((name.trim().to_owned(), metres))
}

impl Compare {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_twice()?;
        let open = |path: &PathBuf| Source::open(path).map(|source| (source, path.clone()));
        let sources: Vec<(Source, PathBuf)> =
            self.dictionaries.iter().map(open).collect::<Result<_, _>>().or_usage()?;
        let options = ComparisonOptions {
            names: self.names.clone(),
            danger_limit: self.danger,
            pair: self.pair.first().cloned().zip(self.pair.get(1).cloned()),
            reach_m: self.reach.clone(),
            workspace_m: self.workspace,
            paired: self.paired,
            most_flips: self.flips,
        };
        let comparison = Comparison::of(&sources, &options).map_err(exit)?;
        for (file, text) in [(&self.html, comparison_html as fn(&_) -> String), (&self.md, comparison_markdown)] {
            if let Some(file) = file {
                write(file, &text(&comparison))?;
            }
        }
        if self.json {
            line(comparison_json(&comparison));
        } else {
            print(&comparison);
        }
        Ok(if comparison.has_evidence() { DONE } else { INVALID })
    }

    /// Refuses a path that is there twice, in whatever way it is written, and a page over what it is made from.
    fn check_twice(&self) -> Result<(), Exit> {
        let full = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        for (i, path) in self.dictionaries.iter().enumerate() {
            if self.dictionaries[..i].iter().any(|before| full(before) == full(path)) {
                let error = anyhow!(
                    "{} is named twice\nhint: a dictionary compared with itself says nothing; name another one",
                    path.display()
                );
                return Err(Exit { code: USAGE, error });
            }
            if let Some(page) = [&self.html, &self.md].into_iter().flatten().find(|page| full(page) == full(path)) {
                let error = anyhow!("{} is a dictionary: a page would overwrite it", page.display());
                return Err(Exit { code: USAGE, error });
            }
        }
        Ok(())
    }
}

fn exit(error: ComparisonError) -> Exit {
    let broken = matches!(error, ComparisonError::Analysis(AnalysisError::Io { .. }));
    Exit { code: if broken { INFRASTRUCTURE } else { USAGE }, error: error.into() }
}

fn write(file: &Path, text: &str) -> Result<(), Exit> {
    std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
    note(format_args!("{}: {} KB", file.display(), text.len().div_ceil(1024)));
    Ok(())
}

/// A text of exactly `width` columns.
fn fit(text: &str, width: usize) -> String {
    let n = text.chars().count();
    if n <= width {
        return format!("{text}{}", " ".repeat(width - n));
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

fn points(share: f64) -> String {
    // What rounds to nothing has no sign.
    let text = format!("{:+.1}", 100.0 * share);
    if matches!(text.as_str(), "+0.0" | "-0.0") { "0.0".to_owned() } else { text }
}

fn points_interval([low, high]: [f64; 2]) -> String {
    format!("{:>6} to {:>6}", points(low), points(high))
}

fn print(of: &Comparison) {
    let names: Vec<&str> = of.dictionaries.iter().map(|d| d.name.as_str()).collect();
    line(format_args!("{} compares {}", bold("RoboGate"), names.join(", ")));
    line("");
    line(bold("The answer"));
    let headline = ComparisonHeadline::of(of);
    wrapped(&headline.answer);
    for (title, lines) in [("What differs", &headline.what_differs), ("What they share", &headline.what_is_common)] {
        if !lines.is_empty() {
            heading(title);
            lines.iter().for_each(|text| wrapped(text));
        }
    }
    rates(of);
    differences(of);
    of.paired.iter().for_each(paired);
    modes(of);
    of.along.iter().for_each(|curve| along(curve, &of.compared));
    not_shared(of);
    universal(of);
    sensitivity(of);
    reach(of);
    heading("What these figures do not say");
    comparison_limits(of).iter().for_each(|limit| wrapped(limit));
}

fn rates(of: &Comparison) {
    heading("Success rates");
    for d in &of.dictionaries {
        let rate = &d.success.rate;
        line(format_args!(
            "  {} {:>7} {} {} {:>8}  {}",
            fit(&d.name, 22),
            rate_of(rate.rate),
            bar(rate.rate.unwrap_or(0.0), 20),
            interval(rate.wilson_95),
            grouped(rate.n),
            dim(if d.left_out.is_some() { "not compared" } else { d.population.brief() })
        ));
        if let Some(because) = &d.left_out {
            wrapped(&format!("{}: {because}.", d.name));
        }
        if let Some(found) = d.success.reweighted.as_ref().and_then(Finding::estimated) {
            line(dim(format_args!(
                "  {:<22} {:>7} {:>20} {} {:>8}  all rows, by weight",
                "",
                percent(found.estimate.rate),
                "",
                interval(found.estimate.interval_95),
                grouped(found.rows)
            )));
        }
        let bounds = &d.success.bounds;
        if let (1.., Some(worst), Some(best)) = (bounds.invalid, bounds.worst_case, bounds.best_case) {
            let n = grouped(bounds.invalid);
            line(format_args!("  {:<22} {n} invalid: {} to {} at most", "", percent(worst), percent(best)));
        }
    }
}

fn differences(of: &Comparison) {
    if of.differences.is_empty() {
        return;
    }
    heading("Differences in points (Newcombe 95 %, Holm over all pairs)");
    for d in &of.differences {
        let text = format!(
            "  {} {:>7}  {}  {:<9}  p by Holm {:>8}  {}",
            fit(&format!("{} - {}", d.first, d.second), 30),
            points(d.difference),
            points_interval(d.interval_95),
            d.z.map_or_else(|| d.test().to_owned(), |z| format!("z {z:>7.2}")),
            p_value(d.holm_p.max(f64::MIN_POSITIVE).ln()),
            if d.holm_p <= 0.05 { "sure" } else { "not sure" }
        );
        if d.holm_p <= 0.05 { line(text) } else { line(dim(text)) }
    }
    if of.differences.iter().any(|d| d.valid_pairs.is_some()) {
        wrapped("McNemar: the same scenarios, paired (exact test, paired interval). z: independent runs.");
    }
}

fn paired(pair: &PairedComparison) {
    heading(format_args!("{} against {}, scenario by scenario", pair.first, pair.second));
    line(format_args!(
        "  {} of {} scenarios have evidence from both",
        grouped(pair.valid_pairs),
        grouped(pair.scenarios)
    ));
    for (name, rate) in [(&pair.first, &pair.first_rate), (&pair.second, &pair.second_rate)] {
        line(format_args!(
            "  {} {:>7} {} {}",
            fit(name, 22),
            rate_of(rate.rate),
            bar(rate.rate.unwrap_or(0.0), 20),
            interval(rate.wilson_95)
        ));
    }
    if let Some(gap) = pair.gap {
        line(format_args!(
            "  {} {:>7}  {} points, McNemar exact p {}, by Holm {}",
            fit("gap", 22),
            points(gap),
            points_interval(pair.gap_95),
            p_value(pair.ln_p),
            p_value(pair.holm_p.max(f64::MIN_POSITIVE).ln())
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
        let bounds = pair.invalid.gap_bounds.map_or_else(|| "-".to_owned(), points_interval);
        wrapped(&format!(
            "{} invalid in {}, {} in {}: in no rate; the gap over all scenarios lies within {} points whatever they were.",
            grouped(pair.invalid.first),
            pair.first,
            grouped(pair.invalid.second),
            pair.second,
            bounds.split_whitespace().collect::<Vec<_>>().join(" ")
        ));
    }
    line("");
    line(format_args!("  how they ended: {} down, {} across", pair.first, pair.second));
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
            wrapped(&format!("No map of disagreement: {because}."));
            return;
        }
    };
    line("");
    line(format_args!("  scenarios that flip, in percent: {} upwards, {} across", map.y.parameter, map.x.parameter));
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
                    _ if cell.disagree.successes == 0 => ' ',
                    std::cmp::Ordering::Greater => 'a',
                    std::cmp::Ordering::Less => 'b',
                    std::cmp::Ordering::Equal => '=',
                };
                let mark = if cell.holm_p <= 0.05 { mark.to_ascii_uppercase() } else { mark };
                cell.disagree.rate.map_or_else(|| format!("{:>6} ", "-"), |rate| format!("{:>6.0}{mark}", 100.0 * rate))
            })
            .collect();
        line(format_args!("  {:>11} {cells}", from(&map.y, row)));
    }
    let across: String =
        (0..nx).map(|i| format!("{:>7}", from(&map.x, i).chars().take(6).collect::<String>())).collect();
    line(dim(format_args!("  {:>11} {across}", "from")));
    wrapped(&format!(
        "a: {} ahead, b: {} ahead, =: neither; a capital where that is sure (McNemar, Holm over the cells)",
        pair.first, pair.second
    ));
}

fn flips(pair: &PairedComparison) {
    let all = pair.first_only + pair.second_only;
    if all == 0 {
        return;
    }
    line("");
    line(format_args!("  scenarios that flip: {} of {} (--flips lists more)", pair.flips.len(), grouped(all)));
    for flip in &pair.flips {
        line(format_args!("  {:>8}  {} -> {}", flip.index, fit(&flip.first, 11), flip.second));
        line(dim(format_args!("            {}", fit(&flip.describe(), 86).trim_end())));
    }
    if let Some(flip) = pair.flips.iter().find(|flip| !flip.replay.is_empty()) {
        line("  see one again, as in");
        flip.replay.iter().for_each(|command| line(format_args!("    {command}")));
    }
}

fn modes(of: &Comparison) {
    heading("Failure modes, share of failures (95 % for all modes together)");
    for d in &of.dictionaries {
        line(format_args!("  {} {} failures", fit(&d.name, 22), grouped(d.failure_modes.failures)));
        for mode in d.failure_modes.modes.iter().filter(|mode| mode.failures > 0) {
            line(format_args!(
                "    {:<20} {:>7} {} {} {:>9}",
                mode.mode,
                rate_of(mode.share),
                bar(mode.share.unwrap_or(0.0), 20),
                interval(mode.interval_95),
                grouped(mode.failures)
            ));
        }
    }
}

/// Dictionaries whose rates stand in one line at most.
const MOST_ACROSS: usize = 3;

fn along(curve: &SharedCurve, names: &[String]) {
    heading(format_args!("Success along {}", curve.parameter));
    for (block, names) in names.chunks(MOST_ACROSS).enumerate() {
        let heads: String = names.iter().map(|name| format!("  {}", fit(name, 25))).collect();
        line(dim(format_args!("  {:<18}{}", "", heads.trim_end())));
        for cell in curve.cells.iter().take(40) {
            let label = match cell.range {
                Some([low, high]) => format!("{low:>7.3} to {high:>7.3}"),
                None => fit(&cell.label, 18),
            };
            let rates = &cell.rates[block * MOST_ACROSS..][..names.len()];
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
        wrapped(&format!("{}: {} (of {})", parameter.parameter, parameter.because, parameter.of.join(", ")));
    }
}

fn universal(of: &Comparison) {
    let zones = &of.universal_zones;
    heading(format_args!(
        "Where all of them are below {:.0} % (Holm over {} cells; {} too thin to say)",
        100.0 * zones.limit,
        grouped(zones.looked_at),
        grouped(zones.too_thin)
    ));
    for zone in zones.zones.iter().take(16) {
        let rates: Vec<String> = zone.rates.iter().map(|rate| rate_of(rate.rate)).collect();
        let text = format!(
            "  {} {}  p by Holm {:>8}  {}",
            fit(&zone.describe(), 42),
            fit(&rates.join(" / "), 24),
            p_value(zone.holm_p.max(f64::MIN_POSITIVE).ln()),
            if zone.sure { "sure" } else { "not sure" }
        );
        if zone.sure { line(text) } else { line(dim(text)) }
    }
    match zones.zones.len() {
        0 if zones.looked_at == 0 => line("  cannot be said: no cell holds enough episodes of each"),
        0 => line("  none observed"),
        n if n > 16 => line(dim(format_args!("  and {} more (--json)", n - 16))),
        _ => {}
    }
}

fn sensitivity(of: &Comparison) {
    let found = match &of.sensitivity {
        Finding::Estimated(found) => found,
        Finding::CannotBeEstimated { because } => {
            heading("What one parameter does");
            wrapped(&format!("It cannot be compared because {because}."));
            return;
        }
    };
    let label = parameter_label(&found.parameter);
    heading(format_args!("What {label} does: slope of the log-odds of success over ln({label})"));
    for effect in &found.effects {
        match &effect.slope {
            Finding::Estimated(slope) => {
                let end = |end: Option<f64>| end.map_or_else(|| "open".to_owned(), |end| format!("{end:.2}"));
                line(format_args!(
                    "  {} {:>7.3}  95 % {:>6} to {:>6}  odds x {:.3} where {label} doubles  p {:>8}{}",
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
                rate_of(rate.rate),
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
            rate_of(row.rate.rate),
            interval(row.rate.wilson_95),
            if row.given { " *" } else { "" }
        ));
    }
    if of.reach.iter().any(|row| row.given) {
        line(dim("  * as given on the command line"));
    }
    if of.reach.iter().any(|row| row.ratio.is_none()) {
        line(dim("  --reach NAME=METRES and --workspace METRES say what is unknown"));
    }
}
