//! Claims about what was judged.

use robogate_gate::evidence::{EnvironmentBinding, Judged, PolicyBinding, Role};

use super::{Answered, Claim, Defeater, paths};

pub(super) fn claim(judged: &Judged<'_>) -> Claim {
    let text = "It is known exactly what was judged.";
    let strategy = "Argue over the policy and over the environment.";
    Claim::of_parts("subject", text, strategy, vec![policy(judged), environment(judged)], Vec::new())
}

fn policy(judged: &Judged<'_>) -> Claim {
    let binding = PolicyBinding::of(judged.provenance());
    let fingerprint = paths(judged, &[Role::Fingerprint]);
    let files = paths(judged, &[Role::Dictionary, Role::Policy, Role::Fingerprint]);
    let unknown = match &binding {
        PolicyBinding::File { .. } | PolicyBinding::BuiltIn | PolicyBinding::InEnvironment { .. } => None,
        PolicyBinding::Declared { .. } => Some("The server runs another policy than the one whose digest it declares."),
        PolicyBinding::Unbound { .. } => {
            Some("The policy is known by its name or address only: another one may answer there.")
        }
    };
    let defeater = unknown.map(|text| {
        Defeater::new(
            "other-policy",
            text,
            if fingerprint.is_empty() { Answered::Open } else { Answered::Yes },
            match fingerprint.is_empty() {
                true => "The evidence has neither its files nor its answers to known requests.".to_owned(),
                false => {
                    "Its answers to requests of the gate, or the files of its checkpoint, are recorded and identify it."
                        .to_owned()
                }
            },
            fingerprint,
        )
    });
    let text = format!("The policy is identified: {}.", judged.evaluation.policy);
    let because = format!("Identified as {binding}.");
    Claim::on("policy", text, because, files, defeater.into_iter().collect())
}

fn environment(judged: &Judged<'_>) -> Claim {
    let provenance = judged.provenance();
    let binding = EnvironmentBinding::of(provenance);
    let files = paths(judged, &[Role::Dictionary, Role::Plan, Role::Robot, Role::Environment]);
    let (state, text, because) = match (&provenance.source, binding.simulator_build_known) {
        (Some(source), _) => (
            Answered::Open,
            "The environment of the imported episodes is not the one that their author names.",
            format!("The rows were imported from a file ({}), which records no digest of it.", source.format),
        ),
        (None, false) => (
            Answered::Open,
            "The simulator is another build than the one that its server declares.",
            "The server declares its name and version, and no digest.".to_owned(),
        ),
        (None, true) => (
            Answered::Yes,
            "The simulator is another build than the one that is named.",
            "The digest of the loaded library is recorded.".to_owned(),
        ),
    };
    let defeater = Defeater::new("other-environment", text, state, because, files.clone());
    let because = format!("Task, world, engine, robot and parameter space have the SHA-256 {}.", binding.sha256);
    Claim::on("environment", "The environment is identified.", because, files, vec![defeater])
}
