"""The network of all three tasks: a small U-Net that says, for each pixel, how much of each of 16 fixed bands to add, and a residual.

The bands are second differences over 1, 2, 4 and 8 px in four directions, of ever smoother copies of the frame: adding them sharpens,
along any direction and at any scale, and subtracting them smooths. With them little has to be learned: the relative strengths of the
bands, which the network is also given, show how blurred the frame is and how to restore it."""
import torch
import torch.nn as nn
import torch.nn.functional as F

# task -> (frames in, index of the frame that is restored)
TASKS = {"defocus": (1, 0), "motion": (3, 1), "noise": (1, 0)}
WIDTHS = (16, 32, 64)  # at 1/2, 1/4, 1/8 of the frame
ENC, DEC = (0, 1, 1), (0, 1)  # residual blocks at each scale
SCALES = 4
BANDS = 4 * SCALES


class Block(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.a = nn.Conv2d(c, c, 3, 1, 1)
        self.b = nn.Conv2d(c, c, 3, 1, 1)

    def forward(self, x):
        return x + self.b(F.leaky_relu(self.a(x), 0.1))


def blocks(c, n):
    return nn.Sequential(*[Block(c) for _ in range(n)])


def table(*rows):
    return torch.tensor(rows, dtype=torch.float32)


SPLINE = table([1, 4, 6, 4, 1]) / 16
SPLINE = (SPLINE.T * SPLINE)[None, None]
DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1))  # y, x


class Net(nn.Module):
    """[1, 3T, H, W] display-encoded RGB in 0..1 -> [1, 3, H, W]; H and W are multiples of 8."""

    def __init__(self, task):
        super().__init__()
        self.frames, self.middle = TASKS[task]
        c = WIDTHS
        facts = BANDS + 1 + (BANDS if self.frames == 3 else 0)
        self.rule = nn.Sequential(nn.Conv2d(facts, 32, 1), nn.LeakyReLU(0.1), nn.Conv2d(32, 32, 1), nn.LeakyReLU(0.1), nn.Conv2d(32, BANDS, 1))
        self.head = nn.Conv2d(12 * self.frames + facts, c[0], 3, 1, 1)
        self.enc = nn.ModuleList([blocks(k, n) for k, n in zip(c, ENC)])
        self.down = nn.ModuleList([nn.Conv2d(a, b, 2, 2) for a, b in zip(c, c[1:])])
        self.up = nn.ModuleList([nn.ConvTranspose2d(b, a, 2, 2) for a, b in zip(c, c[1:])])
        self.dec = nn.ModuleList([blocks(k, n) for k, n in zip(c[:-1], DEC)])
        self.tail = nn.Conv2d(c[0], 12, 3, 1, 1)
        self.gain = nn.Conv2d(c[0], BANDS, 3, 1, 1)
        for m in (self.tail, self.gain, self.rule[-1]):  # zero, so that the network starts as the identity
            nn.init.zeros_(m.weight)
            nn.init.zeros_(m.bias)

        def fixed(name, value):
            self.register_buffer(name, value, persistent=False)

        # pixel-unshuffle is done as a convolution, since not all runtimes have SpaceToDepth
        n = 12 * self.frames
        w = torch.zeros(n, n // 4, 2, 2)
        for i in range(n):
            w[i, i // 4, i % 4 // 2, i % 2] = 1
        fixed("unshuffle", w)
        fixed("smooth3", SPLINE.repeat(3, 1, 1, 1))
        fixed("near", SPLINE.repeat(BANDS, 1, 1, 1))
        sides, slope = torch.zeros(4, 1, 3, 3), torch.zeros(4, 1, 3, 3)
        for i, (y, x) in enumerate(DIRECTIONS):
            sides[i, 0, 1 + y, 1 + x] = sides[i, 0, 1 - y, 1 - x] = 0.5
            slope[i, 0, 1 + y, 1 + x], slope[i, 0, 1 - y, 1 - x] = 0.5, -0.5
        fixed("sides", sides)
        fixed("slope", slope)
        fixed("four", torch.ones(4, 1, 1, 1))
        fixed("luma", table([0.299, 0.587, 0.114])[..., None, None])

    def around(self, x):
        """Mean over about 8 px, at half the size."""
        return F.conv2d(F.avg_pool2d(x, 2), self.near, padding=4, dilation=2, groups=BANDS)

    def bands(self, x, change):
        """The bands of the three channels, 16 each; and with `change` (half the difference of the next and the previous luma) the
        motion by the bands' slopes, in units of what each scale can see. A convolution of ones tells where zeros from outside the
        frame have come in."""
        ones = x[:, :1] * 0 + 1
        rgb, along, across = ([], [], []), [], []
        for j in range(SCALES):
            s = 2**j
            inside = F.relu(2 * F.conv2d(ones, self.sides, padding=s, dilation=s) - 1)
            for out, c in zip(rgb, torch.split(x, 1, 1)):
                out.append((F.conv2d(c, self.four) - F.conv2d(c, self.sides, padding=s, dilation=s)) * inside)
            if change is not None:
                g = F.conv2d(F.conv2d(x, self.luma), self.slope, padding=s, dilation=s) * inside
                along.append(g * g)
                across.append(g * change)
            if j + 1 < SCALES:
                part = F.conv2d(ones, self.smooth3[:1], padding=2 * s, dilation=s)
                x = F.conv2d(x, self.smooth3, padding=2 * s, dilation=s, groups=3) / part
                if change is not None:
                    change = F.conv2d(change, self.smooth3[:1], padding=2 * s, dilation=s) / part
        moved = None
        if change is not None:
            moved = self.around(torch.cat(across, 1)) / (self.around(torch.cat(along, 1)) + 1e-5)
            moved = torch.abs(torch.clamp(moved, -2, 2))
        return [torch.cat(out, 1) for out in rgb], moved

    def evidence(self, x):
        """The inputs that are computed, not learned: the bands, and their relative strengths at half the size."""
        frame = x[:, 3 * self.middle : 3 * self.middle + 3]
        change = (F.conv2d(x[:, 6:], self.luma) - F.conv2d(x[:, :3], self.luma)) * 0.5 if self.frames == 3 else None
        rgb, moved = self.bands(frame, change)
        amount = torch.sqrt(self.around(rgb[0] * rgb[0] + rgb[1] * rgb[1] + rgb[2] * rgb[2]) + 1e-7)
        total = amount.mean(1, keepdim=True)
        facts = [2 * amount / total - 2, 5 * total] + ([moved] if moved is not None else [])
        return frame, rgb, torch.cat(facts, 1), F.conv2d(x - 0.5, self.unshuffle, stride=2)

    def forward(self, x):
        with torch.no_grad():
            frame, rgb, facts, seen = self.evidence(x)
        y = self.head(torch.cat([seen, facts], 1))
        skips = []
        for enc, down in zip(self.enc, self.down):
            y = enc(y)
            skips.append(y)
            y = down(y)
        y = self.enc[-1](y)
        for i in reversed(range(len(skips))):
            y = self.dec[i](self.up[i](y) + skips[i])
        gain = F.interpolate(self.rule(facts) + self.gain(y), scale_factor=2, mode="nearest")
        added = torch.cat([(gain * v).sum(1, keepdim=True) for v in rgb], 1)
        return frame + added + F.pixel_shuffle(self.tail(y), 2)
