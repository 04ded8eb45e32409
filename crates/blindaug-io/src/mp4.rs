//! The built-in video decoder, which needs no other program: H.264 in MP4 or MOV, 4:2:0, 8 bit.

use crate::{
    Error, Result,
    error::{guarded, one_line},
    files::open_file,
    limits::check_size,
    memory,
    mp4_boxes::Checked,
    video_head::{VideoHead, uneven},
    yuv::{Colour, YuvFormat, YuvFrame},
};
use blindaug::colour_space::ColourSpace;
use openh264::{
    decoder::{DecodeOptions, DecodedYUV, Decoder, Flush},
    formats::YUVSource,
};
use re_mp4::{StsdBoxContent, Track, TrackKind};
use std::{
    collections::VecDeque,
    fs::File,
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
    ops::Range,
    path::{Path, PathBuf},
};

const START_CODE: [u8; 4] = [0, 0, 0, 1];

/// The largest compressed frame that is read, bytes.
const MAX_SAMPLE: u64 = 1 << 28;

/// The memory that the parser and this module take for each coded frame, bytes.
const BYTES_PER_SAMPLE: u64 = 120;

/// The positions of a file's coded frames, and the parameters of their coding.
#[derive(Clone, Debug)]
pub(crate) struct Mp4 {
    /// Offset and size of each coded frame, in decoding order, bytes.
    samples: Vec<(u64, u64)>,
    /// The frames that are shown, as a range in display order. A phone trims a video by an entry in its head, and keeps all frames.
    shown: Range<usize>,
    /// The size of the length field in front of each NAL unit, bytes, 1 to 4.
    length_size: usize,
    /// The sequence and picture parameter sets, as a byte stream with start codes.
    parameter_sets: Vec<u8>,
}

impl Mp4 {
    /// Reads the head of the file.
    // This function is long because it checks each box of the head in turn.
    pub(crate) fn open(path: &Path) -> Result<(Self, VideoHead)> {
        let file = open_file(path)?;
        let length = file.metadata().map_err(|e| Error::cannot_read(path, &e))?.len();
        let other = "install ffmpeg, or give the frames as a folder of images";
        guarded(path, || {
            let mut file = BufReader::new(file);
            let is_mp4 = file.fill_buf().is_ok_and(|head| head.get(4..8) == Some(b"ftyp"));
            if !is_mp4 {
                let what = "not an image, nor an MP4 video, which is all that can be read without ffmpeg";
                return Err(Error::new(path, format!("{what}; {other}")));
            }
            let file = Checked::new(file, length).map_err(|e| Error::damaged(path, e))?;
            memory::fits(path, "the list of its frames", BYTES_PER_SAMPLE * file.samples())?;
            let mp4 = re_mp4::Mp4::read(file, length).map_err(|e| Error::damaged(path, e))?;
            let first = |is_wanted: &dyn Fn(&Track) -> bool| mp4.tracks().values().find(|t| is_wanted(t));
            // The parser sets the kind of a track only if it knows the format, so the handler type is looked at, too.
            let handled_as_video = |t: &Track| &t.trak(&mp4).mdia.hdlr.handler_type.value == b"vide";
            let track = first(&|t| t.kind == Some(TrackKind::Video)).or_else(|| first(&handled_as_video));
            let Some(track) = track else {
                return Err(Error::new(
                    path,
                    "there is no video in this file, only sound or text; give a video",
                ));
            };
            let trak = track.trak(&mp4);
            let avc1 = match &trak.mdia.minf.stbl.stsd.contents {
                StsdBoxContent::Avc1(avc1) => avc1,
                coded => {
                    let codec = match coded {
                        // `Checked` has put the name in capitals, so that the parser skips the box.
                        StsdBoxContent::Unknown(name) => {
                            name.value.to_ascii_lowercase().escape_ascii().to_string()
                        }
                        _ => "another format".into(),
                    };
                    let what =
                        format!("the video is coded as {codec}, but without ffmpeg only H.264 can be read");
                    return Err(Error::new(path, format!("{what}; {other}")));
                }
            };
            check_size(path, avc1.width.into(), avc1.height.into())?;
            let avcc = &avc1.avcc;
            let mut parameter_sets = Vec::new();
            for unit in avcc.sequence_parameter_sets.iter().chain(&avcc.picture_parameter_sets) {
                parameter_sets.extend(START_CODE);
                parameter_sets.extend(&unit.bytes);
            }
            let sps = avcc.sequence_parameter_sets.first().map_or(&[][..], |s| &s.bytes);
            let sps = Sps::parse(sps).ok_or_else(|| Error::damaged(path, "its parameters cannot be read"))?;
            if sps.chroma_format != 1 || sps.bit_depth != 8 {
                let what = "the video has more than 8 bits or is not 4:2:0, which only ffmpeg can read";
                return Err(Error::new(path, format!("{what}; {other}")));
            }
            // The decoder allocates memory for the size in the parameter set, whatever the container says.
            check_size(path, sps.size[0], sps.size[1])?;
            if !sps.progressive {
                let what = "the video is interlaced, which only ffmpeg can read";
                return Err(Error::new(path, format!("{what}; {other}")));
            }
            let unit = (track.timescale as f64).recip();
            let mut times: Vec<f64> =
                track.samples.iter().map(|s| s.composition_timestamp as f64 * unit).collect();
            times.sort_by(f64::total_cmp);
            let samples: Vec<_> = track.samples.iter().map(|s| (s.offset, s.size)).collect();
            let seconds = track.duration as f64 / track.timescale as f64;
            let shown = shown_frames(&mp4, track);
            let fps = Some(samples.len() as f64 / seconds).filter(|f| f.is_finite() && *f > 0.0);
            let m = &trak.tkhd.matrix;
            let quarter_turns = match (m.a.signum(), m.b.signum(), m.c.signum(), m.d.signum()) {
                (0, 1, -1, 0) => 1,
                (-1, 0, 0, -1) => 2,
                (0, -1, 1, 0) => 3,
                _ => 0,
            };
            let head = VideoHead {
                fps,
                frames: Some(shown.len()),
                colour: Colour::new(sps.matrix_coefficients, avc1.height.into(), sps.full_range, false),
                space: ColourSpace::SRGB,
                quarter_turns,
                pixel_aspect: None,
                notes: uneven(&times).into_iter().collect(),
            };
            Ok((
                Self {
                    samples,
                    shown,
                    length_size: usize::from(avcc.length_size_minus_one & 3) + 1,
                    parameter_sets,
                },
                head,
            ))
        })
    }

    /// Starts to decode at the first frame.
    pub(crate) fn frames(&self, path: &Path) -> Result<Mp4Frames> {
        let file = open_file(path)?;
        let decoder = Decoder::new().map_err(|e| Error::new(path, format!("no H.264 decoder ({e})")))?;
        Ok(Mp4Frames {
            path: path.into(),
            mp4: self.clone(),
            file: BufReader::new(file),
            decoder,
            next: 0,
            decoded: 0,
            rest: VecDeque::new(),
            flushed: false,
        })
    }
}

/// A reader of the decoded frames.
pub(crate) struct Mp4Frames {
    path: PathBuf,
    mp4: Mp4,
    file: BufReader<File>,
    decoder: Decoder,
    /// Index of the next sample to decode.
    next: usize,
    decoded: usize,
    /// Frames that were left in the decoder after the last sample.
    rest: VecDeque<YuvFrame>,
    flushed: bool,
}

impl Mp4Frames {
    /// The next frame in display order; `None` at the end.
    pub(crate) fn next_frame(&mut self) -> Result<Option<YuvFrame>> {
        while self.decoded < self.mp4.shown.end {
            let path = self.path.clone();
            let number = (self.decoded + 1).saturating_sub(self.mp4.shown.start).max(1);
            let frame = guarded(&path, || {
                self.decode().map_err(|e| {
                    let e = one_line(&e);
                    Error::new(&path, format!("the video is damaged or cut short at frame {number} ({e})"))
                })
            })?;
            self.decoded += 1;
            if frame.is_none() || self.decoded > self.mp4.shown.start {
                return Ok(frame);
            }
        }
        Ok(None)
    }

    fn decode(&mut self) -> std::result::Result<Option<YuvFrame>, String> {
        while let Some(&(offset, size)) = self.mp4.samples.get(self.next) {
            if size > MAX_SAMPLE {
                return Err("a coded frame of absurd size".into());
            }
            let mut sample = Vec::new();
            self.file.seek(SeekFrom::Start(offset)).map_err(|e| e.to_string())?;
            (&mut self.file).take(size).read_to_end(&mut sample).map_err(|e| e.to_string())?;
            if (sample.len() as u64) < size {
                return Err("the file ends".into());
            }
            let mut stream = if self.next == 0 { self.mp4.parameter_sets.clone() } else { Vec::new() };
            byte_stream_from_sample(&sample, self.mp4.length_size, &mut stream)
                .ok_or("a unit is longer than its frame")?;
            self.next += 1;
            // The decoder puts frames into display order if it is not flushed between samples.
            let options = DecodeOptions::new().flush_after_decode(Flush::NoFlush);
            // The decoder's own messages are error numbers, which tell the user nothing.
            let wrong = |_| "its coded picture is wrong".to_string();
            let decoded = self.decoder.decode_with_options(&stream, options).map_err(wrong)?;
            if let Some(yuv) = decoded {
                return Ok(Some(packed(&yuv)));
            }
        }
        if !self.flushed {
            self.flushed = true;
            let rest = self.decoder.flush_remaining().map_err(|_| "its coded picture is wrong")?;
            self.rest.extend(rest.iter().map(packed));
        }
        Ok(self.rest.pop_front())
    }
}

/// A copy of the decoder's planes without the padding of their rows.
fn packed(yuv: &DecodedYUV) -> YuvFrame {
    let format = YuvFormat { size: yuv.dimensions(), chroma_shift: (1, 1), bits: 8 };
    let (luma, chroma) = (format.size, format.chroma_size());
    let (luma_stride, chroma_stride, _) = yuv.strides();
    let mut data = Vec::with_capacity(format.bytes());
    for (plane, stride, (width, height)) in
        [(yuv.y(), luma_stride, luma), (yuv.u(), chroma_stride, chroma), (yuv.v(), chroma_stride, chroma)]
    {
        plane.chunks(stride).take(height).for_each(|row| data.extend(&row[..width]));
    }
    YuvFrame { format, data }
}

/// The range of frames, in display order, that the edit list shows; all frames if there is no list or it has several pieces.
fn shown_frames(mp4: &re_mp4::Mp4, track: &Track) -> Range<usize> {
    let all = 0..track.samples.len();
    let trak = track.trak(mp4);
    let Some(edits) = trak.edts.as_ref().and_then(|e| e.elst.as_ref()) else { return all };
    // A media time of -1 marks an empty edit, that is, a pause.
    let mut pieces = edits.entries.iter().filter(|e| e.media_time < u32::MAX.into());
    let (Some(piece), None, Some(first)) = (pieces.next(), pieces.next(), track.samples.first()) else {
        return all;
    };
    // The parser has shifted all times so that the first frame is shown at 0; `moved` is that shift, in the track's units.
    let offsets = trak.mdia.minf.stbl.ctts.as_ref().map_or(&[][..], |c| &c.entries);
    let lowest = offsets.iter().map(|o| i64::from(o.sample_offset)).min().unwrap_or(0).min(0);
    let moved = lowest.saturating_sub(first.decode_timestamp);
    let start = (piece.media_time as i64).saturating_sub(moved);
    let ratio = track.timescale as f64 / f64::from(mp4.moov.mvhd.timescale.max(1));
    let end = match piece.segment_duration {
        0 => i64::MAX,
        duration => start.saturating_add((duration as f64 * ratio).ceil() as i64),
    };
    let before = |time: i64| track.samples.iter().filter(|s| s.composition_timestamp < time).count();
    let shown = before(start)..before(end);
    if shown.is_empty() { all } else { shown }
}

/// Appends the NAL units of an MP4 sample to `stream`, with start codes in place of their lengths. `None` if a length is wrong.
fn byte_stream_from_sample(mut sample: &[u8], length_size: usize, stream: &mut Vec<u8>) -> Option<()> {
    while !sample.is_empty() {
        let (length, rest) = sample.split_at_checked(length_size)?;
        let length = length.iter().fold(0, |n, &b| n << 8 | usize::from(b));
        let (unit, rest) = rest.split_at_checked(length)?;
        stream.extend(START_CODE);
        stream.extend(unit);
        sample = rest;
    }
    Some(())
}

/// The fields of a sequence parameter set that are used here (section 7.3.2.1.1 and annex E of Rec. ITU-T H.264).
#[derive(Debug, PartialEq)]
struct Sps {
    /// Width and height of the coded picture, px: multiples of 16.
    size: [u64; 2],
    /// The index of the chroma format: 1 is 4:2:0.
    chroma_format: u32,
    bit_depth: u32,
    /// Whether every coded picture is a whole frame, not a field or a mixture of both.
    progressive: bool,
    full_range: bool,
    /// The index of the colour matrix in Table E-5: 2 is "unspecified".
    matrix_coefficients: u32,
}

impl Sps {
    /// Parses a parameter set; `None` if it ends too early.
    fn parse(unit: &[u8]) -> Option<Self> {
        // A byte 3 after two zero bytes only prevents a false start code, and is no data.
        let mut bytes = Vec::with_capacity(unit.len());
        for &b in unit {
            if !(b == 3 && bytes.ends_with(&[0, 0])) {
                bytes.push(b);
            }
        }
        let mut r = Bits { bytes: &bytes, at: 8 };
        let profile = r.bits(8)?;
        r.bits(16)?;
        r.golomb()?;
        let (mut chroma_format, mut bit_depth) = (1, 8);
        if [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135].contains(&profile) {
            chroma_format = r.golomb()?;
            if chroma_format == 3 {
                r.bits(1)?;
            }
            bit_depth = 8 + r.golomb()?.max(r.golomb()?);
            r.bits(1)?;
            if r.bits(1)? == 1 {
                for list in 0..if chroma_format == 3 { 12 } else { 8 } {
                    if r.bits(1)? == 1 {
                        r.scaling_list(if list < 6 { 16 } else { 64 })?;
                    }
                }
            }
        }
        r.golomb()?;
        match r.golomb()? {
            0 => {
                r.golomb()?;
            }
            1 => {
                r.bits(1)?;
                r.golomb()?;
                r.golomb()?;
                for _ in 0..r.golomb()?.min(255) {
                    r.golomb()?;
                }
            }
            _ => {}
        }
        r.golomb()?;
        r.bits(1)?;
        let blocks = [r.golomb()?, r.golomb()?].map(|n| u64::from(n) + 1);
        let progressive = r.bits(1)? == 1;
        let size = [16 * blocks[0], 16 * blocks[1] * if progressive { 1 } else { 2 }];
        if !progressive {
            r.bits(1)?;
        }
        r.bits(1)?;
        if r.bits(1)? == 1 {
            for _ in 0..4 {
                r.golomb()?;
            }
        }
        let mut sps =
            Self { size, chroma_format, bit_depth, progressive, full_range: false, matrix_coefficients: 2 };
        if r.bits(1)? == 1 {
            if r.bits(1)? == 1 && r.bits(8)? == 255 {
                r.bits(32)?;
            }
            if r.bits(1)? == 1 {
                r.bits(1)?;
            }
            if r.bits(1)? == 1 {
                r.bits(3)?;
                sps.full_range = r.bits(1)? == 1;
                if r.bits(1)? == 1 {
                    r.bits(16)?;
                    sps.matrix_coefficients = r.bits(8)?;
                }
            }
        }
        Some(sps)
    }
}

/// A reader of bits, which takes the highest bit of each byte first.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn bits(&mut self, n: u32) -> Option<u32> {
        (0..n).try_fold(0, |value, _| {
            let byte = self.bytes.get(self.at / 8)?;
            let bit = byte >> (7 - self.at % 8) & 1;
            self.at += 1;
            Some(value << 1 | u32::from(bit))
        })
    }

    /// Reads an unsigned Exp-Golomb code.
    fn golomb(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.bits(1)? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1 << zeros) - 1 + self.bits(zeros)?)
    }

    /// Skips a scaling list.
    fn scaling_list(&mut self, size: usize) -> Option<()> {
        let (mut last, mut next) = (8i64, 8i64);
        for _ in 0..size {
            if next != 0 {
                let code = i64::from(self.golomb()?);
                let delta = if code % 2 == 1 { (code + 1) / 2 } else { -code / 2 };
                next = (last + delta).rem_euclid(256);
            }
            last = if next == 0 { last } else { next };
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forty_four_bytes_that_held_the_parser_for_ever_are_damaged() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mp4");
        let file = [&b"\0\0\0\x14ftypisom\0\0\0\0isom"[..], b"\0\0\0\x18moov", &[0; 16]].concat();
        assert_eq!(file.len(), 44);
        std::fs::write(&path, file).unwrap();
        let e = Mp4::open(&path).err().unwrap().to_string();
        assert!(e.contains("a.mp4: the file is damaged"), "{e}");
    }

    #[test]
    fn the_size_in_the_parameters_is_read() {
        // The parameter set that x264 writes for 640 x 272, High profile, progressive.
        let unit = [
            0x67, 0x64, 0x00, 0x15, 0xac, 0xd9, 0x40, 0xa0, 0x23, 0xb0, 0x11, 0x00, 0x00, 0x03, 0x00, 0x01,
            0x00, 0x00, 0x03, 0x00, 0x32, 0x0f, 0x16, 0x2d, 0x96,
        ];
        let sps = Sps::parse(&unit).unwrap();
        assert!(sps.progressive && sps.chroma_format == 1 && sps.bit_depth == 8, "{sps:?}");
        assert_eq!(sps.size, [640, 272]);
        assert_eq!(Sps::parse(&unit[..6]), None);
    }
}
