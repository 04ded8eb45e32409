//! The pictures of a report, as PNG in data URIs.

use crate::two_sample::{TwoSample, two_sample};
use base64::{Engine, engine::general_purpose::STANDARD};
use blindaug::Sample;
use blindaug::model::{BlurSpace, CameraTrack, DepthKind, Estimate, NoiseModel};
use blindaug::synth::{Blur, defocus::Bokeh, noise};
use blindaug::{CameraModel, Encoded, Flow, Linear, Plane, Raster, Result, filter, luma, pyramid};
use image::{ExtendedColorType, ImageEncoder, RgbImage, codecs::png::PngEncoder, imageops};
use plotters::style::colors::colormaps::{ColorMap, ViridisRGB};
use std::borrow::Cow;

/// A picture ready for a page.
pub struct Shown {
    /// The file as a URI, `data:image/png;base64,...`
    pub uri: String,
    /// Width of the file, px.
    pub width: u32,
    /// Height of the file, px.
    pub height: u32,
    /// The factor by which the original's width and height were reduced, >= 1.
    pub reduced: f32,
}

/// The largest width of a picture, px.
const WIDEST: usize = 640;

/// The number of pixels of all full pictures of a page together: noise hardly compresses, so 1 px takes about 3 bytes as base64.
const BUDGET: usize = 1_500_000;

/// The most pixels that each of `n` full pictures may have.
pub fn share_of_budget(n: usize) -> usize {
    (BUDGET / n.max(1)).clamp(10_000, WIDEST * WIDEST)
}

/// The frame, reduced to about `most_pixels` at most; `None` if it is empty.
pub fn shown(frame: &Encoded, most_pixels: usize) -> Option<Shown> {
    let (w, h) = frame.0.size();
    // A cast saturates, and takes NaN to 0.
    let bytes: Vec<u8> = frame.0.data().iter().flatten().map(|v| (255.0 * v + 0.5) as u8).collect();
    let picture = RgbImage::from_raw(w as u32, h as u32, bytes)?;
    let reduced = (w as f32 / WIDEST as f32).max(((w * h) as f32 / most_pixels.max(1) as f32).sqrt());
    // A picture that is a little too large is better than one resampled by a small factor.
    if reduced <= 1.2 {
        return encoded_png(&picture, 1.0);
    }
    let side = |n: usize| ((n as f32 / reduced).round() as u32).max(1);
    encoded_png(&imageops::resize(&picture, side(w), side(h), imageops::FilterType::Triangle), reduced)
}

fn encoded_png(picture: &RgbImage, reduced: f32) -> Option<Shown> {
    let (width, height) = picture.dimensions();
    let mut png = Vec::new();
    PngEncoder::new(&mut png).write_image(picture, width, height, ExtendedColorType::Rgb8).ok()?;
    Some(Shown { uri: format!("data:image/png;base64,{}", STANDARD.encode(png)), width, height, reduced })
}

/// The largest number of pixels of the small pictures of flow and depth.
const SMALL: usize = 320 * 240;

/// The grey of pixels whose value is unknown.
const NO_VALUE: [f32; 3] = [0.45; 3];

/// The picture of flow as colour (hue: direction, saturation: speed), and the speed at full saturation in px per frame.
pub fn flow(flow: &Flow) -> Option<(Shown, f32)> {
    let mut speeds: Vec<f32> =
        flow.data().iter().map(|[u, v]| u.hypot(*v)).filter(|s| s.is_finite()).collect();
    speeds.sort_unstable_by(f32::total_cmp);
    let full = speeds.get(speeds.len().saturating_sub(1) * 98 / 100).copied().unwrap_or(0.0).max(0.5);
    Some((shown(&Encoded(flow.map(|f| flow_colour(f, full))), SMALL)?, full))
}

/// The colour wheel that explains the colours of flow.
pub fn flow_wheel() -> Option<Shown> {
    const RADIUS: usize = 30;
    let r = RADIUS as f32;
    let wheel = Raster::from_fn(2 * RADIUS + 1, 2 * RADIUS + 1, |x, y| {
        let (u, v) = (x as f32 - r, y as f32 - r);
        if u.hypot(v) > r { [1.0; 3] } else { flow_colour([u, v], r) }
    });
    shown(&Encoded(wheel), SMALL)
}

fn flow_colour([u, v]: [f32; 2], full: f32) -> [f32; 3] {
    if !(u.is_finite() && v.is_finite()) {
        return NO_VALUE;
    }
    let saturation = (u.hypot(v) / full).min(1.0);
    let angle = v.atan2(u);
    std::array::from_fn(|c| {
        let hue = 0.5 + 0.5 * (angle - c as f32 * std::f32::consts::TAU / 3.0).cos();
        1.0 - saturation * (1.0 - hue)
    })
}

/// The colour of a nearness, from 0 (far, dark) to 1 (near, bright).
pub(crate) fn of_nearness(nearness: f32) -> [f32; 3] {
    let c = ViridisRGB.get_color(nearness.clamp(0.0, 1.0));
    [c.0, c.1, c.2].map(|v| f32::from(v) / 255.0)
}

/// The picture of inverse depth from dark (far) to bright (near), and the two ends of the scale.
pub fn inverse_depth(depth: &Plane) -> Option<(Shown, [f32; 2])> {
    let mut values: Vec<f32> = depth.data().iter().copied().filter(|d| d.is_finite()).collect();
    values.sort_unstable_by(f32::total_cmp);
    let at = |percent: usize| values.get(values.len().saturating_sub(1) * percent / 100).copied();
    let (low, high) = (at(1)?, at(99)?);
    let span = (high - low).max(1e-9);
    let picture = depth.map(|d| {
        if !d.is_finite() {
            return NO_VALUE;
        }
        of_nearness((d - low) / span)
    });
    Some((shown(&Encoded(picture), SMALL)?, [low, high]))
}

/// The clean frame as this camera would have filmed it: defocus (a round aperture), motion blur, noise. Effects whose
/// estimate or evidence is missing are left out, and named.
///
/// # Errors
/// If flow or depth has another size than the clean frame.
pub fn resynthesised(
    clean: &Encoded,
    sample: &Sample,
    model: &CameraModel,
) -> Result<(Encoded, Vec<&'static str>)> {
    let mut model = model.scaled_to(clean.0.width(), clean.0.height());
    if let Estimate::Known(lens) = &mut model.defocus {
        // The sample's depth is in the model's own unit, whichever that is.
        lens.depth_kind = DepthKind::Metric;
    }
    let depth = sample.inverse_depth.as_ref().map(|depth| {
        let known = depth.map(|d| if d.is_finite() { 1.0 } else { 0.0 });
        pyramid::pull_push(depth, &known)
    });
    let blur = Blur::new(&model, clean.0.width(), Bokeh::Disk)?;
    let blurred = |image| blur.of(image, depth.as_ref(), sample.flow.as_ref());
    let mut image = match model.blur_space {
        BlurSpace::Linear => Linear(blurred(&clean.to_linear(model.transfer).0)?).to_encoded(model.transfer),
        BlurSpace::Encoded => Encoded(blurred(&clean.0)?),
    };
    if let Estimate::Known(m) = &model.noise {
        image = with_noise(&image, m, sample.number);
    }
    let missing = [
        ("defocus", model.defocus.known().is_none() || sample.inverse_depth.is_none()),
        ("motion blur", model.motion_blur.known().is_none() || sample.flow.is_none()),
        ("noise", model.noise.known().is_none()),
    ];
    Ok((image, missing.iter().filter(|m| m.1).map(|m| m.0).collect()))
}

fn with_noise(image: &Encoded, model: &NoiseModel, number: u64) -> Encoded {
    let grain = noise::noise(model, &image.0, 1, number);
    let mut out = image.clone();
    for (v, n) in out.0.data_mut().as_flattened_mut().iter_mut().zip(grain.data().as_flattened()) {
        // Where the sensor clips there is no noise, and elsewhere noise does not reach beyond that level.
        if *v < model.clip() {
            *v = (*v + n).min(model.clip());
        }
    }
    out
}

/// The side of the crop that shows blur, px.
const DETAIL: usize = 96;

/// The square `[x, y, width, height]` in which blur matters most: there the frame differs most from the clean one, noise apart.
/// `None` if the frames are too small or have different sizes.
pub fn detail(frame: &Encoded, clean: &Encoded) -> Option<[usize; 4]> {
    let (w, h) = frame.0.size();
    if clean.0.size() != (w, h) || w < DETAIL || h < DETAIL {
        return None;
    }
    let difference = Plane::from_fn(w, h, |x, y| luma(frame.0.at(x, y)) - luma(clean.0.at(x, y)));
    let difference = filter::gaussian_blur(&difference, 1.5);
    squares(w, h, DETAIL)
        .map(|[x, y]| {
            let square = difference.crop(x, y, DETAIL, DETAIL);
            ([x, y], square.data().iter().filter(|v| v.is_finite()).map(|v| v.abs()).sum::<f32>())
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|([x, y], _)| [x, y, DETAIL, DETAIL])
}

/// A part of a frame, not reduced.
pub fn crop(frame: &Encoded, [x, y, w, h]: [usize; 4]) -> Option<Shown> {
    shown(&Encoded(frame.0.crop(x, y, w, h)), usize::MAX)
}

/// Top left corners of squares that overlap by half.
fn squares(w: usize, h: usize, side: usize) -> impl Iterator<Item = [usize; 2]> {
    let step = (side / 2).max(1);
    (0..=h - side).step_by(step).flat_map(move |y| (0..=w - side).step_by(step).map(move |x| [x, y]))
}

/// The side of a patch of noise, px.
const PATCH: usize = 48;

/// A part is flat if smoothing leaves at most this fraction of its std: of white noise it leaves 0.14, of coarser grain more.
const FLAT: f32 = 0.35;

/// The fastest motion, px per frame interval, of the parts whose noise is shown.
const FASTEST: f32 = 24.0;

/// Noise of a part of a frame beside noise of the model for the same brightness, contrast raised alike.
pub struct NoisePatch {
    /// The frame's number.
    pub number: u64,
    /// Mean luminance.
    pub y: f32,
    /// Mean encoded colour.
    pub colour: [f32; 3],
    /// A patch of the frame's noise.
    pub real: Shown,
    /// A patch of the model's noise over the same picture.
    pub synthetic: Shown,
    /// Std of the luminance of the real and of the synthetic patch.
    pub sigma: [f32; 2],
    /// Whether the patch is a difference of two frames along the motion, in which the scene's own texture cancels; else it is a part of one
    /// frame.
    pub temporal: bool,
    /// Whether the real patch is flat: smoothing leaves little of it, as of noise.
    pub flat: bool,
    /// The factor by which contrast was raised.
    pub gain: f32,
    /// Whether a test tells the real noise from the model's.
    pub test: TwoSample,
}

/// What a sample tells of its frame's noise.
struct Residual<'a> {
    sample: &'a Sample,
    /// The frame minus the next one, moved back along the motion (NaN where that is not known), or the frame itself.
    raster: Cow<'a, Raster<[f32; 3]>>,
    temporal: bool,
    /// The frame without its noise.
    smooth: Raster<[f32; 3]>,
}

impl<'a> Residual<'a> {
    fn of(sample: &'a Sample) -> Self {
        let size = sample.frame.0.size();
        let pair = sample.next.as_ref().zip(sample.flow.as_ref());
        let pair = pair.filter(|(next, flow)| next.0.size() == size && flow.size() == size);
        let raster = match pair {
            Some((next, flow)) => Cow::Owned(difference(&sample.frame.0, &next.0, flow, [0; 2])),
            None => Cow::Borrowed(&sample.frame.0),
        };
        // What smoothing leaves is structure, or only the coarsest part of the noise.
        let smooth = filter::gaussian_blur(&sample.frame.0, 2.0);
        Self { sample, raster, temporal: pair.is_some(), smooth }
    }

    /// The same of noise of the model in the patch at this place, without its shading; each seed gives another.
    fn drawn(&self, model: &NoiseModel, [x0, y0]: [usize; 2], seed: u64) -> Raster<[f32; 3]> {
        let number = self.sample.number;
        let margin = if self.temporal { FASTEST as usize + 2 } else { 0 };
        let side = PATCH + 2 * margin;
        let at = |x: usize, from: usize| (from + x) as isize - margin as isize;
        let content = Raster::from_fn(side, side, |x, y| self.smooth.at_clamped(at(x, x0), at(y, y0)));
        let noise = noise::noise(model, &content, seed, number);
        let Some(flow) = self.sample.flow.as_ref().filter(|_| self.temporal) else {
            return without_plane(&noise);
        };
        let next = noise::noise(model, &content, seed, number + 1);
        let flow = flow.crop(x0, y0, PATCH, PATCH);
        without_plane(&difference(&noise, &next, &flow, [margin; 2]))
    }
}

/// The pixels of `flow`'s size from `from` on of an image, minus where the flow leads in the next one.
fn difference(
    image: &Raster<[f32; 3]>,
    next: &Raster<[f32; 3]>,
    flow: &Flow,
    [x0, y0]: [usize; 2],
) -> Raster<[f32; 3]> {
    let (w, h) = next.size();
    Raster::from_fn(flow.width(), flow.height(), |x, y| {
        let [u, v] = flow.at(x, y);
        let to = [(x0 + x) as f32 + u, (y0 + y) as f32 + v];
        let inside = |v: f32, size: usize| v >= 0.0 && v <= (size - 1) as f32;
        if !inside(to[0], w) || !inside(to[1], h) {
            return [f32::NAN; 3];
        }
        let (a, b) = (image.at(x0 + x, y0 + y), next.cubic(to[0], to[1]));
        [0, 1, 2].map(|c| a[c] - b[c])
    })
}

/// Patches of noise among dark, middle and bright parts of the frames: those that match the next frame best, or of single frames the
/// flattest ones, as far as flat ones exist; without any, the flattest patch of all.
pub fn noise_patches(samples: &[Sample], track: &CameraTrack) -> Vec<NoisePatch> {
    let residuals: Vec<Residual> = samples.iter().map(Residual::of).collect();
    type Found<'a> = Option<(f32, &'a Residual<'a>, [usize; 2])>;
    let mut flat: [Found; 3] = [None; 3];
    let mut flattest: Found = None;
    for residual in &residuals {
        let frame = &residual.sample.frame.0;
        let (w, h) = frame.size();
        let camera = track.at(residual.sample.number);
        let Some(model) = camera.noise.known().filter(|_| w >= PATCH && h >= PATCH) else { continue };
        for at in squares(w, h, PATCH) {
            let [x0, y0] = at;
            let picture = frame.crop(x0, y0, PATCH, PATCH);
            let clips = |v: &f32| !(*v > 0.02 && *v < model.clip() - 0.02);
            if picture.data().as_flattened().iter().any(clips) {
                continue;
            }
            let fast = |f: &[f32; 2]| f[0].hypot(f[1]) > FASTEST;
            let flow = residual.sample.flow.as_ref().filter(|_| residual.temporal);
            if flow.is_some_and(|f| f.crop(x0, y0, PATCH, PATCH).data().iter().any(fast)) {
                continue;
            }
            let patch = residual.raster.crop(x0, y0, PATCH, PATCH);
            if patch.data().as_flattened().iter().any(|v| !v.is_finite()) {
                continue;
            }
            let (rough, structure) = (roughness(&patch), roughness(&filter::gaussian_blur(&patch, 2.0)));
            let mean = picture.data().iter().map(|p| luma(*p)).sum::<f32>() / (PATCH * PATCH) as f32;
            let flatter_than = |other: Found| other.is_none_or(|(least, ..)| structure < least);
            let third = ((3.0 * mean) as usize).min(2);
            if structure <= FLAT * rough && flatter_than(flat[third]) {
                flat[third] = Some((structure, residual, at));
            }
            if flatter_than(flattest) {
                flattest = Some((structure, residual, at));
            }
        }
    }
    let any_flat = flat.iter().any(Option::is_some);
    if !any_flat {
        flat[0] = flattest;
    }
    let patch = |(_, residual, at): (f32, &Residual, [usize; 2])| {
        let patch = noise_patch(residual, at, track.at(residual.sample.number).noise.known()?)?;
        Some(NoisePatch { flat: any_flat, ..patch })
    };
    flat.into_iter().flatten().filter_map(patch).collect()
}

/// The root sum of squares over the three channels of the std around the best plane.
fn roughness(patch: &Raster<[f32; 3]>) -> f32 {
    (0..3).map(|c| deviation(&patch.map(|p| p[c])).powi(2)).sum::<f32>().sqrt()
}

fn noise_patch(residual: &Residual, at: [usize; 2], model: &NoiseModel) -> Option<NoisePatch> {
    // A seed that the test does not use.
    const SEED: u64 = 1;
    let [x0, y0] = at;
    let real = without_plane(&residual.raster.crop(x0, y0, PATCH, PATCH));
    let grain = residual.drawn(model, at, SEED);
    let colour = planes_of(&residual.smooth.crop(x0, y0, PATCH, PATCH)).map(|p| p[0]);
    let y = luma(colour);
    let test = two_sample(model, y, &real, |seed| residual.drawn(model, at, seed));
    let std = |r: &Raster<[f32; 3]>| deviation(&r.map(luma));
    let sigma = [std(&real), std(&grain)];
    let gain = (0.1 / sigma[0].max(sigma[1]).max(1e-4)).clamp(1.0, 24.0);
    let stretched = |r: &Raster<[f32; 3]>| shown(&Encoded(r.map(|p| p.map(|v| 0.5 + gain * v))), usize::MAX);
    Some(NoisePatch {
        number: residual.sample.number,
        y,
        colour,
        real: stretched(&real)?,
        synthetic: stretched(&grain)?,
        sigma,
        temporal: residual.temporal,
        flat: true,
        gain,
        test,
    })
}

/// The best planes of a patch's channels.
fn planes_of(patch: &Raster<[f32; 3]>) -> [[f32; 3]; 3] {
    std::array::from_fn(|c| plane_fit(&patch.map(|p| p[c])))
}

/// A patch without its shading.
fn without_plane(patch: &Raster<[f32; 3]>) -> Raster<[f32; 3]> {
    let planes = planes_of(patch);
    Raster::from_fn(PATCH, PATCH, |x, y| {
        let v = patch.at(x, y);
        std::array::from_fn(|c| v[c] - at_plane(planes[c], x, y))
    })
}

/// The std around the best plane, so that shading does not count.
fn deviation(p: &Plane) -> f32 {
    let plane = plane_fit(p);
    let (w, h) = p.size();
    let mut sum = 0.0;
    for y in 0..h {
        for x in 0..w {
            sum += (p.at(x, y) - at_plane(plane, x, y)).powi(2);
        }
    }
    (sum / (w * h) as f32).sqrt()
}

/// The least-squares plane of a patch: its value at the middle, its slope along x, and its slope along y.
fn plane_fit(p: &Plane) -> [f32; 3] {
    let (mut sums, mut square) = ([0.0; 3], 0.0);
    for (y, row) in p.data().chunks_exact(PATCH).enumerate() {
        for (x, v) in row.iter().enumerate() {
            let (dx, dy) = (from_middle(x), from_middle(y));
            sums[0] += v;
            sums[1] += v * dx;
            sums[2] += v * dy;
            square += dx * dx;
        }
    }
    [sums[0] / (PATCH * PATCH) as f32, sums[1] / square, sums[2] / square]
}

fn at_plane([middle, sx, sy]: [f32; 3], x: usize, y: usize) -> f32 {
    middle + sx * from_middle(x) + sy * from_middle(y)
}

fn from_middle(x: usize) -> f32 {
    x as f32 - 0.5 * (PATCH - 1) as f32
}
