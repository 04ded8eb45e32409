//! Exposure from a frame and its version without motion blur: the paper's search, made continuous.

use super::{Readback, Stage, common_size, filled, read, storage, uniform, view, write};
use crate::gpu::array_view;
use crate::layout::{Layout, structs, wgsl_struct};
use crate::prelude::{colours, constants};
use blindaug::Result;
use blindaug::fit::motion_blur::{BLOCK, ExposureFit, STEPS};
use blindaug::model::ExposureFraction;
use std::sync::LazyLock;
use wgpu::BufferUsages;

/// The structs of the fit of the exposure to clean frames.
pub(crate) const STRUCTS: [Layout; 2] = [Params::LAYOUT, Place::LAYOUT];

/// The WGSL declarations of the fit of the exposure to clean frames.
pub(crate) fn shared() -> String {
    constants(&[("STEPS", &STEPS), ("CURVE", &CURVE), ("BLOCK", &BLOCK)]) + &structs(&STRUCTS)
}

pub(crate) static SOURCE: LazyLock<String> = LazyLock::new(|| {
    [colours(), shared(), include_str!("../shared.wgsl").into(), include_str!("motion_blur.wgsl").into()]
        .concat()
});

/// The number of exposure fractions of the curve that comes back, evenly from 0 to 1.
pub(crate) const CURVE: usize = 51;

/// The approximate number of cells of an image, each of which holds one place at most; the same as in `places_of_contrast` of blindaug.
const MAX_PLACES: f32 = 8000.0;

/// The distance of the outermost cells from the image's edges, px.
const MARGIN: usize = 10;

/// The least number of places that gives an exposure.
const MIN_PLACES: usize = 200;

wgsl_struct! {
    /// The image and its cells, as the kernels read them.
    pub(crate) struct Params {
        /// Width and height of the images, px.
        size: [u32; 2],
        /// The number of cells across and down; each holds one place at most.
        cells: [u32; 2],
        /// The side of a cell, px.
        cell: u32,
        /// The distance of the outermost cells from the image's edges, px.
        margin: u32,
    }
}

wgsl_struct! {
    /// A place of contrast, and the target's value there.
    pub(crate) struct Place {
        /// The position of the place, px; x is -1 if the cell has no place.
        at: [f32; 2],
        /// The target's value at the place.
        observed: f32,
        /// The inverse std of the target's noise.
        weight: f32,
    }
}

/// Searches for the exposure fraction for which the sharp image, blurred along the flow, is closest to the target, as
/// [`blindaug::fit::motion_blur::fit_exposure`] does.
#[derive(Debug)]
pub struct ExposureSearch {
    /// The kernels that find places, predict and search; there are none for an image with too few cells.
    stages: Vec<Stage>,
    found: Readback,
}

impl ExposureSearch {
    /// Makes a search in `target`, the frame without noise, and `sharp`, both in the space in which blur acts, given the inverse std of the
    /// target's noise and the flow to the next frame, px (NaN where it is unknown). It takes the first layer of each texture, and of all
    /// but the flow the red channel.
    ///
    /// # Errors
    /// If the textures differ in size.
    pub fn new(
        device: &wgpu::Device,
        target: &wgpu::Texture,
        inverse_std: &wgpu::Texture,
        sharp: &wgpu::Texture,
        flow: &wgpu::Texture,
    ) -> Result<Self> {
        let size = common_size(&[target, inverse_std, sharp, flow])?;
        let found = Readback::new(device, "what the search found", 4 + CURVE + 1);
        let [w, h] = size.map(|v| v as usize);
        let cell = ((w * h) as f32 / MAX_PLACES).sqrt().ceil().max(2.0) as usize;
        let cells = [w, h].map(|v| v.saturating_sub(2 * MARGIN) / cell);
        let [columns, rows] = cells.map(|v| v as u32);
        let count = cells[0] * cells[1];
        if count < MIN_PLACES {
            return Ok(Self { stages: vec![], found });
        }
        let params = Params { size, cells: [columns, rows], cell: cell as u32, margin: MARGIN as u32 };
        let params = filled(device, "search", &[params], BufferUsages::UNIFORM);
        let places = storage(device, "places", size_of::<Place>() * count);
        let predictions = storage(device, "predictions", 4 * STEPS * count);
        let [target, inverse_std, sharp, flow] = [target, inverse_std, sharp, flow].map(array_view);
        let params = uniform(&params);
        let stages = vec![
            Stage::new(
                device,
                &SOURCE,
                "places",
                [8, 8, 1],
                [columns, rows, 1],
                &[
                    params.clone(),
                    view(&sharp),
                    view(&flow),
                    view(&target),
                    view(&inverse_std),
                    write(&places),
                ],
            ),
            Stage::new(
                device,
                &SOURCE,
                "predict",
                [64, 1, 1],
                [STEPS as u32 * columns, rows, 1],
                &[params.clone(), view(&sharp), view(&flow), read(&places), write(&predictions)],
            ),
            Stage::new(
                device,
                &SOURCE,
                "search",
                [128, 1, 1],
                [128, 1, 1],
                &[params, read(&places), read(&predictions), write(&found.source)],
            ),
        ];
        Ok(Self { stages, found })
    }

    /// Starts a search in the textures as they are now. It returns `false` and does nothing as long as the last result has not been picked
    /// up.
    pub fn submit(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) -> bool {
        if !self.found.is_idle() {
            return false;
        }
        self.found.submit(device, queue, "exposure search", |pass| {
            self.stages.iter().for_each(|s| s.run(pass));
        });
        true
    }

    /// Gives the exposure, once it is known, until then `None`. `Some(None)` says that nothing with texture moves.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<Option<Option<ExposureFit>>> {
        self.found.poll(device, |found| {
            let (lambda, samples, information, variance) = (found[0], found[1], found[2], found[3]);
            let (curve, max) = (&found[4..4 + CURVE], found[4 + CURVE]);
            let step = 1.0 / (CURVE - 1) as f32;
            (samples >= MIN_PLACES as f32).then(|| ExposureFit {
                exposure: ExposureFraction(lambda),
                variance: if information > 0.0 {
                    f64::from(variance) / f64::from(information).powi(2)
                } else {
                    f64::INFINITY
                },
                samples: samples as usize,
                curve: curve.iter().enumerate().map(|(i, v)| [i as f32 * step, v - max]).collect(),
            })
        })
    }
}
