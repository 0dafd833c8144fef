//! The analysis of one dictionary: every figure with what it speaks of.

use std::path::Path;

use robogate_dictionary::Provenance;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::along::{Along, along};
use crate::claims::{Claims, claims};
use crate::drawn::{HowDrawn, drawn};
use crate::failures::{DangerZones, FailureModes};
use crate::models::{Frontier, Regression, RiskModel, frontier, interactions, risk};
use crate::pairs::{self, PairMap, default_pair};
use crate::replay::{ReplayGroup, worth_replaying};
use crate::rows::{Rows, Sample};
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Finding, Population, Source, Success};

/// The analysis of one dictionary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Analysis {
    /// The version of this form.
    pub version: u32,
    /// What was analysed.
    pub subject: Subject,
    /// What the headline may state.
    pub claims: Claims,
    /// What every figure below speaks of, unless it says otherwise.
    pub population: Population,
    /// How often the policy succeeds.
    pub success: Success,
    /// Success over two parameters at once, with the frontier between success and failure.
    pub envelopes: Vec<Envelope>,
    /// Success along each parameter.
    pub along: Vec<Along>,
    /// How the policy fails.
    pub failure_modes: FailureModes,
    /// Where it surely fails most of the time.
    pub danger_zones: DangerZones,
    /// The published model of the task, standardised, with interactions.
    pub interactions: Finding<Regression>,
    /// The paper's risk model.
    pub risk: Finding<RiskModel>,
    /// How the points were drawn.
    pub drawn: HowDrawn,
    /// Episodes worth seeing again.
    pub replay: Vec<ReplayGroup>,
    /// Where the rows come from.
    pub provenance: Provenance,
}

/// What was analysed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Subject {
    /// The run's folder or the file, as it was named.
    pub path: String,
    /// Whether it is a run's folder, so that its episodes can be replayed.
    pub replayable: bool,
    /// The task; empty where it is not known.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The engine, with its version.
    pub engine: String,
    /// Episodes of all stages, invalid ones included.
    pub episodes: u64,
    /// The content hash of the rows.
    pub dataset_hash: String,
}

impl Subject {
    pub(crate) fn of(source: &Source, path: &Path) -> Self {
        let dictionary = source.dictionary();
        let provenance = dictionary.provenance();
        Self {
            path: path.display().to_string(),
            replayable: source.folder().is_some() && provenance.source.is_none(),
            task: provenance.task.name.as_str().to_owned(),
            robot: provenance.robot.name.clone(),
            policy: provenance.policy.clone(),
            engine: match &provenance.engine.version {
                Some(version) => format!("{} {version}", provenance.engine.name),
                None => provenance.engine.name.clone(),
            },
            episodes: dictionary.len(),
            dataset_hash: dictionary.dataset_hash().to_owned(),
        }
    }
}

/// Success over two parameters at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Envelope {
    /// The observed rates.
    pub map: Finding<PairMap>,
    /// The frontier in closed form, solved for the parameter upwards.
    pub frontier: Finding<Frontier>,
}

impl Analysis {
    /// The version of this form that is written here.
    pub const VERSION: u32 = 2;

    /// Analyses a source that was opened from `path`. `pairs` names what is mapped beside the usual pair.
    ///
    /// # Errors
    /// A column that cannot be read, or a pair that is not there.
    pub fn of(source: &Source, path: &Path, named: &[(String, String)]) -> Result<Self, AnalysisError> {
        let dictionary = source.dictionary();
        let rows = Rows::read(dictionary)?;
        let (base, focused, population) = populations(&rows);
        for (first, second) in named {
            pairs::check(&base, first, second)?;
        }
        let along: Vec<Along> = base.parameters.iter().map(|parameter| along(&rows, &base, parameter)).collect();
        let task = TaskAnalysis::of_dictionary(dictionary.provenance());
        let mut wanted: Vec<(String, String)> = default_pair(&base, &along, task).into_iter().collect();
        for pair in named {
            if !wanted.contains(pair) {
                wanted.push(pair.clone());
            }
        }
        let envelopes = wanted.iter().filter_map(|(up, across)| envelope(&base, up, across)).collect();
        let (risk, scored) = match risk(&base, task) {
            Finding::Estimated((model, scored)) => (Finding::Estimated(model), Some(scored)),
            Finding::CannotBeEstimated { because } => (Finding::CannotBeEstimated { because }, None),
        };
        let provenance = dictionary.provenance().clone();
        let mut analysis = Self {
            version: Self::VERSION,
            subject: Subject::of(source, path),
            claims: Claims::default(),
            population,
            success: Success::of(&rows, &base, focused.as_ref(), population),
            envelopes,
            failure_modes: FailureModes::of(&rows, &base),
            danger_zones: DangerZones::of(&along),
            along,
            interactions: interactions(&base, task),
            risk,
            drawn: drawn(source, &rows),
            replay: worth_replaying(&rows, &base, scored.as_ref(), task),
            provenance,
        };
        analysis.claims = claims(&analysis);
        Ok(analysis)
    }

    /// The parameters that the space samples jointly with others, in the order of the space.
    pub fn jointly_sampled(&self) -> Vec<String> {
        let names = self.along.iter().map(|along| &along.parameter);
        names.filter(|parameter| self.is_jointly_sampled(parameter)).cloned().collect()
    }

    /// Whether the space samples this parameter jointly with another one.
    pub fn is_jointly_sampled(&self, parameter: &str) -> bool {
        let correlations = self.provenance.space.correlations();
        correlations.iter().any(|c| c.parameters.iter().any(|name| **name == *parameter))
    }
}

/// The rows that figures are made from, the focused ones beside them, and what the first speak of.
pub(crate) fn populations(rows: &Rows) -> (Sample, Option<Sample>, Population) {
    let operating = rows.sample(false);
    let focused = rows.sample(true);
    if operating.len() == 0 && focused.len() > 0 {
        return (focused, None, Population::FocusedDesign);
    }
    let any = |name: &str| rows.stages.iter().any(|stage| !stage.focused && stage.name == name);
    let population = if any("imported") {
        Population::AsImported
    } else if any("suite") {
        Population::Suite
    } else {
        Population::OperatingSpace
    };
    (operating, (focused.len() > 0).then_some(focused), population)
}

fn envelope(base: &Sample, up: &str, across: &str) -> Option<Envelope> {
    let (up, across) = (base.parameter(up)?, base.parameter(across)?);
    let map = match pairs::map(base, up, across) {
        Some(map) => Finding::Estimated(map),
        None => Finding::not("one of the two parameters cannot be cut into cells"),
    };
    Some(Envelope { map, frontier: frontier(base, up, across) })
}
