//! What successive frames tell of the times at which they were taken, as a few numbers for each frame.

use crate::analysis::cuts::{MIN_CONFIRMED, cut_between};
use crate::analysis::flow::{FlowEstimator, motion_at_frame};
use crate::fit::geometry::{enlarged, known_flow};
use crate::fit::noise::{LumaNoise, NoiseEvidence};
use crate::fit::robust::median;
use crate::fit::{likelihood, spectral, tiles};
use crate::model::{Method, Space};
use crate::{Encoded, Error, Flow, Plane, Result, Transfer, luma, pyramid, strips};
use std::ops::Range;

/// The number of cells of a frame, across and down.
const CELLS: [usize; 2] = [12, 9];
/// The largest width, px, of the halved frames in which motion and differences are measured.
const WIDTH: usize = 480;
/// The most tiles of a frame whose streaks are measured.
const TILES: usize = 100;
/// The number of pairs of frames from which the noise is measured.
const NOISE_PAIRS: usize = 24;
/// The approximate number of px of the part of a frame in which noise is measured.
const NOISE_PART: usize = 64_000;
/// One of this many values of the exposure's curve is kept.
const THINNED: usize = 5;
/// The share by which a frame lies between its neighbours, beyond which it is no mixture of both.
const BETWEEN: Range<f32> = 0.1..0.9;

/// The numbers of a frame.
pub(super) struct Seen {
    pub number: u64,
    /// Whether the frame is the first of a shot.
    pub opens: bool,
    /// What the next frame tells; `None` at the end of a shot.
    pub pair: Option<Pair>,
    /// What both neighbours tell; `None` at the ends of a shot.
    pub between: Option<Between>,
    /// The log-likelihood of exposure fractions in steps of [`STREAK_STEP`] by the streaks of this frame, if the motion between the frames
    /// goes on as evenly as the flow says; `None` if nothing tells.
    pub streaks: Option<Vec<f32>>,
}

/// The step of the exposure fractions in [`Seen::streaks`].
pub(super) const STREAK_STEP: f32 = THINNED as f32 * likelihood::EXPOSURE_STEP;

/// A frame and the next one.
pub(super) struct Pair {
    /// The median motion in each cell, px of the halved frame per frame interval; NaN where it is unknown.
    pub flow: Vec<[f32; 2]>,
    /// The mean difference in each cell, encoded values.
    pub difference: Vec<f32>,
    /// Whether enough of the frame is found again in the next one.
    pub followed: bool,
}

/// A frame and both its neighbours. The differences, encoded values, are means over the cells in which the neighbours differ most.
#[derive(Clone, Copy)]
pub(super) struct Between {
    /// The share of the next frame in the mixture of both that is nearest to this frame.
    pub share: f32,
    /// The difference to that mixture.
    pub to_blend: f32,
    /// The difference to the mean of both neighbours along the motion.
    pub to_warp: f32,
    /// The difference between both neighbours.
    pub apart: f32,
    /// The log of the finest detail, noise or texture, over the mean of that of the neighbours: the median of the cells.
    pub detail: f32,
}

/// A frame that later frames are compared with.
struct Kept {
    image: Encoded,
    /// Luma, halved.
    small: Plane,
    /// The finest detail in each cell, encoded values.
    detail: Vec<f32>,
    seen: Seen,
    /// The flow to the next frame at the frame's own size.
    flow: Option<Flow>,
    /// The flow from the frame before.
    flow_before: Option<Flow>,
}

/// Measures frame after frame.
pub(super) struct Measurer {
    space: Space,
    /// The frame before the last one, and the last one, as far as they are of the present shot.
    kept: Vec<Kept>,
    flow: FlowEstimator,
    evidence: Option<NoiseEvidence>,
    pairs: usize,
    noise: Option<LumaNoise>,
    /// The frames that are complete.
    pub seen: Vec<Seen>,
}

impl Measurer {
    /// A measurer of frames that this curve encodes.
    pub fn new(transfer: Transfer) -> Self {
        let space = Space { transfer, ..Space::default() };
        let (kept, flow, seen) = (vec![], FlowEstimator::default(), vec![]);
        Self { space, kept, flow, evidence: None, pairs: 0, noise: None, seen }
    }

    /// Takes the next frame; a frame whose number does not follow the last one's begins a new shot.
    pub fn push(&mut self, number: u64, image: Encoded) -> Result<()> {
        let size = image.0.size();
        if size.0 == 0 || size.1 == 0 {
            return Err(Error::new("the frame has no pixels"));
        }
        if let Some(last) = self.kept.last() {
            if last.image.0.size() != size {
                return Err(Error::new(
                    "the frame has another size than the one before; all must have one size",
                ));
            }
            if last.seen.number + 1 != number || cut_between(&last.image, &image)? {
                self.end_shot();
            }
        }
        let small = pyramid::halved_luma(&image.0, |w, _| w > WIDTH);
        let seen = Seen { number, opens: self.kept.is_empty(), pair: None, between: None, streaks: None };
        let mut new = Kept { small, detail: detail(&image), image, seen, flow: None, flow_before: None };
        if let Some(mut last) = self.kept.pop() {
            self.compare(&mut last, &mut new)?;
            if let Some(first) = self.kept.pop() {
                last.seen.between = Some(self.between(&first, &last, &new)?);
                self.seen.push(first.seen);
            }
            self.look_at_streaks(&mut last);
            self.kept.push(last);
        }
        self.kept.push(new);
        Ok(())
    }

    /// Completes the frames of a shot.
    pub fn end_shot(&mut self) {
        self.seen.extend(self.kept.drain(..).map(|kept| kept.seen));
    }

    fn compare(&mut self, last: &mut Kept, new: &mut Kept) -> Result<()> {
        let (a, b) = (&last.small, &new.small);
        let pair = self.flow.flow_with_occlusion(a, b)?;
        let followed = pair.confirmed() >= MIN_CONFIRMED;
        let flow = known_flow(&pair, a, b);
        last.seen.pair = Some(Pair {
            flow: of_cells(a.size(), |x, y| median_flow(&flow, x, y)),
            difference: mean_of_cells(a.size(), |x, y| (b.at(x, y) - a.at(x, y)).abs()),
            followed,
        });
        if followed {
            let size = last.image.0.size();
            let flow = enlarged(flow, size, Flow::filled(0, 0, [0.0; 2]));
            self.measure_noise(&last.image, &new.image, &flow)?;
            new.flow_before = Some(flow.clone());
            last.flow = Some(flow);
        }
        Ok(())
    }

    fn measure_noise(&mut self, frame: &Encoded, next: &Encoded, flow: &Flow) -> Result<()> {
        if self.pairs == NOISE_PAIRS {
            return Ok(());
        }
        let size = frame.0.size();
        // Of more turns than there are pairs, some are left out evenly.
        let turns = strips::turns_of(size, NOISE_PART);
        let rows = strips::rows_in_turn(self.pairs * turns.max(NOISE_PAIRS) / NOISE_PAIRS, turns, size.1);
        let transfer = self.space.transfer;
        let new = || NoiseEvidence::new(Method::Temporal).encoded_by(transfer);
        let evidence = self.evidence.get_or_insert_with(new);
        evidence.add_pair_rows(frame, next, flow, rows)?;
        self.pairs += 1;
        self.noise = evidence.fit().luma.or(self.noise);
        Ok(())
    }

    fn between(&mut self, first: &Kept, middle: &Kept, last: &Kept) -> Result<Between> {
        let (a, m, b) = (&first.small, &middle.small, &last.small);
        let size = m.size();
        let (mut product, mut square) = (0.0f64, 0.0f64);
        for ((a, m), b) in a.data().iter().zip(m.data()).zip(b.data()) {
            product += f64::from((m - a) * (b - a));
            square += f64::from((b - a) * (b - a));
        }
        let share = if square > 0.0 { (product / square) as f32 } else { 0.5 };
        let mix = share.clamp(0.0, 1.0);
        let pair = self.flow.flow_with_occlusion(a, b)?;
        // The motion through the middle frame's pixel: the errors of place of both flows cancel.
        let warped = |x: usize, y: usize| {
            let ([u, v], [p, q]) = (pair.forward.at(x, y), pair.backward.at(x, y));
            let (u, v) = (0.25 * (u - p), 0.25 * (v - q));
            let (x, y) = (x as f32, y as f32);
            0.5 * (a.bilinear(x - u, y - v) + b.bilinear(x + u, y + v))
        };
        let apart = mean_of_cells(size, |x, y| (b.at(x, y) - a.at(x, y)).abs());
        let most = largest(&apart);
        let difference = |of: &(dyn Fn(usize, usize) -> f32 + Sync)| {
            mean_of(&mean_of_cells(size, |x, y| (m.at(x, y) - of(x, y)).abs()), &most)
        };
        let detail = (0..middle.detail.len()).map(|c| {
            let [first, own, last] = [first, middle, last].map(|k| k.detail[c].max(1e-5));
            (own / (first * last).sqrt()).ln()
        });
        Ok(Between {
            share,
            to_blend: difference(&|x, y| a.at(x, y) + mix * (b.at(x, y) - a.at(x, y))),
            to_warp: difference(&warped),
            apart: mean_of(&apart, &most),
            detail: median(detail.collect()).unwrap_or(0.0),
        })
    }

    fn look_at_streaks(&self, kept: &mut Kept) {
        let (Some(flow), Some(before), Some(noise)) = (&kept.flow, &kept.flow_before, &self.noise) else {
            return;
        };
        let motion = motion_at_frame(flow, before);
        let of = |x: usize, y: usize| motion.at(x, y);
        let corners = tiles::corners(kept.image.0.size()).into_iter();
        let chosen = tiles::of_most_contrast(&kept.image, corners, 1, Some(&of), None, TILES);
        let tiles = tiles::tiles_at(&kept.image, &chosen, 1, Some(&of), None, self.space);
        let found = spectral::exposure_observations(&[&tiles], noise);
        if found.len() < FEWEST_STREAKS {
            return;
        }
        let curve = |i: usize| found.iter().map(|w| w.log_likelihood[i * THINNED]).sum();
        kept.seen.streaks = Some((0..=(likelihood::EXPOSURES - 1) / THINNED).map(curve).collect());
    }
}

/// The fewest tiles that tell of a frame's streaks.
const FEWEST_STREAKS: usize = 6;

impl Between {
    /// Whether the nearest mixture has a share of both neighbours.
    pub fn is_mixed(&self) -> bool {
        BETWEEN.contains(&self.share)
    }
}

/// The cells, a quarter of all, of the largest values.
pub(super) fn largest(values: &[f32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
    order.truncate(values.len() / 4);
    order
}

/// The mean over some of the cells.
pub(super) fn mean_of(values: &[f32], cells: &[usize]) -> f32 {
    cells.iter().map(|&c| values[c]).sum::<f32>() / cells.len().max(1) as f32
}

/// A value for each cell, row by row, by its columns and rows.
fn of_cells<T>((w, h): (usize, usize), of: impl Fn(Range<usize>, Range<usize>) -> T) -> Vec<T> {
    let range =
        |i: usize, n: usize, size: usize| i * size / n..((i + 1) * size / n).max(i * size / n + 1).min(size);
    let cells = (0..CELLS[1]).flat_map(|j| (0..CELLS[0]).map(move |i| (i, j)));
    cells.map(|(i, j)| of(range(i, CELLS[0], w), range(j, CELLS[1], h))).collect()
}

fn mean_of_cells(size: (usize, usize), of: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    of_cells(size, |columns, rows| {
        let count = (columns.len() * rows.len()).max(1) as f32;
        rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| of(x, y)).sum::<f32>() / count
    })
}

/// The median flow, NaN if it is known in less than half of the cell.
fn median_flow(flow: &Flow, columns: Range<usize>, rows: Range<usize>) -> [f32; 2] {
    let all = rows.step_by(2).flat_map(|y| columns.clone().step_by(2).map(move |x| flow.at(x, y)));
    let (mut count, mut known) = (0, vec![]);
    for f in all {
        count += 1;
        if f[0].is_finite() {
            known.push(f);
        }
    }
    if 2 * known.len() < count {
        return [f32::NAN; 2];
    }
    [0, 1].map(|c| median(known.iter().map(|f| f[c]).collect()).unwrap_or(f32::NAN))
}

/// The mean in each cell of what is finer than any even slope: the second difference along x and y of luma (Immerkaer 1996), scaled to the
/// std of white noise.
fn detail(Encoded(image): &Encoded) -> Vec<f32> {
    /// The approximate number of pixels that are looked at.
    const SAMPLES: usize = 60_000;
    let (w, h) = image.size();
    if w < 3 || h < 3 {
        return vec![0.0; CELLS[0] * CELLS[1]];
    }
    let second = |x: usize, y: usize| {
        let column = |x: usize| {
            let at = |y: usize| luma(image.at(x, y));
            at(y - 1) - 2.0 * at(y) + at(y + 1)
        };
        (column(x - 1) - 2.0 * column(x) + column(x + 1)).abs()
    };
    let scale = std::f32::consts::FRAC_PI_2.sqrt() / 6.0;
    mean_at_some((w, h), SAMPLES, 1, second).into_iter().map(|mean| scale * mean).collect()
}

/// The mean in each cell over some of the pixels, about `samples` in the whole frame, at least `margin` px away from the frame's edges; 0 in a
/// cell that has none.
pub(super) fn mean_at_some(
    (w, h): (usize, usize),
    samples: usize,
    margin: usize,
    of: impl Fn(usize, usize) -> f32,
) -> Vec<f32> {
    let step = (w * h / samples).max(1);
    of_cells((w, h), |columns, rows| {
        let (mut sum, mut count) = (0.0, 0);
        for y in rows.start.max(margin)..rows.end.min(h - margin) {
            // The samples of a row lie elsewhere than those of the row above.
            let first = columns.start.max(margin) + (y * 7) % step;
            for x in (first..columns.end.min(w - margin)).step_by(step) {
                sum += of(x, y);
                count += 1;
            }
        }
        sum / count.max(1) as f32
    })
}
