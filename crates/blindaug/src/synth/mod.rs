//! Synthesis of each distortion: the reference that every other backend is compared with.

pub mod defocus;
pub mod motion_blur;
pub mod noise;

use crate::model::{CameraModel, DefocusModel, DepthKind, ExposureFraction};
use crate::{Error, Flow, Pixel, Plane, Raster, Result};
use defocus::Bokeh;

/// What a camera's lens and shutter do to an image, as far as it is known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Blur {
    defocus: Option<DefocusModel>,
    exposure: Option<ExposureFraction>,
    bokeh: Bokeh,
}

impl Blur {
    /// The blur of a camera model for frames of `width` px; unknown parts blur nothing.
    ///
    /// # Errors
    /// If the model is for another width, or its defocus is in relative inverse depth (the depths here are metric).
    pub fn new(model: &CameraModel, width: usize, bokeh: Bokeh) -> Result<Self> {
        if model.capture.width != width {
            return Err(Error::new(format!(
                "the camera model is for frames {} px wide but the frame is {width}; scale it first (CameraModel::scaled_to)",
                model.capture.width
            )));
        }
        let defocus = model.defocus.known().copied();
        if defocus.is_some_and(|d| d.depth_kind == DepthKind::Relative) {
            return Err(Error::new(
                "the camera model's defocus is in relative inverse depth; say how that relates to metres (DefocusModel::to_metric, \
                 --scene-scale), or mark the defocus unknown",
            ));
        }
        Ok(Self { defocus, exposure: model.motion_blur.known().map(|m| m.exposure), bokeh })
    }

    /// The defocus std at inverse depth `d` in 1/m, px; 0 where the depth is unknown (NaN).
    pub fn sigma_px(&self, d: f32) -> f32 {
        match self.defocus {
            Some(model) if d.is_finite() => model.sigma_px(d).min(defocus::MAX_SIGMA_PX),
            _ => 0.0,
        }
    }

    /// How far from where it was a point can be seen, if it has this inverse depth and flow, px.
    pub fn reach_px(&self, d: f32, [u, v]: [f32; 2]) -> f32 {
        let path = self.exposure.map_or(0.0, |e| 0.5 * e.0 * u.hypot(v));
        let lens = match self.bokeh {
            Bokeh::Gaussian => 4.5 * self.sigma_px(d),
            Bokeh::Disk => 2.0 * self.sigma_px(d) + 1.0,
        };
        lens + if path.is_finite() { path } else { 0.0 }
    }

    /// Defocus, then motion blur, each where the model and the evidence for it are there.
    ///
    /// # Errors
    /// If depth or flow has another size than the image.
    pub fn of<P: Pixel>(
        &self,
        image: &Raster<P>,
        inverse_depth: Option<&Plane>,
        flow: Option<&Flow>,
    ) -> Result<Raster<P>> {
        let focused = match inverse_depth {
            Some(d) if self.defocus.is_some() => {
                defocus::defocus(image, &d.map(|d| self.sigma_px(d)), self.bokeh)?
            }
            _ => image.clone(),
        };
        match (flow, self.exposure) {
            (Some(flow), Some(exposure)) => motion_blur::motion_blur(&focused, flow, exposure),
            _ => Ok(focused),
        }
    }
}
