//! The grain shaders that are exported to Godot, Unity and Unreal, run on a device as those engines would run them, and compared with the
//! reference synthesis on the CPU.
//!
//! The octaves that a shader reads are those of the reference's own noise of seed 0 and frame 0, continued past its edges. So a picture
//! whose corner reads the corner of the octaves has, away from its edges, the noise of [`blindaug::synth::noise`], pixel by pixel.

use blindaug::export::{Camera, Content, Target, View, grain};
use blindaug::model::{Capture, Estimate, NOISE_LEVELS, NoiseLevel, NoiseModel};
use blindaug::{CameraModel, Raster, Transfer, synth};
use blindaug_gpu::{Gpu, texture};
use half::f16;
use naga::{AddressSpace, Module, TypeInner};
use std::{path::Path, process::Command, sync::LazyLock};
use wgpu::{Features, TextureFormat, TextureUsages};

/// The largest difference from the reference, in encoded values, where the picture is smooth. Half a step of the octaves' 8 bits is
/// 0.016 std (0.0006 at the largest std here), a half float's rounding in bright light 0.0002, and a shader takes the luminance of a
/// pixel, where the reference takes that of each octave's own, coarser pixel.
const WORST: f32 = 0.002;
/// The root mean square of the same.
const RMS: f32 = 0.0003;
/// The largest root mean square where the picture is a checkerboard of squares of 8 px, as a share of that of the noise: there the luminance
/// of a pixel and that of an octave's coarser pixel, a mean over up to 8 of them and more, differ most.
const RMS_AT_EDGES: f32 = 0.2;

/// The side of pictures and octaves, px.
const SIDE: usize = grain::SIDE;
/// The pixels of a row or column in which the octaves are the reference's noise: its edges, which are not continued, are far.
const INSIDE: std::ops::Range<usize> = SIDE / 4..3 * SIDE / 4;

const TRANSFER: Transfer = Transfer::Srgb;

/// The encoded value from which on the sensor clips.
const CLIP: f32 = 0.95;

/// A camera whose noise is `scale` times as strong as that of the comparison.
fn camera(scale: f32) -> CameraModel {
    let capture = Capture { width: SIDE, height: SIDE, fps: None, frames_used: 1, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "not given");
    let levels: [NoiseLevel; NOISE_LEVELS] = std::array::from_fn(|l| {
        let share = scale * [1.0, 0.8, 0.5, 0.2][l];
        // The std of blue falls with the luminance, and is nothing above 0.75.
        let [slope, intercept] = [[0.016, 0.008, -0.024], [0.006, 0.012, 0.018]];
        NoiseLevel { slope: slope.map(|v| share * v), intercept: intercept.map(|v| share * v) }
    });
    model.noise = Estimate::Known(NoiseModel::given(levels, CLIP));
    model
}

/// Scene-linear light that half floats hold exactly, of encoded values that are given over x and y in turns of the picture's side.
fn light(encoded: impl Fn(f32, f32) -> [f32; 3] + Sync) -> Raster<[f32; 3]> {
    let turns = |i: usize| std::f32::consts::TAU * i as f32 / SIDE as f32;
    Raster::from_fn(SIDE, SIDE, |x, y| {
        encoded(turns(x), turns(y)).map(|v| f16::from_f32(TRANSFER.decode(v)).to_f32())
    })
}

/// Slow changes of brightness and colour, from black to beyond where the sensor clips.
fn smooth() -> Raster<[f32; 3]> {
    light(|x, y| {
        [0.0, 0.4, 0.9]
            .map(|c| (0.5 + 0.45 * (2.0 * x + c).sin() + 0.2 * (3.0 * y - c).cos()).clamp(0.0, 1.0))
    })
}

/// Squares of 8 px, dark ones and bright ones.
fn checkered() -> Raster<[f32; 3]> {
    let square = |v: f32| (v * SIDE as f32 / std::f32::consts::TAU / 8.0).round() as usize;
    light(|x, y| if (square(x) + square(y)).is_multiple_of(2) { [0.2, 0.15, 0.1] } else { [0.8, 0.7, 0.6] })
}

/// The channel's encoded values with the noise that the reference gives them, for octaves that begin at the picture's corner.
fn reference(model: &CameraModel, light: &Raster<[f32; 3]>, channel: usize) -> Raster<f32> {
    let noise = model.noise.known().unwrap();
    // The octaves are made of the reference's noise of R; so R gets the std of the channel that is asked for.
    let levels = noise
        .lines()
        .levels
        .map(|l| NoiseLevel { slope: [l.slope[channel]; 3], intercept: [l.intercept[channel]; 3] });
    let content = light.map(|v| v.map(|v| TRANSFER.encode(v)));
    let noisy = synth::noise::noise(&NoiseModel::given(levels, noise.clip()), &content, 0, 0);
    Raster::from_fn(SIDE, SIDE, |x, y| {
        let (v, clip) = (content.at(x, y)[channel], noise.clip());
        if v >= clip { v } else { (v + noisy.at(x, y)[0]).clamp(0.0, clip) }
    })
}

/// How far a picture lies from the reference, in encoded values.
#[derive(Debug)]
struct Difference {
    rms: f32,
    worst: f32,
}

/// Compares what a shader makes of a picture with the reference. `picture` draws it for octaves that begin at a place (x, y).
fn difference(
    model: &CameraModel,
    light: &Raster<[f32; 3]>,
    picture: impl Fn([usize; 2]) -> Raster<[f32; 4]>,
) -> Difference {
    let mut differences = vec![];
    for (channel, offset) in grain::CHANNEL_OFFSETS.into_iter().enumerate() {
        // The frame begins where this channel begins at the octaves' corner.
        let picture = picture(offset.map(|o| (SIDE - o) % SIDE));
        let want = reference(model, light, channel);
        for (x, y) in INSIDE.flat_map(|y| INSIDE.map(move |x| (x, y))) {
            // Half a step of 8 bits below where the sensor clips, the shaders take a value as clipped.
            let below = CLIP - TRANSFER.encode(light.at(x, y)[channel]);
            if (0.0..0.003).contains(&below) {
                continue;
            }
            differences.push((TRANSFER.encode(picture.at(x, y)[channel]) - want.at(x, y)).abs());
        }
    }
    let squares: f64 = differences.iter().map(|d| f64::from(*d).powi(2)).sum();
    Difference {
        rms: (squares / differences.len() as f64).sqrt() as f32,
        worst: differences.into_iter().fold(0.0, f32::max),
    }
}

/// Compares a shader with the reference, and with what it must not agree with. `picture` draws a picture for octaves that begin at a place.
fn compare(name: &str, picture: impl Fn(&Raster<[f32; 3]>, [usize; 2]) -> Raster<[f32; 4]>) {
    let (smooth, checkered) = (smooth(), checkered());
    let model = camera(1.0);
    let same = difference(&model, &smooth, |at| picture(&smooth, at));
    let edges = difference(&model, &checkered, |at| picture(&checkered, at));
    // The reference against a picture without any noise is the noise itself.
    let noise = difference(&model, &checkered, |_| checkered.map(|[r, g, b]| [r, g, b, ALPHA]));
    let share = edges.rms / noise.rms;
    println!("{name}: smooth {same:?}, edges {edges:?}, which is {share:.3} of the noise");
    assert!(same.rms < RMS && same.worst < WORST, "{name}: {same:?}");
    assert!(share < RMS_AT_EDGES, "{name}: {share}");
    // Negative controls: a camera of a tenth more noise, and octaves that are read one pixel beside.
    let other = difference(&camera(1.1), &smooth, |at| picture(&smooth, at));
    let beside = difference(&model, &smooth, |[x, y]| picture(&smooth, [(x + 1) % SIDE, y]));
    println!("{name}: another camera {other:?}, a pixel beside {beside:?}");
    for wrong in [other, beside] {
        assert!(wrong.rms > 3.0 * RMS && wrong.worst > 2.0 * WORST, "{name}: {wrong:?}");
    }
    // Alpha stays.
    let alpha =
        picture(&smooth, [0, 0]).data().iter().map(|v| v[3]).fold(0.0, |a: f32, b| a.max((b - ALPHA).abs()));
    assert_eq!(alpha, 0.0, "{name}");
}

/// The alpha of all pictures.
const ALPHA: f32 = 0.75;

/// A device that can do what Godot asks of one: push constants, and half floats that are read and written in place.
static GPU: LazyLock<Option<Gpu>> = LazyLock::new(|| {
    let found = Gpu::for_tests()?;
    let instance = Gpu::instance(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = ready(wgpu::util::initialize_adapter_from_env_or_default(&instance, None)).ok()?;
    let needed = Features::IMMEDIATES | Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
    if !adapter.features().contains(needed) {
        eprintln!("NOT TESTED: {} cannot do what Godot's shader needs", found.info.name);
        return None;
    }
    let limits = wgpu::Limits { max_immediate_size: 16, ..wgpu::Limits::default() };
    let descriptor =
        wgpu::DeviceDescriptor { required_features: needed, required_limits: limits, ..Default::default() };
    let (device, queue) = ready(adapter.request_device(&descriptor)).unwrap();
    Some(Gpu { device, queue, info: adapter.get_info() })
});

/// The result of one of wgpu's futures, which natively are done as soon as they are polled.
fn ready<T>(future: impl Future<Output = T>) -> T {
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    match std::pin::pin!(future).poll(&mut context) {
        std::task::Poll::Ready(t) => t,
        std::task::Poll::Pending => panic!("a future of wgpu was not done at once"),
    }
}

/// A picture of this light on the device.
fn uploaded(gpu: &Gpu, light: &Raster<[f32; 3]>, usage: TextureUsages) -> wgpu::Texture {
    let usage = usage | TextureUsages::COPY_DST | TextureUsages::COPY_SRC;
    let made = texture(&gpu.device, "picture", [SIDE, SIDE, 1], TextureFormat::Rgba16Float, usage).unwrap();
    gpu.write(&made, &[&light.map(|[r, g, b]| [r, g, b, ALPHA])]);
    made
}

/// The files that are exported for a camera: the text of the one of this name, and the octaves in 8 bits on the device.
fn exported(target: Target, name: &str) -> String {
    let camera = Camera::new(&camera(1.0), &View::default()).unwrap();
    let file = target.export(&camera).files.into_iter().find(|f| f.name == name);
    match file.map(|f| f.content) {
        Some(Content::Text(text)) => text,
        _ => panic!("there is no text {name}"),
    }
}

fn octaves(gpu: &Gpu, usage: TextureUsages) -> wgpu::Texture {
    let usage = usage | TextureUsages::COPY_DST;
    let made = texture(&gpu.device, "octaves", [SIDE, SIDE, 1], TextureFormat::Rgba8Unorm, usage).unwrap();
    gpu.write(&made, &[&grain::bands()]);
    made
}

fn buffer(gpu: &Gpu, numbers: &[f32]) -> wgpu::Buffer {
    let made = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: size_of_val(numbers) as u64,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&made, 0, bytemuck::cast_slice(numbers));
    made
}

fn shader(gpu: &Gpu, module: Module) -> wgpu::ShaderModule {
    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(module)),
    })
}

/// The numbers between the brackets after `name` in a script.
fn numbers(script: &str, name: &str) -> Vec<f32> {
    let rest = script.split_once(&format!("const {name} := ")).unwrap().1;
    let line = rest.lines().next().unwrap().trim_matches(['[', ']']);
    line.split(", ").map(|v| v.parse().unwrap()).collect()
}

/// What glslang makes of a text: SPIR-V, or its complaint. `None` where it is not installed, which is said.
fn glslang(name: &str, text: &str, options: &[&str]) -> Option<Result<Vec<u8>, String>> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let [source, compiled] = ["txt", "spv"].map(|e| folder.join(format!("exported-{name}.{e}")));
    std::fs::write(&source, text).unwrap();
    let ran = Command::new("glslangValidator").args(options).arg("-o").args([&compiled, &source]).output();
    match ran {
        Ok(ran) if ran.status.success() => Some(Ok(std::fs::read(&compiled).unwrap())),
        Ok(ran) => Some(Err(String::from_utf8_lossy(&ran.stdout).into_owned())),
        Err(why) => {
            eprintln!(
                "NOT TESTED: glslangValidator cannot be run ({why}); Debian: apt-get install glslang-tools"
            );
            None
        }
    }
}

fn of_spirv(spirv: &[u8]) -> Module {
    naga::front::spv::parse_u8_slice(spirv, &Default::default()).unwrap()
}

/// The GLSL of Godot's shader without the line of Godot's own, which names its stage.
fn godot_glsl() -> String {
    exported(Target::Godot, "blindaug_grain.glsl").replacen("#[compute]\n", "", 1)
}

fn compiled_by_naga(glsl: &str) -> Module {
    let options = naga::front::glsl::Options::from(naga::ShaderStage::Compute);
    naga::front::glsl::Frontend::default()
        .parse(&options, glsl)
        .unwrap_or_else(|e| panic!("{}", e.emit_to_string(glsl)))
}

/// glslang, which is Godot's own compiler.
fn compiled_by_glslang(name: &str, glsl: &str) -> Option<Result<Vec<u8>, String>> {
    glslang(name, glsl, &["-V", "--target-env", "vulkan1.0", "-S", "comp"])
}

/// Godot's compositor effect: what blindaug_grain.gd does with its shader, with the numbers that stand in that script.
struct Godot<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::ComputePipeline,
    octaves: wgpu::Texture,
    model: wgpu::Buffer,
}

impl<'a> Godot<'a> {
    fn new(gpu: &'a Gpu, module: Module) -> Self {
        let script = exported(Target::Godot, "blindaug_grain.gd");
        let of = |name| numbers(&script, name);
        let model = [of("SLOPE"), of("INTERCEPT"), of("CLIP"), vec![0.0; 3]].concat();
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &shader(gpu, module),
            entry_point: None,
            compilation_options: Default::default(),
            cache: None,
        });
        let octaves = octaves(gpu, TextureUsages::STORAGE_BINDING);
        Self { gpu, pipeline, octaves, model: buffer(gpu, &model) }
    }

    fn picture(&self, light: &Raster<[f32; 3]>, offset: [usize; 2]) -> Raster<[f32; 4]> {
        let picture = uploaded(self.gpu, light, TextureUsages::STORAGE_BINDING);
        let [a, b] = [&picture, &self.octaves].map(|t| t.create_view(&Default::default()));
        let [a, b] = [&a, &b].map(wgpu::BindingResource::TextureView);
        let layout = self.pipeline.get_bind_group_layout(0);
        let group = blindaug_gpu::bind(&self.gpu.device, &layout, &[a, b, self.model.as_entire_binding()]);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        let constants = [offset[0], offset[1], SIDE, SIDE].map(|v| v as i32);
        pass.set_immediates(0, bytemuck::cast_slice(&constants));
        pass.dispatch_workgroups(SIDE.div_ceil(8) as u32, SIDE.div_ceil(8) as u32, 1);
        drop(pass);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.download(&picture).unwrap().remove(0)
    }
}

#[test]
fn godot_s_compute_shader_makes_the_reference_s_noise() {
    let Some(gpu) = &*GPU else { return };
    let glsl = godot_glsl();
    let by_naga = Godot::new(gpu, compiled_by_naga(&glsl));
    compare("Godot's shader, by naga", |light, at| by_naga.picture(light, at));
    let Some(spirv) = compiled_by_glslang("godot", &glsl) else { return };
    let by_glslang = Godot::new(gpu, of_spirv(&spirv.unwrap()));
    compare("Godot's shader, by glslang", |light, at| by_glslang.picture(light, at));
    // Negative control: a shader that takes blue as the luminance.
    let wrong = glsl.replacen("vec3(0.299, 0.587, 0.114)", "vec3(0.0, 0.0, 1.0)", 1);
    assert!(wrong != glsl);
    let (wrong, smooth) = (Godot::new(gpu, compiled_by_naga(&wrong)), smooth());
    let wrong = difference(&camera(1.0), &smooth, |at| wrong.picture(&smooth, at));
    println!("Godot's shader with another luminance: {wrong:?}");
    assert!(wrong.rms > 3.0 * RMS && wrong.worst > 2.0 * WORST, "{wrong:?}");
}

/// The HLSL in Unity's shader.
fn unity_hlsl() -> String {
    let text = exported(Target::UnityUrp, "BlindaugGrain.shader");
    let hlsl = text.split_once("HLSLPROGRAM").and_then(|(_, rest)| rest.split_once("ENDHLSL"));
    hlsl.expect("there is HLSL in the shader").0.into()
}

/// The HLSL in the material of Unreal's script, as the engine takes the body of a function that knows the pixel and the view.
fn unreal_hlsl() -> String {
    let script = exported(Target::Unreal, "blindaug_camera.py");
    let body = script.split_once("CODE = r\"\"\"").and_then(|(_, rest)| rest.split_once("\"\"\""));
    let body = body.expect("there is HLSL in the script").0;
    format!(
        "struct Pixel {{ float4 SvPosition : SV_POSITION; }};
        struct OfView {{ uint StateFrameIndex; }};
        uniform OfView View;
        Texture2D Bands;
        Texture2D Picture;
        float3 Function(Pixel Parameters, float4 Scene) {{ {body} }}
        float4 Frag(Pixel pixel) : SV_Target
        {{
            float4 scene = Picture.Load(int3(int2(pixel.SvPosition.xy), 0));
            return float4(Function(pixel, scene), scene.a);
        }}
        Pixel Vert(uint id : SV_VertexID)
        {{
            Pixel pixel;
            pixel.SvPosition = float4(4.0 * (id & 1) - 1.0, 2.0 * (id & 2) - 1.0, 0.0, 1.0);
            return pixel;
        }}"
    )
}

const VERT: [&str; 2] = ["vert", "Vert"];
const FRAG: [&str; 2] = ["frag", "Frag"];

/// The SPIR-V of an entry point of HLSL, with stand-ins for Unity's headers.
fn compiled_hlsl(
    name: &str,
    hlsl: &str,
    [stage, entry]: [&str; 2],
    more: &[&str],
) -> Option<Result<Vec<u8>, String>> {
    let headers = concat!("-I", env!("CARGO_MANIFEST_DIR"), "/tests/unity");
    let options = [&["-D", "-V", "-S", stage, "-e", entry, headers, "--auto-map-bindings"], more].concat();
    glslang(&format!("{name}-{entry}"), hlsl, &options)
}

/// The place at which a frame reads the octaves, as both HLSL shaders draw it from two numbers (pcg2d, Jarzynski & Olano 2020).
fn frame_offset(numbers: [u32; 2]) -> [usize; 2] {
    let step = |v: u32| v.wrapping_mul(1_664_525);
    let [mut x, mut y] = numbers.map(|v| step(v).wrapping_add(1_013_904_223));
    for _ in 0..2 {
        x = x.wrapping_add(step(y));
        y = y.wrapping_add(step(x));
        (x, y) = (x ^ (x >> 16), y ^ (y >> 16));
    }
    [x, y].map(|v| v as usize % SIDE)
}

/// The first frame that reads the octaves at a place, of which one in 262144 does; `numbers` are those that the shader draws from.
fn frame_at(offset: [usize; 2], numbers: impl Fn(u32) -> [u32; 2]) -> u32 {
    (1..1 << 23).find(|i| frame_offset(numbers(*i)) == offset).expect("some frame has this offset")
}

/// A pass over the whole picture.
struct FullScreen<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::RenderPipeline,
    /// The numbers of the bindings of the octaves, the picture, the numbers of the frame, and the sampler, if there is one.
    bindings: [Option<u32>; 4],
    octaves: wgpu::Texture,
    sampler: wgpu::Sampler,
}

impl<'a> FullScreen<'a> {
    /// The pass of a text of HLSL, in which the octaves and the picture have these names. `None` where it cannot be compiled here.
    fn new(gpu: &'a Gpu, name: &str, hlsl: &str, textures: [&str; 2]) -> Option<Self> {
        let compiled = |stage| compiled_hlsl(name, hlsl, stage, &[]).map(|s| of_spirv(&s.unwrap()));
        let (vertex, fragment) = (compiled(VERT)?, compiled(FRAG)?);
        let number = |is: &dyn Fn(&naga::GlobalVariable) -> bool| {
            let found = fragment.global_variables.iter().find(|(_, v)| is(v));
            found.and_then(|(_, v)| v.binding).map(|b| b.binding)
        };
        let named = |name: &str| number(&|v| v.name.as_deref() == Some(name));
        let bindings = [
            named(textures[0]),
            named(textures[1]),
            number(&|v| v.space == AddressSpace::Uniform),
            number(&|v| matches!(fragment.types[v.ty].inner, TypeInner::Sampler { .. })),
        ];
        let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: None,
            layout: None,
            vertex: wgpu::VertexState {
                module: &shader(gpu, vertex),
                entry_point: None,
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader(gpu, fragment),
                entry_point: None,
                compilation_options: Default::default(),
                targets: &[Some(TextureFormat::Rgba16Float.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let sampler = gpu.device.create_sampler(&Default::default());
        let octaves = octaves(gpu, TextureUsages::TEXTURE_BINDING);
        Some(Self { gpu, pipeline, bindings, octaves, sampler })
    }

    fn picture(&self, values: &Raster<[f32; 3]>, of_frame: &[f32]) -> Raster<[f32; 4]> {
        let gpu = self.gpu;
        let scene = uploaded(gpu, values, TextureUsages::TEXTURE_BINDING);
        let target = uploaded(gpu, values, TextureUsages::RENDER_ATTACHMENT);
        let of_frame = buffer(gpu, of_frame);
        let [octaves, scene] = [&self.octaves, &scene].map(|t| t.create_view(&Default::default()));
        let [octaves, scene] = [&octaves, &scene].map(wgpu::BindingResource::TextureView);
        let sampler = wgpu::BindingResource::Sampler(&self.sampler);
        let resources = [octaves, scene, of_frame.as_entire_binding(), sampler];
        let entries: Vec<_> = (self.bindings.into_iter().zip(resources))
            .filter_map(|(binding, resource)| Some(wgpu::BindGroupEntry { binding: binding?, resource }))
            .collect();
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let view = target.create_view(&Default::default());
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: Default::default(),
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        gpu.download(&target).unwrap().remove(0)
    }
}

#[test]
fn unity_s_full_screen_pass_makes_the_reference_s_noise() {
    let Some(gpu) = &*GPU else { return };
    let Some(pass) = FullScreen::new(gpu, "unity", &unity_hlsl(), ["_Bands", "_BlitTexture"]) else { return };
    // Unity's _Time is (t / 20, t, 2 t, 3 t), with 60 frames per second.
    let time = |frame: u32| [0.05, 1.0, 2.0, 3.0].map(|v| v * frame as f32 / 60.0);
    compare("Unity's shader", |light, at| {
        let frame = frame_at(at, |i| [time(i)[1], time(i)[3]].map(f32::to_bits));
        pass.picture(light, &time(frame))
    });
}

#[test]
fn unreal_s_material_makes_the_reference_s_noise() {
    let Some(gpu) = &*GPU else { return };
    let Some(pass) = FullScreen::new(gpu, "unreal", &unreal_hlsl(), ["Bands", "Picture"]) else { return };
    compare("Unreal's material", |light, at| {
        let frame = frame_at(at, |i| [i, 0]);
        // Uniforms are of 16 bytes at least. After tonemapping, the picture is display-encoded.
        let encoded = light.map(|v| v.map(|v| TRANSFER.encode(v)));
        let noisy = pass.picture(&encoded, &[f32::from_bits(frame), 0.0, 0.0, 0.0]);
        noisy.map(|[r, g, b, a]| [TRANSFER.decode(r), TRANSFER.decode(g), TRANSFER.decode(b), a])
    });
}

#[test]
fn the_exported_shaders_compile_and_broken_copies_do_not() {
    let (hlsl, glsl) = (unity_hlsl(), godot_glsl());
    let Some(both_eyes) = compiled_hlsl("stereo", &hlsl, FRAG, &["-DSTEREO"]) else { return };
    both_eyes.unwrap();
    let broken = |text: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from:?} is not in the shader");
        text.replacen(from, to, 1)
    };
    for (from, to) in [
        ("float luminance = dot(value", "float luminance = dot(valve"),
        ("float4 bands = LOAD", "float4x4 bands = LOAD"),
        ("float3 noisy;", "float3 noisy"),
    ] {
        assert!(compiled_hlsl("broken", &broken(&hlsl, from, to), FRAG, &[]).unwrap().is_err(), "{to}");
    }
    for (from, to) in [
        ("float luminance = dot(value", "float luminance = dot(valve"),
        ("vec4 bands = imageLoad", "mat4 bands = imageLoad"),
        ("vec3 noise = vec3(0.0);", "vec3 noise = vec3(0.0)"),
    ] {
        assert!(compiled_by_glslang("broken-glsl", &broken(&glsl, from, to)).unwrap().is_err(), "{to}");
    }
}
