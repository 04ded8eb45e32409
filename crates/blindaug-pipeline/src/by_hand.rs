//! The parts of a camera that a person sets, whatever the footage says.

use blindaug::{
    CameraModel, Error, Result,
    model::{
        Aperture, Bokeh, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, MOST_SQUEEZE,
        Method, MotionBlurModel,
    },
};
use std::ops::RangeInclusive;

/// The parts of a camera that are set by hand; `None` leaves a part as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ByHand {
    /// The exposure fraction, in [0, 1].
    pub exposure: Option<ExposureFraction>,
    /// When the shutter opens, after the frame's time, in degrees of which a frame interval has 360, in [-180, 180].
    pub phase_degrees: Option<f32>,
    /// The distance in focus, m, > 0.
    pub focus_m: Option<f32>,
    /// The std of the blur at infinity, px of the model's own width, >= 0.
    pub blur_px: Option<f32>,
    /// The shape of out-of-focus points.
    pub bokeh: Option<Bokeh>,
    /// The extent of out-of-focus points from top to bottom over that from left to right, in [0.25, 4].
    pub squeeze: Option<f32>,
    /// How much out-of-focus points are cut towards the picture's edges, in [0, 1].
    pub cats_eye: Option<f32>,
    /// The factor of the noise's std, >= 0.
    pub grain: Option<f32>,
}

/// The ranges that people are offered.
impl ByHand {
    /// The shutter angle, degrees: 360 times the exposure fraction.
    pub const SHUTTER_DEGREES: RangeInclusive<f64> = 0.0..=360.0;
    /// The shutter's phase, degrees.
    pub const PHASE_DEGREES: RangeInclusive<f64> = -180.0..=180.0;
    /// The std of the blur at infinity, px.
    pub const BLUR_PX: RangeInclusive<f64> = 0.0..=100.0;
    /// The squeeze.
    pub const SQUEEZE: RangeInclusive<f64> = 1.0 / MOST_SQUEEZE as f64..=MOST_SQUEEZE as f64;
    /// The strength of the cat's eye.
    pub const CATS_EYE: RangeInclusive<f64> = 0.0..=1.0;
    /// The factor of the noise's std.
    pub const GRAIN: RangeInclusive<f64> = 0.0..=100.0;
}

impl ByHand {
    /// The model with the parts that are set.
    ///
    /// # Errors
    /// If only one of the two numbers of a lens is set and the model does not have the other in metres, a phase is set and the exposure is
    /// unknown, a Gaussian is to be cut, or noise that is unknown is to be scaled.
    pub fn applied(&self, mut model: CameraModel) -> Result<CameraModel> {
        if let Some(exposure) = self.exposure {
            model.motion_blur = Estimate::Known(MotionBlurModel::given(exposure));
        }
        if let Some(phase) = self.phase_degrees {
            match &mut model.motion_blur {
                Estimate::Known(motion_blur) => motion_blur.phase_degrees = Some(phase),
                _ => {
                    return Err(Error::new(
                        "its exposure is unknown, so that the shutter's phase can be set only together with the shutter's angle",
                    ));
                }
            }
        }
        if let Some(lens) = self.lens(&model)? {
            // Relative depth says nothing of a lens in metres.
            model.scene_depth = model.scene_depth.filter(|depth| depth.kind == lens.depth_kind);
            model.defocus = Estimate::Known(lens);
        }
        if let Estimate::Known(lens) = &mut model.defocus {
            lens.bokeh = self.aperture(lens.bokeh)?;
        }
        if let Some(factor) = self.grain {
            match &mut model.noise {
                Estimate::Known(noise) => {
                    noise.multiply(factor);
                    // Its intervals were those of another noise.
                    let lines = noise.lines_mut();
                    (lines.interval, lines.method) = (None, Method::Given);
                }
                _ => {
                    return Err(Error::new(
                        "its noise is unknown, so that it cannot be scaled: leave the grain out",
                    ));
                }
            }
        }
        Ok(model)
    }

    fn lens(&self, model: &CameraModel) -> Result<Option<DefocusModel>> {
        let known = model.defocus.known().filter(|lens| lens.depth_kind == DepthKind::Metric);
        let (blur, inverse) = match known.map(|lens| lens.curve) {
            Some(DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. }) => {
                (Some(sigma_px_at_infinity), Some(focus_inverse_depth))
            }
            _ => (None, None),
        };
        let [focus, infinity] = [self.focus_m.map(|m| 1.0 / m).or(inverse), self.blur_px.or(blur)];
        match (self.focus_m.is_some() || self.blur_px.is_some(), focus, infinity) {
            (false, ..) => Ok(None),
            (true, Some(focus), Some(blur)) => {
                let bokeh = known.map_or_else(Aperture::default, |lens| lens.bokeh);
                Ok(Some(DefocusModel { bokeh, ..DefocusModel::given_lens(blur, focus) }))
            }
            (true, ..) => Err(Error::new(
                "its lens is not known in metres, so that the focus and the blur can be set only together: give both",
            )),
        }
    }
}

impl ByHand {
    /// The aperture of a lens with the parts that are set.
    fn aperture(&self, lens: Aperture) -> Result<Aperture> {
        let aperture = Aperture {
            bokeh: self.bokeh.unwrap_or(lens.bokeh),
            squeeze: self.squeeze.unwrap_or(lens.squeeze),
            cats_eye: self.cats_eye.unwrap_or(lens.cats_eye),
        };
        if aperture.bokeh == Bokeh::Gaussian && aperture.cats_eye > 0.0 {
            return Err(Error::new(
                "a Gaussian has no edge that a cat's eye could be cut from: set the shape of a disk or a polygon, too",
            ));
        }
        Ok(aperture)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Capture, NoiseLevel, NoiseModel, Reason, SceneDepth};

    fn camera() -> CameraModel {
        let capture = Capture { width: 64, height: 48, fps: None, frames_used: 2, pixel_aspect: 1.0 };
        let mut model = CameraModel::unknown(capture, "");
        let level = NoiseLevel { slope: [0.01; 3], intercept: [0.002; 3] };
        model.noise = Estimate::Known(NoiseModel::given([level; 4], 1.0));
        model.defocus = Estimate::Known(DefocusModel::given_lens(2.0, 0.5));
        model
    }

    #[test]
    fn what_is_set_replaces_what_was_estimated_and_nothing_else() {
        let model = camera();
        assert_eq!(ByHand::default().applied(model.clone()).unwrap(), model);
        let half = ByHand { exposure: Some(ExposureFraction(0.5)), ..ByHand::default() };
        let set = half.applied(model.clone()).unwrap();
        assert_eq!(set.motion_blur.known().unwrap().exposure.0, 0.5);
        assert_eq!((set.noise, set.defocus), (model.noise.clone(), model.defocus.clone()));
        // The focus moves, and the blur at infinity stays.
        let near = ByHand { focus_m: Some(1.0), ..ByHand::default() }.applied(model.clone()).unwrap();
        let lens = near.defocus.known().unwrap();
        assert_eq!((lens.sigma_px(0.0), lens.sigma_px(1.0), lens.method), (2.0, 0.0, Method::Given));
        let grainy = ByHand { grain: Some(1.5), ..ByHand::default() }.applied(model.clone()).unwrap();
        let std = |m: &CameraModel| m.noise.known().unwrap().std(1, 0.4)[2];
        assert!((std(&grainy) / std(&model) - 1.5).abs() < 1e-5);
    }

    #[test]
    fn relative_depth_does_not_stay_beside_a_lens_in_metres() {
        let depth = |kind| SceneDepth {
            frame: 1,
            kind,
            cell_px: 16.0,
            columns: 1,
            inverse_depth: vec![Some(0.5); 3],
        };
        let kept = |kind| {
            let mut model = camera();
            model.scene_depth = Some(depth(kind));
            let lens = ByHand { focus_m: Some(2.0), blur_px: Some(3.0), ..ByHand::default() };
            // The camera's own lens is in metres: without another one all stays.
            assert!(ByHand::default().applied(model.clone()).unwrap().scene_depth.is_some());
            lens.applied(model).unwrap().scene_depth.is_some()
        };
        assert!(kept(DepthKind::Metric) && !kept(DepthKind::Relative));
    }

    #[test]
    fn the_shape_and_the_phase_are_set_and_kept() {
        let model = camera();
        let disk = ByHand { bokeh: Some(Bokeh::Disk), cats_eye: Some(0.5), ..ByHand::default() };
        let set = disk.applied(model.clone()).unwrap();
        let lens = set.defocus.known().unwrap();
        assert_eq!(lens.bokeh, Aperture { cats_eye: 0.5, ..Bokeh::Disk.into() });
        assert_eq!(DefocusModel { bokeh: Aperture::default(), ..*lens }, *model.defocus.known().unwrap());
        // The shape stays when the focus moves, and when the file is read again.
        let near =
            ByHand { focus_m: Some(1.0), squeeze: Some(2.0), ..ByHand::default() }.applied(set).unwrap();
        let read = CameraModel::from_json(&near.to_json()).unwrap();
        assert_eq!(
            read.defocus.known().unwrap().bokeh,
            Aperture { squeeze: 2.0, cats_eye: 0.5, bokeh: Bokeh::Disk }
        );
        let cut = ByHand { cats_eye: Some(0.5), ..ByHand::default() };
        assert!(cut.applied(model.clone()).unwrap_err().to_string().contains("a Gaussian has no edge"));
        let phase = ByHand { phase_degrees: Some(0.0), ..ByHand::default() };
        assert!(phase.applied(model.clone()).unwrap_err().to_string().contains("only together"));
        let both = ByHand { exposure: Some(ExposureFraction(0.5)), ..phase }.applied(model).unwrap();
        assert_eq!(both.motion_blur.known().unwrap().shutter().centre, 0.25);
    }

    #[test]
    fn half_of_a_lens_that_is_not_known_in_metres_is_refused() {
        let mut model = camera();
        model.defocus = Estimate::unknown(Reason::NoDepth, "");
        let focus = ByHand { focus_m: Some(2.0), ..ByHand::default() };
        assert!(focus.applied(model.clone()).unwrap_err().to_string().contains("only together"));
        let both = ByHand { blur_px: Some(3.0), ..focus };
        assert_eq!(both.applied(model.clone()).unwrap().defocus.known().unwrap().sigma_px(0.0), 3.0);
        model.noise = Estimate::unknown(Reason::Flat, "");
        let grain = ByHand { grain: Some(2.0), ..ByHand::default() };
        assert!(grain.applied(model).unwrap_err().to_string().contains("cannot be scaled"));
    }
}
