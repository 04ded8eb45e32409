//! Footage of scenes with and without a virtual object, by cameras of several kinds: the ground on which composites are compared.

use crate::fidelity::Fidelity;
use crate::filming::{Filming, coded};
use crate::validation::measure;
use blindaug::composite::{CompositeOptions, Plate, VirtualLayer, composite};
use blindaug::fit::Estimation;
use blindaug::metrics::object_area;
use blindaug::model::{DepthKind, SceneScale, SharpeningModel};
use blindaug::synth::{defocus::Bokeh, sharpening::sharpen};
use blindaug::{CameraModel, Encoded, Flow, Linear, Plane, Raster, Transfer};
use blindaug_io::{Error, Result, VideoCoding};
use blindaug_pipeline::{Networks, Silent};
use blindaug_scenes::camera::{Camera, Setting, in_steps};
use blindaug_scenes::measure::{Footage, Given, NoiseTruth};
use blindaug_scenes::scene::{Exposure, Scene, TextureKind};
use blindaug_scenes::thing::Thing;
use std::path::Path;

/// A camera that films, processes and codes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Device {
    /// The name in tables and of files.
    pub(crate) name: &'static str,
    /// What kind of camera it is, in a few words.
    pub(crate) about: &'static str,
    /// The shutter, the lens and the sensor.
    pub(crate) setting: Setting,
    /// The unsharp mask of the picture's processing.
    pub(crate) sharpening: Option<SharpeningModel>,
    /// The coder; `None`: frames of 8 bits.
    pub(crate) coding: Option<VideoCoding>,
}

impl Device {
    /// A camera with this setting that neither sharpens nor codes.
    pub(crate) fn plain(name: &'static str, about: &'static str, setting: Setting) -> Self {
        Self { name, about, setting, sharpening: None, coding: None }
    }

    fn exposure(&self) -> Exposure {
        let s = &self.setting;
        Exposure { fraction: s.exposure, lens: s.lens, readout: s.rolling_shutter }
    }

    /// The picture after the camera's processing.
    fn processed(&self, frame: &Encoded) -> Encoded {
        match &self.sharpening {
            Some(mask) => Encoded(sharpen(&frame.0, mask).map(|p| p.map(|v| v.clamp(0.0, 1.0)))),
            None => frame.clone(),
        }
    }
}

/// Footage of a scene without the object, and frames on which composites are compared. The lists have an entry for each frame.
pub(crate) struct Shot {
    /// The frames as the camera delivers them, and what can be known of them.
    pub(crate) footage: Footage,
    /// Motion, px per frame interval, from half an interval before to half an interval after the frame's time.
    pub(crate) motion: Vec<Flow>,
    /// The frames on which composites are compared.
    pub(crate) compared: Vec<Compared>,
}

/// A frame with and without the object.
pub(crate) struct Compared {
    /// The number of the frame.
    pub(crate) number: usize,
    /// The frame without noise and coding.
    pub(crate) plate: Encoded,
    /// The frame with the object really there, without noise and coding.
    pub(crate) truth: Encoded,
    /// The object, rendered sharp.
    pub(crate) layer: VirtualLayer,
    /// The object's pixels and those around it.
    pub(crate) area: Raster<bool>,
}

/// The distance around the object that is compared too, px of a frame 512 px wide.
const AROUND: f32 = 20.0;
/// The number of pictures whose mean stands for a frame without noise: each has some noise of its limited number of views.
const PICTURES: u64 = 4;

impl Shot {
    /// Films `frames` frames of a scene, and the frames `compared` also with the object. A video that is coded stays at `video`.
    ///
    /// # Errors
    /// If a coder is needed and there is no ffmpeg program.
    pub(crate) fn film(
        scene: &Scene,
        object: &Thing,
        device: &Device,
        (frames, compared): (u64, &[usize]),
        seed: u64,
        video: &Path,
    ) -> Result<Self> {
        let fails = |e: blindaug::Error| Error::new(video, e.to_string());
        let mut filming = Filming::new(scene.clone(), frames);
        filming.film(Camera::Physics, device.setting, seed).map_err(fails)?;
        let mut delivered: Vec<Encoded> = filming
            .footage
            .frames
            .iter()
            .map(|f| Encoded(device.processed(f).0.map(|p| p.map(in_steps))))
            .collect();
        if let Some(coding) = device.coding {
            delivered = coded(&delivered, coding, video)?;
        }
        let with = scene.clone().with(object.clone());
        let filmed = |scene: &Scene, t: usize| {
            let pictures: Vec<Linear> = (0..PICTURES)
                .map(|i| scene.picture(t as f32, device.exposure(), PICTURES * t as u64 + i))
                .collect();
            let (w, h) = pictures[0].0.size();
            let mean = Linear(Raster::from_fn(w, h, |x, y| {
                let sum = |c: usize| pictures.iter().map(|p| p.0.at(x, y)[c]).sum::<f32>();
                std::array::from_fn(|c| sum(c) / PICTURES as f32)
            }));
            device.processed(&mean.to_encoded(Transfer::Srgb))
        };
        let mut noise = NoiseTruth::default();
        let compared: Vec<Compared> = compared
            .iter()
            .map(|&number| {
                let (plate, truth) = (filmed(scene, number), filmed(&with, number));
                noise.add(&delivered[number], &plate);
                let layer: VirtualLayer = scene.layer(object, number as f32).into();
                let around = AROUND * plate.0.width() as f32 / 512.0;
                let area = object_area(&layer.color.0.map(|p| p[3]), around as usize);
                Compared { number, plate, truth, layer, area }
            })
            .collect();
        let footage = Footage { frames: delivered, noise: Some(noise), ..filming.footage };
        Ok(Self { footage, motion: filming.motion, compared })
    }

    /// The camera that is estimated from what is delivered, and nothing else.
    ///
    /// # Errors
    /// Sound footage gives no error.
    pub(crate) fn estimate(&self) -> blindaug::Result<Estimation> {
        Ok(measure(&self.footage, Given::Nothing, &mut Networks::default(), &Silent)?.1)
    }

    /// The estimated camera with its lens in metres. The frames alone give depth without a unit; whoever places an object knows how far
    /// away it is, so that the scale and the offset are found by a comparison with the scene's depth.
    pub(crate) fn metric(&self, estimation: &Estimation) -> CameraModel {
        let model = estimation.model.clone();
        let relative = model.defocus.known().is_some_and(|m| m.depth_kind == DepthKind::Relative);
        let own = estimation.diagnostics.inverse_depth.as_ref();
        match own
            .filter(|_| relative)
            .and_then(|(frame, own)| scene_scale(own, &self.footage.inverse_depth[*frame]))
        {
            Some(scale) => model.to_metric(scale),
            None => model,
        }
    }

    /// A frame of the shot, in one of its forms, with what is known of the scene in it.
    pub(crate) fn plate<'a>(&'a self, number: usize, frame: &'a Encoded) -> Plate<'a> {
        Plate {
            inverse_depth: Some(&self.footage.inverse_depth[number]),
            flow: Some(&self.motion[number]),
            ..Plate::new(frame, number as u64)
        }
    }

    /// The composite of a frame without noise by this camera; `naive`: pasted as it is.
    ///
    /// # Errors
    /// If the model is for another width or in relative depth.
    pub(crate) fn composite(
        &self,
        of: &Compared,
        model: &CameraModel,
        naive: bool,
    ) -> blindaug::Result<Encoded> {
        let options = CompositeOptions {
            naive,
            no_noise: true,
            bokeh: Some(Bokeh::Disk),
            ..CompositeOptions::default()
        };
        composite(&self.plate(of.number, &of.plate), &of.layer, model, &options)
    }

    /// The mean likeness over the compared frames of what `make` makes of each to the truth.
    ///
    /// # Errors
    /// The same as those of `make`.
    pub(crate) fn fidelity(
        &self,
        mut make: impl FnMut(&Compared) -> blindaug::Result<Encoded>,
    ) -> blindaug::Result<Fidelity> {
        let mut all = vec![];
        for c in &self.compared {
            all.push(Fidelity::new(&make(c)?, &c.truth, &c.area)?);
        }
        let mean = |of: fn(&Fidelity) -> f64| all.iter().map(of).sum::<f64>() / all.len().max(1) as f64;
        Ok(Fidelity { psnr: mean(|f| f.psnr), ssim: mean(|f| f.ssim), flip: mean(|f| f.flip) })
    }
}

/// The scale and the offset with which `own` relative inverse depth follows from the true one, by least squares without the places
/// that do not fit; `None` if there is no such relation.
fn scene_scale(own: &Plane, truth: &Plane) -> Option<SceneScale> {
    let mut points: Vec<[f64; 2]> = own
        .data()
        .iter()
        .zip(truth.data())
        .filter(|(own, truth)| own.is_finite() && truth.is_finite())
        .map(|(&own, &truth)| [truth.into(), own.into()])
        .collect();
    let mut fitted = None;
    for _ in 0..5 {
        let n = points.len() as f64;
        let [x, y] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n);
        let xx: f64 = points.iter().map(|p| (p[0] - x).powi(2)).sum();
        let slope = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum::<f64>() / xx;
        let residual = |p: &[f64; 2]| (p[1] - y - slope * (p[0] - x)).abs();
        if !(slope > 0.0 && n >= 16.0) {
            break;
        }
        fitted = Some(SceneScale { scale: slope as f32, offset: (y - slope * x) as f32 });
        let mut sorted: Vec<f64> = points.iter().map(residual).collect();
        sorted.sort_by(f64::total_cmp);
        let limit = 3.0 * sorted[sorted.len() / 2];
        points.retain(|p| residual(p) <= limit);
    }
    fitted
}

/// A ball of about this radius in px, at this depth, where nothing hides it at time `t`; `None` if there is no such place.
pub(crate) fn ball(
    scene: &Scene,
    t: f32,
    (depth_m, radius_px): (f32, f32),
    texture: TextureKind,
    seed: u64,
) -> Option<Thing> {
    // A marker's board is large enough for a ball of its disk's radius.
    let place = scene.visible_marker(t, depth_m, radius_px, false)?;
    Some(Thing::ball(place.centre, place.radius_m, texture, seed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_depth_is_brought_to_metres() {
        let truth = Plane::from_fn(32, 32, |x, y| 0.1 + 0.02 * x as f32 + 0.001 * y as f32);
        let mut own = truth.map(|d| 0.4 * d + 0.05);
        own.row_mut(3).fill(2.0);
        let scale = scene_scale(&own, &truth).unwrap();
        assert!((scale.scale - 0.4).abs() < 1e-3 && (scale.offset - 0.05).abs() < 1e-3, "{scale:?}");
        assert!(scene_scale(&own.map(|d| -d), &truth).is_none_or(|s| s.scale < 0.1));
    }
}
