//! Networks in ONNX files, run in this process by tract on one core.
//!
//! The keys of cameras and states are the names of the inputs. An image is passed as bytes if the network takes bytes, and
//! as floats from 0 to 1 if it takes floats. If an input has more axes than the profile's array, leading axes of size 1
//! are added, for example for a batch. The first output is the chunk of actions. The same file, profile and observation
//! give the same actions.

use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use serde_json::{Value as Json, json};
use sha2::{Digest, Sha256};
use tract_onnx::prelude::{
    DatumType, Framework, InferenceFact, InferenceModelExt, IntoRunnable, TValue, TVec, Tensor, TractError,
    TractResult, TypedRunnableModel,
};
use tract_onnx::tract_hir::infer::Factoid;

use super::array::{Array, Dtype};
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::profile::{Axes, Camera, Profile};
use super::{chunk::Chunk, query::Query};

/// Largest file that is read, in bytes.
const MAX_FILE: u64 = 1 << 30;

/// A loaded network.
pub(crate) struct Network {
    model: Arc<TypedRunnableModel>,
    inputs: Vec<Input>,
    declared: Json,
}

/// An input of the network.
struct Input {
    name: String,
    dtype: DatumType,
    shape: Vec<usize>,
}

impl Network {
    /// Load a file and check its inputs against the profile.
    pub(crate) fn load(path: &str, profile: &Profile) -> Result<Self, PolicyError> {
        let invalid = |why: String| PolicyError::File { path: path.to_owned(), why };
        let bytes = read(path).map_err(invalid)?;
        let sha256: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let (model, inputs) =
            catch_panics(|| prepare(&bytes, profile)).map_err(|why| invalid(explain(&bytes, &why)))?;
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
            return Err(PolicyError::Mismatch(format!(
                "the network has an input `{name}`, but the profile sends {keys}"
            )));
        }
        let described: Vec<Json> = inputs
            .iter()
            .map(|input| json!({"name": input.name, "shape": input.shape, "type": format!("{:?}", input.dtype)}))
            .collect();
        let declared = json!({"sha256": sha256, "inputs": described});
        Ok(Self { model, inputs, declared })
    }
}

impl Connection for Network {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), PolicyError> {
        Ok(())
    }

    fn infer(&mut self, query: &Query, _: Deadline) -> Result<Chunk, PolicyError> {
        let tensors = self.inputs.iter().map(|input| {
            let mut sent = query.images.iter().chain(&query.states);
            let array = sent.find(|(key, _)| *key == input.name).map(|(_, array)| array);
            let array = array.ok_or_else(|| PolicyError::Mismatch(format!("the profile sends no `{}`", input.name)))?;
            Ok(input.tensor(array)?.into())
        });
        let tensors: TVec<TValue> = tensors.collect::<Result<_, PolicyError>>()?;
        let (shape, numbers) = catch_panics(|| {
            let outputs = self.model.run(tensors)?;
            let actions = outputs.first().map(|output| output.cast_to::<f64>()).transpose()?;
            actions.map_or_else(
                || Ok((Vec::new(), Vec::new())),
                |actions| {
                    Ok((actions.shape().to_vec(), actions.to_plain_array_view::<f64>()?.iter().copied().collect()))
                },
            )
        })
        .map_err(|why| PolicyError::reported(&why))?;
        let data = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let array = Array::new(Dtype::F64, shape, data).map_err(|e| PolicyError::Shape(e.to_string()))?;
        Chunk::of_array(&array)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

impl Input {
    /// Convert an array to the type and shape of this input.
    fn tensor(&self, array: &Array) -> Result<Tensor, PolicyError> {
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
        let tensor = match self.dtype {
            DatumType::U8 if is_picture => Tensor::from_shape(&self.shape, array.data()),
            DatumType::F32 => {
                let scale = if is_picture { 1.0 / 255.0 } else { 1.0 };
                let numbers: Vec<f32> = array.numbers().iter().map(|n| (n * scale) as f32).collect();
                Tensor::from_shape(&self.shape, &numbers)
            }
            other => {
                let (name, sent) = (&self.name, array.dtype().name());
                return Err(PolicyError::Mismatch(format!(
                    "the input `{name}` has the type {other:?}, but the profile sends {sent}. Supported: F32, and U8 for images"
                )));
            }
        };
        tensor.map_err(|e| PolicyError::Mismatch(format!("{e:#}")))
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
        format!("cannot be loaded as an ONNX model: {why}")
    }
}

/// A runnable model and its inputs.
type Prepared = (Arc<TypedRunnableModel>, Vec<Input>);

fn prepare(bytes: &[u8], profile: &Profile) -> TractResult<Prepared> {
    let mut model = tract_onnx::onnx().model_for_read(&mut &*bytes)?;
    let mut inputs = Vec::new();
    for (i, outlet) in model.input_outlets()?.to_vec().into_iter().enumerate() {
        let name = model.node(outlet.node).name.clone();
        let fact = model.input_fact(i)?;
        let dtype = fact.datum_type.concretize().unwrap_or(DatumType::F32);
        let axes = fact.shape.dims().map(|dim| usize::try_from(dim.concretize()?.as_i64()?).ok());
        let shape = fixed_shape(&axes.collect::<Vec<_>>(), sent_shape(profile, &name)).ok_or_else(|| {
            TractError::msg(format!("the input `{name}` has no fixed size. Export the model with fixed sizes"))
        })?;
        model.set_input_fact(i, InferenceFact::dt_shape(dtype, &shape))?;
        inputs.push(Input { name, dtype, shape });
    }
    // The shape of the output follows from the inputs; the file may leave it open.
    model.set_output_fact(0, InferenceFact::default())?;
    Ok((model.into_optimized()?.into_runnable()?, inputs))
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

/// Runs a third-party library on a file and converts a panic into an error for that file.
fn catch_panics<T>(work: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(result) => result.map_err(|e| format!("{e:#}")),
        Err(_) => Err("the ONNX library panicked".to_owned()),
    }
}
