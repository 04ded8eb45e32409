//! A camera model for every frame, while the footage runs.
//!
//! [`Tracker`] weighs the evidence of new frames against that of old frames. Each parameter has a memory of its own: for the
//! exposure the summed log-likelihood over lambda, per block of the image; for the lens the summed log-likelihood over the blur, per
//! block and inverse depth; for the noise the local variances of the last frames. All memories are of constant size, and evidence is
//! forgotten with time, so that a slow drift is followed.
//!
//! **Changes** of shutter, focus or gain: if each of the last three frames with evidence finds the value that these three
//! agree on much more likely than the value of the frames before them (a generalised likelihood ratio), the older evidence is
//! dropped. One frame that errs is not enough. A video coder leaves more noise in some kinds of frames than in others, which is no change of
//! the camera: the noise has changed if five frames lie beyond the whole range of those before, or a dozen away from their median.
//!
//! **Bridges**: a frame that says nothing of a parameter leaves the parameter's last value; the interval widens with the time since the
//! parameter was last estimated, like that of a random walk.

use super::agreement::{ExposureObservation, FineTables, LensObservation};
use super::defocus::{self, Lens};
use super::distant::{DISTANCES, DistantPairs};
use super::geometry::{Follower, WantsParallax, check_sizes, no_parallax, parallax_of};
use super::noise::{LumaNoise, NoiseEvidence, NoiseLine};
use super::observation::FrameObservation;
use super::robust::median;
use super::sharpening;
use super::uneven::{self, Correction, Swings};
use super::{agreement, likelihood, spectral, tiles};
use crate::analysis::cuts::look_different;
use crate::analysis::depth::Parallax;
use crate::analysis::flow::motion_at_pixel;
use crate::model::{
    CameraModel, Capture, Changes, DefocusCurve, DefocusModel, DepthKind, Distortion, DistortionModel,
    Estimate, ExposureFraction, Method, MotionBlurModel, NoiseModel, Reason, SharpeningModel, Space,
    ThinLensInterval, Unknown,
};
use crate::portable::Portable;
use crate::{Encoded, Error, Flow, Plane, Result, par};
use std::borrow::Cow;
use std::collections::VecDeque;

/// The number of last frames whose own exposures the interval is held against: older evidence has faded to a third.
const READINGS: usize = 16;
/// The number of last frames with evidence that must agree on a change.
const AGREEING: usize = 3;
/// The number of nats by which each of those frames must find the new value more likely than the old one.
const SURE: f32 = 4.0;
/// The largest difference of exposure fractions that is not a change.
const SAME_EXPOSURE: f32 = 0.1;
/// The largest difference of mean blur that is not a change: in px, plus a share of the blur before.
const SAME_BLUR: (f32, f32) = (0.25, 0.1);
/// The largest share of the old lens's loss (minus its log-likelihood) that a new lens may have: some lens always suits a few tiles better.
const LEFT_OF_LENS: f32 = 0.33;
/// The share of its weight that evidence of the exposure keeps from one frame to the next.
const KEPT_EXPOSURE: f32 = 0.93;
/// The share of its weight that evidence of the lens keeps from one frame to the next.
const KEPT_LENS: f32 = 0.98;
/// The number of frames that the noise is estimated from: more than two of a coder's usual groups of pictures.
const NOISE_FRAMES: usize = 48;
/// The number of blocks of each level that the noise's curves go through: a third of what a whole clip's do, since there is a fit for each
/// frame, and what is told is a mean over frames.
const NOISE_BLOCKS: usize = 2000;
/// The pairs of distant frames that the noise of compressed footage is estimated from.
const DISTANT_PAIRS: usize = 4;
/// The number of frames of a shot after which the noise is no longer that of the kinds of frames that a coder begins with.
const SETTLED_NOISE: usize = 24;
/// The share of a frame's new estimate of the noise in what is told, unless the noise has jumped: the estimates of successive frames look at
/// different parts of the picture, and noise that differs from frame to frame would be seen to flicker.
const NEW_NOISE: f32 = 0.2;
/// The same once the noise has settled.
const NEW_SETTLED_NOISE: f32 = 0.03;
/// The std, per frame, of the random walk of an exposure fraction that is not seen.
const WALK_EXPOSURE: f32 = 0.01;
/// The relative std, per frame, of the random walk of a lens that is not seen.
const WALK_LENS: f32 = 0.02;
/// The relative std, per frame, of the random walk of noise that is not seen.
const WALK_NOISE: f32 = 0.01;
/// The number of frames whose summed log-likelihood has the width over which the exposure is averaged.
const MEAN_OF: f32 = 4.0;
/// The number of replicas of a bootstrap: fewer than for a whole clip, since there is a bootstrap for each frame.
const BOOTSTRAPS: usize = 24;
/// The most tiles of a frame that are used.
const TILES: usize = 60;
/// The most tiles of a frame that tell the direction of uneven motion.
const TURNED_TILES: usize = 16;
/// Depth from parallax, and with it the lens, is looked for in one of this many frames, since parallax takes as long as all the rest; and in
/// half as many where it was not found the last time, since the search over all directions takes longest.
const PARALLAX_STRIDE: usize = 3;
/// The largest width, px, of the halved frames in which the flow is found.
const FLOW_WIDTH: usize = 256;
/// The approximate number of px of the part of a frame in which noise is measured.
const NOISE_PART: usize = 64_000;
/// The share of confirmed matches below which relative depth starts anew with another scale.
const SCALE_CONFIRMED: f32 = 0.6;

/// Follows a camera's noise, exposure, defocus and sharpening from frame to frame by the frames alone (the spectral family), with flow
/// and depth given or estimated; clean frames are not used. Time and memory for a frame do not depend on the number of earlier frames.
///
/// ```no_run
/// # fn newest_frame() -> Option<blindaug::Encoded> { None }
/// use blindaug::fit::{Evidence, FrameObservation, track::Tracker};
/// let mut tracker = Tracker::new(Default::default(), Some(30.0));
/// let mut last = newest_frame().unwrap();
/// while let Some(newest) = newest_frame() {
///     let evidence = Evidence::default();
///     let model = tracker.push(&FrameObservation { frame: &last, next: Some(&newest), previous: None, evidence })?;
///     println!("{:?}", model.motion_blur);
///     last = newest;
/// }
/// # Ok::<(), blindaug::Error>(())
/// ```
pub struct Tracker {
    space: Space,
    fps: Option<f64>,
    size: Option<(usize, usize)>,
    frames: usize,
    follower: Follower,
    /// The flow of the last frame.
    last_flow: LastFlow,
    swings: Swings,
    /// The buffer of the flow before the last one, for reuse.
    spare: Flow,
    /// The last inverse depth that parallax gave.
    inverse_depth: Option<Plane>,
    /// The number of the first frame in which parallax is looked for again, from 0, and whether it gave depth the last time.
    next_parallax: (usize, bool),
    noise: NoiseMemory,
    distant: DistantPairs,
    luma_noise: Option<LumaNoise>,
    exposure: Memory,
    lens: Memory,
    depth_kind: Option<DepthKind>,
    known: Known,
    /// Whether the next frame belongs to another shot.
    cut_ahead: bool,
    why_no_depth: Unknown,
    model: Option<CameraModel>,
    changes: Changes,
}

/// A frame whose tiles are to be looked at, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct TileLook<'a> {
    /// The frame.
    pub frame: &'a Encoded,
    /// The motion at the frame's own time, px per frame interval, NaN where it is unknown.
    pub motion: Option<&'a Flow>,
    /// The inverse depth, NaN where it is unknown or where the lens is not to be looked at.
    pub inverse_depth: Option<&'a Plane>,
    /// The noise of luma.
    pub noise: &'a LumaNoise,
    /// The last known exposure; 0 if none is known.
    pub exposure: ExposureFraction,
    /// The camera's sharpening, if it is known.
    pub sharpening: Option<&'a SharpeningModel>,
}

/// The observations of the exposure and of the lens in the tiles of a frame.
#[derive(Clone, Debug, Default)]
pub struct TileObservations {
    /// The observations of tiles that move; their frame is 0.
    pub exposure: Vec<ExposureObservation>,
    /// The observations of tiles of one depth; their part of the clip is 0.
    pub lens: Vec<LensObservation>,
}

impl TileObservations {
    fn check(&self) -> Result<()> {
        Self::check_all(&self.exposure, &self.lens)
    }

    /// Fails if one of these is not an observation of [`spectral`].
    fn check_all(exposure: &[ExposureObservation], lens: &[LensObservation]) -> Result<()> {
        let sound = |block: u32, values: &[f32], len: usize| {
            (block as usize) < tiles::BLOCK_COUNT
                && values.len() == len
                && values.iter().all(|&v| v <= 0.0 && v.is_finite())
        };
        let sound_lens = |w: &LensObservation| {
            sound(w.block, &w.table, SIGMAS)
                && w.inverse_depth.is_finite()
                && w.tiles.is_finite()
                && w.tiles > 0.0
        };
        if exposure.iter().all(|w| sound(w.block, &w.log_likelihood, EXPOSURES))
            && lens.iter().all(sound_lens)
        {
            return Ok(());
        }
        Err(Error::new(format!(
            "an observation must lie in one of {} blocks and hold {EXPOSURES} log-likelihoods of the exposure or {SIGMAS} of the lens, finite and none of them above 0",
            tiles::BLOCK_COUNT
        )))
    }
}

/// Something that looks at the tiles of a frame in the place of the tracker itself, as the graphics device can.
pub trait TileObserver: Send {
    /// The observations in the tiles of a frame: what [`spectral::exposure_of`] and [`spectral::lens_of`] take of one frame.
    ///
    /// # Errors
    /// If the frame cannot be looked at.
    fn observe(&mut self, look: &TileLook) -> Result<TileObservations>;
}

/// The last estimate of each parameter, from the last frame whose evidence gave one.
#[derive(Default)]
struct Known {
    noise: Option<NoiseModel>,
    sharpening: Option<Estimate<SharpeningModel>>,
    exposure: Option<MotionBlurModel>,
    lens: Option<DefocusModel>,
}

/// The flow of the last frame, with its origin.
#[derive(Default)]
struct LastFlow {
    flow: Option<Flow>,
    /// Whether the flow was estimated from the frames rather than given.
    found: bool,
    /// Whether the flow leads to the next frame rather than the previous one.
    to_next: bool,
}

/// The known motion and depth of a frame.
struct Geometry<'a> {
    /// The flow to the next frame, or to the previous one if there is no next frame, px.
    flow: Option<Cow<'a, Flow>>,
    inverse_depth: Option<Cow<'a, Plane>>,
}

impl Tracker {
    /// The most bytes, approximately, that a tracker takes for frames of this size, beside the frames and their given evidence.
    pub fn bytes((width, height): (usize, usize)) -> u64 {
        /// The bytes for each pixel of a frame; measured.
        const OF_PIXEL: u64 = 62;
        OF_PIXEL * (width * height) as u64
    }

    /// A tracker that has seen nothing yet, of frames whose blur acts in this space. `fps` is only copied into the models.
    pub fn new(space: Space, fps: Option<f64>) -> Self {
        Self {
            space,
            fps,
            size: None,
            frames: 0,
            follower: Follower::new(FLOW_WIDTH, true),
            last_flow: LastFlow::default(),
            spare: Flow::filled(0, 0, [0.0; 2]),
            inverse_depth: None,
            next_parallax: (0, true),
            noise: NoiseMemory::default(),
            distant: DistantPairs::new(DISTANT_PAIRS, 0),
            swings: Swings::default(),
            luma_noise: None,
            exposure: Memory::new(CURVES + 4, KEPT_EXPOSURE),
            lens: Memory::new(tiles::BLOCK_COUNT * DEPTHS * CELL, KEPT_LENS),
            depth_kind: None,
            known: Known::default(),
            cut_ahead: false,
            why_no_depth: Unknown::new(Reason::NoDepth, "no depth was given, and nothing has moved yet"),
            model: None,
            changes: Changes::default(),
        }
    }

    /// Looks at a frame, and gives the model that holds for this frame. A live camera's frame is pushed when the next frame has
    /// arrived; [`FrameObservation::previous`] is used if there is no next frame.
    ///
    /// # Errors
    /// If a size differs from the first frame's, or the frame is not finite.
    pub fn push(&mut self, observation: &FrameObservation) -> Result<&CameraModel> {
        par::within(|| self.look_at(observation, None))
    }

    /// [`Tracker::push`], but a frame's tiles are looked at by `observer`, for example on a graphics device: motion, depth and noise are
    /// still found here.
    ///
    /// # Errors
    /// The same as [`Tracker::push`], and if the observer fails or gives what no observation can be.
    pub fn push_with(
        &mut self,
        observation: &FrameObservation,
        observer: &mut dyn TileObserver,
    ) -> Result<&CameraModel> {
        par::within(|| self.look_at(observation, Some(observer)))
    }

    fn look_at(
        &mut self,
        observation: &FrameObservation,
        observer: Option<&mut dyn TileObserver>,
    ) -> Result<&CameraModel> {
        check_sizes(&mut self.size, observation)?;
        let FrameObservation { frame, next, previous, .. } = *observation;
        let (width, height) = frame.0.size();
        let capture =
            Capture { width, height, fps: self.fps, frames_used: self.frames + 1, pixel_aspect: 1.0 };
        self.changes = Changes::default();
        self.begin_shot();
        let geometry = self.geometry(observation)?;
        let neighbour = if observation.evidence.flow.is_some() { next } else { next.or(previous) };
        let mut model = CameraModel::unknown(capture, "");
        (model.blur_space, model.transfer) = (self.space.blur, self.space.transfer);
        model.noise = self.follow_noise(frame, neighbour.zip(geometry.flow.as_deref()))?;
        let to_next = next.is_some() || observation.evidence.flow.is_some();
        let flow = geometry.flow.as_deref();
        // The shutter is open around the frame's own time, not on the way to the next frame.
        let last = self.last_flow.flow.as_ref().filter(|_| to_next && self.last_flow.to_next);
        model.sharpening = self.known.sharpening.clone().unwrap_or_else(|| {
            Estimate::unknown(
                Reason::NotFollowed,
                "it shows in noise between frames, and none was seen in this shot so far",
            )
        });
        let sharpening = model.sharpening.known();
        // Few tiles are looked at, so that the motion is found at their pixels only.
        let mean_of = flow.map(|flow| {
            move |x: usize, y: usize| match last {
                Some(last) => motion_at_pixel(flow, last, x, y),
                None => flow.at(x, y),
            }
        });
        let mean_of = mean_of.as_ref().map(|of| of as &tiles::MotionOf);
        let depth = geometry.inverse_depth.as_deref();
        let correction = match (mean_of, self.luma_noise, observation.evidence.flow) {
            (Some(motion), Some(noise), None) => {
                let (mut swing, change) = self.swings.next(flow.filter(|_| to_next), motion);
                if swing.error > 0.0 {
                    let mut corners = self.corners(frame, mean_of, depth);
                    corners.truncate(TURNED_TILES);
                    swing.angle = uneven::turn(frame, &corners, motion, change, &noise, self.space);
                }
                swing
            }
            _ => {
                self.swings.forget();
                Correction::NONE
            }
        };
        if correction.begins {
            // What swings now swung in the last frames, too, which did not allow for it.
            self.exposure.forget_recent();
        }
        let of = mean_of.map(|of| move |x: usize, y: usize| correction.of(of(x, y)));
        let motion = of.as_ref().map(|of| of as &tiles::MotionOf);
        match (observer, self.luma_noise) {
            // What noise cannot be told from tells nothing of blur.
            (_, None) => {
                model.motion_blur = self.follow_exposure(&[]);
                model.defocus = self.follow_lens(&[])?;
            }
            (Some(observer), Some(noise)) => {
                let motion =
                    motion.zip(flow).map(|(of, flow)| Flow::from_fn(flow.width(), flow.height(), of));
                // Streaks of unknown length look like a lens's blur.
                let is_moving = |x: usize, y: usize| {
                    let [u, v] = motion.as_ref().map_or([0.0; 2], |m| m.at(x, y));
                    u.portable_hypot(v) >= spectral::STILL
                };
                let still = depth.filter(|_| self.known.exposure.is_none()).map(|d| {
                    let known = |x, y| if is_moving(x, y) { f32::NAN } else { d.at(x, y) };
                    Plane::from_fn(d.width(), d.height(), known)
                });
                let mut found = observer.observe(&TileLook {
                    frame,
                    motion: motion.as_ref(),
                    inverse_depth: still.as_ref().or(depth),
                    noise: &noise,
                    exposure: self.exposure(),
                    sharpening,
                })?;
                found.check()?;
                found.exposure.iter_mut().for_each(|w| w.speed_error = correction.error);
                model.motion_blur = self.follow_exposure(&found.exposure);
                model.defocus = self.follow_lens(&found.lens)?;
            }
            (None, Some(noise)) => {
                let corners = self.corners(frame, mean_of, depth);
                let mut tiles = tiles::tiles_at(frame, &corners, motion, depth, self.space);
                tiles.iter_mut().for_each(|t| t.speed_error = correction.error);
                let found = spectral::exposure_observations(&[&tiles], &noise);
                model.motion_blur = self.follow_exposure(&found);
                if self.known.exposure.is_none() {
                    // Streaks of unknown length look like a lens's blur.
                    tiles.retain(|t| t.speed * t.scale < spectral::STILL);
                }
                let exposure = self.exposure();
                let found =
                    spectral::lens_observations(&[&tiles], &noise, exposure, sharpening, spectral::lens_gain);
                model.defocus = self.follow_lens(&found)?;
            }
        }
        let found = matches!(geometry.flow, Some(Cow::Owned(_)));
        let flow = geometry.flow.map(Cow::into_owned);
        let before = std::mem::replace(&mut self.last_flow, LastFlow { flow, found, to_next });
        if let Some(memory) = before.flow {
            self.spare = memory;
        }
        if let Some(Cow::Owned(depth)) = geometry.inverse_depth {
            self.inverse_depth = Some(depth);
        }
        self.frames += 1;
        model.validate()?;
        Ok(self.model.insert(model))
    }

    /// Forgets all evidence if the last frame was the last of its shot, since another shot may be another camera's.
    fn begin_shot(&mut self) {
        if std::mem::take(&mut self.cut_ahead) {
            self.exposure.forget();
            self.lens.forget();
            (self.noise, self.known) = (NoiseMemory::default(), Known::default());
            self.distant.forget();
            self.last_flow.flow = None;
            self.swings.forget();
            self.next_parallax = (0, true);
        }
    }

    /// Takes the observations of a frame's exposure and lens that were found elsewhere, for example on a graphics device, and the unit of
    /// their inverse depth, instead of the frame itself. The observations must have been found with [`Tracker::luma_noise`] and the last
    /// model's exposure and sharpening. The noise stays as it is until a frame is pushed again.
    ///
    /// # Errors
    /// If no frame was pushed before, an observation is not one of [`spectral`], or depth is in another unit than before.
    pub fn push_observations(
        &mut self,
        exposure: &[ExposureObservation],
        lens: &[LensObservation],
        depth_kind: DepthKind,
    ) -> Result<&CameraModel> {
        let Some(mut model) = self.model.clone() else {
            return Err(Error::new("nothing is known of the noise yet: push a frame first"));
        };
        TileObservations::check_all(exposure, lens)?;
        if !lens.is_empty() {
            self.measure_depth_in(depth_kind)?;
        }
        self.last_flow = LastFlow::default();
        self.changes = Changes::default();
        self.begin_shot();
        model.motion_blur = self.follow_exposure(exposure);
        model.defocus = self.follow_lens(lens)?;
        self.frames += 1;
        model.capture.frames_used = self.frames;
        model.validate()?;
        Ok(self.model.insert(model))
    }

    /// The noise of luma, if it is known so far.
    pub fn luma_noise(&self) -> Option<&LumaNoise> {
        self.luma_noise.as_ref()
    }

    /// The last known exposure; 0 if none is known, since nothing then shows that anything moves.
    fn exposure(&self) -> ExposureFraction {
        self.known.exposure.map_or(ExposureFraction(0.0), |m| m.exposure)
    }

    fn measure_depth_in(&mut self, kind: DepthKind) -> Result<()> {
        if self.depth_kind.is_some_and(|k| k != kind) {
            return Err(Error::new("depth in one unit cannot follow depth in another: give all in one"));
        }
        self.depth_kind = Some(kind);
        Ok(())
    }

    /// Whether the noise rests on so few frames of this shot that those to come will correct it: a video coder leaves more noise in the
    /// first frames than in those that follow.
    pub fn noise_settles(&self) -> bool {
        self.noise.seen < SETTLED_NOISE
    }

    /// Whether the next frame belongs to another shot.
    pub fn cut_ahead(&self) -> bool {
        self.cut_ahead
    }

    /// The model of the last frame; `None` before the first.
    pub fn model(&self) -> Option<&CameraModel> {
        self.model.as_ref()
    }

    /// The last frame's flow to the next frame (to the previous frame if there was no next one), px, NaN where it is unknown;
    /// `None` if the flow was given, or could not be found.
    pub fn flow(&self) -> Option<&Flow> {
        self.last_flow.flow.as_ref().filter(|_| self.last_flow.found)
    }

    /// The last relative inverse depth that parallax gave, for one of the last frames, in the unit of the models' lens.
    pub fn inverse_depth(&self) -> Option<&Plane> {
        self.inverse_depth.as_ref()
    }

    /// The distortions whose parameters were found to have changed in the last frame.
    pub fn changes(&self) -> Changes {
        self.changes
    }

    fn geometry<'a>(&mut self, observation: &FrameObservation<'a>) -> Result<Geometry<'a>> {
        let FrameObservation { frame, next, previous, evidence } = *observation;
        let mut geometry = Geometry { flow: None, inverse_depth: None };
        let wants_parallax = evidence.inverse_depth.is_none()
            && self.depth_kind != Some(DepthKind::Metric)
            && self.frames >= self.next_parallax.0;
        let stride = if self.next_parallax.1 { PARALLAX_STRIDE } else { 2 * PARALLAX_STRIDE };
        let mut parallax = None;
        if let Some(flow) = evidence.flow {
            geometry.flow = Some(Cow::Borrowed(flow));
            if wants_parallax {
                parallax = Some(parallax_of(flow)?);
            }
        } else if let Some(other) = next.or(previous) {
            let wants = WantsParallax { confirmed: SCALE_CONFIRMED, stride };
            let spare = std::mem::replace(&mut self.spare, Flow::filled(0, 0, [0.0; 2]));
            let followed = self.follower.follow(frame, other, wants_parallax.then_some(wants), spare)?;
            match followed.flow {
                Some(flow) => geometry.flow = Some(Cow::Owned(flow)),
                None => self.cut_ahead = next.is_some_and(|next| look_different(frame, next)),
            }
            parallax = followed.parallax;
            if followed.confirmed < SCALE_CONFIRMED {
                self.follower.forget_scale();
                self.inverse_depth = None;
                if self.depth_kind == Some(DepthKind::Relative) {
                    // Relative depth is in another unit from here on.
                    self.lens.forget();
                }
            }
        }
        if let Some((given, kind)) = evidence.inverse_depth {
            self.measure_depth_in(kind)?;
            geometry.inverse_depth = Some(Cow::Borrowed(given));
        }
        if wants_parallax {
            self.next_parallax = (self.frames + stride, matches!(parallax, Some(Parallax::Known(_))));
        }
        match parallax {
            Some(Parallax::Known(depth)) => {
                self.depth_kind = Some(DepthKind::Relative);
                geometry.inverse_depth = Some(Cow::Owned(depth.inverse_depth));
            }
            Some(Parallax::Unknown(why)) => {
                self.why_no_depth = no_parallax(&why);
            }
            None => {}
        }
        Ok(geometry)
    }

    fn follow_noise(
        &mut self,
        frame: &Encoded,
        neighbour: Option<(&Encoded, &Flow)>,
    ) -> Result<Estimate<NoiseModel>> {
        let mut evidence = NoiseEvidence::new(Method::Temporal);
        let mut part = 0;
        if let Some((other, flow)) = neighbour {
            // Strips of the frame are used in turn. Their height is a multiple of the side of the coarsest level's blocks.
            const STEP: usize = 32;
            let (w, h) = frame.0.size();
            let parts = (w * h).div_ceil(NOISE_PART).min((h / STEP).max(1));
            let edge = |part: usize| if part == parts { h } else { part * (h / STEP) / parts * STEP };
            part = self.frames % parts;
            evidence.add_pair_rows(frame, other, flow, edge(part)..edge(part + 1))?;
        }
        let model = self.luma_noise.unwrap_or_default().levels[0];
        let jumped = self.noise.push(evidence, part, &model);
        self.changes.set(Distortion::Noise, jumped);
        if jumped {
            self.distant.forget();
            // The recent evidence of blur was found with the wrong noise.
            self.exposure.forget_recent();
            self.lens.forget_recent();
        }
        let near = self.noise.middle(&model);
        // Distant frames are compared seldom, so a larger part of them.
        let (w, h) = frame.0.size();
        let turns = (w * h).div_ceil(4 * NOISE_PART).min((h / 64).max(1));
        let (coded, turn) =
            (self.luma_noise.is_some_and(|n| n.may_be_compressed()), self.frames / DISTANCES.start() % turns);
        self.distant.push((self.frames, frame), || coded, &mut self.follower, (turn, turns))?;
        let mut fit = self.distant.complete(&near, near.fit_to(NOISE_BLOCKS));
        if fit.luma.is_none() && self.known.noise.is_none() {
            let mut single = NoiseEvidence::new(Method::Spatial);
            single.add_single(frame);
            fit = single.fit();
        }
        self.luma_noise = fit.luma.or(self.luma_noise);
        let Some(fresh) = fit.model.known() else {
            return Ok(match &self.known.noise {
                Some(noise) => Estimate::Known(walked_noise(noise, self.noise.age)),
                None => fit.model,
            });
        };
        let mut told = fresh.clone();
        if fresh.method() == Method::Temporal {
            if let Some(before) = self.known.noise.as_ref().filter(|_| !jumped) {
                let settled = self.noise.frames.len() >= SETTLED_NOISE;
                told = before.between(fresh, if settled { NEW_SETTLED_NOISE } else { NEW_NOISE });
            }
            self.known.noise = Some(told.clone());
            let fresh = sharpening::of_noise(&fit);
            let before = self.known.sharpening.as_ref().and_then(Estimate::known);
            let jumped = before.zip(fresh.known()).is_some_and(|(a, b)| {
                // The amount has jumped if the intervals do not overlap.
                a.interval[1] < b.interval[0] || b.interval[1] < a.interval[0]
            });
            self.changes.set(Distortion::Sharpening, jumped);
            self.known.sharpening = Some(fresh);
        }
        Ok(Estimate::Known(walked_noise(&told, self.noise.age)))
    }

    /// The corners of some of the frame's tiles, different ones in successive frames: those of most contrast among the tiles that move fast
    /// enough or have a known depth, that with most first.
    fn corners(
        &self,
        frame: &Encoded,
        motion: Option<&tiles::MotionOf>,
        depth: Option<&Plane>,
    ) -> Vec<(usize, usize)> {
        if motion.is_none() && depth.is_none() {
            return vec![];
        }
        let all = tiles::corners(frame.0.size());
        let turns = (all.len() / (2 * TILES)).max(1);
        let tried = all.into_iter().skip(self.frames % turns).step_by(turns);
        tiles::of_most_contrast(frame, tried, motion, depth, TILES)
    }

    /// The exposure with the observations of another frame.
    fn follow_exposure(&mut self, found: &[ExposureObservation]) -> Estimate<MotionBlurModel> {
        let speed_error = found.iter().map(|w| w.speed_error).fold(0.0, f32::max);
        let turn = self.frames % tiles::BLOCK_COUNT;
        let memory = &mut self.exposure;
        memory.fade();
        let mut fits = None;
        if !found.is_empty() {
            let mut evidence = vec![0.0; memory.old.len()];
            let (curves, moments) = evidence.split_at_mut(CURVES);
            for w in found {
                let at = w.block as usize * EXPOSURES;
                curves[at..at + EXPOSURES].iter_mut().zip(&w.log_likelihood).for_each(|(s, v)| *s += v);
                let uneven = if speed_error > 0.0 { 1.0 } else { 0.0 };
                moments.iter_mut().zip([1.0, w.speed, w.speed * w.speed, uneven]).for_each(|(s, v)| *s += v);
            }
            if speed_error > 0.0 {
                // All tiles of the frame err alike, and those of other frames otherwise: the frame takes the place of a block.
                let curve = uneven::over_speeds(&curve_of(&evidence), speed_error);
                evidence[..CURVES].fill(0.0);
                evidence[turn * EXPOSURES..][..EXPOSURES].copy_from_slice(&curve);
            }
            let reading = if found.len() >= agreement::FEWEST {
                agreement::most_likely_exposure(&curve_of(&evidence)).min(1.0)
            } else {
                f32::NAN
            };
            memory.add(evidence, reading);
            if exposure_changed(memory) {
                memory.forget_old();
                self.changes.set(Distortion::MotionBlur, true);
                // The recent evidence of the lens was found with the wrong exposure.
                self.lens.forget_recent();
            }
            let sum = memory.sum();
            let (curves, moments) = sum.split_at(CURVES);
            let (tiles, speed) = (moments[0], agreement::typical_speed(moments[1], moments[2]));
            let mut curve = curve_of(&sum);
            let even = 2.0 * moments[3] <= tiles;
            if !even {
                // What seems longer than a frame was faster than its flow says.
                curve[FRAME_LONG + 1..].fill(f32::MIN);
            }
            let estimate = mean_exposure(&curve, memory.weight);
            let parts: Vec<(u32, usize, Vec<f32>)> = (0..)
                .zip(curves.chunks(EXPOSURES))
                .filter(|(_, c)| c.iter().any(|&v| v < 0.0))
                .map(|(block, c)| (block, 0, c.to_vec()))
                .collect();
            let coding_error = self.luma_noise.map_or(0.0, |n| n.coding_error);
            let interval =
                agreement::exposure_interval(estimate, &curve, &parts, BOOTSTRAPS, coding_error, speed);
            let interval =
                agreement::with_typical_frame(interval, memory.readings.iter().copied(), even, speed);
            let possible = agreement::most_likely_exposure(&curve) <= agreement::LONGEST;
            if tiles >= agreement::FEWEST as f32 && possible {
                fits = Some(interval.map(|v| v.clamp(0.0, 1.0)));
                if interval[1] - interval[0] <= agreement::MAX_UNCERTAINTY {
                    memory.age = 0;
                    self.known.exposure = Some(MotionBlurModel {
                        exposure: ExposureFraction(estimate.min(1.0)),
                        interval,
                        method: Method::Spectral,
                        samples: tiles.round() as u64,
                        phase_degrees: None,
                    });
                }
            }
        }
        let Some(known) = self.known.exposure else {
            let why = "in this shot so far, too little has moved, or what moved has too little texture";
            return Estimate::Unknown(Unknown { fits, ..Unknown::new(Reason::NoMotion, why) });
        };
        let [low, high] = walked(known.interval, known.exposure.0, WALK_EXPOSURE, memory.age);
        Estimate::Known(MotionBlurModel { interval: [low, high.min(1.0)], ..known })
    }

    fn follow_lens(&mut self, found: &[LensObservation]) -> Result<Estimate<DefocusModel>> {
        let memory = &mut self.lens;
        memory.fade();
        let mut why = self.why_no_depth.clone();
        if let (false, Some(depth_kind)) = (found.is_empty(), self.depth_kind) {
            let mut evidence = vec![0.0; memory.old.len()];
            for w in found {
                let cell = w.block as usize * DEPTHS + depth_bin(w.inverse_depth);
                let cell = &mut evidence[cell * CELL..][..CELL];
                cell.iter_mut().zip(&w.table).for_each(|(s, v)| *s += v.max(-likelihood::CLIP * w.tiles));
                cell[SIGMAS] += w.tiles * w.inverse_depth;
                cell[SIGMAS + 1] += w.tiles;
            }
            memory.add(evidence, f32::NAN);
            if lens_changed(memory) {
                memory.forget_old();
                self.changes.set(Distortion::Defocus, true);
            }
            match agreement::lens_of(&observations_of(&memory.sum()), BOOTSTRAPS)? {
                Estimate::Known(fit) => {
                    let curve = DefocusCurve::ThinLens {
                        sigma_px_at_infinity: fit.lens.sigma_px_at_infinity(),
                        focus_inverse_depth: fit.lens.focus,
                        interval: Some(ThinLensInterval {
                            sigma_px_at_infinity: fit.sigma_px_at_infinity,
                            focus_inverse_depth: fit.focus_inverse_depth,
                        }),
                    };
                    let (method, samples) = (Method::Spectral, fit.samples as u64);
                    memory.age = 0;
                    let inverse_depth_seen = Some(fit.inverse_depth_seen);
                    self.known.lens = Some(DefocusModel {
                        method,
                        samples,
                        inverse_depth_seen,
                        ..DefocusModel::given(curve, depth_kind)
                    });
                }
                Estimate::Unknown(reason) => why = reason,
            }
        }
        let Some(mut known) = self.known.lens else { return Ok(Estimate::Unknown(why)) };
        if let DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval: Some(i) } =
            &mut known.curve
        {
            i.sigma_px_at_infinity = walked(i.sigma_px_at_infinity, *s, WALK_LENS * *s, memory.age);
            i.focus_inverse_depth = walked(i.focus_inverse_depth, *f, WALK_LENS * *f, memory.age);
        }
        Ok(Estimate::Known(known))
    }
}

/// Widens the 95 % interval of a value that was last estimated `age` frames ago and walks randomly by `step` (std) per frame.
fn walked([low, high]: [f32; 2], value: f32, step: f32, age: usize) -> [f32; 2] {
    let reach = 1.96 * step * (age as f32).sqrt();
    [
        (value - (value - low).max(0.0).portable_hypot(reach)).max(0.0),
        value + (high - value).max(0.0).portable_hypot(reach),
    ]
}

fn walked_noise(noise: &NoiseModel, age: usize) -> NoiseModel {
    let mut walked_noise = noise.clone();
    let noise = walked_noise.lines_mut();
    for (level, interval) in noise.levels.iter().zip(noise.interval.iter_mut().flatten()) {
        for c in 0..3 {
            let step = WALK_NOISE * level.intercept[c];
            interval.intercept[c] = walked(interval.intercept[c], level.intercept[c], step, age);
            let reach = 1.96 * WALK_NOISE * level.slope[c].abs() * (age as f32).sqrt();
            let [low, high] = interval.slope[c];
            let side = |deviation: f32| deviation.max(0.0).portable_hypot(reach);
            interval.slope[c] =
                [level.slope[c] - side(level.slope[c] - low), level.slope[c] + side(high - level.slope[c])];
        }
    }
    walked_noise
}

/// Sums of evidence, in which older frames count less and less. The last [`AGREEING`] frames are kept apart.
struct Memory {
    /// The faded sum of the evidence of all but the last frames.
    old: Vec<f32>,
    /// The faded evidence of each of the last frames.
    recent: VecDeque<Vec<f32>>,
    /// What each of the last frames tells by itself, at most [`READINGS`] of them; NaN for a frame that tells nothing.
    readings: VecDeque<f32>,
    /// The share of its weight that evidence keeps from one frame to the next.
    kept: f32,
    /// The number of frames in the memory, older frames counting less.
    weight: f32,
    /// The number of frames since the last estimate.
    age: usize,
}

impl Memory {
    fn new(len: usize, kept: f32) -> Self {
        Self {
            old: vec![0.0; len],
            recent: VecDeque::new(),
            readings: VecDeque::new(),
            kept,
            age: 0,
            weight: 0.0,
        }
    }

    /// Lets a frame pass: all evidence fades.
    fn fade(&mut self) {
        self.age += 1;
        self.weight *= self.kept;
        // Sums that get no new evidence would fade into denormal numbers, which are slow.
        let fade = |v: &mut f32| *v = if v.abs() < 1e-12 { 0.0 } else { *v * self.kept };
        self.old.iter_mut().chain(self.recent.iter_mut().flatten()).for_each(fade);
    }

    /// Adds a frame's evidence, and what the frame tells by itself.
    fn add(&mut self, evidence: Vec<f32>, reading: f32) {
        self.weight += 1.0;
        self.readings.push_back(reading);
        if self.readings.len() > READINGS {
            self.readings.pop_front();
        }
        self.recent.push_back(evidence);
        if self.recent.len() > AGREEING
            && let Some(first) = self.recent.pop_front()
        {
            self.old.iter_mut().zip(first).for_each(|(s, v)| *s += v);
        }
    }

    fn recent_sum(&self) -> Vec<f32> {
        let mut sum = vec![0.0; self.old.len()];
        self.recent.iter().for_each(|r| sum.iter_mut().zip(r).for_each(|(s, v)| *s += v));
        sum
    }

    fn sum(&self) -> Vec<f32> {
        let mut sum = self.recent_sum();
        sum.iter_mut().zip(&self.old).for_each(|(s, v)| *s += v);
        sum
    }

    fn forget_old(&mut self) {
        self.old.fill(0.0);
        self.weight = self.recent.len() as f32;
        self.readings.drain(..self.readings.len().saturating_sub(self.recent.len()));
    }

    fn forget(&mut self) {
        self.forget_old();
        self.forget_recent();
    }

    fn forget_recent(&mut self) {
        self.weight = (self.weight - self.recent.len() as f32).max(0.0);
        self.readings.truncate(self.readings.len().saturating_sub(self.recent.len()));
        self.recent.clear();
    }
}

const EXPOSURES: usize = likelihood::EXPOSURES;
/// The index, in a curve, of an exposure as long as a frame interval.
const FRAME_LONG: usize = (1.0 / likelihood::EXPOSURE_STEP + 0.5) as usize;
/// The length of the curves in the exposure's evidence, one for each block. The number of tiles, the sum of their speeds, the sum of
/// the squared speeds and the number of those in frames of uneven motion follow them.
const CURVES: usize = tiles::BLOCK_COUNT * EXPOSURES;

/// The sum of the blocks' curves.
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

/// Whether the last frames agree on an exposure that differs from that of the frames before them.
fn exposure_changed(memory: &Memory) -> bool {
    if memory.recent.len() < AGREEING || memory.old[CURVES] < 6.0 {
        return false;
    }
    let at = |v: f32| (v / likelihood::EXPOSURE_STEP).round() as usize;
    let before = at(agreement::most_likely_exposure(&curve_of(&memory.old)));
    let now = at(agreement::most_likely_exposure(&curve_of(&memory.recent_sum())));
    now.abs_diff(before) > at(SAME_EXPOSURE)
        && memory.recent.iter().all(|frame| {
            let curve = curve_of(frame);
            curve[now] - curve[before] > SURE
        })
}

const SIGMAS: usize = likelihood::SIGMAS;
/// The length of a cell of the lens's evidence. There is a cell for each block of the image and bin of inverse depth, with its table, the
/// sum of its tiles' inverse depths, and the number of its tiles.
const CELL: usize = SIGMAS + 2;
/// The number of bins of inverse depth: 8 per octave from 1/256 to 16; the first and the last bin also hold values outside this range.
const DEPTHS: usize = 96;

fn depth_bin(inverse_depth: f32) -> usize {
    (8.0 * (inverse_depth.max(1e-6).portable_log2() + 8.0)).clamp(0.0, (DEPTHS - 1) as f32) as usize
}

fn observations_of(evidence: &[f32]) -> Vec<LensObservation> {
    evidence
        .chunks(CELL)
        .enumerate()
        .filter(|(_, cell)| cell[SIGMAS + 1] > 0.05)
        .map(|(i, cell)| LensObservation {
            inverse_depth: cell[SIGMAS] / cell[SIGMAS + 1],
            table: cell[..SIGMAS].to_vec(),
            tiles: cell[SIGMAS + 1],
            block: (i / DEPTHS) as u32,
            part: 0,
        })
        .collect()
}

/// Whether the last frames agree on a lens that differs from that of the frames before them.
fn lens_changed(memory: &Memory) -> bool {
    if memory.recent.len() < AGREEING {
        return false;
    }
    let best = |observations: &[LensObservation], tables: &FineTables| -> Option<Lens> {
        (observations.iter().map(|w| w.tiles).sum::<f32>() >= 8.0).then(|| {
            defocus::best_lens(agreement::lens_range(observations), |l| tables.log_likelihood(l, None))
        })
    };
    let [old, recent] = [observations_of(&memory.old), observations_of(&memory.recent_sum())];
    let of_recent = FineTables::new(&recent);
    let (Some(before), Some(now)) = (best(&old, &FineTables::new(&old)), best(&recent, &of_recent)) else {
        return false;
    };
    let mean = |of: &dyn Fn(f32) -> f32| {
        let tiles: f32 = recent.iter().map(|w| w.tiles).sum();
        recent.iter().map(|w| w.tiles * of(w.inverse_depth)).sum::<f32>() / tiles
    };
    let likelihood = |lens| of_recent.log_likelihood(lens, None);
    mean(&|d| (now.sigma_px(d) - before.sigma_px(d)).abs())
        > SAME_BLUR.0 + SAME_BLUR.1 * mean(&|d| before.sigma_px(d))
        && likelihood(now) >= LEFT_OF_LENS * likelihood(before)
        && memory.recent.iter().all(|frame| {
            let tables = FineTables::new(&observations_of(frame));
            let of = |lens| tables.log_likelihood(lens, None);
            of(now) - of(before) > SURE
        })
}

/// The local variances of the last frames that gave evidence of noise.
///
/// In footage that was compressed, the noise differs from frame to frame with the kind of each frame, while the camera stays the same. So
/// the noise is that of the frames in the middle, and a change is one of all kinds of frames.
#[derive(Default)]
struct NoiseMemory {
    /// The evidence of up to [`NOISE_FRAMES`] frames, each with the index of the part of the picture that it is about.
    frames: VecDeque<(NoiseEvidence, usize)>,
    /// The number of frames since the last evidence.
    age: usize,
    /// The number of frames of the shot.
    seen: usize,
}

impl NoiseMemory {
    /// Adds the evidence of the part of a frame with this index, and says whether the noise has changed. The frames are compared with each
    /// other by how much their noise exceeds that of `model`.
    fn push(&mut self, evidence: NoiseEvidence, part: usize, model: &NoiseLine) -> bool {
        self.age += 1;
        self.seen += 1;
        if evidence.log_ratio(model).is_none() {
            return false;
        }
        self.age = 0;
        self.frames.push_back((evidence, part));
        if self.frames.len() > NOISE_FRAMES {
            self.frames.pop_front();
        }
        let changed = noise_changed(&self.excesses(model));
        if let Some(since) = changed {
            self.frames.drain(..self.frames.len() - since);
        }
        changed.is_some()
    }

    /// The log of each frame's noise std over that of `model`, and the index of the frame's part.
    fn excesses(&self, model: &NoiseLine) -> Vec<Excess> {
        /// The least std, a quarter of a step of 8 bits: what is less cannot be seen, and says nothing of a camera.
        const LEAST: f32 = 0.25 / 255.0;
        let least = (LEAST / (0.4 * model.slope + model.intercept).max(1e-4)).portable_ln();
        let of = |(frame, part): &(NoiseEvidence, usize)| Excess {
            part: *part,
            log: frame.log_ratio(model).unwrap_or(least).max(least),
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
        middle.for_each(|((frame, _), _)| all.merge(frame));
        all
    }
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

/// The number of last frames whose noise is another than that of the frames before them, if there are such.
///
/// Either the last few frames all lie beyond the whole range of those before, or the median of the last dozen is away from that of those
/// before by much more than both scatter. A dozen frames are those of a coder's usual group of pictures, or half of it.
fn noise_changed(frames: &[Excess]) -> Option<usize> {
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
    LAST.into_iter().find(|&last| {
        let Some(first) = frames.len().checked_sub(last) else { return false };
        let before = &frames[first.saturating_sub(BEFORE.1)..first];
        if before.len() < BEFORE.0 {
            return false;
        }
        let (now, usual) = (apart(&frames[first..], before), apart(before, before));
        let middle = |v: &[f32]| median(v.to_vec()).unwrap_or(0.0);
        let shift = middle(&now);
        let (early, late) = usual.split_at(usual.len() / 2);
        if (middle(late) - middle(early)).abs() > DRIFT * shift.abs() {
            return false;
        }
        if last == LAST[0] {
            let beyond = |sign: f32| {
                let most = usual.iter().map(|v| sign * v).fold(0.0, f32::max);
                now.iter().all(|v| sign * v > most + BEYOND)
            };
            return beyond(1.0) || beyond(-1.0);
        }
        // The median absolute deviation of normal numbers is their std over 1.48; the median of n has 1.25 times the error of the mean.
        let scatter = (1.48 * middle(&usual.iter().map(|v| v.abs()).collect::<Vec<_>>())).max(SCATTER);
        let error = 1.25 * scatter * (1.0 / last as f32 + 1.0 / usual.len() as f32).sqrt();
        let same_side = now.iter().filter(|v| *v * shift > 0.0).count() as f32;
        shift.abs() > SHIFT.0.max(SHIFT.1 * error) && same_side >= SAME_SIDE * last as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_frames_tell_by_themselves_is_forgotten_with_their_evidence() {
        let of = |n: usize| {
            let mut memory = Memory::new(1, 0.9);
            (0..n).for_each(|i| memory.add(vec![1.0], i as f32));
            memory
        };
        let mut recent = of(5);
        recent.forget_recent();
        assert_eq!(recent.readings, [0.0, 1.0]);
        let mut old = of(5);
        old.forget_old();
        assert_eq!(old.readings, [2.0, 3.0, 4.0]);
        assert_eq!(of(40).readings.len(), READINGS);
        let mut all = of(40);
        all.forget();
        assert!(all.readings.is_empty());
    }

    #[test]
    fn an_interval_widens_with_the_root_of_time() {
        let [low, high] = walked([0.4, 0.6], 0.5, 0.01, 100);
        assert!((high - 0.5 - 0.1f32.hypot(0.196)).abs() < 1e-5 && (low + high - 1.0).abs() < 1e-5);
        assert_eq!(walked([0.4, 0.6], 0.5, 0.01, 0).map(|v| (v * 1e4).round()), [4000.0, 6000.0]);
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
                .filter(|&n| noise_changed(&all[n.saturating_sub(NOISE_FRAMES)..n]).is_some())
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
