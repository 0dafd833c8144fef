//! Of which scenarios a demand speaks.

use std::fmt;

use crate::{Each, Label, Requirement, Trial};

/// A category, a group, both, or everything.
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
        let fits = |wanted: Option<&str>, word: fn(&Label) -> &str| {
            wanted.is_none_or(|wanted| trial.label.as_ref().is_some_and(|label| word(label) == wanted))
        };
        fits(self.category, |label| &label.category) && fits(self.group, |label| &label.group)
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

/// One demand for each category or group where it says so, in order of first appearance.
pub(crate) fn expand<'a>(requirement: &Requirement, trials: impl Iterator<Item = &'a Trial>) -> Vec<Requirement> {
    let Some(each) = requirement.each else { return vec![requirement.clone()] };
    let mut found: Vec<(Option<&str>, Option<&str>)> = Vec::new();
    for label in trials.filter_map(|trial| trial.label.as_ref()) {
        let key = match each {
            Each::Category => (Some(label.category.as_str()), None),
            Each::Group => (Some(label.category.as_str()), Some(label.group.as_str())),
        };
        if !found.contains(&key) {
            found.push(key);
        }
    }
    let owned = |word: Option<&str>| word.map(str::to_owned);
    found
        .into_iter()
        .map(|(category, group)| Requirement {
            category: owned(category),
            group: owned(group),
            each: None,
            ..requirement.clone()
        })
        .collect()
}
