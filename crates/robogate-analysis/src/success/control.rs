//! The rate with the known distribution of the parameters as a control variate.

use robogate_stats::Confidence;
use robogate_stats::adjusted::{Control, ROWS_PER_COEFFICIENT, adjusted};

use super::Adjusted;
use crate::Finding;
use crate::rate::ends;
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// Most knots of a numeric parameter.
const MAX_KNOTS: usize = 8;
/// Most parameters. The first ones of the space are used.
const MAX_PARAMETERS: usize = 24;

pub(super) fn adjusted_rate(base: &Sample) -> Finding<Adjusted> {
    let used = base.parameters.iter().take(MAX_PARAMETERS);
    // The knots must not depend on outcomes, and there must be rows for each.
    let budget = base.len() / (2 * ROWS_PER_COEFFICIENT) / used.len().max(1);
    let knots = (budget + 1).clamp(2, MAX_KNOTS);
    let controls: Vec<Control> = used.filter_map(|parameter| control(parameter, knots)).collect();
    if controls.is_empty() {
        return Finding::not("there is no parameter with a known distribution");
    }
    adjusted(&controls, &base.success, Confidence::P95)
        .map(|found| Adjusted {
            rate: found.rate,
            se: found.se,
            interval_95: ends(found.interval),
            effective_episodes: found.effective,
            parameters: controls.len() as u64,
        })
        .into()
}

/// A parameter with its known distribution. `None` for more levels than twice the knots, and for values out of range.
fn control(parameter: &ParameterColumn, knots: usize) -> Option<Control> {
    let rows = &parameter.values;
    match &parameter.kind {
        ParameterKind::Continuous { low, high, log } => {
            let scale = |v: f64| if *log { v.ln() } else { v };
            let (from, to) = (scale(*low), scale(*high));
            let unit = |v: &f64| {
                let unit = (scale(*v) - from) / (to - from);
                (0.0..=1.0).contains(&unit).then_some(unit)
            };
            Some(Control::Uniform { at: rows.iter().map(unit).collect::<Option<_>>()?, knots })
        }
        ParameterKind::Integer { low, high } => {
            let levels = usize::try_from(high.checked_sub(*low)?).ok()? + 1;
            let cells = levels.min(knots);
            let cell = |offset: usize| (offset * cells / levels) as u16;
            let mut shares = vec![0.0; cells];
            if levels > 1 << 20 {
                return None;
            }
            (0..levels).for_each(|offset| shares[usize::from(cell(offset))] += 1.0 / levels as f64);
            let bin = |v: &f64| {
                let offset = *v - *low as f64;
                (offset >= 0.0 && offset < levels as f64).then(|| cell(offset as usize))
            };
            Some(Control::Levels { of: rows.iter().map(bin).collect::<Option<_>>()?, shares })
        }
        ParameterKind::Categorical { levels } => {
            let count = levels.len();
            if count < 2 || count > 2 * knots {
                return None;
            }
            Some(Control::Levels {
                of: rows.iter().map(|v| *v as u16).collect(),
                shares: vec![1.0 / count as f64; count],
            })
        }
    }
}
