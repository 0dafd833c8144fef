//! Memory of a recurrent network: outputs that are its inputs at the next request of the episode.

use rten::Value;
use rten_onnx::onnx::{DataType, ModelProto};
use rten_tensor::Tensor;
use rten_tensor::prelude::*;

use super::super::error::PolicyError;
use super::super::profile::{Memory, Profile};
use super::sizes::{Array, computed};
use super::{Input, name};

/// The value of one memory.
pub(super) struct Cell {
    /// Index of the input.
    pub(super) input: usize,
    /// The value of the input at the next request.
    pub(super) value: Value,
}

/// Keep the outputs that are used: the actions, which are the first output that is not a memory, and then the outputs of
/// the profile's memories, in their order.
pub(super) fn choose_outputs(model: &mut ModelProto, profile: &Profile) -> Result<(), PolicyError> {
    let Some(graph) = &mut model.graph else { return Ok(()) };
    let outputs = std::mem::take(&mut graph.output);
    let names: Vec<String> = outputs.iter().map(|output| output.name.clone().unwrap_or_default()).collect();
    let find = |memory: &Memory| outputs.iter().find(|output| output.name.as_ref() == Some(&memory.output)).cloned();
    let missing = |memory: &Memory| {
        PolicyError::Mismatch(format!(
            "memory.output `{}` is not an output of the network, which has {}. Hint: correct [[memory]] in the profile",
            memory.output,
            names.join(", ")
        ))
    };
    let is_memory = |name: &String| profile.memories.iter().any(|memory| memory.output == *name);
    let actions = outputs.iter().find(|output| !output.name.as_ref().is_some_and(is_memory)).cloned();
    let kept = profile.memories.iter().map(|memory| find(memory).ok_or_else(|| missing(memory)));
    let kept: Vec<_> = kept.collect::<Result<_, _>>()?;
    let no_actions = || {
        PolicyError::Mismatch(format!(
            "all outputs of the network ({}) are memories. Expected another one with the actions",
            names.join(", ")
        ))
    };
    graph.output = std::iter::once(actions.ok_or_else(no_actions)?).chain(kept).collect();
    // Only the inputs are believed.
    graph.output.iter_mut().for_each(|output| output.r#type = None);
    Ok(())
}

/// Check that each memory has one shape and one type, as input and as output. `outputs` are the actions and then the
/// memories of the profile. Returns the memories at the start of an episode.
pub(super) fn cells(profile: &Profile, inputs: &[Input], outputs: &[Array]) -> Result<Vec<Cell>, PolicyError> {
    let cell = |(memory, output): (&Memory, &Array)| {
        let found = inputs.iter().position(|input| input.name == memory.input);
        let at = found.ok_or_else(|| PolicyError::Mismatch(format!("the network has no input `{}`", memory.input)))?;
        let input = &inputs[at];
        let described = |dtype, shape: &[usize]| format!("{shape:?} {}", name(dtype));
        if computed(input.dtype) != Some(output.dtype) || input.shape != output.shape {
            return Err(PolicyError::Mismatch(format!(
                "the memory `{}` takes {}, but the output `{}` is {}. Expected the same shape and type. Hint: correct \
                 [[memory]] in the profile, or export the network with an output of the shape of its input",
                memory.input,
                described(input.dtype, &input.shape),
                memory.output,
                described(output.dtype, &output.shape)
            )));
        }
        Ok(Cell { input: at, value: zero(input)? })
    };
    profile.memories.iter().zip(outputs.iter().skip(1)).map(cell).collect()
}

/// Zeros for an input.
pub(super) fn zero(input: &Input) -> Result<Value, PolicyError> {
    let shape = &input.shape[..];
    Ok(match computed(input.dtype) {
        Some(DataType::FLOAT) => Tensor::<f32>::zeros(shape).into(),
        Some(DataType::INT32) => Tensor::<i32>::zeros(shape).into(),
        Some(DataType::INT8) => Tensor::<i8>::zeros(shape).into(),
        Some(DataType::UINT8) => Tensor::<u8>::zeros(shape).into(),
        _ => {
            let (input, dtype) = (&input.name, name(input.dtype));
            let why = format!("the memory `{input}` has the type {dtype}, which is not supported");
            return Err(PolicyError::Mismatch(why));
        }
    })
}

/// Check the size of a memory that the network has computed. Sizes that are inferred before may be upper limits.
pub(super) fn check(input: &Input, value: &Value) -> Result<(), PolicyError> {
    if *value.shape() == *input.shape {
        return Ok(());
    }
    Err(PolicyError::Shape(format!(
        "the memory `{}` takes {:?}, but the network has computed {:?} for it. Expected the same shape",
        input.name,
        input.shape,
        &*value.shape()
    )))
}
