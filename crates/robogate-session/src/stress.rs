//! Stress in transit, as the user chooses it.

use std::path::PathBuf;

use anyhow::{Context, anyhow, bail};
use robogate_core::stress::{MOST_CHARACTERS, MOST_WORDINGS, STRESS, STRESS_PREFIX, Stress, StressGroup};
use robogate_core::{ParameterSpace, TaskSpec};
use robogate_dictionary::read_text;

use crate::notice::note;
use crate::text::foreign;

/// The words for groups of parameters.
const GROUPS: [(&str, Option<StressGroup>); 5] = [
    ("all", None),
    ("images", Some(StressGroup::Images)),
    ("state", Some(StressGroup::State)),
    ("actions", Some(StressGroup::Actions)),
    ("language", Some(StressGroup::Language)),
];

/// What varies between environment and policy.
#[derive(Debug, Clone, Default)]
pub struct StressChoice {
    /// Groups or parameters. Empty for none.
    pub wanted: Vec<String>,
    /// The file with other wordings of the instruction, one in each line.
    pub wordings: Option<PathBuf>,
}

impl StressChoice {
    /// The stress of this choice. `None` without one.
    ///
    /// # Errors
    /// An unknown word, or a file that cannot be used.
    pub fn stress(&self) -> anyhow::Result<Option<Stress>> {
        if self.wanted.is_empty() {
            return match &self.wordings {
                Some(_) => Err(anyhow!("--wordings has no effect without --stress\nHint: add --stress language")),
                None => Ok(None),
            };
        }
        let mut parameters: Vec<String> = Vec::new();
        for wanted in &self.wanted {
            let group = GROUPS.iter().find(|(name, _)| name == wanted).map(|(_, group)| *group);
            let name = wanted.strip_prefix(STRESS_PREFIX).unwrap_or(wanted);
            let chosen: Vec<&str> = STRESS
                .iter()
                .filter(|row| match group {
                    Some(group) => group.is_none_or(|group| row.group == group),
                    None => row.name.strip_prefix(STRESS_PREFIX) == Some(name),
                })
                .map(|row| row.name)
                .collect();
            if chosen.is_empty() {
                let groups = GROUPS.iter().map(|(name, _)| *name);
                let names = STRESS.iter().filter_map(|row| row.name.strip_prefix(STRESS_PREFIX));
                let known: Vec<&str> = groups.chain(names).collect();
                bail!("--stress {}: unknown. Expected one of: {}", foreign(wanted), known.join(", "));
            }
            parameters.extend(chosen.into_iter().map(str::to_owned));
        }
        parameters.sort();
        parameters.dedup();
        let wordings = self.wordings()?;
        if wordings.is_empty() && self.wanted.iter().any(|wanted| wanted.ends_with("wording")) {
            bail!("--stress wording: there are no other wordings\nHint: name a file with --wordings");
        }
        if !wordings.is_empty() && !parameters.iter().any(|name| name.ends_with("wording")) {
            bail!("--wordings has no effect without other words\nHint: add --stress language or --stress wording");
        }
        let stress = Stress { parameters, wordings };
        stress.check().map_err(|why| anyhow!("--wordings: {why}"))?;
        Ok(Some(stress))
    }

    fn wordings(&self) -> anyhow::Result<Vec<String>> {
        let Some(file) = &self.wordings else { return Ok(Vec::new()) };
        let most = 4 * MOST_WORDINGS * (MOST_CHARACTERS + 1);
        let name = || format!("--wordings {}", file.display());
        let text = read_text(file).with_context(name)?;
        if text.len() > most {
            bail!("{}: {} bytes. Expected at most {most}", name(), text.len());
        }
        let lines: Vec<String> =
            text.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect();
        if lines.is_empty() {
            bail!("{}: it has no line with a wording", name());
        }
        Ok(lines)
    }
}

/// Whether an adapter between environment and policy applies this parameter.
pub(crate) fn is_stress(parameter: &str) -> bool {
    parameter.starts_with(STRESS_PREFIX)
}

/// The space with the parameters of this stress for this task, each over its range.
pub(crate) fn with_parameters(
    space: ParameterSpace,
    stress: &Stress,
    task: &TaskSpec,
) -> anyhow::Result<ParameterSpace> {
    let without_effect = stress.without_effect(task);
    if without_effect.len() == stress.parameters.len() {
        bail!(
            "--stress: the task {} has nothing that this changes: no cameras, or no other wordings\nHint: choose other parameters",
            task.name
        );
    }
    if !without_effect.is_empty() {
        note(format_args!("without effect in this task, and left out: {}", without_effect.join(", ")));
    }
    let mut parameters = space.parameters().to_vec();
    let new = stress.parameters_for(task).into_iter().filter(|new| space.position(&new.name).is_none());
    parameters.extend(new);
    let name = format!("{} with stress", space.name());
    Ok(ParameterSpace::new(name, parameters)?.with_correlations(space.correlations().to_vec())?)
}
