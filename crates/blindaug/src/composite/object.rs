//! The object, blurred and hidden by the real things in front of it.

use super::place::Place;
use super::{Plate, VirtualLayer};
use crate::model::Space;
use crate::synth::{Blur, coverage_weight, extended};
use crate::{Plane, Raster, Result, filter};

/// The change that the object makes to a pixel of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ObjectPixel {
    /// The light that is added: `V L - A B`.
    pub added: [f32; 3],
    /// The share of the shadows and reflections that the object hides: `A V`, in [0, 1].
    pub cover: f32,
    /// The share of the frame's own value, and so of its noise, that is lost, in [0, 1].
    pub lost: f32,
    /// The share of the object that real things in front let through: `V`, in [0, 1].
    pub visible: f32,
}

impl ObjectPixel {
    pub fn changes_nothing(&self) -> bool {
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
pub(super) struct Object {
    pub place: Place,
    pub pixels: Raster<ObjectPixel>,
}

/// A real surface hides a virtual one if its inverse depth is larger by more than this factor, the tolerance of both depths.
const IN_FRONT: f32 = 1.02;

impl Object {
    /// The place in which the object may be seen; `None` if it covers no pixel.
    pub fn place(layer: &VirtualLayer, blur: &Blur) -> Option<Place> {
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

    pub fn new(
        plate: &Plate,
        place: Place,
        layer: &VirtualLayer,
        space: &Space,
        blur: &Blur,
    ) -> Result<Self> {
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
