//! Measures what a network gains from batches on one core, and whether its answers in a batch are those alone, bit for bit.
//!
//! `cargo bench -p robogate-policy --features onnx --bench networks`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints, and fails by panicking")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use rten::{Model, ModelOptions, RunOptions, ThreadPool, Value};
use rten_onnx::onnx::{
    AttributeProto, DataType, Dimension, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto,
    TensorShapeProto, TypeProto, TypeProtoTensor, ValueInfoProto,
};
use rten_tensor::Tensor;
use rten_tensor::prelude::*;

const INPUTS: usize = 39;
const REQUESTS: usize = 64;
const BATCHES: [usize; 4] = [1, 2, 8, 32];
const TIME: Duration = Duration::from_millis(200);

/// Reproducible numbers in (-0.5, 0.5).
fn numbers(seed: u64, count: usize) -> Vec<f32> {
    let mut stream = robogate_core::Seed::campaign(seed).stream("networks");
    (0..count).map(|_| stream.between(-0.5, 0.5) as f32).collect()
}

/// Fully connected layers of these widths as PyTorch exports them, with an open batch size.
fn layers(widths: &[usize]) -> Vec<u8> {
    let (mut nodes, mut constants, mut last) = (Vec::new(), Vec::new(), "obs".to_owned());
    for (at, pair) in widths.windows(2).enumerate() {
        let [from, to] = [pair[0], pair[1]];
        let scale = 2.0 / (from as f32).sqrt();
        let weights = numbers(at as u64, from * to).iter().map(|n| n * scale).collect();
        for (name, dims, data) in [
            (format!("w{at}"), vec![to as i64, from as i64], weights),
            (format!("b{at}"), vec![to as i64], numbers(99, to)),
        ] {
            let (name, data_type) = (Some(name), Some(DataType::FLOAT));
            constants.push(TensorProto { name, dims, data_type, float_data: data, ..Default::default() });
        }
        let node = |op: &str, input: Vec<String>, output: String| NodeProto {
            op_type: Some(op.to_owned()),
            input,
            output: vec![output],
            ..Default::default()
        };
        let mut product = node("Gemm", vec![last, format!("w{at}"), format!("b{at}")], format!("g{at}"));
        product.attribute.push(AttributeProto { name: Some("transB".to_owned()), i: Some(1), ..Default::default() });
        nodes.push(product);
        nodes.push(node("Tanh", vec![format!("g{at}")], format!("t{at}")));
        last = format!("t{at}");
    }
    let axis = |size: Option<i64>| Dimension { dim_value: size, dim_param: size.is_none().then(|| "batch".to_owned()) };
    let shape = Some(TensorShapeProto { dim: vec![axis(None), axis(Some(INPUTS as i64))] });
    let tensor_type = Some(TypeProtoTensor { elem_type: Some(DataType::FLOAT), shape });
    let described = Some(TypeProto { tensor_type, sequence: None });
    let graph = GraphProto {
        node: nodes,
        initializer: constants,
        input: vec![ValueInfoProto { name: Some("obs".to_owned()), r#type: described }],
        output: vec![ValueInfoProto { name: Some(last), r#type: None }],
        value_info: Vec::new(),
    };
    let opset_import = vec![OperatorSetIdProto { domain: None, version: Some(17) }];
    ModelProto { ir_version: Some(8), graph: Some(graph), opset_import, ..Default::default() }.write_buf().unwrap()
}

struct Runs {
    model: Model,
    options: RunOptions,
    requests: Vec<f32>,
}

impl Runs {
    /// The answers to so many requests from this one on, together.
    fn answers(&self, from: usize, count: usize) -> Vec<Vec<u32>> {
        let data = self.requests[from * INPUTS..(from + count) * INPUTS].to_vec();
        let value = Value::from_shape(&[count, INPUTS], data).unwrap();
        let inputs = vec![(self.model.input_ids()[0], value.into())];
        let found = self.model.run(inputs, self.model.output_ids(), Some(self.options.clone())).unwrap();
        let found: Tensor<f32> = found.into_iter().next().unwrap().try_into().unwrap();
        let bits: Vec<u32> = found.iter().map(|number| number.to_bits()).collect();
        bits.chunks_exact(bits.len() / count).map(<[u32]>::to_vec).collect()
    }

    /// The time of one request in batches of this size, in seconds: the best of five.
    fn time(&self, count: usize) -> f64 {
        let once = || {
            let (start, mut done) = (Instant::now(), 0);
            while start.elapsed() < TIME {
                self.answers(0, count);
                done += count;
            }
            start.elapsed().as_secs_f64() / done as f64
        };
        (0..5).map(|_| once()).fold(f64::INFINITY, f64::min)
    }
}

fn main() {
    let pool = Arc::new(ThreadPool::with_num_threads(1));
    for widths in [[INPUTS, 64, 64, 4].as_slice(), &[INPUTS, 256, 256, 4], &[INPUTS, 1024, 1024, 1024, 4]] {
        let model = ModelOptions::with_all_ops().prepack_weights(true).load(layers(widths)).unwrap();
        let options = RunOptions::default().with_thread_pool(Some(pool.clone()));
        let runs = Runs { model, options, requests: numbers(7, REQUESTS * INPUTS) };
        let alone: Vec<Vec<u32>> = (0..REQUESTS).flat_map(|at| runs.answers(at, 1)).collect();
        let alone_s = runs.time(1);
        print!("{widths:?}: {:.1} us alone", 1e6 * alone_s);
        for count in BATCHES {
            let together = (0..REQUESTS).step_by(count).flat_map(|from| runs.answers(from, count));
            let equal = together.zip(&alone).filter(|(one, other)| one == *other).count();
            print!(", batch of {count}: {:.1} x, {equal} of {REQUESTS} equal", alone_s / runs.time(count));
        }
        println!();
    }
}
