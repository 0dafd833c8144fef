//! Reads conditions, measures and skills: once for each word of the task's choice, with the parts that have the roles there.

use robogate_core::{FailureMode, Word};

use super::conditions::{Compiler, Condition};
use super::document::{Document, MeasureTable, Text};
use super::model::{Case, ChoiceModel, How, Measured, Reading};
use super::numbers::{Numbers, Target};
use super::skills::{self, Skill};
use super::syntax::{self, Wrong};
use super::units::Dimension;

impl Reading<'_, '_> {
    /// The failures, without their conditions.
    pub(super) fn failures(&mut self, document: &Document) -> Vec<FailureMode> {
        let mut failures: Vec<FailureMode> = Vec::new();
        for table in &document.failure {
            let Some(name) = self.word(&table.name) else { continue };
            if ["collision", "struck", "timeout"].contains(&name.as_str()) {
                self.problems.of(&table.name, format!("every task has the failure `{name}`. Expected another name"));
            }
            if failures.iter().any(|failure| failure.as_str() == name.as_str()) {
                self.problems.of(&table.name, format!("a second failure `{name}`"));
            }
            let mode = FailureMode::new(name.as_str()).map_err(|why| why.to_string());
            failures.extend(self.problems.take(&table.name, mode));
        }
        failures
    }

    /// The stages, without their conditions.
    pub(super) fn stages(&mut self, document: &Document) -> Vec<Word> {
        let mut stages = Vec::new();
        for table in &document.stage {
            let Some(name) = self.word(&table.name) else { continue };
            if stages.contains(&name) {
                self.problems.of(&table.name, format!("a second stage `{name}`"));
            }
            stages.push(name);
        }
        stages
    }

    /// Everything that can name a role, for each word of the choice, and the measures.
    pub(super) fn cases(
        &mut self,
        document: &Document,
        choice: Option<&ChoiceModel>,
        nominal: &Numbers,
    ) -> (Vec<Case>, Vec<(Word, Dimension)>) {
        let mut words: Vec<Vec<(String, usize)>> = vec![Vec::new()];
        if let Some(choice) = choice {
            let roles = |parts: &Vec<usize>| choice.roles.iter().cloned().zip(parts.iter().copied()).collect();
            words = choice.words.iter().map(|(_, parts)| roles(parts)).collect();
        }
        let (mut cases, mut measures) = (Vec::new(), Vec::new());
        let before = self.problems.found.len();
        for roles in words {
            self.names.roles = roles;
            self.names.conditions.clear();
            measures = Vec::new();
            cases.push(self.case(document, nominal, &mut measures));
            // What is wrong with one word is wrong with the others.
            if self.problems.found.len() > before {
                break;
            }
        }
        (cases, measures)
    }

    fn case(&mut self, document: &Document, nominal: &Numbers, measures: &mut Vec<(Word, Dimension)>) -> Case {
        let mut case = Case::default();
        for table in &document.condition {
            let name = self.word(&table.name);
            if self.names.conditions.iter().any(|(known, _)| *known == table.name.text) {
                self.problems.of(&table.name, format!("a second condition `{}`", table.name.text));
            }
            // A condition that is not read has a slot, so that others that contain it have no problem of their own.
            let condition = self.condition(&table.when, &mut case.slots);
            if name.is_some() {
                self.names.conditions.push((table.name.text.clone(), case.slots));
            }
            case.named.extend(condition.map(|condition| (condition, case.slots)));
            case.slots += 1;
        }
        case.success = self.condition(&document.success.when, &mut case.slots);
        let failures = document.failure.iter().map(|failure| &failure.when);
        case.failures = failures.filter_map(|when| self.condition(when, &mut case.slots)).collect();
        let stages = document.stage.iter().map(|stage| &stage.when);
        case.stages = stages.filter_map(|when| self.condition(when, &mut case.slots)).collect();
        for table in &document.measure {
            self.measure(table, measures, &mut case);
        }
        self.sets(document, nominal, &mut case);
        for part in document.success.carried.iter().flat_map(|text| text.text.split(',')) {
            let found = self.names.part_named(0, part.trim()).map_err(|(_, why)| why);
            case.carried.extend(self.problems.take(&document.success.when, found));
        }
        case.skills = document
            .expert
            .as_ref()
            .map(|expert| expert.skills.iter().filter_map(|text| self.skill(text, &mut case.slots)).collect());
        case
    }

    /// A skill, whose phase may stand before it: `approach: move(lid, 0 cm)`.
    fn skill(&mut self, text: &Text, slots: &mut usize) -> Option<Skill> {
        let (phase, rest) = match text.text.split_once(": ") {
            Some((phase, rest)) => (Some(self.word(&Text { text: phase.to_owned(), at: text.at })?), rest),
            None => (None, text.text.as_str()),
        };
        let skill = self.parse(text, text.text.len() - rest.len(), rest, slots, skills::skill)?;
        Some(Skill { phase: phase.unwrap_or(skill.phase), ..skill })
    }

    fn condition(&mut self, text: &Text, slots: &mut usize) -> Option<Condition> {
        self.parse(text, 0, &text.text, slots, |compiler, node| compiler.condition(node))
    }

    /// Compiles a part of a text, which begins at a byte of it.
    fn parse<T>(
        &mut self,
        text: &Text,
        offset: usize,
        part: &str,
        slots: &mut usize,
        compile: impl FnOnce(&mut Compiler<'_>, &syntax::Node) -> Result<T, Wrong>,
    ) -> Option<T> {
        let mut compiler = Compiler { names: &self.names, slots: *slots };
        let found = syntax::parse(part).and_then(|node| compile(&mut compiler, &node));
        *slots = compiler.slots;
        found.map_err(|(at, why)| self.problems.at(within(text, offset + at), why, "")).ok()
    }

    fn measure(&mut self, table: &MeasureTable, measures: &mut Vec<(Word, Dimension)>, case: &mut Case) {
        let Some(name) = self.word(&table.name) else { return };
        if measures.iter().any(|(known, _)| *known == name) {
            self.problems.of(&table.name, format!("a second measure `{name}`"));
        }
        let mut read: Option<(Dimension, Vec<Measured>)> = None;
        for text in &table.value.0 {
            let Some((measured, dimension)) = self.measured(text, &mut case.slots) else { return };
            let (first, of) = read.get_or_insert((dimension, Vec::new()));
            if *first != dimension {
                self.problems.of(text, format!("the values do not fit: {first}, and {dimension}"));
            }
            of.push(measured);
        }
        let Some((dimension, of)) = read else {
            self.problems.of(&table.name, format!("`{name}` has no value. Expected at least one"));
            return;
        };
        if let Some(problem) = super::units::other_unit(name.as_str(), dimension) {
            self.problems.of(&table.name, problem);
        }
        measures.push((name, dimension));
        case.measures.push(of);
    }

    fn measured(&mut self, text: &Text, slots: &mut usize) -> Option<(Measured, Dimension)> {
        let (what, when) = match text.text.split_once(" when ") {
            Some((what, when)) => (what, Some(when)),
            None => (text.text.as_str(), None),
        };
        let (how, rest) = what.split_once(' ').unwrap_or((what, ""));
        let (how, dimension) = self.parse(text, what.len() - rest.len(), rest, slots, |compiler, node| {
            let value = |compiler: &mut Compiler<'_>, of: fn(super::conditions::Value) -> How| {
                compiler.value(node).map(|(value, dimension)| (of(value), dimension))
            };
            match how {
                "max" => value(compiler, How::Max),
                "min" => value(compiler, How::Min),
                "final" => value(compiler, How::Final),
                "first" => Ok((How::First(compiler.condition(node)?), Dimension::TIME)),
                _ => Err((
                    0,
                    format!("found `{how}`. Expected `max VALUE`, `min VALUE`, `final VALUE` or `first CONDITION`"),
                )),
            }
        })?;
        let when =
            match when {
                Some(when) => Some(self.parse(text, text.text.len() - when.len(), when, slots, |compiler, node| {
                    compiler.condition(node)
                })?),
                None => None,
            };
        Some((Measured { how, when }, dimension))
    }

    /// The numbers of bodies that follow from parameters.
    fn sets(&mut self, document: &Document, nominal: &Numbers, case: &mut Case) {
        let mut taken: Vec<Target> = Vec::new();
        for table in &document.set {
            for path in table.numbers.text.split(',') {
                let target = self.names.target(path.trim(), nominal);
                let Some((target, dimension)) = self.problems.take(&table.numbers, target) else { continue };
                if taken.contains(&target) {
                    self.problems.of(&table.numbers, format!("a second value for `{}`", path.trim()));
                }
                taken.push(target);
                let value = self.parse(&table.to, 0, &table.to.text, &mut case.slots, |compiler, node| {
                    compiler.constant(node, dimension)
                });
                case.sets.extend(value.map(|value| (target, value)));
            }
        }
    }
}

/// A byte of the file: a byte of a text in it, after the quote.
fn within(text: &Text, at: usize) -> usize {
    // A text over several lines begins after its quotes; others are on one line.
    text.at + text.text.get(..at).unwrap_or_default().len() + 1
}
