//! A virtual object before and after: a grey ball and a mirror ball in the middle of a frame, pasted on, and composited with the estimated
//! camera. Compositors judge a plate by such balls, and what the camera does to them says more than its numbers.
//!
//! The balls are shaded here by formula, for the report must be made without a renderer or files; the composite is the library's.

use blindaug::composite::{CompositeOptions, Plate, VirtualLayer, composite};
use blindaug::model::{DepthKind, Distortion, Estimate};
use blindaug::{
    CameraModel, Encoded, Flow, Linear, Plane, Premultiplied, Raster, Result, Sample, filter, luma,
};

/// The largest width and height of the part of a frame that is shown, px.
const SHOWN: [usize; 2] = [440, 300];
/// The least width and height of a frame that the balls have room in, px.
const LEAST: usize = 64;
/// The radius of a ball over the height of the part.
const RADIUS: f32 = 0.2;
/// The height at which a ball's middle stands, from the top, over the height of the part.
const MIDDLE: f32 = 0.56;
/// The reflectance of grey cards, and of a good mirror.
const GREY: f32 = 0.18;
const MIRROR: f32 = 0.85;

/// The same balls in a part of a frame, without the camera's distortions and with them.
pub(crate) struct BeforeAfter {
    /// The number of the frame.
    pub number: u64,
    /// The balls pasted on.
    pub pasted: Encoded,
    /// The balls composited with the camera.
    pub matched: Encoded,
    /// The distortions that are left out, since they or what they need are unknown.
    pub left_out: Vec<&'static str>,
}

/// The balls in the frame, with a camera for frames of its size; `None` if the frame is too small.
///
/// # Errors
/// If flow or depth has another size than the frame.
pub(crate) fn before_after(sample: &Sample, model: &CameraModel) -> Result<Option<BeforeAfter>> {
    let (w, h) = sample.frame.0.size();
    if w < LEAST || h < LEAST || sample.frame.0.data().as_flattened().iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let (width, height) = (w.min(SHOWN[0]), h.min(SHOWN[1]));
    let (x0, y0) = ((w - width) / 2, (h - height) / 2);
    let frame = Encoded(sample.frame.0.crop(x0, y0, width, height));
    let same = |size: (usize, usize)| size == (w, h);
    let depth = sample.inverse_depth.as_ref().filter(|d| same(d.size()));
    let flow = sample.flow.as_ref().filter(|f| same(f.size()));
    let depth = depth.map(|d| d.crop(x0, y0, width, height));
    let flow = flow.map(|f| f.crop(x0, y0, width, height));

    let mut model = model.scaled_to(w, h);
    // The part keeps the frame's px.
    (model.capture.width, model.capture.height) = (width, height);
    if let Estimate::Known(lens) = &mut model.defocus {
        // The sample's depth is in the model's own unit, whichever that is.
        lens.depth_kind = DepthKind::Metric;
    }
    let balls = Balls::new(width, height);
    let around = |x: usize, y: usize| balls.are_near(x, y);
    // The balls stand where the scene behind them stands, and move along with it.
    let at = depth.as_ref().and_then(|d| median(d, around, |d| d)).filter(|d| *d > 0.0);
    let along = flow
        .as_ref()
        .and_then(|f| Some([median(f, around, |f: [f32; 2]| f[0])?, median(f, around, |f: [f32; 2]| f[1])?]));
    let light = frame.to_linear(model.transfer);
    // Noise is no part of the light that falls on the balls.
    let calm = Linear(filter::gaussian_blur(&light.0, 3.0));
    let layer = VirtualLayer {
        color: balls.shaded(&calm),
        inverse_depth: at.map(|d| Plane::filled(width, height, d)),
        flow: along.map(|f| Flow::filled(width, height, f)),
    };
    let shadowed = balls.shadowed(&calm);
    let plate = Plate {
        // Nothing stands before the balls.
        flow: flow.as_ref(),
        with_and_without: Some((&shadowed, &calm)),
        ..Plate::new(&frame, sample.number)
    };
    let made = |naive: bool| {
        composite(&plate, &layer, &model, &CompositeOptions { naive, ..CompositeOptions::default() })
    };
    let left_out = [
        (Distortion::Defocus, layer.inverse_depth.is_none()),
        (Distortion::MotionBlur, layer.flow.is_none()),
        (Distortion::Noise, false),
    ]
    .into_iter()
    .filter(|(distortion, lacks)| *lacks || model.why_unknown(*distortion).is_some())
    .map(|(distortion, _)| distortion.name())
    .collect();
    Ok(Some(BeforeAfter { number: sample.number, pasted: made(true)?, matched: made(false)?, left_out }))
}

/// The median of finite values of a raster where `within` holds.
fn median<T: Copy>(
    raster: &Raster<T>,
    within: impl Fn(usize, usize) -> bool,
    value: impl Fn(T) -> f32,
) -> Option<f32> {
    let (w, h) = raster.size();
    let places = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| within(x, y));
    let mut values: Vec<f32> =
        places.map(|(x, y)| value(raster.data()[y * w + x])).filter(|v| v.is_finite()).collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Two balls side by side in a picture of this size.
struct Balls {
    size: (usize, usize),
    radius: f32,
    /// The middles of the grey ball and of the mirror.
    middles: [[f32; 2]; 2],
}

impl Balls {
    fn new(width: usize, height: usize) -> Self {
        let radius = (RADIUS * height as f32).min(0.18 * width as f32);
        let (x, y) = (0.5 * width as f32, MIDDLE * height as f32);
        Self { size: (width, height), radius, middles: [[x - 1.25 * radius, y], [x + 1.25 * radius, y]] }
    }

    /// Whether a pixel lies on a ball.
    fn are_near(&self, x: usize, y: usize) -> bool {
        self.middles.iter().any(|m| (x as f32 - m[0]).hypot(y as f32 - m[1]) < self.radius)
    }

    /// The balls' premultiplied light under the light of this picture.
    fn shaded(&self, light: &Linear) -> Premultiplied {
        const SUB: usize = 4;
        let lamps = Lamps::of(light);
        let (w, h) = self.size;
        Premultiplied(Raster::from_fn(w, h, |x, y| {
            let mut sum = [0.0f32; 4];
            for i in 0..SUB * SUB {
                let at = [x, y].map(|v| v as f32 - 0.5);
                let at = [
                    at[0] + ((i % SUB) as f32 + 0.5) / SUB as f32,
                    at[1] + ((i / SUB) as f32 + 0.5) / SUB as f32,
                ];
                for (ball, middle) in self.middles.iter().enumerate() {
                    let n = [0, 1].map(|c| (at[c] - middle[c]) / self.radius);
                    let square = n[0] * n[0] + n[1] * n[1];
                    if square >= 1.0 {
                        continue;
                    }
                    // The normal's third component points at the camera.
                    let normal = [n[0], n[1], (1.0 - square).sqrt()];
                    let colour = if ball == 0 { lamps.on_grey(normal) } else { mirrored(light, normal) };
                    (0..3).for_each(|c| sum[c] += colour[c]);
                    sum[3] += 1.0;
                }
            }
            sum.map(|v| v / (SUB * SUB) as f32)
        }))
    }

    /// The picture with the shadows that the balls cast on what they stand on.
    fn shadowed(&self, light: &Linear) -> Linear {
        let (w, h) = self.size;
        Linear(Raster::from_fn(w, h, |x, y| {
            let lit = self.middles.iter().map(|m| {
                let dx = (x as f32 - m[0]) / (1.0 * self.radius);
                let dy = (y as f32 - m[1] - 0.97 * self.radius) / (0.28 * self.radius);
                1.0 - 0.7 * (-(dx * dx + dy * dy)).exp()
            });
            let lit: f32 = lit.product();
            // Far from the balls the picture is exactly the same.
            light.0.at(x, y).map(|v| if lit > 0.998 { v } else { v * lit })
        }))
    }
}

/// The light from above, from below and from where the picture is brightest, as a white surface would return it.
struct Lamps {
    above: [f32; 3],
    below: [f32; 3],
    key: [f32; 3],
    /// The direction of the brightest light, a unit vector.
    towards: [f32; 3],
}

impl Lamps {
    fn of(light: &Linear) -> Self {
        let (w, h) = light.0.size();
        let mean = |rows: std::ops::Range<usize>| {
            let mut sum = [0.0f64; 3];
            let pixels = &light.0.data()[rows.start * w..rows.end * w];
            for p in pixels {
                (0..3).for_each(|c| sum[c] += f64::from(p[c]));
            }
            sum.map(|v| (v / pixels.len().max(1) as f64) as f32)
        };
        let (above, below) = (mean(0..h.div_ceil(3)), mean(h - h.div_ceil(3)..h));
        // The brightest column of the upper half is taken for the side of the key light.
        let column = |x: usize| (0..h / 2).map(|y| luma(light.0.at(x, y))).sum::<f32>();
        let brightest = (0..w).max_by(|&a, &b| column(a).total_cmp(&column(b))).unwrap_or(w / 2);
        let side = (2.0 * brightest as f32 / w as f32 - 1.0) * 0.8;
        let length = (side * side + 0.64 + 0.36f32).sqrt();
        // What a scene returns is a fifth or so of what falls on it.
        let white = |v: [f32; 3]| v.map(|v| v / GREY);
        let key = [0, 1, 2].map(|c| 0.5 * (above[c] + below[c]));
        Self {
            above: white(above),
            below: white(below),
            key: white(key),
            towards: [side / length, -0.8 / length, 0.6 / length],
        }
    }

    fn on_grey(&self, n: [f32; 3]) -> [f32; 3] {
        let up = 0.5 - 0.5 * n[1];
        let facing = (0..3).map(|c| n[c] * self.towards[c]).sum::<f32>().max(0.0);
        // Less light reaches what faces the ground.
        let open = 0.35 + 0.65 * up;
        [0, 1, 2].map(|c| {
            let around = open * (up * self.above[c] + (1.0 - up) * self.below[c]);
            GREY * (0.6 * around + 0.9 * facing * self.key[c])
        })
    }
}

/// What a mirror with this normal shows: the picture stands for the scene behind the camera too, which nobody filmed.
fn mirrored(light: &Linear, n: [f32; 3]) -> [f32; 3] {
    let (w, h) = light.0.size();
    // The view goes along -z; its reflection is 2 n_z n - z.
    let [x, y] = [2.0 * n[2] * n[0], 2.0 * n[2] * n[1]];
    let at = |v: f32, size: usize| (0.5 + 0.5 * v) * (size - 1) as f32;
    light.0.bilinear(at(-x, w), at(y, h)).map(|v| MIRROR * v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Capture, ExposureFraction, MotionBlurModel};

    fn sample(w: usize, h: usize) -> Sample {
        Sample {
            number: 1,
            frame: Encoded(Raster::from_fn(w, h, |x, y| [((x / 7 + y / 5) % 5) as f32 / 6.0 + 0.1; 3])),
            next: None,
            flow: Some(Flow::filled(w, h, [12.0, 0.0])),
            inverse_depth: Some(Plane::filled(w, h, 0.5)),
            clean: None,
        }
    }

    fn camera(w: usize, h: usize) -> CameraModel {
        let capture = Capture { width: w, height: h, fps: None, frames_used: 5, pixel_aspect: 1.0 };
        CameraModel::unknown(capture, "not looked at")
    }

    /// How strongly neighbouring pixels of a row differ on the balls.
    fn edges(image: &Encoded) -> f32 {
        let (w, h) = image.0.size();
        let row = image.0.row((MIDDLE * h as f32) as usize);
        (1..w).map(|x| (row[x][1] - row[x - 1][1]).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn the_camera_blurs_the_balls_and_leaves_the_rest_of_the_frame() {
        let (w, h) = (200, 150);
        let mut moving = camera(w, h);
        moving.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.7)));
        let made = before_after(&sample(w, h), &moving).unwrap().unwrap();
        assert_eq!(made.left_out, ["defocus", "noise"]);
        assert_ne!(made.pasted, made.matched);
        assert_eq!(made.pasted.0.row(1), sample(w, h).frame.0.row(1));
        assert_eq!(made.matched.0.row(1), sample(w, h).frame.0.row(1));
        // Edges of the balls against a plain frame are softer where the camera moves.
        let plain = |model: &CameraModel| {
            let frame = Encoded(Raster::filled(w, h, [0.2; 3]));
            before_after(&Sample { frame, ..sample(w, h) }, model).unwrap().unwrap()
        };
        let soft = plain(&moving);
        assert!(
            edges(&soft.matched) < 0.6 * edges(&soft.pasted),
            "{} {}",
            edges(&soft.matched),
            edges(&soft.pasted)
        );
        // Negative control: a camera of which nothing is known pastes.
        let nothing = plain(&camera(w, h));
        assert_eq!(nothing.pasted, nothing.matched);
        assert_eq!(nothing.left_out.len(), 3);
    }

    #[test]
    fn small_frames_and_odd_ones_have_no_balls_or_give_them() {
        assert!(before_after(&sample(40, 300), &camera(40, 300)).unwrap().is_none());
        let mut odd = sample(300, 200);
        odd.flow = Some(Flow::filled(300, 200, [f32::NAN; 2]));
        odd.inverse_depth = Some(Plane::filled(300, 200, f32::NAN));
        assert!(before_after(&odd, &camera(300, 200)).unwrap().is_some());
        odd.frame.0.data_mut()[7] = [f32::NAN; 3];
        assert!(before_after(&odd, &camera(300, 200)).unwrap().is_none());
    }
}
