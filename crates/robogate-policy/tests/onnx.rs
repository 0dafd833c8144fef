//! Networks in ONNX files, compared with ONNX Runtime (networks/networks.py).

mod support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{Action, Command, FaultKind, Policy};
use robogate_policy::{ExternalPolicy, PolicyError, Profile};
use robogate_testing::fuzz::{self, Draw};
use rten_onnx::onnx::{AttributeProto, DataType, Dimension, GraphProto, ModelProto, NodeProto, OperatorSetIdProto};
use rten_onnx::onnx::{
    StringStringEntryProto, TensorProto, TensorShapeProto, TypeProto, TypeProtoTensor, ValueInfoProto,
};
use support::{begin, observation};

const SMALL: &str = include_str!("networks/small.toml");

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/networks").join(name)
}

fn load(path: &Path, profile: &str) -> Result<ExternalPolicy, PolicyError> {
    let profile = Profile::from_toml(profile).expect("a good profile");
    ExternalPolicy::connect(&path.display().to_string(), Arc::new(profile))
}

/// The error of loading a network or of its first inference.
fn error_of(path: &Path, profile: &str) -> String {
    let error = load(path, profile).err().or_else(|| {
        let mut policy = load(path, profile).ok()?;
        policy.begin("pick up the box").ok()?;
        policy.infer(&observation(96)).err()
    });
    error.expect("it must be refused").to_string()
}

fn expected(name: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(file("expected.json")).expect("it lies there");
    let mut all: serde_json::Value = serde_json::from_str(&text).expect("it is JSON");
    serde_json::from_value(all[name].take()).expect("rows of numbers")
}

fn agrees_with_onnx_runtime(path: &Path, profile: &str, name: &str) {
    let mut policy = load(path, profile).expect("it loads");
    policy.begin("pick up the box").expect("nothing to begin");
    let chunk = policy.infer(&observation(96)).expect("it answers");
    let expected = expected(name);
    assert_eq!(chunk.rows().len(), expected.len());
    for (ours, theirs) in chunk.rows().iter().zip(&expected) {
        assert_eq!(ours.len(), theirs.len());
        for (ours, theirs) in ours.iter().zip(theirs) {
            assert!((ours - theirs).abs() < 1e-5 * theirs.abs().max(1.0), "{ours} {theirs}");
        }
    }
}

#[test]
fn a_small_network_agrees_with_onnx_runtime() {
    agrees_with_onnx_runtime(&file("small.onnx"), SMALL, "small");
}

#[test]
fn shipped_networks_agree_with_onnx_runtime() {
    let learned = Profile::built_in("learned").expect("it is there");
    let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/policies");
    for name in ["learned", "learned-wide"] {
        agrees_with_onnx_runtime(&policies.join(format!("{name}.onnx")), learned, name);
    }
}

#[test]
fn chunks_become_joint_positions() {
    let mut policy = load(&file("small.onnx"), SMALL).expect("it loads");
    begin(&mut policy, "pick up the box").expect("nothing to begin");
    let rows = expected("small");
    for tick in 0..4 {
        assert_eq!(policy.wants_images(), tick % 2 == 0);
        let action = policy.act(&observation(96)).expect("it answers");
        let Command::JointPosition(joints) = action.command else { panic!("{:?}", action.command) };
        let row = &rows[tick % 2];
        assert!(joints.iter().zip(row).all(|(q, expected)| (q - expected).abs() < 1e-5), "{joints:?}");
        assert_eq!(action.gripper == Some(Action::OPEN), row[7] > 0.0);
    }
}

#[test]
fn the_file_is_identified_by_its_hash() {
    let policy = load(&file("small.onnx"), SMALL).expect("it loads");
    let declared = policy.declared().to_string();
    assert!(declared.contains("\"sha256\":\"") && declared.contains("\"front\""), "{declared}");
}

#[test]
fn mismatches_with_the_profile_are_errors() {
    let small = file("small.onnx");
    for (from, to, part) in [
        (
            "key = \"front\"",
            "key = \"above\"",
            "the profile sends `above`, but the inputs of the network are front, state",
        ),
        (
            "width = 8\nheight = 8",
            "width = 16\nheight = 16",
            "`front` with shape [16, 16, 3], but the network takes [1, 8, 8, 3]",
        ),
        (", \"gripper_opening\"]", "]", "`state` with shape [7], but the network takes [1, 8]"),
        (
            "size = 8\narm = \"joint_positions\"",
            "size = 7\narm = \"tool_delta\"\nrotation = \"axis_angle\"",
            "8 numbers",
        ),
        ("length = 2\nexecute = 2", "length = 5\nexecute = 2", "5"),
    ] {
        let profile = SMALL.replace(from, to);
        assert_ne!(profile, SMALL, "{from}");
        let why = error_of(&small, &profile);
        assert!(why.contains(part), "expected {part:?} in {why:?}");
    }
}

#[test]
fn states_have_the_type_of_the_input() {
    let parts = "parts = [\"joint_positions\", \"gripper_opening\"]";
    let zeros = format!("parts = [{}]", ["\"zero\""; 8].join(", "));
    let integers = SMALL.replace(parts, &zeros);
    assert_ne!(integers, SMALL);
    for dtype in [DataType::FLOAT16, DataType::DOUBLE, DataType::INT64, DataType::INT32] {
        let cast = with_integer(node("Cast", &["state"], "c"), "to", 1);
        let nodes = vec![cast, with_integer(node("Concat", &["c", "c"], "y"), "axis", 0)];
        let scratch = Scratch::new(&format!("typed-{dtype}"), &network_with(dtype, Vec::new(), nodes));
        let mut policy = load(&scratch.0, &integers).unwrap();
        policy.begin("pick up the box").unwrap();
        assert_eq!(policy.infer(&observation(96)).unwrap().rows(), vec![vec![0.0; 8]; 2]);
        if matches!(dtype, DataType::INT64 | DataType::INT32) {
            let why = error_of(&scratch.0, SMALL);
            assert!(why.contains("Expected integers of at most 32 bits"), "{why}");
        } else {
            policy = load(&scratch.0, SMALL).unwrap();
            policy.begin("pick up the box").unwrap();
            assert_ne!(policy.infer(&observation(96)).unwrap().rows(), vec![vec![0.0; 8]; 2]);
        }
    }
}

/// What a state is made of says that it is not of integers, before anything is asked.
#[test]
fn real_numbers_are_refused_at_loading() {
    let nodes = || vec![with_integer(node("Cast", &["state"], "y"), "to", 1)];
    let scratch = Scratch::new("real", &network_with(DataType::INT64, Vec::new(), nodes()));
    let why = load(&scratch.0, SMALL).unwrap_err();
    assert!(why.is_usage_error() && why.to_string().contains("the input `state` has the type I64, but"), "{why}");
    scratch.write(&network_with(DataType::BOOL, Vec::new(), nodes()));
    let why = load(&scratch.0, SMALL).unwrap_err().to_string();
    assert!(why.contains("has the type Bool, but the profile sends a vector"), "{why}");
}

#[test]
fn products_with_vectors_agree_with_onnx_runtime() {
    let camera = SMALL.find("[[camera]]").unwrap()..SMALL.find("[[state]]").unwrap();
    let blind = SMALL.replace(&SMALL[camera], "");
    agrees_with_onnx_runtime(&file("vector.onnx"), &blind, "vector");
}

#[test]
fn products_that_cannot_be_computed_are_errors() {
    let cases = [
        (vec![8, 8], vec![7], "have the sizes [8, 8] and [7], which cannot be multiplied"),
        (vec![3, 8, 8], vec![8], "the product of 3 matrices and one vector is not supported"),
    ];
    for (a, b, part) in cases {
        let ones = |sizes: &[i64]| vec![1.0; sizes.iter().product::<i64>() as usize];
        let constants = vec![tensor("a", &a, &ones(&a)), tensor("b", &b, &ones(&b))];
        let scratch = Scratch::new("product", &network(constants, vec![node("MatMul", &["a", "b"], "y")]));
        let why = error_of(&scratch.0, SMALL);
        assert!(why.contains(part), "{why}");
    }
}

#[test]
fn an_open_batch_size_becomes_one() {
    agrees_with_onnx_runtime(&file("batch.onnx"), SMALL, "small");
}

#[test]
fn other_open_sizes_are_errors() {
    let why = error_of(&file("open.onnx"), SMALL);
    assert!(why.contains("the input `state` has no fixed size: axis 1 is open"), "{why}");
}

#[test]
fn the_wrong_kind_of_address_is_explained() {
    let why = error_of(Path::new("ws://127.0.0.1:1"), SMALL);
    assert!(why.contains("has the dialect onnx and takes a file. Expected FILE.onnx"), "{why}");
    let pi0 = Profile::built_in("pi0-libero").expect("it is there");
    let why = error_of(&file("small.onnx"), pi0);
    assert!(
        why.contains(
            "profile pi0-libero has the dialect openpi and takes the address of a server. Expected ws://HOST:PORT. Hint"
        ),
        "{why}"
    );
    let why = error_of(Path::new("nowhere.onnx"), SMALL);
    assert!(why.contains("nowhere.onnx") && why.contains("cannot be read"), "{why}");
    for (path, part) in [("small.toml", "it is a text file"), ("../networks", "it is a folder")] {
        let why = error_of(&file(path), SMALL);
        assert!(why.starts_with("invalid policy file: ") && why.contains(part), "{why}");
    }
}

#[test]
fn common_operators_agree_with_onnx_runtime() {
    agrees_with_onnx_runtime(&file("operators.onnx"), SMALL, "operators");
}

/// A file for one test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path = std::env::temp_dir().join(format!("robogate-{}-{name}.onnx", std::process::id()));
        let scratch = Self(path);
        scratch.write(bytes);
        scratch
    }

    fn write(&self, bytes: &[u8]) {
        std::fs::write(&self.0, bytes).expect("room for a file");
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        drop(std::fs::remove_file(&self.0));
    }
}

#[test]
fn every_load_and_thread_gives_the_same_bits() {
    let learned = Profile::built_in("learned").expect("it is there");
    let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/policies");
    for (path, profile) in [(file("operators.onnx"), SMALL), (policies.join("learned.onnx"), learned)] {
        let actions = |times: usize| {
            let mut policy = load(&path, profile).expect("it loads");
            policy.begin("pick up the box").expect("nothing to begin");
            let bits = |policy: &mut ExternalPolicy| -> Vec<u64> {
                let chunk = policy.infer(&observation(96)).expect("it answers");
                chunk.rows().iter().flatten().map(|n| n.to_bits()).collect()
            };
            let first = bits(&mut policy);
            assert!((1..times).all(|_| bits(&mut policy) == first));
            first
        };
        let first = actions(5);
        for _ in 0..20 {
            assert_eq!(actions(1), first);
        }
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(|| actions(3))).collect();
            for thread in threads {
                assert_eq!(thread.join().expect("no panic"), first);
            }
        });
    }
}

/// No error of a network in this process is one of a server that is not available.
#[test]
fn errors_of_networks_are_not_outages() {
    let gathered =
        network(vec![integers("n", &[9])], vec![with_integer(node("Gather", &["state", "n"], "y"), "axis", 1)]);
    let scratch = Scratch::new("gather", &gathered);
    let mut policy = load(&scratch.0, SMALL).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let fault = policy.act(&observation(96)).unwrap_err();
    assert_eq!(fault.kind, FaultKind::BadAction, "{fault}");
    let taller = SMALL.replace("width = 8\nheight = 8", "width = 16\nheight = 16");
    let mut policy = load(&file("small.onnx"), &taller).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let fault = policy.act(&observation(96)).unwrap_err();
    assert_eq!(fault.kind, FaultKind::Setup, "{fault}");
}

/// Loads and runs files, and returns how many are refused. None may panic.
fn refused(name: &str, files: impl Iterator<Item = Vec<u8>>) -> usize {
    let path = Scratch::new(name, &[]);
    files.filter_map(|bytes| error(&path, &bytes)).inspect(|why| assert!(!why.contains("panicked"), "{why}")).count()
}

/// Loads and runs a file, and returns the error.
fn error(path: &Scratch, bytes: &[u8]) -> Option<String> {
    path.write(bytes);
    let loaded = load(&path.0, SMALL);
    let result = loaded.and_then(|mut policy| {
        policy.begin("pick up the box")?;
        policy.infer(&observation(96))
    });
    let why = result.err()?.to_string();
    assert!(!why.contains("its thread has ended"), "{why}");
    Some(why)
}

fn good() -> Vec<u8> {
    std::fs::read(file("small.onnx")).expect("it lies there")
}

#[test]
fn truncated_files_never_panic() {
    let good = good();
    let refused = refused("truncated", (0..good.len()).map(|length| good[..length].to_vec()));
    assert!(refused > good.len() * 9 / 10, "{refused} of {}", good.len());
}

#[test]
fn files_with_flipped_bits_never_panic() {
    let good = good();
    let flipped = (0..2 * good.len()).map(|i| {
        let mut bad = good.clone();
        // Each byte once entirely, and once in one bit.
        bad[i / 2] ^= if i % 2 == 0 { 0xff } else { 1 << (i / 2 % 8) };
        bad
    });
    let refused = refused("flipped", flipped);
    assert!(refused > good.len() / 3, "{refused} of {}", good.len());
}

#[test]
fn random_files_are_refused() {
    let good = good();
    let mut state = 1_u64;
    let files = (1..300).map(|length| {
        let random = std::iter::repeat_with(|| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 56) as u8
        });
        // Half of them after a valid beginning.
        let valid = if length % 2 == 0 { &good[..length] } else { &[] };
        [valid, &random.take(length).collect::<Vec<u8>>()].concat()
    });
    assert_eq!(refused("random", files), 299);
}

fn tensor(name: &str, dims: &[i64], numbers: &[f32]) -> TensorProto {
    let (name, dims) = (Some(name.to_owned()), dims.to_vec());
    TensorProto { name, dims, data_type: Some(DataType::FLOAT), float_data: numbers.to_vec(), ..Default::default() }
}

fn integers(name: &str, numbers: &[i64]) -> TensorProto {
    let (name, dims) = (Some(name.to_owned()), vec![numbers.len() as i64]);
    TensorProto { name, dims, data_type: Some(DataType::INT64), int64_data: numbers.to_vec(), ..Default::default() }
}

fn node(op: &str, inputs: &[&str], output: &str) -> NodeProto {
    NodeProto {
        name: Some(format!("the_{output}")),
        op_type: Some(op.to_owned()),
        input: inputs.iter().map(|&name| name.to_owned()).collect(),
        output: vec![output.to_owned()],
        ..Default::default()
    }
}

fn with_integer(mut node: NodeProto, name: &str, i: i64) -> NodeProto {
    node.attribute.push(AttributeProto { name: Some(name.to_owned()), i: Some(i), ..Default::default() });
    node
}

fn with_integers(mut node: NodeProto, name: &str, ints: &[i64]) -> NodeProto {
    let attribute = AttributeProto { name: Some(name.to_owned()), ints: ints.to_vec(), ..Default::default() };
    node.attribute.push(attribute);
    node
}

/// A file with the inputs of [`SMALL`], of which the node `y` computes the output.
fn network(constants: Vec<TensorProto>, nodes: Vec<NodeProto>) -> Vec<u8> {
    network_with(DataType::FLOAT, constants, nodes)
}

/// A file like those of [`network`], with this type of the input `state`.
fn network_with(state: DataType, constants: Vec<TensorProto>, nodes: Vec<NodeProto>) -> Vec<u8> {
    let input = |name: &str, elem_type, sizes: &[i64]| {
        let axis = |size: &i64| Dimension { dim_value: Some(*size), dim_param: None };
        let shape = Some(TensorShapeProto { dim: sizes.iter().map(axis).collect() });
        let tensor_type = Some(TypeProtoTensor { elem_type: Some(elem_type), shape });
        ValueInfoProto { name: Some(name.to_owned()), r#type: Some(TypeProto { tensor_type, sequence: None }) }
    };
    let graph = GraphProto {
        node: nodes,
        initializer: constants,
        input: vec![input("front", DataType::UINT8, &[1, 8, 8, 3]), input("state", state, &[1, 8])],
        output: vec![ValueInfoProto { name: Some("y".to_owned()), r#type: None }],
        value_info: Vec::new(),
    };
    let opset_import = vec![OperatorSetIdProto { domain: None, version: Some(17) }];
    let model = ModelProto { ir_version: Some(8), graph: Some(graph), opset_import, ..Default::default() };
    model.write_buf().expect("room for it")
}

#[test]
fn huge_arrays_are_errors() {
    const HUGE: i64 = 1 << 40;
    let most = i64::from(i32::MAX);
    let single = |constants, op: &str, inputs: &[&str]| network(constants, vec![node(op, inputs, "y")]);
    let too_large = "would need an array of";
    let cases = [
        (single(vec![integers("n", &[HUGE])], "ConstantOfShape", &["n"]), too_large),
        (single(vec![integers("n", &[1 << 20, 1 << 20])], "ConstantOfShape", &["n"]), too_large),
        (single(vec![integers("n", &[1 << 20, 1 << 20, 1])], "Expand", &["state", "n"]), too_large),
        // 8 * 2^29 is 0 in 32 bits.
        (single(vec![integers("n", &[1, 1 << 29])], "Tile", &["state", "n"]), too_large),
        (single(vec![integers("n", &[0, most, 0, most])], "Pad", &["state", "n"]), too_large),
        (
            single(
                vec![tensor("n", &[], &[0.0]), tensor("m", &[], &[1e15]), tensor("d", &[], &[1.0])],
                "Range",
                &["n", "m", "d"],
            ),
            too_large,
        ),
        (single(vec![tensor("w", &[1 << 20, 1 << 20], &[1.0])], "Mul", &["state", "w"]), too_large),
        (single(vec![tensor("w", &[HUGE, 0], &[])], "Mul", &["state", "w"]), "Expected sizes below 2^31"),
        (single(vec![tensor("w", &[-1], &[1.0])], "Mul", &["state", "w"]), "Expected sizes below 2^31"),
        // The outer product of two arrays that are each allowed.
        (
            network(
                vec![integers("n", &[1 << 20, 1]), integers("m", &[1, 1 << 20])],
                vec![
                    node("ConstantOfShape", &["n"], "a"),
                    node("ConstantOfShape", &["m"], "b"),
                    node("MatMul", &["a", "b"], "y"),
                ],
            ),
            too_large,
        ),
        // 16 times 2^28 elements are 0 in 32 bits.
        (
            network(
                vec![integers("n", &[1 << 28])],
                vec![
                    node("ConstantOfShape", &["n"], "a"),
                    NodeProto {
                        attribute: vec![AttributeProto {
                            name: Some("axis".to_owned()),
                            i: Some(0),
                            ..Default::default()
                        }],
                        ..node("Concat", &["a"; 16], "y")
                    },
                ],
            ),
            too_large,
        ),
        (
            network(
                vec![tensor("w", &[1, 1, 1, 1], &[1.0]), integers("n", &[1, 1, 2, 4])],
                vec![
                    node("Reshape", &["state", "n"], "x"),
                    with_integers(node("Conv", &["x", "w"], "y"), "pads", &[most; 4]),
                ],
            ),
            too_large,
        ),
        // Many arrays, each of which is allowed.
        (
            network(
                vec![integers("n", &[1 << 27])],
                (0..9)
                    .map(|i| node("ConstantOfShape", &["n"], &format!("v{i}")))
                    .chain([NodeProto {
                        op_type: Some("Sum".to_owned()),
                        input: (0..9).map(|i| format!("v{i}")).collect(),
                        output: vec!["y".to_owned()],
                        ..Default::default()
                    }])
                    .collect(),
            ),
            "all arrays of the network together would need more than 4096 MiB",
        ),
        // The size depends on what the network sees.
        (
            network(
                vec![],
                vec![
                    NodeProto {
                        attribute: vec![AttributeProto {
                            name: Some("to".to_owned()),
                            i: Some(7),
                            ..Default::default()
                        }],
                        ..node("Cast", &["state"], "n")
                    },
                    node("Tile", &["state", "n"], "y"),
                ],
            ),
            "is not known before it runs",
        ),
        (single(vec![], "NonZero", &["state"]), "is not known before it runs"),
        // 2^66 elements are 0 in 64 bits.
        (
            single(vec![integers("n", &[1 << 22, 1 << 22, 1 << 22]), tensor("w", &[], &[1.0])], "Expand", &["w", "n"]),
            too_large,
        ),
        // Which of two sizes would count?
        (
            network(
                vec![integers("n", &[HUGE]), integers("m", &[1])],
                vec![node("Identity", &["m"], "n"), node("ConstantOfShape", &["n"], "y")],
            ),
            "`n` is defined twice",
        ),
    ];
    let path = Scratch::new("huge", &[]);
    for (i, (bytes, part)) in cases.iter().enumerate() {
        path.write(bytes);
        let why = load(&path.0, SMALL).err().unwrap_or_else(|| panic!("case {i}")).to_string();
        let named = format!("invalid policy file: {}: cannot be loaded as an ONNX model: ", path.0.display());
        assert!(why.starts_with(&named) && why.contains(part), "case {i}: {why}");
    }
}

#[test]
fn unsupported_networks_are_explained() {
    let loop_node = NodeProto {
        attribute: vec![AttributeProto {
            name: Some("body".to_owned()),
            g: Some(GraphProto::default()),
            ..Default::default()
        }],
        ..node("Loop", &["state"], "y")
    };
    let outside = TensorProto {
        external_data: vec![StringStringEntryProto {
            key: Some("location".to_owned()),
            value: Some("w.bin".to_owned()),
        }],
        ..tensor("w", &[1], &[])
    };
    let path = Scratch::new("unsupported", &[]);
    for (bytes, part) in [
        (
            network(vec![], vec![node("Mystery", &["state"], "y")]),
            "node `the_y` (Mystery): this operator is not supported. Hint",
        ),
        (
            network(vec![], vec![node("RandomNormalLike", &["state"], "y")]),
            "node `the_y` (RandomNormalLike): this operator is not",
        ),
        (network(vec![], vec![loop_node]), "node `the_y` (Loop): control flow is not supported. Hint"),
        (network(vec![outside], vec![node("Mul", &["state", "w"], "y")]), "constant `w`: it is in another file"),
        (
            network(vec![], vec![node("GRU", &["state", "state", "state", "", "state"], "y")]),
            "node `the_y` (GRU): sequence_lens is not supported",
        ),
        (
            network(vec![], vec![node("GRU", &["state", "state", "state"], "y")]),
            "node `the_y` (GRU): only linear_before_reset = 1 is supported",
        ),
        (
            network(vec![], vec![node("Neg", &["x"], "y")]),
            "node `the_y` (Neg): it reads `x`, which no earlier node computes",
        ),
    ] {
        path.write(&bytes);
        let why = load(&path.0, SMALL).err().unwrap_or_else(|| panic!("{part}")).to_string();
        assert!(why.contains(&path.0.display().to_string()) && why.contains(part), "expected {part:?} in {why:?}");
    }
}

/// A chain of products of 2048 x 2048 numbers, each of which takes a second or more on one core.
fn slow(start: &str) -> Vec<u8> {
    let mut nodes = vec![node("ReduceMean", &[start], "x"), node("Expand", &["x", "n"], "v0")];
    nodes.extend((0..100).map(|i| node("MatMul", &[&format!("v{i}"), &format!("v{i}")], &format!("v{}", i + 1))));
    nodes.push(node("Identity", &["v100"], "y"));
    network(vec![integers("n", &[2048, 2048]), tensor("w", &[2, 2], &[1.0; 4])], nodes)
}

/// The profile of a small network, with limits on loading and on the first inference, in seconds.
fn timeouts(load: f64, answer: f64) -> String {
    format!("{SMALL}\n[server]\nconnect_s = {load:?}\nfirst_answer_s = {answer:?}\nattempts = 1\n")
}

#[test]
fn deadlines_end_slow_networks() {
    // Products of constants are computed while the file is loaded.
    for (start, profile, operation) in
        [("state", timeouts(600.0, 0.5), "running"), ("w", timeouts(0.5, 600.0), "loading")]
    {
        let path = Scratch::new(operation, &slow(start));
        let begun = std::time::Instant::now();
        let why = error_of(&path.0, &profile);
        let expected = format!("timeout: {operation} {} took longer than 0.5 s", path.0.display());
        assert_eq!(why, expected);
        // The whole chain takes minutes.
        assert!(begun.elapsed().as_secs_f64() < 60.0, "{:?}", begun.elapsed());
    }
}

#[test]
fn deep_networks_load() {
    let mut nodes: Vec<NodeProto> =
        (0..20_000).map(|i| node("Neg", &[&format!("v{i}")], &format!("v{}", i + 1))).collect();
    nodes.insert(0, node("Identity", &["state"], "v0"));
    nodes.push(node("Identity", &["v20000"], "y"));
    let path = Scratch::new("deep", &network(vec![], nodes));
    // Longer than the default limit, for a busy machine.
    load(&path.0, &timeouts(600.0, 60.0)).expect("it loads");
}

/// A network whose nodes read what earlier ones compute, with plausible and extreme sizes.
fn generated(draw: &mut Draw) -> Vec<u8> {
    const UNARY: [&str; 12] = [
        "Neg",
        "Relu",
        "Softmax",
        "Flatten",
        "Shape",
        "Transpose",
        "Identity",
        "ReduceMean",
        "Cast",
        "Squeeze",
        "Size",
        "Exp",
    ];
    const BINARY: [&str; 14] = [
        "Add", "Mul", "MatMul", "Gemm", "Reshape", "Expand", "Tile", "Concat", "Gather", "Pad", "Slice", "Conv",
        "Resize", "Range",
    ];
    let size = |draw: &mut Draw| -> i64 {
        match draw.below(14) {
            0 => [-1, 0, i64::MAX, i64::MIN, 1 << 31, 1 << 20][draw.below(6)],
            1 => 1 << draw.below(24),
            n => (n % 9) as i64,
        }
    };
    let mut names = vec!["state".to_owned(), "front".to_owned()];
    let mut constants = Vec::new();
    for i in 0..draw.below(4) {
        let numbers: Vec<i64> = (0..draw.below(5)).map(|_| size(draw)).collect();
        let mut constant = integers(&format!("k{i}"), &numbers);
        match draw.below(16) {
            0 => constant.dims = vec![size(draw), size(draw)],
            1..=3 => constant = tensor(&format!("k{i}"), &[numbers.len() as i64], &vec![0.5; numbers.len()]),
            4..=8 => constant = tensor(&format!("k{i}"), &[8, 2], &[0.5; 16]),
            _ => {}
        }
        names.push(constant.name.clone().expect("it has one"));
        constants.push(constant);
    }
    let count = 1 + draw.below(6);
    let nodes = (0..count).map(|i| {
        let input = |draw: &mut Draw| {
            if draw.below(60) == 0 { "unknown".to_owned() } else { names[draw.below(names.len())].clone() }
        };
        let (op, inputs) = if draw.below(2) == 0 {
            (UNARY[draw.below(UNARY.len())], vec![input(draw)])
        } else {
            (BINARY[draw.below(BINARY.len())], vec![input(draw), input(draw)])
        };
        let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
        let output = if i + 1 == count { "y".to_owned() } else { format!("v{i}") };
        let mut node = node(op, &inputs, &output);
        let attributes = ["axis", "axes", "perm", "pads", "to", "kernel_shape", "keepdims", "strides", "group"];
        // Most attributes do not belong to the operator.
        for _ in 0..draw.below(8).saturating_sub(5) {
            let name = attributes[draw.below(attributes.len())];
            let ints: Vec<i64> = (0..draw.below(5)).map(|_| size(draw)).collect();
            node = with_integers(node, name, &ints);
            if let Some(attribute) = node.attribute.last_mut()
                && draw.below(2) == 0
            {
                attribute.i = Some(size(draw));
                attribute.ints.clear();
            }
        }
        names.push(output);
        node
    });
    let nodes = nodes.collect();
    network(constants, nodes)
}

/// Networks built part by part, so that they get through the first checks. The corpus has those that once found a defect, and one for each limit.
#[test]
fn fuzzed_networks_are_loaded_or_refused() {
    let kept = fuzz::corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus/onnx"));
    assert!(kept.len() >= 4);
    assert_eq!(refused("kept", kept.iter().cloned()), kept.len());
    // A panic of the library is an error about the file.
    let path = Scratch::new("generated", &[]);
    let (mut panicked, mut wrong_shape) = (0, 0);
    let counts = fuzz::run("onnx", 500, generated, |bytes| {
        let why = error(&path, bytes);
        let says = |words: &str| u64::from(why.as_ref().is_some_and(|why| why.contains(words)));
        panicked += says("the ONNX library panicked");
        wrong_shape += says("wrong shape");
        why.is_none()
    });
    let answers = counts.read + wrong_shape;
    println!("{counts:?}, {panicked} refused by a panic of the library, {answers} answered");
    assert!(counts.refused > 0 && answers > (counts.read + counts.refused) / 50, "{counts:?} {answers}");
}
