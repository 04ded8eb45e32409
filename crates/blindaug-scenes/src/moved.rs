//! Real pixels with a known exposure: a photograph that is moved while the shutter is open, and the frames of a real video averaged.
//!
//! A photograph is moved by whole px, so that no interpolation blurs it, and its views are averaged in light. Frames of a video that are
//! averaged have an exposure that is known but for the video's own.

use crate::camera::in_steps;
use crate::measure::{Value, median};
use blindaug::analysis::{cuts::cut_between, flow::FlowEstimator};
use blindaug::{Encoded, Linear, Raster, Result, Transfer};
use rand::{Rng, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal};
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use std::fmt::Write;

/// How a photograph is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hand {
    /// Speed and direction change by a few percent from one frame to the next.
    Steady,
    /// The speed swings by +-50 % and the direction by +-0.5 radians, each with a period of two to four frames.
    Shaking,
}

/// A swing: its amplitude, its period in frames, and its phase in radians.
#[derive(Clone, Copy, Debug)]
struct Swing {
    amplitude: f32,
    period: f32,
    phase: f32,
}

impl Swing {
    fn at(&self, t: f32) -> f32 {
        self.amplitude * (TAU * t / self.period + self.phase).sin()
    }
}

/// The path of a photograph before the camera, as positions in px at a fixed number of instants a frame.
pub struct Course {
    places: Vec<[f32; 2]>,
}

/// The number of instants in a frame interval at which a course is known.
const INSTANTS: usize = 128;

/// The largest frames that are made, px.
const LARGEST: (usize, usize) = (512, 384);
/// The smallest frames in which the exposure can be measured, px.
const SMALLEST: (usize, usize) = (224, 160);

impl Course {
    /// The course of this seed over a number of frames; the first frame is exposed around the time 0.
    pub fn new(hand: Hand, frames: usize, seed: u64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let mean_speed: f32 = rng.random_range(4.0..11.0);
        let direction: f32 = rng.random_range(0.0..TAU);
        let mut swing = |amplitude: f32, periods: std::ops::Range<f32>| Swing {
            amplitude,
            period: rng.random_range(periods),
            phase: rng.random_range(0.0..TAU),
        };
        let (speed, turn) = match hand {
            Hand::Steady => (swing(0.2, 16.0..30.0), swing(0.3, 16.0..30.0)),
            Hand::Shaking => (swing(0.5, 2.0..4.0), swing(0.5, 2.0..4.0)),
        };
        let step = 1.0 / INSTANTS as f32;
        let mut at = [0.0f32; 2];
        let places = (0..INSTANTS * (frames + 1)).map(|i| {
            let t = (i as f32 + 0.5) * step - 0.5;
            let (s, c) = (direction + turn.at(t)).sin_cos();
            let way = mean_speed * (1.0 + speed.at(t)) * step;
            at = [at[0] + way * c, at[1] + way * s];
            at
        });
        Self { places: places.collect() }
    }

    /// The displacements of the photograph, whole px, at the instants while frame `t` is exposed. The light of the frame is the mean over
    /// them.
    fn views(&self, t: usize, exposure: f32) -> Vec<[i32; 2]> {
        let count = ((exposure * INSTANTS as f32).round() as usize).max(1);
        let middle = t * INSTANTS + INSTANTS / 2;
        self.places[middle - count / 2..][..count].iter().map(|p| p.map(|v| v.round() as i32)).collect()
    }

    /// The least and the largest place in each direction, in whole px.
    fn reach(&self) -> [[i32; 2]; 2] {
        let of = |c: usize| {
            let places = || self.places.iter().map(|p| p[c].round() as i32);
            [places().min().unwrap_or(0), places().max().unwrap_or(0)]
        };
        [of(0), of(1)]
    }
}

/// How frames of a photograph are filmed.
#[derive(Clone, Copy, Debug)]
pub struct Filming {
    /// Exposure fraction, in (0, 1].
    pub exposure: f32,
    /// The number of frames.
    pub frames: usize,
    /// The std of the white noise of encoded values, in [0, 1].
    pub noise: f32,
    /// The seed of the noise.
    pub seed: u64,
}

/// The photograph, halved until it is less than three times as large as the frames. The finest detail of a large photograph is soft from
/// its lens and its coder, which would look like blur.
pub fn reduced(mut photo: Linear) -> Linear {
    while photo.0.width() >= 3 * LARGEST.0 && photo.0.height() >= 3 * LARGEST.1 {
        let of = &photo.0;
        photo = Linear(Raster::from_fn(of.width() / 2, of.height() / 2, |x, y| {
            let at = |i: usize, j: usize| of.at(2 * x + i, 2 * y + j);
            let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
            std::array::from_fn(|k| 0.25 * (a[k] + b[k] + c[k] + d[k]))
        }));
    }
    photo
}

/// Frames of 8 bit of a photograph that moves along a course; `None` if the photograph is too small for the course.
pub fn film(Linear(photo): &Linear, course: &Course, filming: &Filming) -> Option<Vec<Encoded>> {
    let reach = course.reach();
    let side = |c: usize, photo: usize, smallest: usize, largest: usize| {
        let left = photo.checked_sub((reach[c][1] - reach[c][0]) as usize)?;
        (left >= smallest).then_some(left.min(largest))
    };
    let w = side(0, photo.width(), SMALLEST.0, LARGEST.0)?;
    let h = side(1, photo.height(), SMALLEST.1, LARGEST.1)?;
    // The margins of the photograph beyond the course are alike on both sides.
    let corner = |c: usize, photo: usize, side: usize| {
        let spare = photo - side - (reach[c][1] - reach[c][0]) as usize;
        reach[c][1] + (spare / 2) as i32
    };
    let corners = [corner(0, photo.width(), w), corner(1, photo.height(), h)];
    let normal = Normal::new(0.0, filming.noise).ok()?;
    let frame = |t: usize| {
        let mut views = course.views(t, filming.exposure);
        let count = views.len() as f32;
        // Successive instants mostly share a place.
        let mut places: Vec<([usize; 2], f32)> = vec![];
        views.sort_unstable();
        for view in views {
            let from = [0, 1].map(|c| (corners[c] - view[c]) as usize);
            match places.last_mut() {
                Some(last) if last.0 == from => last.1 += 1.0 / count,
                _ => places.push((from, 1.0 / count)),
            }
        }
        let light = Raster::from_fn(w, h, |x, y| {
            let mut sum = [0.0f32; 3];
            for ([x0, y0], weight) in &places {
                let p = photo.at(x0 + x, y0 + y);
                (0..3).for_each(|k| sum[k] += weight * p[k]);
            }
            sum
        });
        let Encoded(mut frame) = Linear(light).to_encoded(Transfer::Srgb);
        let mut rng = StdRng::seed_from_u64(filming.seed.wrapping_mul(1_000_003).wrapping_add(t as u64));
        for p in frame.data_mut() {
            *p = p.map(|v| in_steps(v + normal.sample(&mut rng)));
        }
        Encoded(frame)
    };
    Some((0..filming.frames).map(frame).collect())
}

/// The mean in light of successive frames.
struct Averaged {
    sum: Raster<[f32; 3]>,
    frames: usize,
}

impl Averaged {
    fn new(light: Raster<[f32; 3]>) -> Self {
        Self { sum: light, frames: 1 }
    }

    fn add(&mut self, light: &Raster<[f32; 3]>) {
        for (sum, p) in self.sum.data_mut().iter_mut().zip(light.data()) {
            (0..3).for_each(|k| sum[k] += p[k]);
        }
        self.frames += 1;
    }

    /// The mean as an encoded frame of 8 bit.
    fn frame(&self) -> Encoded {
        let count = self.frames as f32;
        let Encoded(frame) = Linear(self.sum.map(|p| p.map(|v| v / count))).to_encoded(Transfer::Srgb);
        Encoded(frame.map(|p| p.map(in_steps)))
    }
}

/// The pairs (n, N) of averaging: the first n of every N successive frames of a video are averaged.
pub const AVERAGED: [(usize, usize); 8] = [(1, 4), (2, 4), (3, 4), (4, 4), (2, 8), (4, 8), (6, 8), (8, 8)];

/// The fewest and the most averaged frames of a piece of a video.
const FRAMES_OF_FILM: std::ops::RangeInclusive<usize> = 5..=6;

/// The speed, px from one frame of the video to the next, above which averaged frames show ghosts beside each other rather than a streak:
/// copies that are s px apart repeat a streak's spectrum at 1/s cycles per px, and up to 0.35 cycles per px are looked at.
pub const GHOSTS_PX: f32 = 2.8;

/// The number of frames from one of which the speed is measured to the next.
const SPEED_EVERY: usize = 5;

/// The slowest that counts as moving, px from one frame of the video to the next.
const MOVES_PX: f32 = 0.3;

/// Averaged frames of a piece of a video.
pub struct Film {
    /// The number of the first frame of the video.
    pub first: usize,
    /// The number n of frames that each averaged frame is the mean of.
    pub averaged: usize,
    /// The number N of frames of the video from one averaged frame to the next.
    pub of: usize,
    /// The averaged frames.
    pub frames: Vec<Encoded>,
}

/// Averages the successive frames of a video, piece by piece, in all the ways of [`AVERAGED`].
#[derive(Default)]
pub struct FilmMaker {
    given: usize,
    first: usize,
    means: Vec<Vec<Averaged>>,
    last: Option<Encoded>,
    /// The speeds in the current piece, px a frame, each exceeded by a tenth of what moves.
    speeds: Vec<f32>,
    flow: FlowEstimator,
    too_fast: usize,
}

impl FilmMaker {
    /// Takes the next frame of the video. If a piece ends before this frame, its averaged frames are returned; no piece contains a cut.
    ///
    /// # Errors
    /// If the frame has another size than the last one.
    pub fn push(&mut self, frame: &Encoded) -> Result<Vec<Film>> {
        let longest = AVERAGED.iter().map(|a| a.1).max().unwrap_or(1) * FRAMES_OF_FILM.end();
        let frame = reduced(frame.to_linear(Transfer::Srgb)).to_encoded(Transfer::Srgb);
        let cut = self.last.as_ref().map_or(Ok(false), |last| cut_between(last, &frame))?;
        let films = if cut || self.given - self.first == longest { self.finish() } else { vec![] };
        if let Some(last) = &self.last
            && !cut
            && self.given % SPEED_EVERY == 1
        {
            let pair = self.flow.flow_with_occlusion(&last.luma(), &frame.luma())?;
            let known = pair.forward.data().iter().zip(pair.occluded.data()).filter(|(_, hidden)| !**hidden);
            let mut moving: Vec<f32> =
                known.map(|([u, v], _)| u.hypot(*v)).filter(|s| *s > MOVES_PX).collect();
            moving.sort_by(f32::total_cmp);
            self.speeds.extend(moving.get(moving.len() * 9 / 10));
        }
        self.means.resize_with(AVERAGED.len(), Vec::new);
        let at = self.given - self.first;
        let light = frame.to_linear(Transfer::Srgb).0;
        for ((n, of), means) in AVERAGED.iter().zip(&mut self.means) {
            match means.last_mut() {
                _ if at / of >= *FRAMES_OF_FILM.end() || at % of >= *n => {}
                Some(mean) if !at.is_multiple_of(*of) => mean.add(&light),
                _ => means.push(Averaged::new(light.clone())),
            }
        }
        self.given += 1;
        self.last = Some(frame);
        Ok(films)
    }

    /// The number of pieces that were left out, since what moves in them is too fast ([`GHOSTS_PX`]).
    pub fn too_fast(&self) -> usize {
        self.too_fast
    }

    /// The averaged frames of the current piece, none if what moves in it is too fast ([`GHOSTS_PX`]); a new piece begins.
    pub fn finish(&mut self) -> Vec<Film> {
        let first = std::mem::replace(&mut self.first, self.given);
        // In a quarter of a piece the flow may be wrong, or something may pass by.
        let mut speeds = std::mem::take(&mut self.speeds);
        speeds.sort_by(f32::total_cmp);
        if speeds.get(speeds.len() * 3 / 4).is_some_and(|speed| *speed > GHOSTS_PX) {
            self.means.clear();
            self.too_fast += 1;
            return vec![];
        }
        let films = AVERAGED.iter().zip(std::mem::take(&mut self.means)).map(|(&(averaged, of), means)| {
            let whole = means.iter().filter(|m| m.frames == averaged);
            Film { first, averaged, of, frames: whole.map(Averaged::frame).collect() }
        });
        films.filter(|f| FRAMES_OF_FILM.contains(&f.frames.len())).collect()
    }
}

/// The exposure fractions that n of every N frames may have, averaged: those frames were exposed for an unknown share of their interval.
pub fn of_averaged(averaged: usize, of: usize) -> [f32; 2] {
    [averaged - 1, averaged].map(|n| n as f32 / of as f32)
}

/// An estimated exposure beside the true one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The name of the case.
    pub name: String,
    /// The group of cases that share a line of the table.
    pub group: String,
    /// The least and the largest exposure fraction that it may truly have.
    pub truth: [f32; 2],
    /// The estimate, if there is one.
    pub exposure: Option<Value>,
    /// The exposure fraction by each frame alone; of a tracked one, as of each frame in which it is known.
    pub per_frame: Vec<f32>,
    /// The reason why the exposure is unknown, if it is.
    pub unknown: Option<String>,
}

impl Found {
    /// How far the estimate lies from the nearest exposure fraction that may be true.
    pub fn error(&self) -> Option<f32> {
        let [low, high] = self.truth;
        self.exposure.map(|v| (v.estimate - v.estimate.clamp(low, high)).abs())
    }

    /// Whether the interval holds an exposure fraction that may be true.
    pub fn covered(&self) -> Option<bool> {
        let [low, high] = self.truth;
        self.exposure.map(|v| v.interval[0] - 1e-4 <= high && low <= v.interval[1] + 1e-4)
    }
}

/// A table of errors and coverage in Markdown with a line for each group, in the order of the first case of each group.
pub fn table(all: &[Found]) -> String {
    let mut groups: Vec<&str> = vec![];
    for found in all {
        if !groups.contains(&found.group.as_str()) {
            groups.push(&found.group);
        }
    }
    let mut text = String::from(
        "| frames | cases | lambda: mean error | median | worst | covered | unknown | mean width of the interval |\n|---|---|---|---|---|---|---|---|\n",
    );
    for group in groups {
        let of: Vec<&Found> = all.iter().filter(|f| f.group == group).collect();
        let errors: Vec<f32> = of.iter().filter_map(|f| f.error()).collect();
        let known = errors.len();
        let mean = |v: &mut dyn Iterator<Item = f32>| {
            if known == 0 { "-".into() } else { format!("{:.3}", v.sum::<f32>() / known as f32) }
        };
        let width =
            mean(&mut of.iter().filter_map(|f| Some(f.exposure?.interval[1] - f.exposure?.interval[0])));
        let middle = median(errors.clone()).map_or("-".into(), |v| format!("{v:.3}"));
        let worst = of.iter().max_by(|a, b| a.error().unwrap_or(-1.0).total_cmp(&b.error().unwrap_or(-1.0)));
        let worst = worst.and_then(|f| f.error()).map_or("-".into(), |v| format!("{v:.3}"));
        let covered = of.iter().filter(|f| f.covered() == Some(true)).count();
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {group} | {} | {} | {middle} | {worst} | {covered}/{known} | {} | {width} |",
            of.len(),
            mean(&mut errors.iter().copied()),
            of.len() - known,
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Exposure, Scene};
    use blindaug::fit::{Estimator, EstimatorOptions, FrameObservation};

    /// A photograph of one bright point.
    fn point() -> Linear {
        Linear(Raster::from_fn(700, 600, |x, y| [if (x, y) == (350, 300) { 1.0 } else { 0.0 }; 3]))
    }

    #[test]
    fn a_streak_is_as_long_as_the_way_while_the_shutter_is_open() {
        for hand in [Hand::Steady, Hand::Shaking] {
            for exposure in [0.25f32, 1.0] {
                let course = Course::new(hand, 4, 7);
                let filming = Filming { exposure, frames: 4, noise: 0.0, seed: 0 };
                let frames = film(&point(), &course, &filming).expect("it is large enough");
                for (t, frame) in frames.iter().enumerate() {
                    let half = 0.5 * exposure * INSTANTS as f32;
                    let middle = t * INSTANTS + INSTANTS / 2;
                    let ends = [-half, half]
                        .map(|d| course.places[(middle as f32 + d).max(0.0) as usize - usize::from(d > 0.0)]);
                    let lit = frame.0.data().iter().enumerate().filter(|(_, p)| p[1] > 0.0);
                    let places: Vec<[f32; 2]> = lit
                        .map(|(i, _)| [(i % frame.0.width()) as f32, (i / frame.0.width()) as f32])
                        .collect();
                    let longest = places
                        .iter()
                        .flat_map(|a| places.iter().map(|b| (a[0] - b[0]).hypot(a[1] - b[1])))
                        .fold(0.0, f32::max);
                    let chord = (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]);
                    assert!((longest - chord).abs() < 1.8, "{hand:?} {exposure} {t}: {longest} {chord}");
                }
            }
        }
    }

    #[test]
    fn only_a_shaking_hand_changes_its_speed_from_frame_to_frame() {
        let largest_change = |hand: Hand| {
            let changes = (0..20).map(|seed| {
                let course = Course::new(hand, 6, seed);
                let way = |t: usize| {
                    let (a, b) = (course.places[t * INSTANTS], course.places[(t + 1) * INSTANTS - 1]);
                    (b[0] - a[0]).hypot(b[1] - a[1])
                };
                (1..6).map(|t| (way(t) / way(t - 1) - 1.0).abs()).fold(0.0, f32::max)
            });
            changes.sum::<f32>() / 20.0
        };
        let (steady, shaking) = (largest_change(Hand::Steady), largest_change(Hand::Shaking));
        assert!(steady < 0.12 && shaking > 0.3, "{steady} {shaking}");
    }

    /// The exposure of a photograph that is moved by a hand, blind.
    fn estimated(hand: Hand, exposure: f32) -> Value {
        let photo = Scene::new(3, (640, 512)).picture(0.0, Exposure::default(), 0);
        let filming = Filming { exposure, frames: 6, noise: 0.006, seed: 5 };
        let frames = film(&photo, &Course::new(hand, 6, 5), &filming).expect("it is large enough");
        let mut estimator = Estimator::new(EstimatorOptions::default());
        for observation in FrameObservation::of_frames(&frames) {
            estimator.add(&observation).unwrap();
        }
        let model = estimator.estimate().unwrap().model.motion_blur;
        let model = model.known().expect("it moves, and has texture");
        Value { estimate: model.exposure.0, interval: model.interval }
    }

    #[test]
    fn a_shaking_hand_leaves_the_exposure_less_sure_but_covered() {
        let width = |v: &Value| v.interval[1] - v.interval[0];
        // Streaks of about 4 px, whose zeros are seen: the texture could imitate shorter ones, so that they are unsure without shaking, too.
        const TRUTH: f32 = 0.8;
        let [steady, shaking] = [Hand::Steady, Hand::Shaking].map(|hand| estimated(hand, TRUTH));
        assert!(steady.covers(TRUTH) && shaking.covers(TRUTH), "{steady:?} {shaking:?}");
        assert!((steady.estimate - TRUTH).abs() < 0.04 && width(&steady) < 0.2, "{steady:?}");
        assert!(width(&shaking) > 1.5 * width(&steady), "{steady:?} {shaking:?}");
    }

    #[test]
    fn small_photographs_make_no_frames() {
        let course = Course::new(Hand::Steady, 4, 7);
        let filming = Filming { exposure: 0.5, frames: 4, noise: 0.0, seed: 0 };
        let frames = |w: usize, h: usize| film(&Linear(Raster::filled(w, h, [0.5; 3])), &course, &filming);
        assert!(frames(200, 600).is_none() && frames(600, 150).is_none() && frames(600, 600).is_some());
    }

    #[test]
    fn averaged_frames_are_the_mean_of_light_and_none_lies_over_a_cut() {
        let frame = |i: usize| {
            Encoded(Raster::from_fn(64, 48, |x, y| match (i < 30, i % 2) {
                // Two shots: bars, and a checkerboard, that flicker.
                (true, flicker) => [if x / 8 % 2 == 0 { 1.0 } else { 0.2 * flicker as f32 }; 3],
                (false, flicker) => {
                    [if (x / 8 + y / 8) % 2 == 0 { 0.1 } else { 0.7 + 0.1 * flicker as f32 }; 3]
                }
            }))
        };
        let mut maker = FilmMaker::default();
        let mut films = vec![];
        for i in 0..60 {
            films.extend(maker.push(&frame(i)).unwrap());
        }
        films.extend(maker.finish());
        let of = |n: usize, of: usize| films.iter().filter(move |f| (f.averaged, f.of) == (n, of));
        assert_eq!(of(2, 4).map(|f| (f.first, f.frames.len())).collect::<Vec<_>>(), [(0, 6), (30, 6)]);
        // Eight times five frames are more than a shot has.
        assert_eq!(of(8, 8).count(), 0);
        // The mean of 0 and 0.2 in light, as a value that is encoded; that of the values would be 0.1.
        let mean = of(2, 4).next().expect("the first shot").frames[0].0.at(9, 9)[0];
        let light = 0.5 * Transfer::Srgb.decode(0.2);
        assert!((mean - Transfer::Srgb.encode(light)).abs() < 0.003 && (mean - 0.1).abs() > 0.02, "{mean}");
        let single = of(1, 4).next().expect("the first shot").frames[0].0.at(9, 9)[0];
        assert!(single.abs() < 0.003, "{single}");
    }

    #[test]
    fn a_video_that_would_make_ghosts_is_left_out() {
        let films = |px_a_frame: usize| {
            let mut maker = FilmMaker::default();
            for t in 0..24 {
                let texture = |x: usize, y: usize| {
                    let (x, y) = ((x + px_a_frame * t) as f32, y as f32);
                    0.5 + 0.2 * (0.3 * x + 0.1 * y).sin() + 0.2 * (0.11 * x - 0.25 * y).cos()
                };
                let frame = Encoded(Raster::from_fn(160, 120, |x, y| [texture(x, y); 3]));
                assert!(maker.push(&frame).unwrap().is_empty());
            }
            (maker.finish().len(), maker.too_fast())
        };
        // Of eight ways of averaging, four have at least five frames.
        assert_eq!([1, 5].map(films), [(4, 0), (0, 1)]);
    }

    #[test]
    fn the_table_tells_what_is_covered_and_what_is_not() {
        let found = |estimate: f32, half: f32| Found {
            name: String::new(),
            group: "a".into(),
            truth: of_averaged(2, 4),
            exposure: Some(Value { estimate, interval: [estimate - half, estimate + half] }),
            per_frame: vec![],
            unknown: None,
        };
        let near = |v: Option<f32>, to: f32| (v.expect("it is known") - to).abs() < 1e-5;
        assert!(near(found(0.4, 0.1).error(), 0.0) && near(found(0.7, 0.1).error(), 0.2));
        assert_eq!([0.1, 0.3].map(|half| found(0.7, half).covered()), [Some(false), Some(true)]);
        let unknown = Found { exposure: None, unknown: Some("why".into()), ..found(0.0, 0.0) };
        let text = table(&[found(0.4, 0.1), found(0.7, 0.1), found(0.6, 0.1), unknown]);
        assert!(text.ends_with("| a | 4 | 0.100 | 0.100 | 0.200 | 2/3 | 1 | 0.200 |\n"), "{text}");
    }
}
