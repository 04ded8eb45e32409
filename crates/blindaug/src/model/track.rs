use super::{CameraModel, Distortion, Unknown};
use crate::{Error, Result, text};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// The distortions of a camera that jumped from one frame to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes([bool; Distortion::ALL.len()]);

impl Changes {
    /// Whether no distortion jumped.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether the parameters of a distortion jumped.
    pub fn of(&self, distortion: Distortion) -> bool {
        self.0[distortion as usize]
    }

    /// Records whether the parameters of a distortion jumped.
    pub fn set(&mut self, distortion: Distortion, jumped: bool) {
        self.0[distortion as usize] = jumped;
    }

    /// The name of a distortion's field in files: that of the number that jumps.
    fn key(distortion: Distortion) -> &'static str {
        match distortion {
            Distortion::MotionBlur => "exposure",
            other => other.name(),
        }
    }
}

/// A map of the names of what jumped, such as `{"exposure": true}`.
impl Serialize for Changes {
    fn serialize<S: Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        let jumped = Distortion::ALL.into_iter().filter(|&d| self.of(d));
        s.collect_map(jumped.map(|d| (Self::key(d), true)))
    }
}

impl<'de> Deserialize<'de> for Changes {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        let fields = BTreeMap::<String, bool>::deserialize(d)?;
        Ok(Self(Distortion::ALL.map(|d| fields.get(Self::key(d)) == Some(&true))))
    }
}

/// The camera of one frame of a [`CameraTrack`].
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedCamera {
    /// The number of the frame.
    pub frame: u64,
    /// The distortions that were found to have changed just before this frame.
    pub changed: Changes,
    /// The camera, as far as this frame and earlier frames tell; the noise of a clip's frame is a mean with later ones.
    pub camera: CameraModel,
}

impl TrackedCamera {
    /// A line of a file of per-frame models, without the line feed: the camera's JSON with `frame` and `changed`.
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
        text::json_line(&Line { frame: *frame, changed: *changed, camera })
    }

    fn from_json_line(line: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Head {
            frame: u64,
            #[serde(default)]
            changed: Changes,
        }
        let Head { frame, changed } = serde_json::from_str(line).map_err(|e| {
            let why = text::why_not_json(line, &e);
            Error::new(format!("not a camera model with the number of its frame: {why}"))
        })?;
        Ok(Self { frame, changed, camera: CameraModel::from_json(line)? })
    }
}

/// A camera over time: a model for each of some frames, or one model for all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraTrack {
    /// The models in the order of their frames, at least one.
    frames: Vec<TrackedCamera>,
}

/// Whether two models are for frames of one size, with pixels of one shape, whose values have one meaning.
fn are_of_one_clip(a: &CameraModel, b: &CameraModel) -> bool {
    let of = |m: &CameraModel| (m.capture.width, m.capture.height, m.capture.pixel_aspect, m.space());
    of(a) == of(b)
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
    /// The same as [`CameraModel::from_json`], with the number of the line; also if the numbers of the frames do not rise, or the models are for
    /// frames of different sizes or encodings.
    pub fn from_json(json: &str) -> Result<Self> {
        // Some editors put a byte order mark before the text.
        let json = json.strip_prefix('\u{feff}').unwrap_or(json);
        // A camera.json of one line has numbers of frames further inside.
        let of_frame = |line: &str| match serde_json::from_str::<serde_json::Value>(line) {
            Ok(line) => line.get("frame").is_some(),
            Err(_) => line.contains("\"frame\""),
        };
        if !json.lines().next().is_some_and(of_frame) {
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
            if let Some(first) = frames.first().filter(|first| !are_of_one_clip(&first.camera, &read.camera))
            {
                return Err(of_line(format!(
                    "the model of frame {} is for frames of another size or encoding than that of frame {}; all must be for one clip",
                    read.frame, first.frame
                )));
            }
            frames.push(read);
        }
        Ok(Self { frames })
    }

    /// A track of the cameras of some frames, which must be in the order of their numbers.
    ///
    /// # Errors
    /// If there is no camera, the numbers of the frames do not rise, or the cameras are for frames of different sizes or encodings.
    pub fn from_frames(frames: Vec<TrackedCamera>) -> Result<Self> {
        if frames.is_empty() || !frames.is_sorted_by(|a, b| a.frame < b.frame) {
            return Err(Error::new(
                "a camera over time needs at least one frame, and frames in the order of their numbers",
            ));
        }
        if frames.iter().any(|f| !are_of_one_clip(&frames[0].camera, &f.camera)) {
            return Err(Error::new("the cameras over time must be for frames of one size and encoding"));
        }
        Ok(Self { frames })
    }

    /// The cameras in the order of their frames; a camera that holds for all frames has frame number 0.
    pub fn frames(&self) -> &[TrackedCamera] {
        &self.frames
    }

    /// The camera of a frame: interpolated linearly between the two frames around it that have a camera; before the first of these and
    /// after the last, the nearest camera.
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
        Cow::Owned(last.camera.between(&next.camera, t))
    }

    /// The track with a function applied to every camera.
    pub fn map(mut self, f: impl Fn(CameraModel) -> CameraModel) -> Self {
        self.frames = self.frames.into_iter().map(|t| TrackedCamera { camera: f(t.camera), ..t }).collect();
        self
    }

    /// The reason why a distortion is known in no frame; `None` if it is known in at least one.
    pub fn why_unknown(&self, distortion: Distortion) -> Option<&Unknown> {
        self.frames.iter().map(|f| f.camera.why_unknown(distortion)).reduce(|a, b| a.and(b)).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Plane;
    use crate::model::{
        Capture, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel, NOISE_LEVELS,
        NoiseLevel, NoiseModel, SceneDepth,
    };

    fn camera(frame: u64, exposure: Option<f32>, focus: f32) -> TrackedCamera {
        let mut camera = CameraModel::unknown(
            Capture { width: 64, height: 48, fps: None, frames_used: 1, pixel_aspect: 1.0 },
            "dark",
        );
        if let Some(e) = exposure {
            camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(e)));
        }
        camera.defocus = Estimate::Known(DefocusModel::given_lens(2.0 * focus, focus));
        let level = NoiseLevel { slope: [0.0; 3], intercept: [focus; 3] };
        camera.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
        let mut changed = Changes::default();
        changed.set(Distortion::MotionBlur, frame == 20);
        TrackedCamera { frame, changed, camera }
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
                m.noise.known().unwrap().lines().levels[0].intercept[1],
            )
        };
        let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
        let (exposure, sigma, noise) = at(25);
        assert!(near(exposure.unwrap(), 0.4) && near(sigma, 1.2) && near(noise, 0.6), "{:?}", at(25));
        // Where one of the two frames has no exposure, the other frame's counts.
        assert_eq!(at(15).0, Some(0.2));
        assert_eq!((at(0), at(10).0), (at(10), None));
        assert_eq!(at(99), at(30));
        assert_eq!(track.why_unknown(Distortion::MotionBlur), None);
    }

    #[test]
    fn lines_round_trip_and_bad_ones_are_named() {
        let lines: Vec<String> = track().frames().iter().map(TrackedCamera::to_json_line).collect();
        assert_eq!(CameraTrack::from_json(&lines.join("\n")).unwrap(), track());
        assert_eq!(CameraTrack::from_json(&track().frames[1].camera.to_json()).unwrap().frames().len(), 1);
        // A camera of one line is one camera, though it names the frame of its depth.
        let mut one = track().frames[1].camera.clone();
        one.scene_depth = SceneDepth::of(&Plane::filled(64, 48, 0.5), DepthKind::Metric, 7);
        let one_line = serde_json::from_str::<serde_json::Value>(&one.to_json()).unwrap().to_string();
        assert!(one_line.contains("\"frame\":7"), "{one_line}");
        assert_eq!(CameraTrack::from_json(&one_line).unwrap(), one.into());
        let error = |lines: &[&str]| CameraTrack::from_json(&lines.join("\n")).unwrap_err().to_string();
        assert!(error(&[&lines[1], &lines[0]]).starts_with("line 2: frame 10 comes after frame 20"));
        let cut = error(&[&lines[0], &lines[1][..100]]);
        assert!(cut.starts_with("line 2: not a camera model") && cut.ends_with("cut off"), "{cut}");
        assert!(error(&[&lines[0].replace("64", "0")]).starts_with("line 1: "));
    }

    #[test]
    fn models_over_time_are_all_for_one_clip() {
        let (first, mut other) = (camera(1, None, 0.5), camera(2, None, 0.5));
        let lines = |other: &TrackedCamera| format!("{}\n{}\n", first.to_json_line(), other.to_json_line());
        assert!(CameraTrack::from_json(&lines(&other)).is_ok());
        other.camera.capture.width = 128;
        let said = CameraTrack::from_json(&lines(&other)).unwrap_err().to_string();
        assert!(said.starts_with("line 2: the model of frame 2 is for frames of another size"), "{said}");
        assert!(CameraTrack::from_frames(vec![first, other]).is_err());
    }
}
