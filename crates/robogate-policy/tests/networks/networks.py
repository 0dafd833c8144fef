"""Write the networks of this folder, and expected.json: the outputs of ONNX Runtime for them and for the policies that RoboGate ships.

    pip install --requirement scripts/learned/requirements.txt
    python crates/robogate-policy/tests/networks/networks.py

The observation is that of tests/support, with images of 96 x 96 pixels: bytes that count up, joints at zero, an opening of 80 mm. For gru.onnx, lstm.onnx and
history.onnx there are STEPS observations, of one action each: `step_state` and `step_image`.
"""

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper
from PIL import Image

HERE = Path(__file__).parent
SHIPPED = HERE.parents[3] / "assets/policies"
SIDE = 96
STEPS = 8
# Actions that are executed of each chunk, and the offsets of a history, as in the profiles of tests/onnx.rs.
EXECUTED = {"gru": 1, "lstm": 2, "history": 2}
HISTORY = (-2, -1, 0)


def small(path, batch, width):
    """One linear layer from the mean colours of an image and a state of eight numbers to two actions of eight numbers."""
    rng = np.random.default_rng(1)
    weights = {
        "scale": np.float32(1 / 255),
        "layer": rng.normal(0, 0.1, (11, 16)).astype(np.float32),
        "bias": rng.normal(0, 0.1, 16).astype(np.float32),
        "form": np.array([1, 2, 8], dtype=np.int64),
    }
    nodes = [
        helper.make_node("Cast", ["front"], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["floats", "scale"], ["picture"]),
        helper.make_node("ReduceMean", ["picture"], ["colours"], axes=[1, 2], keepdims=0),
        helper.make_node("Concat", ["colours", "state"], ["seen"], axis=1),
        helper.make_node("Gemm", ["seen", "layer", "bias"], ["flat"]),
        helper.make_node("Reshape", ["flat", "form"], ["actions"]),
    ]
    inputs = [
        helper.make_tensor_value_info("front", TensorProto.UINT8, [batch, 8, 8, 3]),
        helper.make_tensor_value_info("state", TensorProto.FLOAT, [batch, width]),
    ]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 2, 8])]
    initializers = [numpy_helper.from_array(np.asarray(value), name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "small", inputs, outputs, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())


def operators(path):
    """Convolutions, recurrent layers and attention as PyTorch exports them, with shapes that are computed."""
    rng = np.random.default_rng(2)
    weights, nodes = {}, []

    def weight(*shape):
        weights[f"w{len(weights)}"] = np.asarray(rng.normal(0, 0.3, shape)).astype(np.float32)
        return f"w{len(weights) - 1}"

    def integers(*values):
        weights[f"w{len(weights)}"] = np.array(values, dtype=np.int64)
        return f"w{len(weights) - 1}"

    def node(op, *inputs, outputs=1, **attributes):
        names = [f"v{len(nodes)}_{i}" for i in range(outputs)]
        nodes.append(helper.make_node(op, list(inputs), names, name=f"{op}_{len(nodes)}", **attributes))
        return names[0] if outputs == 1 else names

    pixels = node("Transpose", node("Cast", "front", to=TensorProto.FLOAT), perm=[0, 3, 1, 2])
    pixels = node("Mul", pixels, weight())
    layer = node("Conv", pixels, weight(8, 3, 3, 3), weight(8), kernel_shape=[3, 3], pads=[1, 1, 1, 1])
    ones = [np.ones(8, dtype=np.float32), np.zeros(8, dtype=np.float32)]
    weights.update(one=ones[0], zero=ones[1])
    layer = node("Relu", node("BatchNormalization", layer, "one", "zero", "zero", "one"))
    layer = node("MaxPool", layer, kernel_shape=[2, 2], strides=[2, 2])
    weights["scales"] = np.array([1, 1, 2, 2], dtype=np.float32)
    weights["none"] = np.array([], dtype=np.float32)
    layer = node("Resize", layer, "none", "scales", mode="linear", coordinate_transformation_mode="half_pixel")
    layer = node("AveragePool", layer, kernel_shape=[2, 2], strides=[1, 1], pads=[0, 0, 1, 1], ceil_mode=1)
    layer = node("Conv", layer, weight(8, 4, 3, 3), kernel_shape=[3, 3], strides=[2, 2], group=2)
    layer = node("Clip", node("Pad", layer, integers(0, 0, 1, 0, 0, 0, 0, 1)), "low", "high")
    weights.update(low=np.float32(-2), high=np.float32(2))
    # Tokens of eight numbers, in a shape that is computed from the input.
    batch = node("Gather", node("Shape", layer), integers(0), axis=0)
    tokens = node("Reshape", layer, node("Concat", batch, integers(8, -1), axis=0))
    tokens = node("Transpose", tokens, perm=[0, 2, 1])
    length = node("Gather", node("Shape", tokens), integers(1), axis=0)
    shape = node("Concat", batch, length, integers(8), axis=0)
    ones = node("ConstantOfShape", integers(3), value=helper.make_tensor("one", TensorProto.INT64, [1], [1]))
    shape = node("Where", node("Equal", shape, node("Mul", ones, integers(-1))), ones, shape)
    position = node("Expand", weight(1, 1, 8), shape)
    tokens = node("Add", tokens, position)
    normal = node("LayerNormalization", tokens, weight(8), weight(8), axis=-1)
    query, key, value = (node("MatMul", normal, weight(8, 8)) for _ in range(3))
    heads = integers(0, -1, 2, 4)
    query, value = (node("Transpose", node("Reshape", x, heads), perm=[0, 2, 1, 3]) for x in (query, value))
    key = node("Transpose", node("Reshape", key, heads), perm=[0, 2, 3, 1])
    scores = node("Softmax", node("Div", node("MatMul", query, key), weight()), axis=-1)
    mixed = node("Transpose", node("MatMul", scores, value), perm=[0, 2, 1, 3])
    tokens = node("Add", tokens, node("Reshape", mixed, integers(0, 0, 8)))
    # GELU as exported before opset 20.
    half = node("Div", tokens, "root")
    weights.update(root=np.float32(2**0.5), unit=np.float32(1), half=np.float32(0.5))
    tokens = node("Mul", node("Mul", tokens, node("Add", node("Erf", half), "unit")), "half")
    sequence = node("Transpose", tokens, perm=[1, 0, 2])
    _, last = node("GRU", sequence, weight(1, 24, 8), weight(1, 24, 8), weight(1, 48), outputs=2, hidden_size=8, linear_before_reset=1)
    output, _, cell = node("LSTM", sequence, weight(1, 32, 8), weight(1, 32, 8), weight(1, 64), outputs=3, hidden_size=8)
    output = node("Slice", output, integers(-1), integers(2**63 - 1), integers(0))
    output = node("Squeeze", output, integers(1))
    parts = [node("Squeeze", x, integers(0)) for x in (last, cell, output)]
    joined = node("Concat", *parts[:2], node("Reshape", parts[2], integers(1, 8)), "state", axis=1)
    left, right = node("Split", joined, integers(16, 16), outputs=2, axis=1)
    first, second = node("Split", node("Dropout", right), outputs=2, axis=1)
    joined = node("Concat", node("Tanh", left), node("Sigmoid", second), first, axis=1)
    flat = node("Gemm", joined, weight(16, 32), weight(16), transB=1, alpha=0.5)
    nodes.append(helper.make_node("Reshape", [flat, integers(1, 2, 8)], ["actions"]))
    inputs = [
        helper.make_tensor_value_info("front", TensorProto.UINT8, ["batch", 8, 8, 3]),
        helper.make_tensor_value_info("state", TensorProto.FLOAT, ["batch", 8]),
    ]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 2, 8])]
    initializers = [numpy_helper.from_array(np.asarray(value, dtype=value.dtype), name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "operators", inputs, outputs, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())


def save(path, nodes, weights, inputs, outputs):
    initializers = [numpy_helper.from_array(value, name) for name, value in weights.items()]
    described = [[helper.make_tensor_value_info(*value) for value in values] for values in (inputs, outputs)]
    graph = helper.make_graph(nodes, path.stem, *described, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())


def recurrent(path, cell, gates, memories):
    """One recurrent layer of 16 units as PyTorch exports it, with an open batch size, and a layer to two actions. The LSTM also counts the requests."""
    rng = np.random.default_rng(3)

    def weight(*shape):
        return rng.normal(0, 0.4, shape).astype(np.float32)

    weights = {
        "first": np.array([0], dtype=np.int64),
        "form": np.array([1, 2, 8], dtype=np.int64),
        "w": weight(1, gates * 16, 8), "r": weight(1, gates * 16, 16), "b": weight(1, 2 * gates * 16),
        "layer": weight(16, 16), "bias": weight(16),
    }
    # linear_before_reset is that of PyTorch.
    more = {"linear_before_reset": 1} if cell == "GRU" else {}
    remembered = [name for name, _ in memories[:2]]
    nodes = [
        helper.make_node("Unsqueeze", ["state", "first"], ["sequence"]),
        helper.make_node(cell, ["sequence", "w", "r", "b", "", *remembered], ["", *(name for _, name in memories[:2])], hidden_size=16, **more),
        helper.make_node("Squeeze", [memories[0][1], "first"], ["last"]),
        helper.make_node("Gemm", ["last", "layer", "bias"], ["flat"]),
        helper.make_node("Reshape", ["flat", "form"], ["joints"]),
    ]
    inputs = [("state", TensorProto.FLOAT, ["batch", 8])]
    inputs += [(name, TensorProto.FLOAT, [1, "batch", 16]) for name, _ in memories[:2]]
    outputs = [(name, TensorProto.FLOAT, [1, "batch", 16]) for _, name in memories[:2]]
    if len(memories) == 3:
        counted, next_count = memories[2]
        weights.update(one=np.array([1], dtype=np.int64), little=np.float32(0.01))
        nodes += [
            helper.make_node("Add", [counted, "one"], [next_count]),
            helper.make_node("Cast", [counted], ["number"], to=TensorProto.FLOAT),
            helper.make_node("Mul", ["number", "little"], ["drift"]),
            helper.make_node("Add", ["joints", "drift"], ["actions"]),
        ]
        inputs.append((counted, TensorProto.INT64, [1]))
        outputs.append((next_count, TensorProto.INT64, [1]))
    else:
        nodes[-1].output[0] = "actions"
    # The actions need not be the first output.
    outputs.append(("actions", TensorProto.FLOAT, [1, 2, 8]))
    save(path, nodes, weights, inputs, outputs)


def history(path):
    """One layer from the mean colours of two images and three states to two actions."""
    rng = np.random.default_rng(4)
    weights = {
        "scale": np.array(1 / 255, dtype=np.float32),
        "colours_form": np.array([1, 6], dtype=np.int64), "states_form": np.array([1, 24], dtype=np.int64),
        "form": np.array([1, 2, 8], dtype=np.int64),
        "layer": rng.normal(0, 0.3, (30, 16)).astype(np.float32), "bias": rng.normal(0, 0.3, 16).astype(np.float32),
    }
    nodes = [
        helper.make_node("Cast", ["front"], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["floats", "scale"], ["pictures"]),
        helper.make_node("ReduceMean", ["pictures"], ["means"], axes=[2, 3], keepdims=0),
        helper.make_node("Reshape", ["means", "colours_form"], ["colours"]),
        helper.make_node("Reshape", ["state", "states_form"], ["states"]),
        helper.make_node("Concat", ["colours", "states"], ["seen"], axis=1),
        helper.make_node("Gemm", ["seen", "layer", "bias"], ["flat"]),
        helper.make_node("Reshape", ["flat", "form"], ["actions"]),
    ]
    inputs = [("front", TensorProto.UINT8, ["batch", "images", 8, 8, 3]), ("state", TensorProto.FLOAT, ["batch", 3, 8])]
    save(path, nodes, weights, inputs, [("actions", TensorProto.FLOAT, [1, 2, 8])])


def vector(path):
    """Two layers without an axis for a batch: a vector times a matrix, and a matrix times a vector."""
    rng = np.random.default_rng(6)
    weights = {
        "w1": rng.normal(0, 3, (8, 6)).astype(np.float32), "w2": rng.normal(0, 0.5, (16, 6)).astype(np.float32),
        "form": np.array([2, 8], dtype=np.int64),
    }
    nodes = [
        helper.make_node("MatMul", ["state", "w1"], ["first"]), helper.make_node("Tanh", ["first"], ["hidden"]),
        helper.make_node("MatMul", ["w2", "hidden"], ["flat"]), helper.make_node("Reshape", ["flat", "form"], ["actions"]),
    ]
    save(path, nodes, weights, [("state", TensorProto.FLOAT, [8])], [("actions", TensorProto.FLOAT, [2, 8])])


def integers(path):
    """One layer from six integers to two numbers."""
    weights = {"w": np.ones((6, 2), np.float32)}
    nodes = [
        helper.make_node("Cast", ["obs"], ["floats"], to=TensorProto.FLOAT), helper.make_node("MatMul", ["floats", "w"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["action"]),
    ]
    save(path, nodes, weights, [("obs", TensorProto.INT64, ["batch", 6])], [("action", TensorProto.FLOAT, ["batch", 2])])


def steering(path):
    """Three layers that steer the point of tests/it/init.py to its target: tanh(gain * (target - place) - damping * speed)."""
    plane = np.kron(np.array([[-3.0], [-1.5], [3.0]]), np.eye(2)).astype(np.float32)
    both = np.concatenate([plane, -plane], axis=1)
    weights = {
        "w1": both, "b1": np.zeros(4, np.float32), "w2": np.eye(4, dtype=np.float32), "b2": np.zeros(4, np.float32),
        "w3": np.concatenate([np.eye(2), -np.eye(2)]).astype(np.float32), "b3": np.zeros(2, np.float32),
    }
    nodes = [
        helper.make_node("Gemm", ["obs", "w1", "b1"], ["first"]), helper.make_node("Relu", ["first"], ["one"]),
        helper.make_node("Gemm", ["one", "w2", "b2"], ["second"]), helper.make_node("Relu", ["second"], ["two"]),
        helper.make_node("Gemm", ["two", "w3", "b3"], ["third"]), helper.make_node("Tanh", ["third"], ["action"]),
    ]
    save(path, nodes, weights, [("obs", TensorProto.FLOAT, ["batch", 6])], [("action", TensorProto.FLOAT, ["batch", 2])])


def step_state(step):
    """Joints and gripper opening at an action."""
    joints = [0.05 * (step + 1) * (joint + 1) for joint in range(7)]
    return np.array([[*joints, 0.08 - 0.01 * step]], dtype=np.float32)


def step_image(step):
    """The image of 8 x 8 pixels at an action."""
    picture = Image.frombytes("RGB", (SIDE, SIDE), bytes((i + 40 * step) % 256 for i in range(3 * SIDE * SIDE)))
    return np.asarray(picture.resize((8, 8), Image.Resampling.BILINEAR))


def episode(name, inputs, memories=()):
    """The executed actions of an episode. `inputs` are those of a request at a step; memories are zero at the start."""
    session = onnxruntime.InferenceSession(HERE / f"{name}.onnx", providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    zeros = {"tensor(float)": np.zeros((1, 1, 16), np.float32), "tensor(int64)": np.zeros(1, np.int64)}
    kept = {given.name: zeros[given.type] for given in session.get_inputs() if given.name in dict(memories)}
    executed = []
    for step in range(STEPS):
        if step % EXECUTED[name] == 0:
            outputs = dict(zip(names, session.run(None, {**inputs(step), **kept})))
            kept = {given: outputs[returned] for given, returned in memories}
        executed.append([float(x) for x in outputs["actions"][0][step % EXECUTED[name]]])
    return executed


def answer(path, **inputs):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return [[float(x) for x in row] for row in session.run(None, inputs)[0][0]]


counting = Image.frombytes("RGB", (SIDE, SIDE), bytes(i % 256 for i in range(3 * SIDE * SIDE)))
eighth = np.asarray(counting.resize((8, 8), Image.Resampling.BILINEAR))[None]
at = SIDE // 4
middle = np.asarray(counting.crop((at, at, SIDE - at, SIDE - at)))[None].astype(np.float32) / 255
whole = np.asarray(counting.resize((64, 64), Image.Resampling.BILINEAR))[None].astype(np.float32) / 255
state = np.array([[0, 0, 0, 0, 0, 0, 0, 0.08]], dtype=np.float32)
small(HERE / "small.onnx", 1, 8)
small(HERE / "batch.onnx", "batch", 8)
small(HERE / "open.onnx", "batch", "width")
operators(HERE / "operators.onnx")
recurrent(HERE / "gru.onnx", "GRU", 3, [("h0", "h1")])
recurrent(HERE / "lstm.onnx", "LSTM", 4, [("h0", "h1"), ("c0", "c1"), ("n0", "n1")])
history(HERE / "history.onnx")
vector(HERE / "vector.onnx")
integers(HERE / "integers.onnx")
steering(HERE.parents[3] / "docs/examples/point/policy.onnx")
expected = {name: answer(HERE / f"{name}.onnx", front=eighth, state=state) for name in ["small", "operators"]}
for path in sorted(SHIPPED.glob("*.onnx")):
    expected[path.stem] = answer(path, front=middle, wrist=whole, state=state)
expected["gru"] = episode("gru", lambda step: {"state": step_state(step)}, [("h0", "h1")])
expected["lstm"] = episode("lstm", lambda step: {"state": step_state(step)}, [("h0", "h1"), ("c0", "c1"), ("n0", "n1")])
# Before the first action, its observation repeats.
expected["history"] = episode("history", lambda step: {
    "state": np.stack([step_state(max(0, step + offset))[0] for offset in HISTORY])[None],
    "front": np.stack([step_image(max(0, step + offset)) for offset in HISTORY[1:]])[None],
})
session = onnxruntime.InferenceSession(HERE / "vector.onnx", providers=["CPUExecutionProvider"])
expected["vector"] = [[float(x) for x in row] for row in session.run(None, {"state": state[0]})[0]]
(HERE / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
