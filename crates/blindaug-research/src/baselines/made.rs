//! What each method finds in a shot, and the composite that it makes of it.

use super::{Method, lens_net, okumura, okumura_plus, shutter_angle};
use crate::shot::Shot;
use crate::validation::measure;
use blindaug::composite::{CompositeOptions, Plate, VirtualLayer, composite};
use blindaug::model::{Capture, Estimate, ExposureFraction, MotionBlurModel};
use blindaug::{CameraModel, Encoded, Linear, Premultiplied, Raster, Result, Transfer};
use blindaug_pipeline::{Networks, Silent};
use blindaug_scenes::camera::{Setting, model};
use blindaug_scenes::measure::Given;
use blindaug_scenes::scene::Scene;
use blindaug_scenes::thing::{Marker, Thing};

/// The radius of the marker's disk, as a share of the picture's width.
const MARKER: f32 = 0.05;

/// A marker in a scene, and the radius of its disk in px where it was put.
pub(crate) struct Placed {
    marker: Marker,
    radius_px: f32,
}

/// The scene with a marker at this depth that the object does not hide at time `t`. A smaller marker is taken where a larger one has no
/// place; `None`: not even the smallest has.
pub(crate) fn with_marker(scene: Scene, object: &Thing, depth_m: f32, t: f32) -> (Scene, Option<Placed>) {
    let with_object = scene.clone().with(object.clone());
    let placed = [1.0, 0.8, 0.6, 0.45].into_iter().find_map(|share| {
        let radius_px = share * MARKER * scene.size().0 as f32;
        let marker = with_object.visible_marker(t, depth_m, radius_px, false)?;
        Some(Placed { marker, radius_px })
    });
    match placed {
        Some(placed) => (scene.with_marker(placed.marker), Some(placed)),
        None => (scene, None),
    }
}

/// A shot, and what the methods are given of it.
pub(crate) struct Ground<'a> {
    /// The shot.
    pub(crate) shot: &'a Shot,
    /// The scene, with the marker in it.
    pub(crate) scene: &'a Scene,
    /// The marker.
    pub(crate) marker: Option<&'a Placed>,
    /// The settings of the camera that filmed.
    pub(crate) setting: &'a Setting,
    /// The number of the scenery, whose camera has a network of its own.
    pub(crate) scenery: usize,
}

/// What a method found.
pub(crate) enum Found {
    /// A camera.
    Camera(Box<CameraModel>),
    /// A blur of the whole layer.
    Gaussian(okumura::EllipticalGaussian),
    /// The network of the camera of this scenery.
    Network(usize),
    /// Nothing: the object is pasted.
    Nothing,
}

impl Ground<'_> {
    /// What a method finds.
    ///
    /// # Errors
    /// Sound footage gives no error.
    pub(crate) fn estimate(&self, method: Method, networks: &mut Networks) -> Result<Found> {
        let shot = self.shot;
        let frames = &shot.footage.frames;
        let camera = |model: CameraModel| Found::Camera(Box::new(model));
        Ok(match method {
            Method::Naive => Found::Nothing,
            Method::OkumuraLike => {
                let middle = frames.len() / 2;
                let found = self.marker.and_then(|placed| {
                    let rim = self.scene.rim(&placed.marker, middle as f32, 96);
                    // The board reaches as far beyond the rim as the disk within.
                    okumura::measure(&frames[middle].to_linear(Transfer::Srgb), &rim, 0.9 * placed.radius_px)
                });
                found.map_or(Found::Nothing, Found::Gaussian)
            }
            Method::OkumuraPlusLike => match self.marker {
                None => Found::Nothing,
                Some(placed) => {
                    let all: Vec<okumura_plus::Seen> =
                        (0..frames.len()).filter_map(|t| self.seen(placed, t)).collect();
                    camera(okumura_plus::measure(&all, (1.9 * placed.radius_px) as usize)?)
                }
            },
            Method::LensNetLike => Found::Network(self.scenery),
            Method::ShutterAngleLike => {
                let all: Vec<_> = frames.iter().zip(&shot.motion).collect();
                let (width, height) = frames[0].0.size();
                let capture =
                    Capture { width, height, fps: None, frames_used: frames.len(), pixel_aspect: 1.0 };
                let mut model = CameraModel::unknown(capture, "the method does not tell it");
                if let Some(found) = shutter_angle::measure(&all) {
                    model.motion_blur =
                        Estimate::Known(MotionBlurModel::given(ExposureFraction(found.exposure)));
                }
                camera(model)
            }
            Method::Removal => {
                let given = if networks.is_empty() { Given::Nothing } else { Given::NothingByNetworks };
                camera(shot.metric(&measure(&shot.footage, given, networks, &Silent)?.1))
            }
            Method::Ours => camera(shot.metric(&shot.estimate()?)),
            Method::TrueCamera => camera(model(frames[0].0.size(), self.setting)),
        })
    }

    /// The marker in a frame; `None` where it is not seen as a whole.
    fn seen(&self, placed: &Placed, t: usize) -> Option<okumura_plus::Seen<'_>> {
        let rim = self.scene.rim(&placed.marker, t as f32, 16);
        if rim.iter().any(|p| !p.visible) {
            return None;
        }
        let middle = [0, 1].map(|k| rim.iter().map(|p| p.place[k]).sum::<f32>() / rim.len() as f32);
        Some(okumura_plus::Seen {
            frame: &self.shot.footage.frames[t],
            sharp: &self.shot.footage.clean[t],
            motion: &self.shot.motion[t],
            middle,
        })
    }
}

impl Found {
    /// The layer over the plate as the method would make it.
    ///
    /// # Errors
    /// If sizes differ.
    pub(crate) fn composite(
        &self,
        plate: &Plate,
        layer: &VirtualLayer,
        options: &CompositeOptions,
    ) -> Result<Encoded> {
        match self {
            Self::Camera(model) => composite(plate, layer, model, options),
            Self::Gaussian(by) => over(plate, layer, |visible| Ok(okumura::blurred(&visible.color, *by))),
            Self::Network(scenery) => over(plate, layer, |visible| {
                lens_net::blurred(visible, *scenery).map_err(|e| blindaug::Error::new(e.to_string()))
            }),
            Self::Nothing => {
                let (width, height) = plate.frame.0.size();
                let capture = Capture { width, height, fps: None, frames_used: 0, pixel_aspect: 1.0 };
                let unknown = CameraModel::unknown(capture, "the method finds nothing");
                composite(plate, layer, &unknown, &CompositeOptions { naive: true, ..*options })
            }
        }
    }

    /// What was found, in a few words.
    pub(crate) fn words(&self) -> String {
        match self {
            Self::Nothing => "nothing".into(),
            Self::Network(_) => "a network of the lens".into(),
            Self::Gaussian(g) => {
                let angle = g.phi.to_degrees();
                format!("std {:.1} px, along {angle:.0} degrees {:.1} px more", g.sigma_d, g.sigma_m)
            }
            Self::Camera(m) => {
                let exposure =
                    m.motion_blur.known().map_or("unknown".into(), |m| format!("{:.2}", m.exposure.0));
                let blur =
                    m.defocus.known().map_or("unknown".into(), |m| format!("{:.1} px", m.sigma_px(0.0)));
                format!("exposure fraction {exposure}, blur at infinity {blur}")
            }
        }
    }
}

/// The layer, without what is hidden, blurred by `blur` and laid over the frame in light.
fn over(
    plate: &Plate,
    layer: &VirtualLayer,
    blur: impl FnOnce(&VirtualLayer) -> Result<Premultiplied>,
) -> Result<Encoded> {
    let (w, h) = layer.color.0.size();
    let hidden = |x, y| {
        let depth = |of: Option<&blindaug::Plane>| of.map_or(f32::NAN, |d| d.at(x, y));
        depth(plate.inverse_depth) > 1.02 * depth(layer.inverse_depth.as_ref())
    };
    let visible = Premultiplied(Raster::from_fn(w, h, |x, y| match hidden(x, y) {
        true => [0.0; 4],
        false => layer.color.0.at(x, y),
    }));
    let layer = blur(&VirtualLayer { color: visible, ..layer.clone() })?;
    let frame = plate.frame.to_linear(Transfer::Srgb);
    let light = Linear(Raster::from_fn(w, h, |x, y| {
        let (l, f) = (layer.0.at(x, y), frame.0.at(x, y));
        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c])
    }));
    Ok(light.to_encoded(Transfer::Srgb))
}
