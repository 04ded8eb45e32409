//! The noise from frame to frame.

use super::memory::walked;
use crate::fit::distant::DistantPairs;
use crate::fit::geometry::Follower;
use crate::fit::noise::{LumaNoise, NoiseEvidence, NoiseLine, UNSEEN_STD};
use crate::fit::robust::median;
use crate::fit::sharpening;
use crate::model::{Changes, Distortion, DistortionModel, Estimate, Method, NoiseModel, SharpeningModel};
use crate::portable::Portable;
use crate::{Encoded, Flow, Result, Transfer, strips};
use std::collections::VecDeque;
use std::ops::Range;

/// The number of frames that the noise is estimated from: more than two of a coder's usual groups of pictures.
const FRAMES: usize = 48;
/// The number of blocks of each level that the noise's curves go through: a third of what a whole clip's do, since there is a fit for each
/// frame, and what is told is a mean over frames.
const BLOCKS: usize = 2000;
/// The most pairs of distant frames that the noise of compressed footage is estimated from.
const PAIRS: usize = 4;
/// The number of frames of a shot after which the noise is no longer that of the kinds of frames that a coder begins with.
const SETTLED: usize = 24;
/// The share of a frame's new estimate of the noise in what is told, unless the noise has jumped: the estimates of successive frames look at
/// different parts of the picture, and noise that differs from frame to frame would be seen to flicker.
const NEW: f32 = 0.2;
/// The same once the noise has settled.
const NEW_SETTLED: f32 = 0.03;
/// The relative std, per frame, of the random walk of noise that is not seen.
const WALK: f32 = 0.01;
/// The approximate number of px of the part of a frame in which noise is measured.
const PART: usize = 64_000;
/// The least share of a change of what successive frames differ by that must show in compressed frames themselves. A coder that renews less
/// changes nothing of them. In clips by nine coders, 38 of 51 real changes showed by more, and 15 of 20 false ones by less.
const SHOWN: f32 = 0.05;

/// The noise's evidence, and the last known noise and sharpening.
pub(super) struct NoiseFollower {
    /// The curve that encodes the frames.
    transfer: Transfer,
    memory: NoiseMemory,
    distant: DistantPairs,
    /// The noise of luma, which outlasts a cut: some noise is needed to look at a shot's first frames.
    pub luma: Option<LumaNoise>,
    known: Option<NoiseModel>,
    /// [`NoiseFit::shared_spread`](crate::fit::noise::NoiseFit::shared_spread) of the last noise.
    pub shared_spread: f32,
    /// The part of it that is due to a coder: [`NoiseFit::coding_spread`](crate::fit::noise::NoiseFit::coding_spread).
    pub coding_spread: f32,
    /// Whether a coder copied much of the last frames.
    copied: bool,
    /// The sharpening, which shows in noise between frames; `None` if none was seen in this shot.
    pub sharpening: Option<Estimate<SharpeningModel>>,
}

impl NoiseFollower {
    /// Nothing seen yet of frames that are encoded by this curve.
    pub fn new(transfer: Transfer) -> Self {
        let (memory, distant) = (NoiseMemory::default(), DistantPairs::new(PAIRS, 0, transfer));
        Self {
            transfer,
            memory,
            distant,
            luma: None,
            known: None,
            shared_spread: 0.0,
            coding_spread: 0.0,
            copied: false,
            sharpening: None,
        }
    }

    /// The noise with the frame of this index, which repeats so many frames before it (`repeated`), and what has changed of noise and
    /// sharpening. `neighbour` is the frame next to it, with the flow that leads there.
    ///
    /// # Errors
    /// If a frame is not finite, or sizes differ.
    pub fn follow(
        &mut self,
        (index, frame, repeated): (usize, &Encoded, usize),
        neighbour: Option<(&Encoded, &Flow)>,
        follower: &mut Follower,
    ) -> Result<(Estimate<NoiseModel>, Changes)> {
        let mut changes = Changes::default();
        let mut evidence = NoiseEvidence::new(Method::Temporal).encoded_by(self.transfer);
        let (w, h) = frame.0.size();
        let parts = strips::turns_of((w, h), PART);
        // Strips of the frame are used in turn.
        let part = index % parts;
        if let Some((other, flow)) = neighbour {
            evidence.add_pair_rows(frame, other, flow, strips::rows_in_turn(part, parts, h))?;
        }
        let coded = self.copied || self.luma.is_some_and(|n| n.may_be_compressed());
        let own = if coded { own_std(frame, strips::rows_in_turn(parts / 2, parts, h)) } else { None };
        let model = self.luma.unwrap_or_default().levels[0];
        let seen = Seen { before: self.memory.shown, evidence, part, own };
        let jumped = self.memory.push(seen, repeated, &model);
        changes.set(Distortion::Noise, jumped);
        if jumped {
            self.distant.forget();
        }
        let near = self.memory.middle(&model);
        self.copied = near.is_copied();
        // Distant frames are compared seldom, so a larger part of them.
        let turns = (w * h).div_ceil(4 * PART).min((h / 64).max(1));
        self.distant.push((index, frame), |_| coded, follower, turns)?;
        if coded {
            self.distant.begin_with(frame);
        }
        let mut fit = self.distant.complete(&near, near.fit_to(BLOCKS));
        if fit.luma.is_none() && self.known.is_none() {
            let alone = NoiseEvidence::of_frame(frame).encoded_by(self.transfer);
            fit = alone.fit().with_coding_spread(fit.coding_spread);
        }
        self.luma = fit.luma.or(self.luma);
        let Some(fresh) = fit.model.known() else {
            let told = match &self.known {
                Some(noise) => Estimate::Known(walked_noise(noise, self.memory.age)),
                None => fit.model,
            };
            return Ok((told, changes));
        };
        (self.shared_spread, self.coding_spread) = (fit.shared_spread(), fit.coding_spread);
        let mut told = fresh.clone();
        if fresh.method() == Method::Temporal {
            // Between straight lines and curves there is no mean.
            let poorer = |before: &&NoiseModel| before.curves().is_none() && fresh.curves().is_some();
            if let Some(before) = self.known.as_ref().filter(|before| !jumped && !poorer(before)) {
                let settled = self.memory.frames.len() >= SETTLED;
                told = before.between(fresh, if settled { NEW_SETTLED } else { NEW });
            }
            self.known = Some(told.clone());
            let fresh = sharpening::of_noise(&fit);
            let before = self.sharpening.as_ref().and_then(Estimate::known);
            let jumped = before.zip(fresh.known()).is_some_and(|(a, b)| {
                // The amount has jumped if the intervals do not overlap.
                a.interval[1] < b.interval[0] || b.interval[1] < a.interval[0]
            });
            changes.set(Distortion::Sharpening, jumped);
            self.sharpening = Some(fresh);
        }
        // Noise of a single frame is this frame's own.
        let age = if told.method() == Method::Temporal { self.memory.age } else { 0 };
        Ok((Estimate::Known(walked_noise(&told, age)), changes))
    }

    /// Forgets all but the noise of luma: another shot may be another camera's.
    pub fn forget(&mut self) {
        *self = Self { luma: self.luma, ..Self::new(self.transfer) };
    }

    /// Whether the noise rests on so few frames of this shot, or since it changed, that those to come will correct it.
    pub fn settles(&self) -> bool {
        self.memory.seen < SETTLED
    }

    /// The number of frames, copies too, from the first one whose noise counts up to the last one: at a change, of those since it.
    pub fn reach(&self) -> usize {
        self.memory.frames.front().map_or(0, |first| self.memory.shown - first.before)
    }
}

/// The local variances of the last frames that gave evidence of noise.
///
/// In footage that was compressed, the noise differs from frame to frame with the kind of each frame, while the camera stays the same. So
/// the noise is that of the frames in the middle, and a change is one of all kinds of frames.
#[derive(Default)]
struct NoiseMemory {
    /// Up to [`FRAMES`] frames.
    frames: VecDeque<Seen>,
    /// The number of frames since the last evidence.
    age: usize,
    /// The number of frames that were looked at since the shot's begin, or since the first one after its last change.
    seen: usize,
    /// The number of frames of the shot, copies too, up to the last one that was looked at.
    shown: usize,
}

/// What was seen of the noise in a frame.
struct Seen {
    /// The number of frames of the shot, copies too, before this one and what it repeats.
    before: usize,
    /// The difference between a part of the frame and the next frame.
    evidence: NoiseEvidence,
    /// The index of the part of the picture.
    part: usize,
    /// The [`own_std`] of a frame of compressed footage.
    own: Option<f32>,
}

impl NoiseMemory {
    /// Adds what was seen of the noise in a frame, which repeats so many frames before it, and says whether the noise has changed. The frames
    /// are compared with each other by how much their noise exceeds that of `model`.
    fn push(&mut self, seen: Seen, repeated: usize, model: &NoiseLine) -> bool {
        self.age += 1;
        self.seen += 1;
        self.shown += 1 + repeated;
        if seen.evidence.log_ratio(model).is_none() {
            return false;
        }
        self.age = 0;
        self.frames.push_back(seen);
        if self.frames.len() > FRAMES {
            self.frames.pop_front();
        }
        let changed = noise_changed(&self.excesses(model), |change| self.shows(change));
        if let Some(Change { since, .. }) = changed {
            self.frames.drain(..self.frames.len() - since);
            self.seen = since;
        }
        changed.is_some()
    }

    /// Whether a change of what successive frames differ by shows in the frames themselves, if they were compressed.
    fn shows(&self, change: &Change) -> bool {
        /// The fewest frames before the change that it is held against: those long before show other things.
        const BEFORE: usize = 8;
        let first = self.frames.len() - change.since;
        // The median, if most frames were compressed.
        let own = |frames: Range<usize>| {
            let all: Vec<f32> = self.frames.range(frames.clone()).filter_map(|s| s.own).collect();
            if 2 * all.len() >= frames.len() { median(all) } else { None }
        };
        let before = own(first.saturating_sub(change.since.max(BEFORE))..first);
        let Some(now) = own(first..self.frames.len()) else { return true };
        before.is_some_and(|before| (now - before) / change.shift >= SHOWN)
    }

    /// The log of each frame's noise std over that of `model`, and the index of the frame's part.
    fn excesses(&self, model: &NoiseLine) -> Vec<Excess> {
        // What cannot be seen says nothing of a camera.
        let least = (UNSEEN_STD / (0.4 * model.slope + model.intercept).max(1e-4)).portable_ln();
        let of = |seen: &Seen| Excess {
            part: seen.part,
            log: seen.evidence.log_ratio(model).unwrap_or(least).max(least),
        };
        self.frames.iter().map(of).collect()
    }

    /// The evidence of the frames in the middle: the half of each part's frames whose noise differs least from the part's median, and all that
    /// differ by no more than [`LIKE_MEDIAN`].
    fn middle(&self, model: &NoiseLine) -> NoiseEvidence {
        let excesses = self.excesses(model);
        let apart = apart(&excesses, &excesses);
        let mut sorted: Vec<f32> = apart.iter().map(|v| v.abs()).collect();
        sorted.sort_by(f32::total_cmp);
        let most = sorted.get(sorted.len() / 2).map_or(LIKE_MEDIAN, |m| m.max(LIKE_MEDIAN));
        let mut all = NoiseEvidence::new(Method::Temporal);
        let middle = self.frames.iter().zip(&apart).filter(|(_, apart)| apart.abs() <= most);
        middle.for_each(|(seen, _)| all.merge(&seen.evidence));
        all
    }
}

/// The log of the std of luma's finest level in these rows of a frame, where the frame has least texture: of noise, and what texture there is.
/// `None` if there are too few such parts.
fn own_std(frame: &Encoded, rows: Range<usize>) -> Option<f32> {
    let strip = Encoded(frame.0.crop(0, rows.start, frame.0.width(), rows.len()));
    NoiseEvidence::of_frame(&strip).log_ratio(&NoiseLine { slope: 0.0, intercept: 1.0 })
}

/// By how much the noise of a frame exceeds a model's.
#[derive(Clone, Copy)]
struct Excess {
    /// The index of the part of the picture.
    part: usize,
    /// The log of the ratio of the stds.
    log: f32,
}

/// The difference of the logs of noise stds of frames that count as alike.
const LIKE_MEDIAN: f32 = 0.15;

/// The differences of some frames from the median of the others that are about the same part of the picture, or of all others if none is.
fn apart(some: &[Excess], others: &[Excess]) -> Vec<f32> {
    let of = |e: &Excess| {
        let same = |o: &&Excess| o.part == e.part;
        let median = median(others.iter().filter(same).map(|o| o.log).collect())
            .or_else(|| median(others.iter().map(|o| o.log).collect()));
        e.log - median.unwrap_or(e.log)
    };
    some.iter().map(of).collect()
}

/// A change of the noise.
struct Change {
    /// The number of frames since then.
    since: usize,
    /// The difference of the logs of the stds.
    shift: f32,
}

/// The change of the noise from some frames to those after them, if there is one that `shows`.
///
/// Either the last few frames all lie beyond the whole range of those before, or the median of the last dozen is away from that of those
/// before by much more than both scatter. A dozen frames are those of a coder's usual group of pictures, or half of it.
fn noise_changed(frames: &[Excess], shows: impl Fn(&Change) -> bool) -> Option<Change> {
    /// The numbers of last frames: a few, and a dozen.
    const LAST: [usize; 2] = [5, 12];
    /// The fewest and the most frames before these that they are compared with.
    const BEFORE: (usize, usize) = (12, 36);
    /// How far beyond the range of those before the few must lie, as a difference of logs of stds.
    const BEYOND: f32 = 0.1;
    /// The least difference of the medians that is a change, as a difference of logs of stds, and as a multiple of its standard error.
    const SHIFT: (f32, f32) = (0.3, 4.5);
    /// The share of the dozen that must lie on the same side.
    const SAME_SIDE: f32 = 0.8;
    /// The largest drift within the frames before, as a share of the shift, that lets the shift be a jump: what drifts is followed anyway.
    const DRIFT: f32 = 0.5;
    /// The least std by which frames scatter, as a difference of logs of stds.
    const SCATTER: f32 = 0.03;
    LAST.into_iter().find_map(|last| {
        let first = frames.len().checked_sub(last)?;
        let before = &frames[first.saturating_sub(BEFORE.1)..first];
        if before.len() < BEFORE.0 {
            return None;
        }
        let (now, usual) = (apart(&frames[first..], before), apart(before, before));
        let middle = |v: &[f32]| median(v.to_vec()).unwrap_or(0.0);
        let shift = middle(&now);
        let shown = Some(Change { since: last, shift }).filter(&shows);
        // Some of these frames may be older than the change.
        let change = shown.map(|change| Change { since: changed_since(&now, shift), ..change });
        let (early, late) = usual.split_at(usual.len() / 2);
        if (middle(late) - middle(early)).abs() > DRIFT * shift.abs() {
            return None;
        }
        if last == LAST[0] {
            let beyond = |sign: f32| {
                let most = usual.iter().map(|v| sign * v).fold(0.0, f32::max);
                now.iter().all(|v| sign * v > most + BEYOND)
            };
            return change.filter(|_| beyond(1.0) || beyond(-1.0));
        }
        // The median absolute deviation of normal numbers is their std over 1.48; the median of n has 1.25 times the error of the mean.
        let scatter = (1.48 * middle(&usual.iter().map(|v| v.abs()).collect::<Vec<_>>())).max(SCATTER);
        let error = 1.25 * scatter * (1.0 / last as f32 + 1.0 / usual.len() as f32).sqrt();
        let same_side = now.iter().filter(|v| *v * shift > 0.0).count() as f32;
        change.filter(|_| shift.abs() > SHIFT.0.max(SHIFT.1 * error) && same_side >= SAME_SIDE * last as f32)
    })
}

/// The number of last values that belong to the new noise: those before them are nearest to 0, and they to `shift`. They are at least half of
/// all.
fn changed_since(values: &[f32], shift: f32) -> usize {
    let cost = |old: usize| -> f32 {
        let (before, after) = values.split_at(old);
        before.iter().map(|v| v.abs()).chain(after.iter().map(|v| (v - shift).abs())).sum()
    };
    let oldest = (0..=values.len() / 2).min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
    values.len() - oldest.unwrap_or(0)
}

fn walked_noise(noise: &NoiseModel, age: usize) -> NoiseModel {
    let mut walked_noise = noise.clone();
    let noise = walked_noise.lines_mut();
    for (level, interval) in noise.levels.iter().zip(noise.interval.iter_mut().flatten()) {
        for c in 0..3 {
            let step = WALK * level.intercept[c];
            interval.intercept[c] = walked(interval.intercept[c], level.intercept[c], step, age);
            let reach = 1.96 * WALK * level.slope[c].abs() * (age as f32).sqrt();
            let [low, high] = interval.slope[c];
            let side = |deviation: f32| deviation.max(0.0).portable_hypot(reach);
            interval.slope[c] =
                [level.slope[c] - side(level.slope[c] - low), level.slope[c] + side(high - level.slope[c])];
        }
    }
    walked_noise
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::noise::tests::white;
    use crate::{Plane, Raster};

    #[test]
    fn a_change_lies_where_the_values_jump() {
        let jump = |old: usize| -> Vec<f32> {
            (0..12).map(|i| if i < old { 0.0 } else { 0.5 } + 0.06 * (i as f32).sin()).collect()
        };
        for old in 0..=5 {
            assert_eq!(changed_since(&jump(old), 0.5), 12 - old);
        }
        // Never less than the half of all values.
        assert_eq!(changed_since(&jump(9), 0.5), 6);
        assert_eq!(changed_since(&[0.5, 0.4, 0.6, 0.5, 0.5], 0.5), 5);
    }

    #[test]
    fn a_coder_that_renews_less_is_no_change_of_the_noise_and_less_noise_is() {
        const FALLS: usize = 30;
        // The noise of each frame has a correlation with that of the frame before it, and a std.
        let changes = |shared: &dyn Fn(usize) -> f32, std: &dyn Fn(usize) -> f32, compressed: bool| {
            let (w, h) = (128, 96);
            let mut noise = Plane::filled(w, h, 0.0);
            let mut frame = |t: usize| {
                let (new, r) = (white(w, h, t as u64), if t == 0 { 0.0 } else { shared(t) });
                let before = std::mem::replace(&mut noise, Plane::filled(0, 0, 0.0));
                noise = Raster::from_fn(w, h, |x, y| {
                    r * before.at(x, y) + (1.0 - r * r).sqrt() * new.at(x, y)[1]
                });
                let std = std(t);
                Encoded(noise.map(|v| [0.5 + std * v; 3]))
            };
            let (mut memory, flow) = (NoiseMemory::default(), Flow::filled(w, h, [0.0; 2]));
            let mut last = frame(0);
            let mut changes: Vec<usize> = vec![];
            for t in 1..FALLS + 20 {
                let next = frame(t);
                let mut evidence = NoiseEvidence::new(Method::Temporal);
                evidence.add_pair(&last, &next, &flow).unwrap();
                let own = if compressed { own_std(&last, 0..h) } else { None };
                let model = NoiseLine { slope: 0.0, intercept: 0.01 };
                if memory.push(Seen { before: memory.shown, evidence, part: 0, own }, 0, &model) {
                    changes.push(t - 1);
                }
                last = next;
            }
            changes
        };
        let falls = |from: f32, to: f32| move |t: usize| if t < FALLS { from } else { to };
        let copied = falls(0.0, 0.95);
        assert!(changes(&copied, &|_| 0.02, true).is_empty());
        // Of footage that was not compressed, what successive frames differ by is the noise.
        assert_eq!(changes(&copied, &|_| 0.02, false).len(), 1);
        let found = changes(&|_| 0.0, &falls(0.02, 0.01), true);
        assert!(found.len() == 1 && (FALLS..FALLS + 6).contains(&found[0]), "{found:?}");
    }

    #[test]
    fn kinds_of_frames_are_no_change_of_the_noise_and_a_gain_is() {
        // Two parts of the picture in turn, scatter of a std of 0.2, and a frame of another kind in every twelfth place.
        let frame = |t: usize, gain: f32, scatter: f32| {
            let noise: f32 = (0..6).map(|k| crate::fit::uniform(7 + k, t as u64) - 0.5).sum();
            let kind = if t.is_multiple_of(12) { 1.0 } else { 0.0 };
            let part = t % 2;
            Excess { part, log: gain + 0.5 * part as f32 + scatter * (kind + 0.2 * 1.41 * noise) }
        };
        let noticed = |gain: &dyn Fn(usize) -> f32, scatter: f32| -> Vec<usize> {
            let all: Vec<Excess> = (0..400).map(|t| frame(t, gain(t), scatter)).collect();
            (1..=all.len())
                .filter(|&n| noise_changed(&all[n.saturating_sub(FRAMES)..n], |_| true).is_some())
                .map(|n| n - 1)
                .collect()
        };
        assert!(noticed(&|_| 0.0, 1.0).is_empty());
        // What drifts is no jump either.
        assert!(noticed(&|t| 0.004 * t as f32, 1.0).is_empty());
        for factor in [1.7f32, 1.0 / 1.7] {
            let jump = |t: usize| if t < 200 { 0.0 } else { factor.ln() };
            let found = noticed(&jump, 1.0);
            assert!(found.first().is_some_and(|t| (200..230).contains(t)), "{factor}: {found:?}");
            // Without a coder it is found at once.
            let found = noticed(&jump, 0.1);
            assert!(found.first().is_some_and(|t| (202..206).contains(t)), "{factor}: {found:?}");
        }
    }
}
