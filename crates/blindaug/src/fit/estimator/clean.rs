//! The comparison of frames with clean frames, by the paper's fits, and what frames compared so agree on.

use super::{Estimator, FrameEvidence};
use crate::fit::observation::{Curve, Evidence};
use crate::fit::robust::{aggregate, median};
use crate::fit::{agreement, defocus, motion_blur, tiles};
use crate::model::{ExposureFraction, Method, MotionBlurModel};
use crate::synth::{self, defocus::Bokeh};
use crate::{Encoded, Flow, Plane, Result, filter};

/// An exposure, its curve, and the exposure fraction of each frame with the frame's index.
type ExposureEvidence = (MotionBlurModel, Vec<[f32; 2]>, Vec<(usize, f32)>);

/// The shape of a real lens's blur. A Gaussian would fit a disk only with a std that is a fifth too large.
const BOKEH: Bokeh = Bokeh::Disk;
/// The largest change at which the alternating fits of exposure and lens to clean frames stop: of the exposure fraction, of the blur at
/// infinity in px, and of the inverse depth in focus.
const SETTLED: f32 = 1e-3;
/// The std of the exposure fraction that stands for errors of the comparison with clean frames: of the flow, and of what interpolation
/// along the path adds and leaves out (docs/lab-log.md).
const REMOVAL_EXPOSURE_FLOOR: f32 = 0.02;
/// The relative std of the lens's numbers that stands for errors of the comparison with clean frames.
const REMOVAL_LENS_FLOOR: f32 = 0.04;
/// The std of the blur, px, that comparison with clean frames does not tell from none.
const REMOVAL_UNTOLD_PX: f32 = 0.1;
/// The std of the exposure fraction if a network made the clean frames: its errors on other scenes (docs/lab-log.md).
const NETWORK_EXPOSURE_FLOOR: f32 = 0.1;
/// The relative std of the lens's numbers if a network made the clean frames: its errors on other scenes (docs/lab-log.md).
const NETWORK_LENS_FLOOR: f32 = 0.3;

impl Estimator {
    /// The paper's fits, to all clean images that are given.
    pub(super) fn compare_with_clean(
        &self,
        kept: &mut FrameEvidence,
        frame: &Encoded,
        evidence: &Evidence,
        motion: Option<&Flow>,
        depth: Option<&Plane>,
    ) -> Result<()> {
        let light = |image: &Encoded| tiles::light_of(image, self.options.space);
        let Evidence { denoised, motion_deblurred, defocus_deblurred, clean, .. } = evidence;
        if [denoised, motion_deblurred, defocus_deblurred, clean].iter().all(|image| image.is_none()) {
            return Ok(());
        }
        // The chain is that of the paper: each distortion is fitted between the images before and after its removal, or else between the
        // frame and the clean frame with the other distortion applied.
        let target = light(evidence.denoised.unwrap_or(frame));
        let weight = self.noise_weight(frame);
        let clean = evidence.clean.map(light);
        let exposure_alone =
            |sharp: &Plane| motion.and_then(|f| motion_blur::fit_exposure(&target, &weight, sharp, f));
        let lens_alone = |target: &Plane, sharp: &Plane| {
            depth.and_then(|d| defocus::fit_lens(target, &weight, sharp, d, None))
        };
        if let Some(deblurred) = evidence.motion_deblurred {
            let deblurred = light(deblurred);
            kept.exposure = exposure_alone(&deblurred);
            if let Some(clean) = &clean {
                kept.lens = lens_alone(&deblurred, clean);
                if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                    kept.search = defocus::pooled_search(&deblurred, clean, d);
                }
            }
        } else if let Some(clean) = &clean {
            kept.exposure = exposure_alone(clean);
            kept.lens = lens_alone(&target, clean);
            if let (Some(motion), Some(depth), Some(_), Some(_)) = (motion, depth, &kept.exposure, &kept.lens)
            {
                for _ in 0..3 {
                    let lens = kept.lens.as_ref().map(|l| l.lens);
                    let defocused = match lens {
                        Some(l) => synth::defocus::defocus(clean, &depth.map(|d| l.sigma_px(d)), BOKEH)?,
                        None => clean.clone(),
                    };
                    let before = kept.numbers();
                    kept.exposure = exposure_alone(&defocused);
                    let exposure = kept.exposure.as_ref().map_or(ExposureFraction(0.0), |e| e.exposure);
                    kept.lens = defocus::fit_lens(&target, &weight, clean, depth, Some((motion, exposure)));
                    if before.iter().zip(kept.numbers()).all(|(a, b)| (a - b).abs() < SETTLED) {
                        break;
                    }
                }
            }
            if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                let exposure = kept.exposure.as_ref().map_or(ExposureFraction(0.0), |e| e.exposure);
                let still = motion
                    .map_or(Ok(clean.clone()), |f| synth::motion_blur::motion_blur(clean, f, exposure))?;
                kept.search = defocus::pooled_search(&target, &still, d);
            }
        }
        if let Some(sharp) = evidence.defocus_deblurred {
            let sharp = light(sharp);
            kept.lens = lens_alone(&target, &sharp);
            if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                kept.search = defocus::pooled_search(&target, &sharp, d);
            }
        }
        match (evidence.denoised, evidence.clean) {
            (Some(denoised), _) => kept.denoised.add_denoised(frame, denoised)?,
            (None, Some(clean)) => {
                let blurred = self.reblurred(clean, kept, motion, depth)?;
                kept.denoised.add_residual(frame, &blurred, clean)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// The clean frame with the blur that was found in this frame.
    fn reblurred(
        &self,
        clean: &Encoded,
        found: &FrameEvidence,
        motion: Option<&Flow>,
        depth: Option<&Plane>,
    ) -> Result<Encoded> {
        let space = self.options.space;
        let mut image = clean.0.map(|v| space.of_encoded(v));
        if let (Some(l), Some(d)) = (&found.lens, depth) {
            image = synth::defocus::defocus(&image, &d.map(|d| l.lens.sigma_px(d)), BOKEH)?;
        }
        if let (Some(e), Some(f)) = (&found.exposure, motion) {
            image = synth::motion_blur::motion_blur(&image, f, e.exposure)?;
        }
        Ok(Encoded(image.map(|v| space.encoded(v))))
    }

    /// The inverse std of the frame's noise in the light that is blurred, up to a constant: noise is nearly the same at all encoded values,
    /// so the std in light is in proportion to the inverse slope of the transfer curve.
    fn noise_weight(&self, frame: &Encoded) -> Plane {
        let space = self.options.space;
        filter::gaussian_blur(&frame.luma(), 1.5).map(|v| space.slope(v.max(0.02)) * 100.0)
    }

    /// The weighted median of the exposure over the frames that were compared with clean frames; `None` if its interval is too wide.
    pub(super) fn aggregate_exposure(&self) -> Option<ExposureEvidence> {
        let fits: Vec<(usize, &motion_blur::ExposureFit)> =
            self.frames.iter().filter_map(|f| f.exposure.as_ref().map(|e| (f.index, e))).collect();
        let values: Vec<(f32, f64)> = fits.iter().map(|(_, e)| (e.exposure.0, e.variance)).collect();
        let floor = if self.by_network { NETWORK_EXPOSURE_FLOOR } else { REMOVAL_EXPOSURE_FLOOR };
        let (value, interval) = aggregate(&values, floor)?;
        let typical = fits
            .iter()
            .min_by(|a, b| (a.1.exposure.0 - value).abs().total_cmp(&(b.1.exposure.0 - value).abs()))?;
        let model = MotionBlurModel {
            exposure: ExposureFraction(value.min(1.0)),
            interval: interval.map(|v| v.min(1.0)),
            method: Method::Removal,
            samples: fits.iter().map(|(_, e)| e.samples as u64).sum(),
            phase_degrees: None,
        };
        (interval[1] - interval[0] <= agreement::MAX_UNCERTAINTY)
            .then(|| (model, typical.1.curve.clone(), fits.iter().map(|(i, e)| (*i, e.exposure.0)).collect()))
    }

    /// The lens over those of the frames that were compared with clean frames, with the 95 % intervals of the std at infinity and of the inverse
    /// depth in focus, and the number of samples; `None` if there is no such frame or the blur is too uncertain.
    pub(super) fn aggregate_lens(
        frames: &[&FrameEvidence],
        by_network: bool,
    ) -> Option<(defocus::Lens, [f32; 2], [f32; 2], usize)> {
        let fits: Vec<&defocus::LensFit> = frames.iter().filter_map(|f| f.lens.as_ref()).collect();
        let of = |value: &dyn Fn(defocus::Lens) -> f32,
                  variance: &dyn Fn(&defocus::LensFit) -> f64,
                  least: &dyn Fn(&defocus::LensFit) -> f32| {
            let values: Vec<(f32, f64)> = fits.iter().map(|f| (value(f.lens), variance(f))).collect();
            let middle = median(values.iter().map(|v| v.0).collect())?;
            let floor = if by_network { NETWORK_LENS_FLOOR } else { REMOVAL_LENS_FLOOR };
            aggregate(&values, (floor * middle).hypot(median(fits.iter().map(|f| least(f)).collect())?))
        };
        let infinity = |f: &defocus::LensFit| {
            let g = [f64::from(f.lens.focus), f64::from(f.lens.slope)];
            (0..2)
                .flat_map(|i| (0..2).map(move |j| (i, j)))
                .map(|(i, j)| g[i] * f.covariance[i][j] * g[j])
                .sum::<f64>()
        };
        let (sigma, sigma_interval) = of(&|l| l.sigma_px_at_infinity(), &infinity, &|_| REMOVAL_UNTOLD_PX)?;
        let unseen = |f: &defocus::LensFit| agreement::unseen_focus(f.lens, REMOVAL_UNTOLD_PX, f.range.1);
        let (focus, focus_interval) = of(&|l| l.focus, &|f| f.covariance[1][1], &unseen)?;
        // The lens is that of one frame, the nearest to both medians: the two medians together may be a lens that no frame has.
        let off = |f: &defocus::LensFit| {
            let share = |v: f32, of: f32| (v - of).abs() / of.max(1e-3);
            share(f.lens.sigma_px_at_infinity(), sigma) + share(f.lens.focus, focus)
        };
        let lens = fits.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?.lens;
        let (s, f) = (lens.sigma_px_at_infinity(), lens.focus);
        let sigma_interval = [sigma_interval[0].min(s), sigma_interval[1].max(s)];
        let focus_interval = [focus_interval[0].min(f), focus_interval[1].max(f)];
        let sure = sigma_interval[1] - sigma_interval[0] <= 2.0 * sigma.max(0.5);
        sure.then(|| (lens, sigma_interval, focus_interval, fits.iter().map(|f| f.samples).sum()))
    }
}
