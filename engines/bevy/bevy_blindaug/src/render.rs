//! The compositor in Bevy's renderer: it runs on Bevy's device, in the command encoder of the view.

use crate::matched::{CameraInUse, MatchedCamera};
use bevy::camera::{Camera, Camera3d};
use bevy::core_pipeline::prepass::ViewPrepassTextures;
use bevy::core_pipeline::tonemapping::tonemapping;
use bevy::core_pipeline::{Core3d, Core3dSystems};
use bevy::ecs::query::QueryItem;
use bevy::math::Mat4;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::extract_component::{ExtractComponent, ExtractComponentPlugin};
use bevy::render::render_asset::RenderAssets;
use bevy::render::renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery};
use bevy::render::sync_component::SyncComponent;
use bevy::render::texture::GpuImage;
use bevy::render::view::{ExtractedView, ViewTarget};
use bevy::render::{Render, RenderApp, RenderStartup, RenderSystems};
use blindaug::CameraModel;
use blindaug::composite::CompositeOptions;
use blindaug::model::Capture;
use blindaug_gpu::{Bound, Compositor, Depth, Frame, Inputs, Quality, Velocity, bind, full_screen, rounded};
use std::sync::Arc;
use wgpu::{BindingResource, TextureFormat, TextureUsages};

/// The format of views that are composited: that of Bevy's cameras with `Hdr`.
const VIEW: TextureFormat = TextureFormat::Rgba16Float;
/// The formats of a layer's colour, inverse depth and motion.
const LAYER: [TextureFormat; 3] = [VIEW, TextureFormat::R16Float, TextureFormat::Rg16Float];

/// The inverse depth that passes.wgsl writes where nothing is, 1/m.
const NOTHING: f32 = -1.0;

/// Adds the compositor to Bevy's renderer, if there is one.
pub(crate) fn plugin(app: &mut App) {
    app.add_plugins(ExtractComponentPlugin::<MatchedCamera>::default());
    let Some(render) = app.get_sub_app_mut(RenderApp) else { return };
    render
        .add_systems(RenderStartup, make_passes)
        .add_systems(Render, prepare.in_set(RenderSystems::PrepareResources))
        .add_systems(Core3d, composite.in_set(Core3dSystems::PostProcess).before(tonemapping));
}

/// What the renderer needs of a [`MatchedCamera`] in a frame.
#[derive(Component, Clone)]
pub struct Matching {
    model: Option<Arc<CameraModel>>,
    background: AssetId<Image>,
    background_layer: u32,
    frame: u64,
    frame_interval: f32,
    quality: Quality,
    options: CompositeOptions,
    apart: bool,
    split: f32,
}

impl SyncComponent for MatchedCamera {
    type Target = (Matching, ViewLayer);
}

impl ExtractComponent for MatchedCamera {
    type QueryData = (&'static MatchedCamera, &'static CameraInUse, &'static Camera);
    type QueryFilter = With<Camera3d>;
    type Out = Matching;

    fn extract_component((matched, in_use, camera): QueryItem<'_, '_, Self::QueryData>) -> Option<Matching> {
        camera.viewport.is_none().then(|| Matching {
            model: in_use.model.clone(),
            background: matched.background.id(),
            background_layer: matched.background_layer,
            frame: matched.frame,
            frame_interval: matched.frame_interval,
            quality: matched.quality,
            options: matched.options,
            apart: matched.apart,
            split: matched.split,
        })
    }
}

/// The passes of all views. They are made anew when Bevy makes its device anew.
#[derive(Resource)]
struct Passes {
    compositor: Compositor,
    frame: wgpu::RenderPipeline,
    gather: wgpu::RenderPipeline,
    gather_samples: wgpu::RenderPipeline,
    paste: wgpu::RenderPipeline,
    bilinear: wgpu::Sampler,
}

fn make_passes(
    mut commands: Commands,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    views: Query<Entity, With<ViewLayer>>,
) {
    for view in &views {
        commands.entity(view).remove::<ViewLayer>();
    }
    let device = device.wgpu_device();
    let module = device.create_shader_module(wgpu::include_wgsl!("passes.wgsl"));
    let pass = |fragment, targets: &[TextureFormat]| full_screen(device, None, &module, fragment, targets);
    commands.insert_resource(Passes {
        compositor: Compositor::new(device, &queue, VIEW).with_linear_output(),
        frame: pass("frame", &[TextureFormat::Rgba8UnormSrgb, VIEW]),
        gather: pass("gather", &LAYER),
        gather_samples: pass("gather_samples", &LAYER),
        paste: pass("paste", &[VIEW]),
        bilinear: device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("bilinear"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        }),
    });
}

/// The numbers of passes.wgsl, in its order.
#[derive(Clone, Copy, Default)]
struct Numbers {
    depth_map: [f32; 2],
    motion_scale: [f32; 2],
    shown_size: [f32; 2],
    shown_origin: [f32; 2],
    line: f32,
    edge: f32,
}

impl Numbers {
    /// The size of the struct, bytes.
    const BYTES: u64 = 40;

    fn bytes(self) -> Vec<u8> {
        let Self { depth_map, motion_scale, shown_size, shown_origin, line, edge } = self;
        let pairs = [depth_map, motion_scale, shown_size, shown_origin, [line, edge]];
        pairs.as_flattened().iter().flat_map(|v| v.to_ne_bytes()).collect()
    }
}

/// The textures that a view is composited from, all of the view's size. It is a component of the view in the render world.
#[derive(Component, Debug)]
pub struct ViewLayer {
    /// The frame behind, display-encoded.
    pub frame: wgpu::Texture,
    /// What was rendered: premultiplied scene-linear R, G, B, A.
    pub color: wgpu::Texture,
    /// The inverse depth of what was rendered, 1/m; infinite where it is unknown, -1 where nothing is.
    pub inverse_depth: wgpu::Texture,
    /// The motion of what was rendered to the next filmed frame, px (x right, y down); infinite where it is unknown.
    pub motion: wgpu::Texture,
    apart: bool,
    bound: Bound,
    numbers: wgpu::Buffer,
    /// The problem that was said last.
    said: std::sync::Mutex<Option<String>>,
}

impl ViewLayer {
    /// Makes the textures of a view of this size, px, and everything between the passes.
    ///
    /// # Errors
    /// If the device cannot hold them.
    fn new(device: &wgpu::Device, passes: &Passes, [w, h]: [u32; 2], apart: bool) -> blindaug::Result<Self> {
        let texture = |label, format, view_formats: &[TextureFormat]| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: w, height: h, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: TextureUsages::RENDER_ATTACHMENT
                    | TextureUsages::TEXTURE_BINDING
                    | TextureUsages::COPY_SRC,
                view_formats,
            })
        };
        let frame = texture("frame", TextureFormat::Rgba8Unorm, &[TextureFormat::Rgba8UnormSrgb]);
        let [color, inverse_depth, motion] = LAYER.map(|format| texture("layer", format, &[]));
        let inputs = Inputs {
            frame: &frame,
            color: &color,
            depth: Some(Depth { texture: &inverse_depth, scale: 1.0, offset: 0.0, nothing: Some(NOTHING) }),
            velocity: Some(Velocity { texture: &motion, scale: [1.0; 2] }),
            cleared: true,
            apart,
        };
        let bound = passes.compositor.bind(device, &inputs)?;
        let numbers = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("numbers"),
            size: Numbers::BYTES,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let said = std::sync::Mutex::default();
        Ok(Self { frame, color, inverse_depth, motion, apart, bound, numbers, said })
    }

    /// The frame's light, and a place to write it to.
    fn frame_light(&self) -> wgpu::TextureView {
        self.frame.create_view(&wgpu::TextureViewDescriptor {
            format: Some(TextureFormat::Rgba8UnormSrgb),
            ..Default::default()
        })
    }

    /// Says a problem, unless it was the last one that was said.
    fn say(&self, problem: String) {
        if let Ok(mut said) = self.said.lock()
            && said.as_ref() != Some(&problem)
        {
            warn!("{problem}");
            *said = Some(problem);
        }
    }
}

/// Makes the textures of views whose size is new.
fn prepare(
    mut commands: Commands,
    device: Res<RenderDevice>,
    passes: Option<Res<Passes>>,
    views: Query<(Entity, &Matching, &ExtractedCamera, Option<&ViewLayer>)>,
) {
    let Some(passes) = passes else { return };
    for (entity, matching, camera, layer) in &views {
        let Some(size) = camera.physical_target_size.filter(|s| s.x > 0 && s.y > 0) else { continue };
        let fits = |l: &&ViewLayer| {
            (l.frame.width(), l.frame.height()) == (size.x, size.y) && l.apart == matching.apart
        };
        if layer.filter(fits).is_some() {
            continue;
        }
        match ViewLayer::new(device.wgpu_device(), &passes, size.to_array(), matching.apart) {
            Ok(layer) => {
                commands.entity(entity).insert(layer);
            }
            Err(e) => {
                warn_once!("{e}");
                commands.entity(entity).remove::<ViewLayer>();
            }
        }
    }
}

/// The scale and the offset that make inverse depth in 1/m of a depth buffer's values; both are 0 for a projection without perspective.
fn depth_map(clip_from_view: &Mat4) -> [f32; 2] {
    // At distance D along the view axis the value is (b - a D) / D.
    let (a, b) = (clip_from_view.z_axis.z, clip_from_view.w_axis.z);
    let is_perspective = clip_from_view.z_axis.w == -1.0 && clip_from_view.w_axis.w == 0.0 && b != 0.0;
    if is_perspective { [1.0 / b, a / b] } else { [0.0; 2] }
}

/// The size and the top left corner, in shares of a frame's size, of the part that is shown where a frame covers a view.
fn shown(frame: [f32; 2], view: [f32; 2]) -> [[f32; 2]; 2] {
    let ratio = [view[0] / frame[0], view[1] / frame[1]];
    let most = ratio[0].max(ratio[1]);
    let size = ratio.map(|r| r / most);
    [size, size.map(|s| 0.5 * (1.0 - s))]
}

/// Draws a pass that covers the view, or its columns up to `columns`.
fn draw(
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &wgpu::RenderPipeline,
    group: &wgpu::BindGroup,
    targets: &[&wgpu::TextureView],
    columns: Option<(u32, u32)>,
) {
    let load = match columns {
        Some(_) => wgpu::LoadOp::Load,
        None => wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
    };
    let attachments: Vec<_> = targets
        .iter()
        .map(|view| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            })
        })
        .collect();
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("blindaug"),
        color_attachments: &attachments,
        ..Default::default()
    });
    if let Some((width, height)) = columns {
        pass.set_scissor_rect(0, 0, width, height);
    }
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.draw(0..3, 0..1);
}

/// Composites a view.
fn composite(
    view: ViewQuery<(&Matching, &ViewLayer, &ExtractedView, &ViewTarget, Option<&ViewPrepassTextures>)>,
    queue: Res<RenderQueue>,
    images: Res<RenderAssets<GpuImage>>,
    passes: Option<Res<Passes>>,
    mut ctx: RenderContext,
) {
    let (matching, layer, extracted, target, prepass) = view.into_inner();
    let (Some(passes), Some(background)) = (passes, images.get(matching.background)) else { return };
    let device = ctx.render_device().wgpu_device().clone();
    let textures = prepass.and_then(|p| Some((p.depth.as_ref()?, p.motion_vectors.as_ref()?)));
    let Some((depth, motion)) = textures.filter(|_| target.main_texture_format() == VIEW) else {
        let needs = "Hdr, DepthPrepass and MotionVectorPrepass";
        layer.say(format!(
            "a camera without {needs} is not composited; leave these components of MatchedCamera on it"
        ));
        return;
    };
    let of_background = background.texture.format().sample_type(None, Some(device.features()));
    let is_flat = background.texture.depth_or_array_layers() > matching.background_layer
        && background.texture.dimension() == wgpu::TextureDimension::D2;
    if of_background != Some(wgpu::TextureSampleType::Float { filterable: true }) || !is_flat {
        let format = background.texture.format();
        let layers = background.texture.depth_or_array_layers();
        layer.say(format!(
            "a picture of format {format:?} with {layers} layers cannot be a background; give one of Rgba8UnormSrgb \
             that has the layer MatchedCamera::background_layer"
        ));
        return;
    }

    let [w, h] = [layer.frame.width(), layer.frame.height()];
    let size = [w as f32, h as f32];
    let [shown_size, shown_origin] =
        shown([background.texture.width() as f32, background.texture.height() as f32], size);
    let edge = (matching.split.clamp(0.0, 1.0) * size[0]).round();
    let numbers = Numbers {
        depth_map: depth_map(&extracted.clip_from_view),
        motion_scale: size.map(|s| s * matching.frame_interval),
        shown_size,
        shown_origin,
        line: f32::from(edge > 0.0 && edge < size[0]),
        edge,
    };
    queue.write_buffer(&layer.numbers, 0, &numbers.bytes());

    let encoder = ctx.command_encoder();
    let view = |v| BindingResource::TextureView(v);
    let group = |pipeline: &wgpu::RenderPipeline, rest: &[BindingResource]| {
        let mut resources = vec![layer.numbers.as_entire_binding()];
        resources.extend_from_slice(rest);
        bind(&device, &pipeline.get_bind_group_layout(0), &resources)
    };
    let frame = layer.frame_light();
    let filmed = background.texture.create_view(&wgpu::TextureViewDescriptor {
        format: background.texture_view_descriptor.as_ref().and_then(|d| d.format),
        dimension: Some(wgpu::TextureViewDimension::D2),
        base_array_layer: matching.background_layer,
        array_layer_count: Some(1),
        ..Default::default()
    });
    let shown = group(&passes.frame, &[view(&filmed), BindingResource::Sampler(&passes.bilinear)]);
    // Nothing but what virtual things change is drawn over the frame's light later on.
    let write = target.post_process_write();
    let output = write.destination;
    draw(encoder, &passes.frame, &shown, &[&frame, output], None);

    let gather =
        if depth.texture.texture.sample_count() > 1 { &passes.gather_samples } else { &passes.gather };
    let sources = [write.source, &depth.texture.default_view, &motion.texture.default_view];
    let gathered = group(gather, &sources.map(|v| view(v)));
    let of_layer =
        [&layer.color, &layer.inverse_depth, &layer.motion].map(|t| t.create_view(&Default::default()));
    draw(encoder, gather, &gathered, &of_layer.each_ref(), None);

    let nothing = || {
        let capture =
            Capture { width: w as usize, height: h as usize, fps: None, frames_used: 0, pixel_aspect: 1.0 };
        CameraModel::unknown(capture, "there is no camera model")
    };
    let naive = CompositeOptions { naive: true, ..matching.options };
    let targets = [(**output).clone()];
    let mut encode = |model: &CameraModel, options| {
        let frame = Frame {
            model,
            options,
            quality: matching.quality,
            number: matching.frame,
            area: None,
            targets: &targets,
            frame_in_targets: true,
            timer: None,
        };
        passes.compositor.encode(&queue, encoder, &layer.bound, &frame)
    };
    let encoded = match &matching.model {
        Some(model) => encode(model, matching.options),
        None => encode(&nothing(), naive),
    };
    if let Err(e) = encoded {
        layer.say(format!("{e}; virtual things are shown undistorted"));
        if let Err(e) = encode(&nothing(), naive) {
            layer.say(e.to_string());
        }
    } else if let Some(sentence) = matching.model.as_ref().and_then(|model| rounded(model, &matching.options))
    {
        layer.say(sentence);
    }
    if edge > 0.0 {
        let pasted = group(&passes.paste, &[view(&of_layer[0]), view(&frame)]);
        let columns = Some(((edge as u32 + 1).min(w), h));
        draw(encoder, &passes.paste, &pasted, &[output], columns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Vec4;

    #[test]
    fn inverse_depth_is_that_of_the_projection() {
        let infinite = Mat4::perspective_infinite_reverse_rh(0.8, 1.5, 0.1);
        let finite = Mat4::perspective_rh(0.8, 1.5, 50.0, 0.1);
        for projection in [infinite, finite] {
            let [scale, offset] = depth_map(&projection);
            for distance in [0.2f32, 1.0, 7.0, 40.0] {
                let clip = projection * Vec4::new(0.3, -0.2, -distance, 1.0);
                let got = scale * clip.z / clip.w + offset;
                assert!((got * distance - 1.0).abs() < 1e-3, "{got} at {distance}");
            }
        }
        assert_eq!(depth_map(&Mat4::orthographic_rh(-1.0, 1.0, -1.0, 1.0, 10.0, 0.1)), [0.0; 2]);
        // The map of another near plane is another one.
        assert_ne!(depth_map(&infinite), depth_map(&Mat4::perspective_infinite_reverse_rh(0.8, 1.5, 0.2)));
    }

    #[test]
    fn a_frame_covers_the_view_and_loses_its_edges_alike() {
        assert_eq!(shown([640.0, 360.0], [640.0, 360.0]), [[1.0, 1.0], [0.0, 0.0]]);
        assert_eq!(shown([640.0, 360.0], [1280.0, 720.0]), [[1.0, 1.0], [0.0, 0.0]]);
        assert_eq!(shown([640.0, 360.0], [320.0, 360.0]), [[0.5, 1.0], [0.25, 0.0]]);
        assert_eq!(shown([640.0, 360.0], [640.0, 180.0]), [[1.0, 0.5], [0.0, 0.25]]);
    }
}
