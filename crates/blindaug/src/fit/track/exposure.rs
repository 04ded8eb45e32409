//! The exposure from frame to frame.

use super::memory::{AGREEING, Memory, SURE, walked};
use super::streaks::ByStreaks;
use crate::fit::agreement::{self, ExposureObservation};
use crate::fit::streaks::widest;
use crate::fit::{likelihood, tiles, uneven};
use crate::model::{Estimate, ExposureFraction, Method, MotionBlurModel, Reason, Unknown};
use crate::portable::Portable;
use std::collections::VecDeque;

/// The number of last frames whose own exposures the interval is held against: older evidence has faded to a third.
const READINGS: usize = 16;
/// The largest difference of exposure fractions that is not a change.
pub(super) const SAME: f32 = 0.1;
/// The share of its weight that evidence keeps from one frame to the next.
const KEPT: f32 = 0.93;
/// The std, per frame, of the random walk of an exposure fraction that is not seen.
const WALK: f32 = 0.01;
/// The number of frames whose summed log-likelihood has the width over which the exposure is averaged.
const MEAN_OF: f32 = 4.0;
/// The number of nats for each of their tiles by which the last frames together must find a new exposure likelier than the old one: the
/// tiles of a frame err alike, so that many of them are hardly surer than few.
const SURE_BY_TILE: f32 = 0.3;
/// The number of exposures in a curve.
pub(super) const EXPOSURES: usize = likelihood::EXPOSURES;
/// The fewest tiles that tell the exposure.
const FEWEST: f32 = agreement::FEWEST as f32;
/// The index, in a curve, of an exposure as long as a frame interval.
const FRAME_LONG: usize = (1.0 / likelihood::EXPOSURE_STEP + 0.5) as usize;
/// The number of parts that frames are dealt to in turn. The bootstrap resamples them as it does blocks of the image, so that the interval
/// is wide where frames contradict each other.
const PARTS: usize = likelihood::PARTS;
/// The length of the curves in the evidence, one for each block of each part. The number of tiles, the sum of their speeds, the sum of the
/// squared speeds and the number of those in frames of uneven motion follow them.
const CURVES: usize = PARTS * tiles::BLOCK_COUNT * EXPOSURES;

/// The summed log-likelihood of the exposure over lambda, per part and block of the image, and the last known exposure.
pub(super) struct ExposureMemory {
    memory: Memory,
    /// The exposure that each of the last frames tells by itself, at most [`READINGS`] of them; NaN for a frame that tells nothing.
    readings: VecDeque<f32>,
    /// The last exposure whose interval was narrow enough.
    pub known: Option<MotionBlurModel>,
}

impl Default for ExposureMemory {
    fn default() -> Self {
        Self { memory: Memory::new(CURVES + 4, KEPT), readings: VecDeque::new(), known: None }
    }
}

/// The exposure as of a frame.
pub(super) struct Followed {
    pub exposure: Estimate<MotionBlurModel>,
    /// Whether it is another one than before.
    pub changed: bool,
    /// Whether the streaks that were given tell what was so before the change.
    pub streaks_outdated: bool,
}

impl ExposureMemory {
    /// The exposure with the observations of the frame of this index. `coding_error` is
    /// [`LumaNoise::coding_error`](crate::fit::noise::LumaNoise::coding_error).
    pub fn follow(
        &mut self,
        found: &[ExposureObservation],
        by_streaks: Option<ByStreaks>,
        frame: usize,
        coding_error: f32,
    ) -> Followed {
        self.memory.fade();
        // A few uneven frames may be those around missing ones, whose streaks contradict the motion.
        let is_uneven = !self.is_mostly_even();
        let within = |s: &ByStreaks, exposure: f32| holds(s.fit.interval, exposure);
        let new_run = is_uneven && by_streaks.as_ref().is_some_and(|s| s.changed);
        let known = self.known.as_ref().map(|m| m.exposure.0);
        let believed = |s: &ByStreaks| {
            is_uneven && (new_run || s.by_many || known.is_none_or(|exposure| within(s, exposure)))
        };
        if new_run {
            // The last frames may be older than the change.
            self.memory.forget();
            self.readings.clear();
        }
        if !found.is_empty() {
            self.add(found, frame);
        }
        let told = changed_to(&self.memory).filter(|_| !found.is_empty());
        // Where motion is uneven, the speeds of several frames may err alike.
        let believed_streaks = by_streaks.as_ref().filter(|s| believed(s));
        let recent_even = self.memory.recent.iter().all(|frame| frame[CURVES + 3] == 0.0);
        let possible = |now: f32| recent_even || believed_streaks.is_none_or(|s| within(s, now));
        let by_frames = told.filter(|&now| possible(now));
        if by_frames.is_some() {
            self.forget_old();
        }
        let contradicts = |s: &ByStreaks| by_frames.is_some_and(|now| !within(s, now));
        let streaks_outdated = by_streaks.as_ref().is_some_and(contradicts);
        let by_streaks = by_streaks.filter(|s| !streaks_outdated && believed(s));
        let changed = new_run || by_frames.is_some();
        if changed {
            self.known = None;
        }
        let by_streaks = by_streaks.map(|ByStreaks { fit, age, .. }| {
            let interval = walked(fit.interval, fit.exposure.0, WALK, age);
            model_of(fit.exposure, interval, fit.samples as u64)
        });
        let may_contradict = by_streaks.is_some() && self.known.is_some() && self.even_tiles() >= FEWEST;
        let by_tiles = if found.is_empty() && !may_contradict { None } else { self.fit(coding_error) };
        let width = |m: &MotionBlurModel| m.interval[1] - m.interval[0];
        let excludes = |a: &MotionBlurModel, b: &MotionBlurModel| !holds(a.interval, b.exposure.0);
        // Where they contradict tiles of even frames, what was told stays while enough of these still count.
        let contradictory = may_contradict
            && matches!((&by_streaks, &by_tiles), (Some(s), Some(t)) if excludes(s, t) && excludes(t, s));
        let best = match (by_streaks, by_tiles.filter(|_| !found.is_empty())) {
            _ if contradictory => None,
            (Some(streaks), Some(tiles)) if width(&streaks) > widest(Some(width(&tiles))) => Some(tiles),
            (streaks, tiles) => streaks.or(tiles),
        };
        let fits = best.as_ref().map(|m| (m.exposure.0, m.interval));
        if let Some(best) = best.filter(|m| width(m) <= agreement::MAX_UNCERTAINTY) {
            self.memory.age = 0;
            self.known = Some(best);
        }
        let Some(known) = self.known else {
            let unknown = match fits {
                Some((exposure, [low, high])) => {
                    let mut why = format!(
                        "exposures from {low:.2} to {high:.2} fit all that was seen in this shot, or since the exposure changed"
                    );
                    if let Some(slow) = self.slow_motion(exposure) {
                        why = format!("{slow}: {why}");
                    }
                    Unknown::new(Reason::Uncertain, why).with_fits([low, high])
                }
                None => Unknown::new(
                    Reason::NoMotion,
                    "in this shot so far, or since the exposure changed, too little has moved, or what moved has too little texture",
                ),
            };
            let exposure = Estimate::Unknown(unknown);
            return Followed { exposure, changed, streaks_outdated };
        };
        let [low, high] = walked(known.interval, known.exposure.0, WALK, self.memory.age);
        let exposure = Estimate::Known(MotionBlurModel { interval: [low, high.min(1.0)], ..known });
        Followed { exposure, changed, streaks_outdated }
    }

    /// The number of tiles that count, and how many of them lie in frames of uneven motion.
    fn tiles(&self) -> [f32; 2] {
        [CURVES, CURVES + 3]
            .map(|i| self.memory.old[i] + self.memory.recent.iter().map(|frame| frame[i]).sum::<f32>())
    }

    /// Whether most of the tiles lie in frames of even motion, and are enough to tell the exposure.
    fn is_mostly_even(&self) -> bool {
        let [tiles, uneven] = self.tiles();
        tiles >= FEWEST && are_even(tiles, uneven)
    }

    /// The number of tiles that count and lie in frames of even motion.
    fn even_tiles(&self) -> f32 {
        let [tiles, uneven] = self.tiles();
        tiles - uneven
    }

    /// Adds the evidence of a frame, and the exposure that it tells by itself.
    fn add(&mut self, found: &[ExposureObservation], frame: usize) {
        let speed_error = found.iter().map(|w| w.speed_error).fold(0.0, f32::max);
        let mut evidence = vec![0.0; self.memory.old.len()];
        let (curves, moments) = evidence.split_at_mut(CURVES);
        let first = frame % PARTS * tiles::BLOCK_COUNT;
        for w in found {
            let at = (first + w.block as usize) * EXPOSURES;
            curves[at..at + EXPOSURES].iter_mut().zip(&w.log_likelihood).for_each(|(s, v)| *s += v);
            let uneven = if speed_error > 0.0 { 1.0 } else { 0.0 };
            moments.iter_mut().zip([1.0, w.speed, w.speed * w.speed, uneven]).for_each(|(s, v)| *s += v);
        }
        if speed_error > 0.0 {
            // All tiles of the frame err alike, and those of other frames otherwise: the frame takes the place of a block, of the first part.
            let curve = uneven::over_speeds(&curve_of(&evidence), speed_error);
            evidence[..CURVES].fill(0.0);
            evidence[frame % tiles::BLOCK_COUNT * EXPOSURES..][..EXPOSURES].copy_from_slice(&curve);
        }
        let reading = if found.len() >= agreement::FEWEST {
            agreement::most_likely_exposure(&curve_of(&evidence)).min(1.0)
        } else {
            f32::NAN
        };
        self.remember(evidence, reading);
    }

    fn remember(&mut self, evidence: Vec<f32>, reading: f32) {
        self.memory.add(evidence);
        self.readings.push_back(reading);
        if self.readings.len() > READINGS {
            self.readings.pop_front();
        }
    }

    /// The exposure that fits all evidence, however wide its interval; `None` if there are too few tiles, or no shutter is open for so long.
    fn fit(&self, coding_error: f32) -> Option<MotionBlurModel> {
        let sum = self.memory.sum();
        let (curves, moments) = sum.split_at(CURVES);
        let (tiles, speed) = (moments[0], agreement::typical_speed(moments[1], moments[2]));
        let mut curve = curve_of(&sum);
        let even = are_even(tiles, moments[3]);
        if !even {
            // What seems longer than a frame was faster than its flow says.
            curve[FRAME_LONG + 1..].fill(f32::MIN);
        }
        let estimate = mean_exposure(&curve, self.memory.weight);
        let parts: Vec<(u32, usize, Vec<f32>)> = curves
            .chunks(EXPOSURES)
            .enumerate()
            .filter(|(_, c)| c.iter().any(|&v| v < 0.0))
            .map(|(i, c)| ((i % tiles::BLOCK_COUNT) as u32, i / tiles::BLOCK_COUNT, c.to_vec()))
            .collect();
        let interval = agreement::exposure_interval(
            estimate,
            &curve,
            &parts,
            super::BOOTSTRAPS,
            coding_error,
            speed,
            even,
        );
        let interval = agreement::with_typical_frame(interval, self.readings.iter().copied(), even, speed);
        let possible = agreement::most_likely_exposure(&curve) <= agreement::LONGEST;
        if tiles < FEWEST || !possible {
            return None;
        }
        Some(model_of(ExposureFraction(estimate.min(1.0)), interval, tiles.round() as u64))
    }

    /// [`agreement::slow_motion`] of the tiles that count.
    fn slow_motion(&self, exposure: f32) -> Option<String> {
        let sum = self.memory.sum();
        let [tiles, speeds, squares, uneven] = [0, 1, 2, 3].map(|i| sum[CURVES + i]);
        if tiles < FEWEST {
            return None;
        }
        agreement::slow_motion(exposure, agreement::typical_speed(speeds, squares), are_even(tiles, uneven))
    }

    fn forget_old(&mut self) {
        self.memory.forget_old();
        self.readings.drain(..self.readings.len().saturating_sub(self.memory.recent.len()));
    }

    /// Forgets the evidence of the last frames.
    pub fn forget_recent(&mut self) {
        self.readings.truncate(self.readings.len().saturating_sub(self.memory.recent.len()));
        self.memory.forget_recent();
    }
}

/// Whether most of so many tiles are of even motion, given how many are not.
fn are_even(tiles: f32, uneven: f32) -> bool {
    2.0 * uneven <= tiles
}

/// Whether an interval holds an exposure.
fn holds([low, high]: [f32; 2], exposure: f32) -> bool {
    (low..=high).contains(&exposure)
}

/// The model of an exposure with its interval, by so many tiles or pairs of tiles.
fn model_of(exposure: ExposureFraction, interval: [f32; 2], samples: u64) -> MotionBlurModel {
    let interval = interval.map(|v| v.clamp(0.0, 1.0));
    MotionBlurModel { interval, method: Method::Spectral, samples, ..MotionBlurModel::given(exposure) }
}

/// The sum of all curves.
fn curve_of(evidence: &[f32]) -> Vec<f32> {
    let mut sum = vec![0.0; EXPOSURES];
    for curve in evidence[..CURVES].chunks(EXPOSURES) {
        sum.iter_mut().zip(curve).for_each(|(s, v)| *s += v);
    }
    sum
}

/// The mean exposure under the likelihood of a curve that sums `frames` frames, made as wide as that of [`MEAN_OF`] frames: the maximum
/// of a sum of clipped log-likelihoods would jump between places that are almost equally likely.
fn mean_exposure(curve: &[f32], frames: f32) -> f32 {
    let max = curve.iter().copied().fold(f32::MIN, f32::max);
    let sharpness = (MEAN_OF / frames).min(1.0);
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, v) in curve.iter().enumerate() {
        let weight = (sharpness * (v - max)).portable_exp();
        sum += weight * i as f32 * likelihood::EXPOSURE_STEP;
        weights += weight;
    }
    sum / weights
}

/// The exposure that the last frames agree on, if it differs from that of the frames before them.
fn changed_to(memory: &Memory) -> Option<f32> {
    if memory.recent.len() < AGREEING || memory.old[CURVES] < FEWEST {
        return None;
    }
    let at = likelihood::index_of_exposure;
    let before = at(agreement::most_likely_exposure(&curve_of(&memory.old)));
    let recent = memory.recent_sum();
    let exposure = agreement::most_likely_exposure(&curve_of(&recent));
    let now = at(exposure);
    let surplus = |evidence: &[f32]| {
        let curve = curve_of(evidence);
        curve[now] - curve[before]
    };
    // All tiles of a frame of uneven motion are one.
    let tiles_of = |frame: &Vec<f32>| if frame[CURVES + 3] > 0.0 { 1.0 } else { frame[CURVES] };
    let tiles: f32 = memory.recent.iter().map(tiles_of).sum();
    let agree = now.abs_diff(before) > at(SAME)
        && surplus(&recent) > SURE_BY_TILE * tiles
        && memory.recent.iter().all(|frame| surplus(frame) > SURE);
    agree.then_some(exposure)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_frames_tell_by_themselves_is_forgotten_with_their_evidence() {
        let of = |n: usize| {
            let mut memory = ExposureMemory::default();
            (0..n).for_each(|i| memory.remember(vec![1.0; CURVES + 4], i as f32));
            memory
        };
        let mut recent = of(5);
        recent.forget_recent();
        assert_eq!(recent.readings, [0.0, 1.0]);
        let mut old = of(5);
        old.forget_old();
        assert_eq!(old.readings, [2.0, 3.0, 4.0]);
        assert_eq!(of(40).readings.len(), READINGS);
    }

    /// Observations of even motion, one for each of `tiles` tiles, each of which finds `exposure` likelier than all others by so many nats.
    fn tiles_that_tell(exposure: f32, tiles: usize, nats: f32) -> Vec<ExposureObservation> {
        let curve = |i: usize| {
            if (i as f32 * likelihood::EXPOSURE_STEP - exposure).abs() < 0.01 { 0.0 } else { -nats }
        };
        let of = |block: usize| ExposureObservation {
            block: (block % tiles::BLOCK_COUNT) as u32,
            frame: 0,
            speed: 8.0,
            speed_error: 0.0,
            log_likelihood: (0..EXPOSURES).map(curve).collect(),
        };
        (0..tiles).map(of).collect()
    }

    #[test]
    fn a_change_is_believed_if_the_tiles_are_surer_than_they_err_alike() {
        let noticed = |nats: f32| {
            let mut memory = ExposureMemory::default();
            let mut follow = |exposure, frame| {
                memory.follow(&tiles_that_tell(exposure, 60, nats), None, frame, 0.0).changed
            };
            let before = (0..6).any(|frame| follow(0.6, frame));
            assert!(!before);
            (6..9).map(|frame| follow(0.3, frame)).collect::<Vec<_>>()
        };
        // 60 tiles of 0.2 nats are 12 nats a frame.
        assert_eq!(noticed(0.2), [false; 3]);
        assert_eq!(noticed(0.6), [false, false, true]);
    }

    #[test]
    fn what_even_frames_told_stays_while_streaks_contradict_them() {
        let fit = agreement::ExposureFit {
            exposure: ExposureFraction(0.05),
            interval: [0.0, 0.1],
            samples: 60,
            curve: vec![],
            per_frame: vec![],
        };
        // What is told after an even frame with so many tiles and five uneven ones of 40; `forgets`: before each of these nothing is known.
        let after = |even_tiles: usize, forgets: bool| {
            let mut memory = ExposureMemory::default();
            memory.follow(&tiles_that_tell(0.6, even_tiles, 2.0), None, 0, 0.0);
            let mut last = None;
            for frame in 1..6 {
                let mut told = tiles_that_tell(0.6, 40, 2.0);
                told.iter_mut().for_each(|w| w.speed_error = 0.01);
                if forgets {
                    memory.known = None;
                }
                let streaks = ByStreaks { fit: &fit, age: 0, changed: false, by_many: true };
                last = Some(memory.follow(&told, Some(streaks), frame, 0.0));
            }
            last.unwrap().exposure.known().map(|m| m.exposure.0)
        };
        let by_tiles = after(30, false);
        assert!(by_tiles.is_some_and(|e| (e - 0.6).abs() < 0.05), "{by_tiles:?}");
        // Five tiles of an even frame are too few to hold against streaks, and where nothing is known, streaks tell it.
        assert_eq!([after(5, false), after(30, true)], [Some(0.05); 2]);
    }

    #[test]
    fn streaks_from_before_a_change_are_told_to_be_outdated() {
        let fit = |exposure: f32| agreement::ExposureFit {
            exposure: ExposureFraction(exposure),
            interval: [exposure - 0.1, exposure + 0.1],
            samples: 60,
            curve: vec![],
            per_frame: vec![],
        };
        let after = |of_streaks: f32| {
            let fit = fit(of_streaks);
            let mut memory = ExposureMemory::default();
            let mut last = None;
            for frame in 0..9 {
                let streaks = ByStreaks { fit: &fit, age: 0, changed: false, by_many: false };
                let told = tiles_that_tell(if frame < 6 { 0.2 } else { 0.6 }, 60, 2.0);
                last = Some(memory.follow(&told, Some(streaks), frame, 0.0));
            }
            let last = last.unwrap();
            (last.changed, last.streaks_outdated, last.exposure.known().map(|m| m.exposure.0))
        };
        let (changed, outdated, exposure) = after(0.2);
        assert!(changed && outdated && exposure.is_some_and(|e| (e - 0.6).abs() < 0.02), "{exposure:?}");
        // Streaks that hold the new exposure are kept.
        let (changed, outdated, _) = after(0.55);
        assert!(changed && !outdated);
    }
}
