//! The noise of frames that lie several frame intervals apart.
//!
//! A video coder predicts each frame from those before it and takes their noise along, as a denoiser over time does. So the difference of
//! successive frames shows only the noise that is new, while the frames hold more. Frames farther apart have less noise in common: their
//! difference shows nearly all of it, and the ratio of both tells the correlation of noise between successive frames. Where the picture is not
//! found again, they differ in its texture, too: such pairs are left out.

use super::geometry::Follower;
use super::noise::{
    CODING_SPREAD, LumaNoise, MOST_CORRELATED, NoiseEvidence, NoiseFit, NoisePoint, UNSEEN_STD, lost,
};
use crate::model::{DistortionModel, Estimate, Method, NoiseLines, NoiseModel};
use crate::portable::Portable;
use crate::synth::noise::white_band_std;
use crate::{Encoded, Flow, Result, Transfer};
use std::collections::VecDeque;
use std::ops::RangeInclusive;
use std::sync::OnceLock;

/// The distance between the two frames of a pair, in frame intervals. Coders renew most of the noise within it, and most of the picture can
/// still be found again.
const DISTANCES: RangeInclusive<usize> = 12..=24;

/// The least distance that short footage is content with.
const SHORTEST: usize = 4;

/// The most of the picture's power in which frames that were found again differ ([`NoiseEvidence::mismatch`]). It lies between panned
/// photographs by nine coders, up to 0.006, and scenes in which layers that pass before each other show other parts by then, 0.07 to 0.45.
const MISMATCH: f32 = 0.02;

/// The share of a picture's textured parts that may show something else where the camera stands still: people who walk by change nothing of
/// the rest, which is compared with itself.
const MOVED: f32 = 0.2;

/// The luminances at which the noise of pairs is held against that of single frames.
const MIDDLE: [f32; 3] = [0.3, 0.5, 0.7];

/// The [`total`] std of noise that cannot be seen.
const UNSEEN: f32 = MIDDLE.len() as f32 * UNSEEN_STD;

/// Pairs of frames of one shot that lie several frame intervals apart, and what they tell of the noise.
pub(super) struct DistantPairs {
    /// The curve that encodes the frames.
    transfer: Transfer,
    /// The distance between the frames of a pair.
    distance: usize,
    /// The first frame of the next pair, with its index.
    held: Option<(usize, Encoded)>,
    /// The last pairs.
    pairs: VecDeque<Pair>,
    /// The evidence of one frame alone, which counts until there is a pair.
    alone: Option<NoiseEvidence>,
    /// The most pairs that are kept.
    most: usize,
    /// The number of pairs that were compared.
    compared: usize,
    /// What the pairs tell, once it was asked for: they are the same for many frames.
    found: OnceLock<Found>,
}

/// The evidence of a pair.
struct Pair {
    /// The difference of its frames, if the picture was found again.
    distant: Option<NoiseEvidence>,
    /// The earlier frame alone.
    single: NoiseEvidence,
}

/// What the pairs tell.
struct Found {
    distant: Option<Distant>,
    /// What a frame's flattest parts hold: noise and texture, less what a coder took away.
    most: Option<NoiseModel>,
}

/// The noise between distant frames.
struct Distant {
    /// The model, without a correlation.
    model: NoiseModel,
    points: Vec<NoisePoint>,
    luma: Option<LumaNoise>,
    /// The mean variance of the finest level's luma where the picture has least texture.
    flat_power: f32,
}

impl DistantPairs {
    /// No pairs yet. At most the last `most` are kept, of footage of about `expected` frames (0: unknown), which this curve encodes.
    pub fn new(most: usize, expected: usize, transfer: Transfer) -> Self {
        let distance = match expected {
            0 => *DISTANCES.start(),
            n if n <= 2 * DISTANCES.start() => (n / 2).max(SHORTEST),
            n => (n / most).clamp(*DISTANCES.start(), *DISTANCES.end()),
        };
        let (held, pairs, alone, found) = (None, VecDeque::new(), None, OnceLock::new());
        Self { transfer, distance, held, pairs, alone, most, compared: 0, found }
    }

    /// Forgets the frame of the next pair, since the next frame belongs to another shot.
    pub fn begin_shot(&mut self) {
        self.held = None;
    }

    /// Forgets all.
    pub fn forget(&mut self) {
        self.held = None;
        self.pairs.clear();
        self.alone = None;
        self.found = OnceLock::new();
    }

    /// Begins with a frame of compressed footage alone, if there is no pair yet: what its flattest parts hold is known at once, a pair only
    /// after its distance.
    pub fn begin_with(&mut self, frame: &Encoded) {
        if self.pairs.is_empty() && self.alone.is_none() {
            self.alone = Some(flat_parts(frame, self.transfer));
            self.found = OnceLock::new();
        }
    }

    /// Looks at a frame of this index. `hides_noise` is given the index of a pair's first frame and tells whether the frames since then may be
    /// compressed, or show too little to tell: elsewhere successive frames show all of the noise, and there is no pair. Each pair shows one of so
    /// many `turns` of the frame's rows.
    pub fn push(
        &mut self,
        (index, frame): (usize, &Encoded),
        hides_noise: impl FnOnce(usize) -> bool,
        follower: &mut Follower,
        turns: usize,
    ) -> Result<()> {
        let Some((held_at, held)) = &self.held else {
            self.held = Some((index, frame.clone()));
            return Ok(());
        };
        if index < held_at + self.distance {
            return Ok(());
        }
        if hides_noise(*held_at) {
            let single = flat_parts(held, self.transfer);
            let mut distant = None;
            if let Some(flow) = follower.follow(held, frame, None, Flow::filled(0, 0, [0.0; 2]))?.flow {
                let mut pair = NoiseEvidence::of_flat_parts(Method::Temporal).encoded_by(self.transfer);
                let still = pair.add_pair_in_turn(held, frame, &flow, (self.compared % turns, turns))?;
                self.compared += 1;
                let mismatch = pair.mismatch(if still { MOVED } else { 0.0 });
                distant = mismatch.is_some_and(|m| m <= MISMATCH).then_some(pair);
            }
            self.pairs.push_back(Pair { distant, single });
            self.alone = None;
            if self.pairs.len() > self.most {
                self.pairs.pop_front();
            }
            self.found = OnceLock::new();
        }
        self.held = Some((index, frame.clone()));
        Ok(())
    }

    /// The fit of the noise that frames hold. `fit` is that of `near`, the evidence of successive frames. If the footage is compressed, its
    /// model, interval and points are replaced by those of distant pairs, if there are any, and the noise of luma, too, where successive frames tell
    /// none. Where a coder copied much of the picture, the fit's [`coding_spread`](NoiseFit::coding_spread) is the largest one.
    pub fn complete(&self, near: &NoiseEvidence, mut fit: NoiseFit) -> NoiseFit {
        if near.is_copied() {
            fit.coding_spread = CODING_SPREAD;
        }
        if fit.coding_spread > 0.0 && (!self.pairs.is_empty() || self.alone.is_some()) {
            // Without a block that was not copied, nothing is new.
            self.replace(near.flat_power().unwrap_or(0.0), &mut fit);
        }
        fit
    }

    /// Replaces the fit of compressed footage by what pairs tell. `new` is the mean variance of what is new from frame to frame where the picture
    /// has least texture.
    fn replace(&self, new: f32, fit: &mut NoiseFit) {
        let Found { distant, most } = self.found.get_or_init(|| self.find());
        let least = fit.model.known().map_or(0.0, total);
        let mut correlation = 0.0;
        // The std of the noise that the coder left.
        let mut left = least / MIDDLE.len() as f32;
        // If successive frames tell more, most of the picture was copied over the whole distance.
        if let Some(Distant { model, points, luma, flat_power }) =
            distant.as_ref().filter(|d| total(&d.model) >= least)
        {
            // The difference of two frames holds twice the part of the noise that they do not share.
            correlation = (1.0 - new / flat_power.max(1e-12)).clamp(0.0, MOST_CORRELATED);
            fit.model = Estimate::Known(model.clone().with_temporal_correlation(correlation));
            fit.points.clone_from(points);
            // Where nearly all was copied, successive frames tell nothing.
            fit.luma = fit.luma.or(*luma);
            left = new.sqrt() / white_band_std()[0];
        }
        if let (Estimate::Known(model), Some(most)) = (&mut fit.model, most) {
            // What is copied over the distance, too, is not seen: the more is copied or taken away, the more the noise may be, up to all that a
            // frame's flattest parts hold.
            let share_towards_most = (correlation / MOST_CORRELATED).max(lost(left));
            match raised(model, most, correlation, share_towards_most) {
                Some(raised) => *model = raised,
                None => {
                    let share = (total(most) / total(model).max(UNSEEN)).max(1.0);
                    model.widen(1.0, 1.0 + share_towards_most * (share - 1.0));
                }
            }
        }
    }

    /// What the pairs tell.
    fn find(&self) -> Found {
        let mut distant = NoiseEvidence::of_flat_parts(Method::Temporal);
        let mut single = NoiseEvidence::of_flat_parts(Method::Spatial);
        for pair in &self.pairs {
            pair.distant.iter().for_each(|pair| distant.merge(pair));
            single.merge(&pair.single);
        }
        self.alone.iter().for_each(|alone| single.merge(alone));
        let most = single.fit().model.known().cloned();
        let distant = match (distant.flat_power(), distant.fit()) {
            (Some(flat_power), NoiseFit { model: Estimate::Known(mut model), points, luma, .. }) => {
                // Coded frames differ by a coder's errors, too, and their quietest parts have lost noise: where pairs tell more than single
                // frames, the noise is between the two.
                let between =
                    most.as_ref().map_or(1.0, |most| (total(most) / total(&model).max(1e-9)).min(1.0).sqrt());
                model.multiply(between);
                model.widen(between, between.recip());
                Some(Distant { model, points, luma, flat_power })
            }
            _ => None,
        };
        Found { distant, most }
    }
}

/// What all flat parts of a frame, which this curve encodes, tell of its noise.
fn flat_parts(frame: &Encoded, transfer: Transfer) -> NoiseEvidence {
    let mut evidence = NoiseEvidence::of_flat_parts(Method::Spatial).encoded_by(transfer);
    evidence.add_single(frame);
    evidence.rank();
    evidence
}

/// Noise of which hardly any is seen between frames, raised; `None` where enough is seen. Frames whose noise was copied differ by nothing, so
/// the noise lies anywhere between what is seen and `most`, what a frame's flattest parts hold: the geometric mean of both is taken, and the
/// less the more is seen. What differs between successive frames stays as it is: the rest is shared by them. `correlation` is that of what is
/// seen, and `share_towards_most` the share of the way to `most` to which the interval reaches.
fn raised(
    model: &NoiseModel,
    most: &NoiseModel,
    correlation: f32,
    share_towards_most: f32,
) -> Option<NoiseModel> {
    let (seen, all) = (total(model), total(most));
    let least = seen.max(UNSEEN);
    let wanted = least * (all / least).portable_powf(0.5 * lost(seen / MIDDLE.len() as f32));
    if all <= least || wanted <= seen {
        return None;
    }
    let raised = model.between(most, (wanted - seen) / (all - seen));
    let told = total(&raised);
    let renewed = (1.0 - correlation) * (seen / told).powi(2);
    let mut raised = raised.with_temporal_correlation((1.0 - renewed).clamp(0.0, MOST_CORRELATED));
    let lines = raised.lines_mut();
    *lines = NoiseLines { levels: lines.levels, clip: lines.clip, ..model.lines().clone() };
    // The flattest parts have lost noise to the coder, too: the interval of what they hold counts, where the picture tells it best.
    let upper_of = |y: f32| most.interval_of_std(0, 1, y)[1] / most.std(0, y)[1].max(1e-9);
    let upper = MIDDLE.map(upper_of).into_iter().fold(f32::INFINITY, f32::min);
    raised.widen_to(1.0 + share_towards_most * (all * upper / told - 1.0).max(0.0));
    Some(raised)
}

/// The sum of green's std at the luminances in the [`MIDDLE`].
fn total(model: &NoiseModel) -> f32 {
    MIDDLE.map(|y| model.total_std(y)[1]).iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::noise::tests::white;
    use crate::fit::{Estimator, FrameObservation};
    use crate::{Plane, Raster, filter};

    /// The std of the noise, which is the same in all channels, as a coder leaves it.
    const STD: f32 = 0.012;

    /// Frames of a camera that pans over a texture by 1 px a frame. Noise that is there moves along, and a share of its variance is renewed in each
    /// frame, as by a coder, so that successive frames have the correlation `shared`.
    fn frames(count: usize, shared: f32) -> Vec<Encoded> {
        noisy_frames(&noise_of_a_coder(count, (192 + count, 144), shared))
    }

    fn noisy_frames(noise: &[Plane]) -> Vec<Encoded> {
        let (w, h, count) = (192, 144, noise.len());
        let texture = filter::gaussian_blur(&white(w + count, h, 1).map(|n| n[1]), 3.0);
        (0..count)
            .map(|t| {
                // The upper half is nearly flat.
                let strength = |y: usize| if y < h / 2 { 0.05 } else { 1.0 };
                Encoded(Raster::from_fn(w, h, |x, y| {
                    let v = strength(y) * texture.at(x + t, y) + STD * noise[t].at(x + t, y);
                    [0.55 + v, 0.5 + v, 0.45 + v]
                }))
            })
            .collect()
    }

    /// Noise of std 1, of which a coder renews a share in each frame, so that successive frames have the correlation `shared`.
    fn noise_of_a_coder(count: usize, (w, h): (usize, usize), shared: f32) -> Vec<Plane> {
        let mut noise = vec![white(w, h, 2).map(|n| n[1])];
        for t in 1..count {
            let (before, new) = (&noise[t - 1], white(w, h, 2 + t as u64));
            noise.push(Raster::from_fn(w, h, |x, y| {
                shared * before.at(x, y) + (1.0 - shared * shared).sqrt() * new.at(x, y)[1]
            }));
        }
        noise
    }

    /// The std of green's finest level over that of the noise, the upper end of the interval over the std, but for what a coder leaves unsure, and the
    /// correlation between successive frames.
    fn estimated(frames: &[Encoded]) -> (f32, f32, f32) {
        let mut estimator = Estimator::new(Default::default()).expecting(frames.len());
        for observation in FrameObservation::of_frames(frames) {
            estimator.add(&observation).unwrap();
        }
        let model = estimator.estimate().unwrap().model;
        let noise = model.noise.known().expect("it is known").clone();
        // What a coder leaves unsure is the same in all clips.
        let upper = (noise.interval_of_std(0, 1, 0.5)[1] / noise.std(0, 0.5)[1]).portable_ln();
        let upper = (upper * upper - (1.96 * CODING_SPREAD).powi(2)).max(0.0).sqrt().portable_exp();
        (noise.std(0, 0.5)[1] / (STD * white_band_std()[0]), upper, noise.temporal_correlation())
    }

    #[test]
    fn frames_in_which_the_picture_was_not_found_again_are_told_by_its_texture() {
        let frames = frames(2, 0.5);
        let mismatch = |a: &Encoded, b: &Encoded, shift: f32| {
            let (w, h) = a.0.size();
            let mut pair = NoiseEvidence::of_flat_parts(Method::Temporal);
            pair.add_pair_in_turn(a, b, &Flow::filled(w, h, [shift, 0.0]), (0, 1)).unwrap();
            pair.mismatch(0.0).unwrap()
        };
        // The picture moves by -1 px a frame.
        let right = mismatch(&frames[0], &frames[1], -1.0);
        assert!(right < 0.5 * MISMATCH, "{right}");
        // Negative controls: a motion of another texture, and of one that is off by its own size.
        let far = mismatch(&frames[0], &frames[1], 20.0);
        assert!(far > 0.4, "{far}");
        let near = mismatch(&frames[0], &frames[1], 2.0);
        assert!(near > 2.0 * MISMATCH, "{near}");
    }

    #[test]
    fn people_who_walk_by_a_still_camera_do_not_hide_its_noise() {
        // The camera stands still, and a square with another texture moves by 3 px a frame.
        let texture = filter::gaussian_blur(&white(192, 144, 5).map(|n| n[1]), 2.0);
        let walker = filter::gaussian_blur(&white(192, 144, 6).map(|n| n[1]), 2.0);
        let scene = filter::gaussian_blur(&white(192, 144, 7).map(|n| n[1]), 3.0);
        let noise = noise_of_a_coder(40, (192, 144), 0.85);
        let frames: Vec<Encoded> = (0..40)
            .map(|t| {
                Encoded(Raster::from_fn(192, 144, |x, y| {
                    let walks = (90..118).contains(&y) && (3 * t + 10..3 * t + 38).contains(&x);
                    let v = if walks {
                        0.1 + walker.at(x - 3 * t, y)
                    } else if y < 72 {
                        0.05 * scene.at(x, y)
                    } else {
                        texture.at(x, y)
                    };
                    let v = v + STD * noise[t].at(x, y);
                    [0.55 + v, 0.5 + v, 0.45 + v]
                }))
            })
            .collect();
        let (std, _, correlation) = estimated(&frames);
        assert!((std - 1.0).abs() < 0.2 && (correlation - 0.85).abs() < 0.1, "{std}, {correlation}");
        let mut pair = NoiseEvidence::of_flat_parts(Method::Temporal);
        pair.add_pair_in_turn(&frames[0], &frames[12], &Flow::filled(192, 144, [0.0; 2]), (0, 1)).unwrap();
        // The walker is most of what does not match.
        let [all, without] = [0.0, MOVED].map(|without| pair.mismatch(without).unwrap());
        assert!(all > MISMATCH && without < 0.5 * MISMATCH, "{all}, {without}");
    }

    #[test]
    fn noise_that_a_coder_takes_along_is_found_in_frames_that_lie_apart() {
        let (std, upper, correlation) = estimated(&frames(40, 0.85));
        assert!((std - 1.0).abs() < 0.2 && (correlation - 0.85).abs() < 0.1, "{std}, {correlation}");
        // Negative control: two frames that follow each other show a part of it only.
        let (std, _, correlation) = estimated(&frames(3, 0.85));
        assert!(std < 0.75 && correlation == 0.0, "{std}, {correlation}");
        // Noise that is new in every frame is told from it.
        let (std, upper_of_new, correlation) = estimated(&frames(40, 0.0));
        assert!((std - 1.0).abs() < 0.2 && correlation < 0.1, "{std}, {correlation}");
        // What was taken along over the whole distance is not seen, so there may be more of it.
        assert!(upper > 1.1 * upper_of_new, "{upper}, {upper_of_new}");
    }

    #[test]
    fn noise_is_found_where_a_coder_copies_nearly_all_of_a_still_picture() {
        const GROUP: usize = 12;
        let (w, h) = (192, 144);
        let scene = filter::gaussian_blur(&white(w, h, 7).map(|n| n[1]), 3.0);
        let mut noise = Plane::filled(w, h, 0.0);
        let frames: Vec<Encoded> = (0..4 * GROUP)
            .map(|t| {
                // Each group begins with new noise; then a small part changes a little in each frame, and the rest is copied.
                let new = white(w, h, t as u64);
                let changes = |x: usize, y: usize| x / 48 + 4 * (y / 32) == t % 16;
                noise = Raster::from_fn(w, h, |x, y| match t % GROUP {
                    0 => new.at(x, y)[1],
                    _ if changes(x, y) => 0.98 * noise.at(x, y) + 0.2 * new.at(x, y)[1],
                    _ => noise.at(x, y),
                });
                Encoded(Raster::from_fn(w, h, |x, y| {
                    let v = if y < h / 2 { 0.05 } else { 1.0 } * scene.at(x, y) + STD * noise.at(x, y);
                    [0.55 + v, 0.5 + v, 0.45 + v]
                }))
            })
            .collect();
        let (std, ..) = estimated(&frames);
        assert!((std - 1.0).abs() < 0.2, "{std}");
    }

    #[test]
    fn noise_that_is_only_copied_lies_between_none_and_that_of_a_frame() {
        let (std, upper, correlation) = estimated(&frames(40, 1.0));
        assert!((0.2..1.0).contains(&std) && correlation > 0.85, "{std}, {correlation}");
        assert!((1.0..10.0).contains(&(std * upper)), "{std}, {upper}");
        // Negative control: where there is no noise, none that shows is told.
        let none = vec![Plane::filled(192 + 40, 144, 0.0); 40];
        let (std, ..) = estimated(&noisy_frames(&none));
        assert!(std * STD < 0.5 / 255.0, "{std}");
    }
}
