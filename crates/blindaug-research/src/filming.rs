//! Scenes of known truth filmed with one setting after another.

use blindaug::{Encoded, Flow, Result, Transfer};
use blindaug_io::{FrameRange, FrameSource, VideoCoding, VideoWriter};
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::measure::{Footage, NoiseTruth, Truth};
use blindaug_scenes::scene::{Exposure, Scene};
use std::path::Path;

/// A scene, its sharp frames and the evidence that can be given with them.
pub(crate) struct Filming {
    scene: Scene,
    /// The footage of the last setting.
    pub(crate) footage: Footage,
    /// The motion of each frame at its own time.
    pub(crate) motion: Vec<Flow>,
    /// The camera and the setting that filmed last, their frames and the noise of these.
    filmed: Option<((Camera, Setting), Vec<Encoded>, NoiseTruth)>,
}

impl Filming {
    /// So many frames of a scene, not filmed yet.
    pub(crate) fn new(scene: Scene, frames: u64) -> Self {
        let times = || 0..frames;
        let footage = Footage {
            frames: vec![],
            clean: times()
                .map(|t| scene.picture(t as f32, Exposure::default(), 0).to_encoded(Transfer::Srgb))
                .collect(),
            inverse_depth: times().map(|t| scene.inverse_depth(t as f32)).collect(),
            flow: times().map(|t| scene.flow(t as f32)).collect(),
            truth: Truth { exposure: 0.0, lens: None },
            noise: None,
        };
        let motion = times().map(|t| scene.motion(t as f32)).collect();
        Self { scene, footage, motion, filmed: None }
    }

    /// Films the scene, unless that was done last, and puts the frames and the truth into the footage.
    pub(crate) fn film(&mut self, camera: Camera, setting: Setting, seed: u64) -> Result<()> {
        let by = (camera, setting);
        if self.filmed.as_ref().is_none_or(|f| f.0 != by) {
            let mut noise = NoiseTruth::default();
            let mut frames = vec![];
            for (t, clean) in self.footage.clean.iter().enumerate() {
                let evidence =
                    (&clean.to_linear(Transfer::Srgb), &self.footage.inverse_depth[t], &self.motion[t]);
                let filmed = camera.film(&self.scene, t as u64, evidence, &setting, seed)?;
                noise.add(&filmed.frame, &filmed.without_noise);
                frames.push(filmed.frame);
            }
            self.filmed = Some((by, frames, noise));
        }
        let (_, frames, noise) = self.filmed.as_ref().expect("it was just filmed");
        self.footage.truth = Truth { exposure: setting.exposure, lens: setting.lens };
        self.footage.frames.clone_from(frames);
        self.footage.noise = Some(noise.clone());
        Ok(())
    }
}

/// Writes frames as a video; none of them leave no file.
///
/// # Errors
/// If there is no ffmpeg program or the file cannot be written.
pub(crate) fn write_video<'a>(
    frames: impl IntoIterator<Item = &'a Encoded>,
    coding: VideoCoding,
    path: &Path,
) -> blindaug_io::Result<()> {
    const FPS: f64 = 25.0;
    let mut frames = frames.into_iter().peekable();
    let Some(first) = frames.peek() else { return Ok(()) };
    let mut video = VideoWriter::create_coded(path, first.0.size(), FPS, coding)?;
    frames.try_for_each(|f| video.write(f))?;
    video.finish()
}

/// The frames after coding as a video, which stays at `path`.
///
/// # Errors
/// The same as those of [`write_video`], and if the video cannot be read again.
pub(crate) fn coded(
    frames: &[Encoded],
    coding: VideoCoding,
    path: &Path,
) -> blindaug_io::Result<Vec<Encoded>> {
    write_video(frames, coding, path)?;
    if frames.is_empty() {
        return Ok(vec![]);
    }
    let source = FrameSource::open(path, FrameRange::default())?;
    source.frames().map(|f| Ok(f?.image)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::{Raster, metrics::psnr};

    #[test]
    fn coders_change_frames_as_much_as_they_are_told_to() {
        if !VideoWriter::is_available() {
            eprintln!("SKIPPED: no ffmpeg program, so nothing goes through a video coder");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let frame = |t: usize| {
            let value = |x: usize, y: usize| {
                0.3 + 0.4 * ((x + 2 * t) as f32 * 0.31).sin().abs() * (y as f32 * 0.17).cos().abs()
            };
            Encoded(Raster::from_fn(96, 64, |x, y| [value(x, y), 0.8 * value(y, x), 0.5]))
        };
        let frames: Vec<Encoded> = (0..3).map(frame).collect();
        let like = |coding, name: &str| {
            let made = coded(&frames, coding, &folder.path().join(name)).unwrap();
            assert_eq!(made.len(), frames.len());
            psnr(&made[1], &frames[1], None).unwrap()
        };
        for (fine, coarse, ending) in [
            (VideoCoding::H264 { crf: 10 }, VideoCoding::H264 { crf: 40 }, "mp4"),
            (VideoCoding::Mjpeg { scale: 2 }, VideoCoding::Mjpeg { scale: 31 }, "avi"),
        ] {
            let (a, b) = (like(fine, &format!("a.{ending}")), like(coarse, &format!("b.{ending}")));
            assert!(a > 30.0 && a > b + 3.0, "{fine:?}: {a}, {coarse:?}: {b}");
        }
    }
}
