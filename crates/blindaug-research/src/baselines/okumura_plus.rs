//! "Okumura++-like": our exposure fraction and blur, fitted on a marker whose sharp picture is known. It follows what the paper says of
//! its own baseline, whose code is not public.
//!
//! The marker is rendered at its known pose, and the picture that the synthesis makes of it is compared with the frame by least squares.
//! A marker at one depth does not tell a lens's two numbers apart, so that everything gets the blur of the marker's depth.

use blindaug::model::{
    Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel,
};
use blindaug::synth::{SynthesisOptions, defocus::Bokeh, distort_frame};
use blindaug::{CameraModel, Encoded, Flow, Plane, Raster, Result, Transfer};

/// A frame in which the marker is seen.
pub struct Seen<'a> {
    /// The frame.
    pub frame: &'a Encoded,
    /// The sharp picture of the same view.
    pub sharp: &'a Encoded,
    /// The motion, px per frame interval.
    pub motion: &'a Flow,
    /// The middle of the marker, px.
    pub middle: [f32; 2],
}

/// The largest std of the blur that is looked for, px.
const LARGEST: f32 = 10.0;

/// The camera with the exposure fraction and the blur, the same everywhere, that make the frames from the sharp pictures best, within
/// `reach` px of the marker's middle. Its noise is unknown.
///
/// # Errors
/// If the sizes of a frame and its evidence differ.
pub fn measure(seen: &[Seen], reach: usize) -> Result<CameraModel> {
    let (width, height) = seen.first().map_or((1, 1), |s| s.frame.0.size());
    let capture = Capture { width, height, fps: None, frames_used: seen.len(), pixel_aspect: 1.0 };
    let unknown = CameraModel::unknown(capture, "the marker does not tell it");
    let windows: Vec<Window> = seen.iter().filter_map(|s| Window::new(s, reach)).collect();
    if windows.is_empty() {
        return Ok(unknown);
    }
    let camera = |exposure: f32, sigma: f32| {
        let mut camera = unknown.clone();
        camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
        camera.defocus = Estimate::Known(everywhere(sigma));
        camera
    };
    let error = |[exposure, sigma]: [f32; 2]| -> Result<f64> {
        let camera = camera(exposure, sigma);
        windows.iter().map(|w| w.error(&camera)).sum()
    };
    let mut best = ([0.0, 0.0], f64::INFINITY);
    // The best place of a coarse grid, then steps to better neighbours that become shorter where there are none.
    for i in 0..=8 {
        for j in 0..=8 {
            let place = [i as f32 / 8.0, LARGEST * (j as f32 / 8.0).powi(2)];
            let e = error(place)?;
            if e < best.1 {
                best = (place, e);
            }
        }
    }
    let mut step = [0.06, 0.5];
    while step[0] > 0.004 {
        let from = best;
        for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i as f32, j as f32))) {
            let [exposure, sigma] = from.0;
            let place = [(exposure + i * step[0]).clamp(0.0, 1.0), (sigma + j * step[1]).clamp(0.0, LARGEST)];
            let e = error(place)?;
            if e < best.1 {
                best = (place, e);
            }
        }
        if best.0 == from.0 {
            step = step.map(|s| 0.5 * s);
        }
    }
    Ok(camera(best.0[0], best.0[1]))
}

/// A blur of this std, px, at every depth.
fn everywhere(sigma: f32) -> DefocusModel {
    let curve = DefocusCurve::Quadratic { a: 0.0, b: 0.0, c: sigma, inverse_depth_range: [0.0, 100.0] };
    DefocusModel::given(curve, DepthKind::Metric)
}

/// The part of a frame around the marker.
struct Window {
    frame: Encoded,
    sharp: Encoded,
    motion: Flow,
    depth: Plane,
}

impl Window {
    /// `None` if the window is not wholly inside the frame.
    fn new(seen: &Seen, reach: usize) -> Option<Self> {
        let (w, h) = seen.frame.0.size();
        let [x, y] = seen.middle.map(|v| v.round());
        let within = |v: f32, n: usize| v >= reach as f32 && v + (reach as f32) < n as f32;
        if !within(x, w) || !within(y, h) {
            return None;
        }
        let (left, top, side) = (x as usize - reach, y as usize - reach, 2 * reach);
        let cut = |of: &Encoded| Encoded(Raster::from_fn(side, side, |x, y| of.0.at(left + x, top + y)));
        Some(Self {
            frame: cut(seen.frame),
            sharp: cut(seen.sharp),
            motion: Raster::from_fn(side, side, |x, y| seen.motion.at(left + x, top + y)),
            depth: Plane::filled(side, side, 1.0),
        })
    }

    /// The sum of squared differences between the frame and what the camera makes of the sharp picture.
    fn error(&self, camera: &CameraModel) -> Result<f64> {
        let side = self.frame.0.width();
        let mut camera = camera.clone();
        // The synthesis wants the width of the pictures that it is given; px stay px.
        (camera.capture.width, camera.capture.height) = (side, side);
        let options =
            SynthesisOptions { bokeh: Some(Bokeh::Disk), no_noise: true, ..SynthesisOptions::default() };
        let sharp = self.sharp.to_linear(Transfer::Srgb);
        let made = distort_frame(&sharp, &camera, Some(&self.depth), Some(&self.motion), &options, 0)?;
        // Near the border, what lies outside is missing.
        let margin = side / 8;
        let inner = || (margin..side - margin).flat_map(|y| (margin..side - margin).map(move |x| (x, y)));
        let square = |(x, y): (usize, usize)| {
            let (a, b) = (made.0.at(x, y), self.frame.0.at(x, y));
            (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>()
        };
        Ok(inner().map(square).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_and_blur_of_a_known_picture_are_found() {
        const N: usize = 96;
        let sharp = Encoded(Raster::from_fn(N, N, |x, y| {
            let inside = (x as f32 - 48.0).hypot(y as f32 - 48.0) < 18.0;
            [if inside { 0.1 } else { 0.85 }; 3]
        }));
        let motion = Flow::filled(N, N, [9.0, 3.0]);
        let measured = |frame: &Encoded, middle| {
            measure(&[Seen { frame, sharp: &sharp, motion: &motion, middle }], 40).unwrap()
        };
        for (exposure, sigma) in [(0.6, 1.5), (0.3, 3.0), (0.8, 0.0)] {
            let mut camera = CameraModel::unknown(
                Capture { width: N, height: N, fps: None, frames_used: 1, pixel_aspect: 1.0 },
                "nobody looked",
            );
            camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
            camera.defocus = Estimate::Known(everywhere(sigma));
            let options =
                SynthesisOptions { bokeh: Some(Bokeh::Disk), no_noise: true, ..SynthesisOptions::default() };
            let depth = Plane::filled(N, N, 1.0);
            let linear = sharp.to_linear(Transfer::Srgb);
            let frame = distort_frame(&linear, &camera, Some(&depth), Some(&motion), &options, 0).unwrap();
            let found = measured(&frame, [48.0; 2]);
            let (e, s) =
                (found.motion_blur.known().unwrap().exposure.0, found.defocus.known().unwrap().sigma_px(1.0));
            assert!((e - exposure).abs() < 0.05 && (s - sigma).abs() < 0.3, "{exposure} {sigma}: {e} {s}");
        }
        // Of a sharp frame, no blur is found.
        let found = measured(&sharp, [48.0; 2]);
        assert!(found.motion_blur.known().unwrap().exposure.0 < 0.05);
        assert!(measured(&sharp, [3.0; 2]).motion_blur.known().is_none());
    }
}
