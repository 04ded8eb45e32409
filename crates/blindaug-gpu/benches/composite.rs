//! The time that a frame of the compositor takes, step by step, beside the time of moving its bytes: `cargo bench -p blindaug-gpu`.
//!
//! The size is 2 x 2064 x 2208 px on a GPU and 640 x 360 px on a software device; `cargo bench -p blindaug-gpu -- WIDTH HEIGHT EYES`
//! chooses another. Bytes and samples are counted at 2064 x 2208 px on every device, from the blocks of the frame in which the compositor
//! found something to do.

use blindaug::composite::CompositeOptions;
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel, NoiseModel,
    SharpeningModel,
};
use blindaug::synth::defocus::Bokeh;
use blindaug::{CameraModel, Error, Flow, Plane, Raster, Result, filter};
use blindaug_gpu::{
    Area, Block, Compositor, Depth, Frame, Gpu, Inputs, Quality, STEPS, Timer, Velocity, layer_views,
    unsharpening_steps,
};
use std::time::Instant;
use wgpu::TextureFormat;

fn main() -> Result<()> {
    let gpu = Gpu::new()?;
    let sizes: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let software = gpu.info.device_type == wgpu::DeviceType::Cpu;
    let [w, h, eyes] = match sizes[..] {
        [] if software => [640, 360, 1],
        [] => [2064, 2208, 2],
        [w, h, eyes] => [w, h, eyes],
        _ => return Err(Error::new("give three numbers: width and height in px, and eyes")),
    };
    let frames = if software { 5 } else { 50 };
    println!("{} ({:?}), {eyes} x {w} x {h}, median of {frames} frames", gpu.info.name, gpu.info.backend);
    if software {
        println!("This device computes on the CPU: its times say nothing of a GPU; bytes and taps do.");
    }
    let bandwidth = copy_bandwidth(&gpu, if software { 32 << 20 } else { 256 << 20 }, frames)?;
    println!("copy bandwidth {:.1} GB/s (read and written)\n", bandwidth * 1e-9);
    let compositor = Compositor::new(&gpu.device, &gpu.queue, TextureFormat::Rgba8Unorm);
    let scene = Scene::new(&gpu, [w, h, eyes], 0.4)?;
    println!("An object over 40 % of the view:\n");
    println!(
        "| quality, bokeh | samples of defocus and of motion blur, mean over the object, most | step | ms |"
    );
    println!("|---|---|---|---|");
    for (quality, bokeh, sharpening) in [
        (Quality::High, Bokeh::Gaussian, 0.0),
        (Quality::Medium, Bokeh::Gaussian, 0.0),
        (Quality::Low, Bokeh::Gaussian, 0.0),
        (Quality::High, Bokeh::Disk, 0.0),
        (Quality::Medium, Bokeh::Disk, 0.0),
        (Quality::Low, Bokeh::Disk, 0.0),
        (Quality::High, Bokeh::Gaussian, 0.5),
        (Quality::High, Bokeh::Gaussian, 5.0),
    ] {
        let manner = Manner { quality, bokeh, sharpening, given: GIVEN[0] };
        let times = scene.time(&gpu, &compositor, manner, frames)?;
        let name = match sharpening {
            0.0 => format!("{quality:?}, {bokeh:?}"),
            amount => format!("{quality:?}, {bokeh:?}, sharpening by {amount}"),
        };
        let taps = scene.taps(quality, bokeh);
        for (step, ms) in STEPS.iter().zip(times.steps.into_iter().flatten()) {
            println!("| {name} | {taps} | {step} | {ms:.3} |");
        }
        println!("| {name} | {taps} | whole frame | {:.3} |", times.frame);
    }
    let counted = count(&gpu, &compositor)?;
    if software { Ok(()) } else { compare(&gpu, &compositor, &counted, bandwidth, frames) }
}

/// The size of the frame of which bytes and samples are counted, px.
const COUNTED: [usize; 2] = [2064, 2208];

/// The shares of the view that the object covers in the counts.
const SHARES: [f32; 3] = [0.05, 0.2, 0.5];

/// The work of a frame of one eye by each of [`QUALITIES`], with the share of the view that the object covers and what is given.
type Counted = (f32, Given, [Work; QUALITIES.len()]);

/// The qualities in the counts.
const QUALITIES: [Quality; 3] = [Quality::High, Quality::Medium, Quality::Low];

/// Prints the times of two eyes at [`COUNTED`], each step beside the time of its bytes at the bandwidth of a copy, bytes/s.
fn compare(
    gpu: &Gpu,
    compositor: &Compositor,
    counted: &[Counted],
    bandwidth: f64,
    frames: usize,
) -> Result<()> {
    let [w, h] = COUNTED;
    println!(
        "\nMeasured, 2 x {w} x {h}, Gaussian: ms (in brackets the ms of the counted bytes at the bandwidth of a copy)\n"
    );
    println!("| quality | object | given | {} | from submission to end |", STEPS.join(" | "));
    println!("|---|---|---|{}|---|", ["---"; STEPS.len()].join("|"));
    for share in SHARES {
        let scene = Scene::new(gpu, [w, h, 2], share)?;
        for (_, given, works) in counted.iter().filter(|c| c.0 == share) {
            for (&quality, work) in QUALITIES.iter().zip(works) {
                let manner = Manner { quality, bokeh: Bokeh::Gaussian, sharpening: 0.0, given: *given };
                let times = scene.time(gpu, compositor, manner, frames)?;
                let floors = work.bytes.map(|bytes| 2e3 * bytes / bandwidth);
                let steps: Vec<_> = match times.steps {
                    Some(steps) => {
                        steps.iter().zip(floors).map(|(ms, floor)| format!("{ms:.3} ({floor:.3})")).collect()
                    }
                    None => floors.map(|floor| format!("({floor:.3})")).into(),
                };
                println!(
                    "| {quality:?} | {:.0} % | {} | {} | {:.3} |",
                    100.0 * share,
                    given.words(),
                    steps.join(" | "),
                    times.frame
                );
            }
        }
    }
    Ok(())
}

/// Prints the bytes and samples of frames, and the time that they would take on a phone; returns the counts.
fn count(gpu: &Gpu, compositor: &Compositor) -> Result<Vec<Counted>> {
    let [w, h] = COUNTED;
    let mut counted = Vec::new();
    for share in SHARES {
        let scene = Scene::new(gpu, [w, h, 1], share)?;
        // With the rectangle around all that may be seen as the area or without, and with the caller's promises or without.
        for given in GIVEN {
            let area = given.area.then(|| scene.around());
            let blocks = scene.blocks(gpu, compositor, area)?;
            counted.push((share, given, QUALITIES.map(|q| Work::new(&scene, &blocks, (given, area), q))));
        }
    }
    println!("\nBytes per pixel, without sharpening, at {w} x {h}; the object's with the rim of its blur\n");
    println!("| quality | object | given | {} | whole view | pixel of the object |", STEPS.join(" | "));
    println!("|---|---|---|{}|---|---|", ["---"; STEPS.len()].join("|"));
    let pixels = (w * h) as f64;
    for (share, given, works) in &counted {
        for (quality, work) in QUALITIES.iter().zip(works) {
            let steps: Vec<_> = work.bytes.iter().map(|b| format!("{:.1}", b / pixels)).collect();
            let whole = work.bytes.iter().sum::<f64>();
            println!(
                "| {quality:?} | {:.0} % | {} | {} | {:.1} | {:.0} |",
                100.0 * share,
                given.words(),
                steps.join(" | "),
                whole / pixels,
                (whole - work.elsewhere) / work.object
            );
        }
    }
    let (bandwidth, rate) = PHONE;
    println!(
        "\nEstimated, not measured: 2 x {w} x {h} at {:.0} GB/s and {:.0} G samples/s\n",
        bandwidth * 1e-9,
        rate * 1e-9
    );
    println!(
        "| quality | object | given | ms of bytes | of samples | of each step, the longer | ms | of a frame at 45 Hz | 72 Hz | 90 Hz |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (share, given, works) in &counted {
        for (quality, work) in QUALITIES.iter().zip(works) {
            // There are two eyes, and a step takes as long as its bytes or its samples, whichever is longer.
            let times = |n: &[f64], rate: f64| -> Vec<f64> { n.iter().map(|n| 2e3 * n / rate).collect() };
            let (bytes, samples) = (times(&work.bytes, bandwidth), times(&work.samples, rate));
            let longer: Vec<f64> = bytes.iter().zip(&samples).map(|(a, b)| a.max(*b)).collect();
            let steps: Vec<_> = longer.iter().map(|ms| format!("{ms:.2}")).collect();
            let ms = longer.iter().sum::<f64>();
            let of = |hz: f64| format!("{:.0} %", 0.1 * ms * hz);
            println!(
                "| {quality:?} | {:.0} % | {} | {:.1} | {:.1} | {} | {ms:.1} | {} | {} | {} |",
                100.0 * share,
                given.words(),
                bytes.iter().sum::<f64>(),
                samples.iter().sum::<f64>(),
                steps.join(" + "),
                of(45.0),
                of(72.0),
                of(90.0)
            );
        }
    }
    println!("\nBlocks of the object by their largest defocus std, and blocks in which it may be seen\n");
    println!(
        "| object | below 1/128 px | below 1 px | above | seen | seen if each block reached as far as its own blur | looks for an empty tile, share of the samples at Medium |"
    );
    println!("|---|---|---|---|---|---|---|");
    for share in SHARES {
        let scene = Scene::new(gpu, [w, h, 1], share)?;
        let blocks = scene.blocks(gpu, compositor, None)?;
        let Classes { sharp, small, large, seen, seen_by_class } = Classes::of(&scene, &blocks);
        let samples: f64 = Work::new(&scene, &blocks, (GIVEN[0], None), Quality::Medium).samples.iter().sum();
        let looks = 4.0 * 25.0 * blocks.iter().filter(|b| b.focused && !b.covered).count() as f64;
        println!(
            "| {:.0} % | {sharp} | {small} | {large} | {seen} | {seen_by_class} | {:.2} % |",
            100.0 * share,
            100.0 * looks / samples
        );
    }
    println!("\nSharpening by a radius of {MASK_RADIUS} px: bytes per pixel of the view, and texels read\n");
    println!(
        "| object | amount | steps | bytes | if it worked on the area | on the whole view | texels | on the whole view |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for share in SHARES {
        let mut scene = Scene::new(gpu, [w, h, 1], share)?;
        scene.camera.sharpening = Estimate::Known(SharpeningModel::given(1.0, MASK_RADIUS));
        let blocks = scene.blocks(gpu, compositor, None)?;
        let area = scene.around();
        let in_area = f64::from(area.width) * f64::from(area.height) / pixels;
        for amount in [0.2, 0.5, 1.0, 5.0, 20.0] {
            let steps = unsharpening_steps(&SharpeningModel::given(amount, MASK_RADIUS));
            let own = Sharpened::of(&blocks, w.div_ceil(BLOCK)).work(steps);
            // One block that is everywhere.
            let everywhere = Sharpened { changed: pixels, rows: pixels, seen: pixels }.work(steps);
            println!(
                "| {:.0} % | {amount} | {steps} | {:.0} | {:.0} | {:.0} | {:.0} | {:.0} |",
                100.0 * share,
                own.0 / pixels,
                in_area * everywhere.0 / pixels,
                everywhere.0 / pixels,
                own.1 / pixels,
                everywhere.1 / pixels
            );
        }
    }
    Ok(counted)
}

/// The radius of the mask of which the sharpening's bytes are counted, px.
const MASK_RADIUS: f32 = 1.0;

/// The assumed speed of a GPU like the Adreno 740: 70 % of the bandwidth of 64 bit of LPDDR5X at 8533 MT/s, bytes/s, and samples of four
/// half floats per second.
const PHONE: (f64, f64) = (0.7 * 68.3e9, 20e9);

/// What the caller gives beside the textures.
#[derive(Clone, Copy)]
struct Given {
    /// The area in which the object may be seen, outside of which the layer is cleared.
    area: bool,
    /// Inverse depths of half floats that tell where nothing is, so that the layer is cleared there, and targets that hold the frame already.
    promises: bool,
}

/// What is given in the counts.
const GIVEN: [Given; 4] = [
    Given { area: false, promises: false },
    Given { area: true, promises: false },
    Given { area: false, promises: true },
    Given { area: true, promises: true },
];

impl Given {
    fn words(self) -> &'static str {
        match (self.area, self.promises) {
            (false, false) => "nothing",
            (true, false) => "area",
            (false, true) => "promises",
            (true, true) => "both",
        }
    }
}

/// How a frame is composited in the times.
#[derive(Clone, Copy)]
struct Manner {
    quality: Quality,
    bokeh: Bokeh,
    /// The amount of sharpening by a radius of [`MASK_RADIUS`]; 0: none.
    sharpening: f32,
    given: Given,
}

/// The side of a block, px.
const BLOCK: usize = 16;

/// The first level of which all pixels are computed, as in extension.wgsl.
const WHOLE_FROM: usize = 6;

/// What classes of blocks would be worth.
struct Classes {
    /// The blocks of the object whose defocus stds are below that which can be seen, 1/128 px.
    sharp: usize,
    /// Those whose largest defocus std is below 1 px.
    small: usize,
    /// The other ones.
    large: usize,
    /// The blocks in which the object may be seen, as the passes find them: by the largest reach of blur in the frame.
    seen: usize,
    /// Those in which it may be seen if each block reached only as far as its own blur.
    seen_by_class: usize,
}

impl Classes {
    fn of(scene: &Scene, blocks: &[Block]) -> Self {
        let [w, h, _] = scene.size;
        let (columns, rows) = (w.div_ceil(BLOCK), h.div_ceil(BLOCK));
        let mut classes = [0; 3];
        let mut seen_by_class = vec![false; blocks.len()];
        for (i, _) in blocks.iter().enumerate().filter(|(_, b)| b.occupied) {
            let (bx, by) = (i % columns, i / columns);
            let pixels = (by * BLOCK..((by + 1) * BLOCK).min(h))
                .flat_map(|y| (bx * BLOCK..((bx + 1) * BLOCK).min(w)).map(move |x| (x, y)));
            let (mut sigma, mut reach) = (0.0f32, 0.0f32);
            for (x, y) in pixels.filter(|&(x, y)| scene.inside(x, y)) {
                let own = scene.sigma(x);
                sigma = sigma.max(own);
                let of_lens = if own < 1.0 / 128.0 { 0.0 } else { 4.5 * own + 2.0 };
                reach = reach.max(of_lens + 0.5 * scene.path(x, y));
            }
            classes[usize::from(sigma >= 1.0 / 128.0) + usize::from(sigma >= 1.0)] += 1;
            let n = (reach / BLOCK as f32).ceil() as usize;
            for y in by.saturating_sub(n)..=(by + n).min(rows - 1) {
                let row = columns * y;
                seen_by_class[row + bx.saturating_sub(n)..=row + (bx + n).min(columns - 1)].fill(true);
            }
        }
        let [sharp, small, large] = classes;
        let seen = blocks.iter().filter(|b| b.visible).count();
        Self { sharp, small, large, seen, seen_by_class: seen_by_class.iter().filter(|s| **s).count() }
    }
}

/// The pixels that the sharpening works on.
struct Sharpened {
    /// Those that it may change.
    changed: f64,
    /// Those whose rows are blurred.
    rows: f64,
    /// Those of the blocks in which the object may be seen.
    seen: f64,
}

impl Sharpened {
    /// The pixels of the blocks of a frame, so many of them in a row.
    fn of(blocks: &[Block], columns: usize) -> Self {
        let taps = filter::gaussian_kernel(MASK_RADIUS).len() - 1;
        let reach = columns * taps.max(2).div_ceil(BLOCK);
        // Above and below the blocks that are changed, rows are read.
        let is_read = |i: usize| {
            (i % columns..blocks.len())
                .step_by(columns)
                .any(|j| j.abs_diff(i) <= reach && blocks[j].sharpened)
        };
        let pixels = |is: &dyn Fn(usize) -> bool| {
            (BLOCK * BLOCK * (0..blocks.len()).filter(|&i| is(i)).count()) as f64
        };
        Self {
            changed: pixels(&|i| blocks[i].sharpened),
            rows: pixels(&is_read),
            seen: pixels(&|i| blocks[i].visible),
        }
    }

    /// The bytes that the sharpening moves, if each texel is read once and written once, and the texels that it reads, beyond those of the
    /// composite of a camera that does not sharpen. Each texel has 8 bytes, of the frame 4. (The bits and the list of the blocks are less
    /// than 0.1 bytes a pixel.)
    fn work(&self, steps: u32) -> (f64, f64) {
        let later = f64::from(steps - 1);
        let taps = 2.0 * filter::gaussian_kernel(MASK_RADIUS).len() as f64 - 1.0;
        // The rows of the frame, those of each further step, and those of the difference.
        let rows = (4.0 + 8.0) + 16.0 * (later + 1.0);
        // The columns of the frame; those of each further step read the source, the rows and the first step's result, which is the second
        // step's source. The difference is written. The last pass reads it and its rows.
        let changed = (8.0 + 4.0 + 8.0) + 32.0 * later - 8.0 + 8.0 + 16.0;
        // The difference reads the frame and what unsharpens it, the last pass the latter.
        let seen = 4.0 + 8.0 + 8.0;
        let bytes = self.rows * rows + self.changed * changed + self.seen * seen;
        let texels =
            self.rows * taps * (later + 2.0) + self.changed * (taps * (later + 2.0) + 1.0 + 2.0 * later);
        (bytes, texels + 3.0 * self.seen)
    }
}

/// What the passes of a frame of one eye move and read, for a camera that does not sharpen.
struct Work {
    /// The bytes that each of [`STEPS`] moves if each texel is read once and written once: 8 bytes for the half floats in four channels of
    /// the layer and between the passes, 4 each for depth (2 if it is of half floats), velocity, the frame and the target. The noise tile stays in the cache.
    bytes: [f64; STEPS.len()],
    /// The texels and the bilinear samples that each of [`STEPS`] reads.
    samples: [f64; STEPS.len()],
    /// The bytes of the pixels without the object: those of the copy, of the layer where it has to be looked at, and of all blocks' bits.
    elsewhere: f64,
    /// The number of pixels of the object.
    object: f64,
}

impl Work {
    fn new(scene: &Scene, blocks: &[Block], (given, area): (Given, Option<Area>), quality: Quality) -> Self {
        let [w, h, _] = scene.size;
        let (columns, rows) = (w.div_ceil(BLOCK), h.div_ceil(BLOCK));
        let pixels = (w * h) as f64;
        let looked_at = area.map_or(pixels, |a| f64::from(a.width) * f64::from(a.height));
        let object = (0..w * h).filter(|i| scene.inside(i % w, i / w)).count() as f64;
        let of_block = (BLOCK * BLOCK) as f64;
        let occupied = of_block * blocks.iter().filter(|b| b.occupied).count() as f64;
        // The pixels of a level whose workgroups of 8 x 8 pixels find a block that they need, or all from WHOLE_FROM on.
        let live = |level: usize, needs: &dyn Fn(&Block) -> bool| -> f64 {
            let (side, around) = (8 << level, 2 << level);
            let groups = |size: usize| size.div_ceil(1 << level).div_ceil(8);
            let found = |gx: usize, gy: usize| {
                if level >= WHOLE_FROM {
                    return true;
                }
                let range = |g: usize, all: usize| {
                    (g * side).saturating_sub(around) / BLOCK
                        ..=((g * side + side + around - 1) / BLOCK).min(all - 1)
                };
                range(gy, rows).any(|y| range(gx, columns).any(|x| needs(&blocks[y * columns + x])))
            };
            let n = (0..groups(w))
                .flat_map(|x| (0..groups(h)).map(move |y| (x, y)))
                .filter(|&(x, y)| found(x, y));
            64.0 * n.count() as f64
        };
        let halvings =
            |levels: std::ops::RangeInclusive<usize>| levels.map(|l| live(l, &|b| b.occupied)).sum::<f64>();
        let levels = w.max(h).next_power_of_two().ilog2() as usize;
        let (pulled, octaves) = (halvings(3..=levels), halvings(2..=7));
        let pushed = (3..levels).map(|l| live(l, &|b| b.visible)).sum::<f64>();
        // Where the object covers a pixel, its own depth or motion is read, and in blocks that it does not cover as a whole the bits that say
        // so, at a quarter of the size; elsewhere those bits, four of the continued values of that size, and one of the next level. Bytes
        // and samples:
        // Inverse depth of half floats or floats; motion has two half floats.
        let depth = if given.promises { 2.0 } else { 4.0 };
        let own_of = |block: &Block, inside: bool, own: f64| match (block.covered, inside) {
            (true, _) => (own, 1.0),
            (false, true) => (0.25 + own, 2.0),
            (false, false) => (0.25 + 0.5 + 0.125, 6.0),
        };
        let mut focused = (0.0, 0.0);
        // The frame is copied.
        let mut composited = if given.promises { (0.0, 0.0) } else { (8.0 * pixels, pixels) };
        for (i, block) in blocks.iter().enumerate() {
            let (x0, y0) = (BLOCK * (i % columns), BLOCK * (i / columns));
            let at = || {
                (y0..(y0 + BLOCK).min(h)).flat_map(move |y| (x0..(x0 + BLOCK).min(w)).map(move |x| (x, y)))
            };
            if block.focused {
                let mut octaves = [0.0; 8];
                for (x, y) in at() {
                    let sigma = scene.sigma(x);
                    octaves[quality.octave(Bokeh::Gaussian, sigma)] = 1.0;
                    let (bytes, samples) = own_of(block, scene.inside(x, y), depth);
                    focused.0 += 8.0 + bytes;
                    focused.1 += samples;
                    if scene.outside_px(x, y) < 4.5 * sigma {
                        focused.1 += f64::from(quality.defocus_taps(Bokeh::Gaussian, sigma));
                    }
                }
                // Of each octave that is read, the block is read once; and one coarse octave is looked at for whether anything is seen.
                focused.0 += of_block
                    * octaves.iter().enumerate().map(|(o, n)| n * 8.0 / 4f64.powi(o as i32)).sum::<f64>();
                if !block.covered {
                    focused.1 += 4.0 * 25.0;
                }
            }
            if block.visible {
                for (x, y) in at() {
                    let inside = scene.inside(x, y);
                    let (mut bytes, mut samples) = own_of(block, inside, 4.0);
                    if inside && quality != Quality::High {
                        // The depth of the next level, too, by which fewer samples are taken along the path.
                        bytes += 0.125;
                        samples += 1.0;
                    }
                    let (outside, reach) =
                        (scene.outside_px(x, y), 3.0 * scene.sigma(x) + 0.5 * scene.path(x, y));
                    if given.promises && outside < reach {
                        // The frame is read and the target written where something is seen.
                        composited.0 += 8.0;
                        composited.1 += 1.0;
                    }
                    composited.0 += 8.0 + bytes;
                    composited.1 +=
                        samples + f64::from(quality.motion_blur_taps(scene.path(x, y), scene.sigma(x)));
                    if outside < -reach {
                        // Inside of its rim, the object hides the frame. Its noise is read from three textures.
                        composited.0 -= 4.0;
                        composited.1 += 3.0 - 1.0;
                    } else if outside < reach {
                        // On the rim, the frame is smoothed too.
                        composited.1 += 3.0 + 9.0;
                    }
                }
            }
        }
        let bits = 4.0 * blocks.len() as f64;
        // Of what may be empty, the colour is looked at, or the depth if that tells where nothing is.
        let look = if given.promises { depth } else { 8.0 };
        // The bits of blocks: two or three kernels beside the first one read and write them.
        let bits_of_extension = if given.promises { 9.0 * bits } else { 7.0 * bits };
        let bytes = [
            // Where there is something, colour, depth and motion 14 or 16; writes at half the size 2, at a quarter of it 1/2 and 1/4. The pull
            // reads four pixels and writes one; the push reads one and one of four, and writes one.
            look * looked_at
                + (12.0 + depth - look) * object
                + 2.75 * occupied
                + 40.0 * pulled
                + 18.0 * pushed
                + bits_of_extension,
            40.0 * octaves,
            focused.0,
            0.0,
            composited.0 + bits,
        ];
        let samples = [
            // Tiles of 20 x 20 pixels for 16 x 16.
            400.0 / 256.0 * (looked_at + 2.0 * object) + 9.0 * pulled + 5.0 * pushed,
            9.0 * octaves,
            focused.1,
            0.0,
            composited.1,
        ];
        let copies = if given.promises { 0.0 } else { 8.0 * (pixels - object) };
        Self {
            bytes,
            samples,
            elsewhere: copies + look * (looked_at - object) + bits_of_extension + bits,
            object,
        }
    }
}

struct Times {
    /// The milliseconds of each step, if the device has timestamps.
    steps: Option<[f32; STEPS.len()]>,
    /// The milliseconds from submission to the end.
    frame: f64,
}

/// The bytes per second that are read and written while a buffer of `size` bytes is copied.
fn copy_bandwidth(gpu: &Gpu, size: u64, times: usize) -> Result<f64> {
    let buffer = || {
        gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("copy"),
            size,
            usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    };
    let (a, b) = (buffer(), buffer());
    let copies = 4;
    let mut best = f64::INFINITY;
    for _ in 0..times {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for _ in 0..copies {
            encoder.copy_buffer_to_buffer(&a, 0, &b, 0, size);
        }
        gpu.wait()?;
        let start = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((2 * copies * size) as f64 / best)
}

struct Scene {
    frame: wgpu::Texture,
    color: wgpu::Texture,
    depth: wgpu::Texture,
    /// Depth in half floats, 0 where nothing is.
    depth_or_nothing: wgpu::Texture,
    velocity: wgpu::Texture,
    target: wgpu::Texture,
    camera: CameraModel,
    size: [usize; 3],
    lens: DefocusModel,
    /// The radius of the object, in widths and heights of the view.
    radius: f32,
}

/// The exposure fraction of the scene's camera.
const EXPOSURE: f32 = 0.75;

impl Scene {
    /// A scene of an object over a share of the frame. Its defocus std rises from 0 in the frame's middle column to 6 px at the left and the
    /// right edge, and its paths are up to 20 px long.
    fn new(gpu: &Gpu, [w, h, eyes]: [usize; 3], share: f32) -> Result<Self> {
        let mut camera = CameraModel::unknown(
            Capture { width: w, height: h, fps: None, frames_used: 1, pixel_aspect: 1.0 },
            "not given",
        );
        let lens = DefocusModel::given_lens(10.0, 0.5);
        camera.defocus = Estimate::Known(lens);
        camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(EXPOSURE)));
        let level = NoiseLevel { slope: [0.02; 3], intercept: [0.01; 3] };
        camera.noise = Estimate::Known(NoiseModel::given([level; 4], 1.0));
        let target = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("target"),
            size: wgpu::Extent3d { width: w as u32, height: h as u32, depth_or_array_layers: eyes as u32 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        // The textures are replaced below, once the scene can tell where its object is.
        let nothing = || gpu.upload(&[&Raster::filled(1, 1, 0.0f32)], TextureFormat::R32Float);
        let mut scene = Self {
            frame: nothing()?,
            color: nothing()?,
            depth: nothing()?,
            depth_or_nothing: nothing()?,
            velocity: nothing()?,
            target,
            camera,
            size: [w, h, eyes],
            lens,
            radius: (share / std::f32::consts::PI).sqrt(),
        };
        let frame = Raster::from_fn(w, h, |x, y| [0.3 + 0.2 * ((x * 7 + y * 13) % 31) as f32 / 31.0; 4]);
        let color = Raster::from_fn(w, h, |x, y| {
            if scene.inside(x, y) { [0.5, ((x / 8 + y / 8) % 2) as f32, 0.2, 1.0] } else { [0.0; 4] }
        });
        let depth = Plane::from_fn(w, h, |x, _| scene.inverse_depth(x));
        let depth_or_nothing =
            Plane::from_fn(w, h, |x, y| if scene.inside(x, y) { scene.inverse_depth(x) } else { 0.0 });
        let flow = Flow::from_fn(w, h, |x, y| scene.flow(x, y));
        scene.frame = gpu.upload(&vec![&frame; eyes], TextureFormat::Rgba8Unorm)?;
        scene.color = gpu.upload(&vec![&color; eyes], TextureFormat::Rgba16Float)?;
        scene.depth = gpu.upload(&vec![&depth; eyes], TextureFormat::R32Float)?;
        scene.depth_or_nothing = gpu.upload(&vec![&depth_or_nothing; eyes], TextureFormat::R16Float)?;
        scene.velocity = gpu.upload(&vec![&flow; eyes], TextureFormat::Rg16Float)?;
        Ok(scene)
    }

    /// Whether the object is at a pixel.
    fn inside(&self, x: usize, y: usize) -> bool {
        let [w, h, _] = self.size;
        (x as f32 / w as f32 - 0.5).hypot(y as f32 / h as f32 - 0.5) < self.radius
    }

    /// About how far a pixel lies outside of the object, px; inside it, it is negative.
    fn outside_px(&self, x: usize, y: usize) -> f32 {
        let [w, h, _] = self.size.map(|s| s as f32);
        let [u, v] = [x as f32 / w - 0.5, y as f32 / h - 0.5];
        (u.hypot(v) - self.radius) * 0.5 * (w + h)
    }

    fn inverse_depth(&self, x: usize) -> f32 {
        0.2 + 0.6 * x as f32 / self.size[0] as f32
    }

    fn flow(&self, x: usize, y: usize) -> [f32; 2] {
        [25.0 * y as f32 / self.size[1] as f32, 10.0 * x as f32 / self.size[0] as f32]
    }

    /// The defocus std of a column of pixels, px.
    fn sigma(&self, x: usize) -> f32 {
        self.lens.sigma_px(self.inverse_depth(x))
    }

    /// The length of the path of a pixel, px.
    fn path(&self, x: usize, y: usize) -> f32 {
        let [u, v] = self.flow(x, y);
        EXPOSURE * u.hypot(v)
    }

    /// The rectangle in which the blurred object may be seen.
    fn around(&self) -> Area {
        let [w, h, _] = self.size.map(|s| s as f32);
        let reach = 4.5 * self.lens.sigma_px(self.inverse_depth((w * (0.5 + self.radius)) as usize)) + 10.0;
        let range = |size: f32| {
            let first = (size * (0.5 - self.radius) - reach).max(0.0);
            (first as u32, ((size * (0.5 + self.radius) + reach).min(size) - first) as u32)
        };
        let ((x, width), (y, height)) = (range(w), range(h));
        Area { x, y, width, height }
    }

    /// The samples of defocus and of motion blur, their mean over the object and the most.
    fn taps(&self, quality: Quality, bokeh: Bokeh) -> String {
        let [w, h, _] = self.size;
        let words = |taps: &dyn Fn(usize, usize) -> u32| {
            let places = (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| self.inside(x, y));
            let taps: Vec<_> = places.map(|(x, y)| taps(x, y)).collect();
            let mean = taps.iter().map(|&t| f64::from(t)).sum::<f64>() / taps.len().max(1) as f64;
            format!("{mean:.0}, {}", taps.iter().max().copied().unwrap_or(0))
        };
        let defocus = words(&|x, _| quality.defocus_taps(bokeh, self.sigma(x)));
        let motion = words(&|x, y| quality.motion_blur_taps(self.path(x, y), self.sigma(x)));
        format!("{defocus}; {motion}")
    }

    fn inputs(&self, given: Given) -> Inputs<'_> {
        let (texture, nothing) =
            if given.promises { (&self.depth_or_nothing, Some(0.0)) } else { (&self.depth, None) };
        Inputs {
            frame: &self.frame,
            color: &self.color,
            depth: Some(Depth { texture, scale: 1.0, offset: 0.0, nothing }),
            velocity: Some(Velocity { texture: &self.velocity, scale: [1.0; 2] }),
            cleared: given.promises,
            apart: false,
        }
    }

    /// The blocks of a frame after another one like it.
    fn blocks(&self, gpu: &Gpu, compositor: &Compositor, area: Option<Area>) -> Result<Vec<Block>> {
        let bound = compositor.bind(&gpu.device, &self.inputs(GIVEN[0]))?;
        let views = layer_views(&self.target);
        for number in 0..2 {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let frame = Frame {
                model: &self.camera,
                // Noise changes no block.
                options: CompositeOptions { no_noise: true, ..Default::default() },
                quality: Quality::Low,
                number,
                area,
                targets: &views,
                frame_in_targets: false,
                timer: None,
            };
            compositor.encode(&gpu.queue, &mut encoder, &bound, &frame)?;
            gpu.queue.submit([encoder.finish()]);
        }
        bound.read_blocks(gpu)
    }

    fn time(&self, gpu: &Gpu, compositor: &Compositor, manner: Manner, frames: usize) -> Result<Times> {
        let Manner { quality, bokeh, sharpening, given } = manner;
        let mut camera = self.camera.clone();
        if sharpening > 0.0 {
            camera.sharpening = Estimate::Known(SharpeningModel::given(sharpening, MASK_RADIUS));
        }
        let bound = compositor.bind(&gpu.device, &self.inputs(given))?;
        let views = layer_views(&self.target);
        // A software device's timestamps do not tell when a step ended.
        let software = gpu.info.device_type == wgpu::DeviceType::Cpu;
        let timer = Timer::new(gpu).ok().filter(|_| !software);
        let (mut whole, mut steps) = (Vec::new(), vec![Vec::new(); STEPS.len()]);
        // The first frames warm the device up.
        for number in 0..frames as u64 + 2 {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let frame = Frame {
                model: &camera,
                options: CompositeOptions { bokeh: Some(bokeh), ..Default::default() },
                quality,
                number,
                area: given.area.then(|| self.around()),
                targets: &views,
                // The targets hold an earlier frame's result, which takes as long.
                frame_in_targets: given.promises,
                timer: timer.as_ref(),
            };
            compositor.encode(&gpu.queue, &mut encoder, &bound, &frame)?;
            gpu.wait()?;
            let start = Instant::now();
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            let elapsed = 1e3 * start.elapsed().as_secs_f64();
            if number < 2 {
                continue;
            }
            whole.push(elapsed);
            if let Some(timer) = &timer {
                steps.iter_mut().zip(timer.read(gpu)?).for_each(|(s, ms)| s.push(ms));
            }
        }
        whole.sort_by(f64::total_cmp);
        let median = |mut ms: Vec<f32>| {
            ms.sort_by(f32::total_cmp);
            ms[ms.len() / 2]
        };
        let steps = timer.map(|_| std::array::from_fn(|i| median(std::mem::take(&mut steps[i]))));
        Ok(Times { steps, frame: whole[whole.len() / 2] })
    }
}
