//! Where and how the episodes of a pair differ.

use serde::Serialize;

use super::trace::Trace;
use super::{Seen, trace};

/// Poses that differ by less are equal for a user, in metres.
const VISIBLE_M: f64 = 0.001;

/// Where and how episodes differ. The figures describe these pairs and are not claims.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Explanation {
    /// Where the motion of the pairs differs for the first time, for at most 20 pairs.
    pub divergence: Vec<Divergence>,
    /// Means over all frames of all pairs.
    pub signals: Vec<SignalChange>,
}

/// Where the motion of a pair differs for the first time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Divergence {
    /// The index of the episode.
    pub index: u64,
    /// The first control period after which any pose differs at all. 0 is the start.
    pub first: Option<usize>,
    /// The first control period after which a body is more than 1 mm away from where it was.
    pub visible: Option<usize>,
    /// That body.
    pub body: Option<String>,
    /// How both ended.
    pub endings: [String; 2],
}

/// A signal before and after.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalChange {
    /// Its name.
    pub name: String,
    /// The mean before and after.
    pub mean: [f64; 2],
    /// The largest value before and after.
    pub largest: [f64; 2],
}

/// A pair with the physics of both episodes.
type Traced<'a> = (&'a Seen, &'a Trace, &'a Seen, &'a Trace);

impl Explanation {
    pub(super) fn of(pairs: &[(&Seen, &Seen)]) -> Self {
        /// Pairs whose divergence is listed.
        const LISTED: usize = 20;
        let traced: Vec<Traced<'_>> = pairs
            .iter()
            .filter_map(|(one, two)| Some((*one, one.trace.as_deref()?, *two, two.trace.as_deref()?)))
            .collect();
        let divergence = traced.iter().take(LISTED).map(|(one, before, two, after)| {
            let (first, visible) = diverges(before, after);
            Divergence {
                index: one.index,
                first,
                visible: visible.as_ref().map(|(frame, _)| *frame),
                body: visible.map(|(_, body)| body),
                endings: [one, two].map(|seen| seen.ending.as_str().to_owned()),
            }
        });
        let divergence = divergence.collect();
        let names = traced.first().map_or(&[][..], |(_, trace, ..)| &trace.signals);
        let signals = names.iter().filter_map(|name| {
            let all = |of: &dyn Fn(&Traced<'_>) -> Option<Vec<f64>>| {
                traced.iter().filter_map(of).flatten().collect::<Vec<f64>>()
            };
            let values = [all(&|of| of.1.signal(name)), all(&|of| of.3.signal(name))];
            let mean = values.each_ref().map(|values| values.iter().sum::<f64>() / values.len() as f64);
            let largest = values.each_ref().map(|values| values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
            values.iter().all(|values| !values.is_empty()).then(|| SignalChange { name: name.clone(), mean, largest })
        });
        Self { signals: signals.collect(), divergence }
    }
}

/// The first frame with any difference, and the first with a visible one and its body.
fn diverges(before: &Trace, after: &Trace) -> (Option<usize>, Option<(usize, String)>) {
    let shared: Vec<(usize, usize)> = before
        .bodies
        .iter()
        .enumerate()
        .filter_map(|(at, part)| Some((at, after.bodies.iter().position(|other| other.name == part.name)?)))
        .collect();
    let frames = before.frames().min(after.frames());
    let mut first = None;
    for frame in 0..frames {
        for (one, two) in &shared {
            let poses = (before.pose(frame, *one), after.pose(frame, *two));
            if poses.0 != poses.1 {
                first.get_or_insert(frame);
            }
            if trace::distance(&poses.0, &poses.1) > VISIBLE_M {
                return (first, before.bodies.get(*one).map(|part| (frame, part.name.clone())));
            }
        }
    }
    let shorter = (before.frames() != after.frames()).then_some(frames);
    (first.or(shorter), None)
}
