//! Synthesis of each distortion: the reference that every other backend is compared with.

pub mod defocus;
pub mod motion_blur;
pub mod noise;
pub mod sharpening;

use crate::model::{
    Bokeh, CameraModel, Capture, DefocusModel, DepthKind, ExposureFraction, NoiseModel, SharpeningModel,
    Shutter, Space,
};
use crate::strips::{STRIP, Strip, grown, kept, largest_strip, strips};
use crate::{Encoded, Error, Flow, Linear, Pixel, Plane, Raster, Result, pyramid};
use defocus::Lens;
use std::ops::Range;

/// The blur of a camera's lens and shutter, as far as it is known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Blur {
    defocus: Option<DefocusModel>,
    /// The lens whose blur the image has already.
    already: Option<DefocusModel>,
    shutter: Option<Shutter>,
    /// The shape of the lens's blur; `None` without a lens.
    lens: Option<Lens>,
    /// The distance, in stds of the lens's blur, to which it spreads a point, and what is added to it, px.
    lens_reach: [f32; 2],
}

impl Blur {
    /// The blur of a camera model for frames of `width` px; unknown parts blur nothing. `bokeh` is the shape of out-of-focus points, in place of
    /// the model's.
    ///
    /// # Errors
    /// If the model is for another width, or its defocus is in relative inverse depth (the depths here are metric).
    pub fn new(model: &CameraModel, width: usize, bokeh: impl Into<Option<Bokeh>>) -> Result<Self> {
        let shutter = model.motion_blur.known().map(|m| m.shutter());
        Ok(Self { shutter, ..Self::default() }.with_lens(model, metric_lens(model, width)?, bokeh.into()))
    }

    /// The blur that footage of camera `from` lacks to look like that of camera `to`. Variances add, so the differences of variances are
    /// taken; where `from` blurs more, nothing is blurred. What is unknown of either camera blurs nothing. The phases of the shutters are
    /// left out: footage stays where it is.
    ///
    /// # Errors
    /// The same as [`Blur::new`], for either model.
    pub fn missing(
        from: &CameraModel,
        to: &CameraModel,
        width: usize,
        bokeh: impl Into<Option<Bokeh>>,
    ) -> Result<Self> {
        let lenses = metric_lens(from, width)?.zip(metric_lens(to, width)?);
        let exposures = from.motion_blur.known().zip(to.motion_blur.known());
        let shutter = exposures.map(|(from, to)| {
            let [from, to] = [from, to].map(|m| m.exposure.0);
            ExposureFraction((to * to - from * from).max(0.0).sqrt()).into()
        });
        let blur = Self { already: lenses.map(|l| l.0), shutter, ..Self::default() };
        Ok(blur.with_lens(to, lenses.map(|l| l.1), bokeh.into()))
    }

    fn with_lens(mut self, model: &CameraModel, defocus: Option<DefocusModel>, bokeh: Option<Bokeh>) -> Self {
        self.defocus = defocus;
        self.lens = defocus.map(|defocus| {
            let mut aperture = defocus.bokeh;
            aperture.bokeh = bokeh.unwrap_or(aperture.bokeh);
            let Capture { width, height, pixel_aspect, .. } = model.capture;
            Lens { pixel_aspect, ..Lens::new(aperture, (width, height)) }
        });
        let shape = self.lens.map_or(bokeh.unwrap_or_default(), |lens| lens.aperture.bokeh);
        let [x, y] = self.lens.map_or([1.0; 2], |lens| lens.stds());
        let edge = if shape == Bokeh::Gaussian { 0.0 } else { 1.0 };
        self.lens_reach = [defocus::aperture_reach(shape) * x.max(y), edge];
        self
    }

    /// The same blur for an image that is cut out of the picture, or of such an image, from pixel (x, y) on.
    pub(crate) fn cut_out(self, (x, y): (usize, usize)) -> Self {
        self.moved((x as isize, y as isize))
    }

    /// The same blur for an image that begins so many px left of the picture and above it.
    pub(crate) fn beginning_before(self, (left, top): (usize, usize)) -> Self {
        self.moved((-(left as isize), -(top as isize)))
    }

    fn moved(mut self, (x, y): (isize, isize)) -> Self {
        if let Some(lens) = &mut self.lens {
            lens.origin = (lens.origin.0 + x, lens.origin.1 + y);
        }
        self
    }

    /// The same blur with a shutter that is centred on the frame's time.
    pub(crate) fn centred(mut self) -> Self {
        self.shutter = self.shutter.map(|s| s.exposure.into());
        self
    }

    /// The exposure fraction over which motion is blurred; 0 if it is unknown.
    pub fn exposure(&self) -> ExposureFraction {
        self.shutter.unwrap_or_default().exposure
    }

    /// The defocus std at inverse depth `d` in 1/m, px; 0 where the depth is unknown (NaN) and where the std is below 1/128 px, so
    /// that surfaces in focus stay unchanged however their depth is rounded.
    pub fn sigma_px(&self, d: f32) -> f32 {
        let sigma = match self.defocus {
            Some(model) if d.is_finite() => {
                let sigma = model.sigma_px(d);
                let already = self.already.map_or(0.0, |lens| lens.sigma_px(d));
                // Without a blur there already, the root of the square would not be exact.
                let missing =
                    if already > 0.0 { (sigma * sigma - already * already).max(0.0).sqrt() } else { sigma };
                missing.min(defocus::MAX_SIGMA_PX)
            }
            _ => 0.0,
        };
        if sigma < 1.0 / 128.0 { 0.0 } else { sigma }
    }

    /// The distance, px, to which blur spreads a point of this inverse depth (1/m) and flow (px per frame interval).
    pub fn reach_px(&self, d: f32, [u, v]: [f32; 2]) -> f32 {
        let path = self.shutter.map_or(0.0, |s| s.reach() * u.hypot(v));
        let [stds, edge] = self.lens_reach;
        stds * self.sigma_px(d) + edge + if path.is_finite() { path } else { 0.0 }
    }

    /// Applies defocus, then motion blur, each only if its model and its evidence are known.
    ///
    /// # Errors
    /// If depth or flow has another size than the image.
    pub fn of<P: Pixel>(
        &self,
        image: &Raster<P>,
        inverse_depth: Option<&Plane>,
        flow: Option<&Flow>,
    ) -> Result<Raster<P>> {
        let focused = match (inverse_depth, self.defocus, self.lens) {
            (Some(d), Some(defocus), Some(lens)) => {
                let sigma =
                    |d: f32| if defocus.is_before_focus(d) { -self.sigma_px(d) } else { self.sigma_px(d) };
                defocus::defocus_through(image, &d.map(sigma), &lens)?
            }
            _ => image.clone(),
        };
        match (flow, self.shutter) {
            (Some(flow), Some(shutter)) => motion_blur::motion_blur(&focused, flow, shutter),
            _ => Ok(focused),
        }
    }
}

/// The lens of a camera model, if it is known.
fn metric_lens(model: &CameraModel, width: usize) -> Result<Option<DefocusModel>> {
    model.check_width(width)?;
    let lens = model.defocus.known().copied();
    if lens.is_some_and(|d| d.depth_kind == DepthKind::Relative) {
        return Err(Error::new(
            "the camera model's defocus is in relative inverse depth; say how that relates to metres (DefocusModel::to_metric, \
             --scene-scale), or mark the defocus unknown",
        ));
    }
    Ok(lens)
}

/// Options of [`distort_frame`].
#[derive(Clone, Copy, Debug, Default)]
pub struct SynthesisOptions {
    /// The shape of out-of-focus points, in place of the lens's own (default: the lens's own).
    pub bokeh: Option<Bokeh>,
    /// Leave out the noise (default: false).
    pub no_noise: bool,
    /// The seed of the noise, which is a function of the seed and the frame's number (default: 0).
    pub seed: u64,
    /// Keep values above white, as scene-linear footage has them, instead of clipping as a sensor does (default: false).
    pub unclipped: bool,
}

/// A sharp, noise-free frame as the camera would have filmed it: defocus, motion blur, sharpening, noise.
///
/// `inverse_depth` (1/m) and `flow` (px per frame interval) are those of the frame, NaN where unknown; parts of the model that are
/// unknown, or whose evidence is missing, are not applied. `number` is the frame's; each number has its own noise.
///
/// # Errors
/// If sizes differ, or the model is for another width or in relative inverse depth.
pub fn distort_frame(
    frame: &Linear,
    model: &CameraModel,
    inverse_depth: Option<&Plane>,
    flow: Option<&Flow>,
    options: &SynthesisOptions,
    number: u64,
) -> Result<Encoded> {
    let light = |x, y| frame.0.at(x, y);
    let distorted =
        DistortedFrame::new(frame.0.size(), Box::new(light), model, inverse_depth, flow, options, number)?;
    let mut strips = distorted.in_strips(usize::MAX);
    Ok(Encoded(strips.next().unwrap_or_else(|| Raster::filled(frame.0.width(), 0, [0.0; 3]))))
}

/// [`distort_frame`] of a display-encoded frame, in strips of rows from the top: the result has the same bits, but a large frame
/// takes little memory beside the arguments ([`bytes_beside`]).
///
/// # Errors
/// The same as [`distort_frame`].
pub fn distorted_strips<'a>(
    frame: &'a Encoded,
    model: &'a CameraModel,
    inverse_depth: Option<&'a Plane>,
    flow: Option<&'a Flow>,
    options: &SynthesisOptions,
    number: u64,
) -> Result<impl Iterator<Item = Raster<[f32; 3]>> + 'a> {
    let light = |x, y| frame.0.at(x, y).map(|v| model.transfer.decode(v));
    let distorted =
        DistortedFrame::new(frame.0.size(), Box::new(light), model, inverse_depth, flow, options, number)?;
    Ok(distorted.in_strips(STRIP))
}

/// An estimate of the most bytes that [`distorted_strips`] takes for a frame of this size, beside its arguments.
pub fn bytes_beside(size @ (width, height): (usize, usize), with_depth: bool) -> u64 {
    /// Bytes for each pixel of a strip, measured.
    const OF_STRIP: u64 = 100;
    /// Bytes for each pixel of the frame where depth is known, measured.
    const WITH_DEPTH: u64 = 240;
    let of_depth = if with_depth { WITH_DEPTH * (width * height) as u64 } else { 0 };
    of_depth.max(OF_STRIP * largest_strip(size))
}

/// A frame and the distortions that are applied to it.
struct DistortedFrame<'a> {
    size: (usize, usize),
    /// The linear light of pixel (x, y).
    light: Box<dyn Fn(usize, usize) -> [f32; 3] + Sync + 'a>,
    space: Space,
    /// The whole frame, blurred slab by slab, if depth is known: surfaces at different depths hide each other.
    blurred: Option<Raster<[f32; 3]>>,
    moving: Option<(&'a Flow, Shutter)>,
    sharpening: Option<&'a SharpeningModel>,
    noise: Option<&'a NoiseModel>,
    /// The encoded value at which the sensor clips, at most 1; infinite if nothing is to be clipped.
    clip: f32,
    seed: u64,
    number: u64,
}

impl<'a> DistortedFrame<'a> {
    fn new(
        size: (usize, usize),
        light: Box<dyn Fn(usize, usize) -> [f32; 3] + Sync + 'a>,
        model: &'a CameraModel,
        inverse_depth: Option<&Plane>,
        flow: Option<&'a Flow>,
        options: &SynthesisOptions,
        number: u64,
    ) -> Result<Self> {
        let blur = Blur::new(model, size.0, options.bokeh)?;
        let noise = model.noise.known().filter(|_| !options.no_noise);
        let mut distortion = Self {
            size,
            light,
            space: model.space(),
            blurred: None,
            moving: None,
            sharpening: model.sharpening.known(),
            noise,
            clip: match options.unclipped {
                true => f32::INFINITY,
                false => noise.map_or(1.0, |m| m.clip().min(1.0)),
            },
            seed: options.seed,
            number,
        };
        match (inverse_depth, flow, blur.shutter) {
            (Some(depth), ..) => {
                distortion.blurred =
                    Some(blur.of_scene(&distortion.sharp(&(0..size.1)), Some(depth), flow)?);
            }
            (None, Some(flow), Some(shutter)) => {
                motion_blur::check_size(size, flow)?;
                distortion.moving = shutter.moves().then_some((flow, shutter));
            }
            _ => {}
        }
        Ok(distortion)
    }

    /// The frame as it is filmed, in strips of at most `most` pixels.
    fn in_strips(self, most: usize) -> impl Iterator<Item = Raster<[f32; 3]>> + 'a {
        strips(self.size, most).map(move |strip| self.filmed(&strip))
    }

    /// Rows before blur, in the space in which blur acts.
    fn sharp(&self, rows: &Range<usize>) -> Raster<[f32; 3]> {
        Raster::from_fn(self.size.0, rows.len(), |x, y| self.space.of_linear((self.light)(x, rows.start + y)))
    }

    /// Rows after blur, display-encoded.
    fn blurred(&self, rows: &Range<usize>) -> Raster<[f32; 3]> {
        let height = self.size.1;
        let blurred = match (&self.blurred, self.moving) {
            (Some(whole), _) => whole.map_rows(rows.clone(), |v| v),
            (None, Some((flow, shutter))) => {
                let seen = grown(rows, motion_blur::reach_px(flow, shutter, rows.clone()), height);
                let sharp = motion_blur::Rows { rows: &self.sharp(&seen), top: seen.start, height };
                sharp.blurred(flow, shutter, rows.clone())
            }
            (None, None) => self.sharp(rows),
        };
        blurred.map(|v| self.space.encoded(v))
    }

    /// Rows before noise, display-encoded.
    fn clean(&self, rows: &Range<usize>) -> Raster<[f32; 3]> {
        let Some(model) = self.sharpening else { return self.blurred(rows) };
        let around = grown(rows, sharpening::reach_px(model), self.size.1);
        // Sharpening acts on values that the sensor has clipped.
        let clipped = self.blurred(&around).map(|v| v.map(|v| v.clamp(0.0, self.clip)));
        kept(sharpening::sharpen(&clipped, model), &around, rows)
    }

    fn filmed(&self, Strip { rows, around }: &Strip) -> Raster<[f32; 3]> {
        let seen = if self.noise.is_some() { around } else { rows };
        let clean = self.clean(seen);
        let noise = self.noise.map(|m| noise::noise_of_rows(m, &clean, seen.start, self.seed, self.number));
        let above = rows.start - seen.start;
        Raster::from_fn(self.size.0, rows.len(), |x, y| {
            let at = |image: &Raster<[f32; 3]>| image.at(x, above + y);
            let (v, n) = (at(&clean), noise.as_ref().map_or([0.0; 3], at));
            std::array::from_fn(|c| {
                if v[c] >= self.clip { self.clip } else { (v[c] + n[c]).clamp(0.0, self.clip) }
            })
        })
    }
}

/// The largest number of slabs into which a scene is cut: with more, the errors where a continuous surface is cut outweigh the gain
/// at silhouettes (measured on renders through a real lens and shutter).
const MOST_SLABS: usize = 3;

impl Blur {
    /// Blurs an opaque scene like [`Blur::of`], but slab by slab in depth, each continued under the nearer ones, from the back to the
    /// front. So a blurred foreground spreads over the background, and a sharp foreground does not leak into a blurred background.
    ///
    /// # Errors
    /// If depth or flow has another size than the image.
    pub fn of_scene(
        &self,
        image: &Raster<[f32; 3]>,
        inverse_depth: Option<&Plane>,
        flow: Option<&Flow>,
    ) -> Result<Raster<[f32; 3]>> {
        let plain = || self.of(image, inverse_depth, flow);
        let Some(depth) = inverse_depth.filter(|d| d.size() == image.size()) else { return plain() };
        if flow.is_some_and(|f| f.size() != image.size()) {
            return plain();
        }
        let starts = self.slab_starts(depth, flow);
        if starts.len() < 2 {
            return plain();
        }
        let (w, h) = image.size();
        // The scene holds colour, depth and flow, unknown depth and flow filled in.
        let known = extended(depth, |_, _| 1.0);
        let known_flow = flow.map(|f| extended(f, |_, _| 1.0));
        let scene = Raster::from_fn(w, h, |x, y| {
            let ([r, g, b], [u, v]) = (image.at(x, y), known_flow.as_ref().map_or([0.0; 2], |f| f.at(x, y)));
            [r, g, b, known.at(x, y), u, v]
        });
        let inside: Vec<f32> = starts
            .iter()
            .zip(starts[1..].iter().chain(&[f32::INFINITY]))
            .filter(|&(start, end)| known.data().iter().any(|d| (start..end).contains(&d)))
            .map(|(&start, _)| start)
            .collect();
        let reach = Raster::from_fn(1, h, |_, y| {
            scene.row(y).iter().map(|&[.., d, u, v]| self.reach_px(d, [u, v])).fold(0.0, f32::max)
        });
        let reach = reach.data().iter().copied().fold(0.0, f32::max).ceil() as usize;
        let mut out: Option<Raster<[f32; 3]>> = None;
        let mut here = Counts::new(&known, |_| true);
        for (i, &start) in inside.iter().enumerate() {
            let end = inside.get(i + 1).copied().unwrap_or(f32::INFINITY);
            let nearer = Counts::new(&known, |d| d >= end);
            let own =
                Plane::from_fn(w, h, |x, y| if (start..end).contains(&known.at(x, y)) { 1.0 } else { 0.0 });
            let scene = pyramid::pull_push(&scene, &own);
            // A slab is not blurred where it cannot be seen: none of it is within reach, or nearer slabs hide everything within reach.
            let seen = Raster::from_fn(w, h, |x, y| {
                here.within(x, y, reach) > 0 && nearer.within(x, y, reach) < nearer.area(x, y, reach)
            });
            let layer = Raster::from_fn(w, h, |x, y| {
                let [r, g, b, ..] = scene.at(x, y);
                if known.at(x, y) >= start || i == 0 { [r, g, b, 1.0] } else { [0.0; 4] }
            });
            let depth = Plane::from_fn(w, h, |x, y| if seen.at(x, y) { scene.at(x, y)[3] } else { f32::NAN });
            let flow = flow.map(|_| {
                Flow::from_fn(w, h, |x, y| {
                    let [.., u, v] = scene.at(x, y);
                    if seen.at(x, y) { [u, v] } else { [0.0; 2] }
                })
            });
            let layer = self.of(&layer, Some(&depth), flow.as_ref())?;
            out = Some(match out {
                None => layer.map(|[r, g, b, _]| [r, g, b]),
                Some(behind) => Raster::from_fn(w, h, |x, y| {
                    let ([r, g, b, a], [p, q, s]) = (layer.at(x, y), behind.at(x, y));
                    [r + (1.0 - a) * p, g + (1.0 - a) * q, b + (1.0 - a) * s]
                }),
            });
            here = nearer;
        }
        out.map_or_else(plain, Ok)
    }

    /// The least inverse depth of each slab, 1/m, from the farthest, which starts at minus infinity. The slabs are evenly spaced,
    /// one for each px by which the blur's std varies over depth or flow, at most [`MOST_SLABS`].
    fn slab_starts(&self, depth: &Plane, flow: Option<&Flow>) -> Vec<f32> {
        // The 2nd and the 98th percentile of the finite values, of which every 16th is taken.
        let range = |values: &mut Vec<f32>| {
            values.retain(|v| v.is_finite());
            values.sort_by(f32::total_cmp);
            let n = values.len();
            if n == 0 { [0.0; 2] } else { [values[n / 50], values[n - 1 - n / 50]] }
        };
        let [lo, hi] = range(&mut depth.data().iter().step_by(16).copied().collect());
        let sigma = |i: usize| self.sigma_px(lo + (hi - lo) * i as f32 / 16.0);
        let mut spread: f32 = (0..16).map(|i| (sigma(i + 1) - sigma(i)).abs()).sum();
        if let (Some(flow), Some(Shutter { exposure, .. })) = (flow, self.shutter) {
            for c in 0..2 {
                let [a, b] = range(&mut flow.data().iter().step_by(16).map(|f| f[c]).collect());
                spread = spread.max(exposure.0 * (b - a) / 12f32.sqrt());
            }
        }
        let slabs = (spread.ceil() as usize).clamp(1, MOST_SLABS);
        (0..slabs)
            .map(|i| if i == 0 { f32::NEG_INFINITY } else { lo + (hi - lo) * i as f32 / slabs as f32 })
            .collect()
    }
}

/// The defocus std, px, at which a layer is cut into parts. Below it, the mixing of sharper and more blurred parts is not visible.
const CUT_PX: f32 = 1.0;

impl Blur {
    /// The inverse depths, 1/m, at which a layer is cut into the parts behind the focus, in focus, and in front of the focus;
    /// `None` without a lens.
    pub fn cuts(&self) -> Option<[f32; 2]> {
        self.defocus.map(|lens| lens.focus_range(CUT_PX))
    }

    /// Blurs a layer of premultiplied colour, whose depth and flow are known where it covers pixels.
    ///
    /// Depth and flow are continued past the layer's silhouette. The parts behind the focus, in focus and in front of it are
    /// blurred separately ([`Blur::cuts`]), so that a sharp part neither bleeds into blurred surroundings nor is cut off at their
    /// edge. Pixels of a farther part that nearer parts hide do not count (normalised convolution, Knutsson & Westin 1993); where
    /// nearer parts hide a whole kernel, the value comes from a smaller image of the farther part.
    ///
    /// # Errors
    /// If depth or flow has another size than the layer.
    pub fn of_layer(
        &self,
        color: &Raster<[f32; 4]>,
        inverse_depth: Option<&Plane>,
        flow: Option<&Flow>,
    ) -> Result<Raster<[f32; 4]>> {
        let (w, h) = color.size();
        let slabs = match (inverse_depth, self.cuts()) {
            (Some(depth), Some(cuts)) if depth.size() == color.size() => slabs(color, depth, cuts),
            _ => Raster::filled(w, h, 1),
        };
        let used = |slab: u8| color.data().iter().zip(slabs.data()).any(|(c, &s)| s == slab && c[3] > 0.0);
        let mut out: Option<Raster<[f32; 4]>> = None;
        for slab in (0..3).filter(|&s| used(s)) {
            let own =
                Raster::from_fn(w, h, |x, y| if slabs.at(x, y) == slab { color.at(x, y) } else { [0.0; 4] });
            let weight = coverage_weight(&own);
            let depth = inverse_depth.map(|d| extended(d, &weight));
            let flow = flow.map(|f| extended(f, &weight));
            let blurred = if (slab + 1..3).any(used) {
                // The fifth channel is the alpha of the nearer parts.
                let part = Raster::from_fn(w, h, |x, y| {
                    let ([r, g, b, a], nearer) = (own.at(x, y), slabs.at(x, y) > slab);
                    [r, g, b, a, if nearer { color.at(x, y)[3] } else { 0.0 }]
                });
                let focused = Self { shutter: None, ..*self }.of(&part, depth.as_ref(), None)?;
                Self { defocus: None, lens: None, ..*self }.of(&seen(&focused, &part), None, flow.as_ref())?
            } else {
                self.of(&own, depth.as_ref(), flow.as_ref())?
            };
            out = Some(match out {
                None => blurred,
                Some(behind) => Raster::from_fn(w, h, |x, y| {
                    let (n, f) = (blurred.at(x, y), behind.at(x, y));
                    std::array::from_fn(|c| n[c] + (1.0 - n[3]) * f[c])
                }),
            });
        }
        Ok(out.unwrap_or_else(|| color.clone()))
    }
}

/// The share of a kernel that must see a part for the part's value there to count as known.
pub const SEEN: f32 = 0.25;

/// The number of times that a part is halved to fill in where nearer parts hide it.
const FILL_OCTAVES: usize = 7;

/// A blurred part (R, G, B, A, alpha of the nearer parts), divided by the share of each kernel that sees it; where that share is
/// below [`SEEN`], smaller and smaller images of the sharp part fill in the rest.
fn seen(blurred: &Raster<[f32; 5]>, sharp: &Raster<[f32; 5]>) -> Raster<[f32; 4]> {
    let octaves = pyramid::halvings(sharp, FILL_OCTAVES);
    Raster::from_fn(blurred.width(), blurred.height(), |x, y| {
        let (mut sum, mut known) = ([0.0f32; 4], 0.0);
        let mut add = |v: [f32; 5]| {
            let share = (1.0 - v[4]).max(0.0);
            let weight = (1.0 - known) * (share / SEEN).min(1.0);
            if weight > 0.0 {
                for (s, v) in sum.iter_mut().zip(v) {
                    *s += weight / share * v;
                }
                known += weight;
            }
            known < 1.0
        };
        let mut more = add(blurred.at(x, y));
        let mut scale = 1.0;
        for octave in &octaves {
            scale *= 0.5;
            more = more && add(octave.bilinear(scale * x as f32, scale * y as f32));
        }
        sum.map(|v| v / known.max(1e-6))
    })
}

/// The weight of each pixel's depth and flow, in [0, 1]: where a layer covers a pixel in part, they may be those of the background,
/// so that fully covered pixels count most.
pub(crate) fn coverage_weight(layer: &Raster<[f32; 4]>) -> impl Fn(usize, usize) -> f32 + Sync {
    let most = layer.data().iter().map(|c| c[3]).fold(0.0, f32::max).max(1e-6);
    move |x, y| (layer.at(x, y)[3] / most).powi(8)
}

/// The part to which each pixel belongs: 0 behind the first inverse depth, 2 in front of the second, 1 elsewhere and where depth is
/// unknown. At silhouettes, the neighbour of largest alpha decides.
fn slabs(color: &Raster<[f32; 4]>, depth: &Plane, [behind, before]: [f32; 2]) -> Raster<u8> {
    let (w, h) = color.size();
    Raster::from_fn(w, h, |x, y| {
        let (mut alpha, mut d) = (color.at(x, y)[3], depth.at(x, y));
        if alpha < OPAQUE {
            for j in y.saturating_sub(1)..(y + 2).min(h) {
                for i in x.saturating_sub(1)..(x + 2).min(w) {
                    if color.at(i, j)[3] > alpha {
                        (alpha, d) = (color.at(i, j)[3], depth.at(i, j));
                    }
                }
            }
        }
        if d < behind {
            0
        } else if d > before {
            2
        } else {
            1
        }
    })
}

/// The alpha from which on a pixel's depth is the layer's own.
pub const OPAQUE: f32 = 0.98;

/// A summed-area table of the pixels that have a property: counting them within a square takes four look-ups.
struct Counts(Raster<u32>);

impl Counts {
    fn new(values: &Plane, has: impl Fn(f32) -> bool) -> Self {
        let (w, h) = values.size();
        let mut sums = Raster::filled(w + 1, h + 1, 0);
        for y in 0..h {
            let mut row = 0;
            for x in 0..w {
                row += u32::from(has(values.at(x, y)));
                let above = sums.at(x + 1, y);
                sums.row_mut(y + 1)[x + 1] = above + row;
            }
        }
        Self(sums)
    }

    /// Left, top, right and bottom of the square of pixels at most `reach` px from (x, y), within the image.
    fn square(&self, x: usize, y: usize, reach: usize) -> [usize; 4] {
        let (w, h) = (self.0.width() - 1, self.0.height() - 1);
        let end = |at: usize, size: usize| (at + 1).saturating_add(reach).min(size);
        [x.saturating_sub(reach), y.saturating_sub(reach), end(x, w), end(y, h)]
    }

    /// The number of pixels of the square that have the property.
    fn within(&self, x: usize, y: usize, reach: usize) -> u32 {
        let [left, top, right, bottom] = self.square(x, y, reach);
        self.0.at(right, bottom) + self.0.at(left, top) - self.0.at(left, bottom) - self.0.at(right, top)
    }

    /// The number of pixels of the square.
    fn area(&self, x: usize, y: usize, reach: usize) -> u32 {
        let [left, top, right, bottom] = self.square(x, y, reach);
        ((right - left) * (bottom - top)) as u32
    }
}

/// The values, continued into the pixels whose weight is 0 or whose value is unknown.
pub(crate) fn extended<P: Pixel>(
    values: &Raster<P>,
    weight: impl Fn(usize, usize) -> f32 + Sync,
) -> Raster<P> {
    let weight = Plane::from_fn(values.width(), values.height(), |x, y| {
        if P::flat(&[values.at(x, y)]).iter().all(|v| v.is_finite()) { weight(x, y) } else { 0.0 }
    });
    pyramid::pull_push(values, &weight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Transfer;
    use crate::model::{
        BlurSpace, Capture, Estimate, MotionBlurModel, NOISE_LEVELS, NoiseLevel, NoiseModel, Reason,
        SharpeningModel,
    };

    const W: usize = 200;
    const H: usize = 140;

    fn camera(sigma_at_infinity: f32, focus: f32, exposure: f32) -> CameraModel {
        let capture = Capture { width: W, height: H, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let mut model = CameraModel::unknown(capture, "not needed");
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
        model.defocus = Estimate::Known(DefocusModel::given_lens(sigma_at_infinity, focus));
        model
    }

    /// A textured wall at 0.2 / m, and in front of it at 1 / m a textured disk that moves.
    struct Scene {
        wall: Raster<[f32; 3]>,
        disk: Raster<[f32; 4]>,
        flow: [f32; 2],
    }

    const DEPTHS: [f32; 2] = [0.2, 1.0];

    impl Scene {
        fn new(flow: [f32; 2]) -> Self {
            let texture = |x: usize, y: usize, size: usize, [r, g, b]: [f32; 3]| {
                let v = if (x / size + y / size).is_multiple_of(2) { 1.0 } else { 0.4 };
                [r * v, g * v, b * v + 0.001 * x as f32]
            };
            let wall = Raster::from_fn(W, H, |x, y| texture(x, y, 9, [0.2, 0.4, 0.3]));
            let disk = Raster::from_fn(W, H, |x, y| {
                let a = (36.5 - (x as f32 - 100.0).hypot(y as f32 - 70.0)).clamp(0.0, 1.0);
                let [r, g, b] = texture(x, y, 12, [0.9, 0.6, 0.1]);
                [a * r, a * g, a * b, a]
            });
            Self { wall, disk, flow }
        }

        fn sharp(&self) -> Linear {
            Linear(Raster::from_fn(W, H, |x, y| {
                let ([r, g, b, a], w) = (self.disk.at(x, y), self.wall.at(x, y));
                [r + (1.0 - a) * w[0], g + (1.0 - a) * w[1], b + (1.0 - a) * w[2]]
            }))
        }

        fn inverse_depth(&self) -> Plane {
            self.disk.map(|d| if d[3] >= 0.5 { DEPTHS[1] } else { DEPTHS[0] })
        }

        fn flow(&self) -> Flow {
            self.disk.map(|d| if d[3] >= 0.5 { self.flow } else { [0.0; 2] })
        }

        /// The mean of the views from many points of the lens at many times, each sharp and with its own occlusion.
        fn filmed(&self, blur: &Blur, exposure: f32) -> Linear {
            let (lens, times) = (80, 7);
            Linear(Raster::from_fn(W, H, |x, y| {
                let mut sum = [0.0f32; 3];
                for i in 0..lens {
                    // The points are spread evenly over a disk of std 1 (Vogel 1979), mirrored for surfaces beyond the focus.
                    let (r, angle) = (2.0 * ((i as f32 + 0.5) / lens as f32).sqrt(), 2.399_963 * i as f32);
                    let [far, near] = DEPTHS.map(|d| {
                        let side = if d < 0.6 { -1.0 } else { 1.0 };
                        let s = side * blur.sigma_px(d);
                        [x as f32 + s * r * angle.cos(), y as f32 + s * r * angle.sin()]
                    });
                    let w = self.wall.bilinear(far[0], far[1]);
                    for j in 0..times {
                        let t = exposure * ((j as f32 + 0.5) / times as f32 - 0.5);
                        let [r, g, b, a] =
                            self.disk.bilinear(near[0] + t * self.flow[0], near[1] + t * self.flow[1]);
                        sum.add_scaled([r, g, b], 1.0);
                        sum.add_scaled(w, 1.0 - a);
                    }
                }
                sum.map(|s| s / (lens * times) as f32)
            }))
        }
    }

    #[test]
    fn slabs_come_closer_to_a_real_lens_and_shutter_than_a_plain_gather() {
        for (name, flow, model) in [
            ("near blurred", [0.0, 0.0], camera(3.0, 0.2001, 0.5)),
            ("far blurred", [0.0, 0.0], camera(4.0, 1.0, 0.5)),
            ("near moving", [24.0, 6.0], camera(0.0, 1.0, 0.5)),
            ("all", [16.0, -6.0], camera(3.0, 0.5, 0.5)),
        ] {
            let scene = Scene::new(flow);
            let blur = Blur::new(&model, W, Bokeh::Disk).unwrap();
            let (sharp, depth, flow) = (scene.sharp(), scene.inverse_depth(), scene.flow());
            let truth = scene.filmed(&blur, 0.5).to_encoded(Transfer::Srgb);
            let options = SynthesisOptions { bokeh: Some(Bokeh::Disk), ..SynthesisOptions::default() };
            let slabs = distort_frame(&sharp, &model, Some(&depth), Some(&flow), &options, 0).unwrap();
            let gather =
                Linear(blur.of(&sharp.0, Some(&depth), Some(&flow)).unwrap()).to_encoded(Transfer::Srgb);
            let psnr = |a: &Encoded| crate::metrics::psnr(a, &truth, None).unwrap();
            // The measured PSNRs in dB are: gather 28.1, 35.2, 35.3, 38.8; slabs 38.8, 42.4, 45.9, 45.5.
            assert!(psnr(&slabs) > 37.0, "{name}: {}", psnr(&slabs));
            assert!(psnr(&slabs) > psnr(&gather) + 5.0, "{name}: {} {}", psnr(&slabs), psnr(&gather));
        }
    }

    #[test]
    fn strips_are_the_whole_frame_bit_by_bit() {
        let (w, h) = (93, 709);
        let frame = Encoded(Raster::from_fn(w, h, |x, y| {
            [
                ((x * 7 + y * 13) % 29) as f32 / 25.0,
                0.5 + 0.4 * (0.3 * y as f32).sin(),
                (x * y % 17) as f32 / 17.0,
            ]
        }));
        // The flow is fast and slow, unknown in places, and in one row leads far out of the picture.
        let flow = Flow::from_fn(w, h, |x, y| match (x + 3 * y) % 41 {
            0 => [f32::NAN, 1.0],
            1 if y == 400 => [3.0, -1200.0],
            _ => [(y % 50) as f32 - 20.0, (x % 30) as f32 - 11.3],
        });
        let level = |l: usize| NoiseLevel { slope: [0.01 * l as f32; 3], intercept: [0.02, 0.01, 0.03] };
        let mut model = camera(2.0, 0.5, 0.7).scaled_to(w, h);
        model.noise = Estimate::Known(NoiseModel::given(std::array::from_fn(level), 0.9));
        let depth = Plane::from_fn(w, h, |x, y| 0.2 + 0.001 * (x + y) as f32);
        let bits = |image: &Raster<[f32; 3]>| -> Vec<u32> {
            image.data().iter().flatten().map(|v| v.to_bits()).collect()
        };
        for (sharpening, blur_space, depth, flow, no_noise) in [
            (None, BlurSpace::Linear, None, None, false),
            (Some(SharpeningModel::given(0.8, 1.3)), BlurSpace::Encoded, None, Some(&flow), false),
            (Some(SharpeningModel::given(0.8, 1.3)), BlurSpace::Linear, Some(&depth), Some(&flow), false),
            (None, BlurSpace::Linear, None, Some(&flow), true),
        ] {
            model.sharpening =
                sharpening.map_or_else(|| Estimate::unknown(Reason::NotSeen, "none"), Estimate::Known);
            model.blur_space = blur_space;
            let options = SynthesisOptions { seed: 5, no_noise, ..SynthesisOptions::default() };
            let whole =
                distort_frame(&frame.to_linear(model.transfer), &model, depth, flow, &options, 3).unwrap();
            let distorted = || {
                let light = |x, y| frame.0.at(x, y).map(|v| model.transfer.decode(v));
                DistortedFrame::new((w, h), Box::new(light), &model, depth, flow, &options, 3).unwrap()
            };
            for rows in [32, 96, 352, 704] {
                let strips: Vec<_> = distorted().in_strips(rows * w).collect();
                assert_eq!(strips.len(), h.div_ceil(rows));
                let strips: Vec<u32> = strips.iter().flat_map(bits).collect();
                assert!(strips == bits(&whole.0), "{rows} rows");
            }
            // Negative control: a strip without the rows around it has different noise.
            let alone = distorted().filmed(&Strip { rows: 64..128, around: 64..128 });
            assert_eq!(bits(&alone) == bits(&whole.0.crop(0, 64, w, 64)), no_noise);
        }
        let all: Vec<_> =
            distorted_strips(&frame, &model, None, None, &SynthesisOptions::default(), 3).unwrap().collect();
        assert_eq!(all.len(), 1);
    }

    #[test]
    fn a_still_pinhole_changes_nothing_and_noise_comes_last() {
        let scene = Scene::new([0.0; 2]);
        let mut model = camera(0.0, 1.0, 0.5);
        let sharp = scene.sharp();
        let run = |model: &CameraModel, number| {
            let (d, f) = (scene.inverse_depth(), scene.flow());
            distort_frame(&sharp, model, Some(&d), Some(&f), &SynthesisOptions::default(), number).unwrap()
        };
        let clean = sharp.to_encoded(Transfer::Srgb);
        assert!(run(&model, 1) == clean);
        let levels = [NoiseLevel { slope: [0.0; 3], intercept: [0.01; 3] }; NOISE_LEVELS];
        model.noise = Estimate::Known(NoiseModel::given(levels, 0.95));
        let noisy = run(&model, 1);
        assert!(noisy == run(&model, 1));
        assert!(noisy != run(&model, 2));
        let psnr = crate::metrics::psnr(&noisy, &clean, None).unwrap();
        assert!((25.0..45.0).contains(&psnr), "{psnr}");
        assert!(noisy.0.data().iter().flatten().all(|&v| v <= 0.95));
    }

    #[test]
    fn sharpening_follows_blur_and_what_is_clipped_has_no_halo_of_its_own() {
        let scene = Scene::new([0.0; 2]);
        let mut model = camera(3.0, 0.2001, 0.5);
        let run = |model: &CameraModel, sharp: &Linear| {
            let d = scene.inverse_depth();
            distort_frame(sharp, model, Some(&d), None, &SynthesisOptions::default(), 0).unwrap()
        };
        let bright = Linear(scene.sharp().0.map(|v| v.map(|v| if v > 0.5 { 30.0 } else { v })));
        let soft = [scene.sharp(), bright].map(|sharp| (run(&model, &sharp), sharp));
        let sharpening = SharpeningModel::given(0.8, 1.5);
        model.sharpening = Estimate::Known(sharpening);
        for (soft, sharp) in soft {
            let want = sharpening::sharpen(&soft.0, &sharpening).map(|v| v.map(|v| v.clamp(0.0, 1.0)));
            assert!(run(&model, &sharp).0 == want);
            assert!(want != soft.0);
        }
    }

    #[test]
    fn missing_evidence_is_left_out_and_wrong_sizes_are_errors() {
        let scene = Scene::new([20.0, 0.0]);
        let (model, sharp) = (camera(3.0, 0.2001, 0.5), scene.sharp());
        let run = |d: Option<&Plane>, f: Option<&Flow>| {
            distort_frame(&sharp, &model, d, f, &SynthesisOptions::default(), 0)
        };
        assert!(run(None, None).unwrap() == sharp.to_encoded(Transfer::Srgb));
        let unknown = Plane::filled(W, H, f32::NAN);
        assert!(run(Some(&unknown), None).unwrap() == sharp.to_encoded(Transfer::Srgb));
        assert!(run(Some(&Plane::filled(3, 3, 1.0)), None).is_err());
        assert!(run(None, Some(&Flow::filled(3, 3, [0.0; 2]))).is_err());
        assert!(run(Some(&scene.inverse_depth()), Some(&Flow::filled(3, 3, [0.0; 2]))).is_err());
    }

    #[test]
    fn parts_of_a_layer_at_different_depths_do_not_bleed() {
        // A square in front of a wall, one of them in focus.
        let square = |x: usize, y: usize| (70..120).contains(&x) && (40..90).contains(&y);
        let wall = |_: usize, _: usize| true;
        let flat = |v: f32, here: &(dyn Fn(usize, usize) -> bool + Sync)| {
            Raster::from_fn(W, H, |x, y| if here(x, y) { [v, v, v, 1.0] } else { [0.0; 4] })
        };
        let layer =
            Raster::from_fn(
                W,
                H,
                |x, y| {
                    if square(x, y) { [0.9, 0.9, 0.9, 1.0] } else { [0.1, 0.1, 0.1, 1.0] }
                },
            );
        let [far, near] = DEPTHS;
        let depth = Plane::from_fn(W, H, |x, y| if square(x, y) { near } else { far });
        for (focus, sigma_at_infinity) in [(near, 6.0), (far, 1.5)] {
            let blur = Blur::new(&camera(sigma_at_infinity, focus, 0.0), W, Bokeh::Gaussian).unwrap();
            // The truth: square and wall are each blurred whole, then laid one over the other.
            let apart = |v, here: &(dyn Fn(usize, usize) -> bool + Sync), d| {
                blur.of(&flat(v, here), Some(&Plane::filled(W, H, d)), None).unwrap()
            };
            let (behind, front) = (apart(0.1, &wall, far), apart(0.9, &square, near));
            let error = |image: &Raster<[f32; 4]>| {
                let of = |x, y| {
                    let (f, b) = (front.at(x, y), behind.at(x, y));
                    (0..4).map(|c| (f[c] + (1.0 - f[3]) * b[c] - image.at(x, y)[c]).abs()).fold(0.0, f32::max)
                };
                (0..W * H).map(|i| of(i % W, i / W)).fold(0.0, f32::max)
            };
            let got = error(&blur.of_layer(&layer, Some(&depth), None).unwrap());
            assert!(got < 0.01, "focus {focus}: {got}");
            let together = error(&blur.of(&layer, Some(&depth), None).unwrap());
            assert!(together > 0.2, "focus {focus}: {together}");
        }
    }

    #[test]
    fn a_surface_that_leaves_the_focus_has_no_seam() {
        let blur = Blur::new(&camera(6.0, 0.5, 0.0), W, Bokeh::Gaussian).unwrap();
        let [behind, before] = blur.cuts().unwrap();
        assert!((blur.sigma_px(behind) - 1.0).abs() < 1e-4 && behind < 0.5);
        assert!((blur.sigma_px(before) - 1.0).abs() < 1e-4 && before > 0.5);
        let depth = Plane::from_fn(W, H, |x, _| 0.2 + 0.6 * x as f32 / W as f32);
        let even = Raster::filled(W, H, [0.3, 0.6, 0.2, 1.0]);
        let got = blur.of_layer(&even, Some(&depth), None).unwrap();
        let off = got.data().iter().flat_map(|v| [v[0] - 0.3, v[3] - 1.0]).map(f32::abs).fold(0.0, f32::max);
        assert!(off < 0.01, "{off}");
        let textured = Raster::from_fn(W, H, |x, y| {
            let v = 0.4 + 0.3 * (0.3 * x as f32).sin() * (0.2 * y as f32).cos();
            [v, v, v, 1.0]
        });
        let [apart, together] =
            [blur.of_layer(&textured, Some(&depth), None), blur.of(&textured, Some(&depth), None)]
                .map(Result::unwrap);
        let off =
            apart.data().iter().zip(together.data()).map(|(a, b)| (a[0] - b[0]).abs()).fold(0.0, f32::max);
        assert!(off < 0.02, "{off}");
        // Nothing changes for a layer at one depth.
        let plane = Plane::filled(W, H, 0.1);
        let [apart, together] =
            [blur.of_layer(&textured, Some(&plane), None), blur.of(&textured, Some(&plane), None)]
                .map(Result::unwrap);
        let off =
            apart.data().iter().zip(together.data()).map(|(a, b)| (a[0] - b[0]).abs()).fold(0.0, f32::max);
        assert!(off < 1e-6, "{off}");
    }
}
