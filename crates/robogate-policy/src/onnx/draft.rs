//! Drafts the profile of a network from its inputs and outputs and the task that it is to drive.

use std::fmt::Write as _;
use std::path::Path;

use robogate_core::TaskSpec;
use rten_onnx::onnx::{DataType, GraphProto, ValueInfoProto};

use super::super::error::PolicyError;
use super::super::profile::Profile;
use super::worker::catch_panics;
use super::{explain, name, parse, read};

/// The draft of a network's profile, as files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkDraft {
    /// The profile (TOML), with a comment on each guess.
    pub profile: String,
    /// The map (TOML) that scales the actions, if the network ends with a `Tanh` and the task has other bounds than -1 and 1.
    pub map: Option<String>,
    /// What the network takes and returns, one line.
    pub found: String,
    /// The guesses, one sentence each.
    pub guesses: Vec<String>,
}

/// An array of the network: its name, its type and its sizes. An open size is `None`.
struct Port {
    name: String,
    dtype: DataType,
    axes: Vec<Option<usize>>,
}

impl Port {
    fn of(value: &ValueInfoProto) -> Self {
        let tensor = value.r#type.as_ref().and_then(|kind| kind.tensor_type.as_ref());
        let dims = tensor.and_then(|tensor| tensor.shape.as_ref()).map_or(&[][..], |shape| &shape.dim);
        let axes = dims.iter().map(|axis| axis.dim_value.and_then(|size| usize::try_from(size).ok())).collect();
        let dtype = tensor.and_then(|tensor| tensor.elem_type).unwrap_or(DataType::FLOAT);
        Self { name: value.name.clone().unwrap_or_default(), dtype, axes }
    }

    fn last(&self) -> Option<usize> {
        self.axes.last().copied().flatten()
    }

    /// Height, width and order of the axes of an image.
    fn picture(&self) -> Option<(usize, usize, &'static str)> {
        match self.axes[..] {
            [.., Some(height), Some(width), Some(3)] => Some((height, width, "hwc")),
            [.., Some(3), Some(height), Some(width)] => Some((height, width, "chw")),
            _ => None,
        }
    }

    fn described(&self) -> String {
        let sizes = self.axes.iter().map(|axis| axis.map_or_else(|| "?".to_owned(), |size| size.to_string()));
        format!("{} [{}] {}", self.name, sizes.collect::<Vec<_>>().join(", "), name(self.dtype))
    }
}

/// Drafts a profile for the network in this file that drives `task`: inputs are matched by name and by size, and the output is the
/// action vector of the task. Nothing of the network runs.
///
/// # Errors
/// A file that is not a network, or sizes that fit nothing of the task.
pub fn draft_network(path: &Path, task: &TaskSpec) -> Result<NetworkDraft, PolicyError> {
    let shown = path.display().to_string();
    let invalid = |why: String| PolicyError::File { path: shown.clone(), why };
    let bytes = read(&shown).map_err(invalid)?;
    let model = catch_panics(|| parse(&bytes)).map_err(|why| invalid(explain(&bytes, &why)))?;
    let graph = model.graph.unwrap_or_default();
    let stem = path.file_stem().map_or_else(|| "network".to_owned(), |stem| stem.to_string_lossy().into_owned());
    Writer::new(&graph, task).write(&stem).map_err(PolicyError::Mismatch)
}

struct Writer<'a> {
    graph: &'a GraphProto,
    task: &'a TaskSpec,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
    guesses: Vec<String>,
}

impl<'a> Writer<'a> {
    fn new(graph: &'a GraphProto, task: &'a TaskSpec) -> Self {
        let constant = |value: &ValueInfoProto| graph.initializer.iter().any(|constant| constant.name == value.name);
        let inputs = graph.input.iter().filter(|value| !constant(value)).map(Port::of).collect();
        Self { graph, task, inputs, outputs: graph.output.iter().map(Port::of).collect(), guesses: Vec::new() }
    }

    fn write(mut self, stem: &str) -> Result<NetworkDraft, String> {
        let ports = |ports: &[Port]| ports.iter().map(Port::described).collect::<Vec<_>>().join(", ");
        let found = format!("takes {}; returns {}", ports(&self.inputs), ports(&self.outputs));
        let mut memories = String::new();
        let mut rest = std::mem::take(&mut self.outputs);
        let at = self.action_of(&rest);
        rest.get_mut(..=at).unwrap_or_default().rotate_right(1);
        let mut known: Vec<(String, String)> = Vec::new();
        let (mut cameras, mut states) = (String::new(), String::new());
        for input in std::mem::take(&mut self.inputs) {
            // A recurrent network returns an array of the same sizes that no vector of the task has.
            let again = rest.iter().skip(1).position(|output| output.axes == input.axes);
            let vectors = self.vectors(&input);
            match (input.picture(), vectors, again) {
                (Some(picture), ..) => cameras += &self.camera(&input, picture)?,
                (None, None, Some(at)) => {
                    let output = rest.remove(at + 1);
                    let _ = write!(memories, "\n[[memory]]\ninput = {:?}\noutput = {:?}\n", input.name, output.name);
                    self.guesses.push(format!("`{}` is fed back from `{}`", input.name, output.name));
                }
                (None, Some((vectors, guess)), _) => {
                    self.guesses.extend(guess);
                    if let Some((other, _)) = known.iter().find(|(_, of)| *of == format!("{vectors:?}")) {
                        self.guesses.push(format!("`{}` and `{other}` take the same vector", input.name));
                    }
                    known.push((input.name.clone(), format!("{vectors:?}")));
                    let _ =
                        write!(states, "\n[[state]]\nkey = {:?}\nvectors = {vectors:?}\ntype = \"<f4\"\n", input.name);
                }
                (None, None, None) => {
                    return Err(format!(
                        "the network takes {}, but the task {} observes {}. Hint: write the profile and a map \
                         (docs/guides/environments.md)",
                        input.described(),
                        self.task.name,
                        self.observed()
                    ));
                }
            }
        }
        let action = rest.first().ok_or("the network has no output with actions")?;
        let (size, length) = self.action(action)?;
        if let [action, others @ ..] = &rest[..]
            && !others.is_empty()
        {
            let others: Vec<String> = others.iter().map(|output| format!("`{}`", output.name)).collect();
            self.guesses.push(format!(
                "the output `{}` is the action, and {} is not used",
                action.name,
                others.join(", ")
            ));
        }
        let map = self.map(&action.name);
        let profile = format!(
            "# A draft from the inputs and outputs of the network, and from the task {}. Check what is marked as a guess.\n\
             {}name = {stem:?}\nmodel = \"{stem}.onnx\"\n\n[dialect]\nname = \"onnx\"\n{cameras}{states}{memories}\n\
             [action]\nsize = {size}\narm = \"vector\"\n\n[chunk]\nlength = {length}\nexecute = {length}\n",
            self.task.name,
            self.guesses.iter().map(|guess| format!("# Guess: {guess}.\n")).collect::<String>(),
        );
        Profile::from_toml(&profile).map_err(|why| format!("the draft is not a valid profile: {why}"))?;
        Ok(NetworkDraft { profile, map, found, guesses: self.guesses })
    }

    /// The place of the output with the actions: by its name, otherwise by its size, otherwise the first.
    fn action_of(&self, outputs: &[Port]) -> usize {
        let size = self.task.action.vector().map(|(low, _)| low.len());
        let named = |output: &Port| output.name.to_ascii_lowercase().contains("action");
        let exact = |output: &Port| ["action", "actions"].contains(&output.name.to_ascii_lowercase().as_str());
        let place = |is: &dyn Fn(&Port) -> bool| outputs.iter().position(is);
        place(&exact)
            .or_else(|| place(&named))
            .or_else(|| place(&|output| size.is_some() && output.last() == size))
            .unwrap_or(0)
    }

    fn observed(&self) -> String {
        let vectors = self.task.observation.vectors.iter().map(|vector| format!("{} ({})", vector.name, vector.length));
        let cameras = self.task.observation.cameras.iter().map(|camera| camera.name.to_string());
        vectors.chain(cameras).collect::<Vec<_>>().join(", ")
    }

    /// The vectors of the task that an input takes: the one of its name, the only one of its length, or all in their order. Also
    /// the guess in this, if it is one.
    fn vectors(&self, input: &Port) -> Option<(Vec<&'a str>, Option<String>)> {
        let all = &self.task.observation.vectors;
        let size = input.last();
        let fits = |length: usize| size.is_none_or(|size| size == length);
        let named = all.iter().find(|vector| vector.name.as_str().eq_ignore_ascii_case(&input.name));
        if let Some(vector) = named.filter(|vector| fits(vector.length)) {
            return Some((vec![vector.name.as_str()], None));
        }
        let alike: Vec<_> = all.iter().filter(|vector| size == Some(vector.length)).collect();
        if let [one] = alike[..] {
            let guess = (all.len() > 1).then(|| format!("`{}` is `{}`, which has its size", input.name, one.name));
            return Some((vec![one.name.as_str()], guess));
        }
        if all.is_empty() || !fits(all.iter().map(|vector| vector.length).sum()) {
            return None;
        }
        let names: Vec<&str> = all.iter().map(|vector| vector.name.as_str()).collect();
        let guess =
            (names.len() > 1).then(|| format!("`{}` is all vectors in this order: {}", input.name, names.join(", ")));
        Some((names, guess))
    }

    fn camera(&mut self, input: &Port, (height, width, axes): (usize, usize, &str)) -> Result<String, String> {
        let cameras = &self.task.observation.cameras;
        let alike =
            cameras.iter().find(|camera| input.name.contains(&*camera.name) || camera.name.contains(&input.name));
        let Some(camera) = alike.or_else(|| cameras.first()) else {
            return Err(format!(
                "the network takes the image {}, but the task {} has no camera",
                input.name, self.task.name
            ));
        };
        if alike.is_none() {
            self.guesses.push(format!("`{}` is the first camera of the task, `{}`", input.name, camera.name));
        }
        Ok(format!(
            "\n[[camera]]\nfrom = {:?}\nkey = {:?}\nwidth = {width}\nheight = {height}\naxes = {axes:?}\n",
            &*camera.name, input.name
        ))
    }

    /// The numbers of an action, and the actions of a reply.
    fn action(&mut self, output: &Port) -> Result<(usize, usize), String> {
        let task = &self.task.action;
        let Some((low, _)) = task.vector() else {
            return Err(format!(
                "the task {} takes {}, whose meaning a network does not state. Hint: give its profile with --profile",
                self.task.name,
                task.kinds()
            ));
        };
        let size = output.last().unwrap_or(low.len());
        if size != low.len() {
            return Err(format!(
                "the network returns {}, but an action of the task {} has {} numbers. Hint: write a map \
                 (docs/guides/environments.md)",
                output.described(),
                self.task.name,
                low.len()
            ));
        }
        let before = output.axes.len().checked_sub(2).and_then(|at| output.axes[at]);
        let length = before.unwrap_or(1).max(1);
        if length > 1 {
            self.guesses.push(format!("all {length} actions of a reply are executed before the next request"));
        }
        Ok((size, length))
    }

    /// A map that scales the actions of a network which ends with `Tanh` to the bounds of the task.
    fn map(&mut self, output: &str) -> Option<String> {
        let ends_with_tanh = |node: &rten_onnx::onnx::NodeProto| {
            node.output.iter().any(|name| name == output) && node.op_type.as_deref() == Some("Tanh")
        };
        if !self.graph.node.iter().any(ends_with_tanh) {
            return None;
        }
        let (names, (low, high)) = (self.task.action.vector_names()?, self.task.action.vector()?);
        let is_unit = |(low, high): (&f64, &f64)| (low + 1.0).abs() < 1e-9 && (high - 1.0).abs() < 1e-9;
        if low.iter().zip(high).all(is_unit) {
            return None;
        }
        self.guesses.push(
            "the network ends with Tanh, so -1 and 1 are the bounds of the task's action (in the map)".to_owned(),
        );
        let mut text =
            "# The network returns numbers from -1 to 1. They are scaled to the bounds of the task.\n[action]\n"
                .to_owned();
        for (at, (name, (low, high))) in names.iter().zip(low.iter().zip(high)).enumerate() {
            let (scale, offset) = (0.5 * (high - low), 0.5 * (high + low));
            let _ = writeln!(text, "{name:?} = {{ from = \"action[{at}]\", scale = {scale:?}, offset = {offset:?} }}");
        }
        Some(text)
    }
}
