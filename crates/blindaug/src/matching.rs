//! Footage of one camera made to look like that of another: what the first lacks in blur and noise is added.
//!
//! Variances add, so what is missing of each is a difference of variances: of defocus at each depth, of the streaks of motion blur, and of
//! the noise in each octave, channel and colour. Nothing is ever taken away: where the other camera blurs less or has less noise, the
//! footage stays as it is. The blur that is added weakens the noise that is there, which is allowed for. Sharpening is left out.

use crate::model::{CameraModel, NOISE_LEVELS, NoiseModel, Space};
use crate::synth::{Blur, defocus::Bokeh, noise};
use crate::{Encoded, Error, Flow, Plane, Raster, Result, filter};
use std::{f32::consts::PI, sync::OnceLock};

/// The square of the length, px, of the streak that blurs as much as linear interpolation at random places between pixels: 12 times its
/// variance of 1/6 px^2.
const OF_TAPS: f32 = 2.0;

/// What footage of one camera lacks to look like that of another.
pub struct Matching {
    blur: Blur,
    /// The blur that the footage has too much of.
    excess: Blur,
    space: Space,
    /// The noise of the footage and that of the other camera, if both are known.
    noise: Option<[NoiseModel; 2]>,
}

/// The blur that footage has more of than another camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TooBlurred {
    /// The share of the pixels of known depth that are visibly more blurred, in [0, 1].
    pub share: f32,
    /// The mean over these pixels of the std of the Gaussian that would have to be taken away, px.
    pub sigma_px: f32,
}

impl Matching {
    /// The difference of two cameras, for frames of `width` px. What is unknown of either camera is not matched.
    ///
    /// # Errors
    /// If a model is for another width, its defocus is in relative inverse depth, or the models' noises are over different encodings.
    pub fn new(
        from: &CameraModel,
        to: &CameraModel,
        width: usize,
        bokeh: impl Into<Option<Bokeh>>,
    ) -> Result<Self> {
        let bokeh = bokeh.into();
        if from.transfer != to.transfer {
            return Err(Error::new(format!(
                "one camera's noise is that of {} values, the other's of {}: estimate both from footage of one encoding",
                from.transfer.name(),
                to.transfer.name()
            )));
        }
        let noise = from.noise.known().zip(to.noise.known());
        Ok(Self {
            blur: Blur::missing(from, to, width, bokeh)?,
            excess: Blur::missing(to, from, width, bokeh)?,
            space: from.space(),
            noise: noise.map(|(from, to)| [from.clone(), to.clone()]),
        })
    }

    /// Whether any motion blur is missing.
    pub fn moves(&self) -> bool {
        self.blur.exposure().0 > 0.0
    }

    /// The defocus that the footage has too much of, by the inverse depth of a frame, 1/m.
    pub fn too_blurred(&self, inverse_depth: &Plane) -> TooBlurred {
        const VISIBLE_PX: f32 = 0.25;
        let known = inverse_depth.data().iter().filter(|d| d.is_finite());
        let (mut count, mut blurred, mut sum) = (0, 0, 0.0f64);
        for sigma in known.map(|&d| self.excess.sigma_px(d)) {
            count += 1;
            if sigma > VISIBLE_PX {
                blurred += 1;
                sum += f64::from(sigma);
            }
        }
        if blurred == 0 {
            return TooBlurred::default();
        }
        TooBlurred { share: blurred as f32 / count as f32, sigma_px: (sum / f64::from(blurred)) as f32 }
    }

    /// A frame of the footage as the other camera would show it. Inverse depth is in 1/m, flow in px per frame interval; without them,
    /// defocus and motion blur stay as they are. Each frame number has its own noise; `seed`: `None` adds none.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn apply(
        &self,
        frame: &Encoded,
        number: u64,
        inverse_depth: Option<&Plane>,
        flow: Option<&Flow>,
        seed: Option<u64>,
    ) -> Result<Encoded> {
        let size = frame.0.size();
        let others = [inverse_depth.map(Plane::size), flow.map(Flow::size)];
        if let Some((w, h)) = others.into_iter().flatten().find(|other| *other != size) {
            return Err(Error::new(format!(
                "depth or flow has {w} x {h} pixels but the frame {} x {}; bring both to one size",
                size.0, size.1
            )));
        }
        let flow = flow.filter(|_| self.moves());
        // The taps of the streak are linear between pixels, which blurs by itself: that much less of the streak is needed.
        let shorter = |f: [f32; 2]| {
            let length = self.blur.exposure().0 * f[0].hypot(f[1]);
            let left = 1.0 - OF_TAPS / (length * length);
            if left > 0.0 { f.map(|v| left.sqrt() * v) } else { [0.0; 2] }
        };
        let needed = flow.map(|f| f.map(shorter));
        let defocuses = inverse_depth.is_some_and(|d| d.data().iter().any(|&d| self.blur.sigma_px(d) > 0.0));
        let blurred = if defocuses || needed.is_some() {
            let light = frame.0.map(|v| self.space.of_encoded(v));
            let blurred = self.blur.of_scene(&light, inverse_depth.filter(|_| defocuses), needed.as_ref())?;
            blurred.map(|v| self.space.encoded(v))
        } else {
            frame.0.clone()
        };
        let (Some([from, to]), Some(seed)) = (&self.noise, seed) else { return Ok(Encoded(blurred)) };
        // Noise depends on the picture without noise.
        let smooth = |image: &Raster<[f32; 3]>| noise::levels_of(filter::gaussian_blur(image, 1.5));
        let (before, after) = (smooth(&frame.0), smooth(&blurred));
        let (w, h) = frame.0.size();
        let (exposure, survival) = (self.blur.exposure().0, Survival::table());
        let there = |level: usize, x: usize, y: usize| {
            let at = ((x << level).min(w - 1), (y << level).min(h - 1));
            let sigma = inverse_depth.map_or(0.0, |d| self.blur.sigma_px(d.at(at.0, at.1)));
            let streak = flow.map_or([0.0; 2], |f| f.at(at.0, at.1).map(|v| exposure * v));
            let kept = survival.of(level, sigma, streak);
            from.std_over(level, before[level].at(x, y)).map(|std| kept * std * std)
        };
        let added = noise::missing(to, &after, there, seed, number);
        Ok(Encoded(Raster::from_fn(w, h, |x, y| {
            let (v, n) = (blurred.at(x, y), added.at(x, y));
            // Where the footage is clipped, there is no noise.
            std::array::from_fn(|c| {
                if v[c] >= from.clip() { v[c] } else { (v[c] + n[c]).clamp(0.0, v[c].max(1.0)) }
            })
        })))
    }
}

/// The share of the variance of white noise that a blur leaves in each level of the noise: a table over the std of a Gaussian, the length of
/// a streak, and its direction.
struct Survival(Vec<[f32; NOISE_LEVELS]>);

/// The steps of the std of the Gaussian and of the length of the streak: octaves of half an octave each from a quarter px on, after 0.
const STEPS: usize = 18;
/// The directions of streaks between 0 and 90 degrees.
const DIRECTIONS: usize = 5;

impl Survival {
    fn table() -> &'static Self {
        static TABLE: OnceLock<Survival> = OnceLock::new();
        TABLE.get_or_init(Self::new)
    }

    fn new() -> Self {
        /// The frequencies from 0 to half a cycle per px.
        const SIDE: usize = 48;
        let frequency = |i: usize| PI * (i as f32 + 0.5) / SIDE as f32;
        // A halving's kernel, [1 4 6 4 1] / 16, which is also that of a doubling.
        let kernel = |w: f32| (0.5 * w).cos().powi(4);
        let power = |u: f32, v: f32| {
            let mut low = 1.0;
            std::array::from_fn::<f32, NOISE_LEVELS, _>(|level| {
                let scale = (1 << level) as f32;
                let halved = kernel(scale * u) * kernel(scale * v);
                let band = low * (1.0 - halved * halved);
                low *= halved;
                band * band
            })
        };
        let places: Vec<[f32; 2]> = (0..SIDE)
            .flat_map(|j| {
                (0..2 * SIDE)
                    .map(move |i| [frequency(i % SIDE) * if i < SIDE { 1.0 } else { -1.0 }, frequency(j)])
            })
            .collect();
        let powers: Vec<[f32; NOISE_LEVELS]> = places.iter().map(|p| power(p[0], p[1])).collect();
        let sum = |weight: &dyn Fn([f32; 2]) -> f32| {
            let mut sums = [0.0f32; NOISE_LEVELS];
            for (place, power) in places.iter().zip(&powers) {
                let weight = weight(*place);
                (0..NOISE_LEVELS).for_each(|l| sums[l] += weight * power[l]);
            }
            sums
        };
        let all = sum(&|_| 1.0);
        let mut table = Vec::with_capacity(STEPS * STEPS * DIRECTIONS);
        for sigma in 0..STEPS {
            for streak in 0..STEPS {
                for direction in 0..DIRECTIONS {
                    let (sigma, length) = (value(sigma), value(streak));
                    let (sin, cos) = (0.5 * PI * direction as f32 / (DIRECTIONS - 1) as f32).sin_cos();
                    let left = sum(&|[u, v]| {
                        let half = 0.5 * length * (u * cos + v * sin);
                        let sinc = if half.abs() < 1e-3 { 1.0 } else { half.sin() / half };
                        (-sigma * sigma * (u * u + v * v)).exp() * sinc * sinc
                    });
                    table.push(std::array::from_fn(|l| left[l] / all[l]));
                }
            }
        }
        Self(table)
    }

    /// The share for a Gaussian of this std and a streak from end to end, px.
    fn of(&self, level: usize, sigma: f32, [u, v]: [f32; 2]) -> f32 {
        let (sigma, streak) = (place(sigma), place(u.hypot(v)));
        let direction = v.abs().atan2(u.abs()) / (0.5 * PI) * (DIRECTIONS - 1) as f32;
        let direction = (direction + 0.5) as usize;
        let at =
            |i: usize, j: usize| self.0[(i * STEPS + j) * DIRECTIONS + direction.min(DIRECTIONS - 1)][level];
        let ((i, s), (j, t)) = (sigma, streak);
        let along = |i: usize| at(i, j) + t * (at(i, j + 1) - at(i, j));
        along(i) + s * (along(i + 1) - along(i))
    }
}

/// The std or length of a step, px.
fn value(step: usize) -> f32 {
    if step == 0 { 0.0 } else { 0.25 * 2f32.powf(0.5 * (step - 1) as f32) }
}

/// The step below a std or length, px, and the share of the way to the next one.
fn place(px: f32) -> (usize, f32) {
    if px.is_nan() || px <= 0.0 {
        return (0, 0.0);
    }
    let step = if px < value(1) { px / value(1) } else { 1.0 + 2.0 * (px / value(1)).log2() };
    let step = step.min((STEPS - 1) as f32 - 1e-3);
    (step as usize, step.fract())
}
