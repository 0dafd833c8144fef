//! Interactions of two parameters: the effect of one depends on the other.

use robogate_stats::correlation::midranks;
use robogate_stats::logistic::{Data, Options, fit, interaction};
use robogate_stats::multiplicity::holm;
use robogate_stats::score_test::ScoreTest;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LEVEL, ParameterEffect};
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// Parameters whose pairs are tested: the most influential ones.
const MOST_PARAMETERS: usize = 16;
/// Rows of the test.
const MOST_ROWS: usize = 50_000;
/// Fewest rows of the rarer outcome. The test is approximate.
const FEWEST: usize = 40;
/// Most levels of a categorical parameter in the model without interactions.
const MOST_LEVELS: usize = 16;

/// A significant interaction of two numeric parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Interaction {
    /// The two parameters.
    pub parameters: [String; 2],
    /// The score of the product of their ranks. Above 0, success is more likely where both are large or both are small
    /// than their own effects explain.
    pub z: f64,
    /// Two-sided p-value.
    pub p: f64,
    /// The same, adjusted for all pairs and for the tests of single parameters.
    pub adjusted_p: f64,
}

/// The significant interactions and the number of tested pairs. `share` is their part of the error probability.
pub(super) fn interactions(base: &Sample, ranked: &[ParameterEffect], share: f64) -> (Vec<Interaction>, u64) {
    tested(base, ranked, share).unwrap_or_default()
}

fn tested(base: &Sample, ranked: &[ParameterEffect], share: f64) -> Option<(Vec<Interaction>, u64)> {
    let step = base.len().div_ceil(MOST_ROWS).max(1);
    let rows: Vec<usize> = (0..base.len()).step_by(step).collect();
    let success: Vec<bool> = rows.iter().map(|row| base.success[*row]).collect();
    let rarer = success.iter().filter(|s| **s).count().min(success.iter().filter(|s| !**s).count());
    // The model without interactions has three columns for each number.
    if rarer < FEWEST.max(8 * base.parameters.len().min(MOST_PARAMETERS)) {
        return None;
    }
    let used = ranked.iter().take(MOST_PARAMETERS).filter_map(|effect| base.parameter(&effect.parameter));
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let mut scores: Vec<(String, Vec<f64>)> = Vec::new();
    for parameter in used {
        if let ParameterKind::Categorical { levels } = &parameter.kind {
            let is = |level: usize| move |row: &usize| f64::from(u8::from(parameter.values[*row] as usize == level));
            columns.extend((1..levels.len().min(MOST_LEVELS)).map(|level| rows.iter().map(is(level)).collect()));
            continue;
        }
        let ranks = centred_ranks(parameter, &rows);
        // A cubic effect of each number: a curve that is too stiff would pass for an interaction.
        columns.push(ranks.iter().map(|r| r * r).collect());
        columns.push(ranks.iter().map(|r| r * r * r).collect());
        columns.push(ranks.clone());
        scores.push((parameter.name.clone(), ranks));
    }
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let weights: Option<Vec<f64>> = base.weights.as_ref().map(|of| rows.iter().map(|row| of[*row]).collect());
    let data = Data::new(&slices, &success, weights.as_deref()).ok()?;
    let null = fit(data, Options::default()).ok()?;
    let test = ScoreTest::new(data, &null)?;
    let mut found = Vec::new();
    for (i, (first, a)) in scores.iter().enumerate() {
        for (second, b) in &scores[i + 1..] {
            let Some(z) = test.z(&interaction(a, b)) else { continue };
            let p = robogate_stats::score_test::two_sided(z);
            found.push(Interaction { parameters: [first.clone(), second.clone()], z, p, adjusted_p: p });
        }
    }
    let adjusted = holm(&found.iter().map(|pair| pair.p).collect::<Vec<_>>()).ok()?;
    let pairs = found.len() as u64;
    found.iter_mut().zip(adjusted).for_each(|(pair, p)| pair.adjusted_p = (p / share).min(1.0));
    found.retain(|pair| pair.adjusted_p <= LEVEL);
    found.sort_by(|a, b| a.p.total_cmp(&b.p));
    Some((found, pairs))
}

/// Ranks from -1 to 1, so that heavy tails and scales do not matter.
fn centred_ranks(parameter: &ParameterColumn, rows: &[usize]) -> Vec<f64> {
    let values: Vec<f64> = rows.iter().map(|row| parameter.values[*row]).collect();
    let n = values.len() as f64;
    midranks(&values).into_iter().map(|rank| (2.0 * rank - n - 1.0) / n).collect()
}
