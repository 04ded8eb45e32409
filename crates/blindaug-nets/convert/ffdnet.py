"""Converts FFDNet's PyTorch weights to ONNX: python ffdnet.py INPUT.pth OUTPUT.onnx. Needs numpy and onnx only.

The network has an input image [1, C, H, W] in 0..1 with even sides, and sigma [1, 1, 1, 1], the noise's std on the same
scale: space to depth by 2, sigma as one more channel, 3 x 3 convolutions with ReLU between them, depth to space.
"""
import io
import pickle
import sys
import zipfile

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

DTYPES = {"DoubleStorage": np.float64, "FloatStorage": np.float32, "HalfStorage": np.float16, "LongStorage": np.int64}
MAGIC = 0x1950A86A20F9469CFC6C  # opens a file of the form before PyTorch 1.6


class Reader(pickle.Unpickler):
    """Reads a pickled state dict and calls nothing but what is named here. A tensor becomes (storage key, function of the data)."""

    def find_class(self, module, name):
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if (module, name) in (("torch._utils", "_rebuild_tensor_v2"), ("torch._utils", "_rebuild_tensor")):
            return lambda storage, offset, size, stride, *_: (*storage, offset, size, stride)
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return lambda tensor, *_: tensor
        if module == "torch" and name in DTYPES:
            return DTYPES[name]
        raise pickle.UnpicklingError(f"a state dict has no {module}.{name}")

    def persistent_load(self, saved):
        kind, dtype, key, _, count, *view = saved
        if kind != "storage" or any(v is not None for v in view):
            raise pickle.UnpicklingError("storage of an unknown kind")
        return str(key), np.dtype(dtype), count


def state_dict(path):
    """Names and arrays of a .pth of either form."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as z:
            index = next(n for n in z.namelist() if n.endswith("/data.pkl"))
            state = Reader(io.BytesIO(z.read(index))).load()
            data = {t[0]: z.read(index[: -len("data.pkl")] + "data/" + t[0]) for t in state.values()}
    else:
        with open(path, "rb") as f:
            if Reader(f).load() != MAGIC:
                raise ValueError(f"{path} is no file of PyTorch's")
            Reader(f).load(), Reader(f).load()  # version, sizes of the machine's integers
            state = Reader(f).load()
            sizes = {t[0]: (t[1], t[2]) for t in state.values()}
            data = {}
            for key in Reader(f).load():
                dtype, count = sizes[str(key)]
                if int.from_bytes(f.read(8), "little") != count:
                    raise ValueError(f"{path} is damaged: storage {key}")
                data[str(key)] = f.read(count * dtype.itemsize)
    out = {}
    for name, (key, dtype, _, offset, size, stride) in state.items():
        flat = np.frombuffer(data[key], dtype)[offset:]
        last = sum((n - 1) * s for n, s in zip(size, stride))
        if offset < 0 or len(size) != len(stride) or min(size, default=1) < 1 or min(stride, default=0) < 0 or last >= len(flat):
            raise ValueError(f"{path} is damaged: {name} is larger than its storage")
        strides = [s * dtype.itemsize for s in stride]
        out[name] = np.lib.stride_tricks.as_strided(flat, size, strides).astype(np.float32)
    return out


def convert(state):
    layers = [n.rsplit(".", 1)[0] for n in state if n.endswith(".weight")]
    layers.sort(key=lambda n: int(n.rsplit(".", 1)[1]))
    first, last = (state[f"{n}.weight"] for n in (layers[0], layers[-1]))
    channels = last.shape[0] // 4
    if first.shape[1] != 4 * channels + 1 or any(state[f"{n}.weight"].shape[2:] != (3, 3) for n in layers):
        raise ValueError("these are not the weights of FFDNet: expected 3 x 3 convolutions, the first with sigma's channel")
    nodes, constants = [], []

    def constant(name, value):
        constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(kind, inputs, output, **attributes):
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    # ONNX's own SpaceToDepth has the 2 x 2 places before the channels; here the channels come first.
    node("Shape", ["image"], "size")
    rows = node("Gather", ["size", constant("two", np.array([2]))], "height")
    columns = node("Gather", ["size", constant("three", np.array([3]))], "width")
    two = constant("half", np.array([2]))
    node("Div", [rows, two], "h")
    node("Div", [columns, two], "w")
    one, c, c4 = (constant(f"n{v}", np.array([v])) for v in (1, channels, 4 * channels))
    split = node("Concat", [one, c, "h", two, "w", two], "split_shape", axis=0)
    x = node("Reshape", ["image", split], "blocks")
    x = node("Transpose", [x], "places", perm=[0, 1, 3, 5, 2, 4])
    x = node("Reshape", [x, node("Concat", [one, c4, "h", "w"], "down_shape", axis=0)], "down")
    noise = node("Expand", ["sigma", node("Concat", [one, one, "h", "w"], "map_shape", axis=0)], "noise")
    x = node("Concat", [x, noise], "both", axis=1)
    for i, name in enumerate(layers):
        weight, bias = (constant(f"{name}.{p}", state[f"{name}.{p}"]) for p in ("weight", "bias"))
        x = node("Conv", [x, weight, bias], f"conv{i}", kernel_shape=[3, 3], pads=[1, 1, 1, 1])
        if name != layers[-1]:
            x = node("Relu", [x], f"relu{i}")
    node("DepthToSpace", [x], "denoised", blocksize=2, mode="CRD")

    image = [1, channels, "height", "width"]
    graph = helper.make_graph(
        nodes,
        "ffdnet",
        [
            helper.make_tensor_value_info("image", TensorProto.FLOAT, image),
            helper.make_tensor_value_info("sigma", TensorProto.FLOAT, [1, 1, 1, 1]),
        ],
        [helper.make_tensor_value_info("denoised", TensorProto.FLOAT, image)],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, producer_name="blindaug")
    onnx.checker.check_model(model, full_check=True)
    return model


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: ffdnet.py INPUT.pth OUTPUT.onnx")
    onnx.save(convert(state_dict(sys.argv[1])), sys.argv[2])
