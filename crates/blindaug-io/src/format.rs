//! The formats in which frames are written.

use crate::{
    Coding, Result, exr,
    image::{decoded_bits, write_png_with, write_png16_with, write_tiff},
    limits::is_exr,
};
use blindaug::{Encoded, Overscan, Plane};
use std::path::Path;

/// The kinds of image files that frames are written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Display-encoded integers.
    Png,
    /// Display-encoded integers, for programs that do not read PNG of 16 bits.
    Tiff,
    /// Scene-linear floats, which may exceed 1.
    Exr,
}

impl FileKind {
    /// The kind by a file's extension; `None` if it is none of these.
    pub fn of_name(path: &Path) -> Option<Self> {
        Self::of_extension(path.extension()?.to_str()?)
    }

    /// The kind by an extension without its dot, in upper or lower case.
    fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "png" => Some(Self::Png),
            "tif" | "tiff" => Some(Self::Tiff),
            "exr" => Some(Self::Exr),
            _ => None,
        }
    }

    /// The extension of such files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Tiff => "tif",
            Self::Exr => "exr",
        }
    }

    /// The bits of a value that such a file may have: the fewest, then the most.
    fn bits(self) -> [u8; 2] {
        match self {
            Self::Png | Self::Tiff => [8, 16],
            Self::Exr => [16, 32],
        }
    }
}

/// The format of a frame's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameFormat {
    kind: FileKind,
    bits: u8,
}

impl FrameFormat {
    /// PNG of 8 bits per value.
    pub const PNG8: Self = Self { kind: FileKind::Png, bits: 8 };

    /// The kind of the file.
    pub fn kind(self) -> FileKind {
        self.kind
    }

    /// The bits of a value: 8 or 16 of PNG and TIFF, 16 (half) or 32 (float) of EXR.
    pub fn bits(self) -> u8 {
        self.bits
    }

    /// Whether these are EXR files, which hold light unless something else is said, and values above 1.
    pub fn is_exr(self) -> bool {
        self.kind == FileKind::Exr
    }

    /// The format in which frames are written that were read from a file like this: EXR as half or as float, as it is; PNG and TIFF of
    /// 16 bits as they are; all others as PNG of 8 bits.
    ///
    /// # Errors
    /// If the file is missing, damaged or no image.
    pub fn of_file(path: &Path) -> Result<Self> {
        if is_exr(path)? {
            let bits = if exr::colour_is_half(path)? { 16 } else { 32 };
            return Ok(Self { kind: FileKind::Exr, bits });
        }
        Ok(match (decoded_bits(path)?, FileKind::of_name(path)) {
            (8, _) => Self::PNG8,
            (_, Some(FileKind::Tiff)) => Self { kind: FileKind::Tiff, bits: 16 },
            _ => Self { kind: FileKind::Png, bits: 16 },
        })
    }

    /// The format of images that are made from frames of a video whose values have so many bits.
    pub(crate) fn of_video(bits: u32) -> Self {
        if bits > 8 { Self { kind: FileKind::Png, bits: 16 } } else { Self::PNG8 }
    }

    /// This format, as far as no other kind and no other number of bits are asked for. Where the kind changes, values keep at least their
    /// bits if the new kind has as many.
    ///
    /// # Errors
    /// If files of this kind do not have values of so many bits.
    pub fn with(self, kind: Option<FileKind>, bits: Option<u8>) -> blindaug::Result<Self> {
        let kind = kind.unwrap_or(self.kind);
        let [fewest, most] = kind.bits();
        match bits {
            None => Ok(Self { kind, bits: self.bits.clamp(fewest, most) }),
            Some(bits) if [fewest, most].contains(&bits) => Ok(Self { kind, bits }),
            Some(bits) => Err(blindaug::Error::new(format!(
                "{} files have {fewest} or {most} bits per value, not {bits}",
                kind.extension().to_uppercase()
            ))),
        }
    }

    /// Writes a frame in the colour space of the file that `coding` says: light for EXR, unless EXR is to hold encoded values. Integers are
    /// clipped to [0, 1] and rounded to the nearest; EXR is not clipped, and gets what `head` says and what its file has beyond the frame. Alpha,
    /// by which colour is premultiplied, is written to EXR alone.
    ///
    /// # Errors
    /// If the file cannot be written; no part of it is left.
    pub fn write(
        self,
        path: &Path,
        frame: &Encoded,
        alpha: Option<&Plane>,
        head: Option<&exr::ExrHead>,
        coding: &Coding,
    ) -> Result<()> {
        self.write_around(path, (frame, Overscan::default()), alpha, head, coding)
    }

    /// [`FrameFormat::write`] of a picture that reaches beyond the frame as far as `overscan` says, which EXR alone can hold; what `head` has
    /// there is left out.
    ///
    /// # Errors
    /// If the file cannot be written; no part of it is left.
    pub fn write_around(
        self,
        path: &Path,
        (frame, overscan): (&Encoded, Overscan),
        alpha: Option<&Plane>,
        head: Option<&exr::ExrHead>,
        coding: &Coding,
    ) -> Result<()> {
        let coded = (!coding.keeps()).then(|| Encoded(frame.0.map(|p| coding.pixel(p))));
        let frame = coded.as_ref().unwrap_or(frame);
        let cut = (!self.is_exr() && !overscan.is_none()).then(|| Encoded(overscan.frame_of(&frame.0)));
        let frame = cut.as_ref().unwrap_or(frame);
        match (self.kind, self.bits) {
            (FileKind::Png, 8) => write_png_with(path, frame, coding.profile()),
            (FileKind::Png, _) => write_png16_with(path, frame, coding.profile()),
            (FileKind::Tiff, bits) => write_tiff(path, frame, bits, coding.profile()),
            (FileKind::Exr, bits) => {
                // Alpha ends with the frame, so that colour beyond it would not be premultiplied by any.
                let beyond = head.and_then(|h| h.beyond.as_deref());
                let beyond = beyond.filter(|b| {
                    let around = b.overscan.frame_size(b.values.0.size()) == frame.0.size();
                    around && alpha.is_none() && overscan.is_none()
                });
                let whole = beyond.map(|beyond| {
                    let mut whole = beyond.values.0.map(|p| coding.pixel_of(p, &beyond.space));
                    beyond.overscan.put_frame(&frame.0, &mut whole);
                    (Encoded(whole), beyond.overscan)
                });
                let (frame, overscan) = whole.as_ref().map_or((frame, overscan), |(f, o)| (f, *o));
                let channels = [0, 1, 2].map(|c| exr::Written {
                    name: ["R", "G", "B"][c],
                    bits,
                    values: frame.0.data().iter().map(|p| p[c]).collect(),
                });
                let alpha = alpha.map(|a| exr::Written { name: "A", bits, values: a.data().to_vec() });
                let channels = channels.into_iter().chain(alpha);
                exr::write(path, (frame.0.size(), overscan), channels, head, &coding.file().primaries)
            }
        }
    }
}

impl std::str::FromStr for FileKind {
    type Err = blindaug::Error;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        Self::of_extension(text)
            .ok_or_else(|| blindaug::Error::new(format!("\"{text}\" is no format: exr, png or tiff")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{read_frame, read_linear};
    use blindaug::{Raster, Transfer, colour_space::ColourSpace};

    /// Frames in sRGB, into EXR as light.
    fn as_srgb(format: FrameFormat) -> Coding {
        let file = if format.is_exr() { ColourSpace::LINEAR_SRGB } else { ColourSpace::SRGB };
        Coding::new(ColourSpace::SRGB, file)
    }

    fn frame() -> Encoded {
        Encoded(Raster::from_fn(21, 9, |x, y| [x as f32 / 20.0, y as f32 / 8.0, 0.1234 + 0.01 * x as f32]))
    }

    /// The largest difference of a frame that was written and read again.
    fn lost(format: FrameFormat, frame: &Encoded) -> f32 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1").with_extension(format.kind().extension());
        format.write(&path, frame, None, None, &as_srgb(format)).unwrap();
        assert_eq!(FrameFormat::of_file(&path).unwrap().with(Some(format.kind()), None).unwrap(), format);
        let again = read_frame(&path).unwrap();
        let pairs = again.0.data().iter().flatten().zip(frame.0.data().iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn every_format_keeps_as_much_as_its_bits_hold() {
        let of = |kind, bits| FrameFormat::PNG8.with(Some(kind), Some(bits)).unwrap();
        // Half a step of 8 and of 16 bits; half floats have 11 significant bits, and encoding halves a relative error at least.
        for (format, most, least) in [
            (of(FileKind::Png, 8), 0.5001 / 255.0, 0.2 / 255.0),
            (of(FileKind::Tiff, 8), 0.5001 / 255.0, 0.2 / 255.0),
            (of(FileKind::Png, 16), 0.5001 / 65535.0, 0.0),
            (of(FileKind::Tiff, 16), 0.5001 / 65535.0, 0.0),
            (of(FileKind::Exr, 16), 0.5 / 2048.0, 1e-5),
            (of(FileKind::Exr, 32), 2e-6, 0.0),
        ] {
            let lost = lost(format, &frame());
            assert!(lost <= most && lost >= least, "{format:?}: {lost}");
        }
    }

    #[test]
    fn exr_keeps_light_above_white() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1.exr");
        let bright = Encoded(Raster::filled(3, 2, [0.2, 1.0, 3.0]));
        FrameFormat::PNG8
            .with(Some(FileKind::Exr), None)
            .unwrap()
            .write(&path, &bright, None, None, &Coding::new(ColourSpace::SRGB, ColourSpace::LINEAR_SRGB))
            .unwrap();
        let [_, white, above] = read_linear(&path).unwrap().0.at(1, 1);
        assert!((white - 1.0).abs() < 1e-3 && (above / Transfer::Srgb.decode(3.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn formats_are_chosen_by_kind_and_bits() {
        let half = FrameFormat { kind: FileKind::Exr, bits: 16 };
        let with = |from: FrameFormat, kind, bits| from.with(kind, bits).map(|f| (f.kind, f.bits));
        assert_eq!(with(FrameFormat::PNG8, Some(FileKind::Exr), None), Ok((FileKind::Exr, 16)));
        assert_eq!(with(half, Some(FileKind::Png), None), Ok((FileKind::Png, 16)));
        assert_eq!(with(half, Some(FileKind::Tiff), Some(8)), Ok((FileKind::Tiff, 8)));
        assert_eq!(with(half, None, Some(32)), Ok((FileKind::Exr, 32)));
        assert!(with(half, None, Some(8)).unwrap_err().to_string().contains("16 or 32 bits"));
        assert!("jpg".parse::<FileKind>().is_err() && "TIFF".parse() == Ok(FileKind::Tiff));
    }
}
