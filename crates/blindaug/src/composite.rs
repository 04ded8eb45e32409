//! The virtual layer over the frame, as if the camera had filmed it.
//!
//! F is the frame, L and A are the colour and alpha of the blurred layer, V is the share of the layer that the blurred real things in front
//! let through, and B is the background's light that these things let through. R is the blurred factor of the shadows, at most 1, and D the
//! blurred light of the reflections. The result is
//!
//! ```text
//! F + (F (R - 1) + D) (1 - A V) + V L - A B,      where B = F if nothing is in front
//! ```
//!
//! Shadows are a factor, the ratio of the renders with and without the object, so that they weaken the noise of the floor as they weaken its
//! light (a difference would leave the bright floor's noise in the dark). Where the object adds light, the difference of the renders is added.
//!
//! If the camera sharpens, F is the unsharpened frame, and the difference of the result to F is sharpened and added to the frame.
//! (The difference to the frame itself, sharpened, would leave a ghost of the background's detail on the object.) Finally, the
//! noise that is missing is added.

mod object;
mod place;
mod shadows;
#[cfg(test)]
mod tests;

use self::object::Object;
use self::place::Place;
use self::shadows::Shadows;
use crate::model::{CameraModel, NoiseModel, SharpeningModel, Space};
use crate::synth::{Blur, coverage_weight, defocus::Bokeh, extended, noise, sharpening};
use crate::{Encoded, Error, Flow, Linear, Overscan, Plane, Premultiplied, Raster, Result, filter};

/// A rendered object, sharp.
#[derive(Clone, Debug)]
pub struct VirtualLayer {
    /// Premultiplied colour. The parts that real things hide may be cut out or not.
    pub color: Premultiplied,
    /// Inverse depth of the object, 1/m, NaN where there is none. Without it, there is no defocus and no occlusion.
    pub inverse_depth: Option<Plane>,
    /// Flow of the object, px per frame interval. Without it, there is no motion blur.
    pub flow: Option<Flow>,
}

/// A frame of the camera and what is known of the scene in it.
#[derive(Clone, Copy, Debug)]
pub struct Plate<'a> {
    /// The frame as it was filmed.
    pub frame: &'a Encoded,
    /// The frame's number; each number has its own noise.
    pub number: u64,
    /// Inverse depth of the filmed scene, 1/m; NaN where unknown, which hides nothing.
    pub inverse_depth: Option<&'a Plane>,
    /// Flow of the filmed scene, px per frame interval.
    pub flow: Option<&'a Flow>,
    /// Sharp renders of the local scene with and without the object, for its shadows and reflections (after Debevec 1998).
    pub with_and_without: Option<(&'a Linear, &'a Linear)>,
    /// A matte: the share of each pixel that things in front of the object cover, in [0, 1], with edges as soft as they are in the frame.
    pub holdout: Option<&'a Plane>,
    /// How far the virtual layer reaches beyond the frame, px: what lies there is blurred into the frame.
    pub overscan: Overscan,
}

impl<'a> Plate<'a> {
    /// A frame of this number, of whose scene nothing else is known.
    pub fn new(frame: &'a Encoded, number: u64) -> Self {
        let overscan = Overscan::default();
        Self {
            frame,
            number,
            inverse_depth: None,
            flow: None,
            with_and_without: None,
            holdout: None,
            overscan,
        }
    }
}

/// Options of [`composite`].
#[derive(Clone, Copy, Debug, Default)]
pub struct CompositeOptions {
    /// Leave out the camera's distortions: no blur, no sharpening, no noise (default: false).
    pub naive: bool,
    /// Leave out the noise (default: false).
    pub no_noise: bool,
    /// The shape of out-of-focus points, in place of the lens's own (default: the lens's own).
    pub bokeh: Option<Bokeh>,
    /// The seed of the noise, which is a function of the seed and the frame's number (default: 0).
    pub seed: u64,
    /// Keep values above white and below black, as scene-linear footage has them, instead of clipping as a sensor does (default: false).
    pub unclipped: bool,
}

/// Composites the layer over the frame. Where nothing virtual is seen, the result is the frame, bit by bit.
///
/// Parts of the model that are unknown, or whose evidence (depth, flow) is missing, are not applied. The model's
/// [`crate::model::BlurSpace`] is also that of the compositing.
///
/// # Errors
/// If sizes differ, or the model is for another width or in relative inverse depth.
pub fn composite(
    plate: &Plate,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Result<Encoded> {
    let mut whole = plate.frame.clone();
    continued(plate, layer, |plate| {
        if let Some(made) = Made::new(plate, layer, model, options)? {
            let out = made.with_noise(|_, _, v| v);
            made.changed.paste_into_frame(&out, &mut whole.0, plate.overscan);
        }
        Ok(())
    })?;
    Ok(whole)
}

/// Calls `make` with a plate that is as large as the layer: beyond the frame, all that was filmed is continued from the frame's edge.
fn continued<T>(plate: &Plate, layer: &VirtualLayer, make: impl FnOnce(&Plate) -> Result<T>) -> Result<T> {
    check_sizes(plate, layer)?;
    let overscan = plate.overscan;
    if overscan.is_none() {
        return make(plate);
    }
    let frame = Encoded(overscan.continued(&plate.frame.0));
    let [depth, holdout] = [plate.inverse_depth, plate.holdout].map(|p| p.map(|p| overscan.continued(p)));
    let flow = plate.flow.map(|f| overscan.continued(f));
    let renders = plate.with_and_without.map(|(a, b)| [a, b].map(|r| Linear(overscan.continued(&r.0))));
    make(&Plate {
        frame: &frame,
        number: plate.number,
        inverse_depth: depth.as_ref(),
        flow: flow.as_ref(),
        with_and_without: renders.as_ref().map(|[with, without]| (with, without)),
        holdout: holdout.as_ref(),
        overscan,
    })
}

/// What a composite adds to a frame, apart, for a compositing program. For each pixel and channel, with F the frame in linear light,
///
/// ```text
/// colour + (1 - alpha) F + noise
/// ```
///
/// is the composite's light. The colour holds all that the object changes besides what alpha says, so that it may be below 0: shadows,
/// the background's light where real things are in front, and halos of a camera that sharpens.
///
/// It is as large as the virtual layer. Beyond the frame, F is taken to go on as it is at the frame's edge.
#[derive(Clone, Debug, PartialEq)]
pub struct DistortedLayer {
    /// Premultiplied colour in linear light, and alpha: the blurred layer's coverage, less what real things hide.
    pub color: Premultiplied,
    /// The noise, in linear light.
    pub noise: Raster<[f32; 3]>,
    /// The share of the layer that the blurred real things in front let through, in [0, 1]; 1 away from the layer.
    pub holdout: Plane,
    /// Inverse depth of the object, 1/m, continued under its blurred edge; NaN where alpha is 0 or it has none.
    pub inverse_depth: Plane,
    /// Flow of the object, px per frame interval, continued under its blurred edge; 0 where alpha is 0 or it has none.
    pub flow: Flow,
    /// How far the layer reaches beyond the frame, px.
    pub overscan: Overscan,
}

impl DistortedLayer {
    /// A layer of this width and height, px, in which there is nothing.
    pub fn empty((width, height): (usize, usize)) -> Self {
        Self {
            color: Premultiplied(Raster::filled(width, height, [0.0; 4])),
            noise: Raster::filled(width, height, [0.0; 3]),
            holdout: Plane::filled(width, height, 1.0),
            inverse_depth: Plane::filled(width, height, f32::NAN),
            flow: Flow::filled(width, height, [0.0; 2]),
            overscan: Overscan::default(),
        }
    }
}

/// What [`composite`] adds to the frame, apart.
///
/// # Errors
/// The same as [`composite`].
pub fn distorted_layer(
    plate: &Plate,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Result<DistortedLayer> {
    continued(plate, layer, |plate| distorted_layer_of(plate, layer, model, options))
}

/// [`distorted_layer`] over a plate that is as large as the layer.
fn distorted_layer_of(
    plate: &Plate,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Result<DistortedLayer> {
    let overscan = plate.overscan;
    let mut whole = DistortedLayer { overscan, ..DistortedLayer::empty(plate.frame.0.size()) };
    let Some(made) = Made::new(plate, layer, model, options)? else { return Ok(whole) };
    let changed = made.changed;
    let of_object = |x: usize, y: usize| {
        made.object.as_ref().and_then(|o| o.place.at(&o.pixels, (x + changed.x, y + changed.y)))
    };
    let light = |v: [f32; 3]| v.map(|v| model.transfer.decode(v));
    let clean = made.without_noise();
    let color = Raster::from_fn(changed.w, changed.h, |x, y| {
        let alpha = of_object(x, y).map_or(0.0, |o| o.cover);
        let (out, f) = (light(clean.at(x, y)), light(made.frame.at(x, y)));
        match made.pixels.at(x, y).untouched && clean.at(x, y) == made.frame.at(x, y) {
            true => [0.0; 4],
            false => std::array::from_fn(|c| if c < 3 { out[c] - (1.0 - alpha) * f[c] } else { alpha }),
        }
    });
    let noise = made.with_noise(|x, y, v| {
        let (with, without) = (light(v), light(clean.at(x, y)));
        std::array::from_fn(|c| with[c] - without[c])
    });
    changed.paste(&color, &mut whole.color.0);
    changed.paste(&noise, &mut whole.noise);
    let Some(object) = &made.object else { return Ok(whole) };
    let place = object.place;
    let seen = |x, y| object.pixels.at(x, y).cover > 0.0;
    place.paste(&object.pixels.map(|o| o.visible), &mut whole.holdout);
    let of_layer = place.crop(&layer.color.0);
    if let Some(depth) = &layer.inverse_depth {
        let depth = extended(&place.crop(depth), coverage_weight(&of_layer));
        let depth =
            Plane::from_fn(place.w, place.h, |x, y| if seen(x, y) { depth.at(x, y) } else { f32::NAN });
        place.paste(&depth, &mut whole.inverse_depth);
    }
    if let Some(flow) = &layer.flow {
        let flow = extended(&place.crop(flow), coverage_weight(&of_layer));
        let flow = Flow::from_fn(place.w, place.h, |x, y| if seen(x, y) { flow.at(x, y) } else { [0.0; 2] });
        place.paste(&flow, &mut whole.flow);
    }
    Ok(whole)
}

/// The part of a composite that differs from the frame.
struct Made {
    changed: Place,
    /// The frame.
    frame: Raster<[f32; 3]>,
    pixels: Raster<Composited>,
    /// The composite before sharpening and noise, encoded.
    clean: Raster<[f32; 3]>,
    /// The sharpened difference to the frame, if the camera sharpens.
    sharpened: Option<Raster<[f32; 3]>>,
    noise: Option<Raster<[f32; 3]>>,
    object: Option<Object>,
    /// The encoded value at which the sensor clips, and that of the brightest that the frame holds.
    clip: f32,
    white: f32,
    /// The least encoded value that the frame holds.
    black: f32,
}

impl Made {
    /// Composites over a plate that is as large as the layer; `None` if nothing virtual is seen.
    fn new(
        plate: &Plate,
        layer: &VirtualLayer,
        model: &CameraModel,
        options: &CompositeOptions,
    ) -> Result<Option<Self>> {
        let Changes { blur, sharpening, places, all } = Changes::new(plate, layer, model, options)?;
        let Some(changed) = all else { return Ok(None) };
        let space = model.space();
        let frame = changed.crop(&plate.frame.0);
        let unsharpened = sharpening.map(|m| sharpening::unsharpen(&frame, &m));
        let background = unsharpened.as_ref().unwrap_or(&frame);
        let before = unsharpened.as_ref().map(|part| {
            let mut whole = plate.frame.clone();
            changed.paste(part, &mut whole.0);
            whole
        });
        let filmed = &Plate { frame: before.as_ref().unwrap_or(plate.frame), ..*plate };
        let [shadows, object] = places;
        let shadows =
            shadows.map(|place| Shadows::new(filmed, place, layer, &space, &blur)).transpose()?.flatten();
        let object = object.map(|place| Object::new(filmed, place, layer, &space, &blur)).transpose()?;
        let noise_model = model.noise.known().filter(|_| !options.naive && !options.no_noise);
        let (clip, white, black) = match options.unclipped {
            true => (f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY),
            false => (noise_model.map_or(1.0, |m| m.clip().min(1.0)), 1.0, 0.0),
        };
        // Encoded values end at 0; some cameras' curves encode light below 0, as noise in the dark has it.
        let darkest = if options.unclipped { black } else { space.of_encoded([0.0; 3])[0].min(0.0) };
        let pixels = Raster::from_fn(changed.w, changed.h, |x, y| {
            let f = space.of_encoded(background.at(x, y));
            let at = (x + changed.x, y + changed.y);
            let [r, g, b, d @ ..] =
                shadows.as_ref().and_then(|s| s.place.at(&s.change, at)).unwrap_or([0.0; 6]);
            let (lost, o) = ([r, g, b], object.as_ref().and_then(|o| o.place.at(&o.pixels, at)));
            let untouched = o.is_none_or(|o| o.changes_nothing()) && lost == [0.0; 3] && d == [0.0; 3];
            let o = o.unwrap_or_default();
            let seen = 1.0 - o.cover;
            let light: [f32; 3] =
                std::array::from_fn(|c| (f[c] + (f[c] * lost[c] + d[c]) * seen + o.added[c]).max(darkest));
            let kept = lost.map(|lost| (1.0 - o.lost + lost * seen).max(0.0));
            Composited { light, kept, untouched }
        });
        let clean = pixels.map(|p| space.encoded(p.light));
        let noise = noise_model
            .map(|m| missing_noise(m, background, &clean, &pixels, &space, options.seed, plate.number));
        let sharpened = sharpening.map(|m| {
            let difference = Raster::from_fn(changed.w, changed.h, |x, y| match pixels.at(x, y).untouched {
                true => [0.0; 3],
                // The sensor clips before the camera sharpens.
                false => {
                    std::array::from_fn(|c| clean.at(x, y)[c].clamp(black, clip) - background.at(x, y)[c])
                }
            });
            sharpening::sharpen(&difference, &m)
        });
        Ok(Some(Self { changed, frame, pixels, clean, sharpened, noise, object, clip, white, black }))
    }

    /// The composite in the changed place, with the noise; `then` gets the place in it and the value.
    fn with_noise(&self, then: impl Fn(usize, usize, [f32; 3]) -> [f32; 3] + Sync) -> Raster<[f32; 3]> {
        Raster::from_fn(self.changed.w, self.changed.h, |x, y| {
            let noise = self.noise.as_ref().map_or([0.0; 3], |n| n.at(x, y));
            then(x, y, self.pixel(x, y, noise))
        })
    }

    fn without_noise(&self) -> Raster<[f32; 3]> {
        Raster::from_fn(self.changed.w, self.changed.h, |x, y| self.pixel(x, y, [0.0; 3]))
    }

    fn pixel(&self, x: usize, y: usize, noise: [f32; 3]) -> [f32; 3] {
        let f = self.frame.at(x, y);
        let v = match &self.sharpened {
            Some(s) => std::array::from_fn(|c| f[c] + s.at(x, y)[c]),
            None => self.clean.at(x, y),
        };
        match (self.pixels.at(x, y).untouched, &self.sharpened) {
            (true, None) => f,
            // Around the object, sharpening may leave a halo; where it leaves none, v is f.
            (true, Some(_)) if v == f => f,
            (true, Some(_)) => v.map(|v| v.clamp(self.black, self.white)),
            (false, _) => std::array::from_fn(|c| {
                if v[c] >= self.clip { self.clip } else { (v[c] + noise[c]).clamp(self.black, self.clip) }
            }),
        }
    }
}

/// The most bytes that a changed pixel takes, measured with everything that a composite can be given.
const BYTES_PER_CHANGED_PIXEL: u64 = 300;

/// An estimate of the most bytes that [`composite`] takes beside its arguments and its result: proportional to the part of the
/// frame that the object and its shadows may change.
///
/// # Errors
/// The same as [`composite`].
pub fn bytes_beside(
    plate: &Plate,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Result<u64> {
    /// Bytes of a pixel of a continued plate: the frame, depth, a matte, flow and renders.
    const CONTINUED: u64 = 52;
    let changed = continued(plate, layer, |plate| Ok(Changes::new(plate, layer, model, options)?.all))?;
    let (width, height) = layer.color.0.size();
    let continued = if plate.overscan.is_none() { 0 } else { CONTINUED * (width * height) as u64 };
    Ok(continued + changed.map_or(0, |place| BYTES_PER_CHANGED_PIXEL * (place.w * place.h) as u64))
}

/// The distortions of a composite, and the places of the frame that they may change.
struct Changes {
    blur: Blur,
    sharpening: Option<SharpeningModel>,
    /// The places of the shadows and of the object, in this order.
    places: [Option<Place>; 2],
    /// The place that holds both of them and what sharpening changes around them.
    all: Option<Place>,
}

impl Changes {
    fn new(
        plate: &Plate,
        layer: &VirtualLayer,
        model: &CameraModel,
        options: &CompositeOptions,
    ) -> Result<Self> {
        let (size, overscan) = (plate.frame.0.size(), plate.overscan);
        let width = overscan.frame_size(size).0;
        let blur = if options.naive { Blur::default() } else { Blur::new(model, width, options.bokeh)? };
        let blur = blur.beginning_before((overscan.left, overscan.top));
        let places = [Shadows::place(plate, &blur), Object::place(layer, &blur)];
        let sharpening = model.sharpening.known().copied().filter(|_| !options.naive);
        let reach = sharpening.map_or(0, |m| sharpening::reach_px(&m));
        let all = places.into_iter().flatten().reduce(Place::union).map(|place| place.grown(reach, size));
        Ok(Self { blur, sharpening, places, all })
    }
}

fn check_sizes(plate: &Plate, layer: &VirtualLayer) -> Result<()> {
    let frame = plate.frame.0.size();
    let (w, h) = plate.overscan.picture_of(frame);
    let of_layer = |name: &str, size: Option<(usize, usize)>| match size {
        Some((a, b)) if (a, b) != (w, h) => Err(Error::new(format!(
            "{name} has {a} x {b} pixels but the frame{} {w} x {h}; render or scale it to the frame's size",
            if plate.overscan.is_none() { "" } else { " with the overscan" }
        ))),
        _ => Ok(()),
    };
    of_layer("the virtual layer", Some(layer.color.0.size()))?;
    of_layer("the virtual layer's depth", layer.inverse_depth.as_ref().map(|d| d.size()))?;
    of_layer("the virtual layer's flow", layer.flow.as_ref().map(|f| f.size()))?;
    let check = |name: &str, size: Option<(usize, usize)>| match size {
        Some((a, b)) if (a, b) != frame => Err(Error::new(format!(
            "{name} has {a} x {b} pixels but the frame {} x {}; render or scale it to the frame's size",
            frame.0, frame.1
        ))),
        _ => Ok(()),
    };
    check("the real depth", plate.inverse_depth.map(|d| d.size()))?;
    check("the real flow", plate.flow.map(|f| f.size()))?;
    check("the holdout matte", plate.holdout.map(|m| m.size()))?;
    check("the render with the object", plate.with_and_without.map(|(w, _)| w.0.size()))?;
    check("the render without the object", plate.with_and_without.map(|(_, w)| w.0.size()))
}

/// A pixel of the result before noise.
#[derive(Clone, Copy, Debug, Default)]
struct Composited {
    light: [f32; 3],
    /// d light / d frame, of each channel: the share of the frame's noise that is left.
    kept: [f32; 3],
    untouched: bool,
}

/// The noise that lifts the frame's remaining noise to the model's variance at the result's luminance.
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
    // Noise depends on the luminance without noise. `clean` still has the noise of the part of the frame that is left.
    let smooth = filter::gaussian_blur(frame, 1.5);
    let gain = Raster::from_fn(w, h, |x, y| {
        let (s, v, k) = (smooth.at(x, y), clean.at(x, y), pixels.at(x, y).kept);
        let gain = |c: usize| (k[c] * space.slope(v[c]) / space.slope(s[c])).clamp(0.0, 1.5);
        std::array::from_fn::<f32, 3, _>(|c| if s[c] >= model.clip() { 0.0 } else { gain(c) })
    });
    let content = Raster::from_fn(w, h, |x, y| {
        let (f, s, v, g) = (frame.at(x, y), smooth.at(x, y), clean.at(x, y), gain.at(x, y));
        std::array::from_fn(|c| v[c] - g[c] * (f[c] - s[c]))
    });
    let kept_variance = gain.map(|g| g.map(|g| g * g));
    let [content, smooth, kept_variance] = [content, smooth, kept_variance].map(noise::levels_of);
    let there = |level: usize, x: usize, y: usize| {
        let (kept, there) = (kept_variance[level].at(x, y), model.std_over(level, smooth[level].at(x, y)));
        std::array::from_fn(|c| kept[c] * there[c] * there[c])
    };
    noise::missing(model, &content, there, seed, number)
}
