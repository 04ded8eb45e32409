"""The network of all three tasks: a small U-Net on pixel-unshuffled frames that predicts a residual."""
import torch
import torch.nn as nn
import torch.nn.functional as F

# task -> (frames in, index of the frame that the residual is added to)
TASKS = {"defocus": (1, 0), "motion": (3, 1), "noise": (1, 0)}
WIDTHS = (24, 48, 96)  # at 1/2, 1/4, 1/8 of the frame
ENC, DEC = (0, 1, 3), (1, 1)  # residual blocks at each scale


class Block(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.a = nn.Conv2d(c, c, 3, 1, 1)
        self.b = nn.Conv2d(c, c, 3, 1, 1)

    def forward(self, x):
        return x + self.b(F.leaky_relu(self.a(x), 0.1))


def blocks(c, n):
    return nn.Sequential(*[Block(c) for _ in range(n)])


class Net(nn.Module):
    """[1, 3T, H, W] display-encoded RGB in 0..1 -> [1, 3, H, W]; H and W are multiples of 8."""

    def __init__(self, task):
        super().__init__()
        frames, self.middle = TASKS[task]
        c = WIDTHS
        self.head = nn.Conv2d(3 * frames * 4, c[0], 3, 1, 1)
        self.enc = nn.ModuleList([blocks(k, n) for k, n in zip(c, ENC)])
        self.down = nn.ModuleList([nn.Conv2d(a, b, 2, 2) for a, b in zip(c, c[1:])])
        self.up = nn.ModuleList([nn.ConvTranspose2d(b, a, 2, 2) for a, b in zip(c, c[1:])])
        self.dec = nn.ModuleList([blocks(k, n) for k, n in zip(c, DEC)])
        self.tail = nn.Conv2d(c[0], 12, 3, 1, 1)
        for p in (self.tail.weight, self.tail.bias):  # starts as the identity
            nn.init.zeros_(p)
        # pixel-unshuffle as a convolution with fixed weights: not all runtimes have SpaceToDepth
        w = torch.zeros(12 * frames, 3 * frames, 2, 2)
        for i in range(12 * frames):
            w[i, i // 4, i % 4 // 2, i % 2] = 1
        self.register_buffer("unshuffle", w, persistent=False)

    def forward(self, x):
        frame = x[:, 3 * self.middle : 3 * self.middle + 3]
        y = self.head(F.conv2d(x - 0.5, self.unshuffle, stride=2))
        skips = []
        for enc, down in zip(self.enc, self.down):
            y = enc(y)
            skips.append(y)
            y = down(y)
        y = self.enc[-1](y)
        for i in reversed(range(len(skips))):
            y = self.dec[i](self.up[i](y) + skips[i])
        return frame + F.pixel_shuffle(self.tail(y), 2)
