//! Computes the memory that a network needs, before the library runs any of it.
//!
//! A few bytes of a file can ask for terabytes, and a failed allocation ends the process. All sizes follow from the
//! inputs, which are fixed, so that they can be computed node by node: the library infers the sizes of one node at a time,
//! from a network that holds only this node. Its data are inputs of that network, and therefore nothing is computed. Small
//! constants, such as shapes, are computed for the nodes that follow.
//!
//! The work space of a node while it runs is not counted.

use std::collections::{HashMap, HashSet};

use rten::{Dimension, LoadErrorKind, Model, ModelOptions, RunOptions, Value, ValueType};
use rten_onnx::onnx::{AttributeProto, DataType, GraphProto, ModelProto, NodeProto, TensorProto};
use rten_onnx::onnx::{OperatorSetIdProto, TensorShapeProto, TypeProto, TypeProtoTensor, ValueInfoProto};
use rten_tensor::prelude::*;

/// Largest array, in elements of up to 4 bytes.
const MAX_ELEMENTS: f64 = (1_u64 << 28) as f64;

/// Most memory for all arrays of a network together, in bytes.
const MAX_BYTES: f64 = (4_u64 << 30) as f64;

/// Largest constant, in elements, that is computed for the nodes that follow.
const SMALL: usize = 1024;

/// Most nodes of a network.
const MAX_NODES: usize = 50_000;

/// Type and shape of an output of a network.
pub(super) struct Array {
    /// The type in which the library computes.
    pub(super) dtype: DataType,
    pub(super) shape: Vec<usize>,
}

/// What is known of an array.
#[derive(Clone)]
struct Known {
    dtype: DataType,
    shape: Vec<usize>,
    /// The content, if it is constant and small.
    content: Option<TensorProto>,
}

/// Check that a network with inputs of fixed sizes needs a limited amount of memory. Returns types and shapes of its
/// outputs.
pub(super) fn check(model: &ModelProto, options: &ModelOptions, run: &RunOptions) -> Result<Vec<Array>, String> {
    let graph = model.graph.as_ref().ok_or("it has no graph")?;
    if graph.node.len() > MAX_NODES {
        return Err(format!("it has {} nodes. Expected at most {MAX_NODES}", graph.node.len()));
    }
    let used = graph.node.iter().flat_map(|node| &node.input).map(String::as_str);
    let used = used.chain(graph.output.iter().filter_map(|output| output.name.as_deref())).collect();
    let opsets = &model.opset_import;
    let mut sizes = Sizes { opsets, options, run, used, arrays: HashMap::new(), bytes: 0.0 };
    for tensor in &graph.initializer {
        let name = tensor.name.as_deref().unwrap_or_default();
        let added = sizes.initializer(tensor).and_then(|array| sizes.add(name, array));
        added.map_err(|why| format!("constant `{name}`: {why}"))?;
    }
    for input in &graph.input {
        let name = input.name.as_deref().unwrap_or_default();
        let unknown = || "its type or size is not supported".to_owned();
        let added = described(input).ok_or_else(unknown).and_then(|array| sizes.add(name, array));
        added.map_err(|why| format!("input `{name}`: {why}"))?;
    }
    for node in &graph.node {
        sizes.node(node).map_err(|why| format!("{}: {why}", label(node)))?;
    }
    let outputs = graph.output.iter().map(|output| {
        let name = output.name.as_deref().unwrap_or_default();
        let known = sizes.arrays.get(name).ok_or_else(|| format!("no node computes its output `{name}`"))?;
        Ok(Array { dtype: known.dtype, shape: known.shape.clone() })
    });
    outputs.collect()
}

/// The sizes computed so far.
struct Sizes<'a> {
    opsets: &'a [OperatorSetIdProto],
    options: &'a ModelOptions,
    run: &'a RunOptions,
    /// Names that a node or the network reads. Outputs that nothing reads are not computed.
    used: HashSet<&'a str>,
    arrays: HashMap<&'a str, Known>,
    bytes: f64,
}

impl<'a> Sizes<'a> {
    /// Count an array and remember it.
    fn add(&mut self, name: &'a str, array: Known) -> Result<(), String> {
        if self.arrays.contains_key(name) {
            return Err(format!("`{name}` is defined twice"));
        }
        let elements = array.check()?;
        // The library holds vectors of integers as expressions while it infers shapes.
        let is_vector = array.dtype == DataType::INT32 && array.shape.len() <= 1;
        self.bytes += elements * if is_vector { 64.0 } else { 4.0 };
        if self.bytes > MAX_BYTES {
            let limit = MAX_BYTES / f64::from(1 << 20);
            return Err(format!("all arrays of the network together would need more than {limit} MiB"));
        }
        self.arrays.insert(name, array);
        Ok(())
    }

    fn initializer(&self, tensor: &TensorProto) -> Result<Known, String> {
        let shape: Option<Vec<usize>> = tensor.dims.iter().map(|n| i32::try_from(*n).ok()?.try_into().ok()).collect();
        let shape = shape.ok_or_else(|| format!("it has the shape {:?}. Expected sizes below 2^31", tensor.dims))?;
        if !tensor.external_data.is_empty() {
            return Err("it is in another file. Expected a single file. Hint: \
                 onnx.save(onnx.load(\"model.onnx\"), \"single.onnx\")"
                .to_owned());
        }
        let dtype = tensor.data_type.unwrap_or(DataType(0));
        let dtype = computed(dtype).ok_or_else(|| format!("its type {dtype} is not supported"))?;
        let array = Known { dtype, shape, content: None };
        let content = if array.is_small() {
            let graph = GraphProto { initializer: vec![tensor.clone()], ..GraphProto::default() };
            self.evaluate(graph, &[tensor.name.as_deref().unwrap_or_default()])?.pop().and_then(|array| array.content)
        } else {
            None
        };
        Ok(Known { content, ..array })
    }

    fn node(&mut self, node: &'a NodeProto) -> Result<(), String> {
        if node.attribute.iter().any(|attribute| attribute.g.is_some()) {
            let why = "control flow is not supported. Hint: export the model with fixed sizes, without branches";
            return Err(why.to_owned());
        }
        let inputs: Vec<Option<&Known>> = node.input.iter().map(|name| self.read(name)).collect::<Result<_, _>>()?;
        let outputs: Vec<&str> = node
            .output
            .iter()
            .map(String::as_str)
            .filter(|name| !name.is_empty() && self.used.contains(name))
            .collect();
        let op = node.op_type.as_deref().unwrap_or_default();
        check_recurrent(node)?;
        check_elements(largest(node, &inputs).unwrap_or(0.0))?;
        let arrays = if op == "Constant" {
            self.evaluate(single(node, &outputs), &outputs)?
        } else if let Some(array) = created(node, &inputs) {
            vec![array?]
        } else if let Some(array) = product(node, &inputs) {
            vec![array?]
        } else if op == "Split" && node.input.len() < 2 && attribute(node, "split").is_none() {
            split(node, &inputs).ok_or("its axis is out of range")?
        } else {
            self.infer(node, &outputs)?
        };
        arrays.iter().try_for_each(|array| array.check().map(drop))?;
        let is_constant = inputs.iter().flatten().all(|input| input.content.is_some());
        let arrays = if op != "Constant" && is_constant && arrays.iter().all(Known::is_small) {
            let mut graph = single(node, &outputs);
            graph.initializer = self.contents(node, None);
            self.evaluate(graph, &outputs)?
        } else {
            arrays
        };
        let names = node.output.iter().filter(|name| outputs.contains(&name.as_str()));
        for (name, array) in names.zip(arrays) {
            self.add(name, array)?;
        }
        Ok(())
    }

    /// What is known of an input of a node; `None` for an optional one that is absent.
    fn read(&self, name: &str) -> Result<Option<&Known>, String> {
        if name.is_empty() {
            return Ok(None);
        }
        let missing = || format!("it reads `{name}`, which no earlier node computes");
        self.arrays.get(name).map(Some).ok_or_else(missing)
    }

    /// Infer the sizes of the outputs of a node. Its first input is taken as unknown, so that nothing is computed.
    fn infer(&self, node: &NodeProto, outputs: &[&str]) -> Result<Vec<Known>, String> {
        let data = node.input.iter().find(|name| !name.is_empty()).map(String::as_str);
        let mut graph = single(node, outputs);
        graph.initializer = self.contents(node, data);
        for name in &node.input {
            let is_new = !graph.input.iter().any(|input| input.name.as_ref() == Some(name));
            if let Some(array) = self.arrays.get(name.as_str())
                && is_new
                && (array.content.is_none() || Some(name.as_str()) == data)
            {
                graph.input.push(description(name, array.dtype, &array.shape));
            }
        }
        let inputs = graph.input.clone();
        let model = self.load(graph)?;
        // The library does not infer all sizes of pools. Their outputs are limited by `largest`.
        let is_float = data.and_then(|name| self.arrays.get(name)).is_some_and(|data| data.dtype == DataType::FLOAT);
        if is_float && matches!(node.op_type.as_deref(), Some("AveragePool" | "MaxPool")) {
            return self.run_on_zeros(&model, &inputs, outputs);
        }
        let known = model.output_ids().iter().zip(outputs).map(|(id, name)| {
            let info = model.node_info(*id);
            let shape = info.as_ref().and_then(|info| info.shape()).and_then(|dimensions| {
                let sizes = dimensions.into_iter().map(|dimension| match dimension {
                    Dimension::Fixed(size) => Some(size),
                    Dimension::Symbolic(_) => None,
                });
                sizes.collect()
            });
            let dtype = info.as_ref().and_then(|info| info.dtype()).and_then(of_library);
            shape.zip(dtype).map(|(shape, dtype)| Known { dtype, shape, content: None }).ok_or_else(|| {
                format!(
                    "the size of its output `{name}` is not known before it runs. Hint: export the model with fixed sizes"
                )
            })
        });
        let known: Vec<Known> = known.collect::<Result<_, _>>()?;
        if matches!(node.op_type.as_deref(), Some("Shape" | "Size")) {
            let ids = model.output_ids();
            let values = model.run(Vec::new(), ids, Some(self.run.clone())).map_err(|e| e.to_string())?;
            return values.into_iter().zip(outputs).map(|(value, name)| content(name, value)).collect();
        }
        Ok(known)
    }

    /// Compute a network for inputs of zeros.
    fn run_on_zeros(&self, model: &Model, inputs: &[ValueInfoProto], outputs: &[&str]) -> Result<Vec<Known>, String> {
        let zeros = inputs.iter().map(|input| {
            let name = input.name.as_deref().unwrap_or_default();
            let shape = self.arrays.get(name).map_or(&[][..], |array| &array.shape);
            let zeros = vec![0_f32; elements(shape) as usize];
            let zeros = Value::from_shape(shape, zeros).map_err(|e| e.to_string())?;
            Ok((model.node_id(name).map_err(|e| e.to_string())?, zeros.into()))
        });
        let zeros = zeros.collect::<Result<_, String>>()?;
        let values = model.run(zeros, model.output_ids(), Some(self.run.clone())).map_err(|e| e.to_string())?;
        let known = values.into_iter().zip(outputs).map(|(value, name)| content(name, value));
        known.map(|known| Ok(Known { content: None, ..known? })).collect()
    }

    /// The small constants that a node reads, except for one input.
    fn contents(&self, node: &NodeProto, except: Option<&str>) -> Vec<TensorProto> {
        let mut contents: Vec<TensorProto> = Vec::new();
        for name in node.input.iter().filter(|name| Some(name.as_str()) != except) {
            let is_new = !contents.iter().any(|content| content.name.as_ref() == Some(name));
            if let Some(content) = self.arrays.get(name.as_str()).and_then(|array| array.content.as_ref())
                && is_new
            {
                contents.push(content.clone());
            }
        }
        contents
    }

    /// Compute a network without inputs.
    fn evaluate(&self, mut graph: GraphProto, outputs: &[&str]) -> Result<Vec<Known>, String> {
        graph.output = outputs.iter().map(|name| named(name)).collect();
        let model = self.load(graph)?;
        let values = model.run(Vec::new(), model.output_ids(), Some(self.run.clone())).map_err(|e| e.to_string())?;
        values.into_iter().zip(outputs).map(|(value, name)| content(name, value)).collect()
    }

    fn load(&self, graph: GraphProto) -> Result<Model, String> {
        let opset_import = self.opsets.to_vec();
        let model = ModelProto { ir_version: Some(8), graph: Some(graph), opset_import, ..ModelProto::default() };
        let bytes = model.write_buf().map_err(|e| e.to_string())?;
        self.options.load(bytes).map_err(|e| {
            let why = e.to_string();
            if e.kind() == LoadErrorKind::OperatorInvalid && why.contains("not enabled") {
                "this operator is not supported. Hint: export the model with another opset, or for evaluation"
                    .to_owned()
            } else {
                why
            }
        })
    }
}

/// Check that the library computes a recurrent layer as its node says.
fn check_recurrent(node: &NodeProto) -> Result<(), String> {
    let op = node.op_type.as_deref().unwrap_or_default();
    // The library ignores the lengths of sequences.
    if matches!(op, "GRU" | "LSTM") && node.input.get(4).is_some_and(|name| !name.is_empty()) {
        return Err("sequence_lens is not supported. Hint: export the model with sequences of one length".to_owned());
    }
    let linear = attribute(node, "linear_before_reset").and_then(|attribute| attribute.i);
    if op == "GRU" && linear != Some(1) {
        return Err("only linear_before_reset = 1 is supported, which PyTorch exports".to_owned());
    }
    Ok(())
}

/// A node for error messages.
fn label(node: &NodeProto) -> String {
    let op = node.op_type.as_deref().unwrap_or("without operator");
    match node.name.as_deref().filter(|name| !name.is_empty()) {
        Some(name) => format!("node `{name}` ({op})"),
        None => format!("node of `{}` ({op})", node.output.first().map_or("", String::as_str)),
    }
}

/// A network that holds only this node.
fn single(node: &NodeProto, outputs: &[&str]) -> GraphProto {
    let mut node = node.clone();
    for name in &mut node.output {
        if !outputs.contains(&name.as_str()) {
            name.clear();
        }
    }
    let output = outputs.iter().map(|name| named(name)).collect();
    GraphProto { node: vec![node], output, ..GraphProto::default() }
}

/// The array of a node that creates it from the contents of its inputs; `None` for other nodes.
fn created(node: &NodeProto, inputs: &[Option<&Known>]) -> Option<Result<Known, String>> {
    let unknown =
        || "its size depends on what the network computes. Hint: export the model with fixed sizes".to_owned();
    let numbers = |i: usize| inputs.get(i).copied().flatten().and_then(numbers).ok_or_else(unknown);
    let create = |dtype, sizes: &[f64]| {
        check_elements(sizes.iter().product())?;
        // An array without elements may claim axes of any size.
        let shape = sizes.iter().map(|size| size.min(MAX_ELEMENTS) as usize).collect();
        Ok(Known { dtype, shape, content: None })
    };
    match node.op_type.as_deref()? {
        "ConstantOfShape" => {
            let value = attribute(node, "value").and_then(|attribute| attribute.t.as_ref());
            let dtype = value.and_then(|value| value.data_type).map_or(Some(DataType::FLOAT), computed);
            let dtype = dtype.unwrap_or(DataType::FLOAT);
            Some(numbers(0).and_then(|sizes| create(dtype, &sizes)))
        }
        "Range" => Some((|| {
            let [start, limit, delta] = [numbers(0)?, numbers(1)?, numbers(2)?].map(|n| n.first().copied());
            let count = start.zip(limit).zip(delta).map(|((start, limit), delta)| ((limit - start) / delta).ceil());
            let dtype = inputs[0].map_or(DataType::FLOAT, |input| input.dtype);
            create(dtype, &[count.filter(|count| count.is_finite()).ok_or_else(unknown)?.max(0.0)])
        })()),
        _ => None,
    }
}

/// The array of a product with a vector. The library does not infer it. `None` for other nodes.
fn product(node: &NodeProto, inputs: &[Option<&Known>]) -> Option<Result<Known, String>> {
    let [Some(left), Some(right)] = inputs else { return None };
    let (a, b) = (&left.shape[..], &right.shape[..]);
    if node.op_type.as_deref() != Some("MatMul") || (a.len() != 1 && b.len() != 1) {
        return None;
    }
    let wrong = || format!("its inputs have the sizes {a:?} and {b:?}, which cannot be multiplied");
    let shape = || match (a, b) {
        ([n], [m]) if n == m => Ok(Vec::new()),
        ([n], [stack @ .., m, columns]) if n == m => Ok([stack, &[*columns]].concat()),
        ([stack @ .., rows, n], [m]) if n == m => match stack.iter().product() {
            0 | 1 => Ok([stack, &[*rows]].concat()),
            // The library would keep an axis of size 1.
            matrices => Err(format!(
                "the product of {matrices} matrices and one vector is not supported. Hint: make the vector a matrix with one \
                 column, and remove that axis of the product"
            )),
        },
        _ => Err(wrong()),
    };
    Some(shape().map(|shape| Known { dtype: DataType::FLOAT, shape, content: None }))
}

/// The outputs that are read of a node that splits an array into equal parts. The library does not infer them.
fn split(node: &NodeProto, inputs: &[Option<&Known>]) -> Option<Vec<Known>> {
    let array = inputs.first().copied().flatten()?;
    let axis = attribute(node, "axis").and_then(|axis| axis.i).unwrap_or(0);
    let rank = i64::try_from(array.shape.len()).ok()?;
    let axis = usize::try_from(if axis < 0 { axis + rank } else { axis }).ok()?;
    let mut shape = array.shape.clone();
    let size = shape.get_mut(axis)?;
    // The last part may be smaller.
    *size = size.div_ceil(node.output.len());
    Some(vec![Known { dtype: array.dtype, shape, content: None }; node.output.len()])
}

/// An upper limit of the elements of the first output of a node, or of its work space, for operators whose sizes the
/// library could compute wrongly: it uses integers of 32 bits.
fn largest(node: &NodeProto, inputs: &[Option<&Known>]) -> Option<f64> {
    let input = |i: usize| inputs.get(i).copied().flatten();
    let shape = |i: usize| input(i).map(|input| input.shape.iter().map(|n| *n as f64).collect::<Vec<f64>>());
    let numbers = |i: usize| input(i).and_then(numbers);
    let integers = |name: &str| attribute(node, name).map(|attribute| &attribute.ints[..]);
    let op = node.op_type.as_deref()?;
    match op {
        "Tile" => Some(shape(0)?.iter().product::<f64>() * numbers(1)?.iter().product::<f64>()),
        "Concat" => Some(inputs.iter().flatten().map(|input| elements(&input.shape)).sum()),
        "Pad" => {
            let pads = numbers(1).or_else(|| Some(integers("pads")?.iter().map(|n| *n as f64).collect()))?;
            let mut sizes = shape(0)?;
            let axes = numbers(3).unwrap_or_else(|| (0..sizes.len()).map(|i| i as f64).collect());
            for (i, axis) in axes.iter().enumerate() {
                let rank = sizes.len() as f64;
                let axis = if *axis < 0.0 { axis + rank } else { *axis };
                let added = [pads.get(i), pads.get(i + axes.len())].into_iter().flatten();
                *sizes.get_mut(axis as usize)? += added.map(|n| n.abs()).sum::<f64>();
            }
            Some(sizes.iter().product())
        }
        "Resize" | "Upsample" => {
            let scales = numbers(if op == "Resize" && inputs.len() > 2 { 2 } else { 1 }).unwrap_or_default();
            let sizes = numbers(3).unwrap_or_default();
            let scaled = shape(0)?.iter().product::<f64>() * scales.iter().product::<f64>();
            Some(scaled.max(sizes.iter().product()))
        }
        "Conv" | "MaxPool" | "AveragePool" | "ConvTranspose" => {
            let axes = shape(0)?;
            let most =
                |name: &str| integers(name).map_or(0.0, |ints| ints.iter().fold(0.0, |m: f64, n| m.max(*n as f64)));
            let grown = if op == "ConvTranspose" { most("strides").max(1.0) } else { 1.0 };
            let kernel = shape(1).unwrap_or_default();
            let spread = kernel.iter().skip(2).fold(0.0, |m: f64, n| m.max(*n)) * most("dilations").max(1.0);
            let added = if op == "ConvTranspose" { spread + most("output_padding") } else { 2.0 * most("pads") };
            let spatial: f64 = axes.iter().skip(2).map(|n| n * grown + added).product();
            let (batch, channels) = (axes.first()?, axes.get(1)?);
            Some(match op {
                "Conv" => batch * kernel.first()? * spatial,
                // With a column for each pixel of the input.
                "ConvTranspose" => {
                    let pixels: f64 = axes.iter().skip(2).product();
                    let columns = kernel.iter().skip(1).product::<f64>() * pixels;
                    let groups = attribute(node, "group").and_then(|group| group.i).unwrap_or(1).max(1) as f64;
                    (batch * kernel.get(1)? * groups * spatial).max(columns)
                }
                _ => batch * channels * spatial,
            })
        }
        _ => None,
    }
}

impl Known {
    /// Check the number of elements and return it.
    fn check(&self) -> Result<f64, String> {
        check_elements(elements(&self.shape))
    }

    fn is_small(&self) -> bool {
        elements(&self.shape) <= SMALL as f64
    }
}

/// The number of elements of an array. The product of integers could overflow.
fn elements(shape: &[usize]) -> f64 {
    shape.iter().map(|n| *n as f64).product()
}

/// Check the number of elements of an array.
fn check_elements(elements: f64) -> Result<f64, String> {
    if (0.0..=MAX_ELEMENTS).contains(&elements) {
        return Ok(elements);
    }
    Err(format!("it would need an array of {elements:.0} elements. Expected at most {MAX_ELEMENTS}"))
}

fn attribute<'a>(node: &'a NodeProto, name: &str) -> Option<&'a AttributeProto> {
    node.attribute.iter().find(|attribute| attribute.name.as_deref() == Some(name))
}

/// The content of a small constant.
fn numbers(array: &Known) -> Option<Vec<f64>> {
    let content = array.content.as_ref()?;
    Some(match content.data_type? {
        DataType::FLOAT => content.float_data.iter().map(|n| f64::from(*n)).collect(),
        _ => content.int32_data.iter().map(|n| f64::from(*n)).collect(),
    })
}

/// A constant of the library.
fn content(name: &str, value: Value) -> Result<Known, String> {
    let mut content = TensorProto { name: Some(name.to_owned()), ..TensorProto::default() };
    let (dtype, shape) = match &value {
        Value::FloatTensor(tensor) => {
            content.float_data = tensor.iter().copied().collect();
            (DataType::FLOAT, tensor.shape().to_vec())
        }
        Value::Int32Tensor(tensor) => {
            content.int32_data = tensor.iter().copied().collect();
            (DataType::INT32, tensor.shape().to_vec())
        }
        Value::Int8Tensor(tensor) => {
            content.int32_data = tensor.iter().map(|n| i32::from(*n)).collect();
            (DataType::INT8, tensor.shape().to_vec())
        }
        Value::UInt8Tensor(tensor) => {
            content.int32_data = tensor.iter().map(|n| i32::from(*n)).collect();
            (DataType::UINT8, tensor.shape().to_vec())
        }
        _ => return Err("sequences are not supported".to_owned()),
    };
    content.data_type = Some(dtype);
    content.dims = shape.iter().map(|n| *n as i64).collect();
    let is_small = content.float_data.len().max(content.int32_data.len()) <= SMALL;
    Ok(Known { dtype, shape, content: is_small.then_some(content) })
}

/// The type in which the library computes with a type of ONNX.
pub(super) fn computed(dtype: DataType) -> Option<DataType> {
    Some(match dtype {
        DataType::FLOAT | DataType::DOUBLE | DataType::FLOAT16 => DataType::FLOAT,
        DataType::INT32 | DataType::INT64 | DataType::BOOL => DataType::INT32,
        DataType::INT8 => DataType::INT8,
        DataType::UINT8 => DataType::UINT8,
        _ => return None,
    })
}

/// The type of ONNX for a type of the library.
fn of_library(dtype: ValueType) -> Option<DataType> {
    let ValueType::Tensor(dtype) = dtype else { return None };
    Some(match dtype {
        rten::DataType::Float => DataType::FLOAT,
        rten::DataType::Int32 => DataType::INT32,
        rten::DataType::Int8 => DataType::INT8,
        rten::DataType::UInt8 => DataType::UINT8,
        _ => return None,
    })
}

/// Type and size of an input of a network, if both are fixed.
fn described(input: &ValueInfoProto) -> Option<Known> {
    let tensor = input.r#type.as_ref()?.tensor_type.as_ref()?;
    let sizes = tensor.shape.as_ref()?.dim.iter().map(|axis| i32::try_from(axis.dim_value?).ok()?.try_into().ok());
    Some(Known { dtype: computed(tensor.elem_type?)?, shape: sizes.collect::<Option<_>>()?, content: None })
}

/// An input of a network.
fn description(name: &str, dtype: DataType, shape: &[usize]) -> ValueInfoProto {
    let axis = |size: &usize| rten_onnx::onnx::Dimension { dim_value: Some(*size as i64), dim_param: None };
    let shape = TensorShapeProto { dim: shape.iter().map(axis).collect() };
    let tensor = TypeProtoTensor { elem_type: Some(dtype), shape: Some(shape) };
    let described = TypeProto { tensor_type: Some(tensor), sequence: None };
    ValueInfoProto { name: Some(name.to_owned()), r#type: Some(described) }
}

/// An output of a network, of any type and size.
fn named(name: &str) -> ValueInfoProto {
    ValueInfoProto { name: Some(name.to_owned()), r#type: None }
}
