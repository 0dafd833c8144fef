//! The first pass over an export: derives space and task from the rows.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{Domain, FailureMode, Parameter, ParameterSpace, Word};

use super::Field;
use super::plan::Plan;
use crate::columns::{Columns, Layout};
use crate::export::{Number, number};
use crate::fields::{MOST_WORDS, continuous, integers};
use crate::raw::MOST_MODES;
use crate::results::{About, Format, task};
use crate::{DictionaryError, Engine, Provenance, Robot, RowPlace, SCHEMA_VERSION, Source, Tool};

/// The results of the first pass.
pub(super) struct Survey<'a> {
    path: &'a Path,
    names: Vec<String>,
    layout: Layout,
    measures: Vec<Word>,
    draws: Vec<Word>,
    places: Places,
    parameters: Vec<Observed>,
    modes: BTreeSet<FailureMode>,
    /// The phases, in order of appearance.
    phases: Vec<Word>,
    seed: Option<u64>,
    rows: u64,
    /// Valid episodes without a cycle time.
    without_time: u64,
}

/// Positions of the columns that this pass reads.
struct Places {
    seed: usize,
    outcome: usize,
    time: usize,
    phase: usize,
}

/// The values of one parameter.
struct Observed {
    numbers: Numbers,
    /// The distinct texts. `None` if there are too many for a category.
    words: Option<BTreeSet<String>>,
}

enum Numbers {
    Nothing,
    Integers(i64, i64),
    Reals(f64, f64),
    /// Not every value is a number.
    No,
}

impl<'a> Survey<'a> {
    pub(super) fn new(path: &'a Path, names: &[String]) -> Result<Self, DictionaryError> {
        let place = |name: &str| names.iter().position(|column| column == name);
        let layout = Layout::of(names);
        let places = || {
            let (seed, outcome) = (place("seed")?, place("outcome")?);
            Some(Places { seed, outcome, time: place("cycle_time_s")?, phase: place("phase")? })
        };
        let (Some(layout), Some(places)) = (layout, places()) else { return Err(other_columns(path)) };
        let words = |columns: std::ops::Range<usize>| {
            let word =
                |name: &String| Word::new(name).map_err(|why| DictionaryError::results(path, format!("column {why}")));
            names[columns].iter().map(word).collect::<Result<Vec<Word>, _>>()
        };
        let (measures, draws) = (words(layout.measures.clone())?, words(layout.draws.clone())?);
        let parameters = layout.parameters.clone();
        Ok(Self {
            path,
            names: names.to_vec(),
            measures,
            draws,
            places,
            parameters: parameters
                .map(|_| Observed { numbers: Numbers::Nothing, words: Some(BTreeSet::new()) })
                .collect(),
            layout,
            modes: BTreeSet::new(),
            phases: Vec::new(),
            seed: None,
            rows: 0,
            without_time: 0,
        })
    }

    pub(super) fn row(&mut self, fields: &[Field]) -> Result<(), DictionaryError> {
        for (at, observed) in self.layout.parameters.clone().zip(&mut self.parameters) {
            if fields[at] != Field::Missing {
                observed.take(&fields[at]);
            }
        }
        let Places { seed, outcome, time, phase } = self.places;
        if self.seed.is_none() {
            self.seed = fields[seed].text().and_then(|text| text.parse().ok());
        }
        let ending = fields[outcome].text().unwrap_or_default();
        if !["success", "invalid"].contains(&ending) {
            let mode = FailureMode::new(ending)
                .map_err(|why| wrong(self.path, self.rows, &self.names[outcome], "the text", &why.to_string()))?;
            self.modes.insert(mode);
        }
        if let Some(text) = fields[phase].text() {
            let word = Word::new(text)
                .map_err(|why| wrong(self.path, self.rows, &self.names[phase], "the text", &why.to_string()))?;
            if !self.phases.contains(&word) {
                self.phases.push(word);
            }
        }
        if self.modes.len().max(self.phases.len()) > MOST_MODES {
            let reason = format!("{}: it has more than {MOST_MODES} failure modes or phases", RowPlace::Row(self.rows));
            return Err(DictionaryError::results(self.path, reason));
        }
        self.without_time += u64::from(ending != "invalid" && fields[time] == Field::Missing);
        self.rows += 1;
        Ok(())
    }

    /// Returns the provenance and the conversion from rows to entries.
    pub(super) fn plan(self, format: Format, sha256: &str, about: &About) -> Result<Plan<'a>, DictionaryError> {
        if self.rows == 0 {
            return Err(DictionaryError::results(self.path, "it has no episodes. Expected at least one row"));
        }
        let parameters = self.names[self.layout.parameters.clone()].iter().zip(self.parameters);
        let parameters = parameters
            .map(|(name, observed)| {
                Ok(Parameter { name: name.as_str().into(), domain: observed.domain(self.path, name)? })
            })
            .collect::<Result<_, DictionaryError>>()?;
        let space = ParameterSpace::new("imported", parameters)?;
        let mut task = task::of_rows(about, self.modes, &self.measures, self.phases);
        task.draws = self.draws.iter().map(|name| task::draw(*name)).collect();
        let columns = Columns::of(&task, &space)?;
        if !columns.specs().iter().map(|spec| &spec.name).eq(&self.names) {
            return Err(other_columns(self.path));
        }
        let mut notes = vec![
            "An export holds no task: failure modes, measures and phases are those of its rows.".to_owned(),
            "Ranges are the observed ones.".to_owned(),
            "Engine, robot and policy are known by name at most: no hash identifies what was judged.".to_owned(),
        ];
        let mut not_recorded = Vec::new();
        if self.without_time > 0 {
            not_recorded.push("cycle_time_s".to_owned());
            notes.push(format!("Episodes without a cycle time: {}.", self.without_time));
        }
        let name = |given: &Option<String>| given.as_deref().unwrap_or("unknown").to_owned();
        let provenance = Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: None,
            engine: Engine { name: name(&about.simulator), version: None, build_sha256: None },
            task: Arc::new(task),
            robot: Robot { name: name(&about.robot), sha256: None, dimensions: None },
            policy: name(&about.policy),
            world: None,
            space,
            plan: serde_json::Value::Null,
            seed: self.seed.unwrap_or_default(),
            question_sha256: None,
            platform: None,
            source: Some(Source {
                format: format!("robogate_{format}"),
                sha256: sha256.to_owned(),
                notes,
                not_recorded,
                columns: Vec::new(),
                sampling: about.sampling,
                stopping: about.stopping,
            }),
        };
        Ok(Plan { path: self.path, provenance, columns, row: 0 })
    }
}

impl Observed {
    fn take(&mut self, field: &Field) {
        let text = field.text().unwrap_or_default();
        if let Some(words) = &mut self.words
            && !words.contains(text)
        {
            words.insert(text.to_owned());
            if words.len() > MOST_WORDS {
                self.words = None;
            }
        }
        let value = match field {
            Field::Bare(text) => number(text),
            Field::Missing | Field::Text(_) => None,
        };
        self.numbers = match (&self.numbers, value) {
            (Numbers::No, _) | (_, None) => Numbers::No,
            (Numbers::Nothing, Some(Number::Integer(n))) => Numbers::Integers(n, n),
            (Numbers::Nothing, Some(Number::Real(x))) => Numbers::Reals(x, x),
            (Numbers::Integers(low, high), Some(Number::Integer(n))) => Numbers::Integers(n.min(*low), n.max(*high)),
            (Numbers::Integers(low, high), Some(Number::Real(x))) => {
                Numbers::Reals(x.min(*low as f64), x.max(*high as f64))
            }
            (Numbers::Reals(low, high), Some(Number::Integer(n))) => {
                Numbers::Reals(low.min(n as f64), high.max(n as f64))
            }
            (Numbers::Reals(low, high), Some(Number::Real(x))) => Numbers::Reals(low.min(x), high.max(x)),
        };
    }

    fn domain(self, path: &Path, name: &str) -> Result<Domain, DictionaryError> {
        match (self.numbers, self.words) {
            (Numbers::Integers(low, high), _) => Ok(integers(low, high)),
            (Numbers::Reals(low, high), _) => Ok(continuous(low, high)),
            (_, Some(words)) => {
                Ok(Domain::Categorical { choices: words.iter().map(|word| word.as_str().into()).collect() })
            }
            (_, None) => {
                let reason = format!("column `{name}` has more than {MOST_WORDS} distinct words");
                Err(DictionaryError::results(path, reason))
            }
        }
    }
}

fn other_columns(path: &Path) -> DictionaryError {
    DictionaryError::results(
        path,
        "it has some columns of an export, but not all of them in order\nHint: import the unmodified file that `robogate export` wrote",
    )
}

fn wrong(path: &Path, row: u64, column: &str, value: &str, reason: &str) -> DictionaryError {
    DictionaryError::Value {
        path: path.to_owned(),
        place: RowPlace::Row(row),
        column: column.to_owned(),
        value: value.to_owned(),
        reason: reason.to_owned(),
    }
}
