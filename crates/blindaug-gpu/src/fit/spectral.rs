//! Blind fit of exposure and defocus: the Whittle likelihood of local spectra, tile by tile.

use super::{Readback, Stage, common_size, filled, read, storage, uniform, view, write};
use crate::gpu::array_view;
use crate::layout::{Layout, structs, wgsl_struct};
use crate::prelude::{colours, constants};
use blindaug::fit::noise::{LumaNoise, NoiseLine};
use blindaug::fit::spectral::{
    self, BLOCK_COUNT, CODING_OF_LENS, COLUMNS, EXPOSURE_TILES, EXPOSURES, ExposureObservation,
    LENS_TILES_PER_BLOCK, LEVELS, LensObservation, SIGMAS, TILE, TILE_SIGMAS, frequencies, hann, lens_gain,
    numbers,
};
use blindaug::model::{BlurSpace, ExposureFraction, NOISE_LEVELS, SharpeningModel};
use blindaug::synth::noise::white_band_std;
use blindaug::{Error, Result};
use std::sync::LazyLock;
use wgpu::BufferUsages;

/// The structs of the blind fits.
pub(crate) const STRUCTS: [Layout; 2] = [Params::LAYOUT, Tile::LAYOUT];

/// The WGSL declarations that the kernels of the blind fits share.
pub(crate) fn shared() -> String {
    let constants = constants(&[
        ("NOISE_LEVELS", &NOISE_LEVELS),
        ("BLOCKS", &numbers::BLOCKS),
        ("LEAST_STEP", &numbers::LAMBDA_STEPS.start),
        ("LARGEST_STEP", &numbers::LAMBDA_STEPS.end),
        ("MAX_STEPS", &((numbers::MAX_LAMBDA / numbers::LAMBDA_STEPS.start).round() as usize + 1)),
        ("EXPOSURE_OBSERVATION", &EXPOSURE_OBSERVATION),
        ("LENS_OBSERVATION", &LENS_OBSERVATION),
        ("TILE", &TILE),
        ("LEVELS", &LEVELS),
        ("COLUMNS", &COLUMNS),
        ("EXPOSURE_TILES", &EXPOSURE_TILES),
        ("LENS_TILES_PER_BLOCK", &LENS_TILES_PER_BLOCK),
        ("BLOCK_COUNT", &BLOCK_COUNT),
        ("MIN_SPEED", &numbers::SPEEDS.start),
        ("MAX_SPEED", &numbers::SPEEDS.end),
        ("SAMPLES", &numbers::SAMPLES),
        ("KNOWN_SAMPLES", &numbers::KNOWN_SAMPLES),
        ("EXPOSURES", &EXPOSURES),
        ("SIGMAS", &SIGMAS),
        ("TILE_SIGMAS", &TILE_SIGMAS),
        ("HEAD", &HEAD),
        ("GAINS", &GAINS),
        ("TEMPER", &numbers::TEMPER),
        ("MIN_CONTRAST", &numbers::MIN_CONTRAST),
        ("MIDDLE", &numbers::MIDDLE),
        ("ALPHA", &numbers::ALPHA.0),
        ("ALPHA_STD", &numbers::ALPHA.1),
        ("ALPHAS", &numbers::ALPHAS),
        ("SHUTTER_FLOOR", &numbers::SHUTTER_FLOOR),
        ("LEAK", &numbers::LEAK),
        ("MAX_LAMBDA", &numbers::MAX_LAMBDA),
        ("STREAK_STEP", &numbers::STREAK_STEP),
        ("EXPOSURE_STEP", &numbers::EXPOSURE_STEP),
        ("STREAK_ERROR", &numbers::STREAK_ERROR),
        ("CLIP", &numbers::CLIP),
        ("INFORMATIVE", &numbers::INFORMATIVE),
        ("CORRELATED", &numbers::CORRELATED),
        ("AMPLITUDE_PRECISION", &numbers::AMPLITUDE_PRECISION),
        ("DIRECTION", &numbers::DIRECTION),
        ("EXPOSURE_NOISE_ERROR", &numbers::EXPOSURE_NOISE_ERROR.as_array()),
        ("LENS_NOISE_ERROR", &numbers::LENS_NOISE_ERROR.as_array()),
        ("PIXEL_RESPONSE", &numbers::PIXEL_RESPONSE),
        ("LARGER_BLUR", &numbers::LARGER_BLUR),
    ]);
    constants + &structs(&STRUCTS)
}

pub(crate) static TILES: LazyLock<String> = LazyLock::new(|| {
    let own = [
        include_str!("../shared.wgsl"),
        include_str!("spectral/common.wgsl"),
        include_str!("spectral/tiles.wgsl"),
    ];
    [colours(), shared(), own.concat()].concat()
});
pub(crate) static EXPOSURE: LazyLock<String> =
    LazyLock::new(|| likelihood(include_str!("spectral/exposure.wgsl")));
pub(crate) static LENS: LazyLock<String> = LazyLock::new(|| likelihood(include_str!("spectral/lens.wgsl")));

/// Joins the source of a likelihood.
fn likelihood(own: &str) -> String {
    let common = [include_str!("spectral/common.wgsl"), include_str!("spectral/likelihood.wgsl")];
    [shared(), common.concat(), own.into()].concat()
}

/// The number of values before the log-likelihood in an observation: 1 if it is valid, its block of the image, and its speed or inverse
/// depth.
pub(crate) const HEAD: usize = 3;

/// The number of values of an observation of the exposure: the head, and the clipped log-likelihood.
pub(crate) const EXPOSURE_OBSERVATION: usize = HEAD + EXPOSURES;

/// The number of values of an observation of the lens: the head, and the log-likelihood over the std.
pub(crate) const LENS_OBSERVATION: usize = HEAD + SIGMAS;

/// The number of moduli in the table of a lens's gain for each std, from 0 to 1/2 cycle per px.
pub(crate) const GAINS: usize = 128;

/// The most tiles that may be observations of the lens.
const LENS_TILES: usize = BLOCK_COUNT * LENS_TILES_PER_BLOCK;

wgsl_struct! {
    /// The frame and the camera, as all kernels read them.
    pub(crate) struct Params {
        /// Width and height of the frame, px.
        size: [u32; 2],
        /// 1 if blur acts on light, 0 if it acts on encoded values.
        linear_light: u32,
        /// 1 if there is flow.
        has_flow: u32,
        /// 1 if there is inverse depth.
        has_depth: u32,
        /// The exposure fraction with which the lens is fitted, 0 to 1.
        exposure: f32,
        /// The amount and the radius, px, of the camera's unsharp mask.
        sharpening: [f32; 2],
        /// For each resolution: the number of tiles across and down, the index of the first tile, and that of the first pixel in the buffer
        /// of light. The coarsest resolutions may have no tiles.
        levels: [[u32; 4]; LEVELS],
        /// For each pyramid level: the slope of the noise std over luma, the noise std at luma 0, the level's variance of white noise of
        /// std 1; then 0.
        noise: [[f32; 4]; NOISE_LEVELS],
        /// The variance of luma of a coder's errors against which tiles are noise-padded: for the exposure, and for the lens.
        coding: [f32; 2],
        /// Unused.
        padding: [u32; 2],
    }
}

wgsl_struct! {
    /// The properties of a tile on which its likelihoods depend.
    pub(crate) struct Tile {
        /// The motion, px of the tile per frame interval.
        motion: [f32; 2],
        /// The length of the motion, px of the tile per frame interval.
        speed: f32,
        /// The inverse depth, in the unit of the depth map.
        inverse_depth: f32,
        /// The means of luma^2, luma and 1 over the tile, times the variance of the noise of light over that of luma.
        noise_moments: [f32; 3],
        /// The sum of the flags in common.wgsl that are true.
        flags: u32,
        /// The top left corner, px of the tile's resolution.
        corner: [u32; 2],
        /// The index of the block of the image in which the tile lies.
        block: u32,
        /// The px of the frame per px of the tile, each way: 1, 2, 4 or 8.
        scale: f32,
    }
}

/// The observations of exposure and defocus in the tiles of a frame. [`blindaug::fit::spectral::exposure_of`] and
/// [`blindaug::fit::spectral::lens_of`] fit the exposure and the lens to those of many frames, and
/// [`blindaug::fit::track::Tracker::push_with`] follows them over time.
pub use blindaug::fit::track::TileObservations as Observations;

/// Looks at the frame in a texture, with the motion and the inverse depth where they are known: it makes its tiles' periodograms and their
/// likelihoods over exposure and defocus. It does what [`blindaug::fit::spectral::tiles`], [`blindaug::fit::spectral::fit_exposure`] and
/// [`blindaug::fit::spectral::fit_lens`] do, except for the fit to all tiles together.
#[derive(Debug)]
pub struct TileEvidence {
    params: wgpu::Buffer,
    /// The values of `params` that stay the same from frame to frame.
    frame: Params,
    /// The kernels for light, motion and depth, periodograms, choice, exposure and lens; there are none for a frame that is smaller than a
    /// tile.
    stages: Vec<Stage>,
    observations: Readback,
}

impl TileEvidence {
    /// Takes display-encoded frames of 3 channels or more, motion in px per frame interval (NaN where it is unknown; best the motion at the
    /// frame's own time, [`blindaug::analysis::flow::motion_at_frame`]) and inverse depth (NaN where it is unknown). It takes the first
    /// layer of each texture. Without motion there are no observations of the exposure, without inverse depth none of the lens.
    ///
    /// # Errors
    /// If the textures differ in size, or the device cannot hold the buffers for a frame as large.
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Texture,
        flow: Option<&wgpu::Texture>,
        inverse_depth: Option<&wgpu::Texture>,
        space: BlurSpace,
    ) -> Result<Self> {
        let (or_flow, or_depth) = (flow.unwrap_or(frame), inverse_depth.unwrap_or(frame));
        let size = common_size(&[frame, or_flow, or_depth])?;
        let (mut levels, [mut count, mut pixels]) = ([[0; 4]; LEVELS], [0; 2]);
        let mut sizes = spectral::levels((size[0] as usize, size[1] as usize));
        for level in &mut levels {
            let (w, h) = sizes.next().unwrap_or_default();
            let [across, down] = tiles([w as u32, h as u32]);
            *level = [across, down, count, pixels];
            (count, pixels) = (count + across * down, pixels + (w * h) as u32);
        }
        let (count, pixels) = (count as usize, pixels as usize);
        let limits = device.limits();
        let largest = 4 * (count * COLUMNS * TILE).max(pixels);
        if largest as u64 > limits.max_storage_buffer_binding_size
            || count > limits.max_compute_workgroups_per_dimension as usize
        {
            return Err(Error::new(format!(
                "the spectra of {} x {} pixels are more than this graphics device can hold; use smaller frames",
                size[0], size[1]
            )));
        }
        let params = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("spectral fit"),
            size: size_of::<Params>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let observations = Readback::new(
            device,
            "observations",
            EXPOSURE_TILES * EXPOSURE_OBSERVATION + LENS_TILES * LENS_OBSERVATION,
        );
        let flags = [space == BlurSpace::Linear, flow.is_some(), inverse_depth.is_some()];
        let [linear_light, has_flow, has_depth] = flags.map(u32::from);
        let fixed = Params { size, linear_light, has_flow, has_depth, levels, ..Params::default() };
        let stages = if count == 0 {
            vec![]
        } else {
            let views = [frame, or_flow, or_depth].map(array_view);
            stages(device, (size, count, pixels), &params, &views, &observations.source)
        };
        Ok(Self { params, frame: fixed, stages, observations })
    }

    /// Starts to look at the textures as they are now, given the noise, the exposure so far (for the lens; 0 if it is unknown) and the
    /// camera's sharpening. It returns `false` and does nothing as long as the last result has not been picked up.
    pub fn submit(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        noise: &LumaNoise,
        exposure: ExposureFraction,
        sharpening: Option<&SharpeningModel>,
    ) -> bool {
        if !self.observations.is_idle() {
            return false;
        }
        let white = white_band_std();
        let params = Params {
            exposure: exposure.0,
            sharpening: sharpening.map_or([0.0; 2], |s| [s.amount, s.radius_px]),
            noise: std::array::from_fn(|l| {
                let NoiseLine { slope, intercept } = noise.levels[l];
                [slope, intercept, white[l] * white[l], 0.0]
            }),
            coding: [1.0, CODING_OF_LENS].map(|share| (share * noise.coding_error).powi(2)),
            ..self.frame
        };
        queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        self.observations.submit(device, queue, "spectral fit", |pass| {
            self.stages.iter().for_each(|s| s.run(pass));
        });
        true
    }

    /// Gives the observations of the tiles once they are known; until then `None`.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<Option<Observations>> {
        self.observations.poll(device, |values| {
            let mut out = Observations::default();
            if self.stages.is_empty() {
                return out;
            }
            let (exposure, lens) = values.split_at(EXPOSURE_TILES * EXPOSURE_OBSERVATION);
            for observation in exposure.chunks_exact(EXPOSURE_OBSERVATION).filter(|w| w[0] > 0.0) {
                let (block, speed, log_likelihood) =
                    (observation[1] as u32, observation[2], observation[HEAD..].to_vec());
                out.exposure.push(ExposureObservation {
                    block,
                    frame: 0,
                    speed,
                    speed_error: 0.0,
                    log_likelihood,
                });
            }
            for observation in lens.chunks_exact(LENS_OBSERVATION).filter(|w| w[0] > 0.0) {
                let (block, inverse_depth, table) =
                    (observation[1] as u32, observation[2], observation[HEAD..].to_vec());
                out.lens.push(LensObservation { inverse_depth, table, tiles: 1.0, block, part: 0 });
            }
            out
        })
    }
}

/// The number of tiles across and down, which overlap by half.
fn tiles([w, h]: [u32; 2]) -> [u32; 2] {
    let tile = TILE as u32;
    if w < tile || h < tile { [0; 2] } else { [w, h].map(|v| (v - tile) / (tile / 2) + 1) }
}

// This function is long, since it lists the kernels with their bindings in order.
fn stages(
    device: &wgpu::Device,
    (size, count, pixels): ([u32; 2], usize, usize),
    params: &wgpu::Buffer,
    [frame, flow, inverse_depth]: &[wgpu::TextureView; 3],
    observations: &wgpu::Buffer,
) -> Vec<Stage> {
    let params = uniform(params);
    let light = storage(device, "light", 4 * pixels);
    let tiles = storage(device, "tiles", size_of::<Tile>() * count);
    let periodograms = storage(device, "periodograms", 4 * COLUMNS * TILE * count);
    let contrasts = storage(device, "contrasts", 4 * count);
    let chosen = storage(device, "chosen tiles", 4 * (EXPOSURE_TILES + LENS_TILES));
    let table = |label, contents: &[f32]| filled(device, label, contents, BufferUsages::STORAGE);
    let turn = |i: usize| (std::f64::consts::TAU * i as f64 / TILE as f64).sin_cos();
    let window: Vec<f32> = (hann().iter().enumerate())
        .flat_map(|(i, &w)| [w, turn(i).0 as f32, turn(i).1 as f32, 0.0])
        .collect();
    let window = table("window", &window);
    let ring = |modulus: f32| (modulus * TILE as f32) as usize;
    let mut by_ring = frequencies().to_vec();
    by_ring.sort_by_key(|f| ring(f.modulus));
    let starts: Vec<u32> =
        (0..=COLUMNS).map(|r| by_ring.partition_point(|f| ring(f.modulus) < r) as u32).collect();
    let rings = filled(device, "rings", &starts, BufferUsages::STORAGE);
    let by_ring: Vec<f32> = by_ring.iter().flat_map(|f| [f.x, f.y, f.modulus, f.at as f32]).collect();
    let by_ring = table("frequencies", &by_ring);
    let gains: Vec<f32> = (0..TILE_SIGMAS * GAINS)
        .map(|i| lens_gain(i / GAINS, 0.5 * (i % GAINS) as f32 / GAINS as f32))
        .collect();
    let gains = table("lenses", &gains);
    let shared = [
        params.clone(),
        read(&tiles),
        read(&chosen),
        read(&periodograms),
        read(&by_ring),
        read(&rings),
        write(observations),
    ];
    let lens: Vec<_> = shared.iter().cloned().chain([read(&gains)]).collect();
    let of_each = |threads: usize, n: usize| [(threads * n) as u32, 1, 1];
    vec![
        Stage::new(
            device,
            &TILES,
            "light",
            [8, 8, 1],
            [size[0].div_ceil(2), size[1].div_ceil(2), 1],
            &[params.clone(), view(frame), write(&light)],
        ),
        Stage::new(
            device,
            &TILES,
            "locate",
            [64, 1, 1],
            of_each(64, count),
            &[params.clone(), view(frame), view(flow), view(inverse_depth), write(&tiles)],
        ),
        Stage::new(
            device,
            &TILES,
            "periodogram",
            [128, 1, 1],
            of_each(128, count),
            &[
                params.clone(),
                read(&light),
                read(&tiles),
                read(&window),
                read(&by_ring),
                write(&periodograms),
                write(&contrasts),
            ],
        ),
        Stage::new(
            device,
            &TILES,
            "choose",
            [64, 1, 1],
            of_each(1, count.max(EXPOSURE_TILES).max(LENS_TILES)),
            &[params, read(&contrasts), read(&tiles), write(&chosen)],
        ),
        Stage::new(device, &EXPOSURE, "exposure", [32, 1, 1], of_each(32, EXPOSURE_TILES), &shared),
        Stage::new(device, &LENS, "defocus", [48, 1, 1], of_each(48, LENS_TILES), &lens),
    ]
}
