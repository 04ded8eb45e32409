//! Reading channels of EXR files, which are found by the names that different programs give them, and writing EXR files.

use crate::{
    Coding, Error, Result,
    error::{guarded, one_line},
    files::open_file,
    limits::{DEFLATE_RATIO, check_length, check_size, is_exr, pixels_in_words},
    memory,
    not_numbers::{Counted, few},
    partial::write_atomically,
};
use ::exr::{
    block::{
        self, BlockIndex, UncompressedBlock, chunk::Chunk, reader::ChunksReader, writer::ChunksWriter as _,
    },
    compression::Compression,
    image::{
        AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer,
        write::layers::{LayersWriter as _, WritableLayers as _},
    },
    math::Vec2,
    meta::{
        BlockDescription,
        attribute::{Chromaticities, IntegerBounds, SampleType},
        header::{Header, ImageAttributes, LayerAttributes},
    },
    prelude::f16,
};
use blindaug::{
    BRIGHTEST, Flow, Linear, Overscan, Plane, Premultiplied, Raster,
    colour_space::{ColourSpace, Primaries},
    composite::DistortedLayer,
    finite_light,
    model::{FRAME_RATES, PIXEL_ASPECTS, inverse_of_metric},
};
use rayon::prelude::*;
use std::{
    fs::File,
    io::{BufReader, BufWriter, Write as _},
    path::Path,
};

/// The depth, m, that is written where there is nothing, as renderers do.
const NOTHING: f32 = 1e10;

/// The kinds of channels in an EXR file, of those that blindaug reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExrContents {
    /// Whether there are channels `R`, `G` and `B`.
    pub colour: bool,
    /// Whether there is a channel `A` beside them.
    pub alpha: bool,
    /// Whether there is depth: a channel `Z`, Blender's `Depth.V`, or a single channel.
    pub depth: bool,
    /// Whether there is optical flow: channels `forward.u` and `forward.v`, or Blender's Vector pass.
    pub flow: bool,
}

/// A rendered virtual layer.
#[derive(Clone, Debug, PartialEq)]
pub struct VirtualLayerFile {
    /// Scene-linear colour, premultiplied by alpha.
    pub color: Premultiplied,
    /// Inverse depth, 1/m, NaN where there is nothing; `None` if the file has no `Z`.
    pub inverse_depth: Option<Plane>,
    /// Optical flow to the next frame, px; `None` if the file has no flow.
    pub flow: Option<Flow>,
    /// How far all of these reach beyond the frame, px: the data window beyond the display window.
    pub overscan: Overscan,
    /// The number of pixels of which a value was NaN, where alpha is not 0. 0 was taken in its place.
    pub not_numbers: usize,
}

/// Reads from the head of an EXR file which kinds of channels it has.
///
/// # Errors
/// If the file is missing, damaged or no EXR.
pub fn exr_contents(path: impl AsRef<Path>) -> Result<ExrContents> {
    let file = open(path.as_ref())?;
    let colour = file.colour();
    Ok(ExrContents {
        colour: colour.is_some(),
        alpha: colour.is_some_and(|rgb| file.alpha(&rgb).is_some()),
        depth: file.depth().is_some(),
        flow: file.flow().is_some(),
    })
}

/// Reads a virtual layer: `R G B A` premultiplied and scene-linear, `Z` in metres, `forward.u` and `forward.v` in px
/// (or Blender's names for these). The frame is the display window; what the file has beyond it is read as well.
///
/// # Errors
/// If the file is missing, damaged, too large, no EXR, lacks `R`, `G`, `B` or `A`, or most pixels are NaN of those where alpha is not 0.
pub fn read_virtual_layer(path: impl AsRef<Path>) -> Result<VirtualLayerFile> {
    let path = path.as_ref();
    if !is_exr(path)? {
        return Err(Error::new(path, "a virtual layer must be an EXR file with channels R G B A and Z"));
    }
    let file = open(path)?;
    let LayerChannels { picks, depth, flow } = file.layer()?;
    let overscan = file.overscan(&picks);
    let planes = file.read(&picks, overscan)?;
    let not_numbers = few(path, bad_pixels(&planes[..4], Some(&planes[3])))?;
    let rest = &planes[4 + depth.iter().len()..];
    let (width, height) = planes[0].size();
    let pixel = |x: usize, y: usize| [0, 1, 2, 3].map(|c| planes[c].at(x, y));
    let color = Raster::from_fn(width, height, |x, y| Premultiplied::of_rendered(pixel(x, y)));
    Ok(VirtualLayerFile {
        color: Premultiplied(color),
        inverse_depth: depth.map(|_| planes[4].map(inverse_of_metric)),
        flow: flow.map(|f| f.join(&rest[0], &rest[1])),
        overscan,
        not_numbers,
    })
}

/// What the head of an EXR file says beside its channels: timecode, chromaticities, pixel aspect, the place of the display window, and
/// what programs wrote there of their own.
#[derive(Clone, Debug)]
pub struct ExrHead {
    image: ImageAttributes,
    layer: LayerAttributes,
    /// The picture that reaches beyond the display window, if it does.
    pub(crate) beyond: Option<Box<Beyond>>,
}

/// A picture that reaches beyond the frame, in the values of its file.
#[derive(Clone, Debug)]
pub(crate) struct Beyond {
    pub(crate) values: Linear,
    pub(crate) overscan: Overscan,
    pub(crate) space: ColourSpace,
}

impl ExrHead {
    /// Reads the head of an EXR file.
    ///
    /// # Errors
    /// If the file is missing, damaged or no EXR.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::of(&open(path)?)
    }

    fn of(file: &ExrFile) -> Result<Self> {
        let first =
            file.reader.headers().first().ok_or_else(|| Error::damaged(file.path, "it has no layer"))?;
        let (image, layer) = (first.shared_attributes.clone(), first.own_attributes.clone());
        Ok(Self { image, layer: LayerAttributes { layer_name: None, ..layer }, beyond: None })
    }

    /// Reads the head, and the colour that a file of this colour space has beyond its display window: it goes on, as it is, into the file
    /// that gets this head.
    ///
    /// # Errors
    /// If the file is missing, damaged, too large, or no EXR with colour.
    pub(crate) fn read_with_overscan(path: &Path, space: ColourSpace) -> Result<Self> {
        let file = open(path)?;
        let head = Self::of(&file)?;
        let Some(rgb) = file.colour() else {
            return Err(file.lacks("channels R, G and B"));
        };
        let overscan = file.overscan(&rgb);
        let beyond = match overscan.is_none() {
            true => None,
            false => {
                Some(Box::new(Beyond { values: colour_of(file, &rgb, true, overscan)?.0, overscan, space }))
            }
        };
        Ok(Self { beyond, ..head })
    }

    /// Frames per second; `None` where the head says nothing, or what cannot be.
    pub fn fps(&self) -> Option<f64> {
        let (frames, seconds) = self.layer.frames_per_second?;
        let rate = f64::from(frames) / f64::from(seconds);
        Some(rate).filter(|rate| FRAME_RATES.contains(rate))
    }

    /// The width of a pixel over its height; 1 where the head says nothing, or what cannot be.
    pub fn pixel_aspect(&self) -> f32 {
        let aspect = self.image.pixel_aspect;
        if PIXEL_ASPECTS.contains(&aspect) { aspect } else { 1.0 }
    }
}

/// The primaries that a file's head tells, or those of sRGB. What spans no colour space counts as not told.
pub(crate) fn primaries(path: &Path) -> Result<Primaries> {
    let file = open(path)?;
    let told = file.reader.headers().first().and_then(|first| first.shared_attributes.chromaticities);
    let xy = told.map(|c| [c.red, c.green, c.blue, c.white].map(|Vec2(x, y)| [f64::from(x), f64::from(y)]));
    Ok(xy.and_then(|xy| Primaries::new(xy).ok()).unwrap_or(Primaries::REC709))
}

/// Whether the channels `R`, `G` and `B` are half floats.
pub(crate) fn colour_is_half(path: &Path) -> Result<bool> {
    let file = open(path)?;
    let channels = file.colour().ok_or_else(|| file.lacks("channels R, G and B"))?;
    Ok(channels.iter().all(|&i| {
        let channel = &file.channels[i];
        file.reader.headers()[channel.header].channels.list[channel.index].sample_type == SampleType::F16
    }))
}

/// A channel to write: its name, the bits of a value, 16 (half) or 32 (float), and the values, row by row from the top left.
pub(crate) struct Written {
    pub(crate) name: &'static str,
    pub(crate) bits: u8,
    pub(crate) values: Vec<f32>,
}

/// Writes channels, compressed without loss (ZIP), with the primaries of their colours. `size` is that of the data window, which reaches
/// beyond the display window as far as `overscan` says.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub(crate) fn write(
    path: &Path,
    (size, overscan): ((usize, usize), Overscan),
    channels: impl IntoIterator<Item = Written>,
    head: Option<&ExrHead>,
    primaries: &Primaries,
) -> Result<()> {
    let channels = channels.into_iter().map(|Written { name, bits, values }| {
        let samples = match bits {
            16 => FlatSamples::F16(values.into_iter().map(half).collect()),
            _ => FlatSamples::F32(values),
        };
        AnyChannel::new(name, samples)
    });
    let channels = AnyChannels::sort(channels.collect());
    let (display, size) = (overscan.frame_size(size), Vec2(size.0, size.1));
    let display = Vec2(display.0, display.1);
    let (mut image, mut layer) = match head {
        Some(head) => (head.image.clone(), head.layer.clone()),
        None => (ImageAttributes::new(IntegerBounds::from_dimensions(display)), LayerAttributes::default()),
    };
    image.display_window.size = display;
    // Files that say nothing are taken to have the primaries of Rec. 709.
    if image.chromaticities.is_some() || *primaries != Primaries::REC709 {
        let [red, green, blue, white] = primaries.xy.map(|[x, y]| Vec2(x as f32, y as f32));
        image.chromaticities = Some(Chromaticities { red, green, blue, white });
    }
    let Vec2(x, y) = image.display_window.position;
    layer.layer_position = Vec2(x - overscan.left as i32, y - overscan.top as i32);
    let layer = Layer::new(size, layer, Encoding::SMALL_LOSSLESS, channels);
    let image = Image::new(image, layer);
    write_atomically(path, |partial| {
        let mut file = BufWriter::new(File::create(partial)?);
        write_compressed(&image, &mut file).map_err(|e| match e {
            ::exr::error::Error::Io(e) => e,
            e => std::io::Error::other(e),
        })?;
        file.flush()
    })
}

/// Writes an image, of which several blocks are compressed at once.
fn write_compressed(
    image: &Image<Layer<AnyChannels<FlatSamples>>>,
    file: &mut BufWriter<File>,
) -> ::exr::error::UnitResult {
    let headers = image.layer_data.infer_headers(&image.attributes);
    let layers = image.layer_data.create_writer(&headers);
    block::write(file, headers, true, |meta, chunks| {
        let blocks: Vec<_> = block::enumerate_ordered_header_block_indices(&meta.headers).collect();
        let bytes =
            |block: &BlockIndex| block.pixel_size.area() * meta.headers[block.layer].channels.bytes_per_pixel;
        let largest = blocks.iter().map(|(_, block)| bytes(block)).max().unwrap_or(0);
        for some in blocks.chunks(at_once(largest as u64)) {
            let compressed: ::exr::error::Result<Vec<_>> = some
                .par_iter()
                .map(|&(place, index)| {
                    let data = layers.extract_uncompressed_block(&meta.headers, index);
                    Ok((place, UncompressedBlock { index, data }.compress_to_chunk(&meta.headers)?))
                })
                .collect();
            compressed?.into_iter().try_for_each(|(place, chunk)| chunks.write_chunk(place, chunk))?;
        }
        Ok(())
    })
}

/// The number of blocks of up to so many bytes that are compressed or decompressed at once.
fn at_once(block: u64) -> usize {
    /// Enough for many threads.
    const MOST: u64 = 32;
    /// The bytes of several blocks.
    const BYTES: u64 = 16 << 20;
    (BYTES / block.max(1)).clamp(1, MOST) as usize
}

/// Writes a distorted layer as an EXR file for a compositing program: `R G B A` premultiplied and scene-linear, `noise.R noise.G noise.B`,
/// `holdout.A`, `Z` in metres (1e10 where there is nothing), and `forward.u forward.v` in px. Over the frame in linear light, colour and
/// alpha give the composite without noise, to which the noise is added. Light comes out in the primaries of `coding`. `bits`
/// are those of colour, noise and holdout, 16 or 32; the others are floats.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub fn write_distorted_layer(
    path: impl AsRef<Path>,
    layer: &DistortedLayer,
    bits: u8,
    head: Option<&ExrHead>,
    coding: &Coding,
) -> Result<()> {
    fn of<const N: usize>(
        names: [&'static str; N],
        image: &Raster<[f32; N]>,
        bits: u8,
    ) -> impl Iterator<Item = Written> {
        (0..N).map(move |c| {
            let values = image.data().iter().map(|p| p[c]).collect();
            Written { name: names[c], bits, values }
        })
    }
    let far = |d: f32| if d > 1.0 / NOTHING { 1.0 / d } else { NOTHING };
    let z = layer.inverse_depth.data().iter().map(|d| far(*d)).collect();
    let plain = [
        Written { name: "holdout.A", bits, values: layer.holdout.data().to_vec() },
        Written { name: "Z", bits: 32, values: z },
    ];
    let color = layer.color.0.map(|[r, g, b, a]| {
        let [r, g, b] = coding.light([r, g, b]);
        [r, g, b, a]
    });
    let noise = layer.noise.map(|v| coding.light(v));
    let channels = of(["R", "G", "B", "A"], &color, bits)
        .chain(of(["noise.R", "noise.G", "noise.B"], &noise, bits))
        .chain(of(["forward.u", "forward.v"], &layer.flow, 32))
        .chain(plain);
    write(path.as_ref(), (layer.color.0.size(), layer.overscan), channels, head, &coding.file().primaries)
}

/// The nearest half float; what is too large becomes the largest.
fn half(v: f32) -> f16 {
    f16::from_f32(v.clamp(-BRIGHTEST, BRIGHTEST))
}

/// Width and height of the display window, px.
pub(crate) fn size(path: &Path) -> Result<(usize, usize)> {
    Ok(open(path)?.size)
}

/// Reads the channels `R`, `G` and `B`. What is below 0 becomes 0, unless it is to be kept.
pub(crate) fn read_colour(path: &Path, below_zero: bool) -> Result<Counted<Linear>> {
    let file = open(path)?;
    let Some(rgb) = file.colour() else {
        return Err(file.lacks("channels R, G and B"));
    };
    colour_of(file, &rgb, below_zero, Overscan::default())
}

fn colour_of(
    file: ExrFile,
    rgb: &[usize; 3],
    below_zero: bool,
    overscan: Overscan,
) -> Result<Counted<Linear>> {
    let (path, alpha) = (file.path, file.alpha(rgb));
    let planes = file.read(rgb, overscan)?;
    let (width, height) = planes[0].size();
    let is_whole = planes.iter().all(|p| p.data().iter().all(|v| !v.is_nan()));
    let alpha = match alpha.filter(|_| !is_whole) {
        Some(alpha) => open(path)?.read(&[alpha], overscan)?.pop(),
        None => None,
    };
    let not_numbers = few(path, bad_pixels(&planes, alpha.as_ref()))?;
    let least = if below_zero { -BRIGHTEST } else { 0.0 };
    let colour =
        Raster::from_fn(width, height, |x, y| [0, 1, 2].map(|c| finite_light(planes[c].at(x, y), least)));
    Ok((Linear(colour), not_numbers))
}

/// For each pixel, whether one of its channels is NaN. Pixels whose alpha is 0 are left out: colour may be 0 / 0 there.
fn bad_pixels<'a>(channels: &'a [Plane], alpha: Option<&'a Plane>) -> impl Iterator<Item = bool> + 'a {
    let pixels = channels.first().map_or(0, |p| p.data().len());
    let seen = (0..pixels).filter(move |&i| alpha.is_none_or(|a| a.data()[i] != 0.0));
    seen.map(|i| channels.iter().any(|p| p.data()[i].is_nan()))
}

/// Reads the depth channel (`Z`, or the only channel) as it is stored.
pub(crate) fn read_depth(path: &Path) -> Result<Plane> {
    let file = open(path)?;
    let Some(z) = file.depth() else {
        return Err(file.lacks("channel Z"));
    };
    let mut planes = file.read(&[z], Overscan::default())?;
    Ok(planes.swap_remove(0))
}

/// Reads a matte: the alpha channel, or the only channel, or red.
pub(crate) fn read_matte(path: &Path) -> Result<Plane> {
    let file = open(path)?;
    let only = (file.channels.len() == 1).then_some([0]);
    let Some([matte]) =
        file.find(["A"], |_, _| Some(0)).or(only).or_else(|| file.find(["R"], |_, _| Some(0)))
    else {
        return Err(file.lacks("channel A or R"));
    };
    Ok(file.read(&[matte], Overscan::default())?.swap_remove(0))
}

/// Reads optical flow to the next frame, px.
pub(crate) fn read_flow(path: &Path) -> Result<Flow> {
    let file = open(path)?;
    let Some(flow) = file.flow() else {
        return Err(file.lacks("channels forward.u and forward.v (or Blender's Vector pass)"));
    };
    let p = file.read(&flow.channels, Overscan::default())?;
    Ok(flow.join(&p[0], &p[1]))
}

/// A channel: the index of its header, its index in that header, and its name with the layer's name in front.
struct Channel {
    header: usize,
    index: usize,
    name: String,
}

impl Channel {
    /// The name without its last part, which follows the last dot.
    fn prefix(&self) -> &str {
        self.name.rsplit_once('.').map_or("", |(prefix, _)| prefix)
    }

    fn last(&self) -> &str {
        self.name.rsplit_once('.').map_or(&self.name, |(_, last)| last)
    }
}

/// The channels of optical flow, x and y, and the sign of each.
struct FlowChannels {
    channels: [usize; 2],
    sign: [f32; 2],
}

/// Flow components of this size or larger, px, are unknown (the `.flo` convention).
const UNKNOWN: f32 = 1e9;

/// The displacement, or NaN for both components if one of them is huge or invalid.
pub(crate) fn known_flow(uv: [f32; 2]) -> [f32; 2] {
    if uv.iter().all(|v| v.abs() < UNKNOWN) { uv } else { [f32::NAN; 2] }
}

impl FlowChannels {
    fn join(&self, u: &Plane, v: &Plane) -> Flow {
        Raster::from_fn(u.width(), u.height(), |x, y| {
            known_flow([self.sign[0] * u.at(x, y), self.sign[1] * v.at(x, y)])
        })
    }
}

/// The channels of a virtual layer.
struct LayerChannels {
    /// R, G, B and A, then depth and the flow's two, if there are any.
    picks: Vec<usize>,
    depth: Option<usize>,
    flow: Option<FlowChannels>,
}

/// An EXR file whose head has been read and checked.
struct ExrFile<'a> {
    path: &'a Path,
    reader: block::reader::Reader<BufReader<File>>,
    channels: Vec<Channel>,
    /// Width and height of the display window, px.
    size: (usize, usize),
}

fn open(path: &Path) -> Result<ExrFile<'_>> {
    let file = open_file(path)?;
    let reader = guarded(path, || block::read(BufReader::new(file), false).map_err(|e| exr_error(path, e)))?;
    let Some(first) = reader.headers().first() else {
        return Err(Error::damaged(path, "it has no layer"));
    };
    let Vec2(width, height) = first.shared_attributes.display_window.size;
    let size = check_size(path, width as u64, height as u64)?;
    let mut channels = Vec::new();
    for (header, h) in reader.headers().iter().enumerate() {
        let layer = h.own_attributes.layer_name.as_ref().map(|n| n.to_string()).filter(|n| !n.is_empty());
        for (index, c) in h.channels.list.iter().enumerate() {
            let name = c.name.to_string();
            let name = layer.as_ref().map_or(name.clone(), |l| format!("{l}.{name}"));
            channels.push(Channel { header, index, name });
        }
    }
    Ok(ExrFile { path, reader, channels, size })
}

fn exr_error(path: &Path, e: ::exr::error::Error) -> Error {
    match e {
        ::exr::error::Error::NotSupported(what) => {
            Error::new(path, format!("this kind of EXR cannot be read ({})", one_line(&what)))
        }
        e => Error::damaged(path, e),
    }
}

impl ExrFile<'_> {
    /// Finds channels with these last parts of their names and a common layer and prefix. Of several prefixes, the one that `rank`
    /// puts lowest is taken; `None` excludes a prefix.
    fn find<const N: usize>(
        &self,
        names: [&str; N],
        rank: impl Fn(&[usize], &str) -> Option<u32>,
    ) -> Option<[usize; N]> {
        let groups = self.channels.iter().filter(|c| c.last() == names[0]).filter_map(|first| {
            let siblings: Vec<usize> = (0..self.channels.len())
                .filter(|&i| {
                    self.channels[i].header == first.header && self.channels[i].prefix() == first.prefix()
                })
                .collect();
            let mut found = [0; N];
            for (slot, name) in found.iter_mut().zip(names) {
                *slot = *siblings.iter().find(|&&i| self.channels[i].last() == name)?;
            }
            let last = first.prefix().rsplit('.').next().unwrap_or("");
            let depth = first.prefix().split('.').count();
            Some(((rank(&siblings, last)?, depth), found))
        });
        groups.min_by_key(|(key, _)| *key).map(|(_, found)| found)
    }

    fn colour(&self) -> Option<[usize; 3]> {
        self.find(["R", "G", "B"], |_, last| {
            Some(u32::from(!last.is_empty()) + u32::from(last != "Combined"))
        })
    }

    /// The alpha channel of the same layer as `rgb`.
    fn alpha(&self, rgb: &[usize; 3]) -> Option<usize> {
        let r = &self.channels[rgb[0]];
        self.channels.iter().position(|c| c.last() == "A" && c.header == r.header && c.prefix() == r.prefix())
    }

    fn depth(&self) -> Option<usize> {
        // A Z beside an X is a coordinate of a vector; Blender's Mist is called Z as well.
        let z = self.find(["Z"], |siblings, last| {
            let vector = siblings.iter().any(|&i| self.channels[i].last() == "X");
            (!vector && last != "Mist").then_some(u32::from(!last.is_empty()) + u32::from(last != "Depth"))
        });
        let v = || self.find(["V"], |_, last| (last == "Depth").then_some(0));
        let only = || (self.channels.len() == 1).then_some([0]);
        z.or_else(v).or_else(only).map(|[z]| z)
    }

    fn flow(&self) -> Option<FlowChannels> {
        let ours = self.find(["u", "v"], |_, last| (last == "forward").then_some(0));
        // Blender's Vector pass has the motion from the previous frame in X and Y, and that to the next one in Z (negated) and W (down).
        let blender = || self.find(["Z", "W"], |_, last| (last == "Vector").then_some(0));
        ours.map(|channels| FlowChannels { channels, sign: [1.0, 1.0] })
            .or_else(|| blender().map(|channels| FlowChannels { channels, sign: [-1.0, 1.0] }))
    }

    /// The channels of a virtual layer.
    fn layer(&self) -> Result<LayerChannels> {
        let Some(rgb) = self.colour() else {
            return Err(self.lacks("channels R, G and B"));
        };
        let Some(alpha) = self.alpha(&rgb) else {
            return Err(self.lacks("channel A; render the object on a transparent background"));
        };
        let (depth, flow) = (self.depth(), self.flow());
        let mut picks = rgb.to_vec();
        picks.push(alpha);
        picks.extend(depth);
        picks.extend(flow.iter().flat_map(|f| f.channels));
        Ok(LayerChannels { picks, depth, flow })
    }

    /// The error that the file has no `what`, with the names of the channels that it has.
    fn lacks(&self, what: &str) -> Error {
        let names: Vec<_> = self.channels.iter().take(12).map(|c| c.name.as_str()).collect();
        let more = if self.channels.len() > names.len() { ", ..." } else { "" };
        let there = format!("its channels are {}{more}", one_line(&names.join(", ")));
        Error::new(self.path, format!("the file has no {what} ({there})"))
    }

    /// How far the data of the channels of these indices reach beyond the display window.
    fn overscan(&self, picks: &[usize]) -> Overscan {
        let px = |v: i64| v.max(0) as usize;
        let mut all = Overscan::default();
        for h in picks.iter().map(|&i| &self.reader.headers()[self.channels[i].header]) {
            let display = h.shared_attributes.display_window;
            // How far the data begin before the display window along an axis, and how far they end behind it.
            let along = |data: i32, size: usize, from: i32, display: usize| {
                let before = i64::from(from) - i64::from(data);
                [px(before), px(size as i64 - before - display as i64)]
            };
            let (at, size) = (h.own_attributes.layer_position, h.layer_size);
            let [left, right] = along(at.x(), size.x(), display.position.x(), display.size.x());
            let [top, bottom] = along(at.y(), size.y(), display.position.y(), display.size.y());
            all = Overscan {
                left: all.left.max(left),
                top: all.top.max(top),
                right: all.right.max(right),
                bottom: all.bottom.max(bottom),
            };
        }
        all
    }

    /// Reads the channels of these indices over the display window and the overscan around it; pixels without data are 0.
    fn read(self, picks: &[usize], overscan: Overscan) -> Result<Vec<Plane>> {
        let Self { path, reader, channels, size } = self;
        let size = overscan.picture_of(size);
        check_size(path, size.0 as u64, size.1 as u64)?;
        let picks: Vec<&Channel> = picks.iter().map(|&i| &channels[i]).collect();
        let length = path.metadata().map_err(|e| Error::cannot_read(path, &e))?.len();
        let mut largest_block = 0;
        for (i, h) in reader.headers().iter().enumerate() {
            if picks.iter().any(|p| p.header == i) {
                largest_block = largest_block.max(check_header(path, h, length)?);
            }
        }
        // Memory is taken for planes of f32, for the raster that they are joined to, and for blocks, both stored and decompressed.
        let pixels = (size.0 * size.1) as u64;
        let at_once = at_once(largest_block);
        let bytes = 8 * pixels * picks.len() as u64 + 2 * largest_block * at_once as u64;
        memory::fits(path, &pixels_in_words(size.0 as u64, size.1 as u64), bytes)?;
        guarded(path, || {
            let mut planes = vec![Plane::filled(size.0, size.1, 0.0); picks.len()];
            let fail = |e| exr_error(path, e);
            let mut chunks = reader
                .filter_chunks(false, |_, _, block| {
                    block.level == Vec2(0, 0) && picks.iter().any(|p| p.header == block.layer)
                })
                .map_err(fail)?;
            let meta = chunks.meta_data().clone();
            loop {
                let some: Vec<Chunk> =
                    chunks.by_ref().take(at_once).collect::<::exr::error::Result<_>>().map_err(fail)?;
                if some.is_empty() {
                    return Ok(planes);
                }
                // Only the blocks of layers that were checked are known to fit into memory.
                if some.iter().any(|chunk| picks.iter().all(|p| p.header != chunk.layer_index)) {
                    return Err(Error::damaged(path, "its table of blocks is wrong"));
                }
                let decompressed = |chunk| {
                    guarded(path, || UncompressedBlock::decompress_chunk(chunk, &meta, false).map_err(fail))
                };
                let blocks: Vec<Result<UncompressedBlock>> = some.into_par_iter().map(decompressed).collect();
                blocks.into_iter().try_for_each(|block| {
                    place_block(&mut planes, &picks, &block?, &meta.headers, overscan);
                    Ok(())
                })?;
            }
        })
    }
}

/// Writes the picked channels of a block into planes of the frame and the overscan around it; samples outside are left out.
fn place_block(
    planes: &mut [Plane],
    picks: &[&Channel],
    block: &UncompressedBlock,
    headers: &[Header],
    overscan: Overscan,
) {
    let Some(header) = headers.get(block.index.layer) else { return };
    let display = header.shared_attributes.display_window.position;
    let data = header.own_attributes.layer_position;
    let offset = |data: i32, display: i32, at: usize| i64::from(data) - i64::from(display) + at as i64;
    for line in block.lines(&header.channels) {
        let at = line.location;
        let x = offset(data.x(), display.x(), at.position.x() + overscan.left);
        let y = offset(data.y(), display.y(), at.position.y() + overscan.top);
        let sample_type = header.channels.list[at.channel].sample_type;
        for (plane, _) in
            planes.iter_mut().zip(picks).filter(|(_, p)| p.header == at.layer && p.index == at.channel)
        {
            if (0..plane.height() as i64).contains(&y) {
                place_line(plane.row_mut(y as usize), x, sample_type, line.value);
            }
        }
    }
}

/// Writes a line of samples into a row from column `x` on, which may be negative; samples outside the row are left out.
fn place_line(row: &mut [f32], x: i64, sample_type: SampleType, bytes: &[u8]) {
    let skip = (-x).max(0) as usize;
    let start = (x.max(0) as usize).min(row.len());
    let out = row[start..].iter_mut();
    match sample_type {
        SampleType::F16 => out
            .zip(bytes.as_chunks::<2>().0.iter().skip(skip))
            .for_each(|(o, &b)| *o = f16::from_ne_bytes(b).to_f32()),
        SampleType::F32 => {
            out.zip(bytes.as_chunks::<4>().0.iter().skip(skip))
                .for_each(|(o, &b)| *o = f32::from_ne_bytes(b));
        }
        SampleType::U32 => out
            .zip(bytes.as_chunks::<4>().0.iter().skip(skip))
            .for_each(|(o, &b)| *o = u32::from_ne_bytes(b) as f32),
    }
}

/// Fails if the decoder cannot read a layer of this header, or a file of `length` bytes cannot hold it. Returns a block's bytes.
fn check_header(path: &Path, h: &Header, length: u64) -> Result<u64> {
    /// Bytes of a block besides its pixels: its place in the table, its coordinates and its length.
    const BLOCK_HEAD: u64 = 16;
    let Vec2(width, height) = h.layer_size;
    check_size(path, width as u64, height as u64)?;
    if h.deep {
        return Err(Error::new(path, "deep EXR data cannot be read; write flat images"));
    }
    if h.channels.list.iter().any(|c| c.sampling != Vec2(1, 1)) {
        return Err(Error::new(path, "sub-sampled EXR channels cannot be read; write full resolution"));
    }
    let block_rows = match h.blocks {
        BlockDescription::ScanLines => h.compression.scan_lines_per_block().min(height),
        BlockDescription::Tiles(t) => t.tile_size.height().min(height),
    };
    let block_columns = match h.blocks {
        BlockDescription::ScanLines => width,
        BlockDescription::Tiles(t) => t.tile_size.width().min(width),
    };
    let of_pixels = |w: usize, h: usize, of: usize| (w * h) as u64 * of as u64;
    let all = of_pixels(width, height, h.channels.bytes_per_pixel);
    let ratio = if h.compression == Compression::Uncompressed { 1 } else { 4 * DEFLATE_RATIO };
    let blocks = (width.div_ceil(block_columns) * height.div_ceil(block_rows)) as u64;
    check_length(path, length, all / ratio + BLOCK_HEAD * blocks, (width as u64, height as u64))?;
    Ok(of_pixels(block_columns, block_rows, h.channels.bytes_per_pixel))
}
