//! `robogate list`: lists the contents of this build by name.

use clap::Args;
use serde_json::{Map, Value, json};

use crate::exit::{DONE, Exit};
use crate::registry;
use crate::terminal::{bold, line};

/// List the tasks, engines, robots, policies, spaces and suites of this build.
#[derive(Debug, Args)]
pub(crate) struct List {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl List {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let listing = registry::listing();
        if self.json {
            let mut document: Map<String, Value> =
                listing.into_iter().map(|(kind, names)| (kind.to_owned(), json!(names))).collect();
            document.insert("version".to_owned(), json!(1));
            line(Value::Object(document));
            return Ok(DONE);
        }
        for (kind, names) in listing {
            line(bold(kind));
            names.iter().for_each(|name| line(format_args!("  {name}")));
        }
        Ok(DONE)
    }
}
