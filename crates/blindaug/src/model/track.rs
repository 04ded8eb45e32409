use super::{CameraModel, DefocusCurve, DefocusModel, Estimate, ExposureFraction, NoiseLevel, NoiseModel};
use super::{MotionBlurModel, NoiseInterval, SharpeningModel, ThinLensInterval, Unknown};
use crate::{Error, Result, text};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Which parameters of a camera jumped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Changes {
    /// Gain, or light.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub noise: bool,
    /// The shutter.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub exposure: bool,
    /// Focus, aperture or focal length.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub defocus: bool,
}

impl Changes {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// The camera of one frame of a [`CameraTrack`].
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedCamera {
    /// The frame's number.
    pub frame: u64,
    /// What was found to have changed just before.
    pub changed: Changes,
    /// The camera, as far as this frame and those before it tell.
    pub camera: CameraModel,
}

impl TrackedCamera {
    /// A line of a file of per-frame models, without its end: the camera's JSON with `frame` and `changed`.
    pub fn to_json_line(&self) -> String {
        #[derive(Serialize)]
        struct Line<'a> {
            frame: u64,
            #[serde(skip_serializing_if = "Changes::is_empty")]
            changed: Changes,
            #[serde(flatten)]
            camera: &'a CameraModel,
        }
        let Self { frame, changed, camera } = self;
        serde_json::to_string(&Line { frame: *frame, changed: *changed, camera })
            .expect("a model has only string keys and finite numbers")
    }

    fn from_json_line(line: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Head {
            frame: u64,
            #[serde(default)]
            changed: Changes,
        }
        let Head { frame, changed } = serde_json::from_str(line).map_err(|e| {
            let why = text::one_line(&e.to_string());
            Error::new(format!("not a camera model with the number of its frame: {why}"))
        })?;
        Ok(Self { frame, changed, camera: CameraModel::from_json(line)? })
    }
}

/// A camera over time: a model for each of some frames, or one for all.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraTrack {
    /// At least one, in the order of their frames.
    frames: Vec<TrackedCamera>,
}

impl From<CameraModel> for CameraTrack {
    /// The same camera in all frames.
    fn from(camera: CameraModel) -> Self {
        Self { frames: vec![TrackedCamera { frame: 0, changed: Changes::default(), camera }] }
    }
}

impl CameraTrack {
    /// Reads one camera.json, or JSON lines with the number of a frame each.
    ///
    /// # Errors
    /// As [`CameraModel::from_json`], with the number of the line; if the frames' numbers do not rise.
    pub fn from_json(json: &str) -> Result<Self> {
        // Some editors put a byte order mark before the text.
        let json = json.strip_prefix('\u{feff}').unwrap_or(json);
        if !json.lines().next().is_some_and(|line| line.contains("\"frame\"")) {
            return CameraModel::from_json(json).map(Self::from);
        }
        let mut frames: Vec<TrackedCamera> = Vec::new();
        for (i, line) in json.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let of_line = |e: String| Error::new(format!("line {}: {e}", i + 1));
            let read = TrackedCamera::from_json_line(line).map_err(|e| of_line(e.to_string()))?;
            if let Some(last) = frames.last().filter(|last| last.frame >= read.frame) {
                return Err(of_line(format!(
                    "frame {} comes after frame {}; sort the lines by their frames",
                    read.frame, last.frame
                )));
            }
            frames.push(read);
        }
        Ok(Self { frames })
    }

    /// The cameras of frames, in the order of their numbers.
    ///
    /// # Errors
    /// If there is none, or the frames' numbers do not rise.
    pub fn from_frames(frames: Vec<TrackedCamera>) -> Result<Self> {
        if frames.is_empty() || !frames.is_sorted_by(|a, b| a.frame < b.frame) {
            return Err(Error::new(
                "a camera over time needs at least one frame, and frames in the order of their numbers",
            ));
        }
        Ok(Self { frames })
    }

    /// The cameras, in the order of their frames; one that holds for all frames has number 0.
    pub fn frames(&self) -> &[TrackedCamera] {
        &self.frames
    }

    /// The camera of a frame: interpolated linearly between the frames around it that have one, the nearest before the
    /// first and after the last.
    pub fn at(&self, frame: u64) -> Cow<'_, CameraModel> {
        let after = self.frames.partition_point(|f| f.frame < frame);
        let Some(next) = self.frames.get(after) else {
            return Cow::Borrowed(&self.frames[self.frames.len() - 1].camera);
        };
        if next.frame == frame || after == 0 {
            return Cow::Borrowed(&next.camera);
        }
        let last = &self.frames[after - 1];
        let t = (frame - last.frame) as f32 / (next.frame - last.frame) as f32;
        Cow::Owned(between(&last.camera, &next.camera, t))
    }

    /// Every camera changed by a function.
    pub fn map(mut self, f: impl Fn(CameraModel) -> CameraModel) -> Self {
        self.frames = self.frames.into_iter().map(|t| TrackedCamera { camera: f(t.camera), ..t }).collect();
        self
    }

    /// Why a part of the model is known in no frame; `None` if it is in one.
    pub fn why_unknown(&self, part: impl Fn(&CameraModel) -> Option<&Unknown>) -> Option<&Unknown> {
        self.frames.iter().map(|f| part(&f.camera)).reduce(|a, b| a.and(b)).flatten()
    }
}

/// `a` at t = 0, `b` at t = 1; what is unknown in one is the other's.
fn between(a: &CameraModel, b: &CameraModel, t: f32) -> CameraModel {
    let nearer = if t < 0.5 { a } else { b };
    CameraModel {
        noise: both(&a.noise, &b.noise, |a, b| noise_between(a, b, t)),
        motion_blur: both(&a.motion_blur, &b.motion_blur, |a, b| MotionBlurModel {
            exposure: ExposureFraction(lerp(a.exposure.0, b.exposure.0, t)),
            interval: lerp_all(a.interval, b.interval, t),
            ..if t < 0.5 { *a } else { *b }
        }),
        defocus: both(&a.defocus, &b.defocus, |a, b| lens_between(a, b, t)),
        sharpening: both(&a.sharpening, &b.sharpening, |a, b| SharpeningModel {
            amount: lerp(a.amount, b.amount, t),
            radius_px: lerp(a.radius_px, b.radius_px, t),
            interval: lerp_all(a.interval, b.interval, t),
            ..if t < 0.5 { *a } else { *b }
        }),
        ..nearer.clone()
    }
}

fn both<T: Clone>(a: &Estimate<T>, b: &Estimate<T>, of: impl Fn(&T, &T) -> T) -> Estimate<T> {
    match (a, b) {
        (Estimate::Known(a), Estimate::Known(b)) => Estimate::Known(of(a, b)),
        (Estimate::Unknown(_), _) => b.clone(),
        _ => a.clone(),
    }
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

fn lerp_all<const N: usize>(a: [f32; N], b: [f32; N], t: f32) -> [f32; N] {
    std::array::from_fn(|i| lerp(a[i], b[i], t))
}

fn noise_between(a: &NoiseModel, b: &NoiseModel, t: f32) -> NoiseModel {
    let intervals = |a: &[[f32; 2]; 3], b: &[[f32; 2]; 3]| std::array::from_fn(|c| lerp_all(a[c], b[c], t));
    NoiseModel {
        levels: std::array::from_fn(|l| NoiseLevel {
            slope: lerp_all(a.levels[l].slope, b.levels[l].slope, t),
            intercept: lerp_all(a.levels[l].intercept, b.levels[l].intercept, t),
        }),
        interval: a.interval.zip(b.interval).map(|(a, b)| {
            std::array::from_fn(|l| NoiseInterval {
                slope: intervals(&a[l].slope, &b[l].slope),
                intercept: intervals(&a[l].intercept, &b[l].intercept),
            })
        }),
        clip: lerp(a.clip, b.clip, t),
        ..if t < 0.5 { a.clone() } else { b.clone() }
    }
}

/// Lenses of another kind or unit cannot be mixed: then the nearer one.
fn lens_between(a: &DefocusModel, b: &DefocusModel, t: f32) -> DefocusModel {
    let nearer = if t < 0.5 { *a } else { *b };
    match (a.curve, b.curve) {
        (
            DefocusCurve::ThinLens { sigma_px_at_infinity: sa, focus_inverse_depth: fa, interval: ia },
            DefocusCurve::ThinLens { sigma_px_at_infinity: sb, focus_inverse_depth: fb, interval: ib },
        ) if a.depth_kind == b.depth_kind => {
            let interval = ia.zip(ib).map(|(a, b)| ThinLensInterval {
                sigma_px_at_infinity: lerp_all(a.sigma_px_at_infinity, b.sigma_px_at_infinity, t),
                focus_inverse_depth: lerp_all(a.focus_inverse_depth, b.focus_inverse_depth, t),
            });
            let curve = DefocusCurve::ThinLens {
                sigma_px_at_infinity: lerp(sa, sb, t),
                focus_inverse_depth: lerp(fa, fb, t),
                interval,
            };
            DefocusModel { curve, ..nearer }
        }
        _ => nearer,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Capture, NOISE_LEVELS};

    fn camera(frame: u64, exposure: Option<f32>, focus: f32) -> TrackedCamera {
        let mut camera =
            CameraModel::unknown(Capture { width: 64, height: 48, fps: None, frames_used: 1 }, "dark");
        if let Some(e) = exposure {
            camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(e)));
        }
        camera.defocus = Estimate::Known(DefocusModel::given_lens(2.0 * focus, focus));
        let level = NoiseLevel { slope: [0.0; 3], intercept: [focus; 3] };
        camera.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
        TrackedCamera { frame, changed: Changes { exposure: frame == 20, ..Changes::default() }, camera }
    }

    fn track() -> CameraTrack {
        CameraTrack {
            frames: vec![camera(10, None, 0.2), camera(20, Some(0.2), 0.4), camera(30, Some(0.6), 0.8)],
        }
    }

    #[test]
    fn between_frames_the_camera_is_interpolated_and_outside_it_is_the_nearest() {
        let track = track();
        let at = |frame: u64| {
            let m = track.at(frame);
            let lens = m.defocus.known().unwrap();
            (
                m.motion_blur.known().map(|m| m.exposure.0),
                lens.sigma_px(0.0),
                m.noise.known().unwrap().levels[0].intercept[1],
            )
        };
        let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
        let (exposure, sigma, noise) = at(25);
        assert!(near(exposure.unwrap(), 0.4) && near(sigma, 1.2) && near(noise, 0.6), "{:?}", at(25));
        // Unknown on one side: the other's.
        assert_eq!(at(15).0, Some(0.2));
        assert_eq!((at(0), at(10).0), (at(10), None));
        assert_eq!(at(99), at(30));
        assert_eq!(track.why_unknown(|m| m.motion_blur.why_unknown()), None);
    }

    #[test]
    fn lines_round_trip_and_bad_ones_are_named() {
        let lines: Vec<String> = track().frames().iter().map(TrackedCamera::to_json_line).collect();
        assert_eq!(CameraTrack::from_json(&lines.join("\n")).unwrap(), track());
        assert_eq!(CameraTrack::from_json(&track().frames[1].camera.to_json()).unwrap().frames().len(), 1);
        let error = |lines: &[&str]| CameraTrack::from_json(&lines.join("\n")).unwrap_err().to_string();
        assert!(error(&[&lines[1], &lines[0]]).starts_with("line 2: frame 10 comes after frame 20"));
        assert!(error(&[&lines[0], &lines[1][..100]]).starts_with("line 2: not a camera model"));
        assert!(error(&[&lines[0].replace("64", "0")]).starts_with("line 1: "));
    }
}
