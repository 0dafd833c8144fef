//! The analysis of one dictionary: every figure with what it speaks of.

use std::path::Path;

use robogate_dictionary::Provenance;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::along::{Along, along};
use crate::drawn::{HowDrawn, drawn};
use crate::failures::{DangerZones, FailureModes};
use crate::headline::{Headline, headline};
use crate::limits::limits;
use crate::models::{Frontier, Regression, RiskModel, frontier, interactions, risk};
use crate::pairs::{self, PairMap, default_pair};
use crate::replay::{ReplayGroup, worth_replaying};
use crate::rows::{Rows, Sample};
use crate::{Finding, Population, ReportError, Source, Success};

/// The analysis of one dictionary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Analysis {
    /// The version of this form.
    pub version: u32,
    /// What was analysed.
    pub subject: Subject,
    /// The answer in plain words.
    pub headline: Headline,
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
    /// The paper's standardised model with interactions.
    pub interactions: Finding<Regression>,
    /// The paper's risk model.
    pub risk: Finding<RiskModel>,
    /// How the points were drawn.
    pub drawn: HowDrawn,
    /// Episodes worth seeing again.
    pub replay: Vec<ReplayGroup>,
    /// What these figures do not say.
    pub limits: Vec<String>,
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
    pub const VERSION: u32 = 1;

    /// Analyses a source that was opened from `path`. `pairs` names what is mapped beside the usual pair.
    ///
    /// # Errors
    /// A column that cannot be read, or a pair that is not there.
    pub fn of(source: &Source, path: &Path, named: &[(String, String)]) -> Result<Self, ReportError> {
        let dictionary = source.dictionary();
        let rows = Rows::read(dictionary)?;
        let (base, focused, population) = populations(&rows);
        for (first, second) in named {
            pairs::check(&base, first, second)?;
        }
        let along: Vec<Along> = base.parameters.iter().map(|parameter| along(&rows, &base, parameter)).collect();
        let mut wanted: Vec<(String, String)> = default_pair(&base, &along).into_iter().collect();
        for pair in named {
            if !wanted.contains(pair) {
                wanted.push(pair.clone());
            }
        }
        let envelopes = wanted.iter().filter_map(|(up, across)| envelope(&base, up, across)).collect();
        let (risk, scored) = match risk(&base) {
            Finding::Estimated((model, scored)) => (Finding::Estimated(model), Some(scored)),
            Finding::CannotBeEstimated { because } => (Finding::CannotBeEstimated { because }, None),
        };
        let provenance = dictionary.provenance().clone();
        let mut analysis = Self {
            version: Self::VERSION,
            subject: Subject::of(source, path),
            headline: Headline::default(),
            population,
            success: Success::of(&rows, &base, focused.as_ref(), population),
            envelopes,
            failure_modes: FailureModes::of(&rows, &base),
            danger_zones: DangerZones::of(&along),
            along,
            interactions: interactions(&base),
            risk,
            drawn: drawn(source, &rows),
            replay: worth_replaying(&rows, &base, scored.as_ref()),
            limits: Vec::new(),
            provenance,
        };
        analysis.headline = headline(&analysis);
        analysis.limits = limits(&analysis);
        Ok(analysis)
    }

    /// The document as JSON, the same bytes for the same rows.
    pub fn to_json(&self) -> String {
        // A tree of strings, finite numbers and maps with string keys cannot fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The JSON Schema of the document.
    pub fn schema() -> String {
        serde_json::to_string_pretty(&schemars::schema_for!(Self)).unwrap_or_default()
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

/// The parameters that the space draws together with others, as people write them, in the order of the space.
pub(crate) fn drawn_together(analysis: &Analysis) -> Vec<String> {
    let along = analysis.along.iter().filter(|along| is_drawn_together(analysis, &along.parameter));
    along.map(|along| along.label.clone()).collect()
}

/// Whether the space draws this parameter together with another one.
pub(crate) fn is_drawn_together(analysis: &Analysis, parameter: &str) -> bool {
    let correlations = analysis.provenance.space.correlations();
    correlations.iter().any(|c| c.parameters.iter().any(|name| **name == *parameter))
}

fn envelope(base: &Sample, up: &str, across: &str) -> Option<Envelope> {
    let (up, across) = (base.parameter(up)?, base.parameter(across)?);
    let map = match pairs::map(base, up, across) {
        Some(map) => Finding::Estimated(map),
        None => Finding::not("one of the two parameters cannot be cut into cells"),
    };
    Some(Envelope { map, frontier: frontier(base, up, across) })
}
