//! The frames that a command reads, and what is said of them.

use crate::console::{Result, note};
use blindaug::colour_space::{ColourSpace, doubts};
use blindaug_io::{FrameRange, FrameSource, IccProfile};
use std::path::Path;

/// What is said of the frames of an input.
#[derive(clap::Args)]
pub struct SourceArgs {
    /// Use only these frames, by number, both ends included
    #[arg(help_heading = "Frames", long, value_name = "FIRST..LAST")]
    pub frames: Option<FrameRange>,
    /// The number of the input's first frame, from which the others are counted on [default: the number in its name; 1 of a video]
    #[arg(help_heading = "Frames", long, value_name = "N")]
    first: Option<u64>,
    /// The colour space of the input: srgb, rec709, linear-srgb, acescg, aces2065-1, s-log3, s-log3-cine, logc3, logc4, v-log, log3g10,
    /// canon-log3, pq, hlg, display-p3, adobe-rgb, prophoto or an ICC profile's file [default: what the file says; else linear-srgb for EXR,
    /// srgb for all other files]
    #[arg(help_heading = "Frames", long, value_name = "SPACE", value_parser = colour_space)]
    colour_space: Option<ColourSpace>,
}

impl SourceArgs {
    /// Opens an input and prints the notes about it.
    pub fn open(&self, path: &Path) -> Result<FrameSource> {
        let source = FrameSource::open_from(path, self.frames.unwrap_or_default(), self.first)?;
        for sentence in source.notes() {
            note(format_args!("{}: {sentence}", path.display()));
        }
        let told = source.file_space();
        let source = match self.colour_space {
            Some(space) => source.in_space(space),
            None => source,
        };
        let space = source.file_space();
        let usual = [ColourSpace::SRGB, ColourSpace::LINEAR_SRGB].contains(&space);
        match self.colour_space {
            Some(_) if space != told => {
                note(format_args!("{}: taken as {}, not {}", path.display(), space.name(), told.name()));
            }
            None if !usual => {
                let said =
                    source.profile().map_or("it".into(), |p| format!("its ICC profile ({})", p.name()));
                note(format_args!("{}: in {}, as {said} says", path.display(), space.name()));
            }
            _ => {}
        }
        if self.colour_space.is_some() || source.format().is_exr() {
            let first = source.frames().next().transpose()?;
            if let Some(doubt) = first.and_then(|frame| doubts(&source.space(), &space, &frame.image)) {
                note(format_args!("warning: {}: {doubt}", path.display()));
            }
        }
        Ok(source)
    }
}

/// Parses a colour space: a name, or the name of a file with an ICC profile.
pub fn colour_space(text: &str) -> std::result::Result<ColourSpace, String> {
    match blindaug_io::has_extension(Path::new(text), &["icc", "icm"]) {
        true => IccProfile::read(text).and_then(|profile| profile.space(text)).map_err(|e| e.to_string()),
        false => text.parse().map_err(|e: blindaug::Error| e.to_string()),
    }
}

/// Parses the colour space of renders, which hold light.
pub fn linear_space(text: &str) -> std::result::Result<ColourSpace, String> {
    let space: ColourSpace = text.parse().map_err(|e: blindaug::Error| e.to_string())?;
    match space.transfer {
        blindaug::Transfer::Linear => Ok(space),
        _ => Err("renders hold light: give linear-srgb, acescg or aces2065-1".into()),
    }
}
