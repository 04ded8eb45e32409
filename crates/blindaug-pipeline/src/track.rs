//! The estimation of a camera model for each frame of a clip.

use crate::{
    Result,
    estimate::{Samples, check_memory, of_clip, of_frame},
    footage::{Clip, Footage},
    observer::Observer,
    operators::{EvidenceSink, Operators},
    window::{Seen, Viewer, show},
};
use blindaug::{
    Sample,
    fit::{FrameObservation, track::Tracker},
    model::{CameraTrack, Distortion, NoiseKind, Space, TrackedCamera},
};

/// The options of tracking a clip.
#[derive(Default)]
pub struct Job<'a> {
    /// The values that blur acts on: light or encoded values.
    pub space: Space,
    /// The kind of noise model.
    pub noise_kind: NoiseKind,
    /// Frames per second; `None`: the clip's.
    pub fps: Option<f64>,
    /// Whether a few frames are kept for a report.
    pub keep_samples: bool,
    /// The operators, such as networks that find flow or depth, that process frames before the tracker.
    pub operators: Option<&'a mut dyn Operators>,
}

/// A tracked camera and the frames that it rests on.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// The models. The last one says if the observer stopped the job before the end of the clip.
    pub track: CameraTrack,
    /// A few frames for a report, if they were asked for.
    pub samples: Vec<Sample>,
    /// The first frame's number.
    pub first: u64,
    /// The last frame's number.
    pub last: u64,
}

/// Estimates a model for each frame.
struct Following<'a> {
    clip: &'a dyn Clip,
    tracker: Tracker,
    noise_kind: NoiseKind,
    each: &'a mut dyn FnMut(&TrackedCamera) -> Result<()>,
    /// The models so far.
    cameras: Vec<TrackedCamera>,
    /// The number of models that were handed on.
    handed_on: usize,
    /// The number of models of earlier shots.
    shot: usize,
    samples: Samples<'a>,
}

impl Following<'_> {
    /// Hands on the models that will not change any more: all of them at the end of a shot (`ends`), else all but the last one, once the
    /// noise is settled. The first frames of a shot get the noise that has settled.
    fn hand_on(&mut self, ends: bool) -> Result<()> {
        if !ends && self.tracker.noise_settles() {
            return Ok(());
        }
        if let (true, Some(last)) = (self.handed_on == self.shot, self.cameras.last()) {
            let noise = last.camera.noise.clone();
            if noise.known().is_some() {
                self.cameras[self.shot..].iter_mut().for_each(|c| c.camera.noise = noise.clone());
            }
        }
        let sure = self.cameras.len() - usize::from(!ends);
        for camera in &self.cameras[self.handed_on.min(sure)..sure] {
            (self.each)(camera)?;
        }
        self.handed_on = self.handed_on.max(sure);
        Ok(())
    }
}

impl Viewer for Following<'_> {
    fn wants_next(&self) -> bool {
        true
    }

    fn view(
        &mut self,
        number: u64,
        observation: &FrameObservation,
        _: Option<&mut dyn EvidenceSink>,
    ) -> Result<()> {
        if self.tracker.cut_ahead() {
            self.hand_on(true)?;
            self.shot = self.cameras.len();
        }
        let mut camera = self.tracker.push(observation).map_err(|e| of_frame(self.clip, number, e))?.clone();
        self.noise_kind.reduce(&mut camera.noise);
        if let Some(aspect) = self.clip.pixel_aspect() {
            camera = camera.measured_in_pixels_of(aspect);
        }
        if self.tracker.changes().of(Distortion::Noise) && self.handed_on == self.shot {
            // What came before the change has another noise.
            self.hand_on(true)?;
            self.shot = self.cameras.len();
        }
        self.cameras.push(TrackedCamera { frame: number, changed: self.tracker.changes(), camera });
        self.hand_on(false)?;
        self.samples.keep(number, observation, None)
    }
}

/// Estimates a model for each frame of a clip, and hands each to `each`: those of the first frames of a shot once its noise has settled,
/// the others one frame late.
///
/// # Errors
/// If a frame or its accompanying data cannot be used, memory does not suffice, or `each` fails.
pub fn track(
    footage: &Footage,
    job: Job,
    observer: &dyn Observer,
    each: &mut dyn FnMut(&TrackedCamera) -> Result<()>,
) -> Result<Tracked> {
    let Job { space, noise_kind, fps, keep_samples, operators } = job;
    let clip = &*footage.clip;
    let reach = operators.as_ref().map_or(0, |o| o.reach());
    check_memory(footage, reach, keep_samples, Tracker::bytes(clip.size()))?;
    let tracker = Tracker::new(space, fps.or(clip.fps()));
    let samples = Samples::new(clip, keep_samples);
    let cameras = Vec::new();
    let mut following =
        Following { clip, tracker, noise_kind, each, cameras, handed_on: 0, shot: 0, samples };
    let Seen { first, last, stopped, .. } =
        show(footage, operators, None, "tracking", &mut following, observer)?;
    if let Some(last) = following.cameras.last_mut() {
        last.camera.stopped = stopped;
    }
    following.hand_on(true)?;
    let Following { cameras, samples, .. } = following;
    let track = CameraTrack::from_frames(cameras).map_err(|e| of_clip(clip, e))?;
    Ok(Tracked { track, samples: samples.kept, first, last })
}

#[cfg(all(test, feature = "files"))]
mod tests {
    use super::*;
    use crate::{Silent, estimate};
    use blindaug::{Encoded, Raster, filter, luma, model::CameraModel, model::total_of_levels};
    use blindaug_io::{FrameRange, FrameSource, VideoCoding, VideoWriter};
    use rand::{Rng, SeedableRng, rngs::StdRng};
    use std::path::Path;

    const SIZE: (usize, usize) = (256, 192);

    /// Writes a camera's pan past a wall of soft texture, its noise `gain` times a std of 6 of 255.
    fn film(path: &Path, coding: VideoCoding, frames: usize, gain: &dyn Fn(usize) -> f32) {
        let mut rng = StdRng::seed_from_u64(5);
        let mut normal = move || (0..6).map(|_| rng.random::<f32>() - 0.5).sum::<f32>() * 1.41;
        let (w, h) = (SIZE.0 + 3 * frames, SIZE.1);
        let white = Raster::from_vec(w, h, (0..w * h).map(|_| normal()).collect()).unwrap();
        let [fine, soft] = [1.2, 9.0].map(|s| filter::gaussian_blur(&white, s));
        let mut writer = VideoWriter::create_coded(path, SIZE, 30.0, coding).unwrap();
        for t in 0..frames {
            let mut frame = Raster::filled(SIZE.0, SIZE.1, [0.0f32; 3]);
            for y in 0..SIZE.1 {
                for x in 0..SIZE.0 {
                    let at = x + 3 * t;
                    let contrast = if (at / 64 + y / 64).is_multiple_of(2) { 0.25 } else { 0.02 };
                    let wall = 0.45 + 2.0 * soft.at(at, y) + contrast * fine.at(at, y);
                    frame.row_mut(y)[x] =
                        std::array::from_fn(|_| (wall + gain(t) * 6.0 / 255.0 * normal()).clamp(0.0, 1.0));
                }
            }
            writer.write(&Encoded(frame)).unwrap();
        }
        writer.finish().unwrap();
    }

    /// The std of the noise over a grey card, of 255.
    fn over_a_card(model: &CameraModel) -> f32 {
        let noise = model.noise.known().expect("all can be followed");
        255.0 * luma(total_of_levels(&std::array::from_fn(|l| noise.std_over(l, [0.45; 3]))))
    }

    /// The first 60 frames alone, since a coder saves bits at a clip's end.
    fn footage(path: &Path) -> Footage {
        Footage::new(FrameSource::open(path, FrameRange { first: None, last: Some(60) }).unwrap())
    }

    fn tracked(path: &Path) -> Vec<TrackedCamera> {
        let footage = footage(path);
        let mut cameras = vec![];
        track(&footage, Job::default(), &Silent, &mut |c| {
            cameras.push(c.clone());
            Ok(())
        })
        .unwrap();
        cameras
    }

    #[test]
    fn a_coder_s_kinds_of_frames_are_no_change_of_the_noise() {
        if !VideoWriter::is_available() {
            eprintln!("SKIPPED: no ffmpeg program, so nothing goes through a video coder");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        for (name, coding) in
            [("18.mp4", VideoCoding::H264 { crf: 18 }), ("24.mp4", VideoCoding::H264 { crf: 24 })]
        {
            let path = folder.path().join(name);
            film(&path, coding, 75, &|_| 1.0);
            let whole = estimate::estimate(&footage(&path), estimate::Job::default(), &Silent).unwrap();
            let whole = over_a_card(&whole.estimation.model);
            let cameras = tracked(&path);
            assert_eq!(cameras.len(), 60);
            let told: Vec<f32> = cameras.iter().map(|c| over_a_card(&c.camera)).collect();
            let noticed = cameras.iter().filter(|c| c.changed.of(Distortion::Noise)).count();
            println!("{name}: {whole:.2} of the whole clip, {noticed} changes, {told:.2?}");
            assert_eq!(noticed, 0);
            let mut sorted = told.clone();
            sorted.sort_by(f32::total_cmp);
            let usual = sorted[told.len() / 2];
            // What is less than a quarter of a step of 8 bits cannot be seen.
            let off = |t: &f32| t.max(0.25) / usual.max(0.25) - 1.0;
            assert!(told.iter().all(|t| off(t).abs() < 0.15), "{usual} {told:?}");
        }
        // Negative control: a gain that changes is noticed, within a second.
        let path = folder.path().join("jump.avi");
        film(&path, VideoCoding::Mjpeg { scale: 2 }, 60, &|t| if t < 30 { 0.5 } else { 1.0 });
        let cameras = tracked(&path);
        let noticed: Vec<usize> = (0..60).filter(|&t| cameras[t].changed.of(Distortion::Noise)).collect();
        let [before, after] = [20, 55].map(|t| over_a_card(&cameras[t].camera));
        println!("jump: {noticed:?}, {before:.2} {after:.2}");
        assert!(matches!(noticed[..], [30..55]), "{noticed:?}");
        assert!(after > 1.4 * before, "{before} {after}");
    }
}
