//! The virtual layer over the frame, as if the camera had filmed it.
//!
//! With F the frame, L and A the colour and alpha of the blurred layer, V how much of it the blurred real things in front
//! let through, B what of the background these let through, and D the blurred shadows and reflections, the result is
//!
//! ```text
//! F + D (1 - A V) + V L - A B,      where B = F if nothing is in front
//! ```
//!
//! and last comes the noise that is missing.

use crate::model::{BlurSpace, CameraModel, NoiseModel};
use crate::synth::{Blur, defocus::Bokeh, noise};
use crate::{
    Encoded, Error, Flow, Linear, Pixel, Plane, Premultiplied, Raster, Result, Transfer, filter, luma,
    pyramid,
};

/// A rendered object, sharp.
#[derive(Clone, Debug)]
pub struct VirtualLayer {
    /// Colour, premultiplied. What real things hide may be cut out or not.
    pub color: Premultiplied,
    /// Inverse depth in 1/m, NaN where there is none. Without it, there is no defocus and no occlusion.
    pub inverse_depth: Option<Plane>,
    /// Flow of the object. Without it, there is no motion blur.
    pub flow: Option<Flow>,
}

/// A frame of the camera and what is known of the scene in it.
#[derive(Clone, Copy, Debug)]
pub struct Shot<'a> {
    /// The frame as it was filmed.
    pub frame: &'a Encoded,
    /// The frame's number, so that each has its own noise.
    pub number: u64,
    /// Inverse depth in 1/m of what was filmed, NaN where unknown (which hides nothing).
    pub inverse_depth: Option<&'a Plane>,
    /// Flow of what was filmed.
    pub flow: Option<&'a Flow>,
    /// Sharp renders of the local scene with and without the object, for its shadows and reflections (Debevec 1998).
    pub with_and_without: Option<(&'a Linear, &'a Linear)>,
}

/// How to composite.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Leave out what the camera does: no blur, no noise.
    pub naive: bool,
    /// Leave out the noise.
    pub no_noise: bool,
    /// The shape of out-of-focus points.
    pub bokeh: Bokeh,
    /// The noise is a function of this and the frame's number.
    pub seed: u64,
}

/// Composites the layer over the frame. Where nothing virtual is seen, the result is the frame, bit by bit.
///
/// Parts of the model that are unknown are not applied; nor are those without the evidence for it (depth, flow). The model's
/// [`BlurSpace`] is also that of the compositing.
///
/// # Errors
/// If sizes differ, or the model is for another width or in relative inverse depth.
pub fn composite(
    shot: &Shot,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &Options,
) -> Result<Encoded> {
    check_sizes(shot, layer)?;
    let space = Space { blur: model.blur_space, transfer: model.transfer };
    let blur =
        if options.naive { Blur::default() } else { Blur::new(model, shot.frame.0.width(), options.bokeh)? };
    let shadows = Shadows::new(shot, layer, &space, &blur)?;
    let object = Object::new(shot, layer, &space, &blur)?;
    let changed = match (&shadows, &object) {
        (None, None) => return Ok(shot.frame.clone()),
        (Some(s), Some(o)) => s.place.union(o.place),
        (Some(s), None) => s.place,
        (None, Some(o)) => o.place,
    };
    let noise_model = model.noise.known().filter(|_| !options.naive && !options.no_noise);
    let frame = changed.crop(&shot.frame.0);
    let pixels = Raster::from_fn(changed.w, changed.h, |x, y| {
        let f = space.from_encoded(frame.at(x, y));
        let at = (x + changed.x, y + changed.y);
        let d = shadows.as_ref().and_then(|s| s.place.at(&s.difference, at)).unwrap_or_default();
        let o = object.as_ref().and_then(|o| o.place.at(&o.pixels, at)).unwrap_or_default();
        let light: [f32; 3] = std::array::from_fn(|c| (f[c] + d[c] * (1.0 - o.cover) + o.added[c]).max(0.0));
        Composited { light, kept: 1.0 - o.lost, untouched: o == ObjectPixel::default() && d == [0.0; 3] }
    });
    let clean = pixels.map(|p| space.to_encoded(p.light));
    let noise =
        noise_model.map(|m| missing_noise(m, &frame, &clean, &pixels, &space, options.seed, shot.number));
    let clip = noise_model.map_or(1.0, |m| m.clip.min(1.0));
    let mut out = shot.frame.clone();
    for y in 0..changed.h {
        for (x, out) in out.0.row_mut(changed.y + y)[changed.x..][..changed.w].iter_mut().enumerate() {
            if !pixels.at(x, y).untouched {
                let (v, n) = (clean.at(x, y), noise.as_ref().map_or([0.0; 3], |n| n.at(x, y)));
                *out =
                    std::array::from_fn(|c| if v[c] >= clip { clip } else { (v[c] + n[c]).clamp(0.0, clip) });
            }
        }
    }
    Ok(out)
}

fn check_sizes(shot: &Shot, layer: &VirtualLayer) -> Result<()> {
    let (w, h) = shot.frame.0.size();
    let check = |name: &str, size: Option<(usize, usize)>| match size {
        Some((a, b)) if (a, b) != (w, h) => Err(Error::new(format!(
            "{name} has {a} x {b} pixels but the frame {w} x {h}; render or scale it to the frame's size"
        ))),
        _ => Ok(()),
    };
    check("the virtual layer", Some(layer.color.0.size()))?;
    check("the virtual layer's depth", layer.inverse_depth.as_ref().map(|d| d.size()))?;
    check("the virtual layer's flow", layer.flow.as_ref().map(|f| f.size()))?;
    check("the real depth", shot.inverse_depth.map(|d| d.size()))?;
    check("the real flow", shot.flow.map(|f| f.size()))?;
    check("the render with the object", shot.with_and_without.map(|(w, _)| w.0.size()))?;
    check("the render without the object", shot.with_and_without.map(|(_, w)| w.0.size()))
}

/// The values that are blurred and mixed: light, or encoded values.
struct Space {
    blur: BlurSpace,
    transfer: Transfer,
}

impl Space {
    fn from_encoded(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v.map(|v| self.transfer.decode(v)),
            BlurSpace::Encoded => v,
        }
    }

    fn to_encoded(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v.map(|v| self.transfer.encode(v)),
            BlurSpace::Encoded => v,
        }
    }

    fn from_linear(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v,
            BlurSpace::Encoded => v.map(|v| self.transfer.encode(v)),
        }
    }

    /// Premultiplied in this space; broken pixels (NaN, infinite) are empty.
    fn from_premultiplied(&self, v: [f32; 4]) -> [f32; 4] {
        let [r, g, b, a] = v;
        if !v.iter().all(|v| v.is_finite()) || a < 0.0 {
            return [0.0; 4];
        }
        let a = a.min(1.0);
        match self.blur {
            BlurSpace::Encoded if a > 0.0 => {
                let [r, g, b] = self.from_linear([r / a, g / a, b / a]);
                [r * a, g * a, b * a, a]
            }
            _ => [r, g, b, a],
        }
    }

    /// d encoded / d value at the value that is encoded as `v`.
    fn slope(&self, v: f32) -> f32 {
        match self.blur {
            BlurSpace::Linear => self.transfer.slope(self.transfer.decode(v)),
            BlurSpace::Encoded => 1.0,
        }
    }
}

/// A part of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    x: usize,
    y: usize,
    w: usize,
    h: usize,
}

impl Place {
    /// The smallest one around the pixels that `holds` is true of, and `margin` px around them.
    fn around(
        (w, h): (usize, usize),
        margin: f32,
        holds: impl Fn(usize, usize) -> bool + Sync,
    ) -> Option<Self> {
        // Per row: first and last.
        let spans = Raster::from_fn(1, h, |_, y| {
            (0..w)
                .find(|&x| holds(x, y))
                .map(|first| (first, (first..w).rfind(|&x| holds(x, y)).unwrap_or(first)))
        });
        let rows = || spans.data().iter().enumerate().filter_map(|(y, s)| s.map(|s| (y, s)));
        let margin = margin.ceil() as usize;
        let (top, bottom) = (rows().next()?.0, rows().next_back()?.0);
        let left = rows().map(|(_, s)| s.0).min()?.saturating_sub(margin);
        let right = (rows().map(|(_, s)| s.1).max()? + margin).min(w - 1);
        let (y, bottom) = (top.saturating_sub(margin), (bottom + margin).min(h - 1));
        Some(Self { x: left, y, w: right + 1 - left, h: bottom + 1 - y })
    }

    fn union(self, b: Self) -> Self {
        let (x, y) = (self.x.min(b.x), self.y.min(b.y));
        let (right, bottom) = ((self.x + self.w).max(b.x + b.w), (self.y + self.h).max(b.y + b.h));
        Self { x, y, w: right - x, h: bottom - y }
    }

    fn crop<T: Copy + Send + Sync>(self, image: &Raster<T>) -> Raster<T> {
        image.crop(self.x, self.y, self.w, self.h)
    }

    /// The value of an image of this place at a position in the frame.
    fn at<T: Copy + Send + Sync>(self, image: &Raster<T>, (x, y): (usize, usize)) -> Option<T> {
        let (x, y) = (x.checked_sub(self.x)?, y.checked_sub(self.y)?);
        (x < self.w && y < self.h).then(|| image.at(x, y))
    }
}

/// Values continued into where `weight` is 0 or they are unknown.
fn extended<P: Pixel>(values: &Raster<P>, weight: impl Fn(usize, usize) -> f32 + Sync) -> Raster<P> {
    let weight = Plane::from_fn(values.width(), values.height(), |x, y| {
        if P::flat(&[values.at(x, y)]).iter().all(|v| v.is_finite()) { weight(x, y) } else { 0.0 }
    });
    pyramid::pull_push(values, &weight)
}

/// The shadows and reflections that the object adds to what was filmed, blurred as that is.
struct Shadows {
    place: Place,
    difference: Raster<[f32; 3]>,
}

/// Layer alpha above which the background's change is not seen in the renders.
const OPAQUE: f32 = 0.01;

impl Shadows {
    fn new(shot: &Shot, layer: &VirtualLayer, space: &Space, blur: &Blur) -> Result<Option<Self>> {
        let Some((with, without)) = shot.with_and_without else { return Ok(None) };
        // Where a render clips or the object is in front, the difference is not that of the background.
        let clipped = |v: [f32; 3]| v.iter().any(|v| (0.996..=1.0).contains(v) || !v.is_finite());
        let seen = |x, y| {
            layer.color.0.at(x, y)[3] <= OPAQUE && !clipped(with.0.at(x, y)) && !clipped(without.0.at(x, y))
        };
        let reach = Raster::from_fn(1, with.0.height(), |_, y| {
            (0..with.0.width())
                .map(|x| {
                    blur.reach_px(
                        shot.inverse_depth.map_or(f32::NAN, |d| d.at(x, y)),
                        shot.flow.map_or([0.0; 2], |f| f.at(x, y)),
                    )
                })
                .fold(0.0, f32::max)
        });
        let reach = reach.data().iter().copied().fold(0.0, f32::max);
        let differs = |x, y| with.0.at(x, y) != without.0.at(x, y);
        let Some(place) = Place::around(with.0.size(), reach + 1.0, differs) else { return Ok(None) };
        let sharp = Raster::from_fn(place.w, place.h, |x, y| {
            let at = (place.x + x, place.y + y);
            let [a, b] = [with, without].map(|i| space.from_linear(i.0.at(at.0, at.1)));
            std::array::from_fn(|c| a[c] - b[c])
        });
        // Continued under the object, so that it is there under the object's soft edge.
        let sharp = extended(&sharp, |x, y| if seen(place.x + x, place.y + y) { 1.0 } else { 0.0 });
        let difference = blur.of(
            &sharp,
            shot.inverse_depth.map(|d| place.crop(d)).as_ref(),
            shot.flow.map(|f| place.crop(f)).as_ref(),
        )?;
        Ok(Some(Self { place, difference }))
    }
}

/// What the object does to a pixel of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ObjectPixel {
    /// What is added: `V L - A B`.
    added: [f32; 3],
    /// How much of the background's light the object hides: `A V`.
    cover: f32,
    /// How much of the frame's own value, and so of its noise, is lost.
    lost: f32,
}

/// The object, blurred, and hidden by what is in front of it.
struct Object {
    place: Place,
    pixels: Raster<ObjectPixel>,
}

/// A real surface hides a virtual one if its inverse depth is larger by this factor: the tolerance of both depths.
const IN_FRONT: f32 = 1.02;

impl Object {
    fn new(shot: &Shot, layer: &VirtualLayer, space: &Space, blur: &Blur) -> Result<Option<Self>> {
        let alpha = |x, y| layer.color.0.at(x, y)[3];
        let size = layer.color.0.size();
        let Some(tight) = Place::around(size, 0.0, |x, y| alpha(x, y) > 0.0) else { return Ok(None) };
        let mut reach = 0.0f32;
        for y in tight.y..tight.y + tight.h {
            for x in (tight.x..tight.x + tight.w).filter(|&x| alpha(x, y) > 0.0) {
                let d = layer.inverse_depth.as_ref().map_or(f32::NAN, |d| d.at(x, y));
                let flow = layer.flow.as_ref().map_or([0.0; 2], |f| f.at(x, y));
                reach = reach.max(blur.reach_px(d, flow));
            }
        }
        let Some(place) = Place::around(size, reach + 1.0, |x, y| alpha(x, y) > 0.0) else { return Ok(None) };
        let color = place.crop(&layer.color.0).map(|v| space.from_premultiplied(v));
        // Depth and flow of a pixel that the object covers in part may be those of what is behind: the fully covered ones speak.
        let most = color.data().iter().map(|c| c[3]).fold(0.0, f32::max).max(1e-6);
        let weight = |x: usize, y: usize| (color.at(x, y)[3] / most).powi(8);
        let depth = layer.inverse_depth.as_ref().map(|d| extended(&place.crop(d), weight));
        let flow = layer.flow.as_ref().map(|f| extended(&place.crop(f), weight));
        let front = match (&depth, shot.inverse_depth) {
            (Some(depth), Some(real)) => Front::new(shot, place, depth, &place.crop(real), space, blur)?,
            _ => None,
        };
        let color = match &front {
            Some(front) => front.uncut(&color),
            None => color,
        };
        let blurred = blur.of(&color, depth.as_ref(), flow.as_ref())?;
        let pixels = Raster::from_fn(place.w, place.h, |x, y| {
            let [r, g, b, a] = blurred.at(x, y);
            if a <= 0.0 {
                return ObjectPixel::default();
            }
            match &front {
                None => {
                    let f = space.from_encoded(shot.frame.0.at(place.x + x, place.y + y));
                    ObjectPixel { added: [r - a * f[0], g - a * f[1], b - a * f[2]], cover: a, lost: a }
                }
                Some(front) => {
                    let (v, [p, q, s]) = (1.0 - front.coverage.at(x, y), front.behind.at(x, y));
                    ObjectPixel {
                        added: [v * r - a * p, v * g - a * q, v * b - a * s],
                        cover: a * v,
                        lost: a * front.share_behind.at(x, y),
                    }
                }
            }
        });
        Ok(Some(Self { place, pixels }))
    }
}

/// Real things in front of the object.
struct Front {
    /// Where they are, sharp: 1 or 0.
    mask: Plane,
    /// How much of the pixel they cover, blurred.
    coverage: Plane,
    /// What is seen of the background beside them: `B`.
    behind: Raster<[f32; 3]>,
    /// The share of a change of the frame's value that is the background's.
    share_behind: Plane,
}

impl Front {
    /// `None` if nothing is in front of a surface of this inverse depth.
    fn new(
        shot: &Shot,
        place: Place,
        virtual_depth: &Plane,
        real_depth: &Plane,
        space: &Space,
        blur: &Blur,
    ) -> Result<Option<Self>> {
        let (w, h) = virtual_depth.size();
        let mask = Plane::from_fn(w, h, |x, y| {
            if real_depth.at(x, y) > IN_FRONT * virtual_depth.at(x, y) { 1.0 } else { 0.0 }
        });
        if mask.data().iter().all(|&m| m == 0.0) {
            return Ok(None);
        }
        let depth = extended(real_depth, |x, y| mask.at(x, y));
        let flow = shot.flow.map(|f| extended(&place.crop(f), |x, y| mask.at(x, y)));
        let render = shot.with_and_without.map(|(_, without)| place.crop(&without.0));
        let sharp = Raster::from_fn(w, h, |x, y| {
            let m = mask.at(x, y);
            let [r, g, b] = render.as_ref().map_or([0.0; 3], |r| space.from_linear(r.at(x, y)));
            if m > 0.0 { [r, g, b, m] } else { [0.0; 4] }
        });
        let blurred = blur.of(&sharp, Some(&depth), flow.as_ref())?;
        let coverage = blurred.map(|v| v[3].clamp(0.0, 1.0));
        // The frame is c C + (1 - c) B0: what is in front and what is behind. First guesses: the frame's own colours where only one
        // of them is seen, continued; for what is in front the render, if there is one. Then the rest is shared out, more to
        // the less certain of them (least squares).
        let frame = place.crop(&shot.frame.0).map(|v| space.from_encoded(v));
        let only_front = extended(&frame, |x, y| if coverage.at(x, y) > 0.9 { 1.0 } else { 0.0 });
        let only_behind = extended(&frame, |x, y| if coverage.at(x, y) < 0.1 { 1.0 } else { 0.0 });
        let uncertainty = if render.is_some() { 16.0 } else { 2.0 };
        let share_behind = coverage.map(|c| {
            let (front, behind) = (c * c, uncertainty * (1.0 - c) * (1.0 - c));
            behind / (front + behind)
        });
        let behind = Raster::from_fn(w, h, |x, y| {
            let (c, f, b) = (coverage.at(x, y), frame.at(x, y), only_behind.at(x, y));
            let front: [f32; 3] = match render {
                Some(_) => std::array::from_fn(|i| blurred.at(x, y)[i]),
                None => only_front.at(x, y).map(|v| c * v),
            };
            std::array::from_fn(|i| {
                let guess = (1.0 - c) * b[i];
                (guess + share_behind.at(x, y) * (f[i] - front[i] - guess)).clamp(0.0, f[i].max(0.0))
            })
        });
        Ok(Some(Self { mask, coverage, behind, share_behind }))
    }

    /// The layer continued under what hides it, whether or not that was cut out: else the cut's edge would be blurred.
    fn uncut(&self, color: &Raster<[f32; 4]>) -> Raster<[f32; 4]> {
        let near = filter::convolve(&self.mask, &[0.5, 0.25]);
        extended(color, |x, y| if near.at(x, y) > 0.0 && color.at(x, y)[3] < 0.98 { 0.0 } else { 1.0 })
    }
}

/// A pixel of the result before noise.
#[derive(Clone, Copy, Debug, Default)]
struct Composited {
    light: [f32; 3],
    /// d light / d frame: how much of the frame's noise is still there.
    kept: f32,
    untouched: bool,
}

/// The noise that lifts what is left of the frame's own to the model's variance at the result's luminance.
fn missing_noise(
    model: &NoiseModel,
    frame: &Raster<[f32; 3]>,
    clean: &Raster<[f32; 3]>,
    pixels: &Raster<Composited>,
    space: &Space,
    seed: u64,
    number: u64,
) -> Raster<[f32; 3]> {
    let (w, h) = frame.size();
    // Noise depends on the luminance without noise. In `clean`, the part of the frame that is left brings its noise along.
    let smooth = filter::gaussian_blur(frame, 1.5);
    let gain = Raster::from_fn(w, h, |x, y| {
        let (s, v, k) = (smooth.at(x, y), clean.at(x, y), pixels.at(x, y).kept);
        let gain = |c: usize| (k * space.slope(v[c]) / space.slope(s[c])).clamp(0.0, 1.5);
        std::array::from_fn::<f32, 3, _>(|c| if s[c] >= model.clip { 0.0 } else { gain(c) })
    });
    let mut frame_luma = smooth.map(luma);
    let mut luma = Plane::from_fn(w, h, |x, y| {
        let (f, s, v, g) = (frame.at(x, y), smooth.at(x, y), clean.at(x, y), gain.at(x, y));
        luma(std::array::from_fn(|c| v[c] - g[c] * (f[c] - s[c])))
    });
    let mut kept_variance = gain.map(|g| g.map(|g| g * g));
    noise::modulated(noise::unit_bands(w, h, seed, number), |level| {
        if level > 0 {
            luma = pyramid::downsample(&luma);
            frame_luma = pyramid::downsample(&frame_luma);
            kept_variance = pyramid::downsample(&kept_variance);
        }
        let model = model.levels[level];
        Raster::from_fn(luma.width(), luma.height(), |x, y| {
            let (want, there) = (model.sigma(luma.at(x, y)), model.sigma(frame_luma.at(x, y)));
            let kept = kept_variance.at(x, y);
            std::array::from_fn(|c| (want[c] * want[c] - kept[c] * there[c] * there[c]).max(0.0).sqrt())
        })
    })
}
