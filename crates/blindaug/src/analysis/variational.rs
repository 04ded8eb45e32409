//! Variational refinement of optical flow (Brox et al., "High Accuracy Optical Flow Estimation Based on a Theory for
//! Warping", ECCV 2004, with the normalised terms of Zimmer et al. 2011), as dense inverse search uses it at each scale.
//!
//! Minimises the sum over the pixels of
//! `DATA psi(brightness change) + GRADIENT psi(gradient change) + SMOOTHNESS g(image gradient) psi(flow gradient)`,
//! psi(s) = sqrt(s^2 + eps^2): the changes are linearised at the current flow and divided by the image's gradient, so
//! that they are in px. The weights psi' are fixed, the remaining linear system is relaxed for a few sweeps, and both steps repeat.

use super::padded::{Padded, split, split_mut};
use crate::par;

/// The weight of brightness constancy.
const DATA: f32 = 1.0;
/// The weight of gradient constancy.
const GRADIENT: f32 = 2.0;
/// The weight of smoothness.
const SMOOTHNESS: f32 = 4.0;
/// The eps of the data terms, px.
const DATA_EPS: f32 = 0.03;
/// The eps of the flow's gradient, px per px.
const SMOOTHNESS_EPS: f32 = 0.01;
/// The gradient, per px of an image in [0, 1], below which noise dominates; it limits the division by the gradient.
const FAINT: f32 = 0.01;
/// The gradient, per px of an image in [0, 1], at which smoothness counts about half, since the flow may have an edge there.
const EDGE: f32 = 1.0 / 15.0;
/// The number of times that the images are warped and their changes linearised.
const WARPS: usize = 2;
/// The number of updates of the weights after each warp.
const UPDATES: usize = 2;
/// The number of sweeps of the solver after each update.
const SWEEPS: usize = 4;
/// The factor of over-relaxation.
const OMEGA: f32 = 1.8;
/// The number of planes of `Refiner::terms`.
const TERMS: usize = 8;

/// The buffers of the refinement. A row of a buffer holds that row of several planes, one after another.
///
/// The unknowns are split into the two colours of a checkerboard, so that all pixels of a colour can be updated at once: pixel x of
/// row y has colour (x + y) % 2 and index 1 + x / 2 in a row of `half(w)` values. A border of one pixel surrounds the image.
#[derive(Default)]
pub(super) struct Refiner {
    /// The mean of the image and the warped image, and their difference; rows have two more pixels on both sides.
    warped: Vec<f32>,
    /// The linearised changes as functions of (u, v): Ix, Iy, It; Ixx, Ixy, Iyy, Ixt, Iyt.
    terms: Vec<f32>,
    /// The smoothness weight of each pixel; the edge between two pixels has the mean of their weights.
    smoothness: Vec<f32>,
    /// The smoothness weights, split into both colours.
    edges: Vec<f32>,
    /// The linear system of both colours: the inverse of the 2 x 2 matrix (xx, xy, yy) and the right-hand side (x, y).
    system: Vec<f32>,
    /// The unknowns u and v of each colour.
    unknown: [Vec<f32>; 2],
}

/// The number of values of one colour in a row of `w` pixels, with the border.
fn half(w: usize) -> usize {
    w / 2 + 2
}

impl Refiner {
    /// Makes room for images up to `w` x `h` pixels.
    pub fn fit(&mut self, w: usize, h: usize) {
        let around = half(w) * (h + 2);
        self.warped.resize(2 * (w + 4) * h, 0.0);
        self.terms.resize(TERMS * w * h, 0.0);
        self.smoothness.resize(w * h, 0.0);
        self.edges.resize(2 * around, 0.0);
        self.system.resize(10 * half(w) * h, 0.0);
        for unknown in &mut self.unknown {
            // The values of the border have no weight, but must be numbers.
            unknown.resize(2 * around, 0.0);
        }
    }

    /// Improves the flow `uv` (rows of u, then v).
    pub fn refine(&mut self, from: &Padded, to: &Padded, uv: &mut [f32]) {
        let (w, h, n) = (from.w, from.h, half(from.w));
        let warped = &mut self.warped[..2 * (w + 4) * h];
        let terms = &mut self.terms[..TERMS * w * h];
        let smoothness = &mut self.smoothness[..w * h];
        let edges = &mut self.edges[..2 * n * (h + 2)];
        let system = &mut self.system[..10 * n * h];
        let unknown = &mut self.unknown;
        for _ in 0..WARPS {
            for_each_row(warped, 2 * (w + 4), |y, out| warp(from, to, uv, y, out));
            for_each_row(terms, TERMS * w, |y, out| linearise(warped, uv, (w, h), y, out));
            for (c, unknown) in unknown.iter_mut().enumerate() {
                for_each_row(&mut unknown[2 * n..][..2 * n * h], 2 * n, |y, out| {
                    let rows: [&[f32]; 2] = split(&uv[2 * w * y..], w);
                    for (row, out) in rows.into_iter().zip(out.chunks_exact_mut(n)) {
                        every_second(row, (y + c) % 2, &mut out[1..]);
                    }
                });
            }
            for _ in 0..UPDATES {
                for_each_row(smoothness, w, |y, out| smoothness_weights(from, uv, y, out));
                for_each_row(edges, 2 * n, |y, out| edge_weights(smoothness, (w, h), y, out));
                for_each_row(system, 10 * n, |y, out| {
                    normal_equations(terms, smoothness, uv, (w, h), y, out)
                });
                for sweep in 0..2 * SWEEPS {
                    let c = sweep % 2;
                    let [red, black] = &mut *unknown;
                    let (this, other) = if c == 0 { (red, &*black) } else { (black, &*red) };
                    for_each_row(&mut this[2 * n..][..2 * n * h], 2 * n, |y, out| {
                        relax(other, edges, &system[10 * n * y..], c, w, y, out);
                    });
                }
                for_each_row(uv, 2 * w, |y, out| {
                    for (c, unknown) in unknown.iter().enumerate() {
                        let rows = unknown[2 * n * (y + 1)..].chunks_exact(n);
                        for (out, row) in out.chunks_exact_mut(w).zip(rows) {
                            for (o, v) in out.iter_mut().skip((y + c) % 2).step_by(2).zip(&row[1..]) {
                                *o = *v;
                            }
                        }
                    }
                });
            }
        }
    }
}

/// [`par::for_each_row`] with several rows per task, since most rows here are computed too quickly to be a task of their own.
fn for_each_row(data: &mut [f32], stride: usize, f: impl Fn(usize, &mut [f32]) + Sync + Send) {
    let rows = ((1 << 15) / stride.max(1)).max(1);
    par::for_each_row(data, stride * rows, |band, data| {
        for (r, row) in data.chunks_mut(stride).enumerate() {
            f(band * rows + r, row);
        }
    });
}

/// Copies every second value of `row`, from index `parity` on, to `out`.
#[inline(always)]
fn every_second(row: &[f32], parity: usize, out: &mut [f32]) {
    let pairs = row.len() / 2;
    for (o, pair) in out.iter_mut().zip(row.chunks_exact(2)) {
        *o = pair[parity];
    }
    if row.len() % 2 == 1 && parity == 0 {
        out[pairs] = row[row.len() - 1];
    }
}

fn warp(from: &Padded, to: &Padded, uv: &[f32], y: usize, out: &mut [f32]) {
    let w = from.w;
    let [u, v] = split(&uv[2 * w * y..], w);
    let a = from.row(y as isize, 0);
    let [mean, change] = split_mut(out, w + 4);
    for x in 0..w {
        let (xi, yi, fx, fy) = to.place(x as f32 + u[x], y as f32 + v[x], 1);
        let at = yi * to.stride + xi;
        let (above, below) = (&to.data[at..][..2], &to.data[at + to.stride..][..2]);
        let above = above[0] + fx * (above[1] - above[0]);
        let below = below[0] + fx * (below[1] - below[0]);
        let b = above + fy * (below - above);
        mean[x + 2] = 0.5 * (a[x] + b);
        change[x + 2] = b - a[x];
    }
    for row in [mean, change] {
        let (first, last) = (row[2], row[w + 1]);
        row[..2].fill(first);
        row[w + 2..].fill(last);
    }
}

fn linearise(warped: &[f32], uv: &[f32], (w, h): (usize, usize), y: usize, out: &mut [f32]) {
    let rows = |dy: isize| {
        let y = (y as isize + dy).clamp(0, h as isize - 1) as usize;
        split::<2>(&warped[2 * (w + 4) * y..], w + 4)
    };
    let ([m0, _], [m1, d1], [m2, d2], [m3, d3], [m4, _]) = (rows(-2), rows(-1), rows(0), rows(1), rows(2));
    let [u, v] = split(&uv[2 * w * y..], w);
    let [ix, iy, it, ixx, ixy, iyy, ixt, iyt] = split_mut(out, w);
    let (right, bottom) = ((w - 1) as f32, (h - 1) as f32);
    for x in 0..w {
        let dx = 0.5 * (m2[x + 3] - m2[x + 1]);
        let dy = 0.5 * (m3[x + 2] - m1[x + 2]);
        let dt = d2[x + 2];
        // Second derivatives are central differences of central differences, which are wide and so less noisy.
        let dxx = 0.25 * (m2[x + 4] - 2.0 * m2[x + 2] + m2[x]);
        let dyy = 0.25 * (m4[x + 2] - 2.0 * m2[x + 2] + m0[x + 2]);
        let dxy = 0.25 * (m3[x + 3] - m3[x + 1] - m1[x + 3] + m1[x + 1]);
        let dxt = 0.5 * (d2[x + 3] - d2[x + 1]);
        let dyt = 0.5 * (d3[x + 2] - d1[x + 2]);
        // A pixel whose target lies outside the frame has no data term.
        let (tx, ty) = (x as i32 as f32 + u[x], y as f32 + v[x]);
        let seen = if (tx >= 0.0) & (tx <= right) & (ty >= 0.0) & (ty <= bottom) { 1.0 } else { 0.0 };
        let k = seen / (dx * dx + dy * dy + FAINT * FAINT).sqrt();
        ix[x] = k * dx;
        iy[x] = k * dy;
        it[x] = k * (dt - dx * u[x] - dy * v[x]);
        let k = seen / (dxx * dxx + 2.0 * dxy * dxy + dyy * dyy + FAINT * FAINT).sqrt();
        ixx[x] = k * dxx;
        ixy[x] = k * dxy;
        iyy[x] = k * dyy;
        ixt[x] = k * (dxt - dxx * u[x] - dxy * v[x]);
        iyt[x] = k * (dyt - dxy * u[x] - dyy * v[x]);
    }
}

fn smoothness_weights(from: &Padded, uv: &[f32], y: usize, out: &mut [f32]) {
    let (w, h) = (from.w, from.h);
    let rows = |y: usize| split::<2>(&uv[2 * w * y..], w);
    let ([ua, va], [u, v], [ub, vb]) = (rows(y.saturating_sub(1)), rows(y), rows((y + 1).min(h - 1)));
    let square = |a: f32| a * a;
    for x in 0..w {
        out[x] = square(u[x] - ua[x]) + square(ub[x] - u[x]) + square(v[x] - va[x]) + square(vb[x] - v[x]);
    }
    let out = &mut out[..w];
    for x in 0..w - 1 {
        out[x] += square(u[x + 1] - u[x]) + square(v[x + 1] - v[x]);
    }
    for x in 1..w {
        out[x] += square(u[x] - u[x - 1]) + square(v[x] - v[x - 1]);
    }
    let y = y as isize;
    let (above, here, below) = (from.row(y - 1, 0), from.row(y, 1), from.row(y + 1, 0));
    for x in 0..w {
        let gradient = 0.25 * (square(here[x + 2] - here[x]) + square(below[x] - above[x]));
        let edge = 0.02 + 1.0 / (1.0 + gradient / (EDGE * EDGE));
        out[x] = SMOOTHNESS * edge / (0.5 * out[x] + SMOOTHNESS_EPS * SMOOTHNESS_EPS).sqrt();
    }
}

/// Splits the smoothness weights of row `y` - 1 of the image into both colours, with the border.
fn edge_weights(smoothness: &[f32], (w, h): (usize, usize), y: usize, out: &mut [f32]) {
    let row = &smoothness[w * y.clamp(1, h).saturating_sub(1)..][..w];
    for (c, out) in out.chunks_exact_mut(half(w)).enumerate() {
        let parity = (y + 1 + c) % 2;
        every_second(row, parity, &mut out[1..]);
        // A pixel of the border gets minus its neighbour's weight, so that the edge between the two has weight 0.
        if !(1..=h).contains(&y) {
            out.iter_mut().for_each(|o| *o = -*o);
        } else {
            if parity == 1 {
                out[0] = -row[0];
            }
            if parity == w % 2 {
                out[1 + w / 2] = -row[w - 1];
            }
        }
    }
}

fn normal_equations(
    terms: &[f32],
    smoothness: &[f32],
    uv: &[f32],
    (w, h): (usize, usize),
    y: usize,
    out: &mut [f32],
) {
    let [u, v] = split(&uv[2 * w * y..], w);
    let [ix, iy, it, ixx, ixy, iyy, ixt, iyt] = split(&terms[TERMS * w * y..], w);
    let row = |y: usize| &smoothness[w * y..][..w];
    let (sa, s, sb) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(h - 1)));
    let (above, below) = (if y > 0 { 0.5 } else { 0.0 }, if y + 1 < h { 0.5 } else { 0.0 });
    let mut rows = vec![0.0f32; 5 * w];
    let [m11, m12, m22, b1, b2] = split_mut(&mut rows, w);
    // `m11` first holds the weight of the edges to the left and right.
    for x in 0..w - 1 {
        m11[x] = 0.5 * (s[x] + s[x + 1]);
    }
    for x in 1..w {
        m11[x] += 0.5 * (s[x - 1] + s[x]);
    }
    for x in 0..w {
        let (u, v) = (u[x], v[x]);
        let (ix, iy, it, ixx, ixy, iyy, ixt, iyt) =
            (ix[x], iy[x], it[x], ixx[x], ixy[x], iyy[x], ixt[x], iyt[x]);
        let r = it + ix * u + iy * v;
        let (rx, ry) = (ixt + ixx * u + ixy * v, iyt + ixy * u + iyy * v);
        let p = DATA / (r * r + DATA_EPS * DATA_EPS).sqrt();
        let q = GRADIENT / (rx * rx + ry * ry + DATA_EPS * DATA_EPS).sqrt();
        let edges = m11[x] + above * (s[x] + sa[x]) + below * (s[x] + sb[x]);
        // The last term is for an image of one pixel, which has neither gradient nor neighbours.
        let a11 = p * ix * ix + q * (ixx * ixx + ixy * ixy) + edges + 1e-6;
        let a12 = p * ix * iy + q * (ixx * ixy + ixy * iyy);
        let a22 = p * iy * iy + q * (ixy * ixy + iyy * iyy) + edges + 1e-6;
        let det = 1.0 / (a11 * a22 - a12 * a12);
        m11[x] = a22 * det;
        m12[x] = -a12 * det;
        m22[x] = a11 * det;
        b1[x] = -p * ix * it - q * (ixx * ixt + ixy * iyt);
        b2[x] = -p * iy * it - q * (ixy * ixt + iyy * iyt);
    }
    for (c, out) in out.chunks_exact_mut(5 * half(w)).enumerate() {
        for (row, out) in rows.chunks_exact(w).zip(out.chunks_exact_mut(half(w))) {
            every_second(row, (y + c) % 2, out);
        }
    }
}

/// One step of successive over-relaxation for the pixels of colour `c` in row `y`.
fn relax(other: &[f32], edges: &[f32], system: &[f32], c: usize, w: usize, y: usize, out: &mut [f32]) {
    let n = half(w);
    let parity = (y + c) % 2;
    let count = (w + 1 - parity) / 2;
    let [u, v] = split_mut(out, n);
    let (u, v) = (&mut u[1..][..count], &mut v[1..][..count]);
    // The neighbours in row `y` of the buffers, which is row `y` - 1 of the image, from an index on.
    let neighbours = |y: usize, from: usize| {
        let [u, v] = split(&other[2 * n * y..], n);
        (&u[from..][..count], &v[from..][..count], &edges[2 * n * y + n * (1 - c) + from..][..count])
    };
    let (ua, va, sa) = neighbours(y, 1);
    let (ub, vb, sb) = neighbours(y + 2, 1);
    let (ul, vl, sl) = neighbours(y + 1, parity);
    let (ur, vr, sr) = neighbours(y + 1, parity + 1);
    let s = &edges[2 * n * (y + 1) + n * c + 1..][..count];
    let [m11, m12, m22, b1, b2] = split::<5>(&system[5 * n * c..], n).map(|row| &row[..count]);
    for i in 0..count {
        let (a, b, l, r) = (s[i] + sa[i], s[i] + sb[i], s[i] + sl[i], s[i] + sr[i]);
        let p = b1[i] + 0.5 * (a * ua[i] + b * ub[i] + l * ul[i] + r * ur[i]);
        let q = b2[i] + 0.5 * (a * va[i] + b * vb[i] + l * vl[i] + r * vr[i]);
        u[i] += OMEGA * (m11[i] * p + m12[i] * q - u[i]);
        v[i] += OMEGA * (m12[i] * p + m22[i] * q - v[i]);
    }
}
