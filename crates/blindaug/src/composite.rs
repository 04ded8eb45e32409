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

/// A rectangle of the frame, px.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    x: usize,
    y: usize,
    w: usize,
    h: usize,
}

impl Place {
    /// The smallest place around the pixels of which `holds` is true.
    fn around((w, h): (usize, usize), holds: impl Fn(usize, usize) -> bool + Sync) -> Option<Self> {
        // The first and the last such pixel of each row.
        let spans = Raster::from_fn(1, h, |_, y| {
            (0..w)
                .find(|&x| holds(x, y))
                .map(|first| (first, (first..w).rfind(|&x| holds(x, y)).unwrap_or(first)))
        });
        let rows = || spans.data().iter().enumerate().filter_map(|(y, s)| s.map(|s| (y, s)));
        let (y, bottom) = (rows().next()?.0, rows().next_back()?.0);
        let (x, right) = (rows().map(|(_, s)| s.0).min()?, rows().map(|(_, s)| s.1).max()?);
        Some(Self { x, y, w: right + 1 - x, h: bottom + 1 - y })
    }

    /// The place with `margin` px around it, as far as the frame reaches.
    fn grown(self, margin: usize, (w, h): (usize, usize)) -> Self {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let (right, bottom) = ((self.x + self.w + margin).min(w), (self.y + self.h + margin).min(h));
        Self { x, y, w: right - x, h: bottom - y }
    }

    fn union(self, b: Self) -> Self {
        let (x, y) = (self.x.min(b.x), self.y.min(b.y));
        let (right, bottom) = ((self.x + self.w).max(b.x + b.w), (self.y + self.h).max(b.y + b.h));
        Self { x, y, w: right - x, h: bottom - y }
    }

    fn crop<T: Copy + Send + Sync>(self, image: &Raster<T>) -> Raster<T> {
        image.crop(self.x, self.y, self.w, self.h)
    }

    /// Puts an image of this place into an image of the whole frame.
    fn paste<T: Copy>(self, image: &Raster<T>, into: &mut Raster<T>) {
        for y in 0..self.h {
            into.row_mut(self.y + y)[self.x..][..self.w].copy_from_slice(image.row(y));
        }
    }

    /// Puts the part of an image of this place that lies in the frame into the frame, beyond which pictures reach so far.
    fn paste_into_frame<T: Copy>(self, image: &Raster<T>, into: &mut Raster<T>, overscan: Overscan) {
        let (left, right) = (self.x.max(overscan.left), (self.x + self.w).min(overscan.left + into.width()));
        for y in self.y.max(overscan.top)..(self.y + self.h).min(overscan.top + into.height()) {
            if left < right {
                let row = &image.row(y - self.y)[left - self.x..right - self.x];
                into.row_mut(y - overscan.top)[left - overscan.left..][..row.len()].copy_from_slice(row);
            }
        }
    }

    /// The value of an image of this place at a position in the frame.
    fn at<T: Copy + Send + Sync>(self, image: &Raster<T>, (x, y): (usize, usize)) -> Option<T> {
        let (x, y) = (x.checked_sub(self.x)?, y.checked_sub(self.y)?);
        (x < self.w && y < self.h).then(|| image.at(x, y))
    }
}

/// The shadows and reflections that the object adds to the filmed scene, blurred like the scene.
struct Shadows {
    place: Place,
    /// In R, G and B the factor of the scene's light, minus 1 (from -1 to 0), then the light that is added.
    change: Raster<[f32; 6]>,
}

/// The layer's alpha above which the renders do not show the change of the background.
const OPAQUE: f32 = 0.01;

impl Shadows {
    /// The place that may have shadows or reflections; `None` if there are none.
    fn place(plate: &Plate, blur: &Blur) -> Option<Place> {
        let (with, without) = plate.with_and_without?;
        let size = with.0.size();
        let reach = Raster::from_fn(1, size.1, |_, y| {
            (0..size.0)
                .map(|x| {
                    blur.reach_px(
                        plate.inverse_depth.map_or(f32::NAN, |d| d.at(x, y)),
                        plate.flow.map_or([0.0; 2], |f| f.at(x, y)),
                    )
                })
                .fold(0.0, f32::max)
        });
        let reach = reach.data().iter().copied().fold(0.0, f32::max);
        let place = Place::around(size, |x, y| with.0.at(x, y) != without.0.at(x, y))?;
        Some(place.grown((reach + 1.0).ceil() as usize, size))
    }

    fn new(
        plate: &Plate,
        place: Place,
        layer: &VirtualLayer,
        space: &Space,
        blur: &Blur,
    ) -> Result<Option<Self>> {
        let Some((with, without)) = plate.with_and_without else { return Ok(None) };
        // Where a render clips or the object is in front, the renders do not show the change of the background.
        let clipped = |v: [f32; 3]| v.iter().any(|v| (0.996..=1.0).contains(v) || !v.is_finite());
        let seen = |x, y| {
            layer.color.0.at(x, y)[3] <= OPAQUE && !clipped(with.0.at(x, y)) && !clipped(without.0.at(x, y))
        };
        let sharp = Raster::from_fn(place.w, place.h, |x, y| {
            let at = (place.x + x, place.y + y);
            let [a, b] = [with, without].map(|i| space.of_linear(i.0.at(at.0, at.1)));
            std::array::from_fn(|i| match i {
                0..3 if a[i] < b[i] => a[i].max(0.0) / b[i] - 1.0,
                3.. if a[i - 3] > b[i - 3] => a[i - 3] - b[i - 3],
                _ => 0.0,
            })
        });
        // The change is continued under the object, so that the object's soft edge lets it through.
        let sharp = extended(&sharp, |x, y| if seen(place.x + x, place.y + y) { 1.0 } else { 0.0 });
        let change = blur.cut_out((place.x, place.y)).of(
            &sharp,
            plate.inverse_depth.map(|d| place.crop(d)).as_ref(),
            plate.flow.map(|f| place.crop(f)).as_ref(),
        )?;
        Ok(Some(Self { place, change }))
    }
}

/// The change that the object makes to a pixel of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ObjectPixel {
    /// The light that is added: `V L - A B`.
    added: [f32; 3],
    /// The share of the shadows and reflections that the object hides: `A V`, in [0, 1].
    cover: f32,
    /// The share of the frame's own value, and so of its noise, that is lost, in [0, 1].
    lost: f32,
    /// The share of the object that real things in front let through: `V`, in [0, 1].
    visible: f32,
}

impl ObjectPixel {
    fn changes_nothing(&self) -> bool {
        self.added == [0.0; 3] && self.cover == 0.0 && self.lost == 0.0
    }

    /// The pixel, of whose object a matte lets only this share through.
    fn times(self, share: f32) -> Self {
        Self {
            added: self.added.map(|v| v * share),
            cover: self.cover * share,
            lost: self.lost * share,
            visible: self.visible * share,
        }
    }
}

impl Default for ObjectPixel {
    /// No change.
    fn default() -> Self {
        Self { added: [0.0; 3], cover: 0.0, lost: 0.0, visible: 1.0 }
    }
}

/// The blurred object, hidden by the real things in front of it.
struct Object {
    place: Place,
    pixels: Raster<ObjectPixel>,
}

/// A real surface hides a virtual one if its inverse depth is larger by more than this factor, the tolerance of both depths.
const IN_FRONT: f32 = 1.02;

impl Object {
    /// The place in which the object may be seen; `None` if it covers no pixel.
    fn place(layer: &VirtualLayer, blur: &Blur) -> Option<Place> {
        let alpha = |x, y| layer.color.0.at(x, y)[3];
        let size = layer.color.0.size();
        let tight = Place::around(size, |x, y| alpha(x, y) > 0.0)?;
        let mut reach = 0.0f32;
        for y in tight.y..tight.y + tight.h {
            for x in (tight.x..tight.x + tight.w).filter(|&x| alpha(x, y) > 0.0) {
                let d = layer.inverse_depth.as_ref().map_or(f32::NAN, |d| d.at(x, y));
                let flow = layer.flow.as_ref().map_or([0.0; 2], |f| f.at(x, y));
                reach = reach.max(blur.reach_px(d, flow));
            }
        }
        Some(tight.grown((reach + 1.0).ceil() as usize, size))
    }

    fn new(plate: &Plate, place: Place, layer: &VirtualLayer, space: &Space, blur: &Blur) -> Result<Self> {
        let color = place.crop(&layer.color.0).map(|v| space.of_premultiplied(v));
        // Of an object without a single known depth or motion nothing can be continued.
        let depth = layer.inverse_depth.as_ref().map(|d| place.crop(d));
        let depth = depth.filter(|d| d.data().iter().any(|d| d.is_finite()));
        let flow = layer.flow.as_ref().map(|f| place.crop(f));
        let flow = flow.filter(|f| f.data().iter().flatten().any(|v| v.is_finite()));
        let front = match (&depth, plate.inverse_depth) {
            (Some(depth), Some(real)) => {
                let depth = extended(depth, coverage_weight(&color));
                Front::new(plate, place, &depth, &place.crop(real), space, blur)?
            }
            _ => None,
        };
        let (color, depth) = match &front {
            Some(front) => (front.uncut(&color), depth.map(|d| extended(&d, |_, _| 1.0))),
            None => (color, depth),
        };
        let blurred = blur.cut_out((place.x, place.y)).of_layer(&color, depth.as_ref(), flow.as_ref())?;
        let held_out = |x: usize, y: usize| {
            let m = plate.holdout.map_or(0.0, |m| m.at(place.x + x, place.y + y));
            if m.is_nan() { 0.0 } else { m.clamp(0.0, 1.0) }
        };
        let pixels = Raster::from_fn(place.w, place.h, |x, y| {
            let [r, g, b, a] = blurred.at(x, y);
            if a <= 0.0 {
                return ObjectPixel::default();
            }
            let pixel = match &front {
                None => {
                    let f = space.of_encoded(plate.frame.0.at(place.x + x, place.y + y));
                    ObjectPixel {
                        added: [r - a * f[0], g - a * f[1], b - a * f[2]],
                        cover: a,
                        lost: a,
                        visible: 1.0,
                    }
                }
                Some(front) => {
                    let (v, [p, q, s]) = (1.0 - front.coverage.at(x, y), front.behind.at(x, y));
                    ObjectPixel {
                        added: [v * r - a * p, v * g - a * q, v * b - a * s],
                        cover: a * v,
                        lost: a * front.share_behind.at(x, y),
                        visible: v,
                    }
                }
            };
            pixel.times(1.0 - held_out(x, y))
        });
        Ok(Self { place, pixels })
    }
}

/// Real things in front of the object.
struct Front {
    /// The sharp mask of the things in front: 1 or 0.
    mask: Plane,
    /// The share of each pixel that the things cover after blur, in [0, 1].
    coverage: Plane,
    /// The background's light that the things let through: `B`.
    behind: Raster<[f32; 3]>,
    /// The background's share of a change of the frame's value, in [0, 1].
    share_behind: Plane,
}

impl Front {
    /// The real things in front of a surface of inverse depth `virtual_depth`; `None` if there are none.
    fn new(
        plate: &Plate,
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
        let flow = plate.flow.map(|f| extended(&place.crop(f), |x, y| mask.at(x, y)));
        let render = plate.with_and_without.map(|(_, without)| place.crop(&without.0));
        let sharp = Raster::from_fn(w, h, |x, y| {
            let m = mask.at(x, y);
            let [r, g, b] = render.as_ref().map_or([0.0; 3], |r| space.of_linear(r.at(x, y)));
            if m > 0.0 { [r, g, b, m] } else { [0.0; 4] }
        });
        // The things in front lie where the frame shows them, whenever the shutter opened.
        let blur = blur.cut_out((place.x, place.y)).centred();
        let blurred = blur.of(&sharp, Some(&depth), flow.as_ref())?;
        let coverage = blurred.map(|v| v[3].clamp(0.0, 1.0));
        // The frame is c C + (1 - c) B0, a mix of the front C and the background B0. The first guess of each is the frame's own
        // colour where it alone is seen, continued from there; for the front it is the render, if there is one. The remaining
        // difference is then divided between the two by least squares, more of it to the less certain one.
        let frame = place.crop(&plate.frame.0).map(|v| space.of_encoded(v));
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

    /// The layer, continued under the things that hide it, whether or not the hidden part was cut out: else the cut's edge would be
    /// blurred.
    fn uncut(&self, color: &Raster<[f32; 4]>) -> Raster<[f32; 4]> {
        let near = filter::convolve(&self.mask, &[0.5, 0.25]);
        extended(color, |x, y| if near.at(x, y) > 0.0 && color.at(x, y)[3] < 0.98 { 0.0 } else { 1.0 })
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Transfer;
    use crate::model::{
        BlurSpace, Capture, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel,
    };

    const W: usize = 160;
    const H: usize = 120;

    fn camera() -> CameraModel {
        let capture = Capture { width: W, height: H, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let mut model = CameraModel::unknown(capture, "not needed");
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
        // The lens is sharp at 1 m, and its blur at infinity has a std of 3 px.
        model.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 1.0));
        model
    }

    fn with_noise(mut model: CameraModel, slope: f32, intercept: f32, clip: f32) -> CameraModel {
        let levels = noise::white_band_std()
            .map(|s| NoiseLevel { slope: [slope * s; 3], intercept: [intercept * s; 3] });
        model.noise = Estimate::Known(NoiseModel::given(levels, clip));
        model
    }

    fn background() -> Encoded {
        Encoded(Raster::from_fn(W, H, |x, y| [0.2 + 0.1 * ((x / 5) % 2) as f32, 0.3, 0.1 + 0.004 * y as f32]))
    }

    /// A square of one colour from (50, 40) to (99, 79).
    fn square(colour: [f32; 3], alpha: f32, inverse_depth: f32, flow: [f32; 2]) -> VirtualLayer {
        let inside = |x: usize, y: usize| (50..100).contains(&x) && (40..80).contains(&y);
        let [r, g, b] = colour.map(|v| v * alpha);
        VirtualLayer {
            color: Premultiplied(Raster::from_fn(W, H, |x, y| {
                if inside(x, y) { [r, g, b, alpha] } else { [0.0; 4] }
            })),
            inverse_depth: Some(Plane::from_fn(
                W,
                H,
                |x, y| if inside(x, y) { inverse_depth } else { f32::NAN },
            )),
            flow: Some(Flow::filled(W, H, flow)),
        }
    }

    fn plate(frame: &Encoded) -> Plate<'_> {
        Plate::new(frame, 7)
    }

    fn close(a: [f32; 3], b: [f32; 3], tolerance: f32) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance)
    }

    const GREY: [f32; 3] = [0.214_041_14; 3]; // encoded: 0.5

    #[test]
    fn without_blur_and_noise_it_is_plain_over() {
        let frame = background();
        let layer = square([0.5, 0.2, 0.1], 0.25, 1.0, [0.0; 2]);
        let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
        let model = with_noise(camera(), 0.1, 0.1, 1.0);
        let out = composite(&plate(&frame), &layer, &model, &naive).unwrap();
        // The camera's blur changes nothing on an object in focus and at rest.
        let silent = CompositeOptions { no_noise: true, ..CompositeOptions::default() };
        assert!(out == composite(&plate(&frame), &layer, &model, &silent).unwrap());
        let t = Transfer::Srgb;
        let (f, l) = (frame.0.at(70, 60), layer.color.0.at(70, 60));
        let want = std::array::from_fn(|c| t.encode(l[c] + 0.75 * t.decode(f[c])));
        assert!(close(out.0.at(70, 60), want, 1e-5));
        assert_eq!(out.0.at(49, 60), frame.0.at(49, 60));
    }

    #[test]
    fn the_frame_is_untouched_bit_by_bit_where_nothing_virtual_is_seen() {
        let frame = background();
        let model = with_noise(camera(), 0.05, 0.02, 1.0);
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            let options = CompositeOptions { bokeh: Some(bokeh), ..CompositeOptions::default() };
            // The object is blurred by 3 px of defocus and 12 px of motion.
            let out =
                composite(&plate(&frame), &square(GREY, 1.0, 2.0, [24.0, 0.0]), &model, &options).unwrap();
            for y in 0..H {
                for x in 0..W {
                    if !(50 - 22..100 + 22).contains(&x) || !(40 - 16..80 + 16).contains(&y) {
                        assert_eq!(out.0.at(x, y), frame.0.at(x, y), "{x} {y}");
                    }
                }
            }
            assert_ne!(out.0.at(46, 60), frame.0.at(46, 60));
        }
        let empty = square(GREY, 0.0, 2.0, [24.0, 0.0]);
        assert!(composite(&plate(&frame), &empty, &model, &CompositeOptions::default()).unwrap() == frame);
    }

    #[test]
    fn the_lens_s_shape_and_the_shutter_s_phase_act_on_the_object_as_on_a_whole_picture() {
        let frame = Encoded(Raster::filled(W, H, [0.0; 3]));
        let composited = |model: &CameraModel| {
            let layer = square([0.5; 3], 1.0, 3.0, [24.0, 0.0]);
            let out = composite(&plate(&frame), &layer, model, &CompositeOptions::default()).unwrap();
            out.to_linear(Transfer::Srgb).0
        };
        let middle = |light: &Raster<[f32; 3]>| {
            let sum = |g: &dyn Fn(usize, usize) -> f32| -> f32 {
                (0..W * H).map(|i| light.data()[i][1] * g(i % W, i / W)).sum()
            };
            let all = sum(&|_, _| 1.0);
            [sum(&|x, _| x as f32) / all, sum(&|_, y| y as f32) / all]
        };
        let [x, y] = middle(&composited(&camera()));
        assert!((x - 74.5).abs() < 0.1 && (y - 59.5).abs() < 0.1, "{x} {y}");
        // A shutter of 180 degrees that opens at the frame's time shows the object a quarter of its motion later.
        let mut later = camera();
        if let Estimate::Known(m) = &mut later.motion_blur {
            m.phase_degrees = Some(0.0);
        }
        let [later, _] = middle(&composited(&later));
        assert!((later - x - 6.0).abs() < 0.15, "{later} {x}");
        // The composite looks at a part of the frame; the cat's eye depends on the place in the whole of it.
        let mut cut = camera();
        if let Estimate::Known(lens) = &mut cut.defocus {
            lens.bokeh = crate::model::Aperture { cats_eye: 1.0, ..Bokeh::Disk.into() };
        }
        let blur = Blur::new(&cut, W, None).unwrap();
        let layer = square([0.5; 3], 1.0, 3.0, [24.0, 0.0]);
        let whole = blur.of_layer(&layer.color.0, layer.inverse_depth.as_ref(), layer.flow.as_ref()).unwrap();
        let error = |light: &Raster<[f32; 3]>| {
            light.data().iter().zip(whole.data()).map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f32::max)
        };
        assert!(error(&composited(&cut)) < 2e-3, "{}", error(&composited(&cut)));
        let disk = CompositeOptions { bokeh: Some(Bokeh::Disk), ..CompositeOptions::default() };
        let round = composite(&plate(&frame), &layer, &camera(), &disk).unwrap().to_linear(Transfer::Srgb).0;
        assert!(error(&round) > 0.02, "{}", error(&round));
    }

    #[test]
    fn the_silhouette_is_blurred_beyond_itself_and_mixes_light() {
        let frame = Encoded(Raster::filled(W, H, [0.0; 3]));
        let out = composite(
            &plate(&frame),
            &square([1.0; 3], 1.0, 1.0, [24.0, 0.0]),
            &camera(),
            &CompositeOptions::default(),
        );
        let light = out.unwrap().to_linear(Transfer::Srgb).0;
        // The edge is a ramp of light over 12 px, centred at x = 49.5.
        for (x, want) in [(42, 0.0), (46, 2.5 / 12.0), (49, 5.5 / 12.0), (50, 6.5 / 12.0), (57, 1.0)] {
            assert!((light.at(x, 60)[0] - want).abs() < 0.02, "{x}: {:?}", light.at(x, 60));
        }
        // On request, encoded values are mixed instead of light.
        let mut model = camera();
        model.blur_space = BlurSpace::Encoded;
        let out = composite(
            &plate(&frame),
            &square([1.0; 3], 1.0, 1.0, [24.0, 0.0]),
            &model,
            &CompositeOptions::default(),
        );
        assert!((out.unwrap().0.at(49, 60)[0] - 5.5 / 12.0).abs() < 0.02);
    }

    #[test]
    fn unknown_parts_and_missing_evidence_are_left_out() {
        let frame = background();
        let plain = CompositeOptions { naive: true, ..CompositeOptions::default() };
        let moving = square(GREY, 1.0, 3.0, [24.0, 0.0]);
        let naive = composite(&plate(&frame), &moving, &camera(), &plain).unwrap();
        let nothing = CameraModel::unknown(camera().capture, "a wall");
        assert!(composite(&plate(&frame), &moving, &nothing, &CompositeOptions::default()).unwrap() == naive);
        let bare = VirtualLayer { inverse_depth: None, flow: None, ..moving };
        assert!(composite(&plate(&frame), &bare, &camera(), &CompositeOptions::default()).unwrap() == naive);
    }

    #[test]
    fn real_things_in_front_hide_the_object_whether_it_was_cut_or_not() {
        let frame = background();
        // A post at 0.4 m is in front of the object at 1 m; a wall is at 4 m; the depth is unknown below y = 70.
        let real = Plane::from_fn(W, H, |x, y| match (x, y) {
            (_, 70..) => f32::NAN,
            (70..80, _) => 2.5,
            _ => 0.25,
        });
        let uncut = square(GREY, 1.0, 1.0, [0.0; 2]);
        let mut cut = uncut.clone();
        for y in 0..70 {
            cut.color.0.row_mut(y)[70..80].fill([0.0; 4]);
        }
        let with_depth = Plate { inverse_depth: Some(&real), ..plate(&frame) };
        let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
        for layer in [&uncut, &cut] {
            let out = composite(&with_depth, layer, &camera(), &naive).unwrap();
            assert_eq!(out.0.at(75, 60), frame.0.at(75, 60));
            assert!(close(out.0.at(60, 60), [0.5; 3], 1e-4) && close(out.0.at(90, 60), [0.5; 3], 1e-4));
        }
        assert!(close(
            composite(&with_depth, &uncut, &camera(), &naive).unwrap().0.at(75, 75),
            [0.5; 3],
            1e-4
        ));
    }

    #[test]
    fn a_blurred_thing_in_front_mixes_with_the_object_instead_of_the_background() {
        // The true image: a white post, blurred, over a black wall; then over the grey object that fills the view behind it.
        let t = Transfer::Srgb;
        let sharp = Plane::from_fn(W, H, |x, _| if (70..90).contains(&x) { 1.0 } else { 0.0 });
        let blur = Blur::new(&camera(), W, Bokeh::Gaussian).unwrap();
        let post = blur.of(&sharp, Some(&Plane::filled(W, H, 2.5)), None).unwrap(); // 4.5 px
        let frame = Encoded(post.map(|a| [t.encode(a); 3]));
        let truth = Encoded(post.map(|a| [t.encode(a + (1.0 - a) * GREY[0]); 3]));
        let real = sharp.map(|a| if a > 0.0 { 2.5 } else { 0.1 });
        let layer = VirtualLayer {
            color: Premultiplied(Raster::from_fn(W, H, |x, _| {
                if sharp.at(x, 0) > 0.0 { [0.0; 4] } else { [GREY[0], GREY[0], GREY[0], 1.0] }
            })),
            inverse_depth: Some(Plane::filled(W, H, 1.0)),
            flow: None,
        };
        let plate = Plate { inverse_depth: Some(&real), ..plate(&frame) };
        let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
        let worst = |a: &Encoded| {
            (40..120).map(|x| (a.0.at(x, 60)[0] - truth.0.at(x, 60)[0]).abs()).fold(0.0, f32::max)
        };
        assert!(worst(&out) < 0.03, "{}", worst(&out));
        // Negative control: the plain over operation is clearly wrong.
        let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
        assert!(worst(&composite(&plate, &layer, &camera(), &naive).unwrap()) > 0.1);
    }

    #[test]
    fn shadows_fall_on_the_frame_and_continue_under_the_soft_edge() {
        let t = Transfer::Srgb;
        let frame = Encoded(Raster::filled(W, H, [0.6; 3]));
        let layer = square(GREY, 1.0, 2.0, [0.0; 2]);
        // The renders differ by a shadow that halves the light right of x = 30; both are darker than the frame, which is halved all the same.
        let without = Linear(Raster::filled(W, H, [0.2; 3]));
        let with = Linear(Raster::from_fn(W, H, |x, y| match layer.color.0.at(x, y) {
            [r, g, b, a] if a > 0.0 => [r, g, b],
            _ if x >= 30 => [0.1; 3],
            _ => [0.2; 3],
        }));
        let plate = Plate { with_and_without: Some((&with, &without)), ..plate(&frame) };
        let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
        let shadow = 0.5 * t.decode(0.6);
        assert_eq!(out.0.at(10, 60), frame.0.at(10, 60));
        assert!(close(out.0.at(140, 60), [t.encode(shadow); 3], 1e-4));
        // The middle of the edge is half object, half shadowed frame.
        let edge = 0.5 * (t.decode(out.0.at(49, 60)[0]) + t.decode(out.0.at(50, 60)[0]));
        assert!((edge - 0.5 * (GREY[0] + shadow)).abs() < 0.01, "{edge}");
    }

    #[test]
    fn light_that_the_object_adds_is_added_and_not_multiplied() {
        let frame = Encoded(Raster::filled(W, H, [0.3; 3]));
        let layer = square(GREY, 0.0, 2.0, [0.0; 2]);
        let without = Linear(Raster::filled(W, H, [0.1, 0.1, 0.1]));
        // The object reflects red onto the scene and takes away half of its blue.
        let with = Linear(Raster::from_fn(W, H, |x, _| if x < 80 { [0.3, 0.1, 0.05] } else { [0.1; 3] }));
        let plate = Plate { with_and_without: Some((&with, &without)), ..plate(&frame) };
        let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
        let light = Transfer::Srgb.decode(0.3);
        let want = [light + 0.2, light, 0.5 * light].map(|v| Transfer::Srgb.encode(v));
        assert!(close(out.0.at(20, 60), want, 1e-4), "{:?}", out.0.at(20, 60));
        assert_eq!(out.0.at(140, 60), frame.0.at(140, 60));
    }

    #[test]
    fn a_shadow_has_the_noise_of_its_own_luminance() {
        // The floor is bright and noisy, and the noise falls with the luminance.
        let model = with_noise(camera(), 0.06, 0.002, 1.0);
        let t = Transfer::Srgb;
        let floor = |number: u64| {
            let clean = Raster::filled(W, H, [0.75; 3]);
            let Estimate::Known(m) = &model.noise else { panic!("the noise is known") };
            let grain = noise::noise(m, &clean, 5, number);
            Encoded(Raster::from_fn(W, H, |x, y| {
                std::array::from_fn(|c| clean.at(x, y)[c] + grain.at(x, y)[c])
            }))
        };
        let without = Linear(Raster::filled(W, H, [0.2; 3]));
        let with = Linear(Raster::from_fn(W, H, |x, _| if x > 30 { [0.2 * 0.05; 3] } else { [0.2; 3] }));
        let layer = square(GREY, 0.0, 2.0, [0.0; 2]);
        let dark = t.encode(0.05 * t.decode(0.75));
        let (mut ours, mut of_difference, mut count) = (0.0, 0.0, 0.0);
        for number in 0..6 {
            let frame = floor(number);
            let plate = Plate { number, with_and_without: Some((&with, &without)), ..plate(&frame) };
            let out = composite(&plate, &layer, &model, &CompositeOptions::default()).unwrap();
            for y in 20..100 {
                for x in 60..150 {
                    ours += (out.0.at(x, y)[0] - dark).powi(2);
                    // Negative control: the difference of the renders, scaled to the frame, leaves all the noise of the floor's light.
                    let light = t.decode(frame.0.at(x, y)[0]) - 0.95 * t.decode(0.75);
                    of_difference += (t.encode(light.max(0.0)) - dark).powi(2);
                    count += 1.0;
                }
            }
        }
        let want = {
            let Estimate::Known(m) = &model.noise else { panic!("the noise is known") };
            let clean = Raster::filled(W, H, [dark; 3]);
            let grain = noise::noise(m, &clean, 9, 0);
            (grain.data().iter().map(|v| v[0] * v[0]).sum::<f32>() / grain.data().len() as f32).sqrt()
        };
        let [ours, of_difference] = [ours, of_difference].map(|v: f32| (v / count).sqrt());
        assert!(ours < 1.5 * want && ours > 0.8 * want, "{ours} {want}");
        assert!(of_difference > 4.0 * want, "{of_difference} {want}");
    }

    #[test]
    fn an_object_of_unknown_depth_and_motion_is_not_blurred() {
        let frame = background();
        let bare = VirtualLayer { inverse_depth: None, flow: None, ..square(GREY, 1.0, 2.0, [24.0, 0.0]) };
        let unknown = VirtualLayer {
            inverse_depth: Some(Plane::filled(W, H, f32::NAN)),
            flow: Some(Flow::filled(W, H, [f32::NAN; 2])),
            ..bare.clone()
        };
        let made = |layer: &VirtualLayer| {
            composite(&plate(&frame), layer, &camera(), &CompositeOptions::default()).unwrap()
        };
        assert!(made(&unknown) == made(&bare));
        // Negative control: what is known is blurred.
        assert!(made(&square(GREY, 1.0, 2.0, [24.0, 0.0])) != made(&bare));
    }

    #[test]
    fn a_matte_holds_the_object_out() {
        let frame = background();
        let layer = square([0.5, 0.2, 0.1], 1.0, 1.0, [0.0; 2]);
        // Left of the middle of the object something is in front of it, with an edge of 4 px.
        let matte = Plane::from_fn(W, H, |x, _| ((77.0 - x as f32) / 4.0).clamp(0.0, 1.0));
        let all = CompositeOptions::default();
        let open = composite(&plate(&frame), &layer, &camera(), &all).unwrap();
        let held = Plate { holdout: Some(&matte), ..plate(&frame) };
        let out = composite(&held, &layer, &camera(), &all).unwrap();
        assert_eq!(out.0.at(60, 60), frame.0.at(60, 60));
        assert_eq!(out.0.at(90, 60), open.0.at(90, 60));
        // Halfway, light is mixed half and half.
        let t = Transfer::Srgb;
        for c in 0..3 {
            let light = t.decode(out.0.at(75, 60)[c]);
            let half = 0.5 * (t.decode(frame.0.at(75, 60)[c]) + t.decode(open.0.at(75, 60)[c]));
            assert!((light - half).abs() < 1e-5, "{light} {half}");
        }
        // The layer for a compositing program says the same.
        let apart = distorted_layer(&held, &layer, &camera(), &all).unwrap();
        assert!((apart.holdout.at(75, 60) - 0.5).abs() < 1e-6 && apart.color.0.at(60, 60)[3] == 0.0);
        let small = Plane::filled(3, 3, 0.0);
        let e = composite(&Plate { holdout: Some(&small), ..held }, &layer, &camera(), &all).unwrap_err();
        assert!(e.to_string().contains("matte"), "{e}");
    }

    /// Std of the red channel over the middle of the square, around its value `clean` without noise.
    fn noise_std(
        frame: impl Fn(u64) -> Encoded,
        layer: &VirtualLayer,
        model: &CameraModel,
        clean: f32,
    ) -> f32 {
        let (mut sum, mut count) = (0.0, 0.0);
        for number in 0..6 {
            let frame = frame(number);
            let plate = Plate { number, ..plate(&frame) };
            let out = composite(&plate, layer, model, &CompositeOptions::default()).unwrap();
            for y in 46..74 {
                for x in 56..94 {
                    sum += (out.0.at(x, y)[0] - clean).powi(2);
                    count += 1.0;
                }
            }
        }
        (sum / count as f32).sqrt()
    }

    /// The largest difference of two frames.
    fn worst(a: &Encoded, b: &Encoded) -> f32 {
        let differences = a.0.data().iter().flatten().zip(b.0.data().iter().flatten());
        differences.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn onto_a_sharpened_frame_it_is_the_sharpened_composite_onto_the_unsharpened_one() {
        let plain = camera();
        let sharpening = SharpeningModel::given(0.9, 1.2);
        let mut sharpening_camera = camera();
        sharpening_camera.sharpening = Estimate::Known(sharpening);
        let sharpened = |image: &Encoded| Encoded(sharpening::sharpen(&image.0, &sharpening));
        let frame = sharpened(&background());
        // Two layers in focus, and one blurred by 3 px of defocus and 6 px of motion.
        for (alpha, depth, flow) in [(1.0, 1.0, [0.0; 2]), (0.6, 1.0, [0.0; 2]), (0.8, 2.0, [12.0, 0.0])] {
            for blur_space in [BlurSpace::Linear, BlurSpace::Encoded] {
                let layer = square(GREY, alpha, depth, flow);
                let over = |frame: &Encoded, model: &CameraModel| {
                    let mut model = model.clone();
                    model.blur_space = blur_space;
                    composite(&plate(frame), &layer, &model, &CompositeOptions::default()).unwrap()
                };
                let want = sharpened(&over(&background(), &plain));
                let out = over(&frame, &sharpening_camera);
                assert!(worst(&out, &want) < 1e-3, "alpha {alpha}: {}", worst(&out, &want));
                // Negative control: without the model's sharpening, the error is larger.
                assert!(worst(&over(&frame, &plain), &want) > 5.0 * worst(&out, &want));
                for y in 0..H {
                    for x in 0..W {
                        if !(50 - 26..100 + 26).contains(&x) || !(40 - 23..80 + 23).contains(&y) {
                            assert_eq!(out.0.at(x, y), frame.0.at(x, y), "{x} {y}");
                        }
                    }
                }
            }
        }
        let layer = square(GREY, 1.0, 1.0, [0.0; 2]);
        let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
        let [with, without] =
            [&sharpening_camera, &plain].map(|m| composite(&plate(&frame), &layer, m, &naive).unwrap());
        assert!(with == without);
    }

    #[test]
    fn noise_ends_at_the_model_s_variance_at_any_alpha() {
        noise_ends_at_the_model_s_variance(with_noise(camera(), 0.04, 0.01, 1.0));
    }

    #[test]
    fn sharpening_leaves_the_noise_as_it_is() {
        let mut model = with_noise(camera(), 0.04, 0.01, 1.0);
        model.sharpening = Estimate::Known(SharpeningModel::given(1.0, 1.0));
        noise_ends_at_the_model_s_variance(model);
    }

    fn noise_ends_at_the_model_s_variance(model: CameraModel) {
        let t = Transfer::Srgb;
        // A frame of 0.6 with the camera's own noise.
        let noisy = |number: u64| {
            let n = noise::noise(model.noise.known().unwrap(), &Raster::filled(W, H, [0.6; 3]), 99, number);
            Encoded(n.map(|n| n.map(|v| v + 0.6)))
        };
        for alpha in [0.1, 0.3, 0.5, 0.8, 1.0] {
            let clean = t.encode(alpha * GREY[0] + (1.0 - alpha) * t.decode(0.6));
            let layer = square(GREY, alpha, 1.0, [0.0; 2]);
            let (got, want) = (noise_std(noisy, &layer, &model, clean), 0.04 * clean + 0.01);
            assert!((got / want - 1.0).abs() < 0.05, "alpha {alpha}: {got}, want {want}");
            // Negative control: on a frame without noise of its own, the result has too little noise.
            let quiet = noise_std(|_| Encoded(Raster::filled(W, H, [0.6; 3])), &layer, &model, clean);
            assert!(alpha > 0.9 || quiet < 0.97 * want, "alpha {alpha}: {quiet}, want {want}");
        }
    }

    #[test]
    fn nothing_is_noisy_or_brighter_past_the_clip() {
        let model = with_noise(camera(), 0.04, 0.01, 0.9);
        let frame = background();
        let bright = composite(
            &plate(&frame),
            &square([3.0; 3], 1.0, 1.0, [0.0; 2]),
            &model,
            &CompositeOptions::default(),
        );
        assert_eq!(bright.unwrap().0.at(70, 60), [0.9; 3]);
        let below = composite(
            &plate(&frame),
            &square([0.75; 3], 1.0, 1.0, [0.0; 2]),
            &model,
            &CompositeOptions::default(),
        );
        let below = below.unwrap();
        assert!(below.0.crop(55, 45, 40, 30).data().iter().flatten().all(|&v| (0.7..=0.9).contains(&v)));
        assert_ne!(below.0.at(70, 60), below.0.at(71, 60));
    }

    #[test]
    fn the_layer_over_the_frame_is_the_composite() {
        let mut model = with_noise(camera(), 0.04, 0.01, 1.0);
        let frame = background();
        let real = Plane::from_fn(W, H, |x, _| if x < 65 { 2.0 } else { 0.1 });
        let layer = square(GREY, 0.8, 1.0, [9.0, 3.0]);
        for sharpening in [None, Some(SharpeningModel::given(0.6, 1.0))] {
            if let Some(mask) = sharpening {
                model.sharpening = Estimate::Known(mask);
            }
            for real in [None, Some(&real)] {
                let plate = Plate { inverse_depth: real, ..plate(&frame) };
                let options = CompositeOptions::default();
                let whole = composite(&plate, &layer, &model, &options).unwrap();
                let apart = distorted_layer(&plate, &layer, &model, &options).unwrap();
                let over = |with_noise: f32| {
                    Linear(Raster::from_fn(W, H, |x, y| {
                        let (l, n) = (apart.color.0.at(x, y), apart.noise.at(x, y));
                        let f = frame.0.at(x, y).map(|v| Transfer::Srgb.decode(v));
                        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c] + with_noise * n[c])
                    }))
                    .to_encoded(Transfer::Srgb)
                };
                let worst = |a: &Encoded| {
                    let pairs = a.0.data().iter().flatten().zip(whole.0.data().iter().flatten());
                    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
                };
                assert!(worst(&over(1.0)) < 1e-4, "{}", worst(&over(1.0)));
                // Negative control: without its noise it is another picture.
                assert!(worst(&over(0.0)) > 0.01);
                let held_out = apart.holdout.data().iter().any(|v| *v < 0.5);
                assert_eq!(held_out, real.is_some());
                // Inverse depth and flow are there wherever the object is seen, and nowhere else.
                let ends =
                    |x: usize, y: usize| (apart.color.0.at(x, y)[3] > 0.0, apart.inverse_depth.at(x, y));
                assert!((0..H).flat_map(|y| (0..W).map(move |x| (x, y))).all(|(x, y)| {
                    let (seen, d) = ends(x, y);
                    seen == d.is_finite() && seen == (apart.flow.at(x, y) != [0.0; 2])
                }));
            }
        }
    }

    #[test]
    fn scene_linear_light_above_white_is_kept_if_asked_for() {
        let model = with_noise(camera(), 0.0, 0.001, 0.9);
        let frame = Encoded(Raster::filled(W, H, [1.8; 3]));
        let options = CompositeOptions { unclipped: true, ..CompositeOptions::default() };
        let made = |layer| composite(&plate(&frame), &layer, &model, &options).unwrap();
        let opaque = made(square([3.0; 3], 1.0, 1.0, [0.0; 2])).0.at(70, 60);
        let half = made(square([0.0; 3], 0.5, 1.0, [0.0; 2])).0.at(70, 60);
        let t = Transfer::Srgb;
        assert!((opaque[0] - t.encode(3.0)).abs() < 0.02, "{opaque:?}");
        assert!((half[0] - t.encode(0.5 * t.decode(1.8))).abs() < 0.02, "{half:?}");
    }

    /// A layer, cut out from (x, y) on.
    fn cut(layer: &VirtualLayer, [x, y, w, h]: [usize; 4]) -> VirtualLayer {
        VirtualLayer {
            color: Premultiplied(layer.color.0.crop(x, y, w, h)),
            inverse_depth: layer.inverse_depth.as_ref().map(|d| d.crop(x, y, w, h)),
            flow: layer.flow.as_ref().map(|f| f.crop(x, y, w, h)),
        }
    }

    #[test]
    fn a_layer_with_overscan_gives_in_the_frame_what_a_larger_picture_has_there() {
        // The frame begins in the middle of the square, which is striped, blurred by 3 px and moves by 4 px while the shutter is open.
        let overscan = Overscan { left: 75, top: 30, right: 9, bottom: 5 };
        let (w, h) = overscan.frame_size((W, H));
        let [x, y] = [overscan.left, overscan.top];
        let mut layer = square(GREY, 1.0, 2.0, [8.0, 5.0]);
        layer.color = Premultiplied(Raster::from_fn(W, H, |x, y| {
            let [r, g, b, a] = layer.color.0.at(x, y);
            let bright = if (x / 12 + y / 9) % 2 == 0 { 2.0 } else { 0.2 };
            [r * bright, g * bright, b, a]
        }));
        let whole_frame = background();
        let frame = Encoded(overscan.frame_of(&whole_frame.0));
        let large = camera();
        let mut small = large.clone();
        (small.capture.width, small.capture.height) = (w, h);
        let without_noise = CompositeOptions { no_noise: true, ..CompositeOptions::default() };
        for bokeh in [
            Bokeh::Gaussian,
            Bokeh::Disk,
            Bokeh::Polygon { blades: 5, roundness: 0.2, rotation_degrees: 20.0 },
        ] {
            let options = CompositeOptions { bokeh: Some(bokeh), ..without_noise };
            let whole = composite(&plate(&whole_frame), &layer, &large, &options).unwrap();
            let whole = Encoded(overscan.frame_of(&whole.0));
            let with = Plate { overscan, ..plate(&frame) };
            let made = composite(&with, &layer, &small, &options).unwrap();
            assert!(worst(&made, &whole) < 2e-5, "{bokeh:?}: {}", worst(&made, &whole));
            // The layer apart has it all, and gives the same over the frame.
            let apart = distorted_layer(&with, &layer, &small, &options).unwrap();
            let large = distorted_layer(&plate(&whole_frame), &layer, &large, &options).unwrap();
            assert_eq!((apart.overscan, apart.color.0.size()), (overscan, (W, H)));
            assert_eq!(apart.color.0.map(|p| p[3]), large.color.0.map(|p| p[3]));
            let over = Linear(Raster::from_fn(w, h, |i, j| {
                let l = apart.color.0.at(i + x, j + y);
                let f = frame.0.at(i, j).map(|v| Transfer::Srgb.decode(v));
                std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c])
            }));
            assert!(worst(&over.to_encoded(Transfer::Srgb), &whole) < 1e-4);
            // Negative control: without what lies beyond the frame the picture is another.
            let bare = composite(&plate(&frame), &cut(&layer, [x, y, w, h]), &small, &options).unwrap();
            assert!(worst(&bare, &whole) > 0.05, "bare, {bokeh:?}: {}", worst(&bare, &whole));
        }
        // With noise, both ways of making the frame still agree.
        let noisy = with_noise(small, 0.04, 0.01, 1.0);
        let with = Plate { overscan, ..plate(&frame) };
        let made = composite(&with, &layer, &noisy, &CompositeOptions::default()).unwrap();
        let apart = distorted_layer(&with, &layer, &noisy, &CompositeOptions::default()).unwrap();
        let over = Linear(Raster::from_fn(w, h, |i, j| {
            let (l, n) = (apart.color.0.at(i + x, j + y), apart.noise.at(i + x, j + y));
            let f = frame.0.at(i, j).map(|v| Transfer::Srgb.decode(v));
            std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c] + n[c])
        }));
        assert!(worst(&over.to_encoded(Transfer::Srgb), &made) < 1e-4);
        let e = composite(&plate(&frame), &layer, &noisy, &without_noise).unwrap_err().to_string();
        assert!(e.contains("160 x 120") && e.contains("76 x 85"), "{e}");
    }

    #[test]
    fn overscan_without_anything_in_it_changes_nothing() {
        // The cat's eye depends on the place in the frame, which is not that in the layer.
        let frame = background();
        let mut model = camera();
        if let Estimate::Known(lens) = &mut model.defocus {
            lens.bokeh = crate::model::Aperture { cats_eye: 1.0, ..Bokeh::Disk.into() };
        }
        let layer = square(GREY, 1.0, 2.0, [9.0, 3.0]);
        let overscan = Overscan { left: 33, top: 21, right: 2, bottom: 0 };
        let mut large = Raster::filled(W + 35, H + 21, [0.0; 4]);
        overscan.put_frame(&layer.color.0, &mut large);
        let around = VirtualLayer {
            color: Premultiplied(large),
            inverse_depth: layer.inverse_depth.as_ref().map(|d| overscan.continued(d)),
            flow: layer.flow.as_ref().map(|f| overscan.continued(f)),
        };
        let options = CompositeOptions::default();
        let plain = composite(&plate(&frame), &layer, &model, &options).unwrap();
        let same = composite(&Plate { overscan, ..plate(&frame) }, &around, &model, &options).unwrap();
        assert!(worst(&same, &plain) < 2e-5, "{}", worst(&same, &plain));
        // Negative control: at another place of the frame the cut is another.
        let mut uncut = model.clone();
        if let Estimate::Known(lens) = &mut uncut.defocus {
            lens.bokeh.cats_eye = 0.0;
        }
        let uncut = composite(&plate(&frame), &layer, &uncut, &options).unwrap();
        assert!(worst(&uncut, &plain) > 1e-3, "{}", worst(&uncut, &plain));
    }

    #[test]
    fn what_does_not_fit_together_is_an_error_that_says_so() {
        let frame = background();
        let layer = square(GREY, 1.0, 1.0, [0.0; 2]);
        let fails = |plate: &Plate, layer: &VirtualLayer, model: &CameraModel, says: &str| {
            let e = composite(plate, layer, model, &CompositeOptions::default()).unwrap_err().to_string();
            assert!(e.contains(says), "{e}");
        };
        let small = Plane::filled(3, 3, 1.0);
        fails(
            &Plate { inverse_depth: Some(&small), ..plate(&frame) },
            &layer,
            &camera(),
            "the real depth has 3 x 3",
        );
        let other = VirtualLayer { flow: Some(Flow::filled(2, 2, [0.0; 2])), ..layer.clone() };
        fails(&plate(&frame), &other, &camera(), "flow has 2 x 2");
        fails(&plate(&frame), &layer, &camera().scaled_to(2 * W, 2 * H), "320");
        let mut relative = camera();
        if let Estimate::Known(d) = &mut relative.defocus {
            d.depth_kind = DepthKind::Relative;
        }
        fails(&plate(&frame), &layer, &relative, "relative inverse depth");
    }

    #[test]
    fn broken_values_do_not_spread() {
        let frame = background();
        let mut layer = square(GREY, 1.0, 2.0, [9.0, 3.0]);
        layer.color.0.row_mut(60)[70] = [f32::NAN, 0.0, f32::INFINITY, 1.0];
        if let (Some(d), Some(f)) = (&mut layer.inverse_depth, &mut layer.flow) {
            d.row_mut(61)[71] = f32::INFINITY;
            f.row_mut(62)[72] = [f32::NAN, f32::INFINITY];
        }
        let real = Plane::from_fn(W, H, |x, y| [f32::NAN, f32::INFINITY, -1.0, 0.0, 5.0][(x + y) % 5]);
        let flow = Flow::filled(W, H, [f32::NAN, 1.0]);
        let with = Linear(Raster::from_fn(W, H, |x, y| [if (x + y) % 7 == 0 { f32::NAN } else { 0.3 }; 3]));
        let without = Linear(Raster::filled(W, H, [0.4; 3]));
        let model = with_noise(camera(), 0.04, 0.01, 1.0);
        let plate = Plate {
            inverse_depth: Some(&real),
            flow: Some(&flow),
            with_and_without: Some((&with, &without)),
            ..plate(&frame)
        };
        let out = composite(&plate, &layer, &model, &CompositeOptions::default()).unwrap();
        assert!(out.0.data().iter().flatten().all(|v| (0.0..=1.0).contains(v)));
    }
}
