//! Clips under a shaking hand.

use super::leaves::{CAMERA, Camera, Scene};
use blindaug::{Encoded, Linear, Raster, Transfer, synth};

/// Frames of a photograph that a shaking hand moves by whole px: its speed swings by 50 % with this period, in
/// frames.
pub fn shaken(
    (width, height): (usize, usize),
    frames: usize,
    exposure: impl Fn(usize) -> f32,
    period: f32,
) -> Vec<Encoded> {
    /// The number of views of a frame interval.
    const VIEWS: usize = 64;
    let sharp = Camera { exposure: 0.0, sigma_at_infinity: 0.0, noise: 0.0, moves: false, ..CAMERA };
    let photo = Scene::new(1, (width + 7 * frames + 20, height)).seen(0, &sharp, 0).frame;
    let photo = photo.to_linear(Transfer::Srgb).0;
    let place = |t: f32| {
        let turn = std::f32::consts::TAU / period;
        (6.0 * t + 6.0 * 0.5 / turn * (turn * t + 0.7).sin() + 8.0).round() as usize
    };
    let frame = |t: usize| {
        let views = (exposure(t) * VIEWS as f32) as usize;
        let at = |v: usize| place(t as f32 + 0.5 + (v as f32 + 0.5 - 0.5 * views as f32) / VIEWS as f32);
        let ways: Vec<usize> = (0..views).map(at).collect();
        let light = Raster::from_fn(width, height, |x, y| {
            let mut sum = [0.0; 3];
            ways.iter().for_each(|way| (0..3).for_each(|c| sum[c] += photo.at(x + way, y)[c]));
            sum.map(|v: f32| v / views as f32)
        });
        let noise =
            synth::noise::modulated(synth::noise::unit_bands(width, height, t as u64, 0), |l, _, _| {
                [0.006 * synth::noise::white_band_std()[l]; 3]
            });
        let encoded = Linear(light).to_encoded(Transfer::Srgb).0;
        Encoded(Raster::from_fn(width, height, |x, y| {
            std::array::from_fn(|c| ((encoded.at(x, y)[c] + noise.at(x, y)[c]) * 255.0).round() / 255.0)
        }))
    };
    (0..frames).map(frame).collect()
}
