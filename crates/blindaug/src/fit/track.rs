//! A camera model for every frame, while the footage runs.
//!
//! [`Tracker`] weighs the evidence of new frames against that of old frames. Each parameter has a memory of its own: for the
//! exposure the summed log-likelihood over lambda, per block of the image; for the lens the summed log-likelihood over the blur, per
//! block and inverse depth, and that of the shape of out-of-focus points; for the noise the local variances of the last frames. Where motion is uneven, as under a shaking hand, the streaks of
//! successive frames tell the exposure together. All memories are of constant size, and evidence is forgotten with time, so that a slow drift
//! is followed.
//!
//! **Changes** of shutter, focus or gain: if each of the last three frames with evidence finds the value that these three
//! agree on much more likely than the value of the frames before them (a generalised likelihood ratio), the older evidence is
//! dropped. One frame that errs is not enough. A video coder leaves more noise in some kinds of frames than in others, which is no change of
//! the camera: the noise has changed if five frames lie beyond the whole range of those before, or a dozen away from their median, and if
//! compressed frames themselves hold another noise, too.
//!
//! **Bridges**: a frame that says nothing of a parameter leaves the parameter's last value; the interval widens with the time since the
//! parameter was last estimated, like that of a random walk.

mod exposure;
mod lens;
mod memory;
mod noise;
mod shape;
mod streaks;

use self::exposure::{EXPOSURES, ExposureMemory, Followed};
use self::lens::{LensMemory, OfLens, SIGMAS};
use self::noise::NoiseFollower;
use self::streaks::StreaksMemory;
use super::agreement::{ExposureObservation, LensObservation};
use super::defocus::Lens;
use super::geometry::{Follower, WantsParallax, check_sizes, no_parallax, parallax_of};
use super::noise::LumaNoise;
use super::observation::FrameObservation;
use super::streaks::Link;
use super::tiles::Tile;
use super::timing::{Copies, Look};
use super::uneven::{self, Correction, Swings};
use super::warnings::{coding_warning, few_frames};
use super::{bokeh, likelihood, spectral, tiles};
use crate::analysis::active_area::ActiveArea;
use crate::analysis::cuts::look_different;
use crate::analysis::depth::Parallax;
use crate::analysis::flow::motion_at_pixel;
use crate::model::{
    CameraModel, Capture, Changes, DefocusModel, DepthKind, Distortion, Estimate, ExposureFraction,
    MotionBlurModel, NoiseModel, Reason, SharpeningModel, Space, Unknown,
};
use crate::portable::Portable;
use crate::{Encoded, Error, Flow, Plane, Result, par};
use std::borrow::Cow;

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
    /// The [`fingerprint`] of the last frame.
    last_frame: Option<u64>,
    copies: Copies,
    /// The flow to the next frame where that is not the motion: to a copy, and over missing frames.
    flow_to_next: Option<Flow>,
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
    noise: NoiseFollower,
    /// The noise of the last frame; its interval does not hold the error that all frames share.
    scattering: Option<Estimate<NoiseModel>>,
    exposure: ExposureMemory,
    streaks: StreaksMemory,
    lens: LensMemory,
    depth_kind: Option<DepthKind>,
    /// Whether the next frame belongs to another shot.
    cut_ahead: bool,
    why_no_lens: Unknown,
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
        let sound_exposure = |w: &ExposureObservation| {
            sound(w.block, &w.log_likelihood, EXPOSURES)
                && w.speed.is_finite()
                && w.speed > 0.0
                && w.speed_error.is_finite()
                && w.speed_error >= 0.0
        };
        if exposure.iter().all(sound_exposure) && lens.iter().all(sound_lens) {
            return Ok(());
        }
        Err(Error::new(format!(
            "an observation must lie in one of {} blocks and hold {EXPOSURES} log-likelihoods of the exposure or {SIGMAS} of the lens, finite and none of them above 0; its speed must be above 0, and the speed's error at least 0",
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
        /// The bytes for each pixel of a frame; measured, and those of the frame before one that is repeated.
        const OF_PIXEL: u64 = 62 + 12;
        OF_PIXEL * (width * height) as u64
    }

    /// A tracker that has seen nothing yet, of frames whose blur acts in this space. `fps` is only copied into the models.
    pub fn new(space: Space, fps: Option<f64>) -> Self {
        Self {
            space,
            fps,
            size: None,
            frames: 0,
            last_frame: None,
            copies: Copies::default(),
            flow_to_next: None,
            follower: Follower::new(FLOW_WIDTH, true),
            last_flow: LastFlow::default(),
            spare: Flow::filled(0, 0, [0.0; 2]),
            inverse_depth: None,
            next_parallax: (0, true),
            swings: Swings::default(),
            noise: NoiseFollower::new(space.transfer),
            scattering: None,
            exposure: ExposureMemory::default(),
            streaks: StreaksMemory::default(),
            lens: LensMemory::default(),
            depth_kind: None,
            cut_ahead: false,
            why_no_lens: Unknown::new(Reason::NoDepth, "no depth was given, and nothing has moved yet"),
            model: None,
            changes: Changes::default(),
        }
    }

    /// Looks at a frame, and gives the model that holds for this frame. A live camera's frame is pushed when the next frame has
    /// arrived; [`FrameObservation::previous`] is used if there is no next frame, if it was not the last one that was pushed, as on a machine that
    /// leaves frames out, and where motion begins to be uneven, as under a shaking hand. A frame that the next one repeats gets the last model,
    /// and its copy is looked at in its place.
    ///
    /// # Errors
    /// If a size differs from the first frame's, the frame is not finite, or depth is in another unit than before.
    pub fn push(&mut self, observation: &FrameObservation) -> Result<&CameraModel> {
        par::within(|| self.look_at(observation, None))
    }

    /// [`Tracker::push`], but a frame's tiles are looked at by `observer`, for example on a graphics device: motion, depth, noise and the shape
    /// of out-of-focus points are still found here.
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
        let mut observation = *observation;
        let given = observation.evidence.flow;
        let within_bars = ActiveArea::of(observation.frame).flow_within(given);
        observation.evidence.flow = within_bars.as_ref().or(given);
        let FrameObservation { frame, next, previous, .. } = observation;
        let (width, height) = frame.0.size();
        self.changes = Changes::default();
        self.begin_shot();
        let last_frame = self.last_frame.replace(fingerprint(frame));
        let previous = match previous {
            Some(left_out) if last_frame != Some(fingerprint(left_out)) => {
                self.begin_after_left_out(left_out, &observation)?
            }
            _ => previous,
        };
        let look = self.copies.look(frame, next, previous);
        if matches!(look, Look::Pass)
            && let Some(model) = self.model.take()
        {
            self.flow_to_next = Some(Flow::filled(width, height, [0.0; 2]));
            return Ok(self.model.insert(model));
        }
        self.flow_to_next = None;
        let (repeated, picture_before) = match look {
            Look::At { repeated, before, .. } => (repeated, before),
            Look::Pass => (0, None),
        };
        // What a frame repeats is no neighbour.
        let previous = if repeated > 0 { picture_before.as_ref() } else { previous };
        observation.previous = previous;
        let fps = self.copies.pictures_per_second(self.fps);
        let capture = Capture { width, height, fps, frames_used: self.frames + 1, pixel_aspect: 1.0 };
        let mut geometry = self.geometry(&observation)?;
        if let (Some(_), Some(_), Some(to_next)) = (previous, next, &geometry.flow)
            && let Some(before) = self.last_flow.flow.as_ref().filter(|_| self.last_flow.to_next)
            && let Some(ratio) = uneven::speed_ratio(to_next, before)
            && self.copies.gap_beside(repeated, ratio, self.swings.is_even())
        {
            self.flow_to_next = geometry.flow.map(Cow::into_owned);
            (observation.next, observation.evidence.flow) = (None, None);
            geometry = Geometry { flow: self.geometry(&observation)?.flow, ..geometry };
        }
        let next = observation.next;
        let neighbour = if observation.evidence.flow.is_some() { next } else { next.or(previous) };
        let mut model = CameraModel::unknown(capture, "");
        (model.blur_space, model.transfer) = (self.space.blur, self.space.transfer);
        let neighbour = neighbour.zip(geometry.flow.as_deref());
        (model.noise, self.changes) =
            self.noise.follow((self.frames, frame, repeated), neighbour, &mut self.follower)?;
        self.scattering = Some(model.noise.clone());
        if let Estimate::Known(noise) = &mut model.noise {
            noise.allow_for(self.noise.shared_spread);
        }
        if self.changes.of(Distortion::Noise) {
            // The recent evidence of blur was found with the wrong noise.
            self.exposure.forget_recent();
            self.lens.forget_recent();
        }
        let to_next = next.is_some() || observation.evidence.flow.is_some();
        let flow = geometry.flow.as_deref();
        // The shutter is open around the frame's own time, not on the way to the next frame.
        let last = self.last_flow.flow.as_ref().filter(|_| to_next && self.last_flow.to_next);
        model.sharpening = self.noise.sharpening.clone().unwrap_or_else(|| {
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
        let correction = match (mean_of, self.noise.luma, observation.evidence.flow) {
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
        // The link to the frame before was made with that frame, if its motion was uneven already.
        let links = match (next, flow, mean_of) {
            (Some(next), Some(flow), Some(mean)) if correction.error > 0.0 => {
                let before = observation.previous.zip(last).filter(|_| correction.begins);
                let before = before.and_then(|(other, last)| {
                    Link::new([other, frame], last, [&|x, y| last.at(x, y), mean], self.space)
                });
                let after = Link::new([frame, next], flow, [mean, &|x, y| flow.at(x, y)], self.space);
                // A link from the frame before without one to the next frame would leave a hole in the run.
                after.map_or(vec![], |after| before.into_iter().chain([after]).collect())
            }
            _ => vec![],
        };
        let of = mean_of.map(|of| move |x: usize, y: usize| correction.of(of(x, y)));
        let motion = of.as_ref().map(|of| of as &tiles::MotionOf);
        match (observer, self.noise.luma) {
            // What noise cannot be told from tells nothing of blur.
            (_, None) => {
                model.motion_blur = self.follow_exposure(&[], vec![]);
                model.defocus = self.follow_lens(&OfLens::default())?;
            }
            (Some(observer), Some(noise)) => {
                let moved = motion.zip(flow).map(|(of, flow)| Flow::from_fn(flow.width(), flow.height(), of));
                // Streaks of unknown length look like a lens's blur.
                let is_moving = |x: usize, y: usize| {
                    let [u, v] = moved.as_ref().map_or([0.0; 2], |m| m.at(x, y));
                    u.portable_hypot(v) >= spectral::STILL
                };
                let still = depth.filter(|_| self.exposure.known.is_none()).map(|d| {
                    let known = |x, y| if is_moving(x, y) { f32::NAN } else { d.at(x, y) };
                    Plane::from_fn(d.width(), d.height(), known)
                });
                let mut found = observer.observe(&TileLook {
                    frame,
                    motion: moved.as_ref(),
                    inverse_depth: still.as_ref().or(depth),
                    noise: &noise,
                    exposure: self.exposure(),
                    sharpening,
                })?;
                found.check()?;
                found.exposure.iter_mut().for_each(|w| w.speed_error = correction.error);
                let points = self.tiles_of_points(frame, motion, depth);
                model.motion_blur = self.follow_exposure(&found.exposure, links);
                let of_points = self.of_points(points, &noise, sharpening);
                model.defocus = self.follow_lens(&OfLens { as_disks: found.lens, ..of_points })?;
            }
            (None, Some(noise)) => {
                let corners = self.corners(frame, mean_of, depth);
                let mut tiles = tiles::tiles_at(frame, &corners, 1, motion, depth, self.space);
                tiles.iter_mut().for_each(|t| t.speed_error = correction.error);
                let found = spectral::exposure_observations(&[&tiles], &noise);
                let points = self.tiles_of_points(frame, motion, depth);
                model.motion_blur = self.follow_exposure(&found, links);
                self.leave_streaks_out(&mut tiles);
                let exposure = self.exposure();
                let as_disks =
                    spectral::lens_observations(&[&tiles], &noise, exposure, sharpening, spectral::lens_gain);
                let of_points = self.of_points(points, &noise, sharpening);
                model.defocus = self.follow_lens(&OfLens { as_disks, ..of_points })?;
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
        model.warnings = self.warnings();
        model.validate()?;
        Ok(self.model.insert(model))
    }

    /// What makes the last frame's model less sure.
    fn warnings(&self) -> Vec<String> {
        let coding = coding_warning(self.noise.luma.as_ref(), self.noise.coding_spread, self.frames);
        few_frames(self.frames).into_iter().chain(coding).collect()
    }

    /// Finds the motion from the frame before, which was not looked at, since that of the last frame that was is another time's. Gives the frame
    /// before, unless it shows the same picture.
    fn begin_after_left_out<'a>(
        &mut self,
        previous: &'a Encoded,
        observation: &FrameObservation,
    ) -> Result<Option<&'a Encoded>> {
        if let Some(noise) = &self.noise.luma {
            self.streaks.follow(vec![], self.frames, noise);
        }
        self.swings.forget();
        self.last_flow = LastFlow::default();
        if self.copies.are_one_picture(previous, observation.frame) {
            return Ok(None);
        }
        if observation.evidence.flow.is_none() {
            let spare = std::mem::replace(&mut self.spare, Flow::filled(0, 0, [0.0; 2]));
            let flow = self.follower.follow(previous, observation.frame, None, spare)?.flow;
            if let Some(flow) = &flow {
                self.swings.next(Some(flow), &|x, y| flow.at(x, y));
            }
            self.last_flow = LastFlow { flow, found: true, to_next: true };
        }
        Ok(Some(previous))
    }

    /// Forgets all evidence if the last frame was the last of its shot, since another shot may be another camera's.
    fn begin_shot(&mut self) {
        if std::mem::take(&mut self.cut_ahead) {
            self.copies.begin_shot();
            (self.exposure, self.lens) = (ExposureMemory::default(), LensMemory::default());
            self.noise.forget();
            self.last_flow.flow = None;
            self.swings.forget();
            self.streaks.forget();
            self.next_parallax = (0, true);
        }
    }

    /// Takes the observations of a frame's exposure and lens that were found elsewhere, for example on a graphics device, and the unit of
    /// their inverse depth, instead of the frame itself. The observations must have been found with [`Tracker::luma_noise`] and the last
    /// model's exposure and sharpening. The noise and the shape of out-of-focus points stay as they are until a frame is pushed again.
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
        self.swings.forget();
        self.changes = Changes::default();
        self.begin_shot();
        model.motion_blur = self.follow_exposure(exposure, vec![]);
        model.defocus = self.follow_lens(&OfLens { as_disks: lens.to_vec(), ..OfLens::default() })?;
        self.frames += 1;
        model.capture.frames_used = self.frames;
        model.warnings = self.warnings();
        model.validate()?;
        Ok(self.model.insert(model))
    }

    /// The noise of luma, if it is known so far.
    pub fn luma_noise(&self) -> Option<&LumaNoise> {
        self.noise.luma.as_ref()
    }

    /// The last known exposure; 0 if none is known, since nothing then shows that anything moves.
    fn exposure(&self) -> ExposureFraction {
        self.exposure.known.map_or(ExposureFraction(0.0), |m| m.exposure)
    }

    fn measure_depth_in(&mut self, kind: DepthKind) -> Result<()> {
        if self.depth_kind.is_some_and(|k| k != kind) {
            return Err(Error::new("depth in one unit cannot follow depth in another: give all in one"));
        }
        self.depth_kind = Some(kind);
        self.why_no_lens = if self.exposure.known.is_some() {
            Unknown::new(Reason::Flat, "too few textured places whose depth is known")
        } else {
            let why = "the exposure is unknown, and its streaks may be taken for the lens's blur";
            Unknown::new(Reason::Uncertain, why)
        };
        Ok(())
    }

    /// Whether the noise rests on so few frames of this shot, or since it changed, that those to come will correct it: a video coder leaves more
    /// noise in the first frames than in those that follow.
    pub fn noise_settles(&self) -> bool {
        self.noise.settles()
    }

    /// The noise of the last frame as in [`Tracker::model`], with an interval that does not hold the error that all frames share, and that error:
    /// the std of the logarithm of the factor by which the std is off, a
    /// [`shared_spread`](crate::fit::noise::NoiseFit::shared_spread). `None` before the first frame.
    pub fn noise_of_frames(&self) -> Option<(&Estimate<NoiseModel>, f32)> {
        self.scattering.as_ref().map(|noise| (noise, self.noise.shared_spread))
    }

    /// The number of frames before the last one that already have the new noise, if a change of the noise was noticed in the last frame; else 0.
    pub fn noise_changed_before(&self) -> usize {
        if self.changes.of(Distortion::Noise) { self.noise.reach().saturating_sub(1) } else { 0 }
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
        self.flow_to_next.as_ref().or(self.last_flow.flow.as_ref()).filter(|_| self.last_flow.found)
    }

    /// A sentence for the user about the frames that repeat the one before; `None` if there are none so far.
    pub fn copies_in_words(&self) -> Option<String> {
        self.copies.words(self.fps)
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
                if self.depth_kind == Some(DepthKind::Relative) && evidence.inverse_depth.is_none() {
                    // Relative depth is in another unit from here on.
                    self.lens.forget();
                    self.why_no_lens = Unknown::new(
                        Reason::NoDepth,
                        "the depth of the last frames lost its scale, and is found anew",
                    );
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
                self.why_no_lens = no_parallax(&why);
            }
            None => {}
        }
        Ok(geometry)
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
        let tried = tiles::corners_in_turn(frame.0.size(), self.frames, 2 * TILES);
        tiles::of_most_contrast(frame, tried, 1, motion, depth, TILES)
    }

    /// The exposure with the observations of another frame, and its links if its motion is uneven.
    fn follow_exposure(
        &mut self,
        found: &[ExposureObservation],
        links: Vec<Link>,
    ) -> Estimate<MotionBlurModel> {
        let by_streaks = match &self.noise.luma {
            Some(noise) => self.streaks.follow(links, self.frames, noise),
            None => {
                self.streaks.forget();
                None
            }
        };
        let coding_error = self.noise.luma.map_or(0.0, |n| n.coding_error);
        let Followed { exposure, changed, streaks_outdated } =
            self.exposure.follow(found, by_streaks, self.frames, coding_error);
        if streaks_outdated {
            self.streaks.forget();
        }
        if changed {
            self.changes.set(Distortion::MotionBlur, true);
            // The recent evidence of the lens was found with the wrong exposure.
            self.lens.forget_recent();
        }
        exposure
    }

    /// Leaves out the tiles that move if the exposure is unknown: streaks of unknown length look like a lens's blur.
    fn leave_streaks_out(&self, tiles: &mut Vec<Tile>) {
        if self.exposure.known.is_none() {
            tiles.retain(|t| t.speed * t.scale < spectral::STILL);
        }
    }

    /// The last known lens, and tiles that it blurs differently, if this frame is to be looked at for the shape of out-of-focus points.
    fn tiles_of_points(
        &self,
        frame: &Encoded,
        motion: Option<&tiles::MotionOf>,
        depth: Option<&Plane>,
    ) -> Option<(Lens, Vec<Tile>)> {
        let (lens, look) = self.lens.wants_shape()?;
        Some((lens, shape::tiles_of(frame, look, motion, depth?, lens, self.space)))
    }

    /// What such tiles tell of the shape of out-of-focus points, and of the lens if points are Gaussians.
    fn of_points(
        &self,
        points: Option<(Lens, Vec<Tile>)>,
        noise: &LumaNoise,
        sharpening: Option<&SharpeningModel>,
    ) -> OfLens {
        let Some((lens, mut tiles)) = points else { return OfLens::default() };
        self.leave_streaks_out(&mut tiles);
        let exposure = self.exposure();
        let shape = Some(bokeh::observations(&[&tiles], noise, exposure, sharpening, lens));
        let as_gaussians =
            spectral::lens_observations(&[&tiles], noise, exposure, sharpening, likelihood::gaussian_gain);
        OfLens { shape, as_gaussians, ..OfLens::default() }
    }

    /// The lens with what another frame tells.
    fn follow_lens(&mut self, found: &OfLens) -> Result<Estimate<DefocusModel>> {
        let (lens, changed) = self.lens.follow(found, self.depth_kind, self.why_no_lens.clone())?;
        if changed {
            self.changes.set(Distortion::Defocus, true);
        }
        Ok(lens)
    }
}

/// A number by which a frame is known again: a hash (FNV-1a) of some of its values.
fn fingerprint(Encoded(frame): &Encoded) -> u64 {
    const SAMPLES: usize = 1000;
    let step = (frame.data().len() / SAMPLES).max(1);
    let values = frame.data().iter().step_by(step).flatten();
    values.fold(0xcbf2_9ce4_8422_2325, |hash, value| {
        (hash ^ u64::from(value.to_bits())).wrapping_mul(0x100_0000_01b3)
    })
}
