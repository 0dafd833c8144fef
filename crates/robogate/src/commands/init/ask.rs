//! The questions of `robogate init`, and the forms of their answers.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::Path;

use anyhow::{anyhow, bail};
use robogate_core::budget::Budget;
use robogate_policy::{Profile, dialects_at};
use robogate_session::init::{Thing, Wanted};

use crate::number::positive;
use crate::terminal::{foreign, line};

/// The required success rate where the user says none.
pub(super) const SUCCESS: f64 = 0.9;

/// Reads a share: `90%`, `90 %` or `0.9`.
pub(super) fn share(text: &str) -> Result<f64, String> {
    let (number, scale) = match text.trim().strip_suffix('%') {
        Some(number) => (number, 0.01),
        None => (text, 1.0),
    };
    let share = scale * positive(number)?;
    if share < 1.0 { Ok(share) } else { Err("expected less than 100 %, such as 90%".to_owned()) }
}

/// Whether the user can be asked: sees questions and can type.
pub(super) fn can() -> bool {
    io::stdin().is_terminal() && io::stderr().is_terminal()
}

/// Asks until the answer can be read. An empty answer is `None`.
fn question<T>(text: &str, read: impl Fn(&str) -> Result<T, String>) -> anyhow::Result<Option<T>> {
    loop {
        write!(io::stderr(), "{text} ")?;
        io::stderr().flush()?;
        let mut answer = String::new();
        if io::stdin().read_line(&mut answer)? == 0 || answer.trim().is_empty() {
            return Ok(None);
        }
        match read(answer.trim()) {
            Ok(value) => return Ok(Some(value)),
            Err(why) => writeln!(io::stderr(), "  {why}")?,
        }
    }
}

/// Asks for the three figures.
pub(super) fn wanted(collides: bool) -> anyhow::Result<Wanted> {
    let success = question("What share of the cycles must succeed? [90%]", share)?.unwrap_or(SUCCESS);
    let collisions = if collides {
        question("How many collisions in a thousand cycles are allowed? [no requirement]", positive)?
    } else {
        None
    };
    let cycle_time_s = question("How many seconds may a cycle take on average? [no requirement]", positive)?;
    Ok(Wanted { success, collisions, cycle_time_s })
}

/// What the user has: the only thing of this folder, or the answer to a question.
pub(super) fn what(folder: &Path) -> anyhow::Result<Vec<String>> {
    let found = Thing::in_folder(folder);
    if !can() {
        let command = |thing: &String| format!("\nHint: robogate init {}", foreign(thing));
        let commands: String = match found.is_empty() {
            true => "\nHint: robogate init FILE.py, FILE.onnx, ROBOT.urdf, RESULTS.csv or EVIDENCE".to_owned(),
            false => found.iter().map(command).collect(),
        };
        bail!("name what you have: an environment, a policy, a robot, results or evidence{commands}");
    }
    found.iter().for_each(|thing| line(format_args!("found     {}", foreign(thing))));
    let recognised = |answer: &str| {
        let things: Vec<String> = answer.split_whitespace().map(str::to_owned).collect();
        things.iter().try_for_each(|thing| Thing::of(thing).map(|_| ())).map_err(|why| format!("{why:#}"))?;
        Ok(things)
    };
    question("What do you have? Names of files or folders, or the address of a policy server:", recognised)?
        .ok_or_else(|| anyhow!("nothing to start with\nHint: `robogate run` starts with the built-in cell"))
}

/// The built-in profile of the server at an address, if its protocol has one only, or the one that the user chooses.
pub(super) fn profile_of(server: &str) -> anyhow::Result<String> {
    let dialects = dialects_at(server);
    let speaks = |name: &&str| {
        let text = Profile::built_in(name).unwrap_or_default();
        let profile: Result<toml::Table, _> = Budget::FILE.toml(text);
        let dialect = profile.ok().and_then(|profile| Some(profile.get("dialect")?.get("name")?.as_str()?.to_owned()));
        dialect.is_some_and(|dialect| dialects.contains(&&*dialect))
    };
    let names: Vec<&str> = Profile::built_in_names().filter(speaks).collect();
    if dialects.is_empty() {
        bail!(
            "{server}: no policy server answers, or its protocol is unknown\nHint: start it, or give its profile with --profile"
        );
    }
    let list = names.join(", ");
    if let [one] = names[..] {
        return Ok(one.to_owned());
    }
    let known = |answer: &str| match names.iter().find(|name| **name == answer) {
        Some(name) => Ok((*name).to_owned()),
        None => Err(format!("expected one of {list}")),
    };
    let chosen = if can() { question(&format!("Which model is it? {list}:"), known)? } else { None };
    chosen.ok_or_else(|| {
        anyhow!("{server}: a server of the protocol {}\nHint: choose --profile: {list}", dialects.join(" or "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_plain_forms() {
        assert_eq!((share("90%"), share("92.5 %"), share("0.9")), (Ok(0.9), Ok(0.925), Ok(0.9)));
        assert!(share("90").unwrap_err().contains("such as 90%") && share("-1%").is_err() && positive("inf").is_err());
    }
}
