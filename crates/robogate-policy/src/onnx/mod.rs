//! Networks in ONNX files, run in this process by rten on one core.
//!
//! The keys of cameras and states are the names of the inputs. An image is passed as bytes if the network takes bytes, and
//! as floats from 0 to 1 if it takes floats. If an input has more axes than the profile's array, leading axes of size 1
//! are added, for example for a batch. The first output is the chunk of actions. The same file, profile and observation
//! give the same actions.
//!
//! A file may be damaged or hostile. Its structure and the memory that it needs are checked before the library runs any
//! of it, and loading and inference run in a thread whose results are awaited until a deadline.

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
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::profile::{Axes, Camera, Profile};
use super::{chunk::Chunk, query::Query};
use worker::{Worker, catch_panics};

/// Largest file that is read, in bytes.
const MAX_FILE: u64 = 1 << 30;

/// A loaded network.
pub(crate) struct Network {
    path: String,
    worker: Worker<Vec<Value>, Output>,
    inputs: Vec<Input>,
    declared: Json,
}

/// Shape and numbers of the first output.
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
    output: NodeId,
    options: RunOptions,
}

impl Network {
    /// Load a file and check its inputs against the profile.
    pub(crate) fn load(path: &str, profile: &Profile, deadline: Deadline) -> Result<Self, PolicyError> {
        let operation = format!("loading {path}");
        let (file, profile) = (path.to_owned(), profile.clone());
        let load = move || load(&file, &profile);
        let (worker, (inputs, sha256)) = Worker::start(load, Runnable::run, deadline, &operation)?;
        let described: Vec<Json> = inputs
            .iter()
            .map(|input| json!({"name": input.name, "shape": input.shape, "type": name(input.dtype)}))
            .collect();
        let declared = json!({"sha256": sha256, "inputs": described});
        Ok(Self { path: path.to_owned(), worker, inputs, declared })
    }
}

impl Connection for Network {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), PolicyError> {
        Ok(())
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let values = self.inputs.iter().map(|input| {
            let mut sent = query.images.iter().chain(&query.states);
            let array = sent.find(|(key, _)| *key == input.name).map(|(_, array)| array);
            let array = array.ok_or_else(|| PolicyError::Mismatch(format!("the profile sends no `{}`", input.name)))?;
            input.value(array)
        });
        let values = values.collect::<Result<_, PolicyError>>()?;
        let (shape, numbers) = self.worker.call(values, deadline, &format!("running {}", self.path))?;
        let data = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let array = Array::new(Dtype::F64, shape, data).map_err(|e| PolicyError::Shape(e.to_string()))?;
        Chunk::of_array(&array)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

impl Runnable {
    fn run(&self, values: Vec<Value>) -> Result<Output, String> {
        let inputs: Vec<(NodeId, ValueOrView)> =
            self.inputs.iter().copied().zip(values.into_iter().map(Into::into)).collect();
        let outputs = self.model.run(inputs, &[self.output], Some(self.options.clone())).map_err(|e| e.to_string())?;
        match outputs.into_iter().next() {
            Some(Value::FloatTensor(tensor)) => Ok(plain(&tensor)),
            Some(Value::Int32Tensor(tensor)) => Ok(plain(&tensor)),
            Some(Value::Int8Tensor(tensor)) => Ok(plain(&tensor)),
            Some(Value::UInt8Tensor(tensor)) => Ok(plain(&tensor)),
            _ => Err("its first output is not an array".to_owned()),
        }
    }
}

/// Shape and numbers of an array.
fn plain<T: Copy + Into<f64>>(tensor: &rten_tensor::Tensor<T>) -> Output {
    (tensor.shape().to_vec(), tensor.iter().map(|n| (*n).into()).collect())
}

impl Input {
    /// Convert an array to the type and shape of this input.
    fn value(&self, array: &Array) -> Result<Value, PolicyError> {
        let shape = array.shape();
        let extra = self.shape.len().checked_sub(shape.len());
        let fits =
            extra.is_some_and(|extra| self.shape[..extra].iter().all(|n| *n == 1) && self.shape[extra..] == *shape);
        if !fits {
            let (name, expected) = (&self.name, &self.shape);
            return Err(PolicyError::Mismatch(format!(
                "the profile sends `{name}` with shape {shape:?}, but the network takes {expected:?}"
            )));
        }
        let is_picture = array.dtype() == Dtype::U8;
        let mismatch = |e: &dyn std::fmt::Display| PolicyError::Mismatch(e.to_string());
        match self.dtype {
            DataType::UINT8 if is_picture => {
                Value::from_shape(&self.shape, array.data().to_vec()).map_err(|e| mismatch(&e))
            }
            DataType::FLOAT => {
                let scale = if is_picture { 1.0 / 255.0 } else { 1.0 };
                let numbers: Vec<f32> = array.numbers().iter().map(|n| (n * scale) as f32).collect();
                Value::from_shape(&self.shape, numbers).map_err(|e| mismatch(&e))
            }
            other => {
                let (key, sent) = (&self.name, array.dtype().name());
                let other = name(other);
                Err(PolicyError::Mismatch(format!(
                    "the input `{key}` has the type {other}, but the profile sends {sent}. Supported: F32, and U8 for images"
                )))
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

/// Read and check a file. Returns the network, its inputs, and the SHA-256 of the file.
fn load(path: &str, profile: &Profile) -> Result<(Runnable, (Vec<Input>, String)), PolicyError> {
    let invalid = |why: String| PolicyError::File { path: path.to_owned(), why };
    let bytes = read(path).map_err(invalid)?;
    let sha256: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    let parsed = catch_panics(|| parse(&bytes)).and_then(|mut model| {
        let inputs = fix_inputs(&mut model, profile)?;
        Ok((model, inputs))
    });
    let (model, inputs) = parsed.map_err(|why| invalid(explain(&bytes, &why)))?;
    drop(bytes);
    check_keys(&inputs, profile)?;
    let runnable = catch_panics(|| prepare(model, &inputs)).map_err(|why| invalid(cannot_load(&why)))?;
    Ok((runnable, (inputs, sha256)))
}

/// Check that the profile sends each input of the network, and nothing else.
fn check_keys(inputs: &[Input], profile: &Profile) -> Result<(), PolicyError> {
    let names: Vec<&str> = inputs.iter().map(|input| input.name.as_str()).collect();
    let cameras = profile.cameras.iter().map(|camera| camera.key.as_str());
    let keys: Vec<&str> = cameras.chain(profile.states.iter().map(|state| state.key.as_str())).collect();
    if let Some(key) = keys.iter().find(|key| !names.contains(key)) {
        let names = names.join(", ");
        return Err(PolicyError::Mismatch(format!(
            "the profile sends `{key}`, but the inputs of the network are {names}"
        )));
    }
    if let Some(name) = names.iter().find(|name| !keys.contains(name)) {
        let keys = keys.join(", ");
        return Err(PolicyError::Mismatch(format!("the network has an input `{name}`, but the profile sends {keys}")));
    }
    Ok(())
}

/// Read the graph of a file.
fn parse(bytes: &[u8]) -> Result<ModelProto, String> {
    scan::check(bytes)?;
    let mut model = ModelProto::parse_buf(bytes).map_err(|e| e.to_string())?;
    let graph = model.graph.as_mut().ok_or("it has no graph")?;
    // Only the inputs are believed; everything else follows from them.
    graph.value_info.clear();
    graph.output.truncate(1);
    graph.output.first_mut().ok_or("it has no output")?.r#type = None;
    graph.node.iter_mut().for_each(remove_dropout);
    remove_unused(graph);
    Ok(model)
}

/// Remove the nodes that the first output does not depend on.
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
        let shape = fixed_shape(&axes, sent_shape(profile, &name))
            .ok_or_else(|| format!("the input `{name}` has no fixed size. Export the model with fixed sizes"))?;
        let fixed = shape.iter().map(|size| Dimension { dim_value: i64::try_from(*size).ok(), dim_param: None });
        tensor.shape.get_or_insert_default().dim = fixed.collect();
        Ok(Input { name, dtype, shape })
    });
    inputs.collect()
}

/// Check the memory that a network needs, and load it.
fn prepare(model: ModelProto, inputs: &[Input]) -> Result<Runnable, String> {
    let pool = Arc::new(ThreadPool::with_num_threads(1));
    let options = RunOptions::default().with_thread_pool(Some(pool.clone()));
    let single = options.clone();
    // In the thread that computes, so that the many small steps need not wake it.
    let (model, checked) = pool.run(move || {
        let checked = sizes::check(&model, &ModelOptions::with_all_ops(), &single);
        (model, checked)
    });
    checked?;
    let bytes = model.write_buf().map_err(|e| e.to_string())?;
    drop(model);
    let model = ModelOptions::with_all_ops().prepack_weights(true).load(bytes).map_err(|e| e.to_string())?;
    let ids = inputs.iter().map(|input| model.node_id(&input.name).map_err(|e| e.to_string()));
    let inputs = ids.collect::<Result<_, _>>()?;
    let output = *model.output_ids().first().ok_or("it has no output")?;
    Ok(Runnable { model, inputs, output, options })
}

/// The shape of what the profile sends under this name: an image, or a vector whose length depends on the robot.
fn sent_shape(profile: &Profile, name: &str) -> Vec<Option<usize>> {
    match profile.cameras.iter().find(|camera| camera.key == name) {
        Some(Camera { width: w, height: h, axes: Axes::Hwc, .. }) => vec![Some(*h), Some(*w), Some(3)],
        Some(Camera { width: w, height: h, axes: Axes::Chw, .. }) => vec![Some(3), Some(*h), Some(*w)],
        None => vec![None],
    }
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
