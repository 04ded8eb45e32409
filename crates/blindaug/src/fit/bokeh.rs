//! Whether out-of-focus points are disks or Gaussians: which of the two explains the spectra of blurred tiles better. The gain of a disk
//! has zeros and side lobes, whose places follow from the blur, that of a Gaussian has none.

use super::agreement::{BOOTSTRAPS, LensFit, LensObservation, lens_of, resampled};
use super::defocus::Lens;
use super::likelihood::{
    CLIP, LensGain, TILE_SIGMAS, gaussian_gain, index_of_sigma, interpolate, lens_gain, prepare, sigma_of,
};
use super::noise::LumaNoise;
use super::spectral::{CODING_OF_LENS, lens_observations};
use super::tiles::Tile;
use crate::model::{Bokeh, Estimate, ExposureFraction, SharpeningModel};
use crate::portable::Portable;
use crate::{Result, par};
use std::ops::Range;

/// The number of shares of the lens's std, at equal steps of their log, at which the shapes are compared: at equal std, a disk and a Gaussian would
/// also differ in how blurred they look.
pub(super) const SCALES: usize = 9;

/// The largest of these shares; the least one is its inverse.
const LARGEST_SCALE: f32 = 1.4;

/// The stds, px of the tile, of tiles that may tell. With less blur a disk's first zero lies beyond the frequencies that are used, and more
/// would lie beyond the likelihood's tables at the largest share.
pub(super) fn telling() -> Range<f32> {
    0.9..sigma_of(TILE_SIGMAS - 1) / LARGEST_SCALE
}

/// The most tiles that are looked at.
const MOST_TILES: usize = 600;

/// The share of the replicas that must find a shape likelier than the other.
const SURE: f32 = 0.975;

/// The least number of nats by which a shape must be likelier than the other.
const LEAST_NATS: f32 = 30.0;

/// The std of Gaussians over that of the disks that they look like, at most, as measured (docs/accuracy.md).
const MOST_OF_GAUSSIAN: f32 = 2.2;

/// Looks at the shape of out-of-focus points in the tiles to which a lens was fitted with this exposure, as if they were disks. Where they
/// look like Gaussians, the interval of the lens takes in that which Gaussians would have; the lens itself stays as it is, since soft
/// textures look the same.
///
/// # Errors
/// The same as [`lens_of`].
pub(super) fn see(
    fit: &mut LensFit,
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
) -> Result<()> {
    fit.bokeh = shape_of(&observations(frames, noise, exposure, sharpening, fit.lens), BOOTSTRAPS);
    if fit.bokeh == Some(Bokeh::Gaussian) {
        let as_gaussians = lens_observations(frames, noise, exposure, sharpening, gaussian_gain);
        take_in_gaussians(fit, &as_gaussians, BOOTSTRAPS)?;
    }
    Ok(())
}

/// Widens the interval of a lens, which was fitted as if points were disks, to that which Gaussians would have.
///
/// # Errors
/// The same as [`lens_of`].
pub(super) fn take_in_gaussians(
    fit: &mut LensFit,
    as_gaussians: &[LensObservation],
    bootstraps: usize,
) -> Result<()> {
    match lens_of(as_gaussians, bootstraps)? {
        Estimate::Known(gaussian) => fit.widen(&gaussian),
        Estimate::Unknown(_) => {
            let high = &mut fit.sigma_px_at_infinity[1];
            *high = high.max(MOST_OF_GAUSSIAN * fit.lens.sigma_px_at_infinity());
        }
    }
    Ok(())
}

/// The observation of the shape of out-of-focus points by a tile, or by several tiles of one block and part.
#[derive(Clone)]
pub(super) struct ShapeObservation {
    /// The log-likelihoods, nats, of a disk and of a Gaussian at each share of the lens's std.
    pub log_likelihood: [[f32; SCALES]; 2],
    /// The block of the image.
    pub block: u32,
    /// The part of the clip.
    pub part: usize,
}

/// The observations of the shape by at most [`MOST_TILES`] of the tiles that a lens, found with this exposure, puts out of focus.
pub(super) fn observations(
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
    lens: Lens,
) -> Vec<ShapeObservation> {
    let std_of = |t: &Tile| lens.sigma_px(t.inverse_depth) / t.scale;
    let telling = telling();
    let all = prepare(frames, noise, CODING_OF_LENS * noise.coding_error, |t| {
        t.of_lens && t.inverse_depth.is_finite() && telling.contains(&std_of(t))
    });
    let tiles: Vec<_> = all.iter().step_by(all.len().div_ceil(MOST_TILES).max(1)).collect();
    let share = |k: usize| {
        let half = (SCALES - 1) as f32 / 2.0;
        LARGEST_SCALE.portable_powf((k as f32 - half) / half)
    };
    par::map(tiles.len(), |i| {
        let at_shares = |gain: LensGain| -> [f32; SCALES] {
            let table = tiles[i].absolute_over_sigma(exposure.0, sharpening, gain);
            std::array::from_fn(|k| interpolate(&table, index_of_sigma(share(k) * std_of(tiles[i].tile))))
        };
        let both = [at_shares(lens_gain), at_shares(gaussian_gain)];
        let best = both.iter().flatten().copied().fold(f32::MIN, f32::max);
        ShapeObservation {
            log_likelihood: both.map(|shape| shape.map(|v| (v - best).max(-CLIP))),
            block: tiles[i].tile.block,
            part: tiles[i].part,
        }
    })
}

/// The shape that the observations agree on, in at least a share [`SURE`] of `bootstraps` replicas; `None` if they tell none.
pub(super) fn shape_of(observations: &[ShapeObservation], bootstraps: usize) -> Option<Bokeh> {
    let nats = |weight: &dyn Fn(&ShapeObservation) -> f32| {
        let best = [0, 1].map(|shape| {
            let sum =
                |k: usize| observations.iter().map(|w| weight(w) * w.log_likelihood[shape][k]).sum::<f32>();
            (0..SCALES).map(sum).fold(f32::MIN, f32::max)
        });
        best[0] - best[1]
    };
    let all = nats(&|_| 1.0);
    // The replicas weigh blocks of the image and parts of the clip at random.
    let replica = |r: usize| nats(&|w| resampled(r, w.block, w.part));
    let disks = (0..bootstraps).filter(|&r| replica(r) > 0.0).count() as f32 / bootstraps as f32;
    if all >= LEAST_NATS && disks >= SURE {
        Some(Bokeh::Disk)
    } else if all <= -LEAST_NATS && disks <= 1.0 - SURE {
        Some(Bokeh::Gaussian)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::noise::NoiseLine;
    use super::super::noise::tests::white;
    use super::super::spectral;
    use super::super::tiles::tiles;
    use super::*;
    use crate::model::Space;
    use crate::synth::defocus::defocus;
    use crate::synth::noise::white_band_std;
    use crate::{Encoded, Plane, Raster, Transfer};

    #[test]
    fn disks_and_gaussians_are_told_apart_and_a_sharp_lens_tells_nothing() {
        let (side, std) = (384, 0.004);
        // Squares of many sizes, from which the lens's curve runs from sharp on the left to blurred on the right.
        let octaves: Vec<Plane> = (0..6u64).map(|o| white(side, side, o + 1).map(|v| v[0])).collect();
        let sharp = Raster::from_fn(side, side, |x, y| {
            let sum: f32 = (0..6).map(|o| octaves[o].at(x >> o, y >> o)).sum();
            [(0.3 + 0.04 * sum).clamp(0.0, 1.0); 3]
        });
        let depth = Plane::from_fn(side, side, |x, _| 0.2 + 0.8 * x as f32 / side as f32);
        let noise = white(side, side, 9);
        let level = white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: std * white });
        let known = LumaNoise { levels: level, coding_error: 0.0 };
        let seen = |slope: f32, bokeh: Bokeh| {
            let lens = Lens { slope, focus: 0.2 };
            let blurred = defocus(&sharp, &depth.map(|d| lens.sigma_px(d)), bokeh).unwrap();
            let frame = Encoded(Raster::from_fn(side, side, |x, y| {
                let (v, n) = (Transfer::Srgb.encode(blurred.at(x, y)[0]), noise.at(x, y)[0]);
                // One noise in all channels, so that it is luma's.
                [v + std * n; 3]
            }));
            let tiles = tiles(&frame, None, Some(&depth), Space::default()).unwrap();
            let frames: [&[Tile]; 1] = [&tiles];
            let fit = spectral::fit_lens(&frames, &known, ExposureFraction(0.0), None).unwrap();
            let mut fit = fit.into_known().expect("the depths tell a lens");
            let before = fit.sigma_px_at_infinity;
            see(&mut fit, &frames, &known, ExposureFraction(0.0), None).unwrap();
            (fit.bokeh, before, fit.sigma_px_at_infinity, lens.sigma_px_at_infinity())
        };
        let (shape, before, after, _) = seen(4.0, Bokeh::Disk);
        assert_eq!(shape, Some(Bokeh::Disk));
        assert_eq!(before, after);
        let (shape, before, after, truth) = seen(4.0, Bokeh::Gaussian);
        assert_eq!(shape, Some(Bokeh::Gaussian));
        // As disks of the same std, Gaussians look less blurred.
        assert!(
            before[1] < after[1] && after[0] <= truth && truth <= after[1],
            "{before:?} {after:?} {truth}"
        );
        assert_eq!(seen(0.3, Bokeh::Disk).0, None);
    }

    #[test]
    fn gaussians_that_tell_no_lens_of_their_own_leave_room_for_the_most_that_they_may_be_blurred() {
        let lens = Lens { slope: 4.0, focus: 0.2 };
        let told = lens.sigma_px_at_infinity();
        let mut fit = LensFit {
            lens,
            sigma_px_at_infinity: [0.9 * told, 1.1 * told],
            focus_inverse_depth: [0.1, 0.3],
            samples: 100,
            points: vec![],
            inverse_depth_seen: [0.1, 1.0],
            bokeh: Some(Bokeh::Gaussian),
        };
        take_in_gaussians(&mut fit, &[], BOOTSTRAPS).unwrap();
        assert_eq!(fit.sigma_px_at_infinity, [0.9 * told, MOST_OF_GAUSSIAN * told]);
    }
}
