//! Networks without a server: an ONNX file, run inside by tract on one core.
//!
//! Inputs are found by name: a picture by its camera's key, a vector by its state's. A picture comes as bytes where the network
//! takes bytes, and as floats from 0 to 1 where it takes floats. Axes of one are put before what the profile says where the
//! network has more, as for a batch, and close what it leaves open there. The first output is the chunk of actions. The same file, profile and pictures give the
//! same actions, whatever else runs.

use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use serde_json::{Value as Json, json};
use sha2::{Digest, Sha256};
use tract_onnx::prelude::{
    DatumType, Framework, InferenceFact, InferenceModelExt, IntoRunnable, TValue, TVec, Tensor, TractError,
    TractResult, TypedRunnableModel,
};
use tract_onnx::tract_hir::infer::Factoid;

use super::array::{Array, Dtype};
use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::Link;
use super::profile::{Axes, Camera, Profile};
use super::websocket::Deadline;

/// A file that is larger is not read, in bytes.
const MAX_FILE: u64 = 1 << 30;

/// A network, ready to be asked.
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
    /// Reads the file and holds its inputs against the profile.
    pub(crate) fn load(path: &str, profile: &Profile) -> Result<Self, ServerError> {
        let address = |why: String| ServerError::Address { url: path.to_owned(), why };
        let mut bytes = Vec::new();
        File::open(path)
            .and_then(|file| file.take(MAX_FILE + 1).read_to_end(&mut bytes))
            .map_err(|e| address(format!("cannot be read: {e}")))?;
        if bytes.len() as u64 > MAX_FILE {
            return Err(address(format!("more than {} MB: no network for one core", MAX_FILE >> 20)));
        }
        let sha256: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let (model, inputs) = guarded(|| prepare(&bytes, profile))
            .map_err(|why| address(format!("no ONNX file that can be run: {why}")))?;
        let wanted: Vec<&str> = inputs.iter().map(|input| input.name.as_str()).collect();
        let cameras = profile.cameras.iter().map(|camera| camera.key.as_str());
        let keys: Vec<&str> = cameras.chain(profile.states.iter().map(|state| state.key.as_str())).collect();
        if let Some(key) = keys.iter().find(|key| !wanted.contains(key)) {
            let wanted = wanted.join(", ");
            return Err(ServerError::Mismatch(format!("the profile sends `{key}`; the network takes {wanted}")));
        }
        if let Some(name) = wanted.iter().find(|name| !keys.contains(name)) {
            let keys = keys.join(", ");
            return Err(ServerError::Mismatch(format!("the network takes `{name}`; the profile sends {keys}")));
        }
        let described: Vec<Json> = inputs
            .iter()
            .map(|input| json!({"name": input.name, "shape": input.shape, "type": format!("{:?}", input.dtype)}))
            .collect();
        let declared = json!({"sha256": sha256, "inputs": described});
        Ok(Self { model, inputs, declared })
    }
}

impl Link for Network {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), ServerError> {
        Ok(())
    }

    fn ask(&mut self, query: &Query, _: Deadline) -> Result<Chunk, ServerError> {
        let tensors = self.inputs.iter().map(|input| {
            let mut sent = query.images.iter().chain(&query.states);
            let array = sent.find(|(key, _)| *key == input.name).map(|(_, array)| array);
            let array = array.ok_or_else(|| ServerError::Mismatch(format!("nothing is sent as `{}`", input.name)))?;
            Ok(input.tensor(array)?.into())
        });
        let tensors: TVec<TValue> = tensors.collect::<Result<_, ServerError>>()?;
        let (shape, numbers) = guarded(|| {
            let outputs = self.model.run(tensors)?;
            let actions = outputs.first().map(|output| output.cast_to::<f64>()).transpose()?;
            actions.map_or_else(
                || Ok((Vec::new(), Vec::new())),
                |actions| {
                    Ok((actions.shape().to_vec(), actions.to_plain_array_view::<f64>()?.iter().copied().collect()))
                },
            )
        })
        .map_err(|why| ServerError::refused(&why))?;
        let data = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let array = Array::new(Dtype::F64, shape, data).map_err(|e| ServerError::Shape(e.to_string()))?;
        Chunk::of_array(&array)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

impl Input {
    /// What is sent, as the network takes it.
    fn tensor(&self, array: &Array) -> Result<Tensor, ServerError> {
        let shape = array.shape();
        let more = self.shape.len().checked_sub(shape.len());
        let fits = more.is_some_and(|more| self.shape[..more].iter().all(|n| *n == 1) && self.shape[more..] == *shape);
        if !fits {
            let (name, wanted) = (&self.name, &self.shape);
            return Err(ServerError::Mismatch(format!(
                "the profile sends `{name}` as {shape:?}; the network takes {wanted:?}"
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
                return Err(ServerError::Mismatch(format!(
                    "`{name}` is {other:?} in the network; {sent} is sent as F32, pictures also as U8"
                )));
            }
        };
        tensor.map_err(|e| ServerError::Mismatch(format!("{e:#}")))
    }
}

type Prepared = (Arc<TypedRunnableModel>, Vec<Input>);

fn prepare(bytes: &[u8], profile: &Profile) -> TractResult<Prepared> {
    let mut model = tract_onnx::onnx().model_for_read(&mut &*bytes)?;
    let mut inputs = Vec::new();
    for (i, outlet) in model.input_outlets()?.to_vec().into_iter().enumerate() {
        let name = model.node(outlet.node).name.clone();
        let fact = model.input_fact(i)?;
        let dtype = fact.datum_type.concretize().unwrap_or(DatumType::F32);
        let axes = fact.shape.dims().map(|dim| usize::try_from(dim.concretize()?.as_i64()?).ok());
        let shape = closed(&axes.collect::<Vec<_>>(), sent(profile, &name)).ok_or_else(|| {
            TractError::msg(format!("the size of its input `{name}` is left open: export it with a size"))
        })?;
        model.set_input_fact(i, InferenceFact::dt_shape(dtype, &shape))?;
        inputs.push(Input { name, dtype, shape });
    }
    // What comes out follows from what goes in; what the file says of it may still be open.
    model.set_output_fact(0, InferenceFact::default())?;
    Ok((model.into_optimized()?.into_runnable()?, inputs))
}

/// What the profile sends under this name: the axes of a picture, or one axis of a length that the robot knows.
fn sent(profile: &Profile, name: &str) -> Vec<Option<usize>> {
    match profile.cameras.iter().find(|camera| camera.key == name) {
        Some(Camera { width: w, height: h, axes: Axes::Hwc, .. }) => vec![Some(*h), Some(*w), Some(3)],
        Some(Camera { width: w, height: h, axes: Axes::Chw, .. }) => vec![Some(3), Some(*h), Some(*w)],
        None => vec![None],
    }
}

/// Axes that a network leaves open, closed: one where more come than are sent, as for a batch; else what is sent.
fn closed(axes: &[Option<usize>], sent: Vec<Option<usize>>) -> Option<Vec<usize>> {
    let more = axes.len().saturating_sub(sent.len());
    let sent = std::iter::repeat_n(Some(1), more).chain(sent);
    axes.iter().zip(sent).map(|(axis, sent)| axis.or(sent)).collect()
}

/// What a library does with a file that somebody else wrote: should it break, that is an error of the file's.
fn guarded<T>(work: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(result) => result.map_err(|e| format!("{e:#}")),
        Err(_) => Err("the network breaks what runs it".to_owned()),
    }
}
