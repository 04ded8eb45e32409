//! The estimation of a camera model for each frame of a clip.

use crate::{
    Result,
    estimate::{Samples, check_memory, of_clip, of_frame},
    footage::{Clip, Footage},
    observer::Observer,
    operators::Operators,
    window::{Save, Seen, Viewer, show},
};
use blindaug::{
    Sample,
    fit::{FrameObservation, track::Tracker},
    model::{CameraTrack, NoiseKind, Space, TrackedCamera},
};
use models::{ClipModels, Models};

mod frames;
mod models;
mod noise_around;

pub use frames::{Beside, ClipTracker, FrameTracker};

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

/// Estimates a model for each frame of a clip that is shown.
struct Following<'a> {
    clip: &'a dyn Clip,
    models: ClipModels,
    each: &'a mut dyn FnMut(&TrackedCamera) -> Result<()>,
    /// The models that were handed on.
    cameras: Vec<TrackedCamera>,
    /// Whether `each` failed: it then gets no more models.
    refused: bool,
    samples: Samples,
}

impl Following<'_> {
    /// Hands on the models that will not change any more.
    fn hand_on(&mut self) -> Result<()> {
        while let Some(camera) = self.models.take().filter(|_| !self.refused) {
            let taken = (self.each)(&camera);
            self.refused = taken.is_err();
            taken?;
            self.cameras.push(camera);
        }
        Ok(())
    }
}

impl Viewer for Following<'_> {
    fn wants_next(&self) -> bool {
        true
    }

    fn view(&mut self, number: u64, observation: &FrameObservation, _: Option<Save>) -> Result<()> {
        let found = self.models.push(number, observation);
        self.hand_on()?;
        found.map_err(|e| of_frame(self.clip, number, e))?;
        self.samples.keep(self.clip, number, observation, None)
    }
}

/// Estimates a model for each frame of a clip, and hands each to `each`, up to 624 frames late: a frame's noise is the mean over 48 frames
/// before and after it, and over up to 480 more where it is the same within its intervals, as far as the next cut or change of the noise. The
/// noise of the first 23 pictures of a shot, or since a change, counts in no mean; where copies delay these, models come later. A change of
/// the noise is that of the frame in which it was, not of the one in which it is noticed, and stands only if the noise differs by a fifth.
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
    let models = ClipModels::new(Models { tracker, noise_kind, pixel_aspect: clip.pixel_aspect() });
    let samples = Samples::new(clip.len_hint(), keep_samples);
    let mut following = Following { clip, models, each, cameras: Vec::new(), refused: false, samples };
    let seen = show(footage, operators, None, "tracking", &mut following, observer);
    if let Ok(seen) = &seen
        && let Some(last) = following.models.last_mut()
    {
        last.camera.stopped = seen.stopped;
    }
    // The models of the frames before a bad one are right.
    following.models.end();
    following.hand_on()?;
    let Seen { first, last, .. } = seen?;
    let Following { models, cameras, samples, .. } = following;
    if let Some(words) = models.copies_in_words() {
        observer.note(&words);
    }
    let track = CameraTrack::from_frames(cameras).map_err(|e| of_clip(clip, e))?;
    Ok(Tracked { track, samples: samples.kept, first, last })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MemoryClip, Silent, footage::Frames};
    use blindaug::{Encoded, Frame, Raster, model::Distortion};

    /// A moving texture with noise.
    fn frame(t: usize) -> Encoded {
        let hash = |x: usize, y: usize, t: usize| {
            let mut h = (x as u32) ^ ((y as u32) << 12) ^ ((t as u32) << 24);
            (0..3).for_each(|_| h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d));
            (h >> 16) as f32 / 65536.0 - 0.5
        };
        let texture =
            |x: usize, y: usize| 0.5 + 0.3 * hash((x + 2 * t) / 4, y / 4, 0) + 0.03 * hash(x, y, t + 1);
        Encoded(Raster::from_fn(160, 128, |x, y| [texture(x, y); 3]))
    }

    #[test]
    fn frames_that_are_pushed_give_the_models_of_a_clip() {
        let frames: Vec<Encoded> = (0..5).map(frame).collect();
        let footage = Footage::new(MemoryClip { frames: frames.clone(), fps: Some(25.0) });
        let wanted = track(&footage, Job::default(), &Silent, &mut |_| Ok(())).unwrap().track;
        let pushed = |number: &dyn Fn(u64) -> u64| {
            let mut tracker = FrameTracker::new(Space::default(), NoiseKind::default(), Some(25.0), None);
            let mut cameras = vec![];
            for (i, image) in (1..).zip(&frames) {
                let frame = Frame { number: number(i), image: image.clone() };
                cameras.extend(tracker.push(frame, Beside::default()).unwrap());
                assert_eq!(cameras.len() as u64, i - 1);
            }
            cameras.extend(tracker.finish().unwrap());
            assert_eq!(tracker.finish().unwrap(), None);
            CameraTrack::from_frames(cameras).unwrap()
        };
        // The noise of these few frames has not settled; that of the last one is all frames' in the end.
        let found = pushed(&|i| i);
        let last = found.frames()[4].camera.noise.clone();
        let settled = found.map(|mut camera| {
            camera.noise = last.clone();
            camera
        });
        assert_eq!(settled, wanted);
        assert!(wanted.frames()[4].camera.noise.known().is_some());
        // Negative control: with gaps between them, the frames show no motion, and their noise is not told.
        assert_ne!(pushed(&|i| 2 * i).frames()[4].camera.noise, wanted.frames()[4].camera.noise);
    }

    #[test]
    fn a_frame_that_cannot_be_read_does_not_take_the_models_before_it_along() {
        /// A clip whose last frame is damaged.
        struct Damaged(MemoryClip);
        impl Clip for Damaged {
            fn name(&self) -> String {
                "damaged".into()
            }
            fn size(&self) -> (usize, usize) {
                self.0.size()
            }
            fn fps(&self) -> Option<f64> {
                None
            }
            fn len_hint(&self) -> Option<usize> {
                None
            }
            fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
                let error = blindaug::Error::new("its last frame is damaged");
                let bad = crate::Error::Clip { clip: self.name(), error };
                Box::new(self.0.frames_if(wanted).chain(std::iter::once(Err(bad))))
            }
        }
        let footage = Footage::new(Damaged(MemoryClip { frames: (0..5).map(frame).collect(), fps: None }));
        let mut handed_on = 0;
        let failed = track(&footage, Job::default(), &Silent, &mut |_| {
            handed_on += 1;
            Ok(())
        });
        assert!(failed.unwrap_err().to_string().contains("damaged"));
        // The fifth frame waits for its neighbour.
        assert_eq!(handed_on, 4);
    }

    #[test]
    fn a_change_of_the_noise_is_told_where_it_was_also_among_copies() {
        const PICTURES: usize = 60;
        for copies in [1, 2] {
            // From the middle on, all contrast grows, that of the noise too.
            let picture = |t: usize| {
                let grown = if t < PICTURES / 2 { 1.0 } else { 1.8 };
                Encoded(frame(t).0.map(|[v, ..]| [0.5 + grown * (v - 0.5); 3]))
            };
            let frames = (0..copies * PICTURES).map(|t| picture(t / copies)).collect();
            let footage = Footage::new(MemoryClip { frames, fps: None });
            let found = track(&footage, Job::default(), &Silent, &mut |_| Ok(())).unwrap().track;
            let told: Vec<u64> =
                found.frames().iter().filter(|c| c.changed.of(Distortion::Noise)).map(|c| c.frame).collect();
            let first = (copies * PICTURES / 2) as u64 + 1;
            assert!(matches!(told[..], [frame] if frame.abs_diff(first) <= 2 * copies as u64), "{told:?}");
        }
    }

    #[test]
    fn a_frame_s_noise_is_a_mean_over_the_frames_around_it() {
        const FRAMES: usize = 110;
        // Noise that grows slowly is no change that is told.
        let frames: Vec<Encoded> = (0..FRAMES)
            .map(|t| {
                let grown = 1.0 + 0.004 * t as f32;
                Encoded(frame(t).0.map(|[v, ..]| [0.5 + grown * (v - 0.5); 3]))
            })
            .collect();
        let mut handed_on = vec![];
        let footage = Footage::new(MemoryClip { frames: frames.clone(), fps: None });
        let found = track(&footage, Job::default(), &Silent, &mut |camera| {
            handed_on.push(camera.clone());
            Ok(())
        });
        assert_eq!(handed_on, found.unwrap().track.frames());
        let mut tracker = FrameTracker::new(Space::default(), NoiseKind::default(), None, None);
        let mut of_clip = ClipTracker::new(Space::default(), NoiseKind::default(), None, None);
        let (mut told, mut means) = (vec![], vec![]);
        for (number, image) in (1..).zip(frames) {
            let frame = Frame { number, image };
            told.extend(tracker.push(frame.clone(), Beside::default()).unwrap());
            of_clip.push(frame, Beside::default()).unwrap();
            means.extend(std::iter::from_fn(|| of_clip.take()));
            // All wait for the frames around them.
            assert!(means.is_empty());
        }
        told.extend(tracker.finish().unwrap());
        of_clip.finish().unwrap();
        means.extend(std::iter::from_fn(|| of_clip.take()));
        assert_eq!(means, handed_on);
        assert!(told.iter().all(|camera| !camera.changed.of(Distortion::Noise)));
        let green = |camera: &TrackedCamera| camera.camera.noise.known().unwrap().total_std(0.5)[1];
        let steps = |cameras: &[TrackedCamera]| {
            let step = |pair: &[TrackedCamera]| (green(&pair[1]) / green(&pair[0]) - 1.0).abs();
            cameras[23..].windows(2).map(step).fold(0.0, f32::max)
        };
        // The noise has settled in the 24th frame, and grows from there. Its means lie between, and do not flicker.
        let [first, last] = [23, 109].map(|i| green(&told[i]));
        assert!(last > 1.1 * first);
        assert!(handed_on.iter().all(|camera| (first..last).contains(&green(camera))));
        assert!(steps(&handed_on) < 0.5 * steps(&told), "{} {}", steps(&handed_on), steps(&told));
    }
}

#[cfg(all(test, feature = "files"))]
mod coded {
    use super::*;
    use crate::Silent;
    use blindaug::{
        Encoded, Raster, filter, luma,
        model::{CameraModel, Distortion},
    };
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
        255.0 * luma(noise.total_std_over([0.45; 3]))
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
        let path = folder.path().join("18.mp4");
        film(&path, VideoCoding::H264 { crf: 18 }, 75, &|_| 1.0);
        let cameras = tracked(&path);
        assert_eq!(cameras.len(), 60);
        let told: Vec<f32> = cameras.iter().map(|c| over_a_card(&c.camera)).collect();
        let noticed = cameras.iter().filter(|c| c.changed.of(Distortion::Noise)).count();
        assert_eq!(noticed, 0);
        let mut sorted = told.clone();
        sorted.sort_by(f32::total_cmp);
        let usual = sorted[told.len() / 2];
        assert!(told.iter().all(|t| (t / usual - 1.0).abs() < 0.15), "{usual} {told:?}");
        // Negative control: a gain that changes is noticed.
        let path = folder.path().join("jump.avi");
        film(&path, VideoCoding::Mjpeg { scale: 2 }, 60, &|t| if t < 30 { 0.5 } else { 1.0 });
        let cameras = tracked(&path);
        let noticed: Vec<usize> = (0..60).filter(|&t| cameras[t].changed.of(Distortion::Noise)).collect();
        let [before, soon, after] = [20, 34, 55].map(|t| over_a_card(&cameras[t].camera));
        // It is noticed late, but told from the frame on in which it was.
        assert!(matches!(noticed[..], [28..=32]), "{noticed:?}");
        assert!((soon / after - 1.0).abs() < 0.15, "{soon} {after}");
        assert!(after > 1.4 * before, "{before} {after}");
    }
}
