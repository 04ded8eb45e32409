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
    Flow, Frame, Plane, Sample,
    fit::{Evidence, FrameObservation, track::Tracker},
    model::{CameraTrack, DepthKind, Distortion, Estimate, NoiseKind, NoiseModel, Space, TrackedCamera},
};
use std::collections::VecDeque;

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
    noises: NoiseAround,
    samples: Samples,
}

impl Following<'_> {
    /// Hands on the models that will not change any more: all of them at a cut, at a change of the noise and at the end (`ends`), else those
    /// whose noise is a mean over frames that are all known.
    fn hand_on(&mut self, ends: bool) -> Result<()> {
        let settles = self.tracker.noise_settles();
        for mean in self.noises.known(settles, ends) {
            let camera = &mut self.cameras[self.handed_on];
            if let Some(mean) = mean {
                camera.camera.noise = Estimate::Known(mean);
            }
            (self.each)(camera)?;
            self.handed_on += 1;
        }
        Ok(())
    }
}

/// The number of frames before and after a frame over which its noise is a mean: as many as the tracker measures noise in.
const NOISE_REACH: usize = 48;

/// The mean of each frame's noise and that of the frames around it, between two cuts or changes of the noise.
///
/// The noise of a shot's first frames is not settled, and counts in no mean: these frames have that of the frames after them.
#[derive(Default)]
struct NoiseAround {
    /// The noises of the last frames as the tracker tells them.
    told: VecDeque<Estimate<NoiseModel>>,
    /// The number of frames before those of `told`.
    forgotten: usize,
    /// The index of the first frame whose noise had settled; `None`: none has so far.
    settled: Option<usize>,
    /// The number of frames whose mean was given.
    given: usize,
}

impl NoiseAround {
    fn push(&mut self, noise: Estimate<NoiseModel>) {
        self.told.push_back(noise);
    }

    /// The means, in the order of the frames, of the frames whose mean was not given so far and will not change any more: all of them if this
    /// is the end (`ends`), after which another stretch of frames begins; none while the noise of the last frame is still to settle
    /// (`settles`). A mean is `None` where the noise is unknown.
    fn known(&mut self, settles: bool, ends: bool) -> Vec<Option<NoiseModel>> {
        let frames = self.forgotten + self.told.len();
        if frames == 0 || (settles && !ends) {
            return vec![];
        }
        let settled = *self.settled.get_or_insert(frames - 1);
        let sure = if ends { frames } else { frames.saturating_sub(NOISE_REACH) };
        let mean = |i: usize| {
            let first = settled.max(i.saturating_sub(NOISE_REACH));
            let last = settled.max(i + NOISE_REACH).min(frames - 1);
            let around = self.told.range(first - self.forgotten..=last - self.forgotten);
            let own = self.told[settled.max(i) - self.forgotten].known()?;
            own.mean_of_kind(around.filter_map(Estimate::known))
        };
        let means = (self.given..sure).map(mean).collect();
        if ends {
            *self = Self::default();
            return means;
        }
        self.given = self.given.max(sure);
        let unneeded = self.given.saturating_sub(NOISE_REACH).saturating_sub(self.forgotten);
        self.told.drain(..unneeded);
        self.forgotten += unneeded;
        means
    }
}

impl Viewer for Following<'_> {
    fn wants_next(&self) -> bool {
        true
    }

    fn view(&mut self, number: u64, observation: &FrameObservation, _: Option<Save>) -> Result<()> {
        if self.tracker.cut_ahead() {
            self.hand_on(true)?;
        }
        let aspect = self.clip.pixel_aspect();
        let camera = tracked(&mut self.tracker, (number, observation), (self.noise_kind, aspect));
        let camera = camera.map_err(|e| of_frame(self.clip, number, e))?;
        if camera.changed.of(Distortion::Noise) {
            // The frames before have another noise, but for the few in which the change was not noticed yet.
            self.hand_on(true)?;
        }
        self.noises.push(camera.camera.noise.clone());
        self.cameras.push(camera);
        self.hand_on(false)?;
        self.samples.keep(self.clip, number, observation, None)
    }
}

/// The model of the frame of this number.
fn tracked(
    tracker: &mut Tracker,
    (frame, observation): (u64, &FrameObservation),
    (noise_kind, pixel_aspect): (NoiseKind, Option<f32>),
) -> blindaug::Result<TrackedCamera> {
    let mut camera = tracker.push(observation)?.clone();
    noise_kind.reduce(&mut camera.noise);
    if let Some(aspect) = pixel_aspect {
        camera = camera.measured_in_pixels_of(aspect);
    }
    Ok(TrackedCamera { frame, changed: tracker.changes(), camera })
}

/// What is given beside a frame that is handed to a [`FrameTracker`].
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Inverse depth (NaN: no reading) and its kind.
    pub depth: Option<(Plane, DepthKind)>,
    /// Optical flow to the next frame, px.
    pub flow: Option<Flow>,
}

/// The estimation of a model for each frame where frames are handed over one after another, instead of being taken from a clip. The models
/// are those of [`track`], except for the noise, which `track` takes from the frames after a frame, too.
pub struct FrameTracker {
    tracker: Tracker,
    noise_kind: NoiseKind,
    pixel_aspect: Option<f32>,
    /// The frame before the one that waits.
    previous: Option<Frame>,
    /// The last frame, whose model needs the next one.
    waiting: Option<(Frame, Beside)>,
}

impl FrameTracker {
    /// A tracker that has seen nothing yet, of frames whose blur acts in this space. `fps` is only copied into the models; `pixel_aspect` is the
    /// width of a pixel over its height, as the picture is shown, if that is known.
    pub fn new(space: Space, noise_kind: NoiseKind, fps: Option<f64>, pixel_aspect: Option<f32>) -> Self {
        Self { tracker: Tracker::new(space, fps), noise_kind, pixel_aspect, previous: None, waiting: None }
    }

    /// Takes the next frame in the order of time, and gives the model of the frame before it; `None` for the first frame. A gap in the
    /// frames' numbers is a gap in time.
    ///
    /// # Errors
    /// If the frame before, or what was given beside it, cannot be used. That frame is then left out.
    pub fn push(&mut self, frame: Frame, beside: Beside) -> blindaug::Result<Option<TrackedCamera>> {
        let camera = self.look(Some(&frame));
        self.waiting = Some((frame, beside));
        camera
    }

    /// The model of the last frame; `None` if there is none that waits. Frames that are pushed later are taken to follow after a gap.
    ///
    /// # Errors
    /// The same as [`FrameTracker::push`].
    pub fn finish(&mut self) -> blindaug::Result<Option<TrackedCamera>> {
        let camera = self.look(None);
        self.previous = None;
        camera
    }

    /// The model of the frame that waits, which `next` follows.
    fn look(&mut self, next: Option<&Frame>) -> blindaug::Result<Option<TrackedCamera>> {
        let Some((frame, beside)) = self.waiting.take() else { return Ok(None) };
        let number = frame.number;
        let observation = FrameObservation {
            frame: &frame.image,
            next: next.filter(|n| number.checked_add(1) == Some(n.number)).map(|n| &n.image),
            previous: self
                .previous
                .as_ref()
                .filter(|p| p.number.checked_add(1) == Some(number))
                .map(|p| &p.image),
            evidence: Evidence {
                flow: beside.flow.as_ref(),
                inverse_depth: beside.depth.as_ref().map(|(depth, kind)| (depth, *kind)),
                ..Evidence::default()
            },
        };
        let shape = (self.noise_kind, self.pixel_aspect);
        let camera = tracked(&mut self.tracker, (number, &observation), shape);
        self.previous = Some(frame);
        camera.map(Some)
    }
}

/// Estimates a model for each frame of a clip, and hands each to `each`, 48 frames late: a frame's noise is the mean over as many frames before
/// and after it, as far as the next cut or change of the noise. The noise of a shot's first 23 pictures counts in no mean.
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
    let samples = Samples::new(clip.len_hint(), keep_samples);
    let (cameras, noises) = (Vec::new(), NoiseAround::default());
    let mut following = Following { clip, tracker, noise_kind, each, cameras, handed_on: 0, noises, samples };
    let seen = show(footage, operators, None, "tracking", &mut following, observer);
    if seen.is_err() {
        // The models of the frames before the bad one are right.
        following.hand_on(true)?;
    }
    let Seen { first, last, stopped, .. } = seen?;
    if let Some(last) = following.cameras.last_mut() {
        last.camera.stopped = stopped;
    }
    following.hand_on(true)?;
    let Following { tracker, cameras, samples, .. } = following;
    if let Some(words) = tracker.copies_in_words() {
        observer.note(&words);
    }
    let track = CameraTrack::from_frames(cameras).map_err(|e| of_clip(clip, e))?;
    Ok(Tracked { track, samples: samples.kept, first, last })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MemoryClip, Silent, footage::Frames};
    use blindaug::model::{Method, NOISE_LEVELS, NoiseLevel, Reason};
    use blindaug::{Encoded, Raster};

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

    /// Noise of one std everywhere.
    fn noise(std: usize) -> Estimate<NoiseModel> {
        let level = NoiseLevel { slope: [0.0; 3], intercept: [std as f32; 3] };
        Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 0.95))
    }

    /// The stds of means; 0 where the noise is unknown.
    fn stds(means: Vec<Option<NoiseModel>>) -> Vec<f32> {
        means.iter().map(|m| m.as_ref().map_or(0.0, |m| m.lines().levels[0].intercept[0])).collect()
    }

    #[test]
    fn means_of_noise_reach_as_far_as_is_known_and_end_with_a_stretch_of_frames() {
        let mut around = NoiseAround::default();
        // No frame at all, as before a cut in the first frame, and one frame.
        assert!(around.known(false, true).is_empty() && around.known(true, true).is_empty());
        around.push(noise(7));
        assert!(around.known(true, false).is_empty());
        assert_eq!(stds(around.known(true, true)), [7.0]);
        // Two hundred frames, whose noise is their number, settle in the frame of index 20.
        let mut found = vec![];
        for i in 0..200 {
            around.push(noise(i));
            let known = around.known(i < 20, false);
            assert_eq!(known.len(), usize::from(i >= NOISE_REACH));
            found.extend(stds(known));
            assert!(around.told.len() <= 2 * NOISE_REACH + 1);
        }
        found.extend(stds(around.known(false, true)));
        assert_eq!(found.len(), 200);
        for (i, found) in found.into_iter().enumerate() {
            let (first, last) = (i.saturating_sub(NOISE_REACH).max(20), (i + NOISE_REACH).min(199));
            assert!((found - 0.5 * (first + last) as f32).abs() < 1e-3, "{i}: {found}");
        }
        // What follows has nothing of that, and ends before its noise has settled.
        (1..4).for_each(|i| around.push(noise(i)));
        assert!(around.known(true, false).is_empty());
        assert_eq!(stds(around.known(true, true)), [3.0; 3]);
    }

    #[test]
    fn means_of_noise_are_of_one_kind_and_unknown_noise_stays_unknown() {
        let unknown = || Estimate::unknown(Reason::Flat, "everything clips");
        let measured = |std| {
            let Estimate::Known(mut model) = noise(std) else { unreachable!() };
            model.lines_mut().method = Method::Temporal;
            model.lines_mut().samples = std as u64;
            Estimate::Known(model)
        };
        let mut around = NoiseAround::default();
        for noise in [measured(2), unknown(), noise(50), measured(4)] {
            around.push(noise);
            assert!(around.known(false, false).is_empty());
        }
        let means = around.known(false, true);
        assert_eq!(means[0].as_ref().unwrap().samples(), 2);
        assert_eq!(stds(means), [3.0, 0.0, 50.0, 3.0]);
        around.push(unknown());
        assert_eq!(around.known(true, true), [None]);
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
        let mut told = vec![];
        for (number, image) in (1..).zip(frames) {
            told.extend(tracker.push(Frame { number, image }, Beside::default()).unwrap());
        }
        told.extend(tracker.finish().unwrap());
        assert!(told.iter().all(|camera| !camera.changed.of(Distortion::Noise)));
        let green = |camera: &TrackedCamera| camera.camera.noise.known().unwrap().total_std(0.5)[1];
        let mean = |frames: std::ops::Range<usize>| {
            let n = frames.len() as f32;
            told[frames].iter().map(green).sum::<f32>() / n
        };
        // The noise has settled in the 24th frame.
        for (t, around) in [(0, 23..49), (30, 23..79), (80, 32..110), (109, 61..110)] {
            let (found, wanted) = (green(&handed_on[t]), mean(around));
            assert!((found / wanted - 1.0).abs() < 0.01, "{t}: {found} for {wanted}");
        }
        assert!(green(&told[109]) > 1.1 * green(&told[23]));
        assert!((green(&handed_on[109]) / green(&told[109]) - 1.0).abs() > 0.01);
    }
}

#[cfg(all(test, feature = "files"))]
mod coded {
    use super::*;
    use crate::Silent;
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
        // Negative control: a gain that changes is noticed, within a second.
        let path = folder.path().join("jump.avi");
        film(&path, VideoCoding::Mjpeg { scale: 2 }, 60, &|t| if t < 30 { 0.5 } else { 1.0 });
        let cameras = tracked(&path);
        let noticed: Vec<usize> = (0..60).filter(|&t| cameras[t].changed.of(Distortion::Noise)).collect();
        let [before, after] = [20, 55].map(|t| over_a_card(&cameras[t].camera));
        assert!(matches!(noticed[..], [30..55]), "{noticed:?}");
        assert!(after > 1.4 * before, "{before} {after}");
    }
}
