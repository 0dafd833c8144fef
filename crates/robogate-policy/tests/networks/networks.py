"""Write small.onnx, batch.onnx and open.onnx, and expected.json: the outputs of ONNX Runtime for them and for the policies that RoboGate ships.

    pip install --requirement scripts/learned/requirements.txt
    python crates/robogate-policy/tests/networks/networks.py

The observation is that of tests/support, with images of 96 x 96 pixels: bytes that count up, joints at zero, an opening of 80 mm.
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
expected = {"small": answer(HERE / "small.onnx", front=eighth, state=state)}
for path in sorted(SHIPPED.glob("*.onnx")):
    expected[path.stem] = answer(path, front=middle, wrist=whole, state=state)
(HERE / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
