//! Everything that is drawn on one device: the object, both composites, and the picture of the two under a split line.

use crate::{
    compositor::{By, Compositor},
    object::Object,
    render::{Moment, Renderer, attachment},
};
use blindaug::{CameraModel, Encoded, Error, Result, composite::CompositeOptions};
use blindaug_gpu::{Gpu, Quality, bind, full_screen, texture};
use blindaug_pipeline::live::{LiveEstimate, LiveFrame, Pinhole};
use bytemuck::bytes_of;
use std::sync::{Arc, Mutex};
use wgpu::{BindingResource, BufferUsages, TextureFormat, TextureUsages, TextureView};

/// The format of composites and picture: display-encoded values, as the window takes them.
const FORMAT: TextureFormat = TextureFormat::Rgba8Unorm;
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

/// Draws on one device.
pub struct Stage {
    gpu: Gpu,
    /// The first error of the device, as a sentence.
    trouble: Arc<Mutex<Option<String>>>,
    renderer: Renderer,
    by: By,
    compositor: Compositor,
    fps: f64,
    naive: wgpu::Texture,
    filmed: wgpu::Texture,
    split: wgpu::Buffer,
    group: wgpu::BindGroup,
    join: wgpu::RenderPipeline,
    picture: wgpu::Texture,
    picture_view: TextureView,
}

impl Stage {
    /// A stage for one object and frames of one size, `fps` frames per second. The object is composited by the device, or by the processor
    /// where that is faster.
    ///
    /// # Errors
    /// If the device cannot hold the object or the frames.
    pub fn new(gpu: Gpu, object: Object, camera: Pinhole, fps: f64) -> Result<Self> {
        let by = By::fastest(&gpu.info);
        Self::composited_by(by, gpu, object, camera, fps)
    }

    fn composited_by(by: By, gpu: Gpu, object: Object, camera: Pinhole, fps: f64) -> Result<Self> {
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
        let naive =
            made(TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_DST | TextureUsages::COPY_SRC)?;
        let filmed =
            made(TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_DST | TextureUsages::COPY_SRC)?;
        let [a, b] = [&naive, &filmed].map(view);
        let [a, b] = [&a, &b].map(BindingResource::TextureView);
        let group = bind(device, &join.get_bind_group_layout(0), &[a, b, split.as_entire_binding()]);
        let picture_view = view(&picture);
        let compositor = Compositor::new(&gpu, by, renderer.layer(), FORMAT)?;
        Ok(Self {
            gpu,
            trouble,
            renderer,
            by,
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
    pub fn draw(&self, shot: &LiveFrame, estimate: &LiveEstimate, look: &Look) -> Result<()> {
        self.render(shot, estimate, look)?;
        self.composite(shot, estimate, look)
    }

    /// Draws the object in a frame: the first half of [`Stage::draw`].
    ///
    /// # Errors
    /// The same as [`Stage::draw`].
    pub fn render(&self, shot: &LiveFrame, estimate: &LiveEstimate, look: &Look) -> Result<()> {
        let moment = Moment::of(shot, estimate, look.size, self.fps);
        self.renderer.draw(&self.gpu, &moment);
        self.settle()
    }

    /// Composites the object that was rendered over the frame, and makes the picture: the second half of [`Stage::draw`].
    ///
    /// # Errors
    /// The same as [`Stage::draw`].
    pub fn composite(&self, shot: &LiveFrame, estimate: &LiveEstimate, look: &Look) -> Result<()> {
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
        self.settle()
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

    /// A sentence for people where the object is composited by the processor, without a full stop.
    pub fn slow(&self) -> Option<String> {
        (self.by == By::Processor).then(|| {
            format!(
                "there is no graphics card here, only {}: the processor composites the object, and estimates",
                self.gpu.info.name
            )
        })
    }

    /// A sentence for people where the device shapes out-of-focus points otherwise than the camera, without a full stop.
    pub fn rounded(&self, camera: &CameraModel, look: &Look) -> Option<String> {
        (self.by == By::Device).then(|| blindaug_gpu::rounded(camera, &look.options)).flatten()
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The frame with the object pasted on it, and the frame with the object as the camera would have filmed it, as they were drawn last;
    /// display-encoded.
    pub fn composites(&self) -> [&wgpu::Texture; 2] {
        [&self.naive, &self.filmed]
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

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::{
        Raster,
        model::{DefocusModel, Estimate, ExposureFraction, MotionBlurModel},
    };
    use blindaug_pipeline::live::{Home, LiveEstimator};
    use glam::DVec2;
    use std::time::Instant;

    #[test]
    fn a_lost_device_is_told_and_another_one_goes_on() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let camera = Pinhole::new((64, 48), 50.0);
        let frame = Arc::new(Encoded(Raster::from_fn(64, 48, |x, y| [0.3 + 0.005 * (x + y) as f32; 3])));
        let shot = LiveFrame { number: 1, lap: 0, frame: frame.clone(), next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let estimate = LiveEstimator::new(camera, home, None).push(&shot, home, None).unwrap();
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
    fn device_and_processor_composite_alike() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let (w, h) = (160, 120);
        let camera = Pinhole::new((w, h), 50.0);
        let frame = Arc::new(Encoded(Raster::from_fn(w, h, |x, y| [0.2 + 0.003 * (x + y) as f32, 0.4, 0.3])));
        let shot = LiveFrame { number: 3, lap: 0, frame, next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let mut estimate = LiveEstimator::new(camera, home, None).push(&shot, home, None).unwrap();
        estimate.camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.6)));
        estimate.camera.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 1.0));
        let options = CompositeOptions { no_noise: true, ..Default::default() };
        let drawn = |by, options, split| {
            let stage = Stage::composited_by(by, gpu.clone(), Object::built_in(), camera, 25.0).unwrap();
            stage
                .draw(&shot, &estimate, &Look { split, size: 1.0, options, quality: Quality::High })
                .unwrap();
            assert_eq!(stage.slow().is_some(), by == By::Processor);
            stage.read().unwrap()
        };
        let rms = |a: &Encoded, b: &Encoded| {
            let squares =
                a.0.data().iter().flatten().zip(b.0.data().iter().flatten()).map(|(a, b)| (a - b).powi(2));
            (squares.sum::<f32>() / (3 * w * h) as f32).sqrt()
        };
        for split in [0.0, 1.0] {
            let [device, processor] = [By::Device, By::Processor].map(|by| drawn(by, options, split));
            let apart = rms(&device, &processor);
            // Half a step of 8 bits on either side, and the tolerance of the passes (docs/gpu.md).
            assert!(apart < 0.004, "{apart}");
            // Negative control: the pasted object is another picture.
            let pasted = drawn(By::Processor, options, 1.0 - split);
            assert!(rms(&device, &pasted) > 2.0 * 0.004, "{}", rms(&device, &pasted));
        }
        assert_eq!(By::fastest(&gpu.info) == By::Processor, gpu.info.device_type == wgpu::DeviceType::Cpu);
    }

    #[test]
    #[ignore = "it measures: cargo test -p blindaug-stage what_a_picture_costs -- --ignored --nocapture"]
    fn what_a_picture_costs() {
        let gpu = Gpu::new().unwrap();
        let (w, h) = (1296, 720);
        let camera = Pinhole::new((w, h), 50.0);
        let frame =
            Arc::new(Encoded(Raster::from_fn(w, h, |x, y| [0.2 + 0.0003 * (x + y) as f32, 0.4, 0.3])));
        let shot = LiveFrame { number: 3, lap: 0, frame, next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.75), distance: 2.0 };
        let mut estimate = LiveEstimator::new(camera, home, None).push(&shot, home, None).unwrap();
        estimate.camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
        estimate.camera.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 1.0));
        let size = (0.5 * home.distance * h as f64 / camera.focal_length) as f32;
        let look = Look { split: 0.5, size, options: CompositeOptions::default(), quality: Quality::High };
        for by in [By::Device, By::Processor] {
            let stage = Stage::composited_by(by, gpu.clone(), Object::built_in(), camera, 25.0).unwrap();
            // The first picture also makes what later ones use again.
            let mut times = [(); 4].map(|()| {
                let start = Instant::now();
                stage.render(&shot, &estimate, &look).unwrap();
                let rendered = start.elapsed();
                stage.composite(&shot, &estimate, &look).unwrap();
                [start.elapsed() - rendered, rendered]
            });
            times.sort();
            let [composite, render] = times[1].map(|t| 1e3 * t.as_secs_f64());
            println!("{}, {by:?}: render {render:.1} ms, composite {composite:.1} ms", gpu.info.name);
        }
    }

    #[test]
    fn the_line_is_where_it_is_asked_for() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let camera = Pinhole::new((64, 48), 50.0);
        let frame = Arc::new(Encoded(Raster::filled(64, 48, [0.25; 3])));
        let shot = LiveFrame { number: 1, lap: 0, frame, next: None, previous: None };
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let estimate = LiveEstimator::new(camera, home, None).push(&shot, home, None).unwrap();
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
