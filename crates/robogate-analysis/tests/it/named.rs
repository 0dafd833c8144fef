//! What a report claims.

use robogate_analysis::{Advice, Analysis};

/// Everything that a report names: regions, interactions, boxes, danger zones.
pub(crate) fn named(analysis: &Analysis) -> Vec<String> {
    let claims = &analysis.claims;
    let mut named: Vec<String> = claims.failure_regions.iter().map(|region| region.parameter.clone()).collect();
    named.extend(claims.interactions.iter().flatten().cloned());
    for advice in &claims.advice {
        if matches!(advice, Advice::Operate { .. } | Advice::RunMore { .. } | Advice::NoBox { .. }) {
            named.extend(analysis.safe_box.estimated().unwrap().limits.iter().map(|limit| limit.parameter.clone()));
        }
    }
    named.extend(analysis.danger_zones.zones.iter().filter(|z| z.significant).map(|z| z.parameter.clone()));
    named
}
