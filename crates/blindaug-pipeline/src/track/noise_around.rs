//! The mean noise of the frames around each frame of a clip.

use blindaug::model::{Estimate, NoiseModel};
use std::collections::VecDeque;

/// The number of frames before and after a frame over which its noise is a mean: as many as the tracker measures noise in.
const NOISE_REACH: usize = 48;

/// The mean of each frame's noise and that of the frames around it, between two cuts or changes of the noise.
///
/// The noise of a shot's first frames is not settled, and counts in no mean: these frames have that of the frames after them.
#[derive(Default)]
pub(super) struct NoiseAround {
    /// The noises of the last frames as the tracker tells them.
    told: VecDeque<Estimate<NoiseModel>>,
    /// The number of frames before those of `told`.
    forgotten: usize,
    /// The index of the first frame whose noise had settled; `None`: none has so far.
    settled: Option<usize>,
    /// The number of frames whose mean was given.
    given: usize,
}

impl NoiseAround {
    pub(super) fn push(&mut self, noise: Estimate<NoiseModel>) {
        self.told.push_back(noise);
    }

    /// Forgets the last frames, of which none may have been given its mean.
    pub(super) fn forget_last(&mut self, frames: usize) {
        self.told.truncate(self.told.len().saturating_sub(frames));
        if self.told.is_empty() {
            *self = Self::default();
        }
        let last = (self.forgotten + self.told.len()).saturating_sub(1);
        self.settled = self.settled.map(|settled| settled.min(last));
    }

    /// The means, in the order of the frames, of the frames whose mean was not given so far and will not change any more: all of them if this
    /// is the end (`ends`), after which another stretch of frames begins; none while the noise of the last frame is still to settle
    /// (`settles`). A mean is `None` where the noise is unknown.
    pub(super) fn known(&mut self, settles: bool, ends: bool) -> Vec<Option<NoiseModel>> {
        let frames = self.forgotten + self.told.len();
        if frames == 0 || (settles && !ends) {
            return vec![];
        }
        let settled = *self.settled.get_or_insert(frames - 1);
        let sure = if ends { frames } else { frames.saturating_sub(NOISE_REACH) };
        let mean = |i: usize| {
            let first = settled.max(i.saturating_sub(NOISE_REACH));
            let last = settled.max(i + NOISE_REACH).min(frames - 1);
            let around = self.told.range(first - self.forgotten..=last - self.forgotten);
            let own = self.told[settled.max(i) - self.forgotten].known()?;
            own.mean_of_kind(around.filter_map(Estimate::known))
        };
        let means = (self.given..sure).map(mean).collect();
        if ends {
            *self = Self::default();
            return means;
        }
        self.given = self.given.max(sure);
        let unneeded = self.given.saturating_sub(NOISE_REACH).saturating_sub(self.forgotten);
        self.told.drain(..unneeded);
        self.forgotten += unneeded;
        means
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Method, NOISE_LEVELS, NoiseLevel, Reason};

    /// Noise of one std everywhere.
    fn noise(std: usize) -> Estimate<NoiseModel> {
        let level = NoiseLevel { slope: [0.0; 3], intercept: [std as f32; 3] };
        Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 0.95))
    }

    /// The stds of means; 0 where the noise is unknown.
    fn stds(means: Vec<Option<NoiseModel>>) -> Vec<f32> {
        means.iter().map(|m| m.as_ref().map_or(0.0, |m| m.lines().levels[0].intercept[0])).collect()
    }

    #[test]
    fn means_of_noise_reach_as_far_as_is_known_and_end_with_a_stretch_of_frames() {
        let mut around = NoiseAround::default();
        // No frame at all, as before a cut in the first frame, and one frame.
        assert!(around.known(false, true).is_empty() && around.known(true, true).is_empty());
        around.push(noise(7));
        assert!(around.known(true, false).is_empty());
        assert_eq!(stds(around.known(true, true)), [7.0]);
        // Two hundred frames, whose noise is their number, settle in the frame of index 20.
        let mut found = vec![];
        for i in 0..200 {
            around.push(noise(i));
            let known = around.known(i < 20, false);
            assert_eq!(known.len(), usize::from(i >= NOISE_REACH));
            found.extend(stds(known));
            assert!(around.told.len() <= 2 * NOISE_REACH + 1);
        }
        found.extend(stds(around.known(false, true)));
        assert_eq!(found.len(), 200);
        for (i, found) in found.into_iter().enumerate() {
            let (first, last) = (i.saturating_sub(NOISE_REACH).max(20), (i + NOISE_REACH).min(199));
            assert!((found - 0.5 * (first + last) as f32).abs() < 1e-3, "{i}: {found}");
        }
        // What follows has nothing of that, and ends before its noise has settled.
        (1..4).for_each(|i| around.push(noise(i)));
        assert!(around.known(true, false).is_empty());
        assert_eq!(stds(around.known(true, true)), [3.0; 3]);
    }

    #[test]
    fn forgotten_frames_count_in_no_mean() {
        let mut around = NoiseAround::default();
        let mut found = vec![];
        for i in 0..100 {
            around.push(noise(i));
            found.extend(stds(around.known(i < 20, false)));
        }
        around.forget_last(12);
        found.extend(stds(around.known(false, true)));
        assert_eq!(found.len(), 88);
        // Means that were given before still count the forgotten frames.
        assert!((found[50] - 0.5 * (20 + 98) as f32).abs() < 1e-3, "{}", found[50]);
        assert!((found[87] - 0.5 * (39 + 87) as f32).abs() < 1e-3, "{}", found[87]);
        // Nothing is left, or only frames from before the noise settled.
        around.push(noise(7));
        around.forget_last(1);
        assert!(around.known(false, true).is_empty());
        for i in 1..5 {
            around.push(noise(i));
            around.known(i < 4, false);
        }
        around.forget_last(2);
        assert_eq!(stds(around.known(false, true)), [2.0; 2]);
    }

    #[test]
    fn means_of_noise_are_of_one_kind_and_unknown_noise_stays_unknown() {
        let unknown = || Estimate::unknown(Reason::Flat, "everything clips");
        let measured = |std| {
            let Estimate::Known(mut model) = noise(std) else { unreachable!() };
            model.lines_mut().method = Method::Temporal;
            model.lines_mut().samples = std as u64;
            Estimate::Known(model)
        };
        let mut around = NoiseAround::default();
        for noise in [measured(2), unknown(), noise(50), measured(4)] {
            around.push(noise);
            assert!(around.known(false, false).is_empty());
        }
        let means = around.known(false, true);
        assert_eq!(means[0].as_ref().unwrap().samples(), 2);
        assert_eq!(stds(means), [3.0, 0.0, 50.0, 3.0]);
        around.push(unknown());
        assert_eq!(around.known(true, true), [None]);
    }
}
