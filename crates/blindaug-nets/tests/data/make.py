"""Makes the small networks of the tests: `python make.py` in this folder (needs numpy and onnx)."""

import numpy as np
from onnx import TensorProto, helper, numpy_helper, save


def network(name, inputs, nodes, output, weights=()):
    def value(name, shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    graph = helper.make_graph(
        nodes,
        name,
        [value(*i) for i in inputs],
        [value(*output)],
        [numpy_helper.from_array(np.asarray(w, np.float32), n) for n, w in weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    save(model, f"{name}.onnx")


# All attributes are given, because rten has no defaults for them.
def conv(source, weights, target, pads=(0, 0, 0, 0)):
    return helper.make_node("Conv", [source, weights], [target], pads=pads, strides=(1, 1), dilations=(1, 1), group=1)


RGB = [1, 3, "h", "w"]

# Each channel is the mean of 5 x 5 px.
box = np.zeros((3, 3, 5, 5))
box[[0, 1, 2], [0, 1, 2]] = 1 / 25
network("box", [("x", RGB)], [conv("x", "k", "y", (2, 2, 2, 2))], ("y", RGB), [("k", box)])

box[1, 1, 2, 2] = np.nan
network("nan", [("x", RGB)], [conv("x", "k", "y", (2, 2, 2, 2))], ("y", RGB), [("k", box)])

# The means of three frames' red, green and blue, less the noise std.
middle = np.zeros((3, 9, 1, 1))
for c in range(3):
    middle[c, [c, c + 3, c + 6]] = 1 / 3
network(
    "three",
    [("x", [1, 9, "h", "w"]), ("sigma", [1, 1, 1, 1])],
    [conv("x", "k", "m"), helper.make_node("Sub", ["m", "sigma"], ["y"])],
    ("y", RGB),
    [("k", middle)],
)

# Flow: (red of the second frame - red of the first, twice the blue of the first).
first = np.zeros((2, 3, 1, 1))
second = np.zeros((2, 3, 1, 1))
first[0, 0], first[1, 2], second[0, 0] = -1, 2, 1
network(
    "flow",
    [("a", RGB), ("b", RGB)],
    [conv("a", "k", "p"), conv("b", "l", "q"), helper.make_node("Add", ["p", "q"], ["y"])],
    ("y", [1, 2, "h", "w"]),
    [("k", first), ("l", second)],
)

# Depth of 32 x 24 px in the shape [1, H, W]: the green channel.
green = np.zeros((1, 3, 1, 1))
green[0, 1] = 1
network(
    "depth",
    [("x", [1, 3, 24, 32])],
    [conv("x", "k", "d"), helper.make_node("ReduceMean", ["d"], ["y"], axes=[1], keepdims=0)],
    ("y", [1, 24, 32]),
    [("k", green)],
)

# A cubic Resize, which rten would compute as a linear one.
network(
    "cubic",
    [("x", RGB)],
    [helper.make_node("Resize", ["x", "", "s"], ["y"], mode="cubic")],
    ("y", RGB),
    [("s", [1, 1, 2, 2])],
)
