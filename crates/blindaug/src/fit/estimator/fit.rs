//! The model that the evidence of all frames gives.

use super::{Estimator, FrameEvidence};
use crate::fit::noise::{LumaNoise, NoiseEvidence, NoiseFit};
use crate::fit::observation::{Curve, Diagnostics, Estimation, Family, Shot};
use crate::fit::robust::median;
use crate::fit::warnings::{coding_warning, few_frames};
use crate::fit::{agreement, bokeh, defocus, removal, sharpening, spectral, streaks, tiles};
use crate::model::{
    CameraModel, Capture, DefocusCurve, DepthKind, Estimate, ExposureFraction, Method, MotionBlurModel,
    Reason, SharpeningModel, Unknown,
};
use crate::synth::defocus::Bokeh;
use crate::{Error, Result};
use std::ops::Range;

/// The exposure fraction that each frame alone gives, with the frame's index among the added frames.
type ExposurePerFrame = Vec<(usize, f32)>;

/// The least correlation of noise between successive frames of which the user is told.
const NOTABLE_CORRELATION: f32 = 0.1;

impl Estimator {
    /// The model that the frames so far give.
    ///
    /// # Errors
    /// If there was no frame.
    pub fn estimate(&self) -> Result<Estimation> {
        let Some((width, height)) = self.size else { return Err(Error::new("no frame was given")) };
        let capture = Capture {
            width,
            height,
            fps: self.copies.pictures_per_second(self.options.fps),
            frames_used: self.frames.len(),
            pixel_aspect: 1.0,
        };
        let mut model = CameraModel::unknown(capture, "not looked at");
        (model.blur_space, model.transfer) = (self.options.space.blur, self.options.space.transfer);
        let mut diagnostics = Diagnostics { inverse_depth: self.last_depth.clone(), ..Default::default() };
        diagnostics.notes.extend(self.copies.words(self.options.fps));
        model.warnings.extend(few_frames(self.frames.len()));
        if self.unfollowed > 0 {
            model.warnings.push(format!(
                "{} could not be followed to {} (too much changed)",
                if self.unfollowed == 1 { "one frame".into() } else { format!("{} frames", self.unfollowed) },
                if self.unfollowed == 1 { "its neighbour" } else { "their neighbours" }
            ));
        }
        let luma_noise = self.fit_noise(&mut model, &mut diagnostics);
        self.fit_exposure(&mut model, &mut diagnostics, luma_noise.as_ref())?;
        self.fit_defocus(&mut model, &mut diagnostics, luma_noise.as_ref())?;
        model.validate()?;
        Ok(Estimation { model, diagnostics })
    }

    fn fit_noise(&self, model: &mut CameraModel, diagnostics: &mut Diagnostics) -> Option<LumaNoise> {
        let merged = |method: Method, of: &dyn Fn(&FrameEvidence) -> &NoiseEvidence| {
            let mut all = NoiseEvidence::new(method);
            self.frames.iter().for_each(|f| all.merge(of(f)));
            let fit = all.fit();
            if method == Method::Temporal { self.distant.complete(&all, fit) } else { fit }
        };
        // The difference between frames holds nothing of the image's structure, so temporal noise comes first; clean frames come next.
        let temporal = || merged(Method::Temporal, &|f| &f.temporal);
        let denoised = || merged(Method::Removal, &|f| &f.denoised);
        let spatial = || merged(Method::Spatial, &|f| &f.spatial);
        let order: [&dyn Fn() -> NoiseFit; 3] = match self.options.family {
            // A network's residual holds more of the image than the flattest parts of a frame do.
            _ if self.by_network => [&temporal, &spatial, &denoised],
            Family::Removal => [&denoised, &temporal, &spatial],
            Family::Auto | Family::Spectral => [&temporal, &denoised, &spatial],
        };
        // That a coder was at work is known even where the comparison that shows it tells no noise, since all was copied.
        let mut coding_spread = 0.0;
        let with_spread = |f: &&dyn Fn() -> NoiseFit| {
            let fit = f().with_coding_spread(coding_spread);
            coding_spread = fit.coding_spread;
            fit
        };
        let mut fit = order.iter().map(with_spread).find(|f| f.luma.is_some()).unwrap_or_else(spatial);
        let spread = fit.shared_spread();
        if let Estimate::Known(model) = &mut fit.model {
            model.allow_for(spread);
        }
        if fit.model.known().is_some_and(|m| m.method() == Method::Spatial) {
            diagnostics.notes.push(
                "noise was measured in single frames: coarse noise cannot be told from structure there; how it goes with fine noise is taken from cameras, or from white noise where neighbouring pixels are independent"
                    .into(),
            );
        }
        model.warnings.extend(coding_warning(fit.luma.as_ref(), coding_spread, self.frames.len()));
        model.sharpening = sharpening::of_noise(&fit);
        if let Estimate::Known(SharpeningModel { amount, interval: [low, high], .. }) = model.sharpening {
            diagnostics.notes.push(format!(
                "the camera sharpens: fine noise is stronger than white noise, as after an unsharp mask of {amount:.1} ({low:.1} to {high:.1})"
            ));
        }
        if let Estimate::Known(noise) = &fit.model
            && noise.temporal_correlation() >= NOTABLE_CORRELATION
        {
            diagnostics.notes.push(format!(
                "noise stays from frame to frame: its correlation between successive frames is {:.2}, as a coder's copying or a denoiser over time leaves it",
                noise.temporal_correlation()
            ));
        }
        diagnostics.noise_points = fit.points;
        model.noise = fit.model;
        self.options.noise_kind.reduce(&mut model.noise);
        fit.luma
    }

    fn fit_exposure(
        &self,
        model: &mut CameraModel,
        diagnostics: &mut Diagnostics,
        noise: Option<&LumaNoise>,
    ) -> Result<()> {
        let moving: Vec<&FrameEvidence> = self.frames.iter().filter(|f| f.has_motion).collect();
        let why = if self.given < 2 {
            Unknown::new(Reason::TooShort, "a single image says nothing about the exposure")
        } else {
            Unknown::new(Reason::NotFollowed, "no frame could be followed to the next")
        };
        let method = self.blind_method();
        (diagnostics.shots, diagnostics.exposure_per_frame) = self.exposure_of_shots(&moving, noise)?;
        if let Some(why) = contradiction(&diagnostics.shots) {
            model.motion_blur = Estimate::Unknown(why);
            return Ok(());
        }
        let blind =
            if moving.is_empty() { Estimate::Unknown(why) } else { self.blind_exposure(&moving, noise)? };
        let compared = self.aggregate_exposure();
        let width = |i: [f32; 2]| i[1] - i[0];
        let (known, curve, per_frame, by_tiles) = match (blind, compared) {
            (Estimate::Known(b), Some(c))
                if method != Method::Removal && width(b.interval) <= width(c.0.interval) =>
            {
                (blind_model(method, &b), b.curve, b.per_frame, true)
            }
            (_, Some((m, curve, per_frame))) => (m, curve, per_frame, false),
            (Estimate::Known(b), None) => (blind_model(method, &b), b.curve, b.per_frame, true),
            (Estimate::Unknown(why), None) => {
                model.motion_blur = Estimate::Unknown(why);
                return Ok(());
            }
        };
        model.motion_blur = Estimate::Known(known);
        diagnostics.exposure_curve = curve;
        // The tiles' frames are numbered among the moving frames, and get their index among the given frames here.
        diagnostics.exposure_per_frame =
            per_frame.into_iter().map(|(i, v)| (if by_tiles { moving[i].index } else { i }, v)).collect();
        Ok(())
    }

    /// The exposure that each shot alone gives without clean frames, and that of each frame; both lists are empty if there is no cut.
    fn exposure_of_shots(
        &self,
        moving: &[&FrameEvidence],
        noise: Option<&LumaNoise>,
    ) -> Result<(Vec<Shot>, ExposurePerFrame)> {
        let mut per_frame = vec![];
        if self.shots.len() < 2 {
            return Ok((vec![], per_frame));
        }
        let ends = self.shots[1..].iter().copied().chain([self.given]);
        let shot = |(number, frames): (usize, Range<usize>)| {
            let own: Vec<&FrameEvidence> = moving.iter().filter(|f| f.shot == number).copied().collect();
            let motion_blur = match self.blind_exposure(&own, noise)? {
                // The error of one frame may be larger than its interval.
                Estimate::Known(_) if own.len() < 2 => {
                    Estimate::unknown(Reason::TooShort, "only one of its frames was looked at")
                }
                Estimate::Known(fit) => {
                    per_frame.extend(fit.per_frame.iter().map(|&(i, v)| (own[i].index, v)));
                    Estimate::Known(blind_model(self.blind_method(), &fit))
                }
                Estimate::Unknown(why) => Estimate::Unknown(why),
            };
            Ok(Shot { frames, motion_blur })
        };
        let frames = self.shots.iter().zip(ends).map(|(&first, end)| first..end);
        let shots = frames.enumerate().map(shot).collect::<Result<Vec<Shot>>>()?;
        Ok((shots, per_frame))
    }

    /// The exposure that frames agree on, without clean frames.
    fn blind_exposure(
        &self,
        frames: &[&FrameEvidence],
        noise: Option<&LumaNoise>,
    ) -> Result<Estimate<agreement::ExposureFit>> {
        if self.blind_method() == Method::Removal {
            return Ok(removal::fit_exposure(&removal_tiles(frames)));
        }
        let Some(noise) = noise else { return Ok(Estimate::Unknown(noise_unknown())) };
        let by_tiles_of = |counts: &dyn Fn(&FrameEvidence) -> bool| {
            let own = |f: &&&FrameEvidence| counts(f);
            let tiles: Vec<&[tiles::Tile]> =
                frames.iter().map(|f| Some(f).filter(own).map_or(&[][..], |f| &f.tiles)).collect();
            let pairs: Vec<&[spectral::Pair]> =
                frames.iter().map(|f| Some(f).filter(own).map_or(&[][..], |f| &f.pairs)).collect();
            spectral::fit_exposure(&tiles, &pairs, noise)
        };
        // A few uneven frames may be those around missing ones, whose streaks contradict the motion.
        if 2 * frames.iter().filter(|f| f.is_even()).count() >= frames.len()
            && let known @ Estimate::Known(_) = by_tiles_of(&FrameEvidence::is_even)?
        {
            return Ok(known);
        }
        let by_tiles = by_tiles_of(&|_| true)?;
        let width = |fit: &agreement::ExposureFit| fit.interval[1] - fit.interval[0];
        let widest = streaks::widest(by_tiles.known().map(width));
        let by_streaks = streaks::fit_exposure(&runs(frames), noise).filter(|fit| width(fit) <= widest);
        Ok(match (by_streaks, by_tiles) {
            // What each frame tells by itself is shown beside what all of them tell together.
            (Some(fit), Estimate::Known(tiles)) => {
                Estimate::Known(agreement::ExposureFit { per_frame: tiles.per_frame, ..fit })
            }
            (Some(fit), Estimate::Unknown(_)) => Estimate::Known(fit),
            (None, by_tiles) => by_tiles,
        })
    }

    /// The method that measures blur if no clean frames are given. It is not the one with the tighter interval, since the intervals of
    /// [`removal`] are too narrow (docs/lab-log.md), and [`removal`] is slower.
    fn blind_method(&self) -> Method {
        if self.options.family == Family::Removal { Method::Removal } else { Method::Spectral }
    }

    fn fit_defocus(
        &self,
        model: &mut CameraModel,
        diagnostics: &mut Diagnostics,
        noise: Option<&LumaNoise>,
    ) -> Result<()> {
        let Some(depth_kind) = self.depth_kind else {
            model.defocus = Estimate::Unknown(self.why_no_depth.clone());
            return Ok(());
        };
        let mut deep: Vec<&FrameEvidence> = self.frames.iter().filter(|f| f.has_depth).collect();
        // Relative depth has a unit of its own in each shot, and shots with different shutters may be from different cameras.
        let apart = depth_kind == DepthKind::Relative || contradiction(&diagnostics.shots).is_some();
        let shot = (apart && self.shots.len() > 1).then(|| {
            let frames = |shot: usize| deep.iter().filter(|f| f.shot == shot).count();
            (0..self.shots.len()).rev().max_by_key(|&shot| frames(shot)).unwrap_or(0)
        });
        let mut motion_blur = model.motion_blur.known();
        if let Some(shot) = shot {
            deep.retain(|f| f.shot == shot);
            motion_blur = motion_blur.or_else(|| diagnostics.shots.get(shot)?.motion_blur.known());
        }
        let blind_method = self.blind_method();
        let blind = match blind_method {
            Method::Removal => {
                let exposure = motion_blur.map_or(ExposureFraction(0.0), |m| m.exposure);
                removal::fit_lens(&removal_tiles(&deep), exposure)?
            }
            _ => self.blind_lens(&spectral_tiles(&deep), noise, motion_blur, model.sharpening.known())?,
        };
        let compared = Self::aggregate_lens(&deep, self.by_network);
        let width = |i: [f32; 2]| i[1] - i[0];
        let (fit, method) = match (blind, compared) {
            (Estimate::Known(b), Some(c))
                if blind_method != Method::Removal && width(b.sigma_px_at_infinity) <= width(c.1) =>
            {
                (b, blind_method)
            }
            (blind, Some((lens, sigma_px_at_infinity, focus_inverse_depth, samples))) => {
                let ranges = deep.iter().filter_map(|f| f.lens.as_ref()).map(|l| l.range);
                let compared = agreement::LensFit {
                    lens,
                    sigma_px_at_infinity,
                    focus_inverse_depth,
                    samples,
                    points: deep.iter().flat_map(|f| f.search.iter().copied()).collect(),
                    inverse_depth_seen: agreement::seen(ranges.flat_map(|(far, near)| [far, near])),
                    // What looks like Gaussians is only said of the lens whose interval takes that in.
                    bokeh: blind.known().and_then(|b| b.bokeh).filter(|&b| b == Bokeh::Disk),
                };
                (compared, Method::Removal)
            }
            (Estimate::Known(b), None) => (b, blind_method),
            (Estimate::Unknown(why), None) => {
                model.defocus = Estimate::Unknown(why);
                return Ok(());
            }
        };
        let thin = fit.thin_lens();
        let curve = match (self.options.curve, defocus::quadratic(&fit.points)) {
            (Curve::ThinLens, _) => thin,
            (Curve::Quadratic, Some(([a, b, c], (lo, hi)))) => {
                DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [lo, hi] }
            }
            (Curve::Quadratic, None) => {
                diagnostics
                    .notes
                    .push("too few points for a quadratic: the thin lens is given instead".into());
                thin
            }
        };
        if let Some(shot) = shot {
            diagnostics.notes.push(format!(
                "the lens is that of shot {} alone, which shows most depth: the others may have another, or depth in another unit",
                shot + 1
            ));
        }
        if fit.bokeh == Some(Bokeh::Gaussian) {
            diagnostics.notes.push(
                "out-of-focus points look like Gaussians, or the textures are soft: the lens's interval holds what both would make of it"
                    .into(),
            );
        }
        model.defocus = Estimate::Known(fit.model(curve, method, depth_kind));
        diagnostics.blur_points = fit.points;
        Ok(())
    }

    /// The lens that the spectra agree on, for all exposures that may be. Where nothing is known of the exposure, only what hardly moves
    /// tells the lens: a streak of unknown length looks like a lens's blur.
    fn blind_lens(
        &self,
        frames: &[&[tiles::Tile]],
        noise: Option<&LumaNoise>,
        motion_blur: Option<&MotionBlurModel>,
        sharpening: Option<&SharpeningModel>,
    ) -> Result<Estimate<agreement::LensFit>> {
        let Some(noise) = noise else { return Ok(Estimate::Unknown(noise_unknown())) };
        let Some(motion_blur) = motion_blur else {
            let slow: Vec<Vec<tiles::Tile>> = frames
                .iter()
                .map(|tiles| tiles.iter().filter(|t| t.speed * t.scale < spectral::STILL).cloned().collect())
                .collect();
            let slow: Vec<&[tiles::Tile]> = slow.iter().map(Vec::as_slice).collect();
            let fit = spectral::fit_lens(&slow, noise, ExposureFraction(0.0), sharpening)?;
            let moving =
                frames.iter().any(|tiles| tiles.iter().any(|t| t.speed * t.scale >= spectral::STILL));
            return Ok(match fit {
                Estimate::Known(mut known) => {
                    bokeh::see(&mut known, &slow, noise, ExposureFraction(0.0), sharpening)?;
                    Estimate::Known(known)
                }
                Estimate::Unknown(why) if moving => Estimate::unknown(
                    Reason::Uncertain,
                    format!(
                        "the exposure is unknown, and its streaks may be taken for the lens's blur; of what does not move: {why}"
                    ),
                ),
                fit => fit,
            });
        };
        let fit = spectral::fit_lens(frames, noise, motion_blur.exposure, sharpening)?;
        let Estimate::Known(mut known) = fit else { return Ok(fit) };
        let speeds: Vec<f32> = frames.iter().copied().flatten().map(|t| t.speed * t.scale).collect();
        let typical = median(speeds).unwrap_or(0.0);
        for end in motion_blur.interval {
            if (end - motion_blur.exposure.0).abs() * typical < spectral::SURE_STREAK {
                continue;
            }
            match spectral::fit_lens(frames, noise, ExposureFraction(end), sharpening)? {
                Estimate::Known(other) => known.widen(&other),
                unknown => return Ok(unknown),
            }
        }
        let [low, high] = known.sigma_px_at_infinity;
        if high - low > 2.0 * known.lens.sigma_px_at_infinity().max(0.5) {
            let why = format!(
                "the exposure is known too badly to tell its streaks from the lens's blur: {low:.1} to {high:.1} px all fit"
            );
            return Ok(Estimate::unknown(Reason::Uncertain, why));
        }
        bokeh::see(&mut known, frames, noise, motion_blur.exposure, sharpening)?;
        Ok(Estimate::Known(known))
    }
}

/// Why blur is unknown where noise is: to take noise for detail of the scene would make all blur too small.
fn noise_unknown() -> Unknown {
    Unknown::new(Reason::Flat, "the noise is unknown, and what is sharp could be either noise or detail")
}

fn blind_model(method: Method, fit: &agreement::ExposureFit) -> MotionBlurModel {
    let (interval, samples) = (fit.interval, fit.samples as u64);
    MotionBlurModel { interval, method, samples, ..MotionBlurModel::given(fit.exposure) }
}

/// The reason why no single exposure fits all shots, if two shots are sure that their exposures differ.
fn contradiction(shots: &[Shot]) -> Option<Unknown> {
    let known = || (1..).zip(shots).filter_map(|(n, s)| Some((n, s.motion_blur.known()?)));
    // The largest of n deviations grows as sqrt(2 ln n), so intervals are widened in proportion for more than two shots.
    let spread = |n: usize| 1.0 + (2.0 * (n as f32).ln()).sqrt();
    let wider = (spread(known().count().max(2)) / spread(2)).max(1.0);
    let end = |m: &MotionBlurModel, i: usize| m.exposure.0 + wider * (m.interval[i] - m.exposure.0);
    let (n, longest) = known().max_by(|a, b| end(a.1, 0).total_cmp(&end(b.1, 0)))?;
    let (m, shortest) = known().min_by(|a, b| end(a.1, 1).total_cmp(&end(b.1, 1)))?;
    let told = |n: usize, m: &MotionBlurModel| {
        format!("{:.2} ({:.2} to {:.2}) in shot {n}", m.exposure.0, m.interval[0], m.interval[1])
    };
    (end(shortest, 1) < end(longest, 0)).then(|| {
        let why = format!(
            "the shots were filmed with different shutters, exposures of {} and {}: estimate each alone, or a model for each frame",
            told(m, shortest),
            told(n, longest)
        );
        Unknown::new(Reason::Contradicting, why)
    })
}

/// The runs of successive frames of uneven motion.
fn runs<'a>(frames: &[&'a FrameEvidence]) -> Vec<streaks::Run<'a>> {
    let mut runs: Vec<streaks::Run> = vec![];
    for (i, frame) in frames.iter().enumerate() {
        let before = i.checked_sub(1).filter(|&b| frames[b].order + 1 == frame.order);
        if let Some(link) = &frame.from_before {
            match runs.last_mut() {
                Some(run)
                    if before.is_some()
                        && run.frames.last() == Some(&before)
                        && run.links.len() < streaks::LONGEST_RUN =>
                {
                    run.links.push(link);
                    run.frames.push(Some(i));
                }
                _ => runs.push(streaks::Run { links: vec![link], frames: vec![before, Some(i)] }),
            }
        }
        if let Some(link) = &frame.to_next_frame {
            match runs.last_mut() {
                Some(run) if run.frames.last() == Some(&Some(i)) => {
                    run.links.push(link);
                    run.frames.push(None);
                }
                _ => runs.push(streaks::Run { links: vec![link], frames: vec![Some(i), None] }),
            }
        }
    }
    runs
}

fn spectral_tiles<'a>(frames: &[&'a FrameEvidence]) -> Vec<&'a [tiles::Tile]> {
    frames.iter().map(|f| f.tiles.as_slice()).collect()
}

fn removal_tiles<'a>(frames: &[&'a FrameEvidence]) -> Vec<&'a [removal::Tile]> {
    frames.iter().map(|f| f.removal.as_slice()).collect()
}
