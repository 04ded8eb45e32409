//! The estimated camera as settings of other tools, with one module per target.
//!
//! A [`Camera`] is the model together with the picture's size, the field of view and depths in metres. Each target turns the camera
//! into the tool's settings, computes the blur in px that they give, and names what the tool cannot do; [`Target::export`] makes
//! the files that a user of the tool loads.
//!
//! Facts common to all targets:
//! - A uniform disk of diameter c has a std of c / 4 along each axis; one of radius R has R / 2.
//! - The blur of every physical lens is `sigma(Z) = sigma_inf |1 - P / Z|`: affine in inverse depth, with one slope on both sides
//!   of the focus distance P. A model of another shape is fitted by that curve, and the remaining difference is reported.
//! - A lens of focal length f (m) and f-number N before a sensor of height h (m), on a picture H px high, has at infinity a circle
//!   of confusion of diameter `f^2 H / (N h (P - f))` px.
//! - Where a tool has grain it scales a texture by a response over luminance: [`grain`].

pub mod av1_grain;
pub mod bevy;
pub mod blender;
pub mod filament;
pub mod godot;
pub mod grain;
pub mod nuke;
pub mod texture;
pub mod three;
mod unity;
pub mod unity_hdrp;
pub mod unity_urp;
pub mod unreal;

use crate::model::{
    Aperture, BlurSpace, Bokeh, DefocusCurve, DefocusModel, DepthKind, Distortion, Estimate,
    ExposureFraction, NoiseModel,
};
use crate::{CameraModel, Error, Raster, Result, Transfer, text};
use std::fmt;

/// The properties of a tool's pictures that the model does not hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct View {
    /// Width and height of the pictures that the tool makes, px; `None`: the capture's.
    pub size: Option<(usize, usize)>,
    /// Vertical field of view of the tool's camera, degrees, from 1 to 170; `None`: that of the tool where it can be asked, else
    /// [`USUAL_FOV_Y_DEGREES`].
    pub fov_y_degrees: Option<f32>,
}

/// The vertical field of view, degrees, of cameras whose own is unknown: about that of a phone's main camera or of 33 mm on full frame.
pub const USUAL_FOV_Y_DEGREES: f32 = 40.0;

/// A lens whose blur has the std `sigma_px_at_infinity |1 - focus_m / Z|`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinLens {
    /// Std of the blur at infinity, px of the tool's picture.
    pub sigma_px_at_infinity: f32,
    /// The distance that is in focus, m.
    pub focus_m: f32,
}

impl ThinLens {
    /// The std of the blur at a depth in m, px.
    pub fn sigma_px(&self, depth_m: f32) -> f32 {
        self.sigma_px_at_infinity * (1.0 - self.focus_m / depth_m).abs()
    }

    /// The f-number of a lens of this focal length before a sensor of this height, on a picture `height_px` high.
    pub fn f_number(&self, focal_length_m: f32, sensor_height_m: f32, height_px: usize) -> f32 {
        let beyond_focal_point = (self.focus_m - focal_length_m).max(1e-3);
        focal_length_m.powi(2) * height_px as f32
            / (4.0 * self.sigma_px_at_infinity * sensor_height_m * beyond_focal_point)
    }

    /// The lens nearest to a defocus model over metric inverse depth, in least squares over the depths on which the model was fitted.
    fn nearest(model: &DefocusModel) -> Self {
        // The largest focus distance, m: farther away, blur hardly changes, and engines' numbers end.
        const FARTHEST: f32 = 1e4;
        match model.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. } => {
                let slope = sigma_px_at_infinity / focus_inverse_depth;
                Self::from_slope(slope, focus_inverse_depth.max(FARTHEST.recip()))
            }
            DefocusCurve::Quadratic { inverse_depth_range: [lo, hi], .. } => {
                let seen: Vec<f32> = (0..64).map(|i| lo + (hi - lo) * (i as f32 + 0.5) / 64.0).collect();
                let fit = |focus: f32| {
                    let [mut wanted, mut squares] = [0.0; 2];
                    for d in &seen {
                        wanted += model.sigma_px(*d) * (focus - d).abs();
                        squares += (focus - d).powi(2);
                    }
                    let slope = if squares > 0.0 { wanted / squares } else { 0.0 };
                    let loss: f32 =
                        seen.iter().map(|d| (model.sigma_px(*d) - slope * (focus - d).abs()).powi(2)).sum();
                    (slope, loss)
                };
                // The focus may lie outside the observed range of inverse depth, by up to the range's length on both sides.
                let (from, to) = ((2.0 * lo - hi).max(FARTHEST.recip()), (2.0 * hi - lo).max(2.0 / FARTHEST));
                let candidates = (0..=2000).map(|i| from + (to - from) * i as f32 / 2000.0);
                let best = candidates.min_by(|a, b| fit(*a).1.total_cmp(&fit(*b).1)).unwrap_or(from);
                Self::from_slope(fit(best).0, best)
            }
        }
    }

    fn from_slope(px_per_inverse_m: f32, focus_inverse_m: f32) -> Self {
        Self { sigma_px_at_infinity: px_per_inverse_m * focus_inverse_m, focus_m: focus_inverse_m.recip() }
    }
}

/// The blur std, px, below which a lens counts as sharp, and below which a difference of blur is not reported.
const SHARP_PX: f32 = 0.05;

/// A camera model made ready for a tool: sizes in px of its pictures, depths in metres, unknown parts named.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width of the tool's pictures, px.
    pub width: usize,
    /// Height of the tool's pictures, px.
    pub height: usize,
    /// Vertical field of view, degrees, if it was given.
    pub fov_y_degrees: Option<f32>,
    /// The exposure, if it is known.
    pub exposure: Option<ExposureFraction>,
    /// The middle of the exposure after the frame's time, in frame intervals; 0 if it is unknown or centred. Of all tools, only Blender takes it.
    pub shutter_centre: f32,
    /// The lens, if it is known and not sharp throughout.
    pub lens: Option<ThinLens>,
    /// The defocus model that `lens` approximates, in px of the tool's pictures.
    pub defocus: Option<DefocusModel>,
    /// The shape of out-of-focus points.
    pub aperture: Aperture,
    /// The noise, if it is known.
    pub noise: Option<NoiseModel>,
    /// The curve of the encoded values that noise is added to.
    pub transfer: Transfer,
    /// Notes on what is left at the tool's default or not exported, and why; a sentence each, without a full stop.
    pub left: Vec<String>,
}

/// The name that tools give to a distortion.
fn effect(distortion: Distortion) -> &'static str {
    match distortion {
        Distortion::Defocus => "depth of field",
        _ => distortion.name(),
    }
}

impl Camera {
    /// The model for pictures of this size and field of view.
    ///
    /// A defocus in relative inverse depth is left out: convert it to metres first, with [`DefocusModel::to_metric`].
    ///
    /// # Errors
    /// If the field of view or the size is out of its range.
    pub fn new(model: &CameraModel, view: &View) -> Result<Self> {
        let (width, height) = view.size.unwrap_or((model.capture.width, model.capture.height));
        if width == 0 || height == 0 {
            return Err(Error::new("the picture's size must be at least 1 x 1 px"));
        }
        if view.fov_y_degrees.is_some_and(|fov| !(1.0..=170.0).contains(&fov)) {
            return Err(Error::new("the vertical field of view must lie between 1 and 170 degrees"));
        }
        let model = model.scaled_to(width, height);
        let mut left = vec![];
        for distortion in Distortion::ALL {
            let exported = match distortion {
                Distortion::Defocus | Distortion::MotionBlur | Distortion::Noise => true,
                // No tool sharpens as cameras do.
                _ => false,
            };
            match (model.why_unknown(distortion), model.parameters(distortion).first()) {
                (Some(why), _) if exported => {
                    let effect = effect(distortion);
                    left.push(format!("{effect} is left at the tool's default, since it is unknown: {why}"));
                }
                (None, Some(p)) if !exported => left.push(format!(
                    "the camera's own {} ({} {:.2}{}) is not exported",
                    distortion.name(),
                    p.name,
                    p.value,
                    p.unit_after_value(),
                )),
                _ => {}
            }
        }
        let mut defocus = model.defocus.known().copied();
        if defocus.is_some_and(|d| d.depth_kind == DepthKind::Relative) {
            defocus = None;
            left.push(
                "depth of field is left at the tool's default: it is known in relative inverse depth only; say how that relates to \
                 metres, which is the scene's scale"
                    .into(),
            );
        }
        let mut lens = defocus.as_ref().map(ThinLens::nearest);
        if let (Some(l), Some(d)) = (lens, defocus) {
            // A lens focused far away is sharp at infinity but not near by, so that all compared depths must be sharp.
            if probes(l.focus_m).all(|z| l.sigma_px(z) < SHARP_PX && d.sigma_px(z.recip()) < SHARP_PX) {
                left.push("depth of field is off: this lens is sharp throughout".into());
                lens = None;
            }
        }
        let aperture = defocus.filter(|_| lens.is_some()).map_or_else(Aperture::default, |d| d.bokeh);
        let square = model.capture.pixel_aspect == 1.0;
        if !square && lens.is_some() {
            left.push(format!(
                "pixels are taken to be square, though they are {} times as wide as high: blur is exported as it is down the picture",
                short(model.capture.pixel_aspect)
            ));
        }
        if model.blur_space == BlurSpace::Encoded {
            left.push(
                "blur was fitted in encoded values; in linear light, as tools blur, highlights come out brighter"
                    .into(),
            );
        }
        Ok(Self {
            width,
            height,
            fov_y_degrees: view.fov_y_degrees,
            exposure: model.motion_blur.known().map(|m| m.exposure),
            shutter_centre: model.motion_blur.known().map_or(0.0, |m| m.shutter().centre),
            lens,
            defocus: defocus.filter(|_| lens.is_some()),
            aperture,
            // Tools know the lines alone, which must be those of the noise that composites have.
            noise: match model.noise.map(NoiseModel::with_agreeing_lines) {
                // Tools add noise to values that are encoded as sRGB.
                Estimate::Known(noise) if model.transfer != Transfer::Srgb => {
                    left.push(format!(
                        "the noise was found over {} values; its std over sRGB is exported, by lines over luminance, without what channels \
                         and frames share",
                        model.transfer.name()
                    ));
                    Some(NoiseModel::Lines(noise.recoded(model.transfer, Transfer::Srgb)))
                }
                // Tools' values end at 1, whatever the footage's do.
                Estimate::Known(mut noise) => {
                    noise.lines_mut().clip = noise.clip().min(1.0);
                    Some(noise)
                }
                Estimate::Unknown(_) => None,
            },
            transfer: Transfer::Srgb,
            left,
        })
    }

    /// The same, with a note on what a tool cannot be told of the shape of out-of-focus points.
    fn with_shape_note(&self, tool: Shapes) -> Self {
        let mut camera = self.clone();
        camera.left.extend(tool.lost(&self.aperture));
        camera
    }

    /// The blades that a tool can be told: their number, their roundness and their rotation, degrees.
    fn blades(&self, tool: Shapes) -> Option<(u8, f32, f32)> {
        match self.aperture.bokeh {
            Bokeh::Polygon { blades, roundness, rotation_degrees } if tool.takes(blades) => {
                Some((blades, roundness, rotation_degrees))
            }
            _ => None,
        }
    }

    /// Focal length over sensor height, from the field of view.
    pub fn focal_length_per_sensor_height(&self) -> f32 {
        let fov = self.fov_y_degrees.unwrap_or(USUAL_FOV_Y_DEGREES);
        0.5 / (0.5 * fov.to_radians()).tan()
    }

    /// A note that names the pictures and the field of view for which the blur is computed.
    fn for_this_view(&self) -> String {
        let fov = match self.fov_y_degrees {
            Some(fov) => format!("{} degrees", short(fov)),
            None => {
                format!("{} degrees, which is assumed, since nothing says it", short(USUAL_FOV_Y_DEGREES))
            }
        };
        format!(
            "the blur is for pictures {} x {} px and a vertical field of view of {fov}",
            self.width, self.height
        )
    }

    /// A note on the difference of a tool's blur, `sigma_px` of a depth in m, from the model's; `None` if it is at most [`SHARP_PX`].
    fn blur_lost(&self, sigma_px: impl Fn(f32) -> f32) -> Option<String> {
        let (defocus, lens) = (self.defocus?, self.lens?);
        let error = |z: f32| sigma_px(z) - defocus.sigma_px(z.recip());
        let worst = probes(lens.focus_m).max_by(|a, b| error(*a).abs().total_cmp(&error(*b).abs()))?;
        let mean = probes(lens.focus_m).map(|z| error(z).abs()).sum::<f32>() / PROBES as f32;
        (error(worst).abs() > SHARP_PX).then(|| {
            format!(
                "blur differs from the model's by {mean:.2} px on average over {PROBES} depths, most at {} m ({:.2} instead of {:.2} px)",
                short(worst),
                sigma_px(worst),
                defocus.sigma_px(worst.recip()),
            )
        })
    }
}

/// What a tool can be told of the shape of out-of-focus points, which are disks without it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shapes {
    /// The fewest and the most blades of a polygon; `None`: there are disks alone.
    pub blades: Option<[u8; 2]>,
    /// Whether blades may be curved.
    pub roundness: bool,
    /// Whether a polygon may be turned.
    pub rotation: bool,
    /// Whether the shape may be stretched.
    pub squeeze: bool,
}

impl fmt::Display for Shapes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some([fewest, most]) = self.blades else { return f.write_str("the tool's own") };
        write!(f, "{fewest} to {most} blades")?;
        let parts = [("roundness", self.roundness), ("rotation", self.rotation), ("squeeze", self.squeeze)];
        parts.iter().filter(|part| part.1).try_for_each(|(name, _)| write!(f, ", {name}"))
    }
}

impl Shapes {
    /// Disks alone.
    pub const DISKS: Self = Self { blades: None, roundness: false, rotation: false, squeeze: false };

    fn takes(&self, blades: u8) -> bool {
        self.blades.is_some_and(|[fewest, most]| (fewest..=most).contains(&blades))
    }

    /// A note on what the tool is not told of a shape.
    fn lost(&self, aperture: &Aperture) -> Option<String> {
        let mut lost = vec![];
        if let Bokeh::Polygon { blades, roundness, .. } = aperture.bokeh {
            match self.takes(blades) {
                false => lost.push("the blades"),
                true => {
                    lost.extend((!self.roundness && roundness > 0.0).then_some("how round the blades are"));
                    lost.extend((!self.rotation).then_some("how they are turned"));
                }
            }
        }
        lost.extend((!self.squeeze && aperture.squeeze != 1.0).then_some("the stretch"));
        lost.extend((aperture.cats_eye > 0.0).then_some("the cut towards the edges"));
        (!lost.is_empty()).then(|| {
            format!(
                "out-of-focus points are {} in the model; the tool is not told {}, and the second moment is kept",
                aperture.words(),
                lost.join(", ")
            )
        })
    }
}

/// The std of a regular polygon over that of a disk of the same radius through its corners. `inward` says how far the middle of a blade lies
/// towards the centre as URP and HDRP have it: the radius is `(cos(pi / n) / cos(angle))^inward`, so that 1 is a straight blade, 0 a disk.
fn polygon_std(blades: u8, inward: f32) -> f32 {
    const STEPS: usize = 256;
    let half = std::f32::consts::PI / f32::from(blades);
    let [mut second, mut area] = [0.0f32; 2];
    for i in 0..STEPS {
        let angle = half * (2.0 * (i as f32 + 0.5) / STEPS as f32 - 1.0);
        let radius = (half.cos() / angle.cos()).powf(inward);
        second += radius.powi(4);
        area += radius.powi(2);
    }
    (second / area).sqrt()
}

/// The exponent of [`polygon_std`] for blades of this roundness: the middle of a blade lies where the arc's does.
fn inward(blades: u8, roundness: f32) -> f32 {
    let half = std::f32::consts::PI / f32::from(blades);
    // An arc of the radius 1 / roundness through both corners.
    let bulge = match roundness > 1e-3 {
        true => (1.0 - (1.0 - (half.sin() * roundness).powi(2)).max(0.0).sqrt()) / roundness,
        false => 0.0,
    };
    ((half.cos() + bulge).min(1.0).ln() / half.cos().ln()).clamp(0.0, 1.0)
}

/// The number of depths at which blurs are compared.
pub const PROBES: usize = 20;

/// Depths in m from about half the focus distance to 20 times the focus distance, evenly spaced in inverse depth.
pub fn probes(focus_m: f32) -> impl Iterator<Item = f32> {
    (0..PROBES).map(move |i| focus_m * PROBES as f32 / (2.0 * (i as f32 + 0.5)))
}

/// A file that a target writes.
#[derive(Clone, Debug, PartialEq)]
pub struct File {
    /// The file's name, by which other files refer to it.
    pub name: String,
    /// The file's content.
    pub content: Content,
}

impl File {
    fn text(name: &str, text: String) -> Self {
        Self { name: name.into(), content: Content::Text(text) }
    }

    fn texture(name: &str, texture: Raster<[f32; 4]>) -> Self {
        Self { name: name.into(), content: Content::Texture(texture) }
    }
}

/// The content of a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// A text in UTF-8.
    Text(String),
    /// Data in [0, 1], not colours: to be stored and read without any colour space, alpha not premultiplied.
    Texture(Raster<[f32; 4]>),
}

/// A camera as settings of a tool.
#[derive(Clone, Debug, PartialEq)]
pub struct Export {
    /// The files; a user loads or pastes the first one, which refers to the others.
    pub files: Vec<File>,
    /// Notes on what the tool cannot do and what is left at its default; a sentence each, without a full stop.
    pub lost: Vec<String>,
}

/// The abilities and limits of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Abilities {
    /// The tool and the versions that this was written for.
    pub tool: &'static str,
    /// The accuracy and the limits of the exported exposure.
    pub motion_blur: &'static str,
    /// The accuracy and the limits of the exported lens.
    pub defocus: &'static str,
    /// The shapes of out-of-focus points that are exported.
    pub bokeh: Shapes,
    /// The form and the limits of the exported noise.
    pub grain: &'static str,
    /// The source of the formulas, and the checks that were made.
    pub checked: &'static str,
}

macro_rules! targets {
    ($($variant:ident $name:literal $module:ident)*) => {
        /// The tools that a camera can be exported to.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Target { $(#[doc = $name] $variant,)* }

        impl Target {
            /// All targets.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// The name on the command line.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// The abilities and limits of this target.
            pub fn abilities(self) -> &'static Abilities {
                match self { $(Self::$variant => &$module::ABILITIES),* }
            }

            /// The camera as settings of this tool.
            pub fn export(self, camera: &Camera) -> Export {
                let mut camera = camera.with_shape_note(self.abilities().bokeh);
                if camera.shutter_centre != 0.0 && self != Self::Blender {
                    camera.left.push(
                        "the shutter's phase is not exported: the exposure is centred on the frame's time, or as the tool has it"
                            .into(),
                    );
                }
                match self { $(Self::$variant => $module::export(&camera)),* }
            }
        }
    };
}

targets! {
    UnityUrp "unity-urp" unity_urp
    UnityHdrp "unity-hdrp" unity_hdrp
    Unreal "unreal" unreal
    Godot "godot" godot
    Bevy "bevy" bevy
    Blender "blender" blender
    Three "three" three
    Filament "filament" filament
    Nuke "nuke" nuke
    Av1Grain "av1-grain" av1_grain
    Texture "texture" texture
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The number with six significant digits and always a point or an exponent, which makes it a float in every exported language.
fn number(v: f32) -> String {
    let rounded: f32 = format!("{v:.5e}").parse().unwrap_or(v);
    format!("{rounded:?}")
}

/// The number with three significant digits, for sentences.
fn short(v: f32) -> String {
    let rounded: f32 = format!("{v:.2e}").parse().unwrap_or(v);
    format!("{rounded}")
}

/// The [`number`]s with commas between them.
fn numbers(values: &[f32]) -> String {
    values.iter().map(|v| number(*v)).collect::<Vec<_>>().join(", ")
}

/// A template with each `@name@` replaced by its value.
fn filled(template: &str, values: &[(&str, String)]) -> String {
    values
        .iter()
        .fold(template.into(), |text: String, (name, value)| text.replace(&format!("@{name}@"), value))
}

/// The comment lines at the head of a file: its origin, and the notes on what was lost.
fn head(marker: &str, what: &str, lost: &[String]) -> String {
    let mut head = comment(marker, &format!("{what}, written by blindaug export."));
    for sentence in lost {
        head += &comment(marker, &format!("Note: {sentence}."));
    }
    head
}

/// A comment of one line in a language whose comments go from `marker` to the end of the line. The sentence may quote a camera
/// file; whatever the file says stays inside the comment.
fn comment(marker: &str, sentence: &str) -> String {
    // In C and Tcl a backslash at the end of a line continues the comment on the next one.
    let sentence = text::one_line(sentence).replace('\\', "/");
    format!("{marker} {sentence}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Capture, MotionBlurModel};

    fn model(curve: DefocusCurve, kind: DepthKind) -> CameraModel {
        let capture = Capture { width: 960, height: 540, fps: Some(30.0), frames_used: 1, pixel_aspect: 1.0 };
        let mut model = CameraModel::unknown(capture, "nothing was filmed");
        model.defocus = Estimate::Known(DefocusModel::given(curve, kind));
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
        model
    }

    fn lens(sigma_px_at_infinity: f32, focus_inverse_depth: f32) -> DefocusCurve {
        DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, interval: None }
    }

    #[test]
    fn a_polygon_s_std_is_that_of_its_second_moment() {
        for blades in 3..=16 {
            let turn = 2.0 * std::f32::consts::PI / f32::from(blades);
            let want = ((2.0 + turn.cos()) / 3.0).sqrt();
            assert!((polygon_std(blades, 1.0) - want).abs() < 1e-3, "{blades}");
            assert!((polygon_std(blades, 0.0) - 1.0).abs() < 1e-6);
            assert!(inward(blades, 0.0) == 1.0 && inward(blades, 1.0) < 1e-3);
            assert!((0.2..0.8).contains(&inward(blades, 0.5)));
        }
    }

    #[test]
    fn a_thin_lens_is_kept_and_scales_with_the_picture() {
        let view = View { size: Some((1920, 1080)), ..View::default() };
        let camera = Camera::new(&model(lens(2.0, 0.25), DepthKind::Metric), &view).unwrap();
        let lens = camera.lens.unwrap();
        assert!((lens.sigma_px_at_infinity - 4.0).abs() < 1e-5 && (lens.focus_m - 4.0).abs() < 1e-5);
        assert_eq!(camera.blur_lost(|z| lens.sigma_px(z)), None);
        assert!(camera.blur_lost(|z| 2.0 * lens.sigma_px(z)).is_some());
    }

    #[test]
    fn a_bowl_is_fitted_over_the_depths_that_were_seen_and_the_rest_is_told() {
        let bowl = DefocusCurve::Quadratic { a: 9.0, b: -7.2, c: 1.44, inverse_depth_range: [0.1, 0.9] };
        let camera = Camera::new(&model(bowl, DepthKind::Metric), &View::default()).unwrap();
        let lens = camera.lens.unwrap();
        let focus = lens.focus_m.recip();
        assert!((focus - 0.4).abs() < 0.1, "{focus}");
        let lost = camera.blur_lost(|z| lens.sigma_px(z)).unwrap();
        assert!(lost.contains("px on average"), "{lost}");
        // No other lens is nearer.
        let loss = |slope: f32, focus: f32| -> f32 {
            let d = |i: i32| 0.1 + 0.8 * (i as f32 + 0.5) / 64.0;
            (0..64)
                .map(|i| (camera.defocus.unwrap().sigma_px(d(i)) - slope * (focus - d(i)).abs()).powi(2))
                .sum()
        };
        let slope = lens.sigma_px_at_infinity / focus;
        for (s, f) in [(1.02, 1.0), (0.98, 1.0), (1.0, 1.02), (1.0, 0.98)] {
            assert!(loss(slope * s, focus * f) > loss(slope, focus));
        }
    }

    #[test]
    fn what_is_unknown_relative_or_sharp_is_left_and_named() {
        let relative = Camera::new(&model(lens(2.0, 0.5), DepthKind::Relative), &View::default()).unwrap();
        assert!(relative.lens.is_none() && relative.left.iter().any(|s| s.contains("the scene's scale")));
        assert!(relative.left.iter().any(|s| s.contains("nothing was filmed")), "{:?}", relative.left);
        let sharp = Camera::new(&model(lens(0.01, 0.5), DepthKind::Metric), &View::default()).unwrap();
        assert!(sharp.lens.is_none() && sharp.left.iter().any(|s| s.contains("sharp")));
        // This lens is sharp at the compared depths, which begin at half of its focus distance of 10 km.
        let far = Camera::new(&model(lens(0.02, 0.0001), DepthKind::Metric), &View::default()).unwrap();
        assert!(far.lens.is_none());
        for (size, fov) in [(Some((0, 5)), 40.0), (None, 0.0), (None, f32::NAN), (None, 180.0)] {
            let view = View { size, fov_y_degrees: Some(fov) };
            assert!(Camera::new(&model(lens(2.0, 0.25), DepthKind::Metric), &view).is_err());
        }
    }

    #[test]
    fn every_target_takes_every_camera() {
        let mut models = vec![
            model(lens(3.0, 0.25), DepthKind::Metric),
            model(lens(1e-3, 1e-6), DepthKind::Metric),
            model(lens(400.0, 20.0), DepthKind::Metric),
        ];
        let capture = Capture { width: 1, height: 1, fps: None, frames_used: 0, pixel_aspect: 1.0 };
        models.push(CameraModel::unknown(capture, "it is empty"));
        models.push(models[0].scaled_to(1, 1));
        for model in &models {
            let camera = Camera::new(model, &View::default()).unwrap();
            for target in Target::ALL {
                let export = target.export(&camera);
                for file in &export.files {
                    if let Content::Text(text) = &file.content {
                        let marker = |piece: &str| {
                            !piece.is_empty() && piece.chars().all(|c| c.is_ascii_alphanumeric())
                        };
                        assert!(
                            !text.split('@').skip(1).step_by(2).any(marker),
                            "{target}: a marker is left in {text}"
                        );
                        assert!(!text.contains("NaN") && !text.contains("inf,"), "{target}: {text}");
                    }
                }
            }
        }
    }
}
