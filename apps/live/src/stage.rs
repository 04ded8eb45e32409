//! Everything that is drawn on one device: the object, both composites, and the picture of the two under a split line.

use super::{
    compositor::Compositor,
    object::Object,
    render::{Light, Moment, Renderer, attachment},
};
use blindaug::{Encoded, Error, Result, Transfer, composite::CompositeOptions, luma};
use blindaug_gpu::{Gpu, Quality, bind, full_screen, texture};
use blindaug_pipeline::live::{LiveEstimate, LiveFrame, Pinhole};
use bytemuck::bytes_of;
use glam::Vec3;
use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use wgpu::{BindingResource, BufferUsages, TextureFormat, TextureUsages, TextureView};

/// The format of composites and picture: display-encoded values, as the window takes them.
const FORMAT: TextureFormat = TextureFormat::Rgba8Unorm;
/// The strengths of the light from all sides and of that from one direction, relative to a frame's mean light.
const AMBIENT: f32 = 0.7;
const DIRECT: f32 = 1.3;
/// The step along each axis, px, between the pixels whose mean is a frame's light.
const LIGHT_STRIDE: usize = 8;

/// The look of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// The place of the line as a share of the width, in [0, 1]; left of the line the object is pasted as it is.
    pub split: f32,
    /// The object's longest side, m.
    pub size: f32,
    /// The options of the composite right of the line.
    pub options: CompositeOptions,
    /// The quality of both composites.
    pub quality: Quality,
}

/// The times that the parts of a picture took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// The time to draw the object.
    pub render: Duration,
    /// The time to composite the object.
    pub composite: Duration,
}

/// Draws on one device.
pub struct Stage {
    gpu: Gpu,
    /// The first error of the device, as a sentence.
    trouble: Arc<Mutex<Option<String>>>,
    renderer: Renderer,
    compositor: Compositor,
    fps: f64,
    naive: TextureView,
    filmed: TextureView,
    split: wgpu::Buffer,
    group: wgpu::BindGroup,
    join: wgpu::RenderPipeline,
    picture: wgpu::Texture,
    picture_view: TextureView,
}

impl Stage {
    /// A stage for one object and frames of one size, `fps` frames per second.
    ///
    /// # Errors
    /// If the device cannot hold the object or the frames.
    pub fn new(gpu: Gpu, object: Object, camera: Pinhole, fps: f64) -> Result<Self> {
        let trouble = Arc::new(Mutex::new(None));
        let complain = |sentence: &'static str| {
            let trouble = trouble.clone();
            move |more: &dyn std::fmt::Display| {
                let more = more.to_string();
                let why = if more.is_empty() { more } else { format!(" ({more})").replace('\n', " ") };
                if let Ok(mut trouble) = trouble.lock() {
                    trouble.get_or_insert_with(|| format!("{sentence}{why}"));
                }
            }
        };
        let lost = complain("the graphics device was lost");
        gpu.device.set_device_lost_callback(move |_, why| lost(&why));
        let failed = complain("the graphics device failed");
        gpu.device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| failed(&e)));
        let device = &gpu.device;
        let renderer = Renderer::new(&gpu, object, camera)?;
        let (w, h) = camera.size;
        let made =
            |usage| texture(device, "composite", [w, h, 1], FORMAT, usage | TextureUsages::TEXTURE_BINDING);
        let picture = made(TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC)?;
        let module = device.create_shader_module(wgpu::include_wgsl!("split.wgsl"));
        let join = full_screen(device, None, &module, "joined", &[FORMAT]);
        let split = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("split"),
            size: size_of::<[f32; 4]>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let view = |t: &wgpu::Texture| t.create_view(&Default::default());
        let naive = view(&made(TextureUsages::RENDER_ATTACHMENT)?);
        let filmed = view(&made(TextureUsages::RENDER_ATTACHMENT)?);
        let [a, b] = [&naive, &filmed].map(BindingResource::TextureView);
        let group = bind(device, &join.get_bind_group_layout(0), &[a, b, split.as_entire_binding()]);
        let picture_view = view(&picture);
        let compositor = Compositor::new(&gpu, renderer.layer(), FORMAT)?;
        Ok(Self {
            gpu,
            trouble,
            renderer,
            compositor,
            fps,
            naive,
            filmed,
            split,
            group,
            join,
            picture,
            picture_view,
        })
    }

    /// Draws the picture of a frame.
    ///
    /// # Errors
    /// If the device was lost or fails; then another stage is needed.
    pub fn draw(&self, shot: &LiveFrame, estimate: &LiveEstimate, look: &Look) -> Result<Times> {
        let start = Instant::now();
        let placed = estimate.placed_at(shot.number);
        let moment = Moment {
            poses: [placed.now, placed.next],
            seconds: shot.number as f64 / self.fps,
            step: self.fps.recip(),
            size: look.size,
            light: light(&shot.frame),
        };
        self.renderer.draw(&self.gpu, &moment);
        self.settle()?;
        let render = start.elapsed();
        let naive = CompositeOptions { naive: true, ..look.options };
        let mut targets = vec![];
        if look.split > 0.0 {
            targets.push((naive, &self.naive));
        }
        if look.split < 1.0 {
            targets.push((look.options, &self.filmed));
        }
        self.compositor.composite(&self.gpu, shot, &estimate.camera, look.quality, &targets)?;
        self.gpu.queue.write_buffer(&self.split, 0, bytes_of(&[look.split; 4]));
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("split"),
                color_attachments: &[attachment(&self.picture_view)],
                ..Default::default()
            });
            pass.set_pipeline(&self.join);
            pass.set_bind_group(0, &self.group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.settle()?;
        Ok(Times { render, composite: start.elapsed() - render })
    }

    /// Waits for the device, and checks it.
    fn settle(&self) -> Result<()> {
        self.gpu.wait()?;
        self.check()
    }

    /// Checks that the device still works.
    ///
    /// # Errors
    /// The first error of the device.
    pub fn check(&self) -> Result<()> {
        match self.trouble.lock().ok().and_then(|t| t.clone()) {
            Some(sentence) => Err(Error::new(sentence)),
            None => Ok(()),
        }
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The picture that was drawn last, display-encoded.
    pub fn picture(&self) -> &TextureView {
        &self.picture_view
    }

    /// The picture that was drawn last, copied from the device.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read(&self) -> Result<Encoded> {
        let picture = self.gpu.download::<[f32; 4]>(&self.picture)?;
        self.settle()?;
        Ok(Encoded(picture[0].map(|[r, g, b, _]| [r, g, b])))
    }
}

/// The light on the object, which is taken to be the mean light that the camera sees.
fn light(frame: &Encoded) -> Light {
    let (w, h) = frame.0.size();
    let grid =
        || (0..h).step_by(LIGHT_STRIDE).flat_map(|y| (0..w).step_by(LIGHT_STRIDE).map(move |x| (x, y)));
    let sum: Vec3 = grid().map(|(x, y)| Vec3::from(frame.0.at(x, y).map(|v| Transfer::Srgb.decode(v)))).sum();
    let mean = sum / grid().count() as f32;
    Light { ambient: AMBIENT * mean, direct: Vec3::splat(DIRECT * luma(mean.into())) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;
    use blindaug_pipeline::live::{Home, LiveEstimator};
    use glam::DVec2;

    #[test]
    fn a_lost_device_is_told_and_another_one_goes_on() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let camera = Pinhole::new((64, 48), 50.0);
        let frame = Arc::new(Encoded(Raster::from_fn(64, 48, |x, y| [0.3 + 0.005 * (x + y) as f32; 3])));
        let shot = LiveFrame { number: 1, lap: 0, frame: frame.clone(), next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let estimate = LiveEstimator::new(camera, home, None).push(&shot, home).unwrap();
        let look =
            Look { split: 0.0, size: 1.0, options: CompositeOptions::default(), quality: Quality::High };
        let stage = |gpu| Stage::new(gpu, Object::built_in(), camera, 25.0).unwrap();
        let first = stage(gpu);
        first.draw(&shot, &estimate, &look).unwrap();
        let before = first.read().unwrap();
        assert_ne!(before, *frame);
        first.gpu().device.destroy();
        let e = first.draw(&shot, &estimate, &look).unwrap_err().to_string();
        assert!(e.contains("graphics device") && !e.contains('\n'), "{e}");
        let again = stage(Gpu::new().unwrap());
        again.draw(&shot, &estimate, &look).unwrap();
        assert_eq!(again.read().unwrap(), before);
    }

    #[test]
    fn the_line_is_where_it_is_asked_for() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let camera = Pinhole::new((64, 48), 50.0);
        let frame = Arc::new(Encoded(Raster::filled(64, 48, [0.25; 3])));
        let shot = LiveFrame { number: 1, lap: 0, frame, next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let estimate = LiveEstimator::new(camera, home, None).push(&shot, home).unwrap();
        let stage = Stage::new(gpu, Object::built_in(), camera, 25.0).unwrap();
        for (split, line) in [(0.25, Some(16)), (0.0, None), (1.0, None)] {
            let look =
                Look { split, size: 0.1, options: CompositeOptions::default(), quality: Quality::High };
            stage.draw(&shot, &estimate, &look).unwrap();
            let picture = stage.read().unwrap();
            let white: Vec<usize> = (0..64).filter(|&x| picture.0.at(x, 1) == [1.0; 3]).collect();
            assert_eq!(white, line.map_or(vec![], |x: usize| vec![x - 1, x]));
        }
    }
}
