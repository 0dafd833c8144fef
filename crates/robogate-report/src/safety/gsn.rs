//! The argument as YAML in the format of gsn2x.

use std::fmt::Write;

use robogate_stats::format::is_deceptive;

use super::{Answered, Claim, Defeater, NoteKind, SafetyCase, Solution};

impl SafetyCase {
    /// The argument in Goal Structuring Notation: YAML as gsn2x reads it. Equal arguments give equal bytes.
    ///
    /// `status`, `because`, `sha256` and `clause` are additional attributes, which gsn2x keeps.
    pub fn to_gsn(&self) -> String {
        let mut yaml = Yaml(
            "# Goal Structuring Notation (GSN Community Standard, version 3) in the format of gsn2x 4. Made by RoboGate from the evidence \
             beside it.\n"
                .to_owned(),
        );
        let notes: Vec<String> = self.notes.iter().map(|note| format!("{}-{}", prefix(note.kind), note.name)).collect();
        let clauses: Vec<String> = (1..=self.clauses.len()).map(|at| format!("C-clause-{at}")).collect();
        self.claim(&mut yaml, &self.claim, &notes);
        for (name, note) in notes.iter().zip(&self.notes) {
            yaml.element(name, &note.text);
        }
        for (name, clause) in clauses.iter().zip(&self.clauses) {
            let text = format!(
                "{}, {}: {}. The evidence can contribute {}.",
                clause.source, clause.number, clause.title, clause.contributes
            );
            yaml.element(name, &text);
            yaml.text("clause", &format!("{} {}", clause.source, clause.number));
        }
        yaml.0
    }

    fn claim(&self, yaml: &mut Yaml, claim: &Claim, context: &[String]) {
        let id = format!("G-{}", claim.name);
        yaml.element(&id, &claim.text);
        yaml.text("status", claim.support.as_str());
        yaml.text("because", &claim.because);
        let strategy = format!("S-{}", claim.name);
        // Each claim has solutions of its own: gsn2x draws a tree.
        let solutions: Vec<&Solution> = self.solutions_in(&claim.files).collect();
        let names: Vec<String> = (1..=solutions.len()).map(|at| format!("Sn-{}-{at}", claim.name)).collect();
        let below = if claim.parts.is_empty() { names.clone() } else { vec![strategy.clone()] };
        if below.is_empty() {
            yaml.yes("undeveloped");
        } else {
            yaml.list("supportedBy", &below);
        }
        let clauses =
            self.clauses.iter().enumerate().filter(|(_, clause)| clause.claims.contains(&claim.name.as_str()));
        let clauses = clauses.map(|(at, _)| format!("C-clause-{}", at + 1));
        yaml.list("inContextOf", &context.iter().cloned().chain(clauses).collect::<Vec<String>>());
        if claim.defeaters.iter().any(|defeater| defeater.state == Answered::Confirmed) {
            yaml.yes("defeated");
        }
        for (name, solution) in names.iter().zip(&solutions) {
            yaml.element(name, &format!("{}: {}. SHA-256 {}", solution.path, solution.what, solution.sha256));
            yaml.text("sha256", &solution.sha256);
            yaml.text("url", &solution.path);
        }
        for defeater in &claim.defeaters {
            self.defeater(yaml, defeater, &id);
        }
        if !claim.parts.is_empty() {
            yaml.element(&strategy, &claim.strategy);
            yaml.list(
                "supportedBy",
                &claim.parts.iter().map(|part| format!("G-{}", part.name)).collect::<Vec<String>>(),
            );
            claim.parts.iter().for_each(|part| self.claim(yaml, part, &[]));
        }
    }

    /// The solutions with these paths.
    fn solutions_in(&self, paths: &[String]) -> impl Iterator<Item = &Solution> {
        paths.iter().filter_map(|path| self.solutions.iter().find(|solution| solution.path == *path))
    }

    /// A defeater is a counter goal. Files that confirm it support it; what answers it is a counter solution that challenges it.
    fn defeater(&self, yaml: &mut Yaml, defeater: &Defeater, target: &str) {
        let (id, reason) = (format!("CG-{}", defeater.name), format!("CSn-{}", defeater.name));
        yaml.element(&id, &defeater.text);
        yaml.text("status", defeater.state.as_str());
        yaml.text("challenges", target);
        match defeater.state {
            Answered::Open => {
                yaml.yes("undeveloped");
                yaml.text("because", &defeater.because);
            }
            Answered::Yes => yaml.yes("defeated"),
            Answered::Confirmed => yaml.list("supportedBy", std::slice::from_ref(&reason)),
        }
        if defeater.state != Answered::Open {
            let files = self.solutions_in(&defeater.files).map(|of| format!("{} (SHA-256 {})", of.path, of.sha256));
            let files = files.collect::<Vec<String>>().join(", ");
            let from = if files.is_empty() { String::new() } else { format!(" From {files}.") };
            yaml.element(&reason, &format!("{}{from}", defeater.because));
            if defeater.state == Answered::Yes {
                yaml.text("challenges", &id);
            }
        }
    }
}

fn prefix(kind: NoteKind) -> &'static str {
    match kind {
        NoteKind::Context => "C",
        NoteKind::Assumption => "A",
        NoteKind::Justification => "J",
    }
}

/// A map of elements. JSON strings are double-quoted scalars of YAML.
struct Yaml(String);

impl Yaml {
    fn element(&mut self, id: &str, text: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{id}:");
        self.text("text", text);
    }

    fn text(&mut self, key: &str, text: &str) {
        // YAML allows no control characters, and none may hide or reorder text.
        let text = text.replace(is_deceptive, "\u{fffd}");
        let _ = writeln!(self.0, "  {key}: {}", serde_json::Value::from(text));
    }

    fn yes(&mut self, key: &str) {
        let _ = writeln!(self.0, "  {key}: true");
    }

    fn list(&mut self, key: &str, ids: &[String]) {
        if !ids.is_empty() {
            let _ = writeln!(self.0, "  {key}: [{}]", ids.join(", "));
        }
    }
}
