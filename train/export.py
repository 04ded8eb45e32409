"""Checkpoint -> ONNX with f16 weights that are cast to f32 (half the file, the same arithmetic). Checks it in onnxruntime."""
import argparse
import hashlib

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper

import nets

p = argparse.ArgumentParser(description=__doc__)
p.add_argument("checkpoint")
p.add_argument("out", help="file .onnx")
a = p.parse_args()

saved = torch.load(a.checkpoint)
task = saved["task"]
net = nets.Net(task).eval()
net.load_state_dict(saved["weights"])
for v in net.parameters():  # rounded to f16, as in the file
    v.data = v.data.half().float()
frames, _ = nets.TASKS[task]
name_in, name_out = ("frames" if frames > 1 else "frame"), ("clean" if task == "noise" else "sharp")
torch.onnx.export(
    net, torch.rand(1, 3 * frames, 64, 64), a.out, dynamo=False, opset_version=13, input_names=[name_in], output_names=[name_out],
    dynamic_axes={name_in: {2: "h", 3: "w"}, name_out: {2: "h", 3: "w"}},
)
model = onnx.load(a.out)
graph = model.graph
kept, casts = [], []
for t in graph.initializer:
    if t.data_type == TensorProto.FLOAT and numpy_helper.to_array(t).size > 1:
        half = numpy_helper.from_array(numpy_helper.to_array(t).astype(np.float16), t.name + ".f16")
        casts.append(helper.make_node("Cast", [half.name], [t.name], to=TensorProto.FLOAT))
        t = half
    kept.append(t)
nodes = casts + list(graph.node)
del graph.initializer[:], graph.node[:]
graph.initializer.extend(kept)
graph.node.extend(nodes)
onnx.checker.check_model(model)
onnx.save(model, a.out)

run = onnxruntime.InferenceSession(a.out, providers=["CPUExecutionProvider"])
for h, w in ((64, 64), (72, 136)):
    x = torch.rand(1, 3 * frames, h, w)
    with torch.no_grad():
        want = net(x).numpy()
    worst = np.abs(run.run(None, {name_in: x.numpy()})[0] - want).max()
    assert worst < 1e-4, worst
data = open(a.out, "rb").read()
print(f"{a.out}: {sum(v.numel() for v in net.parameters())} parameters, {len(data)} bytes, {saved['steps']} steps, differs from torch by {worst:.1e}")
print("operators:", *sorted({n.op_type for n in nodes}))
print("sha256", hashlib.sha256(data).hexdigest())
