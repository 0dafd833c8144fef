//! The document of a requalification: what an upgrade changes.

use maud::html;
use robogate_gate::{Answer, Requalification};
use robogate_stats::format::{count, counted, percent, points, points_range, significant};

use super::Kind::{Number, Short, Text};
use super::{Block, Document, Section, Table, or_dash, plain_p};

/// A requalification with the words that describe it.
#[derive(Debug, Clone, Copy)]
pub struct RequalificationPage<'a> {
    /// What was upgraded, in which task.
    pub title: &'a str,
    /// The engines on both sides, and how many episodes repeat the run.
    pub subtitle: &'a str,
    /// Packages whose versions differ, with both versions.
    pub packages: &'a [[String; 3]],
    /// Other versions between the two sides, each with its answer.
    pub versions: &'a [[String; 2]],
    /// The result.
    pub result: &'a Requalification,
}

/// The words of an answer.
pub fn answer_label(answer: Answer) -> &'static str {
    match answer {
        Answer::MeaningChanged => "success is equal, its meaning changed",
        Answer::StartsChanged => "initial states changed",
        Answer::SuccessChanged => "success changed",
        Answer::CannotRun => "cannot run",
        Answer::NotPaired => "pairing not valid",
        Answer::SolverWorse => "solver does worse",
        Answer::NoRelevantChange => "no relevant change",
        Answer::Inconclusive => "inconclusive",
    }
}

pub(crate) fn requalification_document(of: &RequalificationPage<'_>) -> Document {
    let result = of.result;
    let [ran, planned] = result.pairs;
    let mut tested = vec![format!("{} of {planned} planned pairs ran", count(ran))];
    if result.identical > 0 {
        tested.push(format!("{} of them are equal bit for bit", count(result.identical)));
    }
    if result.distinct < ran {
        tested.push(format!("{} do not repeat an earlier one; only these count", counted(result.distinct, "pair")));
    }
    tested.push(format!(
        "{} properties were tested after each round. The probability of any false claim among them is at most 5 %",
        count(result.properties_tested)
    ));
    let found = result.changes.iter().map(|change| change.sentence.clone()).collect::<Vec<_>>();
    Document {
        kind: "requalification",
        title: of.title.to_owned(),
        subtitle: of.subtitle.to_owned(),
        figure: if result.success.pairs > 0 {
            format!("{} points", points(result.success.difference))
        } else {
            "-".to_owned()
        },
        figure_label: "change of the success rate".to_owned(),
        interval: format!("95 % interval {} points", points_range(result.success.interval_95)),
        scale: html! {},
        answer: result.headline.clone(),
        columns: [("What changed", found), ("How it was tested", tested)]
            .into_iter()
            .filter(|(_, lines)| !lines.is_empty())
            .collect(),
        sections: [Some(changes(result)), Some(properties(result)), starts(result), differences(result), versions(of)]
            .into_iter()
            .flatten()
            .collect(),
        verdict: None,
    }
}

fn section(id: &'static str, title: &str, blocks: Vec<Block>) -> Section {
    Section { id, title: title.to_owned(), population: None, blocks }
}

fn changes(of: &Requalification) -> Section {
    let success = &of.success;
    let rate = |n: u64| if success.pairs > 0 { percent(n as f64 / success.pairs as f64) } else { "-".to_owned() };
    let mut blocks = vec![Block::Facts(vec![
        ("success before".to_owned(), rate(success.successes[0])),
        ("success after".to_owned(), rate(success.successes[1])),
        ("only before".to_owned(), counted(success.only[0], "pair")),
        ("only after".to_owned(), counted(success.only[1], "pair")),
    ])];
    for change in &of.changes {
        blocks.push(Block::Heading(change.sentence.clone()));
        blocks.push(Block::List(change.details.clone()));
    }
    section("rates", "Answer", blocks)
}

fn properties(of: &Requalification) -> Section {
    let row = |of: &robogate_gate::PropertyChange| {
        let [before, after] = of.mean.map(|x| significant(x, 3));
        let adjusted = plain_p(of.p_adjusted);
        let changed = super::yes_no(of.changed);
        vec![of.name.clone(), before, after, count(of.less), count(of.more), count(of.pairs), adjusted, changed]
    };
    let heads = [
        ("property", Text),
        ("mean before", Number),
        ("mean after", Number),
        ("pairs with less", Number),
        ("with more", Number),
        ("of", Number),
        ("p, for all", Number),
        ("certain", Short),
    ];
    let table = Table::new("Properties that differ in some pair", &heads, of.properties.iter().map(row).collect());
    let about = format!(
        "A change is certain if as many pairs with less as with more of a property are excluded for all properties and rounds together, \
         and relevant if the net share of pairs is at least 10 %. Net changes of up to {} of the episodes remain possible for any other \
         property.",
        percent(of.bound)
    );
    section("paired", "Properties", vec![Block::Table(table), Block::Text(about)])
}

fn starts(of: &Requalification) -> Option<Section> {
    let starts = &of.starts;
    if starts.pairs == 0 {
        return None;
    }
    let facts = vec![
        ("starts that differ".to_owned(), format!("{} of {}", count(starts.different), count(starts.pairs))),
        ("effectively different, before".to_owned(), significant(starts.effective[0], 3)),
        ("effectively different, after".to_owned(), significant(starts.effective[1], 3)),
        ("nearest to their own pair".to_owned(), or_dash(starts.recognized, percent)),
    ];
    Some(section("starts", "Initial states", vec![Block::Facts(facts), Block::List(starts.differences.clone())]))
}

fn differences(of: &Requalification) -> Option<Section> {
    let explanation = &of.explanation;
    let step = |at: Option<usize>| or_dash(at, |at| at.to_string());
    let rows = explanation.divergence.iter().map(|of| {
        let [before, after] = of.endings.clone();
        vec![
            of.index.to_string(),
            step(of.first),
            step(of.visible),
            or_dash(of.body.clone(), |body| body),
            before,
            after,
        ]
    });
    let heads = [
        ("episode", Number),
        ("first difference", Number),
        ("first above 1 mm", Number),
        ("of", Text),
        ("ending before", Short),
        ("after", Short),
    ];
    let divergence = Table::new("Control periods until the motion differs", &heads, rows.collect());
    let signals = explanation.signals.iter().map(|of| {
        let numbers = [of.mean[0], of.mean[1], of.largest[0], of.largest[1]].map(|x| significant(x, 3));
        std::iter::once(of.name.replace('_', " ")).chain(numbers).collect()
    });
    let heads =
        [("signal", Text), ("mean before", Number), ("after", Number), ("largest before", Number), ("after", Number)];
    let signals = Table::new("Contacts, solver and energy", &heads, signals.collect());
    let blocks = vec![
        Block::Text("These figures describe the episodes that ran. They are not claims.".to_owned()),
        Block::Table(divergence),
        Block::Table(signals),
    ];
    (!explanation.divergence.is_empty()).then(|| section("paired-motion", "Where episodes differ", blocks))
}

fn versions(of: &RequalificationPage<'_>) -> Option<Section> {
    let rows = of.packages.iter().map(|row| row.to_vec()).collect();
    let packages =
        Table::new("Packages with another version", &[("package", Text), ("before", Short), ("after", Short)], rows);
    let rows = of.versions.iter().map(|row| row.to_vec()).collect();
    let between = Table::new("Versions in between", &[("version", Short), ("answer", Text)], rows);
    let blocks: Vec<Block> =
        [packages, between].into_iter().filter(|table| !table.rows.is_empty()).map(Block::Table).collect();
    (!blocks.is_empty()).then(|| section("rates-versions", "Versions", blocks))
}
