//! The meaning of a file: bodies, parameters, conditions and skills, with every name resolved.

use robogate_core::budget::Budget;
use robogate_core::{FailureMode, Word};
use robogate_physics::{Color, GRAVITY, Part};

use super::conditions::{Condition, Value};
use super::document::{Document, Text};
use super::foresight::{self, PlugIn};
use super::meshes::{Files, Find, Meshes};
use super::names::{Names, RESERVED, Region};
use super::numbers::{Numbers, Placed, Target};
use super::problem::{Problem, Problems};
use super::skills::Skill;
use super::units::{Dimension, quantities};
use crate::arm::CONTROL_PERIOD_S;

/// The format that this program reads.
pub(super) const FORMAT: &str = "robogate-task/1";

/// The largest file. A file of 10 parts has about 10 kB.
const BUDGET: Budget = Budget { bytes: 64 << 10, values: 1 << 16, depth: 8 };
/// The largest number of parts, of shapes of all bodies, and of entries of other lists.
const MOST_PARTS: usize = 16;
const MOST_SHAPES: usize = 512;
/// The largest number of convex shapes of all bodies: shapes, and pieces of meshes.
const MOST_CONVEX: usize = 512;
const MOST_ENTRIES: usize = 64;

/// Friction coefficient of the parts, if the file states none.
const FRICTION: f64 = 0.7;

/// A task as a file describes it.
#[derive(Debug)]
pub(super) struct Model {
    /// The file as it is written.
    pub(super) document: Document,
    pub(super) name: Word,
    pub(super) time_limit_s: f64,
    pub(super) fixtures: Vec<FixtureModel>,
    pub(super) parts: Vec<PartModel>,
    pub(super) parameters: Vec<ParameterModel>,
    /// The numbers of the file, with nominal values of the parameters.
    pub(super) nominal: Numbers,
    pub(super) choice: Option<ChoiceModel>,
    pub(super) settings: Vec<SettingModel>,
    /// The built-in space that campaigns sample.
    pub(super) space: Option<&'static str>,
    pub(super) suite: Option<Word>,
    /// What is known about episodes before they run, by its name.
    pub(super) foresight: Option<(&'static str, PlugIn)>,
    pub(super) failures: Vec<FailureMode>,
    pub(super) stages: Vec<Word>,
    /// The measures with the dimension of their values.
    pub(super) measures: Vec<(Word, Dimension)>,
    /// Conditions and skills for each word of the choice, or for a task without a choice.
    pub(super) cases: Vec<Case>,
    /// The text of the file.
    pub(super) text: String,
    /// The files that it names.
    pub(super) files: Files,
    /// What was measured for each mesh, and left out of each MJCF file.
    pub(super) figures: Vec<String>,
}

/// A body that stands still.
#[derive(Debug)]
pub(super) struct FixtureModel {
    pub(super) name: String,
    pub(super) shapes: Vec<Part>,
    /// Indices of its shapes in the scene.
    pub(super) range: std::ops::Range<usize>,
    pub(super) touch: bool,
    pub(super) color: Option<Color>,
}

/// A body that moves.
#[derive(Debug)]
pub(super) struct PartModel {
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    pub(super) start: Option<Region>,
    pub(super) color: Option<Color>,
}

/// A parameter.
#[derive(Debug)]
pub(super) struct ParameterModel {
    pub(super) name: Word,
    pub(super) target: Target,
    pub(super) dimension: Dimension,
    pub(super) range: [f64; 2],
    pub(super) nominal: f64,
    pub(super) meaning: String,
    pub(super) family: Option<Word>,
    pub(super) told: bool,
}

/// The parameter that says which parts have which roles.
#[derive(Debug)]
pub(super) struct ChoiceModel {
    pub(super) name: Word,
    pub(super) roles: Vec<String>,
    /// The words, with the part of each role.
    pub(super) words: Vec<(String, Vec<usize>)>,
    pub(super) nominal: usize,
    pub(super) meaning: String,
    pub(super) family: Option<Word>,
}

/// A number that a user can set.
#[derive(Debug)]
pub(super) struct SettingModel {
    pub(super) name: Word,
    pub(super) range: [f64; 2],
    pub(super) default: f64,
}

/// Conditions and skills, with every role resolved.
#[derive(Debug, Default)]
pub(super) struct Case {
    /// Named conditions, each with the slot of its result.
    pub(super) named: Vec<(Condition, usize)>,
    pub(super) success: Option<Condition>,
    pub(super) failures: Vec<Condition>,
    pub(super) stages: Vec<Condition>,
    /// What each measure records.
    pub(super) measures: Vec<Vec<Measured>>,
    pub(super) skills: Option<Vec<Skill>>,
    /// Numbers that follow from parameters.
    pub(super) sets: Vec<(Target, Value)>,
    /// Parts that every policy must carry.
    pub(super) carried: Vec<usize>,
    /// Number of slots in the memory of conditions.
    pub(super) slots: usize,
}

impl Case {
    /// Every condition of the task except those with a name.
    pub(super) fn conditions(&self) -> impl Iterator<Item = &Condition> {
        self.success.iter().chain(&self.failures).chain(&self.stages)
    }
}

/// What a measure records in one of its texts, and when.
#[derive(Debug)]
pub(super) struct Measured {
    pub(super) how: How,
    pub(super) when: Option<Condition>,
}

/// A number that a measure records.
#[derive(Debug)]
pub(super) enum How {
    Max(Value),
    Min(Value),
    Final(Value),
    First(Condition),
}

impl Model {
    /// Reads a file.
    ///
    /// # Errors
    /// Every problem that was found.
    pub(super) fn read(text: &str, find: Find<'_>) -> Result<Self, Vec<Problem>> {
        let mut problems = Problems::new(text);
        if let Err(error) = BUDGET.check_toml(text) {
            problems.at(0, error.to_string(), "a task's file contains numbers and names, not data");
            return Err(problems.found);
        }
        let document: Document = match toml::from_str(text) {
            Ok(document) => document,
            Err(error) => {
                problems.syntax(&error);
                return Err(problems.found);
            }
        };
        let reading = Reading {
            problems: &mut problems,
            names: Names::default(),
            meshes: Meshes::new(find),
            left_out: Vec::new(),
        };
        let model = reading.model(document, text);
        match model {
            Some(model) if problems.found.is_empty() => Ok(model),
            _ => {
                problems.found.sort_by_key(|problem| problem.line);
                Err(problems.found)
            }
        }
    }

    /// The names of its regions.
    pub(super) fn region_names(&self) -> impl Iterator<Item = &str> {
        self.document.region.iter().map(|table| table.name.text.as_str())
    }

    /// Whether the file has an expert.
    pub(super) fn has_expert(&self) -> bool {
        self.cases.iter().any(|case| case.skills.is_some())
    }

    /// The index of the value of a parameter or setting.
    pub(super) fn number_named(&self, name: &str) -> Option<usize> {
        let settings = self.settings.iter().map(|setting| setting.name);
        self.parameters.iter().map(|parameter| parameter.name).chain(settings).position(|known| known.as_str() == name)
    }

    /// The lowest value of a parameter or setting.
    pub(super) fn lowest(&self, name: &str) -> Option<f64> {
        let settings = self.settings.iter().map(|setting| (setting.name, setting.range));
        let mut all = self.parameters.iter().map(|parameter| (parameter.name, parameter.range)).chain(settings);
        all.find(|(known, _)| known.as_str() == name).map(|(_, [low, _])| low)
    }

    /// The part that has a role with this word of the choice.
    pub(super) fn in_role(&self, word: usize, role: &str) -> Option<usize> {
        let choice = self.choice.as_ref()?;
        let index = choice.roles.iter().position(|known| known == role)?;
        choice.words[word].1.get(index).copied()
    }

    /// The skills of the expert with this word of the choice.
    pub(super) fn skills(&self, word: usize) -> &[Skill] {
        self.cases[word].skills.as_deref().unwrap_or_default()
    }

    /// Whether only an engine of this process can simulate the task and judge it.
    pub(super) fn is_local(&self) -> bool {
        let local = |case: &Case| {
            let named = case.named.iter().map(|(condition, _)| condition);
            let measured = case.measures.iter().flatten().any(|of| {
                of.when.as_ref().is_some_and(Condition::is_local)
                    || match &of.how {
                        How::Max(value) | How::Min(value) | How::Final(value) => value.is_local(),
                        How::First(condition) => condition.is_local(),
                    }
            });
            measured || case.conditions().chain(named).any(Condition::is_local)
        };
        let moves = self.nominal.motions.iter().any(Option::is_some);
        moves
            || !self.files.is_empty()
            || self.nominal.parts.iter().any(|part| part.joint.is_some() || part.friction.is_some())
            || self.nominal.frictions.iter().any(Option::is_some)
            || self.fixtures.iter().any(|fixture| fixture.touch)
            || self.cases.iter().any(local)
    }

    /// The frame that each part's position refers to.
    pub(super) fn parents(&self) -> Vec<Option<usize>> {
        self.parts.iter().map(|part| part.parent).collect()
    }
}

/// A file that is being read.
pub(super) struct Reading<'a, 'b> {
    pub(super) problems: &'a mut Problems<'b>,
    pub(super) names: Names,
    pub(super) meshes: Meshes<'a>,
    /// What was left out of MJCF files, as lines.
    pub(super) left_out: Vec<String>,
}

impl Reading<'_, '_> {
    fn model(mut self, mut document: Document, text: &str) -> Option<Model> {
        if document.format.text != FORMAT {
            self.problems
                .of(&document.format, format!("unknown format `{}`. Expected `{FORMAT}`", document.format.text));
        }
        self.fragments(&mut document);
        self.check_sizes(&document);
        let name = self.word(&document.name);
        let time_limit_s = self.time_limit(&document.time_limit);
        let mut nominal = Numbers {
            friction: self.optional(document.scene.friction.as_ref(), Dimension::NONE, [0.01, 10.0], FRICTION),
            gravity: self.optional(document.scene.gravity.as_ref(), Dimension::ACCELERATION, [0.0, 30.0], GRAVITY),
            scale: 1.0,
            ..Numbers::default()
        };
        let fixtures = self.fixtures(&document, &mut nominal);
        // Regions may be in parts, and parts may start in regions: names first.
        let parts = self.parts(&document, &mut nominal);
        self.threads(&document, &mut nominal);
        let convex = fixtures.iter().map(|fixture| fixture.shapes.len()).sum::<usize>()
            + nominal.parts.iter().map(|part| part.shapes.len()).sum::<usize>();
        if convex > MOST_CONVEX {
            let what = format!("the bodies have {convex} convex shapes. At most {MOST_CONVEX} are accepted");
            self.problems.at(0, what, "give meshes fewer `pieces`");
        }
        self.regions(&document);
        let parts = self.with_starts(&document, parts);
        let parameters = self.parameters(&document, &mut nominal);
        let settings = self.settings(&document, &mut nominal);
        let choice = document.choice.as_ref().and_then(|table| self.choice(table));
        let space = document.space.as_ref().and_then(|text| {
            let known = crate::spaces::built_in_spaces();
            let found = known.clone().find(|name| *name == text.text);
            let why = || format!("unknown parameter space `{}`: {}", text.text, robogate_core::hint(&text.text, known));
            self.problems.take(text, found.ok_or_else(why))
        });
        let suite = document.suite.as_ref().and_then(|text| {
            let word = Word::new(&text.text).map_err(|why| why.to_string());
            self.problems.take(text, word)
        });
        let foresight = document.foresight.as_ref().and_then(|text| {
            let known = foresight::PLUG_INS.iter();
            let found = known.clone().find(|(name, _)| *name == text.text).copied();
            let why = || {
                let names = known.map(|(name, _)| *name);
                format!("unknown foresight `{}`: {}", text.text, robogate_core::hint(&text.text, names))
            };
            self.problems.take(text, found.ok_or_else(why))
        });
        let failures = self.failures(&document);
        let stages = self.stages(&document);
        let (cases, measures) = self.cases(&document, choice.as_ref(), &nominal);
        if let Some(choice) = &choice {
            nominal.word = choice.nominal;
            self.names.roles = choice.roles.iter().map(|role| (role.clone(), 0)).collect();
        }
        check_instruction(self.problems, &self.names, &document.instruction);
        let model = Model {
            name: name?,
            time_limit_s: time_limit_s?,
            fixtures,
            parts,
            parameters,
            nominal,
            choice,
            settings,
            space,
            suite,
            foresight,
            failures,
            stages,
            measures,
            cases,
            text: text.to_owned(),
            files: self.meshes.files,
            figures: self.meshes.figures.into_iter().chain(self.left_out).collect(),
            document,
        };
        if let (Some(text), Some((_, plug_in))) = (&model.document.foresight, foresight) {
            self.problems.take(text, (plug_in.suits)(&model));
        }
        Some(model)
    }

    fn check_sizes(&mut self, document: &Document) {
        let shapes = document.fixture.iter().map(|fixture| &fixture.shapes);
        let shapes = shapes.chain(document.part.iter().map(|part| &part.shapes)).map(Vec::len).sum();
        let points = document.part.iter().map(|part| part.points.len()).sum();
        for (what, count, most) in [
            ("parts", document.part.len(), MOST_PARTS),
            ("shapes", shapes, MOST_SHAPES),
            ("points", points, MOST_ENTRIES),
            ("regions", document.region.len(), MOST_ENTRIES),
            ("parameters", document.parameter.len(), MOST_ENTRIES),
            ("settings", document.setting.len(), MOST_ENTRIES),
            ("entries of `set`", document.set.len(), MOST_ENTRIES),
            ("conditions", document.condition.len(), MOST_ENTRIES),
            ("values of measures", document.measure.iter().map(|of| of.value.0.len()).sum(), MOST_ENTRIES),
            ("failures", document.failure.len(), MOST_ENTRIES),
            ("stages", document.stage.len(), MOST_ENTRIES),
            ("measures", document.measure.len(), MOST_ENTRIES),
            ("skills", document.expert.as_ref().map_or(0, |expert| expert.skills.len()), MOST_ENTRIES),
        ] {
            if count > most {
                self.problems.at(0, format!("the file has {count} {what}. At most {most} are accepted"), "");
            }
        }
        if document.part.is_empty() {
            let hint = "a `[[part]]`, or a body of an `[[mjcf]]` file with a joint or with `free = true`";
            self.problems.at(0, "the file has no part. Expected at least one", hint);
        }
    }

    fn time_limit(&mut self, text: &Text) -> Option<f64> {
        let seconds = self.number(text, Dimension::TIME, [CONTROL_PERIOD_S, 3600.0])?;
        let periods = seconds / CONTROL_PERIOD_S;
        if (periods - periods.round()).abs() > 1e-6 {
            self.problems.of(text, format!("`{}`: expected a multiple of {CONTROL_PERIOD_S} s", text.text));
        }
        Some(seconds)
    }

    pub(super) fn word(&mut self, text: &Text) -> Option<Word> {
        word(self.problems, text)
    }

    /// A new name of a body or a region.
    pub(super) fn name(&mut self, text: &Text) -> String {
        self.word(text);
        let name = &text.text;
        let names = &self.names;
        let taken = names.fixtures.iter().map(|(name, _)| name).chain(names.parts.iter().map(|(name, _)| name));
        let mut taken = taken.chain(names.regions.iter().map(|(name, _)| name));
        if taken.any(|taken| taken == name) {
            self.problems.of(text, format!("a second body or region `{name}`. Expected different names"));
        }
        if RESERVED.contains(&&**name) || name.contains('.') {
            self.problems.of(text, format!("`{name}` has a meaning of its own. Expected another name"));
        }
        name.clone()
    }

    pub(super) fn number(&mut self, text: &Text, dimension: Dimension, range: [f64; 2]) -> Option<f64> {
        let [value] = self.problems.take(text, quantities::<1>(&text.text, dimension))?;
        if !(range[0]..=range[1]).contains(&value) {
            let (unit, [low, high]) = (dimension.unit(), range);
            self.problems.of(text, format!("`{}` is out of range. Expected {low} to {high} {unit}", text.text));
        }
        Some(value)
    }

    pub(super) fn optional(&mut self, text: Option<&Text>, dimension: Dimension, range: [f64; 2], or: f64) -> f64 {
        text.and_then(|text| self.number(text, dimension, range)).unwrap_or(or)
    }

    pub(super) fn triple(&mut self, text: Option<&Text>, dimension: Dimension) -> [f64; 3] {
        let Some(text) = text else { return [0.0; 3] };
        let found = self.problems.take(text, quantities(&text.text, dimension)).unwrap_or_default();
        if dimension == Dimension::LENGTH && found.iter().any(|x: &f64| x.abs() > 10.0) {
            self.problems.of(text, format!("`{}` is out of range. Expected at most 10 m", text.text));
        }
        found
    }

    pub(super) fn placed(&mut self, at: Option<&Text>, rotation: Option<&Text>) -> Placed {
        Placed { at: self.triple(at, Dimension::LENGTH), rotation: self.triple(rotation, Dimension::ANGLE) }
    }
}

fn word(problems: &mut Problems<'_>, text: &Text) -> Option<Word> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !text.text.starts_with(|c: char| c.is_ascii_lowercase()) || !text.text.chars().all(plain) {
        problems.of(text, format!("`{}`: expected a name of lower-case letters, digits and `_`", text.text));
        return None;
    }
    problems.take(text, Word::new(&text.text).map_err(|why| why.to_string()))
}

/// The names in braces of an instruction.
pub(super) fn braces(text: &str) -> impl Iterator<Item = &str> {
    text.split('{').skip(1).filter_map(|rest| rest.split_once('}')).map(|(name, _)| name)
}

fn check_instruction(problems: &mut Problems<'_>, names: &Names, text: &Text) {
    for name in braces(&text.text).filter(|name| !names.roles.iter().any(|(role, _)| role == name)) {
        if let Err((_, why)) = names.parameter(0, name) {
            problems.of(text, why);
        }
    }
}
