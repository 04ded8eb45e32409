//! Dense optical flow: dense inverse search (Kroeger et al., ECCV 2016) with variational refinement at every scale
//! (Brox et al., ECCV 2004), from coarse to fine.

use crate::{Error, Flow, Plane, Result, par, pyramid, filter};

fn tune(name: &str, default: f32) -> f32 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// Side of a patch, px.
const PATCH: usize = 8;
/// Pixels repeated around an image, so that patches may leave it.
const PAD: usize = 16;

/// Optical flow
pub fn flow(from: &Plane, to: &Plane) -> Result<Flow> {
    let (w, h) = from.size();
    if from.size() != to.size() {
        let (tw, th) = to.size();
        return Err(Error::new(format!("optical flow needs two images of one size, not {w} x {h} and {tw} x {th}")));
    }
    if w == 0 || h == 0 {
        return Err(Error::new(format!("an image of {w} x {h} pixels has no optical flow")));
    }
    let finest = tune("FINEST", 1.0) as usize;
    let timing = std::env::var("TIMING").is_ok();
    let t0 = std::time::Instant::now();
    let from = pyramid_of(from);
    let to = pyramid_of(to);
    if timing { eprintln!("pyramid {:?}", t0.elapsed()); }
    let mut uv = Vec::new();
    let mut solver = Solver::default();
    for level in (0..from.len()).rev() {
        let (a, b) = (&from[level], &to[level]);
        uv = if uv.is_empty() { vec![0.0; 2 * a.w * a.h] } else { upsample(&uv, a.w, a.h) };
        let t0 = std::time::Instant::now();
        if level >= finest {
            uv = dense_inverse_search(a, b, &uv);
        }
        let t1 = std::time::Instant::now();
        let (warps, fixed, sweeps) = match level {
            0 => (tune("W0", 1.0) as usize, tune("K0", 3.0) as usize, tune("S0", 5.0) as usize),
            1 => (tune("W1", 1.0) as usize, tune("K1", 3.0) as usize, tune("S1", 5.0) as usize),
            _ => (tune("W2", 1.0) as usize, tune("K2", 3.0) as usize, tune("S2", 5.0) as usize),
        };
        for _ in 0..warps {
            solver.refine(a, b, &mut uv, fixed, sweeps);
        }
        if timing { eprintln!("level {level} dis {:?} var {:?}", t1 - t0, t1.elapsed()); }
    }
    let mut out = Flow::filled(w, h, [0.0; 2]);
    par::for_each_row(out.data_mut(), w, |y, row| {
        let (u, v) = uv[2 * w * y..][..2 * w].split_at(w);
        for (x, o) in row.iter_mut().enumerate() {
            *o = [u[x], v[x]];
        }
    });
    Ok(out)
}

/// An image with its edge pixels repeated `PAD` times outside.
struct Padded {
    w: usize,
    h: usize,
    stride: usize,
    data: Vec<f32>,
}

impl Padded {
    fn new(p: &Plane) -> Self {
        let (w, h) = p.size();
        // At least a patch and its neighbours, however small the image.
        let stride = w.max(PATCH) + 2 * PAD;
        let rows = h.max(PATCH) + 2 * PAD;
        let mut data = vec![0.0; stride * rows];
        for (y, out) in data.chunks_mut(stride).enumerate() {
            let row = p.row(y.saturating_sub(PAD).min(h - 1));
            out[..PAD].fill(row[0]);
            out[PAD..PAD + w].copy_from_slice(row);
            out[PAD + w..].fill(row[w - 1]);
        }
        Self { w, h, stride, data }
    }
    /// From pixel (x - PAD, y - PAD) on.
    #[inline(always)]
    fn from(&self, x: usize, y: usize) -> &[f32] {
        &self.data[y * self.stride + x..]
    }
    #[inline(always)]
    fn row(&self, y: usize) -> &[f32] {
        &self.from(PAD, y + PAD)[..self.w]
    }
}

/// Half the size at each level, finest first, until the largest motion (a quarter of the width) is a few px.
fn pyramid_of(p: &Plane) -> Vec<Padded> {
    let mut p = p.map(|v| if v.is_finite() { v.clamp(-4.0, 4.0) } else { 0.0 });
    p = filter::gaussian_blur(&p, tune("SIGMA", 0.7));
    let mut levels = vec![Padded::new(&p)];
    while p.width() > 24 && p.height() > 12 && levels.len() < 12 {
        p = pyramid::downsample(&p);
        levels.push(Padded::new(&p));
    }
    levels
}

/// Flow at twice the size: rows of `w` u, then `w` v.
fn upsample(coarse: &[f32], w: usize, h: usize) -> Vec<f32> {
    let (cw, ch) = (w.div_ceil(2), h.div_ceil(2));
    let mut fine = vec![0.0; 2 * w * h];
    par::for_each_row(&mut fine, 2 * w, |y, out| {
        let a = &coarse[2 * cw * (y / 2)..][..2 * cw];
        let b = &coarse[2 * cw * y.div_ceil(2).min(ch - 1)..][..2 * cw];
        for (out, (a, b)) in out.chunks_mut(w).zip(a.chunks(cw).zip(b.chunks(cw))) {
            for (x, o) in out.iter_mut().enumerate() {
                let (i, j) = (x / 2, x.div_ceil(2).min(cw - 1));
                *o = 0.5 * (a[i] + a[j] + b[i] + b[j]);
            }
        }
    });
    fine
}

/// What does not change while a patch is searched.
struct Template {
    value: [f32; PATCH * PATCH],
    gx: [f32; PATCH * PATCH],
    gy: [f32; PATCH * PATCH],
    /// Inverse of the Hessian of the mean-normalised squared difference.
    inverse: [f32; 3],
    mean_gx: f32,
    mean_gy: f32,
}

const N: f32 = (PATCH * PATCH) as f32;

impl Template {
    fn new(from: &Padded, x: usize, y: usize, prior: f32) -> Self {
        let mut t = Self {
            value: [0.0; PATCH * PATCH],
            gx: [0.0; PATCH * PATCH],
            gy: [0.0; PATCH * PATCH],
            inverse: [0.0; 3],
            mean_gx: 0.0,
            mean_gy: 0.0,
        };
        let mut sums = [[0.0f32; PATCH]; 5];
        for j in 0..PATCH {
            let above = &from.from(x + PAD - 1, y + PAD + j - 1)[..PATCH + 2];
            let here = &from.from(x + PAD - 1, y + PAD + j)[..PATCH + 2];
            let below = &from.from(x + PAD - 1, y + PAD + j + 1)[..PATCH + 2];
            let value = &mut t.value[j * PATCH..][..PATCH];
            let gx = &mut t.gx[j * PATCH..][..PATCH];
            let gy = &mut t.gy[j * PATCH..][..PATCH];
            for i in 0..PATCH {
                value[i] = here[i + 1];
                let (dx, dy) = (0.5 * (here[i + 2] - here[i]), 0.5 * (below[i + 1] - above[i + 1]));
                gx[i] = dx;
                gy[i] = dy;
                sums[0][i] += dx;
                sums[1][i] += dy;
                sums[2][i] += dx * dx;
                sums[3][i] += dx * dy;
                sums[4][i] += dy * dy;
            }
        }
        let [sx, sy, sxx, sxy, syy] = sums.map(|s| s.iter().sum::<f32>());
        let (a, b, c) = (sxx - sx * sx / N + prior, sxy - sx * sy / N, syy - sy * sy / N + prior);
        let det = (a * c - b * b).max(1e-12);
        t.inverse = [c / det, -b / det, a / det];
        t.mean_gx = sx / N;
        t.mean_gy = sy / N;
        t
    }

    /// Where the patch displaced to (x, y) lies in `to`: pixel, and fraction.
    #[inline(always)]
    fn place(to: &Padded, x: f32, y: f32) -> (usize, usize, f32, f32) {
        let p = PAD as f32;
        let x = (x + p).max(0.0).min((to.stride - PATCH - 2) as f32);
        let y = (y + p).max(0.0).min((to.data.len() / to.stride - PATCH - 2) as f32);
        let (xi, yi) = (x as i32, y as i32);
        (xi as usize, yi as usize, x - xi as f32, y - yi as f32)
    }

    /// Mean-normalised squared difference to the patch of `to` at (x, y), and the right hand side of the normal equations.
    #[inline(always)]
    fn compare(&self, to: &Padded, x: f32, y: f32) -> (f32, f32, f32) {
        let (xi, yi, fx, fy) = Self::place(to, x, y);
        let (mut r1, mut rr, mut rx, mut ry) = ([0.0f32; PATCH], [0.0f32; PATCH], [0.0f32; PATCH], [0.0f32; PATCH]);
        let mut above = [0.0f32; PATCH];
        let row = &to.from(xi, yi)[..PATCH + 1];
        for i in 0..PATCH {
            above[i] = row[i] + fx * (row[i + 1] - row[i]);
        }
        for j in 0..PATCH {
            let row = &to.from(xi, yi + j + 1)[..PATCH + 1];
            let value = &self.value[j * PATCH..][..PATCH];
            let gx = &self.gx[j * PATCH..][..PATCH];
            let gy = &self.gy[j * PATCH..][..PATCH];
            for i in 0..PATCH {
                let below = row[i] + fx * (row[i + 1] - row[i]);
                let r = above[i] + fy * (below - above[i]) - value[i];
                above[i] = below;
                r1[i] += r;
                rr[i] += r * r;
                rx[i] += gx[i] * r;
                ry[i] += gy[i] * r;
            }
        }
        let sum = |s: [f32; PATCH]| (s[0] + s[4]) + (s[1] + s[5]) + ((s[2] + s[6]) + (s[3] + s[7]));
        let s = sum(r1);
        (sum(rr) - s * s / N, sum(rx) - self.mean_gx * s, sum(ry) - self.mean_gy * s)
    }
}

/// Where patch `k` of a row or column of `size` px starts.
fn start(k: usize, stride: usize, size: usize) -> usize {
    (k * stride).min(size.saturating_sub(PATCH))
}

fn dense_inverse_search(from: &Padded, to: &Padded, uv: &[f32]) -> Vec<f32> {
    let (w, h) = (from.w, from.h);
    let stride = tune("STRIDE", 4.0) as usize;
    let iterations = tune("GD", 8.0) as usize;
    let prior = tune("PRIOR", 1e-3);
    let offset = tune("OFFSET", 10.0) as usize;
    let rounds = tune("ROUNDS", 1.0) as usize;
    let count = |size: usize| size.saturating_sub(PATCH).div_ceil(stride) + 1;
    let (nx, ny) = (count(w), count(h));
    let at = |x: usize, y: usize| {
        let row = &uv[2 * w * y.min(h - 1)..][..2 * w];
        [row[x.min(w - 1)], row[w + x.min(w - 1)]]
    };
    let descend = |t: &Template, x: f32, y: f32, start: [f32; 2], cost: f32| {
        let (mut best, mut best_cost) = (start, f32::MAX);
        let mut f = start;
        for _ in 0..iterations {
            let (c, bx, by) = t.compare(to, x + f[0], y + f[1]);
            if c >= best_cost {
                break;
            }
            (best, best_cost) = (f, c);
            let bx = bx + prior * (f[0] - start[0]);
            let by = by + prior * (f[1] - start[1]);
            let d = [t.inverse[0] * bx + t.inverse[1] * by, t.inverse[1] * bx + t.inverse[2] * by];
            f = [f[0] - d[0], f[1] - d[1]];
            let moved = [f[0] - start[0], f[1] - start[1]];
            if moved[0] * moved[0] + moved[1] * moved[1] > (PATCH * PATCH) as f32 {
                break;
            }
            if d[0] * d[0] + d[1] * d[1] < 1e-4 {
                break;
            }
        }
        let _ = cost;
        [best[0], best[1], best_cost]
    };
    let mut patches = vec![[0.0f32; 3]; nx * ny];
    par::for_each_row(&mut patches, nx, |j, row| {
        let y = start(j, stride, h);
        for (i, out) in row.iter_mut().enumerate() {
            let x = start(i, stride, w);
            let t = Template::new(from, x, y, prior);
            let (cx, cy) = (x + PATCH / 2, y + PATCH / 2);
            let (xf, yf) = (x as f32, y as f32);
            let mut best = at(cx, cy);
            let mut cost = t.compare(to, xf + best[0], yf + best[1]).0;
            if offset > 0 {
                for (x, y) in [
                    (cx.saturating_sub(offset), cy),
                    (cx + offset, cy),
                    (cx, cy.saturating_sub(offset)),
                    (cx, cy + offset),
                ] {
                    let f = at(x, y);
                    if (f[0] - best[0]).abs() + (f[1] - best[1]).abs() < 0.25 { continue; }
                    let c = t.compare(to, xf + f[0], yf + f[1]).0;
                    if c < cost {
                        (best, cost) = (f, c);
                    }
                }
            }
            *out = descend(&t, xf, yf, best, cost);
        }
    });
    for _ in 0..rounds {
        let before = patches.clone();
        par::for_each_row(&mut patches, nx, |j, row| {
            let y = start(j, stride, h);
            for (i, out) in row.iter_mut().enumerate() {
                let x = start(i, stride, w);
                let (xf, yf) = (x as f32, y as f32);
                let t = Template::new(from, x, y, prior);
                let mut best = [out[0], out[1]];
                let mut cost = out[2];
                let mut changed = false;
                for (i, j) in [(i.saturating_sub(1), j), ((i + 1).min(nx - 1), j), (i, j.saturating_sub(1)), (i, (j + 1).min(ny - 1))] {
                    let n = before[j * nx + i];
                    if (n[0] - best[0]).abs() + (n[1] - best[1]).abs() < 0.5 { continue; }
                    let c = t.compare(to, xf + n[0], yf + n[1]).0;
                    if c < cost {
                        (best, cost, changed) = ([n[0], n[1]], c, true);
                    }
                }
                if changed {
                    *out = descend(&t, xf, yf, best, cost);
                }
            }
        });
    }
    densify(from, to, &patches, nx, ny, stride)
}

/// Mean of the patches over a pixel, each weighted by how well the pixel fits it.
fn densify(from: &Padded, to: &Padded, patches: &[[f32; 3]], nx: usize, ny: usize, stride: usize) -> Vec<f32> {
    let (w, h) = (from.w, from.h);
    let floor = tune("DFLOOR", 1.0 / 255.0);
    let power2 = tune("DPOW", 2.0) > 1.5;
    let mut uv = vec![0.0; 2 * w * h];
    let padded = w.max(PATCH);
    par::for_each_row(&mut uv, 2 * w, |y, out| {
        let mut sums = vec![0.0f32; 3 * padded];
        let (su, rest) = sums.split_at_mut(padded);
        let (sv, sw) = rest.split_at_mut(padded);
        let first = (y + 1).saturating_sub(PATCH).div_ceil(stride).min(ny - 1);
        for j in first..ny {
            let py = start(j, stride, h);
            if py > y {
                break;
            }
            for i in 0..nx {
                let px = start(i, stride, w);
                let [u, v, _] = patches[j * nx + i];
                let (xi, yi, fx, fy) = Template::place(to, px as f32 + u, py as f32 + v);
                let k = y - py;
                let a = &to.from(xi, yi + k)[..PATCH + 1];
                let b = &to.from(xi, yi + k + 1)[..PATCH + 1];
                let t = &from.from(px + PAD, y + PAD)[..PATCH];
                let (su, sv, sw) = (&mut su[px..][..PATCH], &mut sv[px..][..PATCH], &mut sw[px..][..PATCH]);
                for l in 0..PATCH {
                    let above = a[l] + fx * (a[l + 1] - a[l]);
                    let below = b[l] + fx * (b[l + 1] - b[l]);
                    let r = (above + fy * (below - above) - t[l]).abs().max(floor);
                    let weight = if power2 { 1.0 / (r * r) } else { 1.0 / r };
                    su[l] += weight * u;
                    sv[l] += weight * v;
                    sw[l] += weight;
                }
            }
        }
        let (u, v) = out.split_at_mut(w);
        for x in 0..w {
            u[x] = su[x] / sw[x];
            v[x] = sv[x] / sw[x];
        }
    });
    uv
}

/// `K` rows of `w` values each.
#[inline(always)]
fn split<const K: usize>(row: &[f32], w: usize) -> [&[f32]; K] {
    std::array::from_fn(|k| &row[k * w..][..w])
}

/// `K` rows of `w` values each.
#[inline(always)]
fn split_mut<const K: usize>(row: &mut [f32], w: usize) -> [&mut [f32]; K] {
    let mut rows = row.chunks_exact_mut(w);
    std::array::from_fn(|_| rows.next().unwrap_or_default())
}

/// Calls `f(y, row)` like [`par::for_each_row`], but shares out several rows at a time.
fn bands(data: &mut [f32], stride: usize, f: impl Fn(usize, &mut [f32]) + Sync + Send) {
    let rows = (BAND / stride.max(1)).max(1);
    par::for_each_row(data, stride * rows, |b, band| {
        for (r, row) in band.chunks_mut(stride).enumerate() {
            f(b * rows + r, row);
        }
    });
}
const BAND: usize = 1 << 15;

/// Every second value of `row`, from `parity` on.
#[inline(always)]
fn every_second(row: &[f32], parity: usize, out: &mut [f32]) {
    let n = row.len() / 2;
    for (o, pair) in out[..n].iter_mut().zip(row.chunks_exact(2)) {
        *o = pair[parity];
    }
    if row.len() % 2 == 1 && parity == 0 {
        out[n] = row[row.len() - 1];
    }
}

/// The variational refinement and its buffers.
#[derive(Default)]
struct Solver {
    /// Per row: mean of the images, and their difference; 2 px repeated at both ends.
    warped: Vec<f32>,
    /// Per row: the linearised constancy terms.
    terms: Vec<f32>,
    /// Per row: smoothness weight.
    smooth: Vec<f32>,
    /// Per colour and row: u, v.
    unknown: [Vec<f32>; 2],
    /// Per row and colour: smoothness weight.
    weight: Vec<f32>,
    /// Per row and colour: inverse of the 2x2 system, right-hand side.
    system: Vec<f32>,
}

const TERMS: usize = 8;

impl Solver {
    fn refine(&mut self, from: &Padded, to: &Padded, uv: &mut [f32], fixed: usize, sweeps: usize) {
        let (w, h) = (from.w, from.h);
        let alpha = tune("ALPHA", 4.0);
        let omega = tune("OMEGA", 1.6);
        let k = Knobs::new();
        let pw = w + 4;
        let hw = w / 2 + 2;
        let Self { warped, terms, smooth, unknown, weight, system } = self;
        warped.resize(2 * pw * h, 0.0);
        terms.resize(TERMS * w * h, 0.0);
        smooth.resize(w * h, 0.0);
        weight.resize(2 * hw * (h + 2), 0.0);
        system.resize(10 * hw * h, 0.0);
        for unknown in &mut *unknown {
            unknown.resize(2 * hw * (h + 2), 0.0);
        }
        bands(warped, 2 * pw, |y, out| warp_row(from, to, &uv[2 * w * y..][..2 * w], y, out));
        bands(terms, TERMS * w, |y, out| terms_row(&k, warped, uv, w, h, y, out));
        for (c, unknown) in unknown.iter_mut().enumerate() {
            bands(&mut unknown[2 * hw..][..2 * hw * h], 2 * hw, |y, out| {
                let [u, v] = split_mut(out, hw);
                let row = &uv[2 * w * y..][..2 * w];
                every_second(&row[..w], (y + c) % 2, &mut u[1..]);
                every_second(&row[w..], (y + c) % 2, &mut v[1..]);
            });
        }
        for _ in 0..fixed {
            bands(smooth, w, |y, out| smoothness_row(uv, w, h, y, alpha, out));
            bands(weight, 2 * hw, |y, out| weight_row(smooth, w, h, y, out));
            bands(system, 10 * hw, |y, out| system_row(&k, terms, smooth, uv, w, h, y, out));
            for _ in 0..sweeps {
                for c in 0..2 {
                    sweep(unknown, weight, system, c, w, h, omega);
                }
            }
            bands(uv, 2 * w, |y, out| {
                for c in 0..2 {
                    let parity = (y + c) % 2;
                    let [u, v] = split(&unknown[c][2 * hw * (y + 1)..], hw);
                    let [ou, ov] = split_mut(out, w);
                    for (out, src) in [(ou, u), (ov, v)] {
                        for (o, s) in out[parity.min(w)..].chunks_mut(2).zip(&src[1..]) {
                            o[0] = *s;
                        }
                    }
                }
            });
        }
    }
}

struct Knobs { zeta: f32, delta: f32, gamma: f32 }
impl Knobs { fn new() -> Self { Self { zeta: tune("ZETA", 0.01), delta: tune("DELTA", 1.0), gamma: tune("GAMMA", 2.0) } } }

#[inline(never)]
fn warp_row(from: &Padded, to: &Padded, uv: &[f32], y: usize, out: &mut [f32]) {
    let w = from.w;
    let [mean, diff] = split_mut(out, w + 4);
    let [u, v] = split(uv, w);
    let a = from.row(y);
    let (p, xmax, ymax) = (PAD as f32, (to.stride - 2) as f32, (to.data.len() / to.stride - 2) as f32);
    for x in 0..w {
        let fx = (x as f32 + u[x] + p).max(0.0).min(xmax);
        let fy = (y as f32 + v[x] + p).max(0.0).min(ymax);
        let (xi, yi) = (fx as i32, fy as i32);
        let (fx, fy) = (fx - xi as f32, fy - yi as f32);
        let at = yi as usize * to.stride + xi as usize;
        let (r, s) = (&to.data[at..][..2], &to.data[at + to.stride..][..2]);
        let above = r[0] + fx * (r[1] - r[0]);
        let below = s[0] + fx * (s[1] - s[0]);
        let b = above + fy * (below - above);
        mean[x + 2] = 0.5 * (a[x] + b);
        diff[x + 2] = b - a[x];
    }
    for row in [mean, diff] {
        let (first, last) = (row[2], row[w + 1]);
        row[..2].fill(first);
        row[w + 2..].fill(last);
    }
}

#[inline(never)]
fn terms_row(k: &Knobs, warped: &[f32], uv: &[f32], w: usize, h: usize, y: usize, out: &mut [f32]) {
    let (zeta, zeta_g) = (k.zeta * k.zeta, k.zeta * k.zeta);
    let pw = w + 4;
    let row = |dy: isize| split::<2>(&warped[2 * pw * (y as isize + dy).clamp(0, h as isize - 1) as usize..], pw);
    let ([m, d], [m1, d1], [m2, d2], [mm1, _], [mm2, _]) = (row(0), row(-1), row(1), row(-2), row(2));
    let [u, v] = split(&uv[2 * w * y..], w);
    let [ix, iy, it, ixx, ixy, iyy, ixt, iyt] = split_mut(out, w);
    let (wm, hm) = ((w - 1) as f32, (h - 1) as f32);
    for x in 0..w {
        let dx = 0.5 * (m[x + 3] - m[x + 1]);
        let dy = 0.5 * (m2[x + 2] - m1[x + 2]);
        let dxx = 0.25 * (m[x + 4] - 2.0 * m[x + 2] + m[x]);
        let dyy = 0.25 * (mm2[x + 2] - 2.0 * m[x + 2] + mm1[x + 2]);
        let dxy = 0.25 * (m2[x + 3] - m2[x + 1] - m1[x + 3] + m1[x + 1]);
        let dt = d[x + 2];
        let dxt = 0.5 * (d[x + 3] - d[x + 1]);
        let dyt = 0.5 * (d2[x + 2] - d1[x + 2]);
        let (tx, ty) = (x as i32 as f32 + u[x], y as f32 + v[x]);
        let inside = if (tx >= 0.0) & (tx <= wm) & (ty >= 0.0) & (ty <= hm) { 1.0 } else { 0.0 };
        let s = inside / (dx * dx + dy * dy + zeta).sqrt();
        let g = inside / (dxx * dxx + 2.0 * dxy * dxy + dyy * dyy + zeta_g).sqrt();
        ix[x] = s * dx;
        iy[x] = s * dy;
        it[x] = s * (dt - dx * u[x] - dy * v[x]);
        ixx[x] = g * dxx;
        ixy[x] = g * dxy;
        iyy[x] = g * dyy;
        ixt[x] = g * (dxt - dxx * u[x] - dxy * v[x]);
        iyt[x] = g * (dyt - dxy * u[x] - dyy * v[x]);
    }
}
const EPS_D: f32 = 0.03 * 0.03;
const EPS_S: f32 = 0.01 * 0.01;

#[inline(never)]
fn smoothness_row(uv: &[f32], w: usize, h: usize, y: usize, alpha: f32, out: &mut [f32]) {
    let row = |y: usize| split::<2>(&uv[2 * w * y..], w);
    let [u, v] = row(y);
    let [ua, va] = row(y.saturating_sub(1));
    let [ub, vb] = row((y + 1).min(h - 1));
    let out = &mut out[..w];
    let sq = |a: f32| a * a;
    for x in 0..w {
        out[x] = sq(u[x] - ua[x]) + sq(ub[x] - u[x]) + sq(v[x] - va[x]) + sq(vb[x] - v[x]);
    }
    for x in 1..w {
        let right = sq(u[x] - u[x - 1]) + sq(v[x] - v[x - 1]);
        out[x - 1] += right;
        out[x] += right;
    }
    for o in out {
        *o = alpha / (0.5 * *o + EPS_S).sqrt();
    }
}

#[inline(never)]
fn weight_row(smooth: &[f32], w: usize, h: usize, y: usize, out: &mut [f32]) {
    let colours: [&mut [f32]; 2] = split_mut(out, w / 2 + 2);
    let inside = (1..=h).contains(&y);
    let row = &smooth[w * y.clamp(1, h).saturating_sub(1)..][..w];
    for (c, out) in colours.into_iter().enumerate() {
        // The row above the first.
        let parity = (y + 1 + c) % 2;
        every_second(row, parity, &mut out[1..]);
        if inside {
            // The pixel at -1 is of this colour if parity is 1; the one at w if w has it.
            if parity == 1 {
                out[0] = -row[0];
            }
            if w % 2 == parity {
                out[1 + w / 2] = -row[w - 1];
            }
        } else {
            // A weight of minus the neighbour's makes the edge between them 0.
            out.iter_mut().for_each(|o| *o = -*o);
        }
    }
}

#[inline(never)]
fn system_row(k: &Knobs, terms: &[f32], smooth: &[f32], uv: &[f32], w: usize, h: usize, y: usize, out: &mut [f32]) {
    let (delta, gamma) = (k.delta, k.gamma);
    let eps_d = EPS_D;
    let hw = w / 2 + 2;
    let [u, v] = split(&uv[2 * w * y..], w);
    let row = |y: usize| &smooth[w * y..][..w];
    let (s, sa, sb) = (row(y), row(y.saturating_sub(1)), row((y + 1).min(h - 1)));
    let (top, bottom) = (if y > 0 { 0.5 } else { 0.0 }, if y + 1 < h { 0.5 } else { 0.0 });
    let [ix, iy, it, ixx, ixy, iyy, ixt, iyt] = split(&terms[TERMS * w * y..], w);
    let mut natural = vec![0.0f32; 5 * w];
    let [m11, m12, m22, b1, b2] = split_mut(&mut natural, w);
    // m11 holds the sum of the weights first.
    for x in 1..w.max(1) - 1 {
        m11[x] = s[x] + 0.5 * (s[x - 1] + s[x + 1]);
    }
    if w > 1 {
        m11[0] = 0.5 * (s[0] + s[1]);
        m11[w - 1] = 0.5 * (s[w - 2] + s[w - 1]);
    }
    for x in 0..w {
        let (u, v) = (u[x], v[x]);
        let (ix, iy, it) = (ix[x], iy[x], it[x]);
        let (ixx, ixy, iyy, ixt, iyt) = (ixx[x], ixy[x], iyy[x], ixt[x], iyt[x]);
        let r = it + ix * u + iy * v;
        let p = delta / (r * r + eps_d).sqrt();
        let (rx, ry) = (ixt + ixx * u + ixy * v, iyt + ixy * u + iyy * v);
        let q = gamma / (rx * rx + ry * ry + eps_d).sqrt();
        let sum = m11[x] + top * (s[x] + sa[x]) + bottom * (s[x] + sb[x]);
        let a11 = p * ix * ix + q * (ixx * ixx + ixy * ixy) + sum;
        let a12 = p * ix * iy + q * (ixx * ixy + ixy * iyy);
        let a22 = p * iy * iy + q * (ixy * ixy + iyy * iyy) + sum;
        let det = 1.0 / (a11 * a22 - a12 * a12 + 1e-20);
        m11[x] = a22 * det;
        m12[x] = -a12 * det;
        m22[x] = a11 * det;
        b1[x] = -(p * ix * it + q * (ixx * ixt + ixy * iyt));
        b2[x] = -(p * iy * it + q * (ixy * ixt + iyy * iyt));
    }
    for (c, out) in out.chunks_mut(5 * hw).enumerate() {
        for (row, out) in natural.chunks(w).zip(out.chunks_mut(hw)) {
            every_second(row, (y + c) % 2, out);
        }
    }
}

/// Successive over-relaxation of the pixels of one colour of the checkerboard.
fn sweep(unknown: &mut [Vec<f32>; 2], weight: &[f32], system: &[f32], c: usize, w: usize, h: usize, omega: f32) {
    let hw = w / 2 + 2;
    let [red, black] = unknown;
    let (this, other) = if c == 0 { (red, &*black) } else { (black, &*red) };
    bands(&mut this[2 * hw..][..2 * hw * h], 2 * hw, |y, out| sweep_row(other, weight, system, c, w, omega, y, out));
}

#[inline(never)]
fn sweep_row(other: &[f32], weight: &[f32], system: &[f32], c: usize, w: usize, omega: f32, y: usize, out: &mut [f32]) {
    let hw = w / 2 + 2;
    let parity = (y + c) % 2;
    let n = (w + 1 - parity) / 2;
    let (u, v) = out.split_at_mut(hw);
    let (u, v) = (&mut u[1..][..n], &mut v[1..][..n]);
    let line = |k: usize, x: usize| {
        let (u, v) = other[2 * hw * k..][..2 * hw].split_at(hw);
        (&u[x..][..n], &v[x..][..n], &weight[2 * hw * k + (1 - c) * hw..][x..][..n])
    };
    let (ua, va, wa) = line(y, 1);
    let (ub, vb, wb) = line(y + 2, 1);
    let (ul, vl, wl) = line(y + 1, parity);
    let (ur, vr, wr) = line(y + 1, parity + 1);
    let wc = &weight[2 * hw * (y + 1) + c * hw..][1..][..n];
    let [m11, m12, m22, b1, b2] = split(&system[10 * hw * y + 5 * hw * c..], hw);
    let (m11, m12, m22, b1, b2) = (&m11[..n], &m12[..n], &m22[..n], &b1[..n], &b2[..n]);
    for i in 0..n {
        let (a, b, l, r) = (wc[i] + wa[i], wc[i] + wb[i], wc[i] + wl[i], wc[i] + wr[i]);
        let p = b1[i] + 0.5 * (a * ua[i] + b * ub[i] + l * ul[i] + r * ur[i]);
        let q = b2[i] + 0.5 * (a * va[i] + b * vb[i] + l * vl[i] + r * vr[i]);
        u[i] += omega * (m11[i] * p + m12[i] * q - u[i]);
        v[i] += omega * (m12[i] * p + m22[i] * q - v[i]);
    }
}
