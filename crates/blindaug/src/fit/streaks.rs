//! The exposure from the streaks of successive frames whose motion is uneven, as under a shaking hand.
//!
//! A frame's streak is a vector: the way that the picture goes while the shutter is open, the exposure times the velocity at the frame's
//! own time. Flow tells the ways from frame to frame only, and where velocity swings within few frames, it tells the velocity at a
//! frame's time badly. But two successive frames show the same surfaces, and whatever their texture, their spectra tell how both streaks
//! differ, in length and direction ([`PreparedPair`]). So the streaks of all frames of a run are found together. Then they are held
//! against the flow: velocity is a smooth course, whose mean between two frames is the flow, so the streaks over the velocities that
//! such a course has at the frames' times are the exposure. The course is a Gaussian process (Rasmussen & Williams, Gaussian Processes for
//! Machine Learning, chapter 2), and the streaks are integrated out by Laplace's method.

use super::agreement::{
    BOOTSTRAPS, ExposureFit, FEWEST, MAX_UNCERTAINTY, most_likely_exposure, typical_speed, uneven_interval,
};
use super::likelihood::{EXPOSURE_STEP, EXPOSURES, MAX_LAMBDA, interpolate};
use super::linear::{cholesky, solved, solved_by};
use super::noise::LumaNoise;
use super::robust::uniform;
use super::spectral::{Pair, PreparedPair, streak_pairs};
use super::tiles::MotionOf;
use super::uneven::{median_difference, typical_motion};
use crate::model::{ExposureFraction, Space};
use crate::portable::Portable;
use crate::{Encoded, Flow, par};

/// A vector in the frame, px.
type Vector = [f32; 2];

/// Two successive frames whose streaks are compared.
#[derive(Clone, Debug)]
pub(super) struct Link {
    /// The way of what moves from the first frame to the second, px.
    way: Vector,
    /// The typical motion of each frame by which the pairs were found, px per frame interval: a pair's surface may move otherwise.
    typical: [Vector; 2],
    /// The pairs of tiles of both frames.
    pairs: Vec<Pair>,
}

impl Link {
    /// A link between two successive frames, given the flow from the first to the second, px, and the motion of each frame at its own time, px
    /// per frame interval (NaN: unknown); `None` if nothing moves, nothing is known of it, or the typical motions of the two frames are those of
    /// different things.
    pub fn new(frames: [&Encoded; 2], flow: &Flow, motions: [&MotionOf; 2], space: Space) -> Option<Self> {
        let size = flow.size();
        let (of_flow, [first, second]) = (|x, y| flow.at(x, y), motions.map(|of| typical_motion(size, of)));
        let (way, typical) = (typical_motion(size, &of_flow)?, [first?, second?]);
        // Where a car enters the frame, the typical motion jumps, though no thing moves otherwise than before.
        let same_things = motions.iter().zip(typical).all(|(of, typical)| {
            let changed = median_difference(size, &of_flow, of).unwrap_or(0.0);
            length([typical[0] - way[0], typical[1] - way[1]]) <= SAME_PX + SAME_SHARE * changed
        });
        if !same_things {
            return None;
        }
        let pairs = streak_pairs(frames, flow, motions, space);
        if pairs.is_empty() {
            return None;
        }
        Some(Self { way, typical, pairs })
    }
}

/// Successive frames, each linked to the next.
pub(super) struct Run<'a> {
    /// The links, at least one and at most [`LONGEST_RUN`].
    pub links: Vec<&'a Link>,
    /// The number of each frame among the frames of the fit, if it is one of these.
    pub frames: Vec<Option<usize>>,
}

/// The most links of a run: a hand does not shake alike for longer, and the time grows with the cube of the length.
pub(super) const LONGEST_RUN: usize = 12;

/// The time, in frame intervals, over which velocities are alike: the scale of the kernel of their Gaussian process. Swings with periods
/// from two to thirty frames give the same exposure with 0.5 and with 1 in its place.
const ALIKE_FOR: f64 = 0.7;

/// The stds of the velocity around its mean that are tried, over the mean speed; the likeliest one counts.
const SPREADS: [f64; 6] = [0.05, 0.1, 0.2, 0.4, 0.8, 1.2];

/// The std, px, by which a streak seems to be longer or shorter than it is, since a surface looks slightly different in both frames.
const STREAK_STD: f64 = 0.4;

/// The std of the flow, px.
const FLOW_STD: f64 = 0.1;

/// The most by which the typical motion of a link's frame may differ from its way, px, beyond [`SAME_SHARE`] times the median difference of
/// motion and flow: where it differs by more, other things move.
const SAME_PX: f32 = 1.0;
const SAME_SHARE: f32 = 2.0;

/// The factor of the log-likelihoods of pairs, whose tiles overlap and err alike.
const ALIKE: f32 = 0.1;

/// The frequency below which frequencies are looked at first, in cycles over the way of a frame interval, and its range in cycles per px:
/// what is low changes slowly with the streaks, so that the search finds its way from far.
const COARSE: f32 = 1.3;
const COARSE_RANGE: (f32, f32) = (0.04, 0.12);

/// The exposures from which the search starts.
const STARTS: [f32; 4] = [0.15, 0.35, 0.6, 0.9];
/// The number of starts whose result by low frequencies is improved by all.
const IMPROVED: usize = 2;
/// The most rounds by low frequencies, and by all.
const ROUNDS: [usize; 2] = [6, 8];
/// The factor by which the exposure may change in one round.
const REACH: f32 = 1.6;
/// The factor below which a smaller reach changes nothing: the exposure stays about what it is.
const NARROW: f32 = 1.1;
/// The largest change of a streak in one round, px, or as a share of the typical streak if that is more.
const STREAK_REACH: (f32, f32) = (2.0, 0.3);
/// The nats below which a round gains too little to go on.
const GAIN: f64 = 0.5;

/// The step of the curves over the exposure fraction in which streaks are integrated out, and their number of values.
const STEP: f32 = 0.025;
const STEPS: usize = (MAX_LAMBDA / STEP) as usize + 1;
/// The number of exposures up to that of a shutter that is always open.
const POSSIBLE: usize = (1.0 / EXPOSURE_STEP) as usize + 1;

/// The step, px, of the differences by which the likelihood's derivatives are found: the kernels of streaks change over three px.
const DIFFERENCE: f32 = 0.5;

/// The widest interval by streaks that takes the place of the interval by single tiles, whose width is given; `None`: these tell no exposure.
pub(super) fn widest(by_tiles: Option<f32>) -> f32 {
    /// Where motion is uneven, tiles are less sure than their interval says.
    const PREFERRED: f32 = 1.2;
    by_tiles.map_or(MAX_UNCERTAINTY, |width| (PREFERRED * width).min(MAX_UNCERTAINTY))
}

/// The exposure that the streaks of all runs agree on; `None` if no run tells one.
pub(super) fn fit_exposure(runs: &[Run], noise: &LumaNoise) -> Option<ExposureFit> {
    let told: Vec<Told> = runs.iter().filter_map(|run| told_by(run, None, noise)).collect();
    agreed(&told.iter().collect::<Vec<_>>(), noise.coding_error)
}

/// The exposure that some runs agree on, with noise of this [`LumaNoise::coding_error`]; `None` if there is no run.
pub(super) fn agreed(told: &[&Told], coding_error: f32) -> Option<ExposureFit> {
    if told.is_empty() {
        return None;
    }
    let sum = summed(told);
    let estimate = likeliest(&sum);
    // With a single run all replicas agree, so that the interval rests on the likelihood alone.
    let replicas = par::map(BOOTSTRAPS, |r| {
        let weight = |run: usize| -(1.0 - uniform(r as u64, run as u64)).portable_ln();
        likeliest(&weighted(told, weight))
    });
    let seen = || told.iter().flat_map(|t| t.velocities.windows(2)).map(|v| seen_speed(v[0], v[1]));
    // Velocities that are all alike show nothing.
    let speed = typical_speed(seen().sum(), seen().map(|v| v * v).sum()).max(f32::MIN_POSITIVE);
    let most = sum.iter().copied().fold(f32::MIN, f32::max);
    let mut per_frame: Vec<(usize, f32)> = told.iter().flat_map(|t| t.per_frame.iter().copied()).collect();
    per_frame.sort_by_key(|f| f.0);
    per_frame.dedup_by_key(|f| f.0);
    Some(ExposureFit {
        exposure: ExposureFraction(estimate),
        interval: uneven_interval(estimate, &sum, &replicas, coding_error, speed, true),
        samples: told.iter().map(|t| t.samples).sum(),
        curve: sum.iter().enumerate().map(|(i, v)| [i as f32 * EXPOSURE_STEP, v - most]).collect(),
        per_frame,
    })
}

/// The log-likelihoods of some runs together, over the exposures of a curve.
pub(super) fn summed(told: &[&Told]) -> Vec<f32> {
    weighted(told, |_| 1.0)
}

fn weighted(told: &[&Told], weight: impl Fn(usize) -> f32) -> Vec<f32> {
    let mut sum = vec![0.0f32; EXPOSURES];
    for (i, run) in told.iter().enumerate() {
        sum.iter_mut().zip(&run.curve).for_each(|(s, v)| *s += weight(i) * v);
    }
    sum
}

/// The likeliest exposure fraction of a curve: at most 1, since what seems longer than a frame was faster than its flow says.
pub(super) fn likeliest(curve: &[f32]) -> f32 {
    most_likely_exposure(&curve[..POSSIBLE])
}

/// The speed whose streak, against none, differs as much as those of two frames with these velocities, in any unit. A short streak takes
/// from a spectrum what is proportional to the square of its length, in its direction, so the matrices of these squares are compared.
fn seen_speed(a: Vector, b: Vector) -> f32 {
    let squares = dot(a, a).powi(2) + dot(b, b).powi(2) - 2.0 * dot(a, b).powi(2);
    squares.max(0.0).sqrt().sqrt()
}

/// What the frames of a run tell.
pub(super) struct Told {
    /// The likeliest streaks.
    streaks: Streaks,
    /// The log-likelihood over the exposures of a curve, in nats.
    curve: Vec<f32>,
    /// The velocities at the frames' times, px per frame interval, as the flow tells them.
    velocities: Vec<Vector>,
    /// The exposure fraction by the streak of each frame alone, with the frame's number.
    per_frame: Vec<(usize, f32)>,
    /// The number of pairs of tiles.
    samples: usize,
}

impl Told {
    /// The number of links of the run.
    pub fn links(&self) -> usize {
        self.velocities.len() - 1
    }
}

/// What the streaks of a run tell; `None` if fewer than [`FEWEST`] pairs of tiles can be compared. `before` is what its first frames told: the search then
/// starts from their streaks alone, and is much shorter.
pub(super) fn told_by<'a>(run: &Run<'a>, before: Option<&Told>, noise: &LumaNoise) -> Option<Told> {
    let links = |highest: f32| -> Vec<PreparedLink<'a>> {
        let of_pair = |pair| PreparedPair::of_streaks(pair, noise, highest);
        let of_link = |link: &'a Link| PreparedLink {
            typical: link.typical,
            pairs: link.pairs.iter().filter_map(of_pair).collect(),
        };
        run.links.iter().copied().map(of_link).collect()
    };
    let ways: Vec<Vector> = run.links.iter().map(|link| link.way).collect();
    let course = Course::new(&ways).filter(|course| course.speed > 0.0)?;
    let fine = links(f32::INFINITY);
    let samples = fine.iter().map(|link| link.pairs.len()).sum();
    if samples < FEWEST {
        return None;
    }
    let search =
        |links: &[PreparedLink], streaks, rounds| Search { links, course: &course }.improved(streaks, rounds);
    let at = |lambda: f32| course.velocities.iter().map(move |v| v.map(|v| lambda * v));
    let starts = match before {
        Some(Told { streaks: Streaks { vectors, lambda }, .. }) => {
            let vectors = vectors.iter().copied().chain(at(*lambda).skip(vectors.len())).collect();
            vec![Streaks { vectors, lambda: *lambda }]
        }
        None => {
            let coarse = links((COARSE / course.speed).clamp(COARSE_RANGE.0, COARSE_RANGE.1));
            let from = |lambda| search(&coarse, Streaks { vectors: at(lambda).collect(), lambda }, ROUNDS[0]);
            let mut starts = STARTS.into_iter().map(from).collect::<Option<Vec<_>>>()?;
            starts.sort_by(|a, b| b.log_density.total_cmp(&a.log_density));
            starts.into_iter().take(IMPROVED).map(|start| start.streaks).collect()
        }
    };
    let mut curve = vec![f32::MIN; STEPS];
    let mut likeliest: Option<(Streaks, f32)> = None;
    for streaks in starts {
        let Improved { streaks, log_density, curve: near } = search(&fine, streaks, ROUNDS[1])?;
        // Far from where the likelihood was looked at its quadratic may promise more than there is.
        let most = near.iter().copied().fold(f32::MIN, f32::max);
        curve.iter_mut().zip(&near).for_each(|(c, v)| *c = c.max(v - most + log_density));
        if likeliest.as_ref().is_none_or(|l| log_density > l.1) {
            likeliest = Some((streaks, log_density));
        }
    }
    let (streaks, _) = likeliest?;
    let share = |(streak, v): (&Vector, &Vector)| dot(*streak, *v) / dot(*v, *v).max(1e-6);
    let shares = streaks.vectors.iter().zip(&course.velocities).map(share).map(|s| s.clamp(0.0, 1.0));
    let per_frame = run.frames.iter().zip(shares).filter_map(|(frame, share)| Some(((*frame)?, share)));
    let per_frame = per_frame.collect();
    Some(Told {
        streaks,
        curve: (0..EXPOSURES).map(|i| interpolate(&curve, i as f32 * EXPOSURE_STEP / STEP)).collect(),
        per_frame,
        velocities: course.velocities,
        samples,
    })
}

fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

fn length([x, y]: Vector) -> f32 {
    x.portable_hypot(y)
}

/// What the ways from frame to frame tell of the velocities at the frames' own times.
struct Course {
    /// The mean of the velocities that a smooth course may have, px per frame interval.
    velocities: Vec<Vector>,
    /// The covariance of one component of the velocities over the frames, row by row, if velocity has the variance 1 around its mean.
    covariance: Vec<f64>,
    /// The mean speed, px per frame interval.
    speed: f32,
}

impl Course {
    fn new(ways: &[Vector]) -> Option<Self> {
        /// The number of parts of an interval over which the kernel is integrated.
        const PARTS: usize = 16;
        /// The variance of the mean velocity, which is not known, over that around it.
        const MEAN: f64 = 1e4;
        /// The variance of a way, which keeps the system regular.
        const REST: f64 = 1e-3;
        let kernel = |lag: f64| libm::exp(-lag * lag / (2.0 * ALIKE_FOR * ALIKE_FOR)) + MEAN;
        let within = |of: &dyn Fn(f64) -> f64| {
            let at = |i: usize| if i == 0 || i == PARTS { 0.5 } else { 1.0 } * of(i as f64 / PARTS as f64);
            (0..=PARTS).map(at).sum::<f64>() / PARTS as f64
        };
        // The covariance of a velocity with a way, which is a mean velocity, and of two ways.
        let with_way = |lag: f64| within(&|u| kernel(lag - u));
        let of_ways = |lag: f64| within(&|u| with_way(lag + u));
        let (n, m) = (ways.len() + 1, ways.len());
        let lag = |a: usize, b: usize| a as f64 - b as f64;
        let system: Vec<f64> = (0..m * m)
            .map(|i| of_ways(lag(i / m, i % m)) + if i % (m + 1) == 0 { REST } else { 0.0 })
            .collect();
        let told: Vec<Vec<f64>> = (0..n).map(|t| (0..m).map(|i| with_way(lag(t, i))).collect()).collect();
        let weights = told.iter().map(|of| solved(&system, of.clone())).collect::<Option<Vec<_>>>()?;
        let covariance = (0..n * n).map(|i| {
            let known = told[i / n].iter().zip(&weights[i % n]).map(|(a, b)| a * b).sum::<f64>();
            kernel(lag(i / n, i % n)) - known
        });
        let velocity = |of: &Vec<f64>| {
            [0, 1].map(|c| of.iter().zip(ways).map(|(w, way)| w * f64::from(way[c])).sum::<f64>() as f32)
        };
        let velocities: Vec<Vector> = weights.iter().map(velocity).collect();
        let speed = velocities.iter().map(|v| length(*v)).sum::<f32>() / n as f32;
        Some(Self { covariance: covariance.collect(), velocities, speed })
    }

    /// The covariance of one component of the streaks over the frames, row by row, at an exposure, if velocity has the std `spread`, px per
    /// frame interval, around its mean.
    fn of_streaks(&self, lambda: f64, spread: f64) -> Vec<f64> {
        let n = self.velocities.len();
        let own = STREAK_STD * STREAK_STD + (FLOW_STD * lambda).powi(2);
        let of =
            |(i, c): (usize, &f64)| (lambda * spread).powi(2) * c + if i % (n + 1) == 0 { own } else { 0.0 };
        self.covariance.iter().enumerate().map(of).collect()
    }

    /// The log of the density of streaks at an exposure, but for what does not depend on them.
    fn log_density(&self, streaks: &[Vector], lambda: f32, spread: f64) -> Option<f64> {
        let covariance = self.of_streaks(f64::from(lambda), spread);
        let mut sum = 0.0;
        for c in [0, 1] {
            let off = streaks.iter().zip(&self.velocities).map(|(s, v)| f64::from(s[c] - lambda * v[c]));
            let off: Vec<f64> = off.collect();
            let x = solved(&covariance, off.clone())?;
            sum -= 0.5 * off.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>();
        }
        Some(sum)
    }
}

/// The streaks of a run's frames, px, and the exposure fraction that they were found with.
#[derive(Clone, Debug)]
struct Streaks {
    vectors: Vec<Vector>,
    lambda: f32,
}

/// The quadratic that the data's log-likelihood is like near some streaks, over all their components.
struct Quadratic {
    value: f64,
    gradient: Vec<f64>,
    /// Minus the second derivatives, row by row.
    curvature: Vec<f64>,
}

/// The components of the streaks of a link's two frames.
const K: usize = 4;

/// The gradient of a function of [`K`] components, and minus its second derivatives, made positive, from its values at steps of
/// [`DIFFERENCE`]: at the middle, forth and back along each component, and forth and back along each two together.
fn derivatives(f: &[f32]) -> ([f32; K], [[f32; K]; K]) {
    let along = |i: usize| f[1 + 2 * i] + f[2 + 2 * i] - 2.0 * f[0];
    let gradient = std::array::from_fn(|i| (f[1 + 2 * i] - f[2 + 2 * i]) / (2.0 * DIFFERENCE));
    let mixed = |a: usize, b: usize| {
        let (i, j) = (a.max(b), a.min(b));
        let k = 1 + 2 * K + i * (i - 1) + 2 * j;
        let both = f[k] + f[k + 1] - 2.0 * f[0];
        -0.5 * (both - along(i) - along(j)) / (DIFFERENCE * DIFFERENCE)
    };
    let curvature = std::array::from_fn(|i| {
        // Rows that dominate make the matrix positive.
        let others = (0..K).filter(|&j| j != i).map(|j| mixed(i, j).abs()).sum::<f32>();
        let own = (-along(i) / (DIFFERENCE * DIFFERENCE)).max(others).max(1e-3);
        std::array::from_fn(|j| if i == j { own } else { mixed(i, j) })
    });
    (gradient, curvature)
}

/// What follows from the data near some streaks, with all streaks integrated out.
struct Marginal {
    /// The log-likelihood over the exposure in steps of [`STEP`].
    curve: Vec<f32>,
    /// The likeliest streaks within reach, with their exposure.
    likeliest: Streaks,
    /// The std of the velocity around its mean that goes with them, px per frame interval.
    spread: f64,
}

/// The result of a search for the likeliest streaks.
struct Improved {
    streaks: Streaks,
    /// The log-likelihood of the data plus the log-density of the streaks.
    log_density: f32,
    /// The [`Marginal::curve`] near them.
    curve: Vec<f32>,
}

/// A [`Link`] whose pairs are ready for the likelihood.
struct PreparedLink<'a> {
    typical: [Vector; 2],
    pairs: Vec<PreparedPair<'a>>,
}

struct Search<'a> {
    links: &'a [PreparedLink<'a>],
    course: &'a Course,
}

impl Search<'_> {
    /// The likeliest streaks that are found from some in so many rounds; `None` if a covariance is not one.
    fn improved(&self, mut streaks: Streaks, rounds: usize) -> Option<Improved> {
        /// How often a step is halved.
        const HALVED: usize = 4;
        let mut reach = REACH;
        let (px, of_streak) = STREAK_REACH;
        let mut quadratic = self.quadratic(&streaks);
        for _ in 0..rounds {
            let Marginal { likeliest: Streaks { vectors: best, lambda }, spread, .. } =
                self.marginal(&quadratic, &streaks, reach)?;
            let total = |vectors: &[Vector], value: f64| {
                Some(value + self.course.log_density(vectors, lambda, spread)?)
            };
            let before = total(&streaks.vectors, quadratic.value)?;
            let apart = |(a, b): (&Vector, &Vector)| length([a[0] - b[0], a[1] - b[1]]);
            let farthest = best.iter().zip(&streaks.vectors).map(apart).fold(0.0, f32::max);
            let farthest_allowed = px.max(of_streak * streaks.lambda * self.course.speed);
            let mut share = (farthest_allowed / farthest.max(f32::MIN_POSITIVE)).min(1.0);
            let mut gained = None;
            for _ in 0..HALVED {
                let step =
                    |(from, to): (&Vector, &Vector)| [0, 1].map(|c| from[c] + share * (to[c] - from[c]));
                let vectors = streaks.vectors.iter().zip(&best).map(step).collect();
                let next = Streaks { vectors, lambda };
                let now = total(&next.vectors, self.log_likelihood(&next))?;
                if now > before {
                    gained = Some(now - before);
                    streaks = next;
                    quadratic = self.quadratic(&streaks);
                    break;
                }
                share *= 0.5;
            }
            match gained {
                Some(gained) if gained < GAIN => break,
                Some(_) => {}
                // The exposure that seemed likeliest is too far away for the quadratic.
                None if reach > NARROW => reach = reach.sqrt(),
                None => break,
            }
        }
        let Marginal { curve, likeliest: Streaks { lambda, .. }, spread } =
            self.marginal(&quadratic, &streaks, NARROW)?;
        let log_density =
            (quadratic.value + self.course.log_density(&streaks.vectors, lambda, spread)?) as f32;
        Some(Improved { streaks, log_density, curve })
    }

    /// The streak of a surface of a link's pair in one of both frames: that of the frame, but for what the surface's motion differs from the
    /// frame's.
    fn streak(&self, (link, pair): (usize, usize), frame: usize, streaks: &Streaks) -> Vector {
        let PreparedLink { typical, pairs } = &self.links[link];
        let (own, motion, typical) =
            (streaks.vectors[link + frame], pairs[pair].motion(frame), typical[frame]);
        [0, 1].map(|c| own[c] + streaks.lambda * (motion[c] - typical[c]))
    }

    /// The data's log-likelihood.
    fn log_likelihood(&self, streaks: &Streaks) -> f64 {
        let of_link = |(link, PreparedLink { pairs, .. }): (usize, &PreparedLink)| {
            let all = par::map(pairs.len(), |i| {
                let [first, second] =
                    [0, 1].map(|frame| pairs[i].kernels(self.streak((link, i), frame, streaks)));
                pairs[i].log_likelihood(&first, &second)
            });
            f64::from(ALIKE * all.into_iter().sum::<f32>())
        };
        self.links.iter().enumerate().map(of_link).sum()
    }

    /// The quadratic of the data's log-likelihood, by differences.
    fn quadratic(&self, streaks: &Streaks) -> Quadratic {
        const D: f32 = DIFFERENCE;
        /// The differences of one frame's streak: none, along each axis, and along both.
        const MOVED: [Vector; 7] = [[0.0, 0.0], [D, 0.0], [-D, 0.0], [0.0, D], [0.0, -D], [D, D], [-D, -D]];
        // In these two components move, forth and back, as the elements of `MOVED` for both frames.
        let both = |i: usize, j: usize| match (i, j) {
            (1, 0) => [(5, 0), (6, 0)],
            (3, 2) => [(0, 5), (0, 6)],
            _ => [(2 * j + 1, 2 * (i - 2) + 1), (2 * j + 2, 2 * (i - 2) + 2)],
        };
        let one = |i: usize| match i {
            0 | 1 => [(2 * i + 1, 0), (2 * i + 2, 0)],
            _ => [(0, 2 * (i - 2) + 1), (0, 2 * (i - 2) + 2)],
        };
        let order: Vec<(usize, usize)> = [(0, 0)]
            .into_iter()
            .chain((0..K).flat_map(one))
            .chain((0..K).flat_map(|i| (0..i).flat_map(move |j| both(i, j))))
            .collect();
        let components = 2 * streaks.vectors.len();
        let mut sum = Quadratic {
            value: 0.0,
            gradient: vec![0.0; components],
            curvature: vec![0.0; components * components],
        };
        for (link, PreparedLink { pairs, .. }) in self.links.iter().enumerate() {
            let rows = par::map(pairs.len(), |i| {
                let kernels = [0, 1].map(|frame| {
                    let own = self.streak((link, i), frame, streaks);
                    MOVED.map(|by| pairs[i].kernels([own[0] + by[0], own[1] + by[1]]))
                });
                let [first, second] = kernels;
                let (misregistration, value) = pairs[i].likeliest(&first[0], &second[0]);
                let at = |&(a, b): &(usize, usize)| {
                    pairs[i].log_likelihood_at(&first[a], &second[b], misregistration)
                };
                std::iter::once(value).chain(order[1..].iter().map(at)).collect::<Vec<f32>>()
            });
            let total = |k: usize| ALIKE * rows.iter().map(|row| row[k]).sum::<f32>();
            let f: Vec<f32> = (0..order.len()).map(total).collect();
            let (gradient, curvature) = derivatives(&f);
            sum.value += f64::from(f[0]);
            let first = 2 * link;
            for i in 0..K {
                sum.gradient[first + i] += f64::from(gradient[i]);
                let row = &mut sum.curvature[(first + i) * components + first..][..K];
                row.iter_mut().zip(curvature[i]).for_each(|(s, v)| *s += f64::from(v));
            }
        }
        sum
    }

    /// The log-likelihood with the streaks integrated out, by the data's [`Search::quadratic`] at some streaks, and the likeliest streaks at
    /// exposures that differ from theirs by at most the factor `reach`. `None` if a covariance is not one.
    fn marginal(&self, quadratic: &Quadratic, streaks: &Streaks, reach: f32) -> Option<Marginal> {
        let n = streaks.vectors.len();
        let components = 2 * n;
        let Quadratic { value, gradient, curvature } = quadratic;
        let of = |lambda: f32, spread: f64| -> Option<(f64, Vec<f64>)> {
            let covariance = self.course.of_streaks(f64::from(lambda), spread);
            let factor = cholesky(&covariance, n)?;
            let mut precision = curvature.clone();
            for i in 0..n {
                let mut unit = vec![0.0; n];
                unit[i] = 1.0;
                for (j, v) in solved_by(&factor, unit).into_iter().enumerate() {
                    for c in [0, 1] {
                        precision[(2 * i + c) * components + 2 * j + c] += v;
                    }
                }
            }
            let posterior = cholesky(&precision, components)?;
            let log_root =
                |factor: &[f64], n: usize| (0..n).map(|i| libm::log(factor[i * (n + 1)])).sum::<f64>();
            // The quadratic is moved to the mean of the prior.
            let velocities = self.course.velocities.iter().flatten();
            let mean: Vec<f64> = velocities.map(|v| f64::from(lambda * v)).collect();
            let now = streaks.vectors.iter().flatten();
            let off: Vec<f64> = mean.iter().zip(now).map(|(m, s)| m - f64::from(*s)).collect();
            let bent: Vec<f64> = curvature
                .chunks(components)
                .map(|row| row.iter().zip(&off).map(|(a, b)| a * b).sum())
                .collect();
            let slope: Vec<f64> = gradient.iter().zip(&bent).map(|(g, b)| g - b).collect();
            let at_mean = (0..components).map(|i| off[i] * (gradient[i] - 0.5 * bent[i])).sum::<f64>();
            let x = solved_by(&posterior, slope.clone());
            let gain = 0.5 * slope.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>();
            let volume = log_root(&posterior, components) + 2.0 * log_root(&factor, n);
            let best = mean.iter().zip(&x).map(|(m, x)| m + x).collect();
            Some((value + at_mean + gain - volume, best))
        };
        let lambda_of = |l: usize| (l as f32 * STEP).max(0.2 * STEP);
        let spread_of = |k: usize| SPREADS[k] * f64::from(self.course.speed);
        let all = par::map(STEPS * SPREADS.len(), |i| {
            of(lambda_of(i / SPREADS.len()), spread_of(i % SPREADS.len()))
        });
        let all = all.into_iter().collect::<Option<Vec<_>>>()?;
        let over = all.chunks(SPREADS.len()).map(|of| of.iter().map(|v| v.0 as f32).fold(f32::MIN, f32::max));
        let within = streaks.lambda / reach - 0.5 * STEP..streaks.lambda * reach + 0.5 * STEP;
        // An exposure of 0 has no streaks from which to go on.
        let possible = (SPREADS.len()..all.len())
            .filter(|i| (i / SPREADS.len()) as f32 * STEP <= 1.0)
            .filter(|i| within.contains(&lambda_of(i / SPREADS.len())));
        let best = possible.max_by(|&a, &b| all[a].0.total_cmp(&all[b].0))?;
        let vectors = all[best].1.chunks(2).map(|v| [v[0] as f32, v[1] as f32]).collect();
        let likeliest = Streaks { vectors, lambda: lambda_of(best / SPREADS.len()) };
        Some(Marginal { curve: over.collect(), likeliest, spread: spread_of(best % SPREADS.len()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::motion_blur::motion_blur;
    use crate::{Raster, filter, model::BlurSpace};

    /// The place and the velocity at a time, in frame intervals, of a swing with this period, in px.
    fn swing(t: f32, period: f32) -> (Vector, Vector) {
        let rate = std::f32::consts::TAU / period;
        let ((s, c), (s1, c1)) = ((rate * t).sin_cos(), (rate * t + 1.0).sin_cos());
        ([7.0 * t + 3.0 * s, 2.0 * t - 2.0 * c1], [7.0 + 3.0 * rate * c, 2.0 + 2.0 * rate * s1])
    }

    fn ways(frames: usize, period: f32) -> Vec<Vector> {
        let place = |t: usize| swing(t as f32, period).0;
        (1..frames).map(|t| [0, 1].map(|c| place(t)[c] - place(t - 1)[c])).collect()
    }

    #[test]
    fn known_streaks_tell_the_exposure_though_no_frame_knows_its_velocity() {
        for (period, lambda) in [(2.6f32, 0.6f32), (3.5, 0.3), (7.0, 0.9)] {
            let course = Course::new(&ways(8, period)).unwrap();
            let streaks: Vec<Vector> =
                (0..8).map(|t| swing(t as f32, period).1.map(|v| lambda * v)).collect();
            // Without pairs only the course tells.
            let density = |exposure: f32| {
                let of = |k: &f64| {
                    let spread = k * f64::from(course.speed);
                    let covariance = course.of_streaks(f64::from(exposure), spread);
                    let factor = cholesky(&covariance, 8).unwrap();
                    let volume = 2.0 * (0..8).map(|i| libm::log(factor[9 * i])).sum::<f64>();
                    course.log_density(&streaks, exposure, spread).unwrap() - volume
                };
                SPREADS.iter().map(of).fold(f64::MIN, f64::max)
            };
            let best =
                (2..120).max_by(|&a, &b| density(0.01 * a as f32).total_cmp(&density(0.01 * b as f32)));
            let found = 0.01 * best.unwrap() as f32;
            assert!((found - lambda).abs() < 0.04, "{period}: {found} for {lambda}");
            // The mean of the ways around a frame errs by more than a tenth somewhere, if the swing is fast.
            let steps = ways(8, period);
            let mean = |t: usize| [0, 1].map(|c| 0.5 * (steps[t - 1][c] + steps[t][c]));
            let share = |t: usize| length(swing(t as f32, period).1) / length(mean(t));
            let farthest = (1..7).map(|t| (share(t) - 1.0).abs()).fold(0.0, f32::max);
            assert!(farthest > if period < 5.0 { 0.15 } else { 0.03 }, "{period}: {farthest}");
        }
    }

    #[test]
    fn two_frames_show_streaks_by_what_their_velocities_differ() {
        let seen = seen_speed;
        assert!((seen([3.0, 4.0], [0.0; 2]) - 5.0).abs() < 1e-4);
        // A streak has no sense, so the opposite velocity leaves the same.
        assert!(seen([3.0, 4.0], [3.0, 4.0]) < 1e-3 && seen([3.0, 4.0], [-3.0, -4.0]) < 1e-3);
        let turned = seen([5.0, 0.0], [0.0, 5.0]);
        assert!(turned > 5.0 && seen([5.0, 0.0], [5.5, 0.0]) < 2.5, "{turned}");
    }

    #[test]
    fn derivatives_are_those_of_a_quadratic() {
        const D: f32 = DIFFERENCE;
        let (slope, bend) = ([1.0, -2.0, 0.5, 3.0], [[4.0, 1.0, 0.0, -0.5], [1.0, 3.0, 0.5, 0.0]]);
        let bend: [[f32; K]; K] = [bend[0], bend[1], [0.0, 0.5, 2.0, 1.0], [-0.5, 0.0, 1.0, 5.0]];
        let value = |x: [f32; K]| {
            let bent =
                (0..K).flat_map(|i| (0..K).map(move |j| (i, j))).map(|(i, j)| x[i] * bend[i][j] * x[j]);
            (0..K).map(|i| slope[i] * x[i]).sum::<f32>() - 0.5 * bent.sum::<f32>()
        };
        let at = |which: &[usize], by: f32| {
            value(std::array::from_fn(|i| if which.contains(&i) { by } else { 0.0 }))
        };
        let mut f = vec![value([0.0; K])];
        (0..K).for_each(|i| f.extend([at(&[i], D), at(&[i], -D)]));
        (0..K).for_each(|i| (0..i).for_each(|j| f.extend([at(&[i, j], D), at(&[i, j], -D)])));
        let (gradient, curvature) = derivatives(&f);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(near(&gradient, &slope), "{gradient:?}");
        assert!(near(curvature.as_flattened(), bend.as_flattened()), "{curvature:?}");
    }

    #[test]
    fn frames_of_a_shaken_texture_tell_their_exposure() {
        const FRAMES: usize = 5;
        let (w, h) = (336, 240);
        let noise = crate::fit::noise::tests::white(w + 80, h + 80, 3).map(|n| n[1]);
        let octaves: Vec<_> = [1.0, 2.0, 4.0, 8.0].map(|s| filter::gaussian_blur(&noise, s)).into();
        let texture = Raster::from_fn(w + 80, h + 80, |x, y| {
            let sum: f32 = octaves.iter().zip([1.0, 2.0, 4.0, 8.0]).map(|(o, s)| s * o.at(x, y)).sum();
            [0.4 + 0.1 * sum; 3]
        });
        // The places are rounded, so that the frames are cut out of the texture without interpolation.
        let place = |t: usize| swing(t as f32, 3.0).0.map(|v| 40.0 + v.round());
        let frames = |lambda: f32| -> Vec<Encoded> {
            let blurred = |t: usize| {
                let flow = Flow::filled(w + 80, h + 80, swing(t as f32, 3.0).1);
                let whole = motion_blur(&texture, &flow, ExposureFraction(lambda)).unwrap();
                let [x, y] = place(t);
                Encoded(whole.crop(80 - x as usize, 80 - y as usize, w, h))
            };
            (0..FRAMES).map(blurred).collect()
        };
        let flow = |t: usize| Flow::filled(w, h, [0, 1].map(|c| place(t + 1)[c] - place(t)[c]));
        let linked = |frames: &[Encoded]| -> Vec<Link> {
            (0..frames.len() - 1)
                .map(|t| {
                    let ways = ways(FRAMES, 3.0);
                    let mean = |t: usize| {
                        let (a, b) = (ways[t.saturating_sub(1)], ways[t.min(FRAMES - 2)]);
                        Flow::filled(w, h, [0, 1].map(|c| 0.5 * (a[c] + b[c])))
                    };
                    let [first, second] = [mean(t), mean(t + 1)];
                    let motions: [&MotionOf; 2] = [&|x, y| first.at(x, y), &|x, y| second.at(x, y)];
                    let pair = [&frames[t], &frames[t + 1]];
                    Link::new(pair, &flow(t), motions, BlurSpace::Encoded.into()).unwrap()
                })
                .collect()
        };
        let fitted = |links: &[Link]| {
            let run = Run { links: links.iter().collect(), frames: (0..=links.len()).map(Some).collect() };
            fit_exposure(&[run], &LumaNoise::default())
        };
        let found = |frames: &[Encoded]| fitted(&linked(frames)).expect("it moves");
        for lambda in [0.4, 0.8] {
            let fit = found(&frames(lambda));
            let [low, high] = fit.interval;
            // Streaks are known to 0.4 px, about a fifteenth of the speed.
            assert!((fit.exposure.0 - lambda).abs() < 0.08, "{} for {lambda}", fit.exposure.0);
            assert!(low <= lambda && lambda <= high && high - low < 0.35, "{low} to {high} for {lambda}");
            assert_eq!(fit.per_frame.len(), FRAMES);
        }
        // A single pair has two velocities that are alike, of which pairs tell nothing.
        let alone = found(&frames(0.4)[..2]).interval;
        assert!(alone[0] < 0.05 && alone[1] > 0.95, "{alone:?}");
        // Frames of sharp things have no streaks, however they swing.
        let sharp = found(&frames(0.0));
        assert!(sharp.exposure.0 < 0.1, "{}", sharp.exposure.0);
        assert!(fit_exposure(&[], &LumaNoise::default()).is_none());
        // A pair of tiles for each two frames is too few: a texture that looks like a streak does so in all of them.
        let mut links = linked(&frames(0.4));
        links.iter_mut().for_each(|link| link.pairs.truncate(1));
        assert!(fitted(&links).is_none());
    }

    #[test]
    fn frames_in_which_other_things_move_are_not_compared() {
        let (w, h) = (336, 240);
        let texture = crate::fit::noise::tests::white(w, h, 3).map(|n| [0.5 + 0.1 * n[1]; 3]);
        let frame = Encoded(texture);
        // Something fast fills the left part of a frame, up to this share of its width, and the rest is slow.
        let filled = |share: f32| {
            let fast = move |x: usize| (x as f32) < share * w as f32;
            move |x: usize, _: usize| [if fast(x) { 24.0 } else { 3.0 }, 0.0]
        };
        let [most, less] = [filled(0.6), filled(0.4)];
        let flow = Flow::from_fn(w, h, most);
        let linked = |first: &MotionOf, second: &MotionOf| {
            Link::new([&frame, &frame], &flow, [first, second], BlurSpace::Encoded.into()).is_some()
        };
        assert!(linked(&most, &most));
        assert!(!linked(&most, &less) && !linked(&less, &most));
        // All that is slow becomes faster, as under a hand that shakes.
        let swings = |x: usize, y: usize| most(x, y).map(|v| 1.5 * v);
        assert!(linked(&most, &swings));
    }
}
