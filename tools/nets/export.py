#!/usr/bin/env python3
"""Exports known networks to ONNX, from their authors' weights: export.py NAME WEIGHTS -o FILE.onnx

WEIGHTS is a file of PyTorch or safetensors, or a folder with config.json for networks in transformers. --random takes random
weights instead, which is enough to try a runtime.
--size W H is the size of networks that are exported at one size; --list shows them all. See README.md beside it.
"""
import argparse
import math
import os
import sys

import torch
from torch import nn


class Pair(nn.Module):
    """Flow of two images."""

    def __init__(self, net, call):
        super().__init__()
        self.net, self.call = net, call

    def forward(self, first, second):
        return self.call(self.net, first, second)


class Wrapped(nn.Module):
    def __init__(self, net, call):
        super().__init__()
        self.net, self.call = net, call

    def forward(self, image):
        return self.call(self.net, image)


def no_padding(net):
    """The sides are a multiple of what the network needs already."""
    net.check_image_size = lambda x: x
    return net


def nafnet(encoders, middle, decoders):
    def build():
        from spandrel.architectures.NAFNet import NAFNet

        blocks = {"enc_blk_nums": encoders, "middle_blk_num": middle, "dec_blk_nums": decoders}
        net = no_padding(NAFNet(img_channel=3, width=32, **blocks))
        return net, Wrapped(net, lambda n, x: n(x))

    return build


def scunet():
    from spandrel.architectures.SCUNet import SCUNet

    net = no_padding(SCUNet())
    return net, Wrapped(net, lambda n, x: n(x))


def restormer(norm):
    def build():
        from spandrel_extra_arches.architectures.Restormer import Restormer

        net = Restormer(LayerNorm_type=norm)
        return net, Wrapped(net, lambda n, x: n(x))

    return build


def raft(which):
    def build():
        from torchvision.models import optical_flow

        net = getattr(optical_flow, which)(weights=None)
        return net, Pair(net, lambda n, a, b: n(a, b, num_flow_updates=12)[-1])

    return build


def ptlflow(which):
    def build():
        import importlib

        folder = {"sea_raft_m": "sea_raft", "flownet2": "flownet"}[which]
        # The package's own default is a tuple, which it then changes.
        options = {"block_dims": [64, 128, 256]} if which == "sea_raft_m" else {}
        net = getattr(importlib.import_module("ptlflow.models." + folder), which)(**options)
        for part in net.modules():
            if hasattr(part, "preprocess_images"):
                part.postprocess_predictions = lambda flow, *_, **__: flow
                part.preprocess_images = lambda images, *_, **__: (images, None)
        if which == "flownet2":
            # The original centres both images on their common mean of each channel.
            def call(n, a, b):
                both = torch.stack([a, b], 1)
                return n({"images": both - both.mean((1, 3, 4), keepdim=True)})["flows"][:, 0]
        else:
            call = lambda n, a, b: n({"images": torch.stack([a, b], 1)})["flows"][:, 0]
        return net, Pair(net, call)

    return build


def constant_positions(net):
    """DINOv2 resamples its positions bicubically, which not all runtimes can: they become constants of the size at the export."""

    def kept(resample):
        known = {}

        def positions(tokens, height, width):
            size = int(height), int(width)
            if size not in known:
                known[size] = resample(tokens, *size).detach()
            return known[size]

        return positions

    for part in net.modules():
        if type(part).__name__ == "Dinov2Embeddings":
            part.interpolate_pos_encoding = kept(part.interpolate_pos_encoding)


def dpt_large():
    from transformers import DPTConfig, DPTForDepthEstimation

    config = DPTConfig(
        hidden_size=1024,
        num_hidden_layers=24,
        num_attention_heads=16,
        intermediate_size=4096,
        backbone_out_indices=[5, 11, 17, 23],
        neck_hidden_sizes=[256, 512, 1024, 1024],
    )
    net = DPTForDepthEstimation(config)
    return net, Wrapped(net, lambda n, x: n(x).predicted_depth[:, None])


def depth_anything_v2_small():
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config

    backbone = Dinov2Config(
        hidden_size=384,
        num_hidden_layers=12,
        num_attention_heads=6,
        image_size=518,
        patch_size=14,
        out_indices=[3, 6, 9, 12],
        reshape_hidden_states=False,
        apply_layernorm=True,
    )
    net = DepthAnythingForDepthEstimation(DepthAnythingConfig(backbone_config=backbone))
    constant_positions(net)
    return net, Wrapped(net, lambda n, x: n(x).predicted_depth[:, None])


def depth_pro(small=False):
    """`small` has the same operators with a hundredth of the weights, to try a runtime."""
    from transformers import DepthProConfig, DepthProForDepthEstimation

    config = None
    if small:
        vit = {"model_type": "dinov2", "hidden_size": 32, "num_hidden_layers": 12, "num_attention_heads": 2, "patch_size": 16, "image_size": 64}
        config = DepthProConfig(
            fusion_hidden_size=16,
            patch_size=64,
            intermediate_feature_dims=[16, 16],
            scaled_images_feature_dims=[32, 32, 16],
            image_model_config=dict(vit),
            patch_model_config=dict(vit),
            fov_model_config=dict(vit),
            use_fov_model=True,
        )
    net = DepthProForDepthEstimation(config or DepthProConfig(use_fov_model=True))
    constant_positions(net)

    def metres(n, x):
        out = n(x)
        # The network gives inverse depth for a focal length of one image width, and the angle of view in degrees.
        width_per_focal = 2 * torch.tan(out.field_of_view * (math.pi / 360))
        return 1 / (out.predicted_depth[:, None] * width_per_focal.view(-1, 1, 1, 1)).clamp(1e-4, 1e4)

    return net, Wrapped(net, metres)


# For each network's name: its builder, the packages that it needs, the size (width, height) of its export, and whether other sizes work.
NETS = {
    "nafnet-sidd-width32": (nafnet([2, 2, 4, 8], 12, [2, 2, 2, 2]), "spandrel", (256, 256), True),
    "nafnet-gopro-width32": (nafnet([1, 1, 1, 28], 1, [1, 1, 1, 1]), "spandrel", (256, 256), True),
    "scunet-color-real": (scunet, "spandrel", (256, 256), False),
    "restormer-real-denoising": (restormer("BiasFree"), "spandrel spandrel_extra_arches", (256, 256), True),
    "restormer-motion-deblurring": (restormer("WithBias"), "spandrel spandrel_extra_arches", (256, 256), True),
    "restormer-defocus-deblurring": (restormer("WithBias"), "spandrel spandrel_extra_arches", (256, 256), True),
    "raft-large": (raft("raft_large"), "torchvision", (512, 384), True),
    "raft-small": (raft("raft_small"), "torchvision", (512, 384), True),
    "sea-raft-m": (ptlflow("sea_raft_m"), "ptlflow", (512, 384), True),
    "flownet2": (ptlflow("flownet2"), "ptlflow", (512, 384), False),
    "dpt-large": (dpt_large, "transformers", (384, 384), False),
    "depth-anything-v2-small": (depth_anything_v2_small, "transformers", (518, 518), False),
    "depth-pro": (depth_pro, "transformers", (1536, 1536), False),
    "depth-pro-tiny": (lambda: depth_pro(small=True), "transformers", (256, 256), False),
}


def load(net, path):
    if path.endswith(".safetensors"):
        from safetensors.torch import load_file

        state = load_file(path)
    else:
        state = torch.load(path, map_location="cpu", weights_only=True)
        for key in ("state_dict", "params_ema", "params", "model"):
            state = state.get(key, state)
    state = {k.removeprefix("module."): v for k, v in state.items()}
    missing, unexpected = net.load_state_dict(state, strict=False)
    if missing:
        sys.exit(f"{path} lacks {len(missing)} weights of this network, such as {missing[0]}")
    if unexpected:
        print(f"not used: {len(unexpected)} weights, such as {unexpected[0]}", file=sys.stderr)


def randomise(net, module):
    """Weights with which a signal neither dies out nor grows, and with which nothing is hidden behind a zero."""
    torch.manual_seed(1)
    with torch.no_grad():
        for p in net.parameters():
            if p.dim() > 1 and 0 < p.std() < 0.025:
                p.normal_(0, p[0].numel() ** -0.5)
            elif p.count_nonzero() == 0:
                # The weights are above zero, since some outputs end in a ReLU.
                p.uniform_(0, 0.1)
        if hasattr(net, "flow_head"):
            # SEA-RAFT's flow would leave the image and jump with rounding.
            net.flow_head[-1].weight.mul_(0.01)
        norms = [m for m in module.eval().modules() if isinstance(m, nn.BatchNorm2d)]
        if norms:
            for m in norms:
                m.momentum = 1
                m.train()
            inputs = [torch.rand(1, 3, 128, 128) for _ in range(2 if isinstance(module, Pair) else 1)]
            module(*inputs)


def build(name, weights=None):
    """The network as it is exported, its inputs at that size, and whether other sizes work."""
    make, packages, (width, height), dynamic = NETS[name]
    torch.manual_seed(1)
    try:
        net, module = make()
    except ImportError as e:
        sys.exit(f"{name}: {e}; pip install {packages}")
    if weights and os.path.isdir(weights):
        net.load_state_dict(type(net).from_pretrained(weights).state_dict())
    elif weights:
        load(net, weights)
    else:
        randomise(net, module)
    return module.eval(), width, height, dynamic


def export(module, path, width, height, dynamic):
    pair = isinstance(module, Pair)
    names = ["first", "second"] if pair else ["image"]
    output = "flow" if pair else "output"
    sides = {2: "height", 3: "width"}
    inputs = tuple(torch.rand(1, 3, height, width) for _ in names)
    if not dynamic:
        module(*inputs)  # computes what is kept for this size
    torch.onnx.export(
        module,
        inputs,
        path,
        input_names=names,
        output_names=[output],
        dynamic_axes={n: sides for n in [*names, output]} if dynamic else None,
        opset_version=17,
        dynamo=False,
    )


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("name", nargs="?", choices=NETS, metavar="NAME")
    p.add_argument("weights", nargs="?", metavar="WEIGHTS")
    p.add_argument("-o", "--output", metavar="FILE.onnx")
    p.add_argument("--random", action="store_true")
    p.add_argument("--size", nargs=2, type=int, metavar=("W", "H"))
    p.add_argument("--list", action="store_true")
    a = p.parse_args()
    if a.list:
        for name, (_, packages, (w, h), dynamic) in NETS.items():
            print(f"{name:26} {'any size' if dynamic else f'{w} x {h}':12} pip install {packages}")
        return
    if not a.name or not a.output or bool(a.weights) == a.random:
        p.error("needs NAME, -o FILE.onnx, and either WEIGHTS or --random")
    module, width, height, dynamic = build(a.name, a.weights)
    width, height = a.size or (width, height)
    with torch.no_grad():
        export(module, a.output, width, height, dynamic)


if __name__ == "__main__":
    main()
