//! The operating ranges as an operational design domain in ASAM OpenODD 1.0 (YAML).
//!
//! One module holds where all parameters are within the judged space. Values are in the unit that a parameter's name ends with.

use std::collections::BTreeSet;
use std::fmt::Write;

use robogate_core::{Domain, Parameter, Spread, Suite, Value};
use robogate_dictionary::Provenance;
use robogate_stats::format::is_deceptive;

/// The suite that rows were sampled from, if there is one.
pub(crate) fn suite_of(provenance: &Provenance) -> Option<Suite> {
    let suite = provenance.plan.pointer("/suite/suite").cloned();
    suite.and_then(|suite| serde_json::from_value(suite).ok())
}

/// The operating ranges of rows: their space. A number that all scenarios of a suite share is constant, although the space has a small
/// range for it.
pub fn operating_ranges(provenance: &Provenance) -> Vec<Parameter> {
    let suite = suite_of(provenance);
    let constant = |name: &str| {
        let of = suite.iter().flat_map(Suite::cases).flat_map(|case| &case.parameters).filter(|(of, _)| **of == *name);
        let mut values = of.map(|(_, spread)| match spread {
            Spread::Fixed(Value::Number(x)) => Some(*x),
            _ => None,
        });
        let first = values.next()??;
        values.all(|value| value == Some(first)).then_some(first)
    };
    let range = |parameter: &Parameter| match (&parameter.domain, constant(&parameter.name)) {
        (Domain::Continuous { scale, .. }, Some(x)) => {
            Parameter { domain: Domain::Continuous { low: x, high: x, scale: *scale }, ..parameter.clone() }
        }
        _ => parameter.clone(),
    };
    provenance.space.parameters().iter().map(range).collect()
}

/// The domain of the operating ranges of a space.
pub fn operating_domain(space: &str, ranges: &[Parameter]) -> String {
    let mut taken = BTreeSet::new();
    let (mut taxonomy, mut module) = (String::new(), String::new());
    for parameter in ranges {
        let name = concept(&parameter.name, &mut taken);
        let (kind, values) = match &parameter.domain {
            Domain::Continuous { low, high, .. } => ("float".to_owned(), quoted(&format!("[{low:?}, {high:?}]"))),
            Domain::Integer { low, high } => ("integer".to_owned(), quoted(&format!("[{low}, {high}]"))),
            Domain::Categorical { choices } => {
                let choices: Vec<String> = choices.iter().map(|choice| quoted(choice)).collect();
                let list = format!("[{}]", choices.join(", "));
                (list.clone(), list)
            }
        };
        // Writing to a string cannot fail.
        let _ = writeln!(taxonomy, "  {name}: {kind}");
        let _ = writeln!(module, "      {name}: {values}");
    }
    format!(
        "# ASAM OpenODD 1.0. Values are in the unit that a name ends with.\nTAXONOMY:\n{taxonomy}MODULES:\n  operating_range:\n    \
         TITLE: {}\n    INCLUDE_AND:\n{module}",
        quoted(&format!("The parameter space {space}"))
    )
}

/// A name of letters, digits and underscores that is not taken yet.
fn concept(name: &str, taken: &mut BTreeSet<String>) -> String {
    let mut concept: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if concept.chars().next().is_none_or(|first| first.is_ascii_digit()) {
        concept.insert(0, '_');
    }
    while !taken.insert(concept.clone()) {
        concept.push('_');
    }
    concept
}

/// A double-quoted scalar: JSON is YAML, except for control characters.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text.replace(is_deceptive, "\u{fffd}")).to_string()
}
