//! The spectra of a frame's tiles on the graphics device, for the estimation of exposure and lens.

use blindaug::{
    Flow, Plane, Result,
    fit::track::{TileLook, TileObservations, TileObserver},
    model::BlurSpace,
};
use blindaug_gpu::{Gpu, fit::spectral::TileEvidence, texture};
use blindaug_stage::Stage;
use wgpu::{TextureFormat, TextureUsages};

/// Looks at the tiles of frames of one size on a device.
pub struct Spectra {
    gpu: Gpu,
    frame: wgpu::Texture,
    motion: wgpu::Texture,
    inverse_depth: wgpu::Texture,
    evidence: TileEvidence,
    /// Motion and depth of frames of which they are unknown.
    unknown: (Flow, Plane),
    failed: bool,
}

impl Spectra {
    /// The device of a stage, if it is a real one and can hold the spectra: a program that plays a graphics device is slower than the
    /// estimation on the processor itself.
    pub fn of(stage: &Stage, size: (usize, usize)) -> Option<Self> {
        if stage.slow().is_some() {
            return None;
        }
        Self::new(stage.gpu().clone(), size).ok()
    }

    fn new(gpu: Gpu, size @ (w, h): (usize, usize)) -> Result<Self> {
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
        let made = |label, format| texture(&gpu.device, label, [w, h, 1], format, usage);
        let frame = made("frame", TextureFormat::Rgba8Unorm)?;
        let motion = made("motion", TextureFormat::Rg32Float)?;
        let inverse_depth = made("inverse depth", TextureFormat::R32Float)?;
        let evidence =
            TileEvidence::new(&gpu.device, &frame, Some(&motion), Some(&inverse_depth), BlurSpace::Linear)?;
        let (w, h) = size;
        let unknown = (Flow::filled(w, h, [f32::NAN; 2]), Plane::filled(w, h, f32::NAN));
        Ok(Self { gpu, frame, motion, inverse_depth, evidence, unknown, failed: false })
    }

    /// Whether the device still works. Where it does not, a frame's tiles say nothing.
    pub fn works(&self) -> bool {
        !self.failed
    }

    fn look(&mut self, look: &TileLook) -> Result<TileObservations> {
        let (motion, inverse_depth) = &self.unknown;
        self.gpu.write(&self.frame, &[&look.frame.0.map(|[r, g, b]| [r, g, b, 1.0])]);
        self.gpu.write(&self.motion, &[look.motion.unwrap_or(motion)]);
        self.gpu.write(&self.inverse_depth, &[look.inverse_depth.unwrap_or(inverse_depth)]);
        let Gpu { device, queue, .. } = &self.gpu;
        self.evidence.submit(device, queue, look.noise, look.exposure, look.sharpening);
        self.gpu.wait()?;
        Ok(self.evidence.poll(device)?.unwrap_or_default())
    }
}

impl TileObserver for Spectra {
    fn observe(&mut self, look: &TileLook) -> Result<TileObservations> {
        if look.motion.is_none() && look.inverse_depth.is_none() {
            return Ok(TileObservations::default());
        }
        // A lost device ends the drawing, too, which then begins anew on another one; until then, the processor estimates.
        Ok(self.look(look).unwrap_or_else(|_| {
            self.failed = true;
            TileObservations::default()
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::{Encoded, Raster, Transfer};
    use blindaug_pipeline::{
        MemoryClip,
        live::{Home, LiveEstimator, Loop, Pinhole},
    };
    use glam::DVec2;

    const SIZE: (usize, usize) = (192, 144);
    /// The motion, px per frame.
    const SPEED: f32 = 7.0;

    /// A value in [0, 1) of a lattice of cells of this many px, between which it is interpolated.
    fn lattice(x: f32, y: f32, cell: f32) -> f32 {
        let hash = |i: i32, j: i32| {
            let mut v =
                (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b) ^ cell.to_bits();
            v = (v ^ (v >> 15)).wrapping_mul(0x2c1b_3c6d);
            v = (v ^ (v >> 12)).wrapping_mul(0x297a_2d39);
            ((v ^ (v >> 15)) >> 8) as f32 / 16_777_216.0
        };
        let (x, y) = (x / cell, y / cell);
        let (i, j) = (x.floor(), y.floor());
        let (a, b) = (x - i, y - j);
        let row = |j| (1.0 - a) * hash(i as i32, j) + a * hash(i as i32 + 1, j);
        (1.0 - b) * row(j as i32) + b * row(j as i32 + 1)
    }

    /// A wall of a texture with detail of all sizes that passes by, filmed with this exposure fraction.
    fn filmed(exposure: f32) -> MemoryClip {
        let light = |x: f32, y: f32| {
            let octaves = [1.0f32, 2.0, 4.0, 8.0, 16.0, 32.0];
            0.02 + 0.25 * octaves.map(|c| c.sqrt() * lattice(x, y, c)).iter().sum::<f32>() / 6.0
        };
        let frame = |t: usize| {
            Encoded(Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
                const TIMES: usize = 24;
                let times = (0..TIMES).map(|s| t as f32 + exposure * ((s as f32 + 0.5) / TIMES as f32 - 0.5));
                let sum: f32 = times.map(|t| light(x as f32 - SPEED * t, y as f32)).sum();
                let noise = 0.01 * (lattice(x as f32, y as f32, 1.0 + t as f32 * 1e-3) - 0.5);
                [Transfer::Srgb.encode(sum / TIMES as f32) + noise; 3]
            }))
        };
        MemoryClip { frames: (0..10).map(frame).collect(), fps: None }
    }

    /// The exposure after all frames of a clip.
    fn exposure(clip: &MemoryClip, mut spectra: Option<&mut Spectra>) -> f32 {
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let mut estimation = LiveEstimator::new(Pinhole::new(SIZE, 50.0), home, None);
        let mut frames = Loop::new(clip);
        let estimates = clip.frames.iter().map(|_| {
            let shot = frames.next_frame().unwrap().unwrap();
            let observer = spectra.as_deref_mut().map(|s| s as &mut dyn TileObserver);
            estimation.push(&shot, home, observer).unwrap()
        });
        let last = estimates.last().unwrap();
        last.camera.motion_blur.known().expect("the exposure is known").exposure.0
    }

    #[test]
    fn the_device_finds_the_exposure_that_the_processor_finds() {
        // A software device is used here, too, which `Spectra::of` would leave out.
        let Some(gpu) = Gpu::for_tests() else { return };
        let found = [0.25, 0.75].map(|truth| {
            let clip = filmed(truth);
            let mut spectra = Spectra::new(gpu.clone(), SIZE).unwrap();
            let (device, processor) = (exposure(&clip, Some(&mut spectra)), exposure(&clip, None));
            println!("exposure {truth}: {device} on the device, {processor} on the processor");
            assert!(spectra.works());
            assert!((device - processor).abs() < 0.1, "{device} {processor}");
            device
        });
        // Negative control: the two shutters are told apart.
        assert!(found[1] - found[0] > 0.2, "{found:?}");
    }

    #[test]
    fn where_the_device_is_lost_the_processor_goes_on() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let mut spectra = Spectra::new(gpu.clone(), SIZE).unwrap();
        gpu.device.on_uncaptured_error(std::sync::Arc::new(|_| {}));
        gpu.device.destroy();
        let clip = filmed(0.5);
        let frame = &clip.frames[0];
        let motion = Flow::filled(SIZE.0, SIZE.1, [SPEED, 0.0]);
        let found = spectra.observe(&TileLook {
            frame,
            motion: Some(&motion),
            inverse_depth: None,
            noise: &Default::default(),
            exposure: Default::default(),
            sharpening: None,
        });
        assert!(found.unwrap().exposure.is_empty() && !spectra.works());
    }
}
