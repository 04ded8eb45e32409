//! Cameras that film a scene with known numbers: the project's own synthesis, with its own noise or with that of the paper's validation,
//! and one made of physics alone.

use crate::scene::{Exposure, Scene};
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel, NoiseModel,
};
use blindaug::synth::{self, defocus::Bokeh, noise};
use blindaug::{CameraModel, Encoded, Flow, Linear, Plane, Raster, Result, Transfer};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal, Poisson, StandardNormal};
use serde::{Deserialize, Serialize};

/// The kinds of cameras that film a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Camera {
    /// The sharp frame, distorted by `synth`: what is fitted is what was applied, as in the paper.
    Synthesis,
    /// As [`Camera::Synthesis`], but with the noise of the paper's validation: white and Gaussian, of the std k_readout + k_shot sqrt(I) at
    /// an encoded value I.
    Heteroscedastic,
    /// Many pinhole views averaged over the lens and the shutter; photons counted and read in light, then the transfer curve.
    Physics,
}

/// The settings of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Exposure fraction.
    pub exposure: f32,
    /// Blur at infinity (std in px) and focus distance in m; `None`: a pinhole.
    pub lens: Option<(f32, f32)>,
    /// Std of the noise at an encoded value of 0.5, in encoded values.
    pub noise: f32,
    /// The share of the noise at an encoded value of 0.5 that does not depend on the light, in [0, 1]: of the variance for physics, of the
    /// std for the others.
    pub readout: f32,
    /// The time from the first row to the last one of a rolling shutter, as [`Exposure::readout`]; the synthesis, which has no such
    /// distortion, takes all rows at once.
    #[serde(default)]
    pub rolling_shutter: f32,
}

/// A filmed frame and what it would be without noise.
pub struct Filmed {
    /// The frame as a camera gives it, in steps of 8 bits.
    pub frame: Encoded,
    /// The frame without noise and rounding.
    pub without_noise: Encoded,
}

impl Camera {
    /// Films the frame at `time`, in frames. `sharp`, inverse depth and motion are those of the scene at that time.
    ///
    /// # Errors
    /// If the sizes differ, which they do not for pictures of one scene.
    pub fn film(
        self,
        scene: &Scene,
        time: u64,
        (sharp, inverse_depth, motion): (&Linear, &Plane, &Flow),
        setting: &Setting,
        seed: u64,
    ) -> Result<Filmed> {
        // The seed of the frame's own noise.
        let of_frame = seed.wrapping_mul(1_000_003).wrapping_add(time);
        let (without_noise, noisy) = match self {
            Self::Synthesis | Self::Heteroscedastic => {
                let model = model(sharp.0.size(), setting);
                let options = synth::SynthesisOptions {
                    bokeh: Some(Bokeh::Disk),
                    no_noise: true,
                    seed,
                    unclipped: false,
                };
                let clean =
                    synth::distort_frame(sharp, &model, Some(inverse_depth), Some(motion), &options, time)?;
                let noise = model.noise.known().filter(|_| self == Self::Synthesis);
                let noisy = match noise.map(|m| noise::noise(m, &clean.0, seed, time)) {
                    Some(n) => Encoded(Raster::from_fn(clean.0.width(), clean.0.height(), |x, y| {
                        let (v, n) = (clean.0.at(x, y), n.at(x, y));
                        std::array::from_fn(|c| v[c] + n[c])
                    })),
                    None => heteroscedastic(&clean, setting, of_frame),
                };
                (clean, noisy)
            }
            Self::Physics => {
                let exposure = Exposure {
                    fraction: setting.exposure,
                    lens: setting.lens,
                    readout: setting.rolling_shutter,
                };
                // The frame is the mean of two pictures, whose own noise is part of the frame's. One of them stands for the frame
                // without noise, as the frame differs from it by as much as from a picture of infinitely many views.
                let views = |seed| scene.picture(time as f32, exposure, seed);
                let (light, without_noise) = match exposure {
                    // An instant through a pinhole is the sharp frame, which is given.
                    Exposure { fraction: 0.0, lens: None, readout: 0.0 } => (sharp.clone(), sharp.clone()),
                    Exposure { lens: None, .. } => {
                        let light = views(0);
                        (light.clone(), light)
                    }
                    _ => {
                        let [a, b] = [0, 1].map(|half| views(2 * time + half));
                        let mean = |x, y| {
                            let (a, b): ([f32; 3], [f32; 3]) = (a.0.at(x, y), b.0.at(x, y));
                            std::array::from_fn(|c| 0.5 * (a[c] + b[c]))
                        };
                        (Linear(Raster::from_fn(a.0.width(), a.0.height(), mean)), b)
                    }
                };
                let noisy = counted(&light, setting, of_frame);
                (without_noise.to_encoded(Transfer::Srgb), noisy.to_encoded(Transfer::Srgb))
            }
        };
        Ok(Filmed { frame: Encoded(noisy.0.map(|p| p.map(in_steps))), without_noise })
    }
}

/// An encoded value rounded to a step of 8 bit, in [0, 1].
pub fn in_steps(v: f32) -> f32 {
    (v.clamp(0.0, 1.0) * 255.0).round() / 255.0
}

/// The setting as a camera model.
pub fn model((width, height): (usize, usize), setting: &Setting) -> CameraModel {
    let mut model = CameraModel::unknown(
        Capture { width, height, fps: None, frames_used: 0, pixel_aspect: 1.0 },
        "the camera has none",
    );
    if setting.exposure > 0.0 {
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(setting.exposure)));
    }
    if let Some((sigma, focus)) = setting.lens {
        model.defocus = Estimate::Known(DefocusModel::given_lens(sigma, 1.0 / focus));
    }
    // White noise has this std in the bands; blue is noisier than green, as in most cameras.
    let white = noise::white_band_std();
    let levels = white.map(|white| {
        let std = [1.05, 0.9, 1.2].map(|c| c * white * setting.noise);
        NoiseLevel {
            intercept: std.map(|s| s * setting.readout),
            slope: std.map(|s| 2.0 * s * (1.0 - setting.readout)),
        }
    });
    model.noise = Estimate::Known(NoiseModel::given(levels, 1.0));
    model
}

/// The frame with white Gaussian noise of the std k_readout + k_shot sqrt(I) at an encoded value I, the same in all channels.
fn heteroscedastic(frame: &Encoded, setting: &Setting, seed: u64) -> Encoded {
    let readout = setting.noise * setting.readout;
    let shot = setting.noise * (1.0 - setting.readout) / 0.5f32.sqrt();
    let mut rng = StdRng::seed_from_u64(seed);
    let mut noisy = frame.clone();
    for v in noisy.0.data_mut().as_flattened_mut() {
        let n: f32 = StandardNormal.sample(&mut rng);
        *v += n * (readout + shot * v.max(0.0).sqrt());
    }
    noisy
}

/// The light as a sensor measures it: photons are counted (Poisson) and read with an error (Gaussian).
fn counted(light: &Linear, setting: &Setting, seed: u64) -> Linear {
    // The std of light at an encoded value of 0.5, and the share of its variance that photons have, give the full well.
    let middle = Transfer::Srgb.decode(0.5);
    let std = setting.noise / Transfer::Srgb.slope(middle);
    let full_well = middle / (std * std * (1.0 - setting.readout)).max(1e-12);
    let read = Normal::new(0.0, std * setting.readout.sqrt()).expect("a finite std");
    let width = light.0.width();
    Linear(
        Raster::from_vec(width, light.0.height(), {
            let mut rng = StdRng::seed_from_u64(seed);
            let mut filmed = Vec::with_capacity(light.0.data().len());
            for p in light.0.data() {
                filmed.push(p.map(|v| {
                    // The mean of a Poisson distribution must be above 0.
                    let photons = Poisson::new((v * full_well).max(1e-6)).map_or(0.0, |d| d.sample(&mut rng));
                    (photons / full_well + read.sample(&mut rng)).max(0.0)
                }));
            }
            filmed
        })
        .expect("as many as pixels"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::value::{Error, MapDeserializer};

    #[test]
    fn a_setting_that_was_stored_without_a_rolling_shutter_has_none() {
        let stored = [("exposure", 0.5f32), ("noise", 0.01), ("readout", 0.2)];
        let setting = Setting::deserialize(MapDeserializer::<_, Error>::new(stored.into_iter())).unwrap();
        assert_eq!(setting.rolling_shutter, 0.0);
        let stored = stored.into_iter().chain([("rolling_shutter", 0.3)]);
        let setting = Setting::deserialize(MapDeserializer::<_, Error>::new(stored)).unwrap();
        assert_eq!(setting.rolling_shutter, 0.3);
    }

    #[test]
    fn heteroscedastic_noise_has_the_paper_s_std() {
        let scene = Scene::new(4, (160, 120));
        let sharp = scene.picture(0.0, Exposure::default(), 0);
        let (depth, motion) = (scene.inverse_depth(0.0), scene.motion(0.0));
        let setting = Setting { exposure: 0.0, lens: None, noise: 0.02, readout: 0.4, rolling_shutter: 0.0 };
        let filmed = Camera::Heteroscedastic.film(&scene, 0, (&sharp, &depth, &motion), &setting, 5).unwrap();
        // Squares of noise over what they should be, apart for dark and for bright values; nothing is clipped in between.
        let mut ratios = [vec![], vec![]];
        for (n, c) in filmed.frame.0.data().iter().zip(filmed.without_noise.0.data()) {
            for (n, c) in n.iter().zip(c).filter(|(_, c)| (0.1..0.9).contains(*c)) {
                let std = 0.02 * (0.4 + 0.6 * (c / 0.5).sqrt());
                // The steps of 8 bit add the variance of a uniform distribution.
                ratios[usize::from(*c > 0.4)]
                    .push((n - c).powi(2) / (std * std + 1.0 / (12.0 * 255.0 * 255.0)));
            }
        }
        for part in ratios {
            let mean = part.iter().sum::<f32>() / part.len() as f32;
            assert!(part.len() > 4000 && (mean - 1.0).abs() < 0.06, "{mean} of {}", part.len());
        }
    }

    #[test]
    fn physics_films_row_by_row_with_a_rolling_shutter() {
        let scene = Scene::new(3, (64, 48));
        let sharp = scene.picture(2.0, Exposure::default(), 0);
        let (depth, motion) = (scene.inverse_depth(2.0), scene.motion(2.0));
        let film = |rolling_shutter| {
            let setting = Setting { exposure: 0.0, lens: None, noise: 0.0, readout: 0.0, rolling_shutter };
            Camera::Physics.film(&scene, 2, (&sharp, &depth, &motion), &setting, 1).unwrap().without_noise
        };
        assert!(film(0.0) == sharp.to_encoded(Transfer::Srgb));
        // The last row is taken at the end.
        let late = scene.picture(2.25, Exposure::default(), 0).to_encoded(Transfer::Srgb);
        assert_eq!(film(0.5).0.row(47), late.0.row(47));
        assert_ne!(film(0.0).0.row(47), late.0.row(47));
    }
}
