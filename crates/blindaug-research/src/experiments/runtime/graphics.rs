//! How long a composite takes on the graphics card.

use blindaug::composite::{CompositeOptions, VirtualLayer};
use blindaug::{CameraModel, Encoded, Raster, Result};
use blindaug_gpu::{Compositor, Depth, Frame, Gpu, Inputs, Quality, Velocity, layer_views, texture};
use std::time::Instant;
use wgpu::{DeviceType, TextureFormat, TextureUsages};

/// The eyes of a headset.
const EYES: usize = 2;

/// The name of the graphics card and the durations, ms, of so many composites for two eyes, from submission to end; `None` if there is no
/// graphics card. Both eyes see the same.
///
/// # Errors
/// If the layer has no depth or motion, sizes differ, or the card cannot hold textures as large.
pub(super) fn composite(
    frame: &Encoded,
    layer: &VirtualLayer,
    camera: &CameraModel,
    repetitions: usize,
) -> Result<Option<(String, Vec<f64>)>> {
    match Gpu::new() {
        Ok(gpu) if gpu.info.device_type != DeviceType::Cpu => {
            let ms = composite_on(&gpu, frame, layer, camera, repetitions)?;
            Ok(Some((gpu.info.name.clone(), ms)))
        }
        _ => Ok(None),
    }
}

fn composite_on(
    gpu: &Gpu,
    frame: &Encoded,
    layer: &VirtualLayer,
    camera: &CameraModel,
    repetitions: usize,
) -> Result<Vec<f64>> {
    const FORMAT: TextureFormat = TextureFormat::Rgba8Unorm;
    let missing = |what: &str| blindaug::Error::new(format!("the layer has no {what}"));
    let depth = layer.inverse_depth.as_ref().ok_or_else(|| missing("depth"))?;
    let motion = layer.flow.as_ref().ok_or_else(|| missing("motion"))?;
    // Where nothing is, the depth is 0, as a renderer clears it.
    let depth = depth.map(|d| if d.is_finite() { d } else { 0.0 });
    let opaque: Raster<[f32; 4]> = frame.0.map(|[r, g, b]| [r, g, b, 1.0]);
    let of_frame = gpu.upload(&[&opaque; EYES], FORMAT)?;
    let color = gpu.upload(&[&layer.color.0; EYES], TextureFormat::Rgba16Float)?;
    let depth = gpu.upload(&[&depth; EYES], TextureFormat::R16Float)?;
    let velocity = gpu.upload(&[motion; EYES], TextureFormat::Rg16Float)?;
    let (w, h) = frame.0.size();
    let target = texture(&gpu.device, "target", [w, h, EYES], FORMAT, TextureUsages::RENDER_ATTACHMENT)?;
    let targets = layer_views(&target);
    let compositor = Compositor::new(&gpu.device, &gpu.queue, FORMAT);
    let inputs = Inputs {
        frame: &of_frame,
        color: &color,
        depth: Some(Depth { texture: &depth, scale: 1.0, offset: 0.0, nothing: Some(0.0) }),
        velocity: Some(Velocity { texture: &velocity, scale: [1.0; 2] }),
        cleared: true,
        apart: false,
    };
    let bound = compositor.bind(&gpu.device, &inputs)?;
    // The first repetitions warm the card up and are not counted.
    const WARMING: u64 = 2;
    let mut all = vec![];
    for number in 0..WARMING + repetitions as u64 {
        let of_frame = Frame {
            model: camera,
            options: CompositeOptions::default(),
            quality: Quality::Medium,
            number,
            area: None,
            targets: &targets,
            frame_in_targets: false,
            timer: None,
        };
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        compositor.encode(&gpu.queue, &mut encoder, &bound, &of_frame)?;
        gpu.wait()?;
        let start = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        all.push(1000.0 * start.elapsed().as_secs_f64());
    }
    Ok(all.split_off(WARMING as usize))
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Capture, DefocusModel, Estimate};
    use blindaug::{Plane, Premultiplied};

    #[test]
    fn composites_are_timed() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let (w, h) = (64, 48);
        let inside = |x: usize, y: usize| (20..40).contains(&x) && (10..30).contains(&y);
        let frame = Encoded(Raster::filled(w, h, [0.5; 3]));
        let colour =
            Raster::from_fn(w, h, |x, y| if inside(x, y) { [0.2, 0.3, 0.4, 1.0] } else { [0.0f32; 4] });
        let layer = VirtualLayer {
            color: Premultiplied(colour),
            inverse_depth: Some(Plane::from_fn(w, h, |x, y| if inside(x, y) { 0.5 } else { f32::NAN })),
            flow: Some(Raster::filled(w, h, [2.0, 0.0])),
        };
        let capture = Capture { width: w, height: h, fps: None, frames_used: 0, pixel_aspect: 1.0 };
        let mut camera = CameraModel::unknown(capture, "not given");
        camera.defocus = Estimate::Known(DefocusModel::given_lens(2.0, 1.0));
        let ms = composite_on(&gpu, &frame, &layer, &camera, 3).unwrap();
        assert!(ms.len() == 3 && ms.iter().all(|ms| *ms > 0.0), "{ms:?}");
        let flat = VirtualLayer { inverse_depth: None, ..layer };
        assert!(composite_on(&gpu, &frame, &flat, &camera, 3).is_err());
    }
}
