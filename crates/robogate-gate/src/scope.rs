//! The scenarios that a requirement applies to.

use std::fmt;

use robogate_dictionary::Label;

use crate::{Each, GateError, Requirement, Trial};

/// A category, a group, both, or all scenarios.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Scope<'a> {
    pub(crate) category: Option<&'a str>,
    pub(crate) group: Option<&'a str>,
}

impl<'a> Scope<'a> {
    pub(crate) fn of(requirement: &'a Requirement) -> Self {
        Self { category: requirement.category.as_deref(), group: requirement.group.as_deref() }
    }

    pub(crate) fn holds(self, trial: &Trial) -> bool {
        let Label { category, group, .. } = &trial.label;
        let fits = |wanted: Option<&str>, word: &Option<String>| wanted.is_none_or(|w| word.as_deref() == Some(w));
        fits(self.category, category) && fits(self.group, group)
    }
}

impl fmt::Display for Scope<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.category, self.group) {
            (Some(category), Some(group)) => write!(f, "category `{category}`, group `{group}`"),
            (Some(category), None) => write!(f, "category `{category}`"),
            (None, Some(group)) => write!(f, "group `{group}`"),
            (None, None) => f.write_str("any kind"),
        }
    }
}

/// Expands a requirement with `each` to one requirement per category or group, in order of first appearance.
///
/// # Errors
/// If an episode has no category or group. No requirement would judge it otherwise.
pub(crate) fn expand<'a>(
    requirement: &Requirement,
    labels: impl Iterator<Item = &'a Label>,
) -> Result<Vec<Requirement>, GateError> {
    let Some(each) = requirement.each else { return Ok(vec![requirement.clone()]) };
    let mut found: Vec<(Option<&str>, Option<&str>)> = Vec::new();
    for Label { category, group, .. } in labels {
        let (key, wanted, what) = match each {
            Each::Category => ((category.as_deref(), None), category, "category"),
            Each::Group => ((category.as_deref(), group.as_deref()), group, "group"),
        };
        if wanted.is_none() {
            return Err(GateError::NoLabel { id: requirement.id(), what });
        }
        if !found.contains(&key) {
            found.push(key);
        }
    }
    let owned = |word: Option<&str>| word.map(str::to_owned);
    let parts = found.into_iter().map(|(category, group)| Requirement {
        category: owned(category),
        group: owned(group),
        each: None,
        ..requirement.clone()
    });
    Ok(parts.collect())
}
