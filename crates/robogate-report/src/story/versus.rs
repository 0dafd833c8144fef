//! A comparison as a page.

use super::Kind::{Code, Number, Short, Text};
use super::{Block, Figure, Section, Story, Table};
use crate::page::versus::{self, Row};
use crate::text::{ComparisonHeadline, comparison_limits};
use robogate_analysis::Finding;
use robogate_analysis::labels::{label_with_unit, mode_label, parameter_label, value_with_unit};
use robogate_analysis::{Comparison, PairedComparison};
use robogate_stats::format::{
    count, counted, fixed, list, number, p_value, percent, percent_or_dash, percent_range, points, points_range, range,
    sentence,
};

/// Zones that are drawn; the table has more.
const MOST_ZONES: usize = 14;
/// Rows of one table.
const MOST: usize = 60;

/// Tells a comparison.
pub(crate) fn tell(of: &Comparison) -> Story {
    let headline = ComparisonHeadline::of(of);
    let names: Vec<String> = of.dictionaries.iter().map(|d| d.name.clone()).collect();
    let widest = of
        .paired
        .iter()
        .filter_map(|pair| Some((pair.gap?, pair.gap_95, &pair.first, &pair.second)))
        .chain(of.differences.iter().map(|d| (d.difference, d.interval_95, &d.first, &d.second)))
        .reduce(|best, next| if next.0.abs() > best.0.abs() { next } else { best });
    let mut sections = vec![rates(of)];
    sections.extend(of.paired.iter().enumerate().map(|(i, pair)| paired(pair, i)));
    sections.extend([failures(of), along(of), universal(of), sensitivity(of), reach(of), sources(of), limits(of)]);
    Story {
        kind: "comparison",
        title: match names.as_slice() {
            [first, second] => format!("{first} against {second}"),
            names => list(names),
        },
        subtitle: format!(
            "{} dictionaries, {} episodes \u{b7} compared {}",
            of.dictionaries.len(),
            count(of.dictionaries.iter().map(|d| d.subject.episodes).sum()),
            if of.paired.is_empty() { "as independent runs" } else { "scenario by scenario" }
        ),
        rate: widest
            .map_or_else(|| "\u{2013}".to_owned(), |(gap, ..)| format!("{} points", fixed(100.0 * gap.abs(), 1))),
        rate_of: match widest {
            Some((gap, _, first, second)) => {
                let (ahead, behind) = if gap >= 0.0 { (first, second) } else { (second, first) };
                let most = if of.dictionaries.len() > 2 { "widest gap: " } else { "" };
                format!("{most}{ahead} ahead of {behind}")
            }
            None => "nothing to compare".to_owned(),
        },
        interval: match widest {
            Some((gap, [low, high], ..)) => {
                let ends = if gap >= 0.0 { [low, high] } else { [-high, -low] };
                format!("95 % interval {}", versus::gap(ends))
            }
            None => "no interval".to_owned(),
        },
        scale: versus::rates(&of.dictionaries, &of.compared),
        answer: headline.answer,
        columns: vec![
            ("What differs", headline.what_differs),
            ("What they share", headline.what_is_common),
            ("How sure", headline.how_sure),
        ],
        sections,
    }
}

fn rates(of: &Comparison) -> Section {
    let rows = of.dictionaries.iter().map(|d| {
        let weighted = d.success.reweighted.as_ref().and_then(Finding::estimated);
        vec![
            d.name.clone(),
            count(d.success.rate.n),
            count(d.success.rate.successes),
            percent_or_dash(d.success.rate.rate),
            percent_range(d.success.rate.wilson_95),
            percent_range(d.success.rate.clopper_pearson_95),
            weighted.map_or_else(
                || "-".to_owned(),
                |w| format!("{} ({})", percent(w.estimate.rate), percent_range(w.estimate.interval_95)),
            ),
            count(d.success.bounds.invalid),
            match &d.left_out {
                Some(because) => format!("not compared: {because}"),
                None => d.population.brief().to_owned(),
            },
        ]
    });
    let columns = [
        ("dictionary", Text),
        ("n", Number),
        ("succeeded", Number),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("exact 95 %", Number),
        ("all rows, by weight", Number),
        ("invalid", Number),
        ("speaks of", Text),
    ];
    let mut blocks = vec![Block::Table(Table::new("", &columns, rows.collect()).without_empty())];
    if !of.differences.is_empty() {
        let drawn: Vec<Row> = of
            .differences
            .iter()
            .map(|d| Row {
                label: format!("{} \u{2212} {}", d.first, d.second),
                estimate: 100.0 * d.difference,
                interval: d.interval_95.map(|end| 100.0 * end),
                sure: d.holm_p <= 0.05,
                series: None,
            })
            .collect();
        let rows = of.differences.iter().map(|d| {
            vec![
                d.first.clone(),
                d.second.clone(),
                points(d.difference),
                points_range(d.interval_95),
                d.z.map_or_else(|| d.test().to_owned(), |z| format!("z {}", fixed(z, 2))),
                d.ln_p.map_or_else(|| "-".to_owned(), p_value),
                p_value(d.holm_p.max(f64::MIN_POSITIVE).ln()),
            ]
        });
        let columns = [
            ("first", Text),
            ("second", Text),
            ("points", Number),
            ("95 % (Newcombe)", Number),
            ("test", Short),
            ("p", Number),
            ("p by Holm", Number),
        ];
        blocks.push(Block::Figure(Figure {
            title: "Differences of success rates".to_owned(),
            svg: versus::forest(
                &drawn,
                "",
                ["\u{2190} second ahead", "first ahead \u{2192}"],
                "Differences of success rates in percentage points",
            ),
            is_map: false,
            caption:
                "Percentage points with Newcombe's interval. A filled dot is a difference that holds over all pairs \
                      (Holm). Dictionaries that ran the same scenarios are paired (McNemar's exact test, Newcombe's \
                      paired interval); the others are independent runs (z-test)."
                    .to_owned(),
            reading: Vec::new(),
            table: Table::new("The differences", &columns, rows.collect()).at_most(MOST),
        }));
    }
    Section { id: "rates", title: "Success rates".to_owned(), population: speaks(of), blocks }
}

fn speaks(of: &Comparison) -> Option<String> {
    let compared = of.dictionaries.iter().filter(|d| d.left_out.is_none());
    let mut said: Vec<&str> = Vec::new();
    for dictionary in compared {
        let text = dictionary.population.describe();
        if !said.contains(&text) {
            said.push(text);
        }
    }
    (!said.is_empty()).then(|| format!("Speaks of {}.", said.join("; and of ")))
}

const PAIR_IDS: [&str; 6] = ["paired", "paired-2", "paired-3", "paired-4", "paired-5", "paired-6"];

fn paired(pair: &PairedComparison, at: usize) -> Section {
    let mut blocks = Vec::new();
    blocks.push(Block::Text(format!(
        "{} succeeds in {} ({}), {} in {} ({}). Both solve {}, only {} {}, only {} {}, neither {}.",
        pair.first,
        percent_or_dash(pair.first_rate.rate),
        percent_range(pair.first_rate.wilson_95),
        pair.second,
        percent_or_dash(pair.second_rate.rate),
        percent_range(pair.second_rate.wilson_95),
        count(pair.both),
        pair.first,
        count(pair.first_only),
        pair.second,
        count(pair.second_only),
        count(pair.neither)
    )));
    let mut facts = vec![
        (
            "Gap".to_owned(),
            pair.gap.map_or_else(
                || "-".to_owned(),
                |gap| format!("{} points ({})", points(gap), points_range(pair.gap_95)),
            ),
        ),
        (
            "McNemar, exact".to_owned(),
            format!(
                "p = {}; by Holm over all pairs {}",
                p_value(pair.ln_p),
                p_value(pair.holm_p.max(f64::MIN_POSITIVE).ln())
            ),
        ),
        (
            "Scenarios".to_owned(),
            format!("{}, {} with evidence from both", count(pair.scenarios), count(pair.valid_pairs)),
        ),
    ];
    if pair.invalid.either > 0 {
        let bounds = pair.invalid.gap_bounds.map_or_else(|| "-".to_owned(), points_range);
        facts.push((
            "Invalid".to_owned(),
            format!(
                "{} in {}, {} in {}: in no rate. Whatever they had been, the gap over all scenarios would lie within {bounds} points.",
                count(pair.invalid.first),
                pair.first,
                count(pair.invalid.second),
                pair.second
            ),
        ));
    }
    blocks.push(Block::Facts(facts));
    match &pair.disagreement {
        Finding::Estimated(map) => {
            let nx = map.x.cells().max(1);
            let rows = map.cells.iter().enumerate().map(|(i, cell)| {
                vec![
                    map.y.cell_label(i / nx),
                    map.x.cell_label(i % nx),
                    count(cell.disagree.n),
                    percent_or_dash(cell.disagree.rate),
                    percent_range(cell.disagree.wilson_95),
                    count(cell.first_only),
                    count(cell.second_only),
                    p_value(cell.holm_p.max(f64::MIN_POSITIVE).ln()),
                ]
            });
            let (y, x) = (parameter_label(&map.y.parameter), parameter_label(&map.x.parameter));
            let heads = [format!("only {}", pair.first), format!("only {}", pair.second)];
            let columns = [
                (y.as_str(), Short),
                (x.as_str(), Short),
                ("n", Number),
                ("differ", Number),
                ("Wilson 95 %", Number),
                (heads[0].as_str(), Number),
                (heads[1].as_str(), Number),
                ("p by Holm", Number),
            ];
            blocks.push(Block::Figure(Figure {
                title: format!(
                    "Where they end differently: {} \u{d7} {}",
                    parameter_label(&map.y.parameter),
                    parameter_label(&map.x.parameter)
                ),
                svg: versus::disagreement(map, [&pair.first, &pair.second]),
                is_map: true,
                caption:
                    "Scenarios that end differently, in percent, and below it how many were run. The colour says who \
                          is ahead."
                        .to_owned(),
                reading: Vec::new(),
                table: Table::new("The cells", &columns, rows.collect()).at_most(100),
            }));
        }
        Finding::CannotBeEstimated { because } => {
            blocks.push(Block::Text(format!("No map can be drawn because {because}.")));
        }
    }
    let mut columns = vec![("", Short)];
    let words: Vec<String> = pair.outcomes.outcomes.iter().map(|word| mode_label(word)).collect();
    columns.extend(words.iter().map(|word| (word.as_str(), Number)));
    let rows = words
        .iter()
        .zip(&pair.outcomes.counts)
        .map(|(word, counts)| std::iter::once(word.clone()).chain(counts.iter().map(|n| count(*n))).collect());
    let title = format!("How they ended: {} down, {} across", pair.first, pair.second);
    blocks.push(Block::Table(Table::new(title, &columns, rows.collect())));
    if !pair.flips.is_empty() {
        let rows = pair.flips.iter().map(|flip| {
            vec![
                count(flip.index),
                mode_label(&flip.first),
                mode_label(&flip.second),
                if flip.replay.is_empty() { "-".to_owned() } else { flip.replay.join(" ; ") },
                flip.describe(),
            ]
        });
        let columns = [
            ("index", Number),
            (pair.first.as_str(), Short),
            (pair.second.as_str(), Short),
            ("replay", Code),
            ("parameters", Text),
        ];
        let mut table = Table::new("Scenarios that flip", &columns, rows.collect()).without_empty();
        let all = pair.first_only + pair.second_only;
        if all > pair.flips.len() as u64 {
            table.remark = Some(format!("{} of {}; --flips lists more.", pair.flips.len(), count(all)));
        }
        blocks.push(Block::Folded(table));
    }
    Section {
        id: PAIR_IDS.get(at).copied().unwrap_or("paired-more"),
        title: format!("{} against {}, scenario by scenario", pair.first, pair.second),
        population: Some("Speaks of the scenarios that both ran, invalid ones left out.".to_owned()),
        blocks,
    }
}

fn failures(of: &Comparison) -> Section {
    let mut blocks = Vec::new();
    let failed: Vec<&robogate_analysis::ComparedDictionary> =
        of.dictionaries.iter().filter(|d| d.failure_modes.failures > 0).collect();
    if failed.is_empty() {
        blocks.push(Block::Text("Nothing failed.".to_owned()));
    } else {
        let rows = failed.iter().flat_map(|d| {
            d.failure_modes.modes.iter().map(|m| {
                vec![
                    d.name.clone(),
                    mode_label(&m.mode),
                    count(m.failures),
                    percent_or_dash(m.share),
                    percent_range(m.interval_95),
                    if d.left_out.is_some() { d.population.brief().to_owned() } else { "-".to_owned() },
                ]
            })
        });
        let columns = [
            ("dictionary", Text),
            ("failure", Short),
            ("episodes", Number),
            ("share of failures", Number),
            ("95 %, all modes together", Number),
            ("note", Text),
        ];
        blocks.push(Block::Figure(Figure {
            title: "Failure modes".to_owned(),
            svg: versus::modes(&failed),
            is_map: false,
            caption: "Share of each mode among the failures.".to_owned(),
            reading: failed
                .iter()
                .map(|d| match &d.failure_modes.dominant {
                    Finding::Estimated(word) => format!("{} fails mostly by {}.", d.name, mode_label(word)),
                    Finding::CannotBeEstimated { because } => {
                        format!("{}: which mode leads cannot be said because {because}.", d.name)
                    }
                })
                .collect(),
            table: Table::new("The modes", &columns, rows.collect()).without_empty().at_most(MOST),
        }));
    }
    Section { id: "failures", title: "How they fail".to_owned(), population: speaks(of), blocks }
}

fn along(of: &Comparison) -> Section {
    let mut blocks = Vec::new();
    if of.along.is_empty() {
        blocks.push(Block::Text("No curve can be drawn: they have no parameter in common.".to_owned()));
    } else {
        let figures = of.along.iter().map(|curve| {
            let rows = curve.cells.iter().map(|cell| {
                let rates = cell
                    .rates
                    .iter()
                    .flat_map(|rate| [percent_or_dash(rate.rate), percent_range(rate.wilson_95), count(rate.n)]);
                std::iter::once(cell.label.clone()).chain(rates).collect()
            });
            let heads: Vec<[String; 3]> =
                of.compared.iter().map(|name| [name.clone(), "95 %".to_owned(), "n".to_owned()]).collect();
            let label = label_with_unit(&curve.parameter);
            let mut columns = vec![(label.as_str(), Short)];
            columns.extend(heads.iter().flatten().map(|head| (head.as_str(), Number)));
            Figure {
                title: sentence(&curve.label),
                svg: versus::curve(curve, &of.compared),
                is_map: false,
                caption: curve.remark.clone().unwrap_or_default(),
                reading: Vec::new(),
                table: Table::new(format!("Success along {}", curve.label), &columns, rows.collect()).at_most(MOST),
            }
        });
        blocks.push(Block::Grid(figures.collect()));
    }
    if !of.parameters.not_shared.is_empty() {
        let rows = of.parameters.not_shared.iter().map(|parameter| {
            let of = if parameter.of.is_empty() { "-".to_owned() } else { parameter.of.join(", ") };
            vec![label_with_unit(&parameter.parameter), of, parameter.because.clone()]
        });
        let columns = [("parameter", Text), ("of", Text), ("why it is left out", Text)];
        blocks.push(Block::Table(Table::new("Not shared", &columns, rows.collect()).at_most(MOST)));
    }
    Section { id: "along", title: "Along what they share".to_owned(), population: speaks(of), blocks }
}

fn universal(of: &Comparison) -> Section {
    let zones = &of.universal_zones;
    let limit = format!("{:.0} %", 100.0 * zones.limit);
    let thin = match zones.too_thin {
        0 => String::new(),
        n => format!(
            " {} with fewer than {} episodes of some dictionary: too thin to say.",
            counted(n, "cell"),
            zones.smallest_n
        ),
    };
    let mut blocks = vec![Block::Text(format!(
        "Cells in which every dictionary is below {limit} success: bins and levels of each shared parameter{}. A cell is \
         sure where each of them is shown to be below (intersection-union of exact tests), Holm over the {} looked at.{thin}",
        zones.pair.as_ref().map_or_else(String::new, |[up, across]| {
            format!(", and cells of {} with {}", parameter_label(up), parameter_label(across))
        }),
        count(zones.looked_at)
    ))];
    if zones.looked_at == 0 {
        blocks.push(Block::Text("Nothing can be said: no cell holds enough episodes of each.".to_owned()));
    } else if zones.zones.is_empty() {
        blocks.push(Block::Text(format!("In no cell was every one of them observed below {limit}.")));
    } else {
        let rows = zones.zones.iter().map(|zone| {
            let rates =
                zone.rates.iter().map(|r| format!("{} ({})", percent_or_dash(r.rate), percent_range(r.wilson_95)));
            std::iter::once(zone.describe())
                .chain(rates)
                .chain([p_value(zone.p.max(f64::MIN_POSITIVE).ln()), p_value(zone.holm_p.max(f64::MIN_POSITIVE).ln())])
                .chain([if zone.sure { "sure" } else { "not sure" }.to_owned()])
                .collect()
        });
        let mut columns = vec![("cell", Short)];
        columns.extend(of.compared.iter().map(|name| (name.as_str(), Number)));
        columns.extend([("p", Number), ("p by Holm", Number), ("all below", Short)]);
        let sure = zones.zones.iter().filter(|zone| zone.sure).count();
        blocks.push(Block::Figure(Figure {
            title: format!("{sure} sure, {} observed", zones.zones.len()),
            svg: versus::universal(zones, &of.compared, MOST_ZONES),
            is_map: false,
            caption: format!("Success rates with 95 % intervals; the line is at {limit}. Grey names are not sure."),
            reading: Vec::new(),
            table: Table::new("The cells", &columns, rows.collect()).at_most(MOST),
        }));
    }
    Section { id: "universal", title: "Where all of them fail".to_owned(), population: speaks(of), blocks }
}

fn sensitivity(of: &Comparison) -> Section {
    let mut blocks = Vec::new();
    let title = match of.sensitivity.estimated() {
        Some(found) => format!("What {} does", parameter_label(&found.parameter)),
        None => "What one parameter does".to_owned(),
    };
    match &of.sensitivity {
        Finding::Estimated(found) => {
            let label = parameter_label(&found.parameter);
            let values = |both: [f64; 2]| value_with_unit(&range(both), &found.parameter);
            let rows = found.effects.iter().map(|effect| {
                let slope = effect.slope.estimated();
                let end = |end: Option<f64>| end.map_or_else(|| "open".to_owned(), |end| fixed(end, 2));
                vec![
                    effect.name.clone(),
                    slope.map_or_else(|| "-".to_owned(), |s| fixed(s.per_log_unit, 3)),
                    slope.map_or_else(
                        || "-".to_owned(),
                        |s| format!("{} to {}", end(s.interval_95[0]), end(s.interval_95[1])),
                    ),
                    slope.map_or_else(|| "-".to_owned(), |s| format!("\u{d7} {}", number(s.odds_per_doubling))),
                    slope.map_or_else(|| "-".to_owned(), |s| p_value(s.ln_p)),
                    format!("{} ({})", percent_or_dash(effect.low.rate), percent_range(effect.low.wilson_95)),
                    format!("{} ({})", percent_or_dash(effect.high.rate), percent_range(effect.high.wilson_95)),
                ]
            });
            let heads = [format!("success at {}", values(found.low)), format!("at {}", values(found.high))];
            let columns = [
                ("dictionary", Text),
                ("slope", Number),
                ("95 %", Number),
                ("odds per doubling", Number),
                ("p", Number),
                (heads[0].as_str(), Number),
                (heads[1].as_str(), Number),
            ];
            let reading = found.effects.iter().map(|effect| match &effect.slope {
                Finding::Estimated(slope) => format!(
                    "{}: twice the {label} multiplies the odds of success by {}{}.",
                    effect.name,
                    number(slope.odds_per_doubling),
                    if slope.penalised {
                        format!(" (Firth's fit: {label} alone tells success from failure)")
                    } else {
                        String::new()
                    }
                ),
                Finding::CannotBeEstimated { because } => {
                    format!("{}: cannot be estimated because {because}.", effect.name)
                }
            });
            blocks.push(Block::Figure(Figure {
                title: format!("Slope of the log-odds over ln({label}), {}", values(found.range)),
                svg: versus::sensitivity(found),
                is_map: false,
                caption: format!(
                    "Logistic regression of success on ln({label}) alone, over the values that all of them cover."
                ),
                reading: reading.collect(),
                table: Table::new(sentence(&label), &columns, rows.collect()),
            }));
        }
        Finding::CannotBeEstimated { because } => {
            blocks.push(Block::Text(format!("It cannot be compared because {because}.")));
        }
    }
    Section { id: "sensitivity", title, population: speaks(of), blocks }
}

fn reach(of: &Comparison) -> Section {
    let metres = |m: Option<f64>| m.map_or_else(|| "unknown".to_owned(), |m| format!("{} m", number(m)));
    let rows = of.reach.iter().map(|row| {
        vec![
            row.name.clone(),
            metres(row.reach_m),
            metres(row.workspace_m),
            row.ratio.map_or_else(|| "unknown".to_owned(), number),
            percent_or_dash(row.rate.rate),
            percent_range(row.rate.wilson_95),
            if row.given {
                "given by the user"
            } else if row.ratio.is_some() {
                "recorded"
            } else {
                "-"
            }
            .to_owned(),
        ]
    });
    let columns = [
        ("dictionary", Text),
        ("reach", Number),
        ("workspace at", Number),
        ("ratio", Number),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("from", Short),
    ];
    let table = Table::new("Reach", &columns, rows.collect()).without_empty();
    let mut blocks = Vec::new();
    if of.reach.iter().filter(|row| row.ratio.is_some()).count() >= 2 {
        blocks.push(Block::Figure(Figure {
            title: "Workspace over reach against success".to_owned(),
            svg: versus::reach(&of.reach, &of.compared),
            is_map: false,
            caption: "A ratio of 1 puts the workspace's centre at the end of the reach.".to_owned(),
            reading: Vec::new(),
            table,
        }));
    } else {
        blocks.push(Block::Text(
            "Reach is known of fewer than two of them. --reach NAME=METRES and --workspace METRES say what is missing."
                .to_owned(),
        ));
        if !table.rows.is_empty() {
            blocks.push(Block::Table(table));
        }
    }
    Section { id: "reach", title: "Workspace and reach".to_owned(), population: speaks(of), blocks }
}

fn sources(of: &Comparison) -> Section {
    let rows = of.dictionaries.iter().map(|d| {
        let s = &d.subject;
        let hash = s.dataset_hash.get(..12).unwrap_or(&s.dataset_hash).to_owned();
        vec![
            d.name.clone(),
            s.robot.clone(),
            s.policy.clone(),
            s.engine.clone(),
            count(s.episodes),
            hash,
            s.path.clone(),
        ]
    });
    let columns = [
        ("dictionary", Text),
        ("robot", Short),
        ("policy", Short),
        ("engine", Short),
        ("episodes", Number),
        ("dataset", Short),
        ("path", Text),
    ];
    let blocks = vec![Block::Table(Table::new("", &columns, rows.collect()).at_most(MOST))];
    Section { id: "sources", title: "What was compared".to_owned(), population: None, blocks }
}

fn limits(of: &Comparison) -> Section {
    let blocks = vec![Block::List(comparison_limits(of))];
    Section { id: "limits", title: "What these figures do not say".to_owned(), population: None, blocks }
}
