//! Networks in ONNX files, run in this process by rten on one core.
//!
//! The keys of cameras and states are the names of the inputs. An image is passed as bytes if the network takes bytes, and
//! as floats from 0 to 1 if it takes floats. If an input has more axes than the profile's array, leading axes of size 1
//! are added, for example for a batch. The first output is the chunk of actions. The same file, profile and observations
//! give the same actions. A recurrent network gets some of its outputs back with the next request: its memory.
//!
//! A file may be damaged or hostile. Its structure and the memory that it needs are checked before the library runs any
//! of it, and loading and inference run in a thread whose results are awaited until a deadline.

mod draft;
mod memory;
mod scan;
mod sizes;
mod worker;

use std::collections::HashSet;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use rten::{Model, ModelOptions, NodeId, RunOptions, ThreadPool, Value, ValueOrView};
use rten_onnx::onnx::{DataType, Dimension, GraphProto, ModelProto, NodeProto};
use rten_tensor::prelude::*;
use serde_json::{Value as Json, json};
use sha2::{Digest, Sha256};

use super::array::{Array, Dtype};
use super::checkpoint::hex;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::profile::{Axes, Camera, Part, Profile};
use super::{chunk::Chunk, query::Query};
pub use draft::{NetworkDraft, draft_network};
use memory::Cell;
use worker::{Worker, catch_panics};

/// Largest file that is read, in bytes.
const MAX_FILE: u64 = 1 << 30;

/// A loaded network.
pub(crate) struct Network {
    path: String,
    worker: Worker<Vec<Value>, (Output, Vec<Value>)>,
    inputs: Vec<Input>,
    /// The memory of the present episode.
    memory: Vec<Cell>,
    declared: Json,
}

/// What is known of a network after loading it: its inputs, its memory at the start of an episode, and the SHA-256 of the
/// file.
struct Description {
    inputs: Vec<Input>,
    memory: Vec<Cell>,
    sha256: String,
}

/// Shape and numbers of the actions.
type Output = (Vec<usize>, Vec<f64>);

/// An input of the network.
struct Input {
    name: String,
    dtype: DataType,
    shape: Vec<usize>,
}

/// A network that is ready to run.
struct Runnable {
    model: Model,
    inputs: Vec<NodeId>,
    /// The actions, and then the memories.
    outputs: Vec<NodeId>,
    options: RunOptions,
}

impl Network {
    /// Load a file and check its inputs against the profile.
    pub(crate) fn load(path: &str, profile: &Profile, deadline: Deadline) -> Result<Self, PolicyError> {
        let operation = format!("loading {path}");
        let (file, wanted) = (path.to_owned(), profile.clone());
        let load = move || load(&file, &wanted);
        let (worker, Description { inputs, memory, sha256 }) =
            Worker::start(load, Runnable::run, deadline, &operation)?;
        let described: Vec<Json> = inputs
            .iter()
            .map(|input| json!({"name": input.name, "shape": input.shape, "type": name(input.dtype)}))
            .collect();
        let mut declared = json!({"sha256": sha256, "inputs": described});
        if !profile.memories.is_empty() {
            declared["memory"] = json!(profile.memories);
        }
        Ok(Self { path: path.to_owned(), worker, inputs, memory, declared })
    }
}

impl Connection for Network {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), PolicyError> {
        for cell in &mut self.memory {
            cell.value = memory::zero(&self.inputs[cell.input])?;
        }
        Ok(())
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let values = self.inputs.iter().enumerate().map(|(at, input)| {
            if let Some(cell) = self.memory.iter().find(|cell| cell.input == at) {
                return Ok(cell.value.clone());
            }
            let mut sent = query.images.iter().chain(&query.states);
            let array = sent.find(|(key, _)| *key == input.name).map(|(_, array)| array);
            let array = array.ok_or_else(|| PolicyError::Mismatch(format!("the profile sends no `{}`", input.name)))?;
            input.value(array)
        });
        let values = values.collect::<Result<_, PolicyError>>()?;
        let operation = format!("running {}", self.path);
        let ((shape, numbers), remembered) = self.worker.call(values, deadline, &operation)?;
        for (cell, value) in self.memory.iter_mut().zip(remembered) {
            memory::check(&self.inputs[cell.input], &value)?;
            cell.value = value;
        }
        let data = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let array = Array::new(Dtype::F64, shape, data).map_err(|e| PolicyError::Shape(e.to_string()))?;
        Chunk::of_array(&array)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

impl Runnable {
    /// Compute the actions and the memories for the next request.
    fn run(&self, values: Vec<Value>) -> Result<(Output, Vec<Value>), String> {
        let inputs: Vec<(NodeId, ValueOrView)> =
            self.inputs.iter().copied().zip(values.into_iter().map(Into::into)).collect();
        let outputs = self.model.run(inputs, &self.outputs, Some(self.options.clone())).map_err(|e| e.to_string())?;
        let mut outputs = outputs.into_iter();
        let actions = match outputs.next() {
            Some(Value::FloatTensor(tensor)) => plain(&tensor),
            Some(Value::Int32Tensor(tensor)) => plain(&tensor),
            Some(Value::Int8Tensor(tensor)) => plain(&tensor),
            Some(Value::UInt8Tensor(tensor)) => plain(&tensor),
            _ => return Err("its first output is not an array".to_owned()),
        };
        Ok((actions, outputs.collect()))
    }
}

/// Shape and numbers of an array.
fn plain<T: Copy + Into<f64>>(tensor: &rten_tensor::Tensor<T>) -> Output {
    (tensor.shape().to_vec(), tensor.iter().map(|n| (*n).into()).collect())
}

impl Input {
    /// Check that this input can take an image, or else a vector.
    fn check_type(&self, is_picture: bool) -> Result<(), String> {
        let fits = match sizes::computed(self.dtype) {
            Some(DataType::UINT8) => is_picture,
            Some(DataType::INT32) => !is_picture && self.dtype != DataType::BOOL,
            computed => computed == Some(DataType::FLOAT),
        };
        if fits {
            return Ok(());
        }
        let (key, dtype) = (&self.name, name(self.dtype));
        let sent = if is_picture { "an image" } else { "a vector" };
        Err(format!(
            "the input `{key}` has the type {dtype}, but the profile sends {sent}. Supported: F16, F32 and F64; U8 for images; I32 and \
             I64 for states"
        ))
    }

    /// Convert an array to the type and shape of this input.
    fn value(&self, array: &Array) -> Result<Value, PolicyError> {
        let shape = array.shape();
        let extra = self.shape.len().checked_sub(shape.len());
        let fits =
            extra.is_some_and(|extra| self.shape[..extra].iter().all(|n| *n == 1) && self.shape[extra..] == *shape);
        if !fits {
            let (name, expected) = (&self.name, &self.shape);
            return Err(PolicyError::Observation(format!(
                "the profile sends `{name}` with shape {shape:?}, but the network takes {expected:?}"
            )));
        }
        let is_picture = array.dtype() == Dtype::U8;
        self.check_type(is_picture).map_err(PolicyError::Observation)?;
        let mismatch = |e: &dyn std::fmt::Display| PolicyError::Observation(e.to_string());
        let whole = |n: &f64| (n.fract() == 0.0 && n.abs() <= f64::from(i32::MAX)).then_some(*n as i32);
        match sizes::computed(self.dtype) {
            Some(DataType::UINT8) => Value::from_shape(&self.shape, array.data().to_vec()).map_err(|e| mismatch(&e)),
            Some(DataType::INT32) => {
                let numbers = array.numbers();
                let integers: Option<Vec<i32>> = numbers.iter().map(whole).collect();
                let integers = integers.ok_or_else(|| {
                    let (key, dtype) = (&self.name, name(self.dtype));
                    PolicyError::Observation(format!(
                        "the input `{key}` has the type {dtype}, but the profile sends {numbers:?}. Expected integers of \
                         at most 32 bits"
                    ))
                })?;
                Value::from_shape(&self.shape, integers).map_err(|e| mismatch(&e))
            }
            _ => {
                let scale = if is_picture { 1.0 / 255.0 } else { 1.0 };
                let numbers: Vec<f32> = array.numbers().iter().map(|n| (n * scale) as f32).collect();
                Value::from_shape(&self.shape, numbers).map_err(|e| mismatch(&e))
            }
        }
    }
}

/// Read a file of limited size.
fn read(path: &str) -> Result<Vec<u8>, String> {
    if Path::new(path).is_dir() {
        return Err("it is a folder. Expected an ONNX file".to_owned());
    }
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(MAX_FILE + 1).read_to_end(&mut bytes))
        .map_err(|e| format!("cannot be read: {e}"))?;
    if bytes.len() as u64 > MAX_FILE {
        return Err(format!("it has more than {} MiB, which is too large to run on one core", MAX_FILE >> 20));
    }
    Ok(bytes)
}

/// Why a file cannot be loaded, for a user who may have named the wrong one.
fn explain(bytes: &[u8], why: &str) -> String {
    if bytes.is_empty() {
        "it is empty. Expected an ONNX model".to_owned()
    } else if std::str::from_utf8(bytes).is_ok() {
        "it is a text file. Expected an ONNX model".to_owned()
    } else {
        cannot_load(why)
    }
}

fn cannot_load(why: &str) -> String {
    format!("cannot be loaded as an ONNX model: {why}")
}

/// Read and check a file.
fn load(path: &str, profile: &Profile) -> Result<(Runnable, Description), PolicyError> {
    let invalid = |why: String| PolicyError::File { path: path.to_owned(), why };
    let bytes = read(path).map_err(invalid)?;
    let sha256 = hex(Sha256::new_with_prefix(&bytes));
    let parsed = catch_panics(|| parse(&bytes)).and_then(|mut model| {
        let inputs = fix_inputs(&mut model, profile)?;
        Ok((model, inputs))
    });
    let (mut model, inputs) = parsed.map_err(|why| invalid(explain(&bytes, &why)))?;
    drop(bytes);
    check_keys(&inputs, profile)?;
    check_types(&inputs, profile)?;
    memory::choose_outputs(&mut model, profile)?;
    let prepared = catch_panics(|| prepare(model, &inputs));
    let (runnable, outputs) = prepared.map_err(|why| invalid(cannot_load(&why)))?;
    let memory = memory::cells(profile, &inputs, &outputs)?;
    Ok((runnable, Description { inputs, memory, sha256 }))
}

/// Check that the profile sends each input of the network, and nothing else.
fn check_keys(inputs: &[Input], profile: &Profile) -> Result<(), PolicyError> {
    let names: Vec<&str> = inputs.iter().map(|input| input.name.as_str()).collect();
    let cameras = profile.cameras.iter().map(|camera| camera.key.as_str());
    let keys: Vec<&str> = cameras.chain(profile.states.iter().map(|state| state.key.as_str())).collect();
    let memories: Vec<&str> = profile.memories.iter().map(|memory| memory.input.as_str()).collect();
    if let Some(input) = memories.iter().find(|input| !names.contains(input)) {
        let names = names.join(", ");
        return Err(PolicyError::Mismatch(format!(
            "memory.input `{input}` is not an input of the network, which has {names}. Hint: correct [[memory]] in the \
             profile"
        )));
    }
    if let Some(key) = keys.iter().find(|key| !names.contains(key)) {
        let names = names.join(", ");
        return Err(PolicyError::Mismatch(format!(
            "the profile sends `{key}`, but the inputs of the network are {names}"
        )));
    }
    if let Some(name) = names.iter().find(|name| !keys.contains(name) && !memories.contains(name)) {
        let keys = keys.join(", ");
        return Err(PolicyError::Mismatch(format!(
            "the network has an input `{name}`, but the profile sends {keys}. Hint: add a [[state]] or [[camera]] with this \
             key, or a [[memory]] if an output of the network is fed back to it"
        )));
    }
    Ok(())
}

/// Check that each input can take what the profile sends: an image, integers or real numbers.
fn check_types(inputs: &[Input], profile: &Profile) -> Result<(), PolicyError> {
    for input in inputs {
        if profile.cameras.iter().any(|camera| camera.key == input.name) {
            input.check_type(true).map_err(PolicyError::Mismatch)?;
        }
        let Some(state) = profile.states.iter().find(|state| state.key == input.name) else { continue };
        input.check_type(false).map_err(PolicyError::Mismatch)?;
        let real = state.parts.iter().any(|part| *part != Part::Zero);
        if real && sizes::computed(input.dtype) == Some(DataType::INT32) {
            return Err(PolicyError::Mismatch(format!(
                "the input `{}` has the type {}, but the `parts` of the state in the profile are real numbers. Expected integers of \
                 at most 32 bits. Hint: export the network with an input of real numbers, or send `vectors` of integers",
                input.name,
                name(input.dtype)
            )));
        }
    }
    Ok(())
}

/// Read the graph of a file.
fn parse(bytes: &[u8]) -> Result<ModelProto, String> {
    scan::check(bytes)?;
    let mut model = ModelProto::parse_buf(bytes).map_err(|e| e.to_string())?;
    let graph = model.graph.as_mut().ok_or("it has no graph")?;
    if graph.output.is_empty() {
        return Err("it has no output".to_owned());
    }
    // Only the inputs are believed; everything else follows from them.
    graph.value_info.clear();
    graph.node.iter_mut().for_each(remove_dropout);
    Ok(model)
}

/// Remove the nodes that no output depends on.
fn remove_unused(graph: &mut GraphProto) {
    let mut used: HashSet<String> = graph.output.iter().filter_map(|output| output.name.clone()).collect();
    let mut nodes = std::mem::take(&mut graph.node);
    // Each node reads what earlier ones compute.
    nodes.reverse();
    nodes.retain(|node| {
        let is_used = node.output.iter().any(|name| used.contains(name));
        if is_used {
            used.extend(node.input.iter().cloned());
        }
        is_used
    });
    nodes.reverse();
    graph.node = nodes;
}

/// Dropout does nothing outside of training.
fn remove_dropout(node: &mut NodeProto) {
    if node.op_type.as_deref() == Some("Dropout") && node.input.len() < 3 {
        node.op_type = Some("Identity".to_owned());
        node.input.truncate(1);
        node.output.truncate(1);
        node.attribute.clear();
    }
}

/// Give each input of a network a fixed size.
fn fix_inputs(model: &mut ModelProto, profile: &Profile) -> Result<Vec<Input>, String> {
    let Some(GraphProto { input, initializer, .. }) = &mut model.graph else { return Ok(Vec::new()) };
    // Files of old versions list constants as inputs too.
    input.retain(|input| !initializer.iter().any(|constant| constant.name == input.name));
    let inputs = input.iter_mut().map(|input| {
        let name = input.name.clone().unwrap_or_default();
        let tensor = input.r#type.as_mut().and_then(|t| t.tensor_type.as_mut());
        let tensor = tensor.ok_or_else(|| format!("the input `{name}` is not an array"))?;
        let dtype = *tensor.elem_type.get_or_insert(DataType::FLOAT);
        let axes = tensor.shape.as_ref().map_or(&[][..], |shape| &shape.dim);
        let axes: Vec<_> = axes.iter().map(|axis| axis.dim_value.and_then(|size| usize::try_from(size).ok())).collect();
        let shape = fixed_shape(&axes, sent_shape(profile, &name)).ok_or_else(|| {
            let open = axes.iter().rposition(Option::is_none).unwrap_or_default();
            format!("the input `{name}` has no fixed size: axis {open} is open. Export the model with fixed sizes")
        })?;
        let fixed = shape.iter().map(|size| Dimension { dim_value: i64::try_from(*size).ok(), dim_param: None });
        tensor.shape.get_or_insert_default().dim = fixed.collect();
        Ok(Input { name, dtype, shape })
    });
    inputs.collect()
}

/// Check the memory that a network needs, and load it. Returns also the types and shapes of its outputs.
fn prepare(mut model: ModelProto, inputs: &[Input]) -> Result<(Runnable, Vec<sizes::Array>), String> {
    model.graph.iter_mut().for_each(remove_unused);
    let pool = Arc::new(ThreadPool::with_num_threads(1));
    let options = RunOptions::default().with_thread_pool(Some(pool.clone()));
    let single = options.clone();
    // In the thread that computes, so that the many small steps need not wake it.
    let (model, checked) = pool.run(move || {
        let checked = sizes::check(&model, &ModelOptions::with_all_ops(), &single);
        (model, checked)
    });
    let described = checked?;
    let bytes = model.write_buf().map_err(|e| e.to_string())?;
    drop(model);
    let model = ModelOptions::with_all_ops().prepack_weights(true).load(bytes).map_err(|e| e.to_string())?;
    let ids = inputs.iter().map(|input| model.node_id(&input.name).map_err(|e| e.to_string()));
    let inputs = ids.collect::<Result<_, _>>()?;
    let outputs = model.output_ids().to_vec();
    Ok((Runnable { model, inputs, outputs, options }, described))
}

/// The shape of what the profile sends under this name: an image, or a vector whose length depends on the robot, with a
/// leading axis for a history. A memory has the shape that the network declares.
fn sent_shape(profile: &Profile, name: &str) -> Vec<Option<usize>> {
    if profile.memories.iter().any(|memory| memory.input == name) {
        return Vec::new();
    }
    let camera = profile.cameras.iter().find(|camera| camera.key == name);
    let state = profile.states.iter().find(|state| state.key == name);
    let history = camera.map(|camera| &camera.history).or_else(|| state.map(|state| &state.history));
    let mut shape: Vec<_> =
        history.filter(|offsets| !offsets.is_empty()).map(|offsets| Some(offsets.len())).into_iter().collect();
    match camera {
        Some(Camera { width: w, height: h, axes: Axes::Hwc, .. }) => shape.extend([Some(*h), Some(*w), Some(3)]),
        Some(Camera { width: w, height: h, axes: Axes::Chw, .. }) => shape.extend([Some(3), Some(*h), Some(*w)]),
        None => shape.push(None),
    }
    shape
}

/// Fix the sizes that a network leaves open: 1 for leading axes that are not sent, else the size that is sent.
fn fixed_shape(axes: &[Option<usize>], sent: Vec<Option<usize>>) -> Option<Vec<usize>> {
    let extra = axes.len().saturating_sub(sent.len());
    let sent = std::iter::repeat_n(Some(1), extra).chain(sent);
    axes.iter().zip(sent).map(|(axis, sent)| axis.or(sent)).collect()
}

/// The name of a type in the record of a run.
fn name(dtype: DataType) -> String {
    match dtype {
        DataType::FLOAT => "F32".to_owned(),
        DataType::UINT8 => "U8".to_owned(),
        DataType::INT8 => "I8".to_owned(),
        DataType::INT32 => "I32".to_owned(),
        DataType::INT64 => "I64".to_owned(),
        DataType::BOOL => "Bool".to_owned(),
        DataType::FLOAT16 => "F16".to_owned(),
        DataType::DOUBLE => "F64".to_owned(),
        other => other.to_string(),
    }
}
