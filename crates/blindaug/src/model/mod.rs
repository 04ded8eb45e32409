//! The camera model: a small file that describes how a camera distorts its pictures.

mod bokeh;
mod capture;
mod defocus;
mod distortion;
mod estimate;
mod facts;
mod motion_blur;
mod noise;
mod noise_curves;
mod scene_depth;
mod sharpening;
mod track;
mod units;

pub use bokeh::{Aperture, BLADES, Bokeh, MOST_SQUEEZE};
pub use capture::{BlurSpace, Capture, FRAME_RATES, Method, PIXEL_ASPECTS, Space, Stopped};
pub use defocus::{DefocusCurve, DefocusModel, ThinLensInterval};
pub use distortion::Parameter;
pub use estimate::{Estimate, Reason, Unknown};
pub use facts::{DefocusFacts, Focus, OutsideFocus, VISIBLE_PX, thin_lens_sharp};
pub use motion_blur::{ExposureFraction, MotionBlurModel, Shutter};
#[cfg(test)]
pub(crate) use noise::BAND_COVARIANCE;
pub use noise::{
    GREYS, NOISE_LEVELS, NoiseInterval, NoiseKind, NoiseLevel, NoiseLines, NoiseModel, total_of_levels,
};
pub use noise_curves::{CurveLevel, KNOTS, NOISE_KNOTS, NoiseCurves, place};
pub use scene_depth::{KnownDistance, SceneDepth};
pub use sharpening::SharpeningModel;
pub use track::{CameraTrack, Changes, TrackedCamera};
pub use units::{DepthKind, SceneScale, inverse_of_metric};

use crate::{Error, Result, Transfer, text};
pub(crate) use distortion::DistortionModel;
use distortion::{between, known};
use serde::{Deserialize, Deserializer, Serialize};

/// A distortion that is estimated and applied. The order of [`Distortion::ALL`] is the order in which a camera makes distortions, and in
/// which this crate applies and reports them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Distortion {
    /// Defocus: the lens blurs everything that is out of focus.
    Defocus,
    /// Motion blur: everything that moves while the shutter is open is smeared.
    MotionBlur,
    /// Sharpening: the camera adds contrast at edges.
    Sharpening,
    /// Noise of the sensor, as it is after the camera's sharpening.
    Noise,
}

impl Distortion {
    /// All distortions, in the order in which a camera makes them.
    pub const ALL: [Self; 4] = [Self::Defocus, Self::MotionBlur, Self::Sharpening, Self::Noise];

    /// The name of the distortion in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Defocus => "defocus",
            Self::MotionBlur => "motion blur",
            Self::Sharpening => "sharpening",
            Self::Noise => "noise",
        }
    }

    /// The part of the camera that makes the distortion, as headings name that part.
    pub fn part(self) -> &'static str {
        match self {
            Self::Defocus => "the lens",
            Self::MotionBlur => "the shutter",
            Self::Sharpening => "the camera's processing",
            Self::Noise => "the sensor",
        }
    }

    /// Whether every camera has this distortion, more or less of it: then the user is told when it is unknown. Of the others, an unknown one
    /// counts as absent.
    pub fn in_every_camera(self) -> bool {
        match self {
            Self::Defocus | Self::MotionBlur | Self::Noise => true,
            Self::Sharpening => false,
        }
    }
}

/// Everything that is known of a camera's noise, motion blur, defocus and sharpening.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraModel {
    format: Format,
    version: Version,
    /// The footage that the model was estimated from.
    pub capture: Capture,
    /// The progress of an estimation that was stopped before the end of the clip; `None` if it was not stopped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped: Option<Stopped>,
    /// What makes the numbers less sure than their intervals say, a clause each without a full stop: compressed footage, few frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty", deserialize_with = "printable_lines")]
    pub warnings: Vec<String>,
    /// The curve between the light that blur acts on and the frame's values.
    pub transfer: Transfer,
    /// The values that blur acts on.
    #[serde(default)]
    pub blur_space: BlurSpace,
    /// The noise of the encoded frame.
    pub noise: Estimate<NoiseModel>,
    /// The exposure.
    pub motion_blur: Estimate<MotionBlurModel>,
    /// The defocus blur over inverse depth.
    pub defocus: Estimate<DefocusModel>,
    /// The camera's own sharpening; unknown if the file has no such field.
    #[serde(default = "not_in_the_file")]
    pub sharpening: Estimate<SharpeningModel>,
    /// The depth of the scene, where it is known and the lens too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_depth: Option<SceneDepth>,
}

/// Sentences of a file, each as one printable line.
fn printable_lines<'de, D: Deserializer<'de>>(d: D) -> std::result::Result<Vec<String>, D::Error> {
    const MOST: usize = 20;
    let lines = Vec::<String>::deserialize(d)?;
    Ok(lines.iter().take(MOST).map(|line| text::one_line(line)).collect())
}

fn not_in_the_file<T>() -> Estimate<T> {
    Estimate::unknown(Reason::NotEstimated, "the file says nothing of it")
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Format {
    #[serde(rename = "blindaug-camera")]
    BlindaugCamera,
}

/// The version of the file's form that this crate reads and writes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Version(u32);

const VERSION: u32 = 1;

impl<'de> Deserialize<'de> for Version {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        match u32::deserialize(d)? {
            VERSION => Ok(Self(VERSION)),
            v => Err(serde::de::Error::custom(format!(
                "it has version {v}, this program reads version {VERSION}; use a newer blindaug, or estimate again"
            ))),
        }
    }
}

impl CameraModel {
    /// A model in which every part is unknown since it was not estimated ([`Reason::NotEstimated`]); `why` tells people the reason.
    pub fn unknown(capture: Capture, why: &str) -> Self {
        let why = Unknown::new(Reason::NotEstimated, why);
        Self {
            format: Format::BlindaugCamera,
            version: Version(VERSION),
            capture,
            stopped: None,
            warnings: vec![],
            transfer: Transfer::Srgb,
            blur_space: BlurSpace::Linear,
            noise: Estimate::Unknown(why.clone()),
            motion_blur: Estimate::Unknown(why.clone()),
            defocus: Estimate::Unknown(why.clone()),
            sharpening: Estimate::Unknown(why),
            scene_depth: None,
        }
    }

    /// The space in which blur acts, and the curve of the frames' values.
    pub fn space(&self) -> Space {
        Space { blur: self.blur_space, transfer: self.transfer }
    }

    /// The model of a distortion, or the reason why it is unknown.
    fn known(&self, distortion: Distortion) -> std::result::Result<&dyn DistortionModel, &Unknown> {
        match distortion {
            Distortion::Defocus => known(&self.defocus),
            Distortion::MotionBlur => known(&self.motion_blur),
            Distortion::Sharpening => known(&self.sharpening),
            Distortion::Noise => known(&self.noise),
        }
    }

    /// The model with its distortions scaled to frames that are `s` times as wide.
    fn scaled(mut self, s: f32) -> Self {
        if let Some(depth) = &mut self.scene_depth {
            depth.cell_px *= s;
        }
        // The compiler asks here for a distortion that is added.
        for distortion in Distortion::ALL {
            match distortion {
                Distortion::Defocus => self.defocus = self.defocus.map(|m| m.scaled(s)),
                Distortion::MotionBlur => self.motion_blur = self.motion_blur.map(|m| m.scaled(s)),
                Distortion::Sharpening => self.sharpening = self.sharpening.map(|m| m.scaled(s)),
                Distortion::Noise => self.noise = self.noise.map(|m| m.scaled(s)),
            }
        }
        self
    }

    /// Interpolates between two models: `self` at t = 0, `other` at t = 1. A part that is unknown in one is taken from the other.
    fn between(&self, other: &Self, t: f32) -> Self {
        let (a, b) = (self, other);
        let mut m = if t < 0.5 { a.clone() } else { b.clone() };
        for distortion in Distortion::ALL {
            match distortion {
                Distortion::Defocus => m.defocus = between(&a.defocus, &b.defocus, t),
                Distortion::MotionBlur => m.motion_blur = between(&a.motion_blur, &b.motion_blur, t),
                Distortion::Sharpening => m.sharpening = between(&a.sharpening, &b.sharpening, t),
                Distortion::Noise => m.noise = between(&a.noise, &b.noise, t),
            }
        }
        m
    }

    /// The reason why a distortion is unknown; `None` if it is known.
    pub fn why_unknown(&self, distortion: Distortion) -> Option<&Unknown> {
        self.known(distortion).err()
    }

    /// The numbers of a distortion, the most important one first; empty if the distortion is unknown.
    pub fn parameters(&self, distortion: Distortion) -> Vec<Parameter> {
        self.known(distortion).map_or(vec![], DistortionModel::parameters)
    }

    /// The method by which a distortion was estimated, and the number of samples; `None` if the distortion is unknown.
    pub fn basis(&self, distortion: Distortion) -> Option<(Method, u64)> {
        self.known(distortion).ok().map(DistortionModel::basis)
    }

    /// Reads camera.json.
    ///
    /// # Errors
    /// If the text is not JSON, is of another format or version, lacks a field, or holds a number out of its range.
    pub fn from_json(json: &str) -> Result<Self> {
        // Some editors put a byte order mark before the text.
        let json = json.strip_prefix('\u{feff}').unwrap_or(json);
        // The head is read first, so that a file of a newer version is called newer rather than malformed.
        #[derive(Deserialize)]
        struct Head {
            #[serde(rename = "format")]
            _format: Format,
            #[serde(rename = "version")]
            _version: Version,
        }
        serde_json::from_str::<Head>(json)
            .and_then(|_| serde_json::from_str::<Self>(json))
            .map_err(|e| {
                Error::new(format!("not a camera model of blindaug: {}", text::why_not_json(json, &e)))
            })
            .and_then(|m| m.validate().map(|()| m))
    }

    /// The text of camera.json.
    pub fn to_json(&self) -> String {
        text::json_pretty(self) + "\n"
    }

    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first field that is out of its range.
    pub fn validate(&self) -> Result<()> {
        let Capture { width, height, fps, pixel_aspect, .. } = self.capture;
        check(width > 0 && height > 0, "capture.width and capture.height must be at least 1 px")?;
        check(fps.is_none_or(|f| f.is_finite() && f > 0.0), "capture.fps must be a positive number")?;
        self.scene_depth.as_ref().map_or(Ok(()), SceneDepth::validate)?;
        check(PIXEL_ASPECTS.contains(&pixel_aspect), "capture.pixel_aspect must be a number from 0.1 to 10")?;
        let fits = self.motion_blur.why_unknown().and_then(|why| why.fits);
        check(
            fits.is_none_or(|[low, high]| 0.0 <= low && low <= high && high <= 1.0),
            "motion_blur.fits must be two rising numbers from 0 to 1",
        )?;
        Distortion::ALL.into_iter().filter_map(|d| self.known(d).ok()).try_for_each(|model| model.validate())
    }

    /// Checks that the model is for frames of this width, px.
    ///
    /// # Errors
    /// If the model is for another width.
    pub fn check_width(&self, width: usize) -> Result<()> {
        if self.capture.width == width {
            return Ok(());
        }
        Err(Error::new(format!(
            "the camera model is for frames {} px wide but the frame is {width}; scale it first (CameraModel::scaled_to)",
            self.capture.width
        )))
    }

    /// The model for frames of the same width in pixels that show the same view in pixels of another shape: the lens's std, which is measured in
    /// px of the height, scales with the shown width.
    pub fn with_pixel_aspect(&self, pixel_aspect: f32) -> Self {
        let mut m = self.clone();
        let wider = pixel_aspect / m.capture.pixel_aspect;
        m.capture.pixel_aspect = pixel_aspect;
        if wider != 1.0 {
            m.defocus = m.defocus.map(|lens| lens.scaled(wider));
        }
        m
    }

    /// The model of footage whose pixels have this shape, given one that was estimated as if they were square: the lens's std, which was then
    /// about the root mean square of those along and down the picture, becomes that down the picture.
    pub fn measured_in_pixels_of(&self, pixel_aspect: f32) -> Self {
        let mut m = self.clone();
        m.capture.pixel_aspect = pixel_aspect;
        if pixel_aspect != 1.0 {
            let along = pixel_aspect.recip();
            m.defocus = m.defocus.map(|lens| lens.scaled((0.5 * (1.0 + along * along)).sqrt().recip()));
        }
        m
    }

    /// The model for frames of another size: blur in px scales with the width, noise and exposure stay.
    ///
    /// A pixel of the new size keeps the noise of one of the old size, as of a camera of the same sensor quality.
    pub fn scaled_to(&self, width: usize, height: usize) -> Self {
        let mut m = self.clone().scaled(width as f32 / self.capture.width as f32);
        m.capture.width = width;
        m.capture.height = height;
        m
    }
}

/// Whether an interval is two finite numbers that do not fall.
fn rise([low, high]: [f32; 2]) -> bool {
    low.is_finite() && high.is_finite() && low <= high
}

fn check(holds: bool, sentence: &str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::new(sentence)) }
}

/// Linear interpolation: `a` at t = 0, `b` at t = 1.
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

/// [`lerp`], number by number.
fn lerp_all<const N: usize>(a: [f32; N], b: [f32; N], t: f32) -> [f32; N] {
    std::array::from_fn(|i| lerp(a[i], b[i], t))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: &str = r#"{ "format": "blindaug-camera", "version": 1,
      "capture": { "width": 512, "height": 512, "fps": 30.0, "frames_used": 5 },
      "transfer": "srgb",
      "noise": { "levels": [ { "slope": [0.01,0.01,0.02], "intercept": [0.01,0.01,0.01] },
        { "slope": [0.01,0.01,0.02], "intercept": [0.01,0.01,0.01] }, { "slope": [0.01,0.01,0.02], "intercept": [0.01,0.01,0.01] },
        { "slope": [0.01,0.01,0.02], "intercept": [0.01,0.01,0.01] } ], "clip": 1.0, "method": "temporal", "samples": 12345 },
      "motion_blur": { "exposure": 0.48, "interval": [0.45, 0.51], "method": "spectral", "samples": 210 },
      "defocus": { "model": "thin_lens", "sigma_px_at_infinity": 4.3, "focus_inverse_depth": 0.167, "depth_kind": "metric",
        "interval": { "sigma_px_at_infinity": [4.1, 4.5], "focus_inverse_depth": [0.16, 0.17] }, "method": "spectral", "samples": 280 } }"#;

    #[test]
    fn the_contract_s_sample_round_trips() {
        let m = CameraModel::from_json(SAMPLE).unwrap();
        assert_eq!(CameraModel::from_json(&m.to_json()).unwrap(), m);
        let (a, b): (serde_json::Value, serde_json::Value) =
            (serde_json::from_str(SAMPLE).unwrap(), serde_json::from_str(&m.to_json()).unwrap());
        for (k, v) in a.as_object().unwrap() {
            if k == "transfer" || k == "format" || k == "version" {
                assert_eq!(&b[k], v);
            }
        }
        assert!(b["defocus"].get("model").is_some());
    }

    #[test]
    fn pixels_that_are_not_square_are_kept_and_their_lens_s_blur_is_that_down_the_picture() {
        let square = CameraModel::from_json(SAMPLE).unwrap();
        assert!(!square.to_json().contains("pixel_aspect"));
        let sigma = |m: &CameraModel| m.defocus.known().unwrap().sigma_px(0.0);
        let wide = square.measured_in_pixels_of(2.0);
        // Files have six digits, which are kept.
        let kept = CameraModel::from_json(&wide.to_json()).unwrap();
        assert!(kept.capture == wide.capture && (sigma(&kept) / sigma(&wide) - 1.0).abs() < 1e-5);
        assert_eq!(CameraModel::from_json(&kept.to_json()).unwrap(), kept);
        // Stds of 1 and 2 px along and down the picture have a root mean square of 2.5^(1/2).
        assert!((sigma(&wide) / sigma(&square) - 2.0 / 2.5f32.sqrt()).abs() < 1e-5);
        // Shown in half as many pixels, each twice as wide, the picture has the same height and the same blur down.
        let squeezed = square.scaled_to(256, 512).with_pixel_aspect(2.0);
        assert!((sigma(&squeezed) - sigma(&square)).abs() < 1e-5);
        assert_eq!(square.measured_in_pixels_of(1.0), square);
        assert_eq!(square.with_pixel_aspect(1.0), square);
        let bad = wide.to_json().replace("\"pixel_aspect\": 2.0", "\"pixel_aspect\": 0.0");
        assert!(CameraModel::from_json(&bad).unwrap_err().to_string().contains("pixel_aspect"));
    }

    #[test]
    fn shapes_and_phases_round_trip_and_their_numbers_are_checked() {
        let with = |shape: &str| {
            let field = format!(r#""depth_kind": "metric", "bokeh": {{ {shape} }}"#);
            CameraModel::from_json(&SAMPLE.replacen(r#""depth_kind": "metric""#, &field, 1))
        };
        for shape in [
            r#""shape": "gaussian""#,
            r#""shape": "disk", "cats_eye": 0.5"#,
            r#""shape": "polygon", "blades": 7, "roundness": 0.25, "rotation_degrees": -12.5, "squeeze": 2.0"#,
        ] {
            let m = with(shape).unwrap();
            assert_eq!(CameraModel::from_json(&m.to_json()).unwrap(), m);
        }
        let polygon = Bokeh::Polygon { blades: 7, roundness: 0.0, rotation_degrees: 0.0 };
        let m = with(r#""shape": "polygon", "blades": 7"#).unwrap();
        assert_eq!(m.defocus.known().unwrap().bokeh, polygon.into());
        for (shape, says) in [
            (r#""shape": "polygon", "blades": 2"#, "blades"),
            (r#""shape": "polygon", "blades": 7, "roundness": 1.5"#, "roundness"),
            (r#""shape": "disk", "squeeze": 9.0"#, "squeeze"),
            (r#""shape": "disk", "cats_eye": -1.0"#, "cats_eye"),
            (r#""shape": "gaussian", "cats_eye": 0.5"#, "no edge"),
            (r#""shape": "star""#, "star"),
        ] {
            let e = with(shape).unwrap_err().to_string();
            assert!(e.contains(says), "{shape}: {e}");
        }
        let phase = |degrees: &str| {
            let field = format!(r#""exposure": 0.48, "phase_degrees": {degrees}"#);
            CameraModel::from_json(&SAMPLE.replacen(r#""exposure": 0.48"#, &field, 1))
        };
        let m = phase("0.0").unwrap();
        assert_eq!(CameraModel::from_json(&m.to_json()).unwrap(), m);
        assert!((m.motion_blur.known().unwrap().shutter().centre - 0.24).abs() < 1e-6);
        assert!(phase("200.0").unwrap_err().to_string().contains("phase_degrees"));
    }

    #[test]
    fn unknown_parts_round_trip() {
        let m = CameraModel::unknown(
            Capture { width: 4, height: 3, fps: None, frames_used: 0, pixel_aspect: 1.0 },
            "nothing moves",
        );
        assert_eq!(CameraModel::from_json(&m.to_json()).unwrap(), m);
        let why = m.motion_blur.why_unknown().unwrap();
        assert_eq!((why.reason, why.sentence.as_str()), (Reason::NotEstimated, "nothing moves"));
    }

    #[test]
    fn bad_files_are_refused_with_the_field_s_name() {
        for (from, to, says) in [
            (r#""version": 1"#, r#""version": 2"#, "version 2"),
            (r#""exposure": 0.48, "#, "", "exposure"),
            (r#""exposure": 0.48"#, r#""exposure": -0.48"#, "exposure"),
            (r#""exposure": 0.48"#, r#""exposure": NaN"#, "not a camera model"),
            (r#""sigma_px_at_infinity": 4.3"#, r#""sigma_px_at_infinity": -4.3"#, "sigma_px_at_infinity"),
            (r#""sigma_px_at_infinity": 4.3"#, r#""sigma_px_at_infinity": 1e999"#, "not a camera model"),
            (r#""intercept": [0.01,0.01,0.01]"#, r#""intercept": [0.01,0.01]"#, "not a camera model"),
            (r#""width": 512"#, r#""width": 0"#, "width"),
            ("blindaug-camera", "other", "other"),
        ] {
            assert!(SAMPLE.contains(from), "{from}");
            let e = CameraModel::from_json(&SAMPLE.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(e.contains(says), "{e}");
        }
    }

    #[test]
    fn sharpening_round_trips_and_its_numbers_are_checked() {
        let with = |amount: &str| {
            let field = format!(
                r#", "sharpening": {{ "amount": {amount}, "radius_px": 1.0, "interval": [0.5, 0.9], "method": "temporal", "samples": 400 }} }}"#
            );
            CameraModel::from_json(&(SAMPLE.strip_suffix('}').unwrap().to_owned() + &field))
        };
        let m = with("0.7").unwrap();
        assert_eq!(CameraModel::from_json(&m.to_json()).unwrap(), m);
        let sharpening = *m.scaled_to(1024, 1024).sharpening.known().unwrap();
        assert_eq!(sharpening.radius_px, 2.0);
        assert_eq!(sharpening.gain(0.0), 1.0);
        assert!((sharpening.gain(0.5) - 1.7).abs() < 1e-3);
        assert!(with("-0.7").unwrap_err().to_string().contains("sharpening.amount"));
    }

    #[test]
    fn defocus_scales_with_the_width() {
        let m = CameraModel::from_json(SAMPLE).unwrap();
        let (a, b) = (m.defocus.known().unwrap(), m.scaled_to(1024, 1024));
        assert_eq!(b.defocus.known().unwrap().sigma_px(0.5), 2.0 * a.sigma_px(0.5));
    }
}
