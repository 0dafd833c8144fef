//! The comparison of a run with its nominal twins.

use std::path::Path;

use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{FAMILIES, NOMINAL};
use robogate_gate::{Record, Sampling, Twins, check_repeats};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;

/// The comparison of a run with the control arm in its folder, and with the episodes of one family of perturbations each. `None`
/// without a finished arm.
///
/// # Errors
/// Rows that cannot be read or do not belong together.
pub fn twins_of(folder: &Path, source: &Source, sampling: Sampling) -> Result<Option<Twins>, Failure> {
    let arm = folder.join(NOMINAL);
    if !arm.join(DICTIONARY).is_file() {
        return Ok(None);
    }
    let provenance = source.dictionary().provenance();
    let has_nominal = |name: &str| provenance.task.parameter(name).is_some_and(|spec| spec.nominal.is_some());
    let names = provenance.space.parameters().iter().map(|parameter| &*parameter.name);
    let kept = names.filter(|name| !has_nominal(name)).map(str::to_owned).collect();
    let record = Record::of(source.dictionary())?;
    if let Err(why) = check_repeats(&[&record]) {
        note(format_args!("note: no comparison with the control arm: {why}"));
        return Ok(None);
    }
    let nominal = Record::of(Source::open(&arm).or_broken()?.dictionary())?;
    let families = folder.join(FAMILIES);
    let families = match families.join(DICTIONARY).is_file() {
        true => Some(Record::of(Source::open(&families).or_broken()?.dictionary())?),
        false => None,
    };
    Ok(Some(Twins::with_families(&record, &nominal, families.as_ref(), sampling)?.keeping(kept)))
}
