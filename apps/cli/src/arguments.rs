//! Arguments that several commands have, and the parsers of their values.

use blindaug::{composite::CompositeOptions, model::ExposureFraction, synth::defocus::Bokeh};
use blindaug_pipeline::ByHand;
use clap::ValueEnum;
use std::ops::RangeInclusive;

/// The options of applying a camera's distortions.
#[derive(clap::Args)]
pub struct Style {
    /// Leave the noise out
    #[arg(help_heading = "Look", long)]
    no_noise: bool,
    /// The shape of an out-of-focus point
    #[arg(help_heading = "Look", long, value_enum, default_value = "gaussian")]
    bokeh: BokehArg,
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
    /// The distance in focus, m, in place of the model's
    #[arg(help_heading = "Set by hand", long, value_name = "METRES", value_parser = positive)]
    focus: Option<f32>,
    /// The blur at infinity (std in px of the frames), 0 to 100, in place of the model's
    #[arg(help_heading = "Set by hand", long, value_name = "PX", value_parser = blur_std)]
    blur: Option<f32>,
    /// The factor of the noise's std, 0 to 100, such as x1.2
    #[arg(help_heading = "Set by hand", long, value_name = "xN", value_parser = factor)]
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
