//! Blind fit of exposure and defocus by the Whittle likelihood of local spectra.
//!
//! The windowed periodogram P of a tile is compared with `V = S |K_MB|^2 |K_DoF|^2 + n`: S is the spectrum of the sharp
//! scene, `K_MB = sinc(lambda F.w)` the shutter, `K_DoF` the lens at the tile's depth, n the noise, which was measured
//! before. Log-likelihood: `-sum(ln V + P / V)`.
//!
//! Motion blur acts along the flow, and defocus acts alike in all directions, which separates the two:
//! - **lambda**: `S |K_DoF|^2` may be any function of the frequency's modulus, with one amplitude per ring, which is integrated over: so
//!   isotropic effects (the lens, the slope of the scene's spectrum, the pixel's response, sharpening) have no influence. It may also be a
//!   smooth function of the direction, the same in all rings, under a prior, so that boards or bars have no influence either: the
//!   trace of motion blur that remains is its zeros, which lie at a distance along the motion, not in a direction. If a surface moves
//!   differently in two frames, [`pairs()`] tells lambda whatever S is.
//! - **lens**, given lambda: `S = a / |w|^alpha` times a small pixel response, with a and the noise's exact power profiled out and alpha
//!   integrated out under a prior from natural images.
//!
//! The global unknowns maximise the sum over the tiles of all frames, each tile's loss clipped against outliers.
//! The intervals are those of a bootstrap over blocks of the image and parts of the clip, with a floor for errors of the models.

mod pairs;

pub use super::agreement::{
    BOOTSTRAPS, ExposureFit, ExposureObservation, LensFit, LensObservation, exposure_of, lens_of,
};
pub use super::likelihood::{EXPOSURES, SIGMAS, TILE_SIGMAS, lens_gain};
use super::likelihood::{LensGain, Prepared, prepare};
use super::noise::LumaNoise;
use super::tiles::SPEEDS;
pub use super::tiles::{
    BLOCK_COUNT, COLUMNS, EXPOSURE_TILES, Frequency, LENS_TILES_PER_BLOCK, LEVELS, TILE, Tile, frequencies,
    hann, levels, tiles,
};
use crate::model::{Estimate, ExposureFraction, SharpeningModel};
use crate::{Result, par};
pub use pairs::{Pair, pairs};
pub(super) use pairs::{PreparedPair, streak_pairs};

/// The constants of these fits, for implementations of the fits elsewhere, for example on a graphics device.
pub mod numbers {
    pub use super::super::likelihood::{
        ALPHA, ALPHAS, AMPLITUDE_PRECISION, CLIP, CORRELATED, DIRECTION, EXPOSURE_NOISE_ERROR, EXPOSURE_STEP,
        INFORMATIVE, LAMBDA_STEPS, LARGER_BLUR, LEAK, LENS_NOISE_ERROR, MAX_LAMBDA, NoiseError,
        PIXEL_RESPONSE, SHUTTER_FLOOR, STREAK_ERROR, STREAK_STEP, TEMPER,
    };
    pub use super::super::tiles::{BLOCKS, KNOWN_SAMPLES, MIDDLE, MIN_CONTRAST, SAMPLES, SPEEDS};
}

/// The share of a coder's errors by which tiles are noise-padded for the lens, which needs the fine detail that lambda can do without.
pub const CODING_OF_LENS: f32 = 0.45;

/// The speed, px per frame interval, below which no shutter leaves blur that could be taken for a lens's.
pub(super) const STILL: f32 = 0.75;

/// The error of a typical streak's length, px, from which on the lens is fitted for all exposures that may be.
pub(super) const SURE_STREAK: f32 = 0.6;

/// The observations of the exposure by the tiles that move.
pub(super) fn exposure_observations(frames: &[&[Tile]], noise: &LumaNoise) -> Vec<ExposureObservation> {
    let moving: Vec<Prepared> =
        prepare(frames, noise, noise.coding_error, |t| t.of_exposure && t.speed >= SPEEDS.start);
    par::map(moving.len(), |i| {
        let Prepared { tile, frame, .. } = moving[i];
        let speed = tile.speed * tile.scale;
        ExposureObservation {
            block: tile.block,
            frame,
            speed,
            speed_error: tile.speed_error,
            log_likelihood: moving[i].clipped_log_likelihood(),
        }
    })
}

/// The exposure that the tiles of all frames, and the pairs of each frame with the frame before, agree on.
///
/// # Errors
/// The same as [`exposure_of`].
pub fn fit_exposure(
    frames: &[&[Tile]],
    pairs: &[&[Pair]],
    noise: &LumaNoise,
) -> Result<Estimate<ExposureFit>> {
    let mut observations = exposure_observations(frames, noise);
    let of_tiles = exposure_of(&observations, frames.len(), noise.coding_error)?;
    let Estimate::Known(ExposureFit { samples, .. }) = of_tiles else { return Ok(of_tiles) };
    // Pairs only refine an exposure that tiles tell. If the tiles tell none, a few pairs may be sure of a wrong one.
    let pairs: Vec<(usize, &Pair)> =
        pairs.iter().enumerate().flat_map(|(f, pairs)| pairs.iter().map(move |p| (f, p))).collect();
    let of_pairs = par::map(pairs.len(), |i| {
        let (frame, pair) = pairs[i];
        let log_likelihood = pair.clipped_log_likelihood(noise)?;
        Some(ExposureObservation {
            block: pair.block,
            frame,
            speed: pair.speed(),
            speed_error: 0.0,
            log_likelihood,
        })
    });
    observations.extend(of_pairs.into_iter().flatten());
    if observations.len() == samples {
        return Ok(of_tiles);
    }
    exposure_of(&observations, frames.len(), noise.coding_error)
}

/// The thin lens that the tiles of all frames agree on, given the exposure (0 if it is unknown) and the camera's sharpening, which
/// hides blur.
///
/// # Errors
/// The same as [`lens_of`].
pub fn fit_lens(
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
) -> Result<Estimate<LensFit>> {
    lens_of(&lens_observations(frames, noise, exposure, sharpening, lens_gain), BOOTSTRAPS)
}

/// The observations of the lens by the tiles whose depth is known, if the lens has this gain.
pub(super) fn lens_observations(
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
    gain: LensGain,
) -> Vec<LensObservation> {
    let prepared: Vec<Prepared> = prepare(frames, noise, CODING_OF_LENS * noise.coding_error, |t| {
        t.of_lens && t.inverse_depth.is_finite()
    });
    par::map(prepared.len(), |i| LensObservation {
        inverse_depth: prepared[i].tile.inverse_depth,
        table: prepared[i].over_sigma_of_frame(exposure.0, sharpening, gain),
        tiles: 1.0,
        block: prepared[i].tile.block,
        part: prepared[i].part,
    })
}

#[cfg(test)]
mod tests {
    use super::super::agreement::{FineTables, lens_range, surface_weights};
    use super::super::likelihood::{CLIP, EXPOSURE_NOISE_ERROR, TEMPER, sigma_of};
    use super::super::tiles::{Light, noise_density, tiles_in_strips};
    use super::*;
    use crate::fit::defocus::{self, Lens};
    use crate::fit::noise::NoiseLine;
    use crate::model::{BlurSpace, Reason, Space};
    use crate::synth::noise::white_band_std;
    use crate::{Encoded, Flow, LUMA, Plane, Raster, luma};

    #[test]
    fn the_noise_of_coloured_light_is_what_that_of_luma_predicts() {
        const COLOUR: [f32; 3] = [0.85, 0.35, 0.2];
        const STD: f32 = 0.01;
        let side = 8 * TILE;
        let normal = crate::fit::noise::tests::white(side, side, 0);
        let frame = Encoded(Raster::from_fn(side, side, |x, y| {
            let n = normal.at(x, y);
            std::array::from_fn(|c| COLOUR[c] + STD * n[c])
        }));
        let std = STD * LUMA.iter().map(|w| w * w).sum::<f32>().sqrt();
        let levels = white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: std * white });
        let noise = LumaNoise { levels, coding_error: 0.0 };
        for space in [BlurSpace::Linear, BlurSpace::Encoded] {
            let tiles = tiles(&frame, None, None, space.into()).unwrap();
            // The mean power over the predicted power, with the noise moments of a tile of this colour or of a grey tile.
            let over = |moments: &dyn Fn(&Tile) -> [f32; 3]| {
                let (mut power, mut predicted) = (0.0, 0.0);
                for tile in &tiles {
                    let density = noise_density(moments(tile), tile.scale, &noise, 0.0);
                    power += tile.bins.iter().map(|b| b.weight * b.power).sum::<f32>();
                    predicted += tile.bins.iter().map(|b| b.weight * density(b.modulus)).sum::<f32>();
                }
                power / predicted
            };
            let own = over(&|tile| tile.noise_moments);
            assert!((own - 1.0).abs() < 0.03, "{space:?}: {own}");
            let grey = Encoded(frame.0.map(|p| [luma(p); 3]));
            let of_grey = Light::new(&grey, space.into()).noise_moments((0, 0));
            let other = over(&|_| of_grey);
            assert_eq!((other - 1.0).abs() > 0.1, space == BlurSpace::Linear, "{space:?}: {other}");
        }
    }

    #[test]
    fn strips_give_the_tiles_of_the_whole_frame() {
        let (w, h) = (770, 807);
        let noise = crate::fit::noise::tests::white(w, h, 1);
        let frame = Encoded(Raster::from_fn(w, h, |x, y| {
            noise.at(x, y).map(|n| 0.3 + 0.3 * ((x / 37 + y / 43) % 2) as f32 + 0.02 * n)
        }));
        let flow = Flow::from_fn(w, h, |_, y| [4.0 + 0.002 * y as f32, 1.0]);
        let depth = Plane::from_fn(w, h, |x, y| 0.3 + 0.0001 * (x + y) as f32);
        for space in [BlurSpace::Linear, BlurSpace::Encoded] {
            let found = |most: usize| {
                let tiles = tiles_in_strips(&frame, Some(&flow), Some(&depth), space.into(), most).unwrap();
                assert_eq!(tiles.iter().map(|t| t.scale as usize).max(), Some(4));
                format!("{tiles:?}")
            };
            let whole = found(w * h);
            for rows in [32, 224, 800] {
                assert!(found(rows * w) == whole, "{rows} rows");
            }
        }
    }

    #[test]
    fn surfaces_that_disagree_about_the_lens_leave_it_unknown() {
        let lenses = [Lens { slope: 4.0, focus: 0.2 }, Lens { slope: 4.0, focus: 0.8 }];
        let observation = |i: usize, lens: &Lens| {
            let inverse_depth = 0.1 + 0.8 * (i / BLOCK_COUNT) as f32 / 9.0;
            let log_likelihood =
                |s: usize| (-20.0 * (sigma_of(s) - lens.sigma_px(inverse_depth)).powi(2)).max(-CLIP);
            let table = (0..SIGMAS).map(log_likelihood).collect();
            LensObservation { inverse_depth, table, tiles: 1.0, block: (i % BLOCK_COUNT) as u32, part: 0 }
        };
        let fit = |of_block: &dyn Fn(usize) -> usize| {
            let observations: Vec<LensObservation> =
                (0..250).map(|i| observation(i, &lenses[of_block(i % BLOCK_COUNT)])).collect();
            lens_of(&observations, BOOTSTRAPS)
        };
        let agreed = fit(&|_| 0).unwrap().into_known().expect("all surfaces agree");
        let [low, high] = agreed.focus_inverse_depth;
        assert!((low..high).contains(&lenses[0].focus) && high < 0.5 * lenses[1].focus, "{agreed:?}");
        let disagreed = fit(&|block| block % 2).unwrap();
        assert_eq!(disagreed.why_unknown().expect("they do not").reason, Reason::Uncertain);
    }

    #[test]
    fn a_soft_wall_does_not_outvote_all_that_stands_before_it() {
        // Most tiles show a far wall that looks blurred; the things before the wall, at all depths down to it, are sharp.
        let observation = |i: usize, inverse_depth: f32, blur: f32| LensObservation {
            inverse_depth,
            table: (0..SIGMAS).map(|s| (-4.0 * (sigma_of(s) - blur).powi(2)).max(-CLIP)).collect(),
            tiles: 1.0,
            block: (i % BLOCK_COUNT) as u32,
            part: 0,
        };
        let wall = (0..150).map(|i| observation(i, 0.1, 0.8));
        let things = (0..100).map(|i| observation(i, 0.11 + 0.008 * i as f32, 0.0));
        let observations: Vec<LensObservation> = wall.chain(things).collect();
        let tables = FineTables::new(&observations);
        let lens = |log_likelihood: &(dyn Fn(Lens) -> f32 + Sync)| {
            defocus::best_lens(lens_range(&observations), log_likelihood)
        };
        let weighted = lens(&|l| tables.log_likelihood(l, None)).sigma_px(0.1);
        // The negative control weighs all observations alike.
        let undo: Vec<f32> = surface_weights(&observations).iter().map(|w| 1.0 / w).collect();
        let plain = lens(&|l| tables.log_likelihood(l, Some(&undo))).sigma_px(0.1);
        assert!(weighted < 0.4 && plain > 0.6, "{weighted} {plain}");
    }

    #[test]
    fn weak_noise_is_known_less_exactly_than_strong_noise() {
        let side = 4 * TILE;
        let frame =
            Encoded(Raster::from_fn(side, side, |x, y| [0.3 + 0.2 * ((x / 5 + y / 7) % 2) as f32; 3]));
        let tiles = tiles(&frame, None, None, Space::default()).unwrap();
        let std_of_factor = |std: f32, scale: f32| {
            let levels = white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: std * white });
            let noise = LumaNoise { levels, coding_error: 0.0 };
            let tile = tiles.iter().find(|t| t.scale == scale).expect("both scales");
            let prepared = Prepared::new(tile, 0, 0, &noise, 0.0).expect("it has contrast");
            (TEMPER * prepared.noise_precision(&EXPOSURE_NOISE_ERROR)).sqrt().recip()
        };
        for scale in [1.0, 2.0] {
            let [strong, weak] = [0.06, 0.001].map(|std| std_of_factor(std, scale));
            assert!((0.2..0.203).contains(&strong) && weak > 10.0 * strong, "{strong} {weak}");
        }
    }
}
