//! Dense optical flow, from coarse to fine: at each scale dense inverse search (Kroeger et al., "Fast Optical Flow using
//! Dense Inverse Search", ECCV 2016), then variational refinement; occlusion by the
//! forward-backward check. If the brightness changes from one image to the other, the change is undone and the flow found once more.
//!
//! The constants were chosen on rendered clips, with and without noise (std 0.02 to 0.05), motion blur and defocus; the
//! result depends little on any of them.

use super::brightness::{brightening, undone};
use super::padded::{PAD, PATCH, Padded, split_mut};
use super::variational::Refiner;
use crate::{Error, Flow, Plane, Raster, Result, filter, par, pyramid};

/// Distance between patches, px.
const STRIDE: usize = 4;
/// The most Gauss-Newton steps of a patch.
const STEPS: usize = 6;
/// The distance, in px, at which the flow to each side is another start of a patch: it may be the motion beyond an edge.
const REACH: usize = 10;
/// The weight of staying near the start, in units of the Hessian of an image in [0, 1], so that flat patches stay where they are.
const PRIOR: f32 = 1e-4;
/// The finest level of the pyramid in which patches are searched; noise would dominate in patches of full resolution.
const FINEST_SEARCHED: usize = 1;
/// The largest length, in px, of the longer side of the coarsest image: a motion by a quarter of that image is about half a patch.
const COARSEST: usize = 24;
/// The std, in px, of the Gaussian that reduces noise and aliasing.
const SMOOTHING: f32 = 0.7;
/// The most pixels of an image for which the forward and backward flow are found at the same time: the rows of a small image are too few
/// to be shared among threads, and two sets of its buffers need little memory.
const SOLVED_AT_ONCE: usize = 1 << 17;
/// The most bytes that [`FlowEstimator`] takes for each pixel of a frame, beside the two images; measured, approximate.
pub const BYTES_PER_PIXEL: u64 = 140;

/// The flow between two images in both directions, with the pixels and differences that contradict the flow.
#[derive(Clone, Debug)]
pub struct FlowPair {
    /// Displacement of each pixel of `a` to its place in `b`, px.
    pub forward: Flow,
    /// Displacement of each pixel of `b` to its place in `a`, px.
    pub backward: Flow,
    /// Whether each pixel of `a` is not seen in `b` (out of frame, or behind something), or its two flows contradict each other.
    pub occluded: Raster<bool>,
    /// The difference that the flow does not explain: `|b(x + forward) - a(x)|` of the images as given; NaN if the target is out of frame.
    pub residual: Plane,
}

impl FlowPair {
    /// The share of the pixels of `a` whose match in `b` was confirmed, in [0, 1].
    ///
    /// The share is mostly over 0.8 within a shot. Across a cut it is less than half, and nothing in such a pair should be relied on.
    pub fn confirmed(&self) -> f32 {
        let occluded = self.occluded.data().iter().filter(|&&o| o).count();
        1.0 - occluded as f32 / self.occluded.data().len().max(1) as f32
    }
}

/// The displacement of each pixel of `from` to its place in `to`: px, x right, y down.
///
/// The images are luma in [0, 1], display-encoded; values that are not finite count as 0. Motions up to about a quarter of the width
/// are found if the moving object is large enough to be seen in the pyramid; a small object is followed over about its own size. The
/// flow is dense: the flow of the surroundings continues over hidden pixels, for which see [`flow_with_occlusion`].
///
/// # Errors
/// If the images have no pixels, or differ in size.
pub fn flow(from: &Plane, to: &Plane) -> Result<Flow> {
    FlowEstimator::new().flow(from, to)
}

/// The flow from `a` to `b` and back, and the pixels of `a` at which the two flows do not agree ([`inconsistent`]).
///
/// # Errors
/// If the images have no pixels, or differ in size.
pub fn flow_with_occlusion(a: &Plane, b: &Plane) -> Result<FlowPair> {
    FlowEstimator::new().flow_with_occlusion(a, b)
}

/// The flow of one pair of frames after another, in the same buffers: about a third faster than [`flow`], which allocates fresh memory
/// each time. The result does not depend on earlier pairs.
#[derive(Default)]
pub struct FlowEstimator {
    refiner: Refiner,
    /// The refiner of the backward flow of small images, which is found at the same time as the forward flow.
    second: Refiner,
}

impl FlowEstimator {
    /// An estimator that holds no buffers yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same as [`flow`].
    ///
    /// # Errors
    /// The same as [`flow`].
    pub fn flow(&mut self, from: &Plane, to: &Plane) -> Result<Flow> {
        check(from.size(), to.size())?;
        Ok(par::within(|| solve_alike(&mut self.refiner, (from, &pyramid_of(from)), (to, &pyramid_of(to)))))
    }

    /// The same as [`flow_with_occlusion`].
    ///
    /// # Errors
    /// The same as [`flow_with_occlusion`].
    pub fn flow_with_occlusion(&mut self, a: &Plane, b: &Plane) -> Result<FlowPair> {
        check(a.size(), b.size())?;
        Ok(par::within(|| {
            let (pa, pb) = (pyramid_of(a), pyramid_of(b));
            let (first, second) = ((a, pa.as_slice()), (b, pb.as_slice()));
            let (forward, backward) = if a.data().len() <= SOLVED_AT_ONCE {
                let Self { refiner, second: other } = self;
                par::both(|| solve_alike(refiner, first, second), || solve_alike(other, second, first))
            } else {
                let refiner = &mut self.refiner;
                (solve_alike(refiner, first, second), solve_alike(refiner, second, first))
            };
            let occluded = inconsistent(&forward, &backward);
            let residual = Plane::from_fn(a.width(), a.height(), |x, y| {
                let f = forward.at(x, y);
                let (tx, ty) = (x as f32 + f[0], y as f32 + f[1]);
                if inside(tx, ty, a.size()) { (b.bilinear(tx, ty) - a.at(x, y)).abs() } else { f32::NAN }
            });
            FlowPair { forward, backward, occluded, residual }
        }))
    }
}

/// Whether each pixel leaves the frame, or its way there and back does not end where the way began:
/// `|F + B(x + F)|^2 > 0.01 (|F|^2 + |B|^2) + 0.5` (Sundaram et al., ECCV 2010). A flow that is not finite is inconsistent.
///
/// The flows must have one size.
pub fn inconsistent(forward: &Flow, backward: &Flow) -> Raster<bool> {
    Raster::from_fn(forward.width(), forward.height(), |x, y| {
        let f = forward.at(x, y);
        let (tx, ty) = (x as f32 + f[0], y as f32 + f[1]);
        if !inside(tx, ty, backward.size()) {
            return true;
        }
        let b = backward.bilinear(tx, ty);
        let square = |v: [f32; 2]| v[0] * v[0] + v[1] * v[1];
        let gap = square([f[0] + b[0], f[1] + b[1]]);
        gap.is_nan() || gap > 0.01 * (square(f) + square(b)) + 0.5
    })
}

/// The motion at a frame's own time, px per frame interval: the mean of the flow to the next frame and the flow from the previous frame
/// to this one, each of which is the motion half an interval away. It is the flow to the next frame alone where the matching pixel of
/// the previous frame is not known, and NaN where the flow to the next frame is NaN.
///
/// The flows must have one size.
pub fn motion_at_frame(to_next: &Flow, from_previous: &Flow) -> Flow {
    let (w, h) = to_next.size();
    let mut motion = Flow::filled(w, h, [0.0; 2]);
    par::for_each_row(motion.data_mut(), w, |y, out| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = motion_at_pixel(to_next, from_previous, x, y);
        }
    });
    motion
}

/// [`motion_at_frame`] at one pixel.
#[inline]
pub(crate) fn motion_at_pixel(to_next: &Flow, from_previous: &Flow, x: usize, y: usize) -> [f32; 2] {
    // The largest distance, in px, by which the flow of the previous frame's pixel may miss this pixel.
    const GAP: f32 = 1.0;
    // The flow of the previous frame's pixel that lies `way` before this one; the nearest pixel will do, since flow is smooth.
    let before = |way: [f32; 2]| {
        let (x, y) = (x as f32 - way[0], y as f32 - way[1]);
        inside(x, y, to_next.size()).then(|| from_previous.at((x + 0.5) as usize, (y + 0.5) as usize))
    };
    let next = to_next.at(x, y);
    let guess = before(next);
    let last = guess.and_then(|guess| {
        let last = before(guess)?;
        ((last[0] - guess[0]).abs() + (last[1] - guess[1]).abs() < GAP).then_some(last)
    });
    last.map_or(next, |last| [0, 1].map(|c| 0.5 * (next[c] + last[c])))
}

fn inside(x: f32, y: f32, (w, h): (usize, usize)) -> bool {
    x >= 0.0 && y >= 0.0 && x <= (w as f32 - 1.0) && y <= (h as f32 - 1.0)
}

pub(super) fn check((w, h): (usize, usize), (tw, th): (usize, usize)) -> Result<()> {
    if (w, h) != (tw, th) {
        return Err(Error::new(format!(
            "optical flow needs two images of one size, not {w} x {h} and {tw} x {th}: scale or crop one of them"
        )));
    }
    if w == 0 || h == 0 {
        return Err(Error::new(format!("an image of {w} x {h} pixels has no optical flow")));
    }
    Ok(())
}

/// The flow between two images with their pyramids. If the brightness differs, the difference is undone and the flow found once more.
fn solve_alike(
    refiner: &mut Refiner,
    (from, from_pyramid): (&Plane, &[Padded]),
    (to, to_pyramid): (&Plane, &[Padded]),
) -> Flow {
    let flow = solve(refiner, from_pyramid, to_pyramid);
    let pair = |x: usize, y: usize| {
        let [u, v] = flow.at(x, y);
        let (tx, ty) = (x as f32 + u, y as f32 + v);
        inside(tx, ty, to.size()).then(|| [[from.at(x, y)], [to.bilinear(tx, ty)]])
    };
    let Some(k) = brightening(from.size(), pair) else { return flow };
    // The factor of a row of `from` serves for the same row of `to`, since motions are small beside the bands between which factors differ.
    let alike = Plane::from_fn(to.width(), to.height(), |x, y| undone(to.at(x, y), k[y][0]));
    solve(refiner, from_pyramid, &pyramid_of(&alike))
}

fn solve(refiner: &mut Refiner, from: &[Padded], to: &[Padded]) -> Flow {
    let (w, h) = (from[0].w, from[0].h);
    let finest_searched = FINEST_SEARCHED.min(from.len() - 1);
    refiner.fit(w, h);
    // `uv` holds a row of u, then a row of v, for each row of the image.
    let mut uv = Vec::new();
    for (level, (from, to)) in from.iter().zip(to).enumerate().rev() {
        uv = if uv.is_empty() { vec![0.0; 2 * from.w * from.h] } else { upsample(&uv, from.w, from.h) };
        if level >= finest_searched {
            uv = densify(from, to, &search(from, to, &uv));
        }
        refiner.refine(from, to, &mut uv);
    }
    let mut flow = Flow::filled(w, h, [0.0; 2]);
    par::for_each_row(flow.data_mut(), w, |y, out| {
        let (u, v) = uv[2 * w * y..][..2 * w].split_at(w);
        for ((out, &u), &v) in out.iter_mut().zip(u).zip(v) {
            *out = [u, v];
        }
    });
    flow
}

/// The pyramid of a smoothed image, each level half the size of the one before, finest first.
fn pyramid_of(p: &Plane) -> Vec<Padded> {
    // The limits lie far beyond the values of any image, and are small enough that squares of values stay exact.
    let finite = p.map(|v| if v.is_finite() { v.clamp(-4.0, 4.0) } else { 0.0 });
    let mut p = filter::gaussian_blur(&finite, SMOOTHING);
    let mut levels = vec![Padded::new(&p)];
    while p.width().max(p.height()) > COARSEST {
        p = pyramid::downsample(&p);
        levels.push(Padded::new(&p));
    }
    levels
}

/// The flow of a coarse level, enlarged to w x h px, about twice its size.
fn upsample(coarse: &[f32], w: usize, h: usize) -> Vec<f32> {
    let (cw, ch) = (w.div_ceil(2), h.div_ceil(2));
    let mut fine = vec![0.0; 2 * w * h];
    par::for_each_row(&mut fine, 2 * w, |y, out| {
        let above = &coarse[2 * cw * (y / 2)..][..2 * cw];
        let below = &coarse[2 * cw * y.div_ceil(2).min(ch - 1)..][..2 * cw];
        for ((out, a), b) in out.chunks_mut(w).zip(above.chunks(cw)).zip(below.chunks(cw)) {
            for (x, o) in out.iter_mut().enumerate() {
                let (i, j) = (x / 2, x.div_ceil(2).min(cw - 1));
                // The value is the mean of four neighbours, times 2 for the px of the finer level.
                *o = 0.5 * (a[i] + a[j] + b[i] + b[j]);
            }
        }
    });
    fine
}

/// The number of patches that cover a row or column of `size` px.
fn patches(size: usize) -> usize {
    size.saturating_sub(PATCH).div_ceil(STRIDE) + 1
}

/// The first pixel of patch `k` of a row or column of `size` px.
#[inline(always)]
fn origin(k: usize, size: usize) -> usize {
    (k * STRIDE).min(size.saturating_sub(PATCH))
}

/// The displacement of one patch, with its error.
#[derive(Clone, Copy)]
struct Match {
    at: [f32; 2],
    /// The sum of the squared differences of the pixels after subtraction of the mean difference.
    cost: f32,
}

/// Dense inverse search that starts from the flow `uv`.
fn search(from: &Padded, to: &Padded, uv: &[f32]) -> Vec<Match> {
    let (w, h) = (from.w, from.h);
    let start = |x: usize, y: usize| {
        let row = &uv[2 * w * y.min(h - 1)..][..2 * w];
        [row[x.min(w - 1)], row[w + x.min(w - 1)]]
    };
    let mut matches = vec![Match { at: [0.0; 2], cost: 0.0 }; patches(w) * patches(h)];
    par::for_each_row(&mut matches, patches(w), |j, row| {
        let y = origin(j, h);
        for (i, best) in row.iter_mut().enumerate() {
            let x = origin(i, w);
            let template = Template::new(from, x, y);
            let (cx, cy) = (x + PATCH / 2, y + PATCH / 2);
            let mut at = start(cx, cy);
            let mut cost = template.compare(to, at).0;
            let sides = [
                start(cx.saturating_sub(REACH), cy),
                start(cx + REACH, cy),
                start(cx, cy.saturating_sub(REACH)),
                start(cx, cy + REACH),
            ];
            for side in sides {
                if (side[0] - at[0]).abs() + (side[1] - at[1]).abs() > 0.25 {
                    let side_cost = template.compare(to, side).0;
                    if side_cost < cost {
                        (at, cost) = (side, side_cost);
                    }
                }
            }
            *best = template.descend(to, at);
        }
    });
    matches
}

/// A patch with the quantities that inverse-compositional Lucas-Kanade (Baker & Matthews 2004) computes once per patch.
struct Template {
    x: f32,
    y: f32,
    value: [[f32; PATCH]; PATCH],
    gx: [[f32; PATCH]; PATCH],
    gy: [[f32; PATCH]; PATCH],
    mean_gx: f32,
    mean_gy: f32,
    /// The xx, xy and yy components of the inverse of the Hessian, which includes the prior.
    inverse: [f32; 3],
}

/// The number of pixels of a patch.
const AREA: f32 = (PATCH * PATCH) as f32;

impl Template {
    fn new(from: &Padded, x: usize, y: usize) -> Self {
        let mut value = [[0.0; PATCH]; PATCH];
        let (mut gx, mut gy) = (value, value);
        let mut sums = [[0.0f32; PATCH]; 5];
        for j in 0..PATCH {
            let above = &from.from(x + PAD, y + PAD + j - 1)[..PATCH];
            let here = &from.from(x + PAD - 1, y + PAD + j)[..PATCH + 2];
            let below = &from.from(x + PAD, y + PAD + j + 1)[..PATCH];
            for i in 0..PATCH {
                let (dx, dy) = (0.5 * (here[i + 2] - here[i]), 0.5 * (below[i] - above[i]));
                value[j][i] = here[i + 1];
                gx[j][i] = dx;
                gy[j][i] = dy;
                sums[0][i] += dx;
                sums[1][i] += dy;
                sums[2][i] += dx * dx;
                sums[3][i] += dx * dy;
                sums[4][i] += dy * dy;
            }
        }
        let [sx, sy, sxx, sxy, syy] = sums.map(sum);
        let (a, b, c) = (sxx - sx * sx / AREA + PRIOR, sxy - sx * sy / AREA, syy - sy * sy / AREA + PRIOR);
        let det = (a * c - b * b).max(PRIOR * PRIOR);
        let inverse = [c / det, -b / det, a / det];
        Self { x: x as f32, y: y as f32, value, gx, gy, mean_gx: sx / AREA, mean_gy: sy / AREA, inverse }
    }

    /// The sum of the squared differences to `to`, displaced by `at`, after subtraction of the mean difference; and half the gradient of
    /// that sum with respect to `at`.
    #[inline(always)]
    fn compare(&self, to: &Padded, at: [f32; 2]) -> (f32, [f32; 2]) {
        let (x, y, fx, fy) = to.place(self.x + at[0], self.y + at[1], PATCH);
        let mut sums = [[0.0f32; PATCH]; 4];
        let mut above = [0.0f32; PATCH];
        let row = &to.from(x, y)[..PATCH + 1];
        for i in 0..PATCH {
            above[i] = row[i] + fx * (row[i + 1] - row[i]);
        }
        for j in 0..PATCH {
            let row = &to.from(x, y + j + 1)[..PATCH + 1];
            let (value, gx, gy) = (&self.value[j], &self.gx[j], &self.gy[j]);
            for i in 0..PATCH {
                let below = row[i] + fx * (row[i + 1] - row[i]);
                let r = above[i] + fy * (below - above[i]) - value[i];
                above[i] = below;
                sums[0][i] += r;
                sums[1][i] += r * r;
                sums[2][i] += gx[i] * r;
                sums[3][i] += gy[i] * r;
            }
        }
        let [s, ss, sx, sy] = sums.map(sum);
        (ss - s * s / AREA, [sx - self.mean_gx * s, sy - self.mean_gy * s])
    }

    /// Gauss-Newton steps from `start`, as long as they improve the match and stay within the side of a patch of `start`.
    #[inline(always)]
    fn descend(&self, to: &Padded, start: [f32; 2]) -> Match {
        let mut best = Match { at: start, cost: f32::MAX };
        let mut at = start;
        for _ in 0..STEPS {
            let (cost, gradient) = self.compare(to, at);
            if cost >= best.cost {
                break;
            }
            best = Match { at, cost };
            let [bx, by] = [0, 1].map(|k| gradient[k] + PRIOR * (at[k] - start[k]));
            let step =
                [self.inverse[0] * bx + self.inverse[1] * by, self.inverse[1] * bx + self.inverse[2] * by];
            at = [at[0] - step[0], at[1] - step[1]];
            let square = |a: f32, b: f32| a * a + b * b;
            if square(at[0] - start[0], at[1] - start[1]) > AREA || square(step[0], step[1]) < 1e-4 {
                break;
            }
        }
        best
    }
}

/// The sum of the values, in an order that the compiler may vectorise.
#[inline(always)]
fn sum(s: [f32; PATCH]) -> f32 {
    (s[0] + s[4]) + (s[1] + s[5]) + ((s[2] + s[6]) + (s[3] + s[7]))
}

/// The dense flow: at each pixel the mean displacement of the patches over it, each weighted by its fit at the pixel and as a whole.
fn densify(from: &Padded, to: &Padded, matches: &[Match]) -> Vec<f32> {
    let (w, h) = (from.w, from.h);
    let (nx, ny) = (patches(w), patches(h));
    let covered = w.max(PATCH);
    let mut uv = vec![0.0; 2 * w * h];
    par::for_each_row(&mut uv, 2 * w, |y, out| {
        let mut sums = vec![0.0f32; 3 * covered];
        let [su, sv, sw] = split_mut(&mut sums, covered);
        for j in (y + 1).saturating_sub(PATCH).div_ceil(STRIDE).min(ny - 1)..ny {
            let Some(k) = y.checked_sub(origin(j, h)) else { break };
            for (i, m) in matches[j * nx..][..nx].iter().enumerate() {
                let px = origin(i, w);
                let (mx, my, fx, fy) = to.place(px as f32 + m.at[0], (y - k) as f32 + m.at[1], PATCH);
                let above = &to.from(mx, my + k)[..PATCH + 1];
                let below = &to.from(mx, my + k + 1)[..PATCH + 1];
                let value = &from.from(px + PAD, y + PAD)[..PATCH];
                let (su, sv, sw) = (&mut su[px..][..PATCH], &mut sv[px..][..PATCH], &mut sw[px..][..PATCH]);
                // The least squared error is that of a thousandth of the range, since no fit is known better.
                let floor = 1e-6 + 0.3 * m.cost.max(0.0) / AREA;
                for l in 0..PATCH {
                    let a = above[l] + fx * (above[l + 1] - above[l]);
                    let b = below[l] + fx * (below[l + 1] - below[l]);
                    let r = a + fy * (b - a) - value[l];
                    let weight = 1.0 / (r * r + floor);
                    su[l] += weight * m.at[0];
                    sv[l] += weight * m.at[1];
                    sw[l] += weight;
                }
            }
        }
        let [u, v] = split_mut(out, w);
        for x in 0..w {
            u[x] = su[x] / sw[x];
            v[x] = sv[x] / sw[x];
        }
    });
    uv
}
