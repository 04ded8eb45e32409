//! Arguments that several commands have, and the parsers of their values.

use blindaug::{
    composite::CompositeOptions,
    model::{ExposureFraction, KnownDistance},
    synth::defocus::Bokeh,
};
use blindaug_pipeline::{
    ByHand,
    composite::{LayerDepth, LayerMotion},
};
use clap::ValueEnum;
use std::ops::RangeInclusive;

/// The options of applying a camera's distortions.
#[derive(clap::Args)]
pub struct Style {
    /// Leave the noise out
    #[arg(long)]
    no_noise: bool,
    /// The shape of an out-of-focus point
    #[arg(long, value_enum, default_value = "gaussian")]
    bokeh: BokehArg,
    /// The seed of the noise: the same seed gives the same noise
    #[arg(long, value_name = "N", default_value = "0")]
    seed: u64,
}

/// The parts of a camera that are set by hand.
#[derive(clap::Args)]
pub struct ByHandArgs {
    /// The shutter angle, degrees from 0 to 360, in place of the model's exposure
    #[arg(long, value_name = "DEGREES", value_parser = shutter_angle)]
    shutter: Option<f32>,
    /// The distance in focus, m, in place of the model's
    #[arg(long, value_name = "METRES", value_parser = positive)]
    focus: Option<f32>,
    /// The blur at infinity (std in px of the frames), 0 to 100, in place of the model's
    #[arg(long, value_name = "PX", value_parser = blur_std)]
    blur: Option<f32>,
    /// The factor of the noise's std, 0 to 100, such as x1.2
    #[arg(long, value_name = "xN", value_parser = factor)]
    grain: Option<f32>,
}

impl ByHandArgs {
    /// The parts as they are applied to a camera.
    pub fn parts(&self) -> ByHand {
        ByHand {
            exposure: self.shutter.map(|degrees| ExposureFraction(degrees / 360.0)),
            focus_m: self.focus,
            blur_px: self.blur,
            grain: self.grain,
        }
    }
}

fn shutter_angle(text: &str) -> Result<f32, String> {
    within(text, 0.0..=360.0).map(|v| v as f32)
}

fn blur_std(text: &str) -> Result<f32, String> {
    within(text, 0.0..=100.0).map(|v| v as f32)
}

fn factor(text: &str) -> Result<f32, String> {
    within(text.trim().trim_start_matches(['x', 'X']), 0.0..=100.0).map(|v| v as f32)
}

#[derive(Clone, Copy, ValueEnum)]
enum BokehArg {
    Gaussian,
    Disk,
}

impl Style {
    /// The options as a composite takes them.
    pub fn options(&self) -> CompositeOptions {
        CompositeOptions {
            naive: false,
            no_noise: self.no_noise,
            bokeh: match self.bokeh {
                BokehArg::Gaussian => Bokeh::Gaussian,
                BokehArg::Disk => Bokeh::Disk,
            },
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
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("frames per second must be a number greater than 0".into()),
    }
}

#[cfg(test)]
mod tests {
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
