//! The connection to the simulator: lines of JSON, and files with arrays.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io::{BufRead, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{Fault, FaultKind};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::json;

use crate::load_mujoco;
use crate::mujoco::numbers::Plan;

/// The simulator, as it describes itself.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct Identity {
    /// The name of the device.
    pub device: String,
    /// The device as Warp names it, for example `cuda:0`.
    pub alias: String,
    /// Version of Warp.
    pub warp: String,
    /// Version of MuJoCo.
    pub mujoco: String,
    /// Version of MuJoCo Warp.
    pub mujoco_warp: String,
    /// Whether a rerun on the same card gives the same bytes.
    pub deterministic: bool,
}

/// The connection to a simulator.
pub struct Server {
    requests: Box<dyn Write + Send>,
    replies: Box<dyn BufRead + Send>,
    folder: PathBuf,
    identity: Identity,
    groups: Vec<Group>,
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server").field("identity", &self.identity).finish_non_exhaustive()
    }
}

/// The worlds of one topology that the simulator steps together.
struct Group {
    file: Arc<File>,
    layout: BTreeMap<String, Table>,
}

/// A table in the file of a group: the first number, and the shape.
#[derive(Debug, Clone, Deserialize)]
struct Table {
    offset: u64,
    shape: Vec<usize>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Reply<T> {
    Failed { error: String },
    Done(T),
}

#[derive(Deserialize)]
struct Created {
    layout: BTreeMap<String, Table>,
    fields: Vec<(String, usize)>,
}

#[derive(Deserialize)]
struct Nothing {}

fn unavailable(why: impl fmt::Display) -> Fault {
    Fault::new(FaultKind::Unavailable, format!("the simulator of many worlds: {why}"))
}

impl Server {
    /// Greets a simulator. `folder` is for the files of arrays; a folder in memory is fastest.
    ///
    /// # Errors
    /// If the simulator does not answer, or has another version of MuJoCo.
    pub fn new(
        requests: Box<dyn Write + Send>,
        replies: Box<dyn BufRead + Send>,
        folder: PathBuf,
    ) -> Result<Self, Fault> {
        let unknown = String::new();
        let identity = Identity {
            device: unknown.clone(),
            alias: unknown.clone(),
            warp: unknown.clone(),
            mujoco: unknown.clone(),
            mujoco_warp: unknown,
            deterministic: false,
        };
        let mut server = Self { requests, replies, folder, identity, groups: Vec::new() };
        server.identity = server.ask(&json!({"do": "hello"}))?;
        load_mujoco().map_err(unavailable)?;
        let (own, its) = (mujoco_rs::mujoco_version(), &server.identity.mujoco);
        if own != its {
            return Err(unavailable(format_args!("its MuJoCo has version {its}. Expected {own}")));
        }
        Ok(server)
    }

    /// The simulator, as it describes itself.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    fn ask<T: DeserializeOwned>(&mut self, request: &serde_json::Value) -> Result<T, Fault> {
        let mut line = request.to_string();
        line.push('\n');
        self.requests.write_all(line.as_bytes()).and_then(|()| self.requests.flush()).map_err(unavailable)?;
        line.clear();
        if self.replies.read_line(&mut line).map_err(unavailable)? == 0 {
            return Err(unavailable("it has ended"));
        }
        match serde_json::from_str(&line).map_err(unavailable)? {
            Reply::Failed { error } => Err(unavailable(error)),
            Reply::Done(reply) => Ok(reply),
        }
    }

    /// Creates a group of worlds of this model. Returns its number.
    pub(super) fn create(
        &mut self,
        model: &Path,
        plan: &Plan,
        fields: &[(&'static str, usize)],
        worlds: usize,
    ) -> Result<usize, Fault> {
        let group = self.groups.len();
        let path = self.folder.join(format!("worlds-{group}"));
        let created: Created = self.ask(&json!({
            "do": "group", "group": group, "file": path, "model": model, "plan": plan, "worlds": worlds,
        }))?;
        let same = |(own, its): (&(&str, usize), &(String, usize))| own.0 == its.0 && own.1 == its.1;
        if fields.len() != created.fields.len() || !fields.iter().zip(&created.fields).all(same) {
            let its = created.fields;
            return Err(unavailable(format_args!("its worlds have the fields {its:?}. Expected {fields:?}")));
        }
        let file = File::options().read(true).write(true).open(&path).map_err(unavailable)?;
        // Both processes have it open.
        fs::remove_file(&path).map_err(unavailable)?;
        self.groups.push(Group { file: Arc::new(file), layout: created.layout });
        Ok(group)
    }

    /// Writes a model to a file of the simulator's folder.
    pub(super) fn store(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, Fault> {
        let path = self.folder.join(name);
        fs::write(&path, bytes).map_err(unavailable)?;
        Ok(path)
    }

    /// Sets worlds of groups up, then runs one control period in these groups.
    pub(super) fn step(&mut self, resets: &[(usize, Vec<usize>)], groups: &[usize]) -> Result<(), Fault> {
        self.ask(&json!({"do": "step", "resets": resets, "groups": groups})).map(|Nothing {}| ())
    }

    /// Where a world's row of a table is.
    pub(super) fn row(&self, group: usize, table: &str, world: usize) -> Result<Row, Fault> {
        let Group { file, layout } = &self.groups[group];
        let table = layout.get(table).ok_or_else(|| unavailable(format_args!("it has no table {table}")))?;
        let width: usize = table.shape.iter().skip(1).product();
        Ok(Row { file: Arc::clone(file), at: 4 * (table.offset + (world * width) as u64), width })
    }
}

/// A world's row of a table, which can be used without the connection.
#[derive(Debug, Clone)]
pub(super) struct Row {
    file: Arc<File>,
    at: u64,
    width: usize,
}

impl Row {
    pub(super) fn write(&self, numbers: &[f32]) -> Result<(), Fault> {
        if numbers.len() != self.width {
            let (given, width) = (numbers.len(), self.width);
            return Err(unavailable(format_args!("{given} numbers for a row of a world. Expected {width}")));
        }
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.file.write_all_at(&bytes, self.at).map_err(unavailable)
    }

    pub(super) fn read(&self, numbers: &mut Vec<f32>) -> Result<(), Fault> {
        let mut bytes = vec![0; 4 * self.width];
        self.file.read_exact_at(&mut bytes, self.at).map_err(unavailable)?;
        numbers.clear();
        numbers.extend(bytes.chunks_exact(4).map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]])));
        Ok(())
    }
}
