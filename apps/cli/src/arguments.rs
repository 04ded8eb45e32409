//! Arguments that several commands have, and the parsers of their values.

use blindaug::{
    composite::CompositeOptions,
    model::{BLADES, Bokeh, ExposureFraction, FRAME_RATES, KnownDistance},
};
use blindaug_pipeline::{
    ByHand,
    composite::{LayerDepth, LayerMotion},
};
use std::ops::RangeInclusive;

/// The options of applying a camera's distortions.
#[derive(clap::Args)]
pub struct Style {
    /// Leave the noise out
    #[arg(help_heading = "Look", long)]
    no_noise: bool,
    /// The seed of the noise: the same seed gives the same noise
    #[arg(help_heading = "Look", long, value_name = "N", default_value = "0")]
    seed: u64,
}

/// The parts of a camera that are set by hand.
#[derive(clap::Args)]
pub struct ByHandArgs {
    /// The shutter angle, degrees from 0 to 360, in place of the model's exposure
    #[arg(help_heading = "Set by hand", long, value_name = "DEGREES", value_parser = shutter_angle)]
    shutter: Option<f32>,
    /// When the shutter opens, degrees after the frame's time, -180 to 180; minus half the shutter angle is centred [default: centred]
    #[arg(help_heading = "Set by hand", long, value_name = "DEGREES", value_parser = shutter_phase, allow_hyphen_values = true)]
    shutter_phase: Option<f32>,
    /// The distance in focus, m, in place of the model's
    #[arg(help_heading = "Set by hand", long, value_name = "METRES", value_parser = positive)]
    focus: Option<f32>,
    /// The blur at infinity (std in px of the frames), 0 to 100, in place of the model's
    #[arg(help_heading = "Set by hand", long, value_name = "PX", value_parser = blur_std)]
    blur: Option<f32>,
    /// The shape of out-of-focus points: gaussian, disk, or polygon:N with N blades (3 to 16), their roundness (0 straight, 1 a disk) and the
    /// rotation in degrees, in place of the model's
    #[arg(help_heading = "Set by hand", long, value_name = "gaussian|disk|polygon:N[,ROUNDNESS[,ROTATION]]", value_parser = bokeh)]
    bokeh: Option<Bokeh>,
    /// How many times out-of-focus points are as high as wide, 0.25 to 4: 2 for an anamorphic lens of squeeze 2
    #[arg(help_heading = "Set by hand", long, value_name = "RATIO", value_parser = squeeze)]
    squeeze: Option<f32>,
    /// How much out-of-focus points are cut towards the picture's edges, 0 to 1
    #[arg(help_heading = "Set by hand", long, value_name = "STRENGTH", value_parser = share)]
    cats_eye: Option<f32>,
    /// The factor of the noise's std, 0 to 100, such as x1.2
    #[arg(help_heading = "Set by hand", long, value_name = "xN", value_parser = factor)]
    grain: Option<f32>,
}

impl ByHandArgs {
    /// The parts as they are applied to a camera.
    pub fn parts(&self) -> ByHand {
        ByHand {
            exposure: self.shutter.map(|degrees| ExposureFraction(degrees / 360.0)),
            phase_degrees: self.shutter_phase,
            focus_m: self.focus,
            blur_px: self.blur,
            bokeh: self.bokeh,
            squeeze: self.squeeze,
            cats_eye: self.cats_eye,
            grain: self.grain,
        }
    }
}

fn shutter_angle(text: &str) -> Result<f32, String> {
    within(text, ByHand::SHUTTER_DEGREES).map(|v| v as f32)
}

fn shutter_phase(text: &str) -> Result<f32, String> {
    within(text, ByHand::PHASE_DEGREES).map(|v| v as f32)
}

fn squeeze(text: &str) -> Result<f32, String> {
    within(text, ByHand::SQUEEZE).map(|v| v as f32)
}

fn share(text: &str) -> Result<f32, String> {
    within(text, ByHand::CATS_EYE).map(|v| v as f32)
}

/// Parses a shape of out-of-focus points.
///
/// # Errors
/// Says which forms there are.
pub fn bokeh(text: &str) -> Result<Bokeh, String> {
    match text.trim() {
        "gaussian" => return Ok(Bokeh::Gaussian),
        "disk" => return Ok(Bokeh::Disk),
        _ => {}
    }
    let form =
        || "give gaussian, disk, or polygon:N[,ROUNDNESS[,ROTATION]] such as polygon:6,0.2,15".to_owned();
    let numbers: Vec<&str> = text.trim().strip_prefix("polygon:").ok_or_else(form)?.split(',').collect();
    let blades = numbers[0].trim().parse().ok().filter(|n| BLADES.contains(n));
    let of = |i: usize, range: RangeInclusive<f64>| match numbers.get(i) {
        Some(text) => within(text, range).map(|v| v as f32),
        None => Ok(0.0),
    };
    let roundness = of(1, 0.0..=1.0).map_err(|e| format!("of the roundness, {e}"))?;
    let rotation_degrees = of(2, -360.0..=360.0).map_err(|e| format!("of the rotation, {e}"))?;
    match blades {
        Some(blades) if numbers.len() <= 3 => Ok(Bokeh::Polygon { blades, roundness, rotation_degrees }),
        None => Err("a polygon has 3 to 16 blades".into()),
        _ => Err(form()),
    }
}

fn blur_std(text: &str) -> Result<f32, String> {
    within(text, ByHand::BLUR_PX).map(|v| v as f32)
}

fn factor(text: &str) -> Result<f32, String> {
    within(text.trim().trim_start_matches(['x', 'X']), ByHand::GRAIN).map(|v| v as f32)
}

impl Style {
    /// The options as a composite takes them.
    pub fn options(&self) -> CompositeOptions {
        CompositeOptions {
            naive: false,
            no_noise: self.no_noise,
            bokeh: None,
            seed: self.seed,
            unclipped: false,
        }
    }
}

/// Parses a place in a picture: X,Y.
pub fn place(text: &str) -> Result<[f32; 2], String> {
    let number = |t: &str| t.trim().parse::<f32>().ok().filter(|v| v.is_finite() && *v >= 0.0);
    match text.split_once(',').map(|(x, y)| (number(x), number(y))) {
        Some((Some(x), Some(y))) => Ok([x, y]),
        _ => Err("give a place as X,Y in px from the top left".into()),
    }
}

/// Parses a place whose distance is known: X,Y=2.5m.
pub fn known_distance(text: &str) -> Result<KnownDistance, String> {
    let form = || "give a place and its distance as X,Y=METRES, such as 640,360=2.5m".to_owned();
    let (at, distance) = text.split_once('=').ok_or_else(form)?;
    let metres = positive(distance.trim().trim_end_matches('m')).map_err(|_| form())?;
    Ok(KnownDistance { place: place(at)?, metres })
}

/// Parses a depth of a layer: a distance in metres, or `plate`.
pub fn layer_depth(text: &str) -> Result<LayerDepth, String> {
    match text {
        "plate" => Ok(LayerDepth::OfFootage),
        metres => positive(metres.trim_end_matches('m'))
            .map(LayerDepth::Metres)
            .map_err(|_| "give a distance in metres, or plate".into()),
    }
}

/// Parses a motion of a layer: U,V in px per frame, or `plate`.
pub fn layer_motion(text: &str) -> Result<LayerMotion, String> {
    let number = |t: &str| t.trim().parse::<f32>().ok().filter(|v| v.is_finite());
    match (text, text.split_once(',').map(|(u, v)| (number(u), number(v)))) {
        ("plate", _) => Ok(LayerMotion::OfFootage),
        (_, Some((Some(u), Some(v)))) => Ok(LayerMotion::Px([u, v])),
        _ => Err("give the motion to the next frame as U,V in px, or plate".into()),
    }
}

/// Parses a number in a range.
pub fn within(text: &str, range: RangeInclusive<f64>) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if range.contains(&v) => Ok(v),
        _ => Err(format!("it must be a number from {} to {}", range.start(), range.end())),
    }
}

/// Parses a size of memory, to bytes.
pub fn memory_size(text: &str) -> Result<u64, String> {
    const RANGE: RangeInclusive<f64> = 64e6..=1000e9;
    let text = text.trim();
    let unit = match text.chars().last() {
        Some('M' | 'm') => 1e6,
        Some('G' | 'g') => 1e9,
        _ => f64::NAN,
    };
    let number = text.get(..text.len().saturating_sub(1)).and_then(|n| n.parse::<f64>().ok());
    match number.map(|n| n * unit) {
        Some(bytes) if RANGE.contains(&bytes) => Ok(bytes as u64),
        _ => Err("give a number with M or G (millions or billions of bytes), from 64M to 1000G".into()),
    }
}

/// Parses a number > 0.
pub fn positive(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("it must be a number greater than 0".into()),
    }
}

/// Parses a frame rate.
pub fn frame_rate(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if FRAME_RATES.contains(&v) => Ok(v),
        _ => Err("frames per second must be a number from 0.01 to 100000".into()),
    }
}

#[cfg(test)]
mod tests {
    use blindaug::model::Bokeh;

    #[test]
    fn shapes_of_points_are_parsed() {
        let polygon =
            |blades, roundness, rotation_degrees| Bokeh::Polygon { blades, roundness, rotation_degrees };
        for (text, shape) in [
            ("gaussian", Bokeh::Gaussian),
            ("disk", Bokeh::Disk),
            ("polygon:6", polygon(6, 0.0, 0.0)),
            ("polygon:9,0.5", polygon(9, 0.5, 0.0)),
            ("polygon:5, 0.25, -18", polygon(5, 0.25, -18.0)),
        ] {
            assert_eq!(super::bokeh(text), Ok(shape), "{text}");
        }
        for text in [
            "",
            "square",
            "polygon",
            "polygon:2",
            "polygon:17",
            "polygon:6,2",
            "polygon:6,0,x",
            "polygon:6,0,0,0",
        ] {
            assert!(super::bokeh(text).is_err(), "{text}");
        }
    }

    #[test]
    fn places_and_what_is_there_are_parsed() {
        use super::*;
        let known = KnownDistance { place: [640.0, 360.5], metres: 2.5 };
        assert_eq!(known_distance("640,360.5=2.5m"), Ok(known));
        assert_eq!(known_distance(" 640, 360.5 = 2.5"), Ok(known));
        for text in ["640,360", "640=2m", "640,360=-1m", "640,360=x", "-1,2=3m", ""] {
            assert!(known_distance(text).is_err(), "{text}");
        }
        assert_eq!(layer_depth("2.5m"), Ok(LayerDepth::Metres(2.5)));
        assert_eq!(layer_depth("plate"), Ok(LayerDepth::OfFootage));
        assert_eq!(layer_motion("-3,0.5"), Ok(LayerMotion::Px([-3.0, 0.5])));
        assert!(layer_depth("0").is_err() && layer_motion("3").is_err() && layer_motion("nan,1").is_err());
    }

    #[test]
    fn sizes_of_memory_are_parsed() {
        for (text, bytes) in
            [("4G", 4_000_000_000), ("1500M", 1_500_000_000), ("0.5g", 500_000_000), ("64m", 64_000_000)]
        {
            assert_eq!(super::memory_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "4", "4K", "4GB", "-4G", "63M", "1001G", "nanG", "infG", "4 é"] {
            assert!(super::memory_size(text).is_err(), "{text}");
        }
    }
}
