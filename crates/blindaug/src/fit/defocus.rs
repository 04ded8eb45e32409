//! The fit of defocus over inverse depth to a frame and its version without defocus: the paper's per-pixel search and quadratic,
//! and a fit of a thin lens to all pixels at once.

use super::robust::{Samples, places_of_contrast};
use crate::model::ExposureFraction;
use crate::portable::Portable;
use crate::{Flow, Plane, Raster, filter, par, synth};

/// The measured blur of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlurPoint {
    /// The inverse depth of the place.
    pub inverse_depth: f32,
    /// The std that fits the place best by itself, px.
    pub sigma_px: f32,
    /// The weight of the point, in [0, 1].
    pub weight: f32,
}

/// A thin lens in the parameters of the fit: `sigma = slope |d - focus|`, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The change of the std per unit of inverse depth, px, >= 0.
    pub slope: f32,
    /// The inverse depth in focus, > 0.
    pub focus: f32,
}

impl Lens {
    /// The std of the blur at inverse depth `d`, px.
    #[inline]
    pub fn sigma_px(self, d: f32) -> f32 {
        self.slope * (d - self.focus).abs()
    }

    /// The std of the blur at inverse depth 0, px.
    pub fn sigma_px_at_infinity(self) -> f32 {
        self.slope * self.focus
    }
}

/// The 5th and the 95th percentile of the inverse depths.
pub(super) fn seen_range(inverse_depths: impl Iterator<Item = f32>) -> (f32, f32) {
    let mut d: Vec<f32> = inverse_depths.collect();
    d.sort_by(f32::total_cmp);
    (d[d.len() / 20], d[d.len() * 19 / 20])
}

/// The lens that maximises an objective, for scenes in the `range` of inverse depths.
pub(super) fn best_lens(range: (f32, f32), objective: impl Fn(Lens) -> f32 + Sync + Send) -> Lens {
    best_lenses(range, objective)[0].1
}

/// The least and the greatest focus that can be told apart in scenes in the `range` of inverse depths: with a greater focus blur hardly
/// depends on depth, and with a smaller one blur is about proportional to inverse depth.
fn extreme_foci(range: (f32, f32)) -> [f32; 2] {
    let [far, near] = seen_foci(range);
    [0.3 * far, 3.0 * near]
}

/// The least and the greatest focus within the range of inverse depths that is seen.
fn seen_foci((lo, hi): (f32, f32)) -> [f32; 2] {
    let hi = hi.max(1e-6);
    [lo.clamp(0.02 * hi, hi), hi]
}

/// The most blur, px, that a lens may have in the scene; all stds beyond the end of the tables look the same.
const MOST_BLUR: f32 = 60.0;

/// The number of slopes that the search for a lens tries with each focus.
const SLOPES: usize = 50;
/// The ratio between successive slopes of the search, to base 2. The last slope is 500 times the first.
const SLOPE_OCTAVES: f32 = 8.965_784 / (SLOPES - 1) as f32;

/// The highest maxima of the objective with their lenses, the best first; see [`best_lenses_by`].
pub(super) fn best_lenses(
    range: (f32, f32),
    objective: impl Fn(Lens) -> f32 + Sync + Send,
) -> Vec<(f32, Lens)> {
    best_lenses_by(range, |focus, slopes| slopes.map(|slope| objective(Lens { slope, focus })), &objective)
}

/// The highest maxima of the objective with their lenses, the best first. They are found on a grid over the focus and the largest blur in
/// the scene, then by [`refined_lens`]. There are several, since a scene behind the focus may look like one in front of it.
///
/// `over_slopes` is the objective, or one that is close to it, of all lenses of a focus with the slopes given, of which each is
/// 2^[`SLOPE_OCTAVES`] times the one before.
fn best_lenses_by(
    range: (f32, f32),
    over_slopes: impl Fn(f32, [f32; SLOPES]) -> [f32; SLOPES] + Sync + Send,
    objective: impl Fn(Lens) -> f32 + Sync + Send,
) -> Vec<(f32, Lens)> {
    const WITHIN: usize = 96;
    const BEYOND: usize = 12;
    const MAXIMA: usize = 3;
    let ((lo, hi), [far, near], [least, greatest]) = (range, seen_foci(range), extreme_foci(range));
    // Within the range that is seen, the blur of the strongest lens differs by less than 1 px between neighbouring foci.
    let within = (0..WITHIN).map(|i| far + (near - far) * i as f32 / (WITHIN - 1) as f32);
    let between = |from: f32, to: f32, i: usize| from * (to / from).portable_powf(i as f32 / BEYOND as f32);
    let farther = (0..BEYOND).map(|i| between(least, far, i));
    let nearer = (1..=BEYOND).map(|i| between(near, greatest, i));
    let foci: Vec<f32> = farther.chain(within).chain(nearer).collect();
    let best = par::map(foci.len(), |i| {
        let focus = foci[i];
        let reach = (lo - focus).abs().max((hi - focus).abs()).max(1e-9);
        let slopes: [f32; SLOPES] =
            std::array::from_fn(|j| 0.08 * 2f32.portable_powf(j as f32 * SLOPE_OCTAVES) / reach);
        let lenses = slopes.map(|slope| Lens { slope, focus });
        (over_slopes(focus, slopes).into_iter().zip(lenses))
            .fold((f32::MIN, lenses[0]), |a, b| if b.0 > a.0 { b } else { a })
    });
    let value = |i: Option<usize>| i.and_then(|i| best.get(i)).map_or(f32::MIN, |b| b.0);
    let starts: Vec<Lens> = (0..foci.len())
        .filter(|&i| value(Some(i)) > value(i.checked_sub(1)) && value(Some(i)) >= value(Some(i + 1)))
        .map(|i| best[i].1)
        .collect();
    let mut maxima = par::map(starts.len(), |i| refined_lens(starts[i], 1e-3, range, &objective));
    maxima.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut lenses: Vec<(f32, Lens)> = vec![];
    for maximum in maxima {
        let other = |l: &(f32, Lens)| (l.1.focus / maximum.1.focus).portable_ln().abs() > 0.02;
        if lenses.len() < MAXIMA && lenses.iter().all(other) {
            lenses.push(maximum);
        }
    }
    if lenses.is_empty() {
        // The objective prefers no lens.
        lenses.push((f32::MIN, Lens { slope: 0.0, focus: near }));
    }
    lenses
}

/// The maximum next to `start`, and its lens, for scenes in the `range` of inverse depths. The search steps along the coordinates, by
/// relative steps that shrink to `finest`.
pub(super) fn refined_lens(
    start: Lens,
    finest: f32,
    range: (f32, f32),
    objective: impl Fn(Lens) -> f32,
) -> (f32, Lens) {
    let [least, greatest] = extreme_foci(range);
    let mut best = (objective(start), start);
    let mut step = 0.12;
    while step > finest {
        let mut improved = false;
        let Lens { slope, focus } = best.1;
        // Moves change the slope, the focus, or both at constant blur at infinity.
        let moves = [
            Lens { slope: slope * (1.0 + step), focus },
            Lens { slope: slope * (1.0 - step), focus },
            Lens { slope, focus: focus * (1.0 + 0.7 * step) },
            Lens { slope, focus: focus * (1.0 - 0.7 * step) },
            Lens { slope: slope / (1.0 + step), focus: focus * (1.0 + step) },
            Lens { slope: slope * (1.0 + step), focus: focus / (1.0 + step) },
        ];
        for lens in moves {
            let most = lens.sigma_px(range.0).max(lens.sigma_px(range.1));
            if lens.focus < 0.9 * least || lens.focus > 1.1 * greatest || most > MOST_BLUR {
                continue;
            }
            let value = objective(lens);
            if value > best.0 {
                (best, improved) = ((value, lens), true);
            }
        }
        if !improved {
            step *= 0.5;
        }
    }
    best
}

/// The stds of the stack of blurred images, px.
const STACK: [f32; 23] = [
    0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 1.75, 2.0, 2.35, 2.7, 3.1, 3.5, 4.0, 4.5, 5.0, 5.7, 6.5, 7.3,
    8.2, 9.1, 10.0,
];

/// The number of steps of [`STACK_PARTS`] per px; each std of the stack is a whole number of them.
const STEPS_PER_PX: f32 = 20.0;

/// For each step of std up to the end of the stack, the index of the std of [`STACK`] that ends the part in which it lies.
const STACK_PARTS: [u8; 201] = {
    let mut parts = [0; 201];
    let (mut step, mut part) = (0, 1);
    while step < parts.len() {
        // Half a step keeps rounding from mattering.
        if part < STACK.len() - 1 && step as f32 + 0.5 > STACK[part] * STEPS_PER_PX {
            part += 1;
        }
        parts[step] = part as u8;
        step += 1;
    }
    parts
};

/// Between two stds of the stack, a blurred image changes in proportion to the variance: the part of the stack in which `sigma` (px) lies,
/// by the index of its end, and the share of the way through it.
#[inline(always)]
fn in_stack(sigma: f32) -> (usize, f32) {
    let k = usize::from(STACK_PARTS[((sigma * STEPS_PER_PX) as usize).min(STACK_PARTS.len() - 1)]);
    let (a, b) = (STACK[k - 1] * STACK[k - 1], STACK[k] * STACK[k]);
    (k, ((sigma * sigma - a) / (b - a)).clamp(0.0, 1.0))
}

/// The scores of places over the std of their blur. Successive stds have the ratio of successive slopes of the search for a lens, so that
/// for the slopes of a focus each place has a run of successive scores.
struct ScoresOverBlur {
    depths: Vec<f32>,
    scores: Vec<[f32; Self::LEAST + Self::STDS + SLOPES]>,
}

impl ScoresOverBlur {
    /// The smallest std, px; a smaller one scores the same.
    const LEAST_STD: f32 = 0.05;
    /// The index of the smallest std: the scores before it are the same.
    const LEAST: usize = SLOPES;
    /// The number of stds that score differently: up to 10 px, the end of the stack.
    const STDS: usize = 43;

    /// The scores of places at these inverse depths; `score` is that of a place, by its index, at a std in px.
    fn new(depths: impl Iterator<Item = f32>, score: impl Fn(usize, f32) -> f32 + Sync + Send) -> Self {
        let depths: Vec<f32> = depths.collect();
        let stds: [f32; Self::STDS] =
            std::array::from_fn(|k| Self::LEAST_STD * 2f32.portable_powf(k as f32 * SLOPE_OCTAVES));
        let scores = par::map(depths.len(), |i| {
            let of_place = stds.map(|sigma| score(i, sigma));
            std::array::from_fn(|k| of_place[k.saturating_sub(Self::LEAST).min(Self::STDS - 1)])
        });
        Self { depths, scores }
    }

    /// The sum over the places for lenses of this focus, with successive slopes from this one on. The score between two stds is interpolated.
    fn over_slopes(&self, focus: f32, slope: f32) -> [f32; SLOPES] {
        let mut sums = [0.0; SLOPES];
        for (d, scores) in self.depths.iter().zip(&self.scores) {
            let sigma = Lens { slope, focus }.sigma_px(*d).max(1e-6);
            let at = Self::LEAST as f32 + (sigma / Self::LEAST_STD).portable_log2() / SLOPE_OCTAVES;
            let at = at.clamp(0.0, (Self::LEAST + Self::STDS - 1) as f32);
            let (k, t) = (at as usize, at.fract());
            for (sum, pair) in sums.iter_mut().zip(scores[k..].windows(2)) {
                *sum += pair[0] + t * (pair[1] - pair[0]);
            }
        }
        sums
    }
}

/// The fit of a lens to one frame.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// The estimated lens.
    pub lens: Lens,
    /// The covariance of (slope, focus), with the blocks of the image taken as independent.
    pub covariance: [[f64; 2]; 2],
    /// The number of pixels that the estimate rests on.
    pub samples: usize,
    /// The 5th and the 95th percentile of the inverse depths that were seen.
    pub range: (f32, f32),
}

/// The thin lens for which `sharp`, blurred by the lens's disks (and by the shutter, if its flow and exposure are given), is closest to
/// `target`. Both images are luma in the light that is blurred; `weight` is the inverse std of the target's noise.
///
/// The result is `None` if too few places have texture and depth. All images must have one size.
pub fn fit_lens(
    target: &Plane,
    weight: &Plane,
    sharp: &Plane,
    inverse_depth: &Plane,
    shutter: Option<(&Flow, ExposureFraction)>,
) -> Option<LensFit> {
    let (w, h) = sharp.size();
    // Depth must be known and even around a place, since next to a step of depth a blurred pixel shows things at two depths.
    let even = |x: usize, y: usize| {
        let d = inverse_depth.at(x, y);
        let near = |dx: isize, dy: isize| inverse_depth.at_clamped(x as isize + dx, y as isize + dy);
        let around = [(-8, 0), (8, 0), (0, -8), (0, 8), (-4, -4), (4, 4), (-4, 4), (4, -4)];
        d.is_finite() && around.iter().all(|&(dx, dy)| (near(dx, dy) - d).abs() < 0.12 * d.abs() + 1e-6)
    };
    let mild = filter::gaussian_blur(sharp, 2.0);
    let contrast = |x: usize, y: usize| (sharp.at(x, y) - mild.at(x, y)).abs() * weight.at(x, y);
    let places = places_of_contrast(w, h, 10, even, contrast);
    if places.len() < 200 {
        return None;
    }
    // The value of each place is predicted at each std. Where motion and depth are even, the order of the two blurs does not matter, so
    // the shutter's is applied once, before the lens's.
    let still;
    let source = match shutter {
        Some((flow, exposure)) => {
            still = Plane::from_fn(w, h, |x, y| {
                super::motion_blur::mean_along(sharp, x, y, flow.at(x, y), exposure.0)
            });
            &still
        }
        None => sharp,
    };
    let predicted = synth::defocus::disk_values_at(source, &places, &STACK);
    let depth: Vec<f32> = places.iter().map(|&(x, y)| inverse_depth.at(x, y)).collect();
    let blurred = |sigma: f32, i: usize| {
        let (k, t) = in_stack(sigma);
        predicted[i][k - 1] + t * (predicted[i][k] - predicted[i][k - 1])
    };
    let model = |lens: Lens, i: usize| blurred(lens.sigma_px(depth[i]), i);
    let observed = |x: usize, y: usize| (target.at(x, y), weight.at(x, y));
    let samples = Samples::new(&places, observed);
    let range = seen_range(depth.iter().copied());
    // The first fit takes 1 as the scale of the residuals and a few of the places, the later ones estimate it and take all.
    const FEW: usize = 8;
    let few: Vec<(usize, usize)> = places.iter().copied().step_by(FEW).collect();
    let few = Samples::new(&few, observed);
    let scores = ScoresOverBlur::new(depth.iter().copied().step_by(FEW), |i, sigma| {
        few.score_of(i, 1.0, blurred(sigma, FEW * i))
    });
    let over_slopes = |focus: f32, slopes: [f32; SLOPES]| scores.over_slopes(focus, slopes[0]);
    let few_score = |lens: Lens| few.score(1.0, |i| model(lens, FEW * i));
    let mut lens = best_lenses_by(range, over_slopes, few_score)[0].1;
    for _ in 0..2 {
        let scale = samples.scale(|i| model(lens, i));
        lens = refined_lens(lens, 1e-3, range, |l| samples.score(scale, |i| model(l, i))).1;
    }
    let scale = samples.scale(|i| model(lens, i));
    let steps =
        [Lens { slope: lens.slope * 1.02 + 1e-6, ..lens }, Lens { focus: lens.focus * 1.02 + 1e-6, ..lens }];
    let widths = [steps[0].slope - lens.slope, steps[1].focus - lens.focus];
    let covariance = samples.covariance(
        scale,
        |i| model(lens, i),
        |i, k| (model(steps[k], i) - model(lens, i)) / widths[k],
    );
    Some(LensFit { lens, covariance, samples: places.len(), range })
}

/// The stds that [`pooled_search`] tries, rising, px: [0, 10] in 100 steps, as the paper does.
pub fn searched_stds() -> impl ExactSizeIterator<Item = f32> {
    const STEPS: u8 = 100;
    (0..STEPS + 1).map(|step| 10.0 * f32::from(step) / f32::from(STEPS))
}

/// The distance between the pixels at which [`pooled_search`] measures blur, px.
pub const SEARCH_STRIDE: usize = 4;
/// The distance, in px, from such a pixel to the edge of the square over which its errors are summed: the side is twice this, plus 1.
pub const SEARCH_REACH: usize = 4;

/// The result of the search at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Searched {
    /// The inverse depth of the pixel; NaN where there is no reading.
    pub inverse_depth: f32,
    /// The std of the least error, px.
    pub sigma_px: f32,
    /// The least and the greatest summed squared error over all stds.
    pub errors: [f32; 2],
}

/// The paper's search: at every 4th pixel, the std in [0, 10] px (100 steps) for which the blurred `sharp` is closest to `target`, with the
/// error summed over 9x9 px; flat regions are left out.
pub fn pooled_search(target: &Plane, sharp: &Plane, inverse_depth: &Plane) -> Vec<BlurPoint> {
    let (w, h) = sharp.size();
    let (columns, rows) = (w / SEARCH_STRIDE, h / SEARCH_STRIDE);
    let window = |at: usize, end: usize| {
        (at * SEARCH_STRIDE).saturating_sub(SEARCH_REACH)..(at * SEARCH_STRIDE + SEARCH_REACH + 1).min(end)
    };
    let mut searched: Vec<Searched> = (0..columns * rows)
        .map(|i| Searched {
            inverse_depth: inverse_depth.at(i % columns * SEARCH_STRIDE, i / columns * SEARCH_STRIDE),
            sigma_px: 0.0,
            errors: [f32::MAX, 0.0],
        })
        .collect();
    let mut level = sharp.clone();
    let mut before = 0.0f32;
    for sigma in searched_stds() {
        level = filter::gaussian_blur(&level, (sigma * sigma - before * before).sqrt());
        before = sigma;
        let error = Raster::from_fn(w, h, |x, y| (target.at(x, y) - level.at(x, y)).powi(2));
        // Errors are summed over 9 rows, then over 9 columns.
        let pooled = par::map(rows, |r| {
            let mut column = vec![0.0f32; w];
            for y in window(r, h) {
                column.iter_mut().zip(error.row(y)).for_each(|(c, e)| *c += e);
            }
            (0..columns).map(|c| column[window(c, w)].iter().sum::<f32>()).collect::<Vec<f32>>()
        });
        for (found, &e) in searched.iter_mut().zip(pooled.iter().flatten()) {
            let [least, greatest] = found.errors;
            found.errors[1] = greatest.max(e);
            if e < least {
                found.errors[0] = e;
                found.sigma_px = sigma;
            }
        }
    }
    textured(&searched)
}

/// The points of the pixels with texture and known depth: those whose greatest error is over the median and over 3 times their least.
pub fn textured(searched: &[Searched]) -> Vec<BlurPoint> {
    let mut contrast: Vec<f32> = searched.iter().map(|s| s.errors[1]).collect();
    contrast.sort_by(f32::total_cmp);
    let textured = contrast.get(contrast.len() / 2).copied().unwrap_or(0.0).max(1e-4);
    searched
        .iter()
        .filter(|s| s.inverse_depth.is_finite())
        .filter(|Searched { errors: [least, greatest], .. }| *greatest > textured && *greatest > 3.0 * least)
        .map(|&Searched { inverse_depth, sigma_px, errors: [least, greatest] }| BlurPoint {
            inverse_depth,
            sigma_px,
            weight: 1.0 - least / greatest,
        })
        .collect()
}

/// The coefficients of `a d^2 + b d + c` through points of local blur, and the range of inverse depths (5 to 95 %). The fit is robust
/// weighted least squares: the closed form of the minimum that the paper's L-BFGS descends to, repeated with Huber weights.
///
/// The result is `None` if there are too few points or all points have one depth.
pub fn quadratic(points: &[BlurPoint]) -> Option<([f32; 3], (f32, f32))> {
    if points.len() < 8 {
        return None;
    }
    let range = seen_range(points.iter().map(|p| p.inverse_depth));
    let (middle, half) = (0.5 * (range.0 + range.1), 0.5 * (range.1 - range.0));
    if half < 1e-6 {
        return None;
    }
    // The fit is in t = (d - middle) / half, which is better conditioned than d.
    let mut fit = [0.0f64; 3];
    for round in 0..8 {
        let (mut m, mut v) = ([[0.0f64; 3]; 3], [0.0f64; 3]);
        for p in points {
            let t = f64::from((p.inverse_depth - middle) / half);
            let basis = [t * t, t, 1.0];
            let r = f64::from(p.sigma_px) - basis.iter().zip(fit).map(|(b, f)| b * f).sum::<f64>();
            let huber = if round == 0 { 1.0 } else { (0.5 / r.abs().max(1e-9)).min(1.0) };
            let w = f64::from(p.weight) * huber;
            for i in 0..3 {
                v[i] += w * basis[i] * f64::from(p.sigma_px);
                (0..3).for_each(|j| m[i][j] += w * basis[i] * basis[j]);
            }
        }
        fit = solve3(m, v)?;
    }
    let (m, h) = (f64::from(middle), f64::from(half));
    let a = fit[0] / (h * h);
    let b = fit[1] / h - 2.0 * a * m;
    let c = fit[2] - fit[1] * m / h + a * m * m;
    Some(([a as f32, b as f32, c as f32], range))
}

/// Solves `m x = v` by Gaussian elimination with pivoting; `None` if `m` is singular.
fn solve3(mut m: [[f64; 3]; 3], mut v: [f64; 3]) -> Option<[f64; 3]> {
    for i in 0..3 {
        let pivot = (i..3).max_by(|&a, &b| m[a][i].abs().total_cmp(&m[b][i].abs()))?;
        m.swap(i, pivot);
        v.swap(i, pivot);
        if m[i][i].abs() < 1e-12 {
            return None;
        }
        for j in 0..3 {
            if j != i {
                let f = m[j][i] / m[i][i];
                let row = m[i];
                m[j].iter_mut().zip(row).for_each(|(a, b)| *a -= f * b);
                v[j] -= f * v[i];
            }
        }
    }
    Some(std::array::from_fn(|i| v[i] / m[i][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_part_of_the_stack_is_that_which_holds_the_std() {
        for i in 0..=1200 {
            let sigma = 0.01 * i as f32;
            let (k, t) = in_stack(sigma);
            let (a, b) = (STACK[k - 1].powi(2), STACK[k].powi(2));
            assert!((a + t * (b - a) - sigma.min(10.0).powi(2)).abs() < 1e-3, "{sigma}: {k} {t}");
        }
    }

    #[test]
    fn the_scores_over_slopes_are_those_of_each_lens() {
        let depths: Vec<f32> = (0..30).map(|i| 0.1 + 0.03 * i as f32).collect();
        // A smooth score that ends where the stack does.
        let score = |i: usize, sigma: f32| -(1.0 + sigma.min(10.0).powi(2)).ln() * (1.0 + 0.1 * i as f32);
        let scores = ScoresOverBlur::new(depths.iter().copied(), score);
        for (focus, least) in [(0.05, 0.01), (0.4, 0.1), (2.0, 0.3)] {
            for (j, sum) in scores.over_slopes(focus, least).into_iter().enumerate() {
                let lens = Lens { slope: least * 2f32.powf(j as f32 * SLOPE_OCTAVES), focus };
                let alone: f32 = depths.iter().enumerate().map(|(i, &d)| score(i, lens.sigma_px(d))).sum();
                assert!((sum - alone).abs() < 0.01 * alone.abs() + 0.5, "{focus} {j}: {sum} {alone}");
            }
        }
    }

    #[test]
    fn the_quadratic_through_exact_points_is_found() {
        let points: Vec<BlurPoint> = (0..40)
            .map(|i| {
                let d = 0.1 + 0.02 * i as f32;
                BlurPoint { inverse_depth: d, sigma_px: 6.0 * d * d - 3.0 * d + 1.5, weight: 1.0 }
            })
            .collect();
        let ([a, b, c], _) = quadratic(&points).unwrap();
        assert!((a - 6.0).abs() < 0.01 && (b + 3.0).abs() < 0.01 && (c - 1.5).abs() < 0.01, "{a} {b} {c}");
        assert!(quadratic(&points[..3]).is_none());
        assert!(quadratic(&vec![points[0]; 20]).is_none());
    }

    #[test]
    fn the_best_lens_of_a_smooth_objective_is_found() {
        let truth = Lens { slope: 5.0, focus: 0.4 };
        let score = |l: Lens| {
            -(0..20)
                .map(|i| 0.1 + 0.04 * i as f32)
                .map(|d| (l.sigma_px(d) - truth.sigma_px(d)).powi(2))
                .sum::<f32>()
        };
        let found = best_lens((0.1, 0.9), score);
        assert!((found.slope - 5.0).abs() < 0.05 && (found.focus - 0.4).abs() < 0.01, "{found:?}");
    }

    /// The clipped objective is even far from the true lens, like the sum of tiles that all object by the most they may.
    #[test]
    fn strong_lenses_are_found_wherever_they_are_in_focus() {
        let depths: Vec<f32> = (0..40).map(|i| 0.12 + 0.025 * i as f32).collect();
        for (at_infinity, focus) in [(20.0, 0.556), (24.0, 0.4), (16.0, 0.333), (40.0, 0.9)] {
            let truth = Lens { slope: at_infinity / focus, focus };
            let score = |l: Lens| {
                -depths.iter().map(|&d| (l.sigma_px(d) - truth.sigma_px(d)).powi(2).min(0.25)).sum::<f32>()
            };
            let found = best_lens((depths[2], depths[37]), score);
            assert!((found.focus / focus - 1.0).abs() < 0.01, "{found:?} for {truth:?}");
            assert!((found.slope / truth.slope - 1.0).abs() < 0.01, "{found:?} for {truth:?}");
        }
    }

    #[test]
    fn other_candidates_for_the_lens_are_found_too() {
        let lenses = [Lens { slope: 5.0, focus: 0.2 }, Lens { slope: 3.0, focus: 1.0 }];
        let value = |of: usize, l: Lens| {
            let apart = [l.slope / lenses[of].slope, l.focus / lenses[of].focus].map(|r| r.ln().powi(2));
            -(apart[0] + apart[1]).min(1.0) - of as f32 * 0.1
        };
        let found = best_lenses((0.1, 0.9), |l| value(0, l).max(value(1, l)));
        assert!(found.len() >= 2, "{found:?}");
        for ((_, found), lens) in found.iter().zip(&lenses) {
            assert!(
                (found.slope / lens.slope - 1.0).abs() < 0.01
                    && (found.focus / lens.focus - 1.0).abs() < 0.01
            );
        }
        // Blur that does not depend on depth, or is proportional to inverse depth, has no focus: the search must still end.
        for blur in [|_: f32| 2.0, |d: f32| 4.0 * d] {
            let loss = |l: Lens| {
                -(1..10).map(|i| (l.sigma_px(0.1 * i as f32) - blur(0.1 * i as f32)).powi(2)).sum::<f32>()
            };
            for (_, lens) in best_lenses((0.1, 0.9), loss) {
                assert!((0.02..3.0).contains(&lens.focus), "{lens:?}");
            }
        }
        // If the objective prefers nothing, any lens will do, but there must be one.
        assert_eq!(best_lenses((0.1, 0.9), |_| 0.0).len(), 1);
        assert_eq!(best_lenses((0.1, 0.9), |_| f32::NAN).len(), 1);
    }
}
