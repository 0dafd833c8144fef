//! Clauses of standards and regulations that the evidence can support.
//!
//! Numbers and titles of the regulation are those of its consolidated text of 27 July 2026. Those of the standard are from public tables of
//! contents, which were found up to 5.2; later clauses are not stated.

use robogate_gate::evidence::Judged;

use super::{Claim, Support};

const REGULATION: &str = "Regulation (EU) 2023/1230";
const STANDARD: &str = "ISO 10218-2:2025";

/// A clause that claims of the argument can support.
#[derive(Debug, Clone, PartialEq)]
pub struct Clause {
    /// The standard or regulation.
    pub source: &'static str,
    /// The number.
    pub number: &'static str,
    /// The title.
    pub title: &'static str,
    /// What the evidence contributes.
    pub contributes: &'static str,
    /// The claims.
    pub claims: Vec<&'static str>,
    /// The worst status of these claims.
    pub support: Support,
}

/// A clause, what the evidence contributes, and the claims that do.
type Row = (&'static str, &'static str, &'static str, &'static str, &'static [&'static str]);

const ROWS: [Row; 11] = [
    (
        REGULATION,
        "Annex III, Part B, General principles, 1",
        "General principles",
        "to the risk assessment: the limits within which the task was judged, and how often it fails, with bounds",
        &["requirements", "population"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.1.2",
        "Principles of safety integration",
        "whether the policy is fit for its function under the conditions that were judged",
        &["requirements", "ranges"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.1.9",
        "Protection against corruption",
        "identification of the judged software by digest, and whether the deployed one is the same",
        &["subject", "deployed"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.2.1",
        "Safety and reliability of control systems",
        "test results about the defined task, and whether operation outside of it is noticed",
        &["requirements", "operation"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.3.6",
        "Risks related to variations in operating conditions",
        "the operating conditions that were varied, with their ranges",
        &["ranges"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.3.7",
        "Risks related to moving parts",
        "simulated contact forces against the limits that the user supplied",
        &["requirements"],
    ),
    (
        REGULATION,
        "Annex III, Part B, 1.7.4.2",
        "Contents of the instructions for use",
        "operating ranges, failure rates and open defeaters, for the description of the intended use and of residual risks",
        &["requirements", "ranges"],
    ),
    (
        REGULATION,
        "Annex IV, Part A",
        "Technical documentation",
        "a report of tests whose figures can be computed again from the recorded episodes",
        &["may-run"],
    ),
    (
        STANDARD,
        "4.2",
        "Characteristics of robot applications and robot cells",
        "to the risk assessment: task, parts and conditions that were judged, and how often the task fails",
        &["requirements", "population"],
    ),
    (
        STANDARD,
        "4.3.2",
        "Risk assessment for contacts between moving parts of the robot application and operator(s)",
        "simulated contact forces against the limits that the user supplied",
        &["requirements"],
    ),
    (
        STANDARD,
        "5.2.16",
        "Cybersecurity",
        "identification of the judged software by digest, and whether the deployed one is the same",
        &["subject", "deployed"],
    ),
];
/// The clauses about contacts.
const ABOUT_CONTACTS: [&str; 2] = ["Annex III, Part B, 1.3.7", "4.3.2"];

/// The clauses that the argument can support.
pub(super) fn of(judged: &Judged<'_>, claim: &Claim) -> Vec<Clause> {
    let all = claim.all();
    let has_forces = !judged.evaluation.force_limits.is_empty();
    let rows = ROWS.into_iter().filter(|(_, number, ..)| has_forces || !ABOUT_CONTACTS.contains(number));
    let clause = |(source, number, title, contributes, claims): Row| {
        let named = claims.iter().filter_map(|name| all.iter().find(|claim| claim.name == *name));
        let support = named.map(|claim| claim.support).max().unwrap_or(Support::Undeveloped);
        Clause { source, number, title, contributes, claims: claims.to_vec(), support }
    };
    rows.map(clause).collect()
}
