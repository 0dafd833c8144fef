//! Claims about the population and the operating ranges.

use robogate_gate::Population;
use robogate_gate::evidence::{Covered, Judged, Role};
use robogate_stats::format::counted;

use super::{Answered, Claim, Defeater, OPERATING_DOMAIN, paths};

pub(super) fn claim(judged: &Judged<'_>) -> Claim {
    let parts = vec![sampled(judged), independent(judged), ranges(judged)];
    let text = format!("The figures apply to the population: {}.", judged.evaluation.population);
    let strategy = "Argue over the choice of the episodes, over their independence and over each operating range.";
    Claim::of_parts("population", text, strategy, parts, Vec::new())
}

/// The episodes are a sample of the population.
fn sampled(judged: &Judged<'_>) -> Claim {
    let evaluation = judged.evaluation;
    let files = paths(judged, &[Role::Dictionary, Role::Plan, Role::Suite]);
    let mut defeaters = Vec::new();
    if let Population::Imported { sampling, .. } = &evaluation.population {
        let because = match sampling {
            Some(_) => "Their author stated at the import how they were chosen.",
            None => "The file does not record how they were chosen. State it with `robogate import --sampling`.",
        };
        defeaters.push(Defeater::new(
            "chosen-episodes",
            "The imported episodes were chosen by their results, or are not like those of operation.",
            if sampling.is_some() { Answered::Yes } else { Answered::Open },
            because,
            paths(judged, &[Role::Dictionary]),
        ));
    }
    if evaluation.counts.focused > 0 {
        defeaters.push(Defeater::new(
            "chosen-points",
            format!(
                "{} were placed near failures and are not a sample.",
                counted(evaluation.counts.focused, "episode")
            ),
            Answered::Yes,
            "They are not judged.",
            paths(judged, &[Role::Evaluation]),
        ));
    }
    let text = "The judged episodes are a sample of this population.";
    Claim::on("sample", text, evaluation.estimand.clone(), files, defeaters)
}

/// The episodes are independent evidence, or their dependence is accounted for.
fn independent(judged: &Judged<'_>) -> Claim {
    let evaluation = judged.evaluation;
    let groups = evaluation.population.groups();
    let imported = judged.provenance().source.is_some();
    let files = paths(judged, &[Role::Dictionary, Role::Evaluation, Role::Repeats]);
    let repeats = evaluation.controls.as_ref().and_then(|controls| controls.repeats);
    let (state, because) = match (imported, repeats) {
        (true, _) if !groups.is_empty() => {
            (Answered::Yes, format!("Each group counts as one observation. {}", evaluation.estimand))
        }
        (true, _) => (
            Answered::Open,
            "No column of the file names an operator, a day or a session, and the rows are counted as independent."
                .to_owned(),
        ),
        (false, Some(repeats)) => match repeats.line() {
            Some(line) => (Answered::Open, format!("{line}.")),
            None => (Answered::Yes, "Episodes that ran twice, in another order, are the same.".to_owned()),
        },
        (false, None) if judged.environment_is_foreign() => {
            (Answered::Open, "No episode ran twice in another order.".to_owned())
        }
        (false, None) => (
            Answered::Yes,
            "Each episode has its own seed and starts from a reset of the built-in environment.".to_owned(),
        ),
    };
    let shared = Defeater::new(
        "dependence",
        "Episodes share something that moves their outcome, so there is less evidence than episodes.",
        state,
        because.clone(),
        files.clone(),
    );
    Claim::on(
        "independence",
        "The episodes are independent, or count as groups that are.",
        because,
        files,
        vec![shared],
    )
}

/// The valid episodes cover the operating ranges.
fn ranges(judged: &Judged<'_>) -> Claim {
    let text = "The valid episodes cover the operating ranges.";
    let Ok(covered) = judged.coverage() else {
        return Claim::on("ranges", text, "The rows cannot be read.", Vec::new(), Vec::new());
    };
    if covered.is_empty() {
        let because = "The task declares no parameter: nothing was varied but the seed.";
        return Claim::on("ranges", text, because, paths(judged, &[Role::Dictionary]), Vec::new());
    }
    let files = || {
        let mut files = paths(judged, &[Role::Dictionary]);
        files.push(OPERATING_DOMAIN.to_owned());
        files
    };
    let part = |(at, of): (usize, &Covered)| {
        let name = format!("range-{}", at + 1);
        let text = format!("{}: {}.", of.parameter, of.range);
        match &of.missing {
            None => Claim::on(name, text, "Valid episodes cover it.", files(), Vec::new()),
            Some(missing) => Claim::on(name, text, format!("Not covered: {missing}."), Vec::new(), Vec::new()),
        }
    };
    let parts = covered.iter().enumerate().map(part).collect();
    Claim::of_parts("ranges", text, "Argue over each parameter.", parts, Vec::new())
}
