//! The mean noise of the frames around each frame of a clip, and which of its changes stand.

use blindaug::{
    fit::noise::UNSEEN_STD,
    luma,
    model::{Estimate, GREYS, NoiseModel},
};
use std::collections::VecDeque;
use std::ops::Range;

/// The number of frames before and after a frame over which its noise is a mean: as many as the tracker measures noise in.
const NEAR: usize = 48;
/// The number of frames before and after a frame up to which its noise is a mean with theirs, where it is the same within its intervals. What
/// is told of a steady clip that was compressed wanders by more than a half within a few seconds.
const FAR: usize = 480;
/// The distance between the frames up to [`FAR`] whose means count: those of frames next to each other rest on the same frames.
const STEP: usize = 24;
/// The number of frames after a change of the noise that tell whether it stands.
const AFTER: usize = 96;
/// The least difference of the logs of the stds before and after a change that stands. Of changes that the tracker told in coded clips, those
/// of steady clips differed by up to 0.17, and real ones, to 1.6 times the std, by 0.22 to 1.0, but for two of twenty.
const CHANGE: f32 = 0.2;

/// A weight that falls from 1 to 0 as `x` grows to 1, most of it near there.
fn taper(x: f32) -> f32 {
    (1.0 - x.powi(8)).max(0.0)
}

/// A mean noise.
struct Mean {
    noise: NoiseModel,
    /// [`Told::shared_spread`].
    shared_spread: f32,
    /// The mean over [`GREYS`] of the log of the std, and by how much the ends of its interval differ from that.
    log: f32,
    ends: [f32; 2],
}

impl Mean {
    fn new(noise: NoiseModel, shared_spread: f32) -> Self {
        // What cannot be seen is alike.
        let log = |std: [f32; 3]| luma(std).max(UNSEEN_STD).ln();
        let mean = |of: &dyn Fn(f32) -> f32| GREYS.map(of).iter().sum::<f32>() / GREYS.len() as f32;
        let end = |end: usize| mean(&|y| log(noise.interval_of_total_std(y)[end]) - log(noise.total_std(y)));
        Self {
            log: mean(&|y| log(noise.total_std_over([y; 3]))),
            ends: [0, 1].map(end),
            noise,
            shared_spread,
        }
    }

    /// The log of the ratio of another noise's std to this one's.
    fn distance(&self, other: &Self) -> f32 {
        other.log - self.log
    }

    /// How sure it is that two noises are the same, from 0, where neither lies in the other's interval, to 1, where they are equal.
    fn likeness(&self, other: &Self) -> f32 {
        let of = |a: &Self, b: &Self| match a.distance(b) {
            0.0 => 1.0,
            distance => taper(distance / a.ends[usize::from(distance > 0.0)]),
        };
        of(self, other).max(of(other, self))
    }
}

/// The mean of each frame's noise and that of the frames around it, between two cuts or changes of the noise.
///
/// The noise of a shot's first frames, and of those after a change, is not settled, and counts in no mean: these frames have that of the frames
/// next to them.
#[derive(Default)]
pub(super) struct NoiseAround {
    /// What the tracker told of the last frames.
    told: VecDeque<Told>,
    /// The means over the frames next to each of the first frames of `told`; `None` where the noise is unknown.
    near: VecDeque<Option<Mean>>,
    /// The indices in `told` of the first frames after changes of which it is not known yet whether they stand, in order.
    changes: VecDeque<usize>,
    /// Whether the first frame of `told` is the first one after a change that stands.
    after_change: bool,
    /// The number of frames of `told` whose noise was given.
    given: usize,
}

/// What the tracker told of a frame's noise.
#[derive(Clone)]
pub(super) struct Told {
    /// The noise, and the std of the logarithm of the factor by which that of all frames is off alike (`Tracker::noise_of_frames`).
    pub(super) noise: Estimate<NoiseModel>,
    pub(super) shared_spread: f32,
    /// Whether it rests on so many frames that those to come will not correct it.
    pub(super) settled: bool,
}

/// The noise of a frame in the end.
#[derive(Debug, PartialEq)]
pub(super) struct FrameNoise {
    /// The mean noise; `None` where it is unknown.
    pub(super) mean: Option<NoiseModel>,
    /// Whether the noise has changed since the frame before.
    pub(super) changed: bool,
}

impl NoiseAround {
    /// Takes the noise of the next frame.
    pub(super) fn push(&mut self, told: Told) {
        self.told.push_back(told);
    }

    /// Takes note that the noise has changed, to `new`: the next frame has it, and the `late` frames before that, of which none may have been
    /// given its noise.
    pub(super) fn change(&mut self, late: usize, new: &Told) {
        let first = self.told.len().saturating_sub(late);
        // A change that was noticed before, but is not older, is the same one.
        self.changes.retain(|&change| change < first);
        self.changes.push_back(first);
        self.near.truncate(first.saturating_sub(NEAR));
        self.told.range_mut(first..).for_each(|told| *told = Told { settled: false, ..new.clone() });
    }

    /// The noise of the frames, in their order, that was not given so far and will not change any more: of all of them if this is the end
    /// (`ends`), after which another shot begins.
    pub(super) fn known(&mut self, ends: bool) -> Vec<FrameNoise> {
        let mut known = vec![];
        while let Some(&change) = self.changes.front()
            && (ends || self.told.len() >= change + AFTER)
        {
            self.changes.pop_front();
            if self.stands(change) {
                self.give(change, true, &mut known);
                self.forget(change);
                self.after_change = true;
            }
        }
        let decided = self.changes.front().copied().unwrap_or(self.told.len());
        self.give(decided, ends, &mut known);
        if ends {
            *self = Self::default();
        } else {
            self.forget(self.given.saturating_sub(NEAR + FAR) / STEP * STEP);
        }
        known
    }

    /// Whether the noise before this change and after it differ as much as if it were one.
    fn stands(&self, change: usize) -> bool {
        // Only up to the next change.
        let end =
            self.changes.front().copied().unwrap_or(usize::MAX).min(change + AFTER).min(self.told.len());
        let before = change.checked_sub(1).and_then(|last| self.mean(last, 0..change));
        let after = self.mean((change + NEAR).min(end - 1), change..end);
        before.zip(after).is_none_or(|(before, after)| before.distance(&after).abs() >= CHANGE)
    }

    /// Gives the noise of the frames before the one of index `end` that is known: of all of them if nothing after it counts (`ends`).
    fn give(&mut self, end: usize, ends: bool, known: &mut Vec<FrameNoise>) {
        let sure = if ends { end } else { end.saturating_sub(NEAR) };
        while self.near.len() < sure && (ends || !self.settles(self.near.len(), end)) {
            let mean = self.mean(self.near.len(), 0..end);
            self.near.push_back(mean);
        }
        let sure = if ends { end } else { self.near.len().saturating_sub(FAR) };
        while self.given < sure {
            let (frame, mean) = (self.given, self.far(self.given));
            known.push(FrameNoise { mean, changed: frame == 0 && std::mem::take(&mut self.after_change) });
            self.given += 1;
        }
    }

    /// Whether the mean next to frame `at` waits for frames that are still to come, since none before the one of index `end` tells it: noise
    /// settles over the pictures that are looked at, which copies delay. Once it has settled, it stays so up to the next change.
    fn settles(&self, at: usize, end: usize) -> bool {
        let mut next = self.told.range(at.saturating_sub(NEAR)..end.min(at + NEAR + 1));
        !self.told[end - 1].settled && next.all(|told| !told.settled)
    }

    /// The mean of the noise of the frames of a stretch that lie next to frame `at`; `None` if that is unknown.
    fn mean(&self, at: usize, stretch: Range<usize>) -> Option<Mean> {
        let next = at.saturating_sub(NEAR).max(stretch.start)..stretch.end.min(at + NEAR + 1);
        let settled = |i: &usize| self.told[*i].settled;
        let nearest = next.clone().filter(settled).min_by_key(|i| i.abs_diff(at));
        let own = nearest.or_else(|| (next.end..stretch.end).find(settled)).unwrap_or(stretch.end - 1);
        let Told { noise, shared_spread, .. } = &self.told[own];
        let own = noise.known()?;
        let settled = next.filter(settled).filter_map(|i| Some((1.0, self.told[i].noise.known()?)));
        own.mean_of_kind(settled).or_else(|| Some(own.clone())).map(|mean| Mean::new(mean, *shared_spread))
    }

    /// The mean of the means around frame `at`, as far on each side as they are like its own. Their weights fall towards the ends of what counts, so
    /// that none comes in at once.
    fn far(&self, at: usize) -> Option<NoiseModel> {
        let own = self.near[at].as_ref()?;
        let weighted = |likeness: &mut f32, k: usize| {
            let (frame, mean) = (k * STEP, self.near.get(k * STEP)?.as_ref()?);
            *likeness = likeness.min(own.likeness(mean));
            let distance = frame.abs_diff(at) as f32 / FAR as f32;
            (*likeness > 0.0).then(|| (*likeness * taper(distance), &mean.noise))
        };
        // The same frames count for all frames between them.
        let before = (at.saturating_sub(FAR).div_ceil(STEP)..=at / STEP).rev().scan(1.0, weighted);
        let after = (at / STEP + 1..=(at + FAR) / STEP).scan(1.0, weighted);
        let mut mean =
            own.noise.mean_of_kind(std::iter::once((1.0, &own.noise)).chain(before).chain(after))?;
        mean.allow_for(own.shared_spread);
        Some(mean)
    }

    /// Forgets the first frames.
    fn forget(&mut self, frames: usize) {
        self.told.drain(..frames);
        self.near.drain(..frames);
        self.changes.iter_mut().for_each(|change| *change -= frames);
        self.given -= frames;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Method, NOISE_LEVELS, NoiseInterval, NoiseLevel, Reason};

    /// Noise of one std everywhere, of 255, with an interval that reaches this share of it to each side.
    fn noise(std: f32, share: f32) -> Estimate<NoiseModel> {
        let of = |std: f32| [std / 255.0; 3];
        let level = NoiseLevel { slope: [0.0; 3], intercept: of(std) };
        let mut model = NoiseModel::given([level; NOISE_LEVELS], 0.95);
        let ends = [(1.0 - share) * std / 255.0, (1.0 + share) * std / 255.0];
        let interval = NoiseInterval { slope: [[0.0; 2]; 3], intercept: [ends; 3] };
        model.lines_mut().interval = Some([interval; NOISE_LEVELS]);
        Estimate::Known(model)
    }

    /// What the tracker tells of a frame.
    fn told_as(noise: Estimate<NoiseModel>, settled: bool) -> Told {
        Told { noise, shared_spread: 0.0, settled }
    }

    /// The stds of means, of 255; 0 where the noise is unknown.
    fn stds(found: &[FrameNoise]) -> Vec<f32> {
        let std = |m: &NoiseModel| 255.0 * m.lines().levels[0].intercept[0];
        found.iter().map(|f| f.mean.as_ref().map_or(0.0, std)).collect()
    }

    /// The indices of the frames in which a change is told.
    fn changes(found: &[FrameNoise]) -> Vec<usize> {
        (0..found.len()).filter(|&i| found[i].changed).collect()
    }

    #[test]
    fn means_reach_as_far_as_noise_agrees() {
        let mut around = NoiseAround::default();
        assert!(around.known(true).is_empty() && around.known(false).is_empty());
        // The noise of the first twenty frames has not settled, and then it wanders by 1.5 times.
        const FRAMES: usize = 1500;
        let told = |i: usize| match i {
            0..20 => 20.0,
            _ => 5.0 + (i as f32 / 40.0).sin(),
        };
        let means = |share: f32| {
            let (mut around, mut found) = (NoiseAround::default(), vec![]);
            for i in 0..FRAMES {
                around.push(told_as(noise(told(i), share), i >= 20));
                let known = around.known(false);
                assert_eq!(known.len(), usize::from(i >= NEAR + FAR));
                found.extend(known);
                assert!(around.told.len() <= 2 * (NEAR + FAR) + STEP);
            }
            found.extend(around.known(true));
            assert!(found.len() == FRAMES && changes(&found).is_empty());
            stds(&found)
        };
        // Within wide intervals all is the same noise; narrow ones tell that it wanders, as its nearest means do.
        let off = |found: &[f32]| found.iter().map(|v| (v / 5.0 - 1.0).abs()).fold(0.0, f32::max);
        assert!(off(&means(0.6)) < 0.05, "{}", off(&means(0.6)));
        let narrow = means(0.001);
        assert!(off(&narrow) > 0.1);
        for i in [0, 300, 700, FRAMES - 1] {
            let next = i.saturating_sub(NEAR).max(20)..(i + NEAR + 1).min(FRAMES);
            let wanted = next.clone().map(told).sum::<f32>() / next.len() as f32;
            assert!((narrow[i] - wanted).abs() < 0.02, "{i}: {} for {wanted}", narrow[i]);
        }
    }

    #[test]
    fn a_change_stands_where_the_noise_differs() {
        let found = |after: f32, (before, frames): (usize, usize)| {
            let (mut around, mut found) = (NoiseAround::default(), vec![]);
            let noticed = before + 12;
            for i in 0..before + frames {
                if i == noticed {
                    around.change(12, &told_as(noise(after, 0.5), false));
                }
                let std = if i < noticed { 4.0 } else { after };
                around.push(told_as(noise(std, 0.5), i >= 20 && !(noticed..noticed + 12).contains(&i)));
                found.extend(around.known(false));
                // The tracker's own frame waits for its neighbour, which makes one more.
                assert!(i - found.len() < NEAR + FAR + AFTER);
            }
            found.extend(around.known(true));
            assert_eq!(found.len(), before + frames);
            found
        };
        for (before, frames) in [(300, 600), (1250, 700), (300, 100), (300, 13)] {
            // The intervals overlap, but the noises differ.
            let real = found(6.0, (before, frames));
            assert_eq!(changes(&real), [before]);
            assert!(stds(&real)[..before].iter().all(|v| (v - 4.0).abs() < 1e-3));
            assert!(stds(&real)[before..].iter().all(|v| (v - 6.0).abs() < 1e-3));
            let none = found(4.4, (before, frames));
            assert_eq!(changes(&none), [0; 0]);
            // No frame has another noise than that next to it.
            assert!(stds(&none).windows(2).all(|w| (w[0] - w[1]).abs() < 0.05));
        }
    }

    #[test]
    fn an_error_that_all_frames_share_widens_what_is_given_and_nothing_else() {
        // The noise changes slowly by more than its frames scatter, but by less than they may all be off.
        let found = |shared_spread: f32| {
            let (mut around, mut found) = (NoiseAround::default(), vec![]);
            for i in 0..1000 {
                let std = 4.0 + 2.0 * i as f32 / 1000.0;
                around.push(Told { shared_spread, ..told_as(noise(std, 0.05), true) });
                found.extend(around.known(false));
            }
            found.extend(around.known(true));
            found
        };
        let (without, with) = (found(0.0), found(0.45));
        assert_eq!(stds(&with), stds(&without));
        let upper = |found: &[FrameNoise], i: usize| {
            let noise = found[i].mean.as_ref().unwrap();
            (noise.interval_of_total_std(0.5)[1][1] / noise.total_std(0.5)[1]).ln()
        };
        for i in [0, 400, 999] {
            let wanted = upper(&without, i).hypot(1.96 * 0.45);
            assert!((upper(&with, i) - wanted).abs() < 0.02, "{} for {wanted}", upper(&with, i));
        }
    }

    #[test]
    fn changes_close_together_and_at_the_begin() {
        let mut around = NoiseAround::default();
        // The shot's first frame has another noise than was told of it.
        around.push(told_as(noise(2.0, 0.1), false));
        around.change(1, &told_as(noise(4.0, 0.1), false));
        for _ in 0..60 {
            around.push(told_as(noise(4.0, 0.1), true));
        }
        // The first two of these three changes are one.
        around.change(4, &told_as(noise(8.0, 0.1), false));
        around.push(told_as(noise(8.0, 0.1), false));
        around.change(8, &told_as(noise(8.0, 0.1), false));
        (0..40).for_each(|_| around.push(told_as(noise(8.0, 0.1), true)));
        around.change(0, &told_as(noise(12.0, 0.1), false));
        (0..40).for_each(|_| around.push(told_as(noise(12.0, 0.1), true)));
        let found = around.known(true);
        assert_eq!(changes(&found), [0, 54, 102]);
        assert_eq!([0, 53, 54, 101, 102].map(|i| stds(&found)[i].round()), [4.0, 4.0, 8.0, 8.0, 12.0]);
        // A change that is taken back soon counts for as long as it lasts.
        for (std, frames) in [(4.0, 300), (8.0, 40), (4.0, 300)] {
            around.change(0, &told_as(noise(std, 0.1), false));
            (0..frames).for_each(|i| around.push(told_as(noise(std, 0.1), i >= 23)));
        }
        let found = around.known(true);
        assert_eq!(changes(&found), [0, 300, 340]);
        assert_eq!([299, 300, 339, 340].map(|i| stds(&found)[i].round()), [4.0, 8.0, 8.0, 4.0]);
        // The next shot has nothing of that.
        (0..3).for_each(|_| around.push(told_as(noise(3.0, 0.1), false)));
        assert_eq!(stds(&around.known(true)), [3.0; 3]);
    }

    #[test]
    fn frames_before_the_noise_settles_have_that_of_those_after() {
        // As where a clip begins with many copies of its first frame.
        let (mut around, mut found) = (NoiseAround::default(), vec![]);
        for i in 0..900 {
            around.push(told_as(noise(if i < 150 { 9.0 } else { 4.0 }, 0.1), i >= 150));
            found.extend(around.known(false));
        }
        assert!(!found.is_empty());
        found.extend(around.known(true));
        assert_eq!(stds(&found).iter().map(|v| v.round()).collect::<Vec<_>>(), [4.0; 900]);
        // If it never settles, the last frame tells most.
        (0..700).for_each(|i| around.push(told_as(noise(i as f32, 0.1), false)));
        assert!(around.known(false).is_empty());
        assert_eq!(stds(&around.known(true)).iter().map(|v| v.round()).collect::<Vec<_>>(), [699.0; 700]);
    }

    #[test]
    fn means_are_of_one_kind_and_unknown_noise_stays_unknown() {
        let unknown = || Estimate::unknown(Reason::Flat, "everything clips");
        let measured = |std: f32| {
            let Estimate::Known(mut model) = noise(std, 0.1) else { unreachable!() };
            model.lines_mut().method = Method::Temporal;
            model.lines_mut().samples = std as u64;
            Estimate::Known(model)
        };
        let mut around = NoiseAround::default();
        for noise in [measured(2.0), unknown(), noise(50.0, 0.1), measured(4.0)] {
            around.push(told_as(noise, true));
            assert!(around.known(false).is_empty());
        }
        let found = around.known(true);
        assert_eq!(found[0].mean.as_ref().unwrap().samples(), 2);
        assert_eq!(stds(&found).iter().map(|v| v.round()).collect::<Vec<_>>(), [3.0, 0.0, 50.0, 3.0]);
        around.push(told_as(unknown(), false));
        assert_eq!(around.known(true), [FrameNoise { mean: None, changed: false }]);
    }
}
