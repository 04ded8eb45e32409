//! The shadows and reflections of the object on the filmed scene.

use super::place::Place;
use super::{Plate, VirtualLayer};
use crate::model::Space;
use crate::synth::{Blur, extended};
use crate::{Raster, Result};

/// The shadows and reflections that the object adds to the filmed scene, blurred like the scene.
pub(super) struct Shadows {
    pub place: Place,
    /// In R, G and B the factor of the scene's light, minus 1 (from -1 to 0), then the light that is added.
    pub change: Raster<[f32; 6]>,
}

/// The layer's alpha above which the renders do not show the change of the background.
const OPAQUE: f32 = 0.01;

impl Shadows {
    /// The place that may have shadows or reflections; `None` if there are none.
    pub fn place(plate: &Plate, blur: &Blur) -> Option<Place> {
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

    pub fn new(
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
