//! Documents of evidence that follow from its other files: the index, the compliance pack (the verdict as a page for filing and for CI, and
//! the list of components behind it), and the safety case.
//!
//! All documents are functions of these files and this build, without a date. Evidence lists their hashes, and [`check`] writes them again
//! and compares.

use std::path::Path;

use anyhow::Context;
use robogate_campaign::Summary;
use robogate_core::budget::Budget;
use robogate_core::{FailureMode, Parameter, ParameterSpec, SettingSpec};
use robogate_dictionary::{Dictionary, Provenance, Tool, hex};
use robogate_gate::evidence::{
    Documents, EnvironmentBinding, Judged, MANIFEST, Manifest, PolicyBinding, Problem, Role,
};
use robogate_gate::{Evaluation, Metric, operating_domain, operating_ranges};
use robogate_report::{OPERATING_DOMAIN, SafetyCase, evidence_html, junit, of_invalid, safety_case_html, verdict_html};
use robogate_session::SOURCE_SHA256;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::commands::env::domain;

/// The list of components.
const SBOM: &str = "compliance/sbom.cdx.json";
/// The components that the rows identify.
const JUDGED: [&str; 4] = ["policy", "robot", "episodes", "simulator"];
/// The exact versions that this build could link.
const LOCK: &str = include_str!("../../../Cargo.lock");

/// The first page of the evidence.
const INDEX: &str = "index.html";
/// The verdict for readers and for CI.
const VERDICT: &str = "compliance/verdict.html";
const JUNIT: &str = "compliance/gate.junit.xml";
/// The safety case for readers and for tools.
const SAFETY_CASE: &str = "safety-case.html";
const ARGUMENT: &str = "safety-case.gsn.yaml";

/// The documents of evidence: always the index, and these.
pub(crate) fn documents(compliance: bool, safety_case: bool) -> Documents {
    match (compliance, safety_case) {
        (false, false) => |judged| all(judged, false, false),
        (false, true) => |judged| all(judged, false, true),
        (true, false) => |judged| all(judged, true, false),
        (true, true) => |judged| all(judged, true, true),
    }
}

/// Path in the evidence and content of each document.
fn all(judged: &Judged<'_>, compliance: bool, safety_case: bool) -> Vec<(String, Vec<u8>)> {
    let (evaluation, provenance) = (judged.evaluation, judged.provenance());
    let more = safety_case.then_some(SAFETY_CASE);
    let (ranges, unchecked) = (ranges(provenance), unchecked(evaluation, provenance));
    let index = evidence_html(evaluation, &origin(provenance), ranges, unchecked, more);
    let mut documents = vec![(INDEX, index.into_bytes())];
    if compliance {
        // A tree of strings and maps cannot fail to serialise.
        let sbom = serde_json::to_string_pretty(&sbom(evaluation, provenance)).unwrap_or_default() + "\n";
        documents.extend([
            (VERDICT, verdict_html(evaluation, &origin(provenance)).into_bytes()),
            (JUNIT, junit(evaluation).into_bytes()),
            (SBOM, sbom.into_bytes()),
        ]);
    }
    let domain = operating_domain(provenance.space.name(), &operating_ranges(provenance)).into_bytes();
    if safety_case {
        let case = SafetyCase::of(judged, &hex(&Sha256::digest(&domain)));
        documents.push((SAFETY_CASE, safety_case_html(case.as_ref().map_err(String::as_str)).into_bytes()));
        documents.extend(case.ok().map(|case| (ARGUMENT, case.to_gsn().into_bytes())));
    }
    if compliance || safety_case {
        documents.push((OPERATING_DOMAIN, domain));
    }
    documents.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}

/// The parameters of the space: name, range, unit and meaning.
fn ranges(provenance: &Provenance) -> Vec<Vec<String>> {
    let row = |parameter: &Parameter| {
        let spec = provenance.task.parameter(&parameter.name);
        let of = |text: fn(&ParameterSpec) -> String| spec.map(text).unwrap_or_default();
        let name = parameter.name.to_string();
        vec![name, domain(&parameter.domain), of(|spec| spec.unit.to_string()), of(|spec| spec.meaning.to_string())]
    };
    operating_ranges(provenance).iter().map(row).collect()
}

/// What the verdict leaves open, in sentences.
fn unchecked(evaluation: &Evaluation, provenance: &Provenance) -> Vec<String> {
    let mut texts = Vec::new();
    let limited = |mode: FailureMode| {
        let of = |metric| matches!(metric, Metric::Failure(of) | Metric::FailureCount(of) if of == mode);
        evaluation.requirements.requirement.iter().any(|one| of(one.metric))
    };
    let free: Vec<&str> = provenance.task.modes().filter(|mode| !limited(*mode)).map(FailureMode::as_str).collect();
    if !free.is_empty() {
        texts.push(format!("No requirement limits these failure modes alone: {}.", free.join(", ")));
    }
    texts.extend(
        evaluation.dropped.iter().map(|one| format!("`{}` was not judged as written: {}.", one.id, one.because)),
    );
    if evaluation.controls.is_none() {
        texts.push("No controls ran: an expert and random actions were not compared with the policy.".to_owned());
    }
    if PolicyBinding::of(provenance).sha256().is_none() {
        texts.push(format!("The policy has no digest: {}.", PolicyBinding::of(provenance)));
    }
    if !EnvironmentBinding::of(provenance).simulator_build_known {
        texts.push("The build of the simulator is as its server declares it.".to_owned());
    }
    if evaluation.counts.invalid > 0 {
        texts.push(format!(
            "{} invalid episodes have no outcome: {}.",
            evaluation.counts.invalid,
            of_invalid(evaluation.verdict)
        ));
    }
    texts.push(
        "Whether the simulation is like the real cell, unless trials of the real robot are part of the requirements."
            .to_owned(),
    );
    texts
}

/// The summary and the documents in verified evidence that differ from those of its rows, and `false` if
/// another version wrote them, so that they could not be compared.
pub(crate) fn check(folder: &Path) -> anyhow::Result<(Vec<Problem>, bool)> {
    let read = |name: &str| {
        let path = folder.join(name);
        std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let manifest: Manifest = serde_json::from_slice(&read(MANIFEST)?)?;
    let of = |role: Role| manifest.files.iter().filter(move |file| file.role == role);
    let derived = [Role::Compliance, Role::Summary];
    if !manifest.files.iter().any(|file| derived.contains(&file.role)) {
        return Ok((Vec::new(), true));
    }
    if manifest.tool != Tool::robogate() {
        return Ok((Vec::new(), false));
    }
    let file = |role: Role| of(role).next().map(|file| file.path.as_str()).context("a file is missing in the manifest");
    let evaluation: Evaluation = serde_json::from_slice(&read(file(Role::Evaluation)?)?)?;
    let dictionary = Dictionary::open(&folder.join(file(Role::Dictionary)?))?;
    let mut problems = Vec::new();
    for listed in of(Role::Summary) {
        let reason = other_summary(&dictionary, &read(&listed.path)?);
        problems.extend(reason.map(|reason| Problem::new(&*listed.path, reason)));
    }
    let has = |names: &[&str]| manifest.files.iter().any(|file| names.contains(&file.path.as_str()));
    let judged = Judged::of(folder, &evaluation, &dictionary, &manifest.files, manifest.margin)?;
    let expected = documents(has(&[VERDICT, JUNIT, SBOM]), has(&[SAFETY_CASE, ARGUMENT]))(&judged);
    for listed in of(Role::Compliance) {
        let (found, written) = (read(&listed.path)?, expected.iter().find(|(name, _)| *name == listed.path));
        let reason = match written {
            Some((_, bytes)) if *bytes == found => None,
            Some((name, bytes)) if name == SBOM => other_components(bytes, &found),
            _ => Some("differs from the document of the evaluation".to_owned()),
        };
        problems.extend(reason.map(|reason| Problem::new(&*listed.path, reason)));
    }
    Ok((problems, true))
}

/// What differs in a summary from that of the rows. Rows do not show which episodes ran again.
fn other_summary(dictionary: &Dictionary, found: &[u8]) -> Option<String> {
    let mut stated: Value = match Budget::FILE.json(found) {
        Ok(stated) => stated,
        Err(why) => return Some(format!("not JSON: {why}")),
    };
    stated.as_object_mut()?.remove("run_again");
    let hash = dictionary.dataset_hash().to_owned();
    let derived = match Summary::of_rows(dictionary.provenance(), hash, dictionary.entries()) {
        Ok(summary) => json!(summary),
        Err(why) => return Some(format!("there is no summary of the rows: {why}")),
    };
    first_difference(&derived, &stated).map(|(field, was, is)| format!("`{field}` is {is}, but the rows give {was}"))
}

/// What differs in a list of components. The packages of another build are not known here.
fn other_components(derived: &[u8], found: &[u8]) -> Option<String> {
    let read = |bytes: &[u8]| Budget::FILE.json::<Value>(bytes).map_err(|why| format!("not JSON: {why}"));
    let (derived, mut stated) = match (read(derived), read(found)) {
        (Ok(derived), Ok(stated)) => (derived, stated),
        (Err(why), _) | (_, Err(why)) => return Some(why),
    };
    if derived["metadata"] == stated["metadata"] {
        return first_difference(&derived, &stated)
            .map(|(field, was, is)| format!("`{field}` is {is}. Expected {was}, as in the rows and in Cargo.lock"))
            .or_else(|| Some("differs from the same list in its layout".to_owned()));
    }
    let judged = |list: &Value| {
        let components = list["components"].as_array().cloned().unwrap_or_default();
        let of_the_rows = |one: &Value| JUDGED.iter().any(|name| one["bom-ref"] == *name);
        Value::Array(components.into_iter().filter(of_the_rows).collect())
    };
    stated = judged(&stated);
    first_difference(&judged(&derived), &stated)
        .map(|(field, was, is)| format!("the component `{field}` is {is}, but the rows give {was}"))
}

/// The first field whose values differ: its path, and both values as short texts.
fn first_difference(one: &Value, other: &Value) -> Option<(String, String, String)> {
    let below = |key: String, one: &Value, other: &Value| {
        first_difference(one, other).map(|(path, was, is)| {
            let path = if path.is_empty() { key.clone() } else { format!("{key}.{path}") };
            (path, was, is)
        })
    };
    let found = match (one, other) {
        _ if one == other => return None,
        (Value::Object(a), Value::Object(b)) => {
            a.keys().chain(b.keys()).find_map(|key| below(key.clone(), &one[key], &other[key]))
        }
        (Value::Array(a), Value::Array(b)) => {
            (0..a.len().max(b.len())).find_map(|at| below(at.to_string(), &one[at], &other[at]))
        }
        _ => None,
    };
    let short = |value: &Value| value.to_string().chars().take(80).collect::<String>();
    found.or_else(|| Some((String::new(), short(one), short(other))))
}

/// What identifies the judged system, as names and values.
fn origin(provenance: &Provenance) -> Vec<(String, String)> {
    let Provenance { tool, build, engine, robot, task, seed, .. } = provenance;
    let with_hash = |text: String, hash: Option<&String>| match hash {
        Some(hash) => format!("{text}, SHA-256 {hash}"),
        None => text,
    };
    let version = engine.version.as_deref().unwrap_or("of unknown version");
    let mut facts = vec![
        ("Measured by", format!("{} {}", tool.name, tool.version)),
        ("Policy", format!("{}: {}", provenance.policy, PolicyBinding::of(provenance))),
        ("Robot", with_hash(robot.name.clone(), robot.sha256.as_ref())),
        ("Task", format!("{} {}", task.name, task.version)),
        ("Simulator", with_hash(format!("{} {version}", engine.name), engine.build_sha256.as_ref())),
        ("Environment", format!("SHA-256 {}", EnvironmentBinding::of(provenance).sha256)),
        ("Seed", seed.to_string()),
    ];
    let settings: Vec<String> = task.settings.iter().filter_map(SettingSpec::shown).collect();
    if !settings.is_empty() {
        facts.push(("Settings of the task", settings.join(", ")));
    }
    if let Some(build) = build {
        facts.insert(1, ("Source code", format!("SHA-256 {}", build.source_sha256)));
    }
    if let Some(source) = &provenance.source {
        facts.push(("Imported from", format!("{}, SHA-256 {}", source.format, source.sha256)));
    }
    facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// The components behind the verdict as CycloneDX 1.5: what was judged, what judged it, and the Rust packages
/// of this build.
fn sbom(evaluation: &Evaluation, provenance: &Provenance) -> Value {
    let Provenance { tool, engine, robot, policy, .. } = provenance;
    let mut components = vec![
        component("machine-learning-model", "policy", policy, None, PolicyBinding::of(provenance).sha256()),
        component("data", "robot", &robot.name, None, robot.sha256.as_deref()),
        component("data", "episodes", "episodes", None, Some(&evaluation.dataset_sha256)),
        component("library", "simulator", &engine.name, engine.version.as_deref(), engine.build_sha256.as_deref()),
    ];
    let this = Tool::robogate();
    let source = provenance.build.as_ref().map(|build| build.source_sha256.as_str());
    if *tool != this || source.is_some_and(|source| source != SOURCE_SHA256) {
        let mut measured = component("application", "measured-by", &tool.name, Some(&tool.version), None);
        measured["properties"] = json!([{ "name": "robogate:source_sha256", "value": source.unwrap_or("unknown") }]);
        components.push(measured);
    }
    components.extend(packages());
    json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": "robogate",
                "name": this.name,
                "version": this.version,
                "properties": [
                    { "name": "robogate:source_sha256", "value": SOURCE_SHA256 },
                    {
                        "name": "robogate:packages",
                        "value": "Cargo.lock of this build: the packages of all its features, platforms and tests",
                    },
                ],
            },
        },
        "components": components,
    })
}

fn component(kind: &str, reference: &str, name: &str, version: Option<&str>, sha256: Option<&str>) -> Value {
    let mut component = json!({ "type": kind, "bom-ref": reference, "name": name });
    if let Some(version) = version {
        component["version"] = json!(version);
    }
    if let Some(sha256) = sha256 {
        component["hashes"] = json!([{ "alg": "SHA-256", "content": sha256 }]);
    }
    component
}

/// The packages of registries in `Cargo.lock`. The hash is that of the package's archive.
fn packages() -> Vec<Value> {
    let lock: toml::Table = LOCK.parse().unwrap_or_default();
    let packages = lock.get("package").and_then(toml::Value::as_array).map_or(&[][..], Vec::as_slice);
    packages
        .iter()
        .filter_map(|package| {
            let text = |key: &str| package.get(key).and_then(toml::Value::as_str);
            // The packages of this workspace have no source.
            text("source")?;
            let (name, version) = (text("name")?, text("version")?);
            let purl = format!("pkg:cargo/{name}@{version}");
            let mut component = component("library", &purl, name, Some(version), text("checksum"));
            component["purl"] = json!(purl);
            Some(component)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_have_hashes() {
        let packages = packages();
        assert!(packages.len() > 100, "{} packages", packages.len());
        for package in &packages {
            assert!(package["hashes"][0]["content"].as_str().is_some_and(|hash| hash.len() == 64), "{package}");
        }
        assert!(packages.iter().any(|package| package["name"] == "serde"));
    }
}
