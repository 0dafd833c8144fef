//! Claims about the question, the real cell, the deployed policy and what happens in operation.

use robogate_gate::evidence::{Judged, QuestionBinding, Registered, Role, conditions};
use robogate_gate::{Metric, Status};
use robogate_stats::format::{count, number, percent, percent_range};
use serde_json::Value;

use super::{Answered, Claim, Defeater, paths};

/// The question was fixed before the results.
pub(super) fn question(judged: &Judged<'_>) -> Claim {
    let files = paths(judged, &[Role::Question, Role::Registration, Role::Requirements]);
    let (state, question) = match &judged.question {
        QuestionBinding::AsAsked => {
            (Answered::Yes, "The rows name the hash of the question that the gate was asked.".to_owned())
        }
        QuestionBinding::Reasked { changed } => {
            (Answered::Confirmed, format!("These differ from what the gate was asked: {}.", changed.join(", ")))
        }
        QuestionBinding::Afterwards => (Answered::Open, "The rows name no question.".to_owned()),
    };
    let chosen = "The requirements were chosen after the results were known.";
    let selected = match &judged.registration {
        Some(Registered { number: 1, .. }) => {
            (Answered::Yes, "The run is the first registration of its key, made before its first episode.".to_owned())
        }
        Some(Registered { number, .. }) => (
            Answered::Open,
            format!(
                "The run is registration {number} of its key: the earlier ones may be attempts at the same question."
            ),
        ),
        None => (Answered::Open, "The run was not registered (`robogate gate --register`).".to_owned()),
    };
    let because = format!("{question} {}", selected.1);
    let defeaters = vec![
        Defeater::new("chosen-question", chosen, state, question, paths(judged, &[Role::Question, Role::Requirements])),
        Defeater::new(
            "best-of-several",
            "The run is the best of several attempts.",
            selected.0,
            selected.1,
            paths(judged, &[Role::Registration]),
        ),
    ];
    let text = "Requirements, seed and policy were fixed before the first episode.";
    Claim::on("question", text, because, files, defeaters)
}

/// What was shown holds in the real cell.
pub(super) fn cell(judged: &Judged<'_>) -> Claim {
    let evaluation = judged.evaluation;
    let text = "What was shown holds in the real cell.";
    let results = evaluation.results.iter().filter(|result| result.requirement.metric == Metric::RealSuccess);
    let statuses: Vec<Status> = results.map(|result| result.status).collect();
    let files = paths(judged, &[Role::Real]);
    let (state, because) = match &evaluation.real {
        Some(real) => {
            let of =
                format!("{} of {} trials of the real robot succeeded", count(real.successes()), count(real.trials()));
            match () {
                () if statuses.contains(&Status::Violated) => {
                    (Answered::Confirmed, format!("{of}: the requirement on them is violated."))
                }
                () if statuses.is_empty() => {
                    (Answered::Open, format!("{of}, and no requirement (`real:success`) judges them."))
                }
                () if statuses.iter().all(|status| *status == Status::Met) => {
                    (Answered::Yes, format!("{of}: the requirement on them is met."))
                }
                () => (Answered::Open, format!("{of}: they do not decide the requirement.")),
            }
        }
        None if judged.provenance().source.is_some() => (
            Answered::Open,
            format!(
                "The rows were imported. Whether they are of the real robot is known from their author only: engine `{}`.",
                judged.provenance().engine.name
            ),
        ),
        None => (
            Answered::Open,
            "All episodes are simulated, and the evidence has no trial of the real robot (`robogate trial`)."
                .to_owned(),
        ),
    };
    let gap = Defeater::new(
        "simulation",
        "The simulation differs from the cell in something that moves the outcome.",
        state,
        because.clone(),
        files.clone(),
    );
    Claim::on("cell", text, because, files, vec![gap])
}

/// The deployed policy is the judged one.
pub(super) fn deployed(judged: &Judged<'_>) -> Claim {
    let text = "The deployed policy is the one that was judged.";
    let files = paths(judged, &[Role::Admission]);
    let admissions: Vec<Value> = judged.with_role(Role::Admission).filter_map(|file| judged.json(file).ok()).collect();
    let refused = admissions.iter().find(|one| one["admitted"] != true);
    let (state, because) = match (refused, admissions.first()) {
        (Some(refused), _) => {
            let why = refused["differences"].as_array().and_then(|all| all.first()).and_then(Value::as_str);
            (
                Answered::Confirmed,
                format!("A deployed policy was not admitted: {}.", why.unwrap_or("its answers differ")),
            )
        }
        (None, Some(admitted)) => (
            Answered::Yes,
            match admitted["requests"].as_u64() {
                Some(requests) => format!("`robogate admit` compared its answers to {requests} requests of the gate."),
                None => "`robogate admit` compared the files of its checkpoint with those of the gate.".to_owned(),
            },
        ),
        (None, None) => {
            let how = match judged.with_role(Role::Fingerprint).next() {
                Some(_) => "compare it with `robogate admit --json`, and include the result",
                None => "the evidence has no fingerprint that `robogate admit` could use",
            };
            (Answered::Open, format!("No comparison of the deployed policy is part of the evidence: {how}."))
        }
    };
    let other = Defeater::new(
        "deployed-other",
        "Another policy is deployed, or it is connected in another way: images, units, rate, normaliser.",
        state,
        because.clone(),
        files.clone(),
    );
    Claim::on("deployed", text, because, files, vec![other])
}

/// Operation is observed.
pub(super) fn operation(judged: &Judged<'_>) -> Claim {
    let monitors = paths(judged, &[Role::Monitor]);
    let (state, because) = match monitors.is_empty() {
        false => (Answered::Yes, "A monitor has these episodes as its reference."),
        true => (
            Answered::Open,
            "Nothing in this evidence observes the cell (`robogate monitor reference`, included as monitor=FILE).",
        ),
    };
    let outside = Defeater::new(
        "outside",
        "The cell operates outside of the ranges that were judged, or its rate drifts.",
        state,
        because,
        monitors.clone(),
    );
    let text = "Drift, and operation outside of what was judged, raise an alarm.";
    let mut parts = vec![Claim::on("monitor", text, because, monitors, vec![outside])];
    for (at, file) in judged.with_role(Role::Warning).enumerate() {
        let Ok(json) = judged.json(file) else { continue };
        let number_at = |place: &str| json.pointer(place).and_then(Value::as_f64).unwrap_or_default();
        let because = format!(
            "Calibrated with {} independent successes. The promise holds for the task, robot, policy and engine that were judged.",
            number(number_at("/calibration/successes"))
        );
        let text = format!(
            "A detector warns within an episode, and warns at most {} of the successes, with 95 % confidence.",
            percent(number_at("/calibration/promised"))
        );
        let stated = json.pointer("/conditions/population").and_then(Value::as_str).unwrap_or("unknown scenarios");
        let judged_on = conditions(judged.provenance()).into_iter().find(|(what, _)| *what == "population");
        let same = judged_on.is_some_and(|(_, population)| population == stated);
        let other = Defeater::new(
            format!("warning-population-{}", at + 1),
            "The detector was calibrated for other scenarios.",
            if same { Answered::Yes } else { Answered::Open },
            format!("It was calibrated on {stated}."),
            vec![file.path.clone()],
        );
        parts.push(Claim::on(format!("warning-{}", at + 1), text, because, vec![file.path.clone()], vec![other]));
    }
    let strategy = "Argue over the monitor, and over each detector.";
    Claim::of_parts("operation", "What changes in operation is noticed.", strategy, parts, Vec::new())
}

/// Other units of the robot meet the requirements too.
pub(super) fn fleet(judged: &Judged<'_>) -> Option<Claim> {
    let file = judged.with_role(Role::Fleet).next()?;
    let fleet = judged.json(file).ok()?;
    let share = &fleet["share"];
    let counts = ["meets", "violates", "undecided"].map(|name| share[name].as_u64().unwrap_or_default());
    let interval: [f64; 2] = serde_json::from_value(share["interval_95"].clone()).unwrap_or([0.0, 1.0]);
    let because = format!(
        "{} units meet the requirements, {} violate them, {} are undecided. Share of all units: {}, 95 % interval.",
        counts[0],
        counts[1],
        counts[2],
        percent_range(interval)
    );
    let files = vec![file.path.clone()];
    let (state, text) = match (fleet["required_share"].as_f64(), fleet["verdict"].as_str()) {
        (Some(required), verdict) => {
            let state = match verdict {
                Some("pass") => Answered::Yes,
                Some("fail") => Answered::Confirmed,
                _ => Answered::Open,
            };
            (state, format!("At least {} of the units of the robot meet the requirements.", percent(required)))
        }
        (None, _) => (Answered::Open, "The units of the robot meet the requirements.".to_owned()),
    };
    let reason = match fleet["required_share"].is_null() {
        true => format!("No share of units was required (`robogate fleet --share`). {because}"),
        false => because,
    };
    let other = Defeater::new(
        "other-unit",
        "Another unit of the robot behaves otherwise.",
        state,
        reason.clone(),
        files.clone(),
    );
    Some(Claim::on("fleet", text, reason, files, vec![other]))
}

/// Upgrades change nothing that matters.
pub(super) fn upgrades(judged: &Judged<'_>) -> Option<Claim> {
    let one = |(at, file): (usize, &robogate_gate::evidence::FileRecord)| {
        let json = judged.json(file).ok()?;
        let text = |name: &str| json[name].as_str().unwrap_or("unknown").to_owned();
        let state = match json["answer"].as_str() {
            Some("no_relevant_change") => Answered::Yes,
            Some("inconclusive" | "not_paired") => Answered::Open,
            _ => Answered::Confirmed,
        };
        let headline = format!("{}.", text("headline").trim_end_matches('.'));
        let files = vec![file.path.clone()];
        let changed = Defeater::new(
            format!("upgrade-{}-changes", at + 1),
            "The upgrade changes what was judged.",
            state,
            headline.clone(),
            files.clone(),
        );
        let claim = format!("The upgrade ({}) changes nothing that matters.", text("upgrade"));
        Some(Claim::on(format!("upgrade-{}", at + 1), claim, headline, files, vec![changed]))
    };
    let parts: Vec<Claim> = judged.with_role(Role::Requalification).enumerate().filter_map(one).collect();
    (!parts.is_empty()).then(|| {
        let text = "Upgrades since the judgement change nothing that matters.";
        Claim::of_parts("upgrades", text, "Argue over each upgrade.", parts, Vec::new())
    })
}
