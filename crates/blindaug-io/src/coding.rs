//! The colour spaces of files, and the curve of the frames that are read from them and written to them.

use crate::{IccProfile, Result, exr, image::read_values, limits::is_exr, not_numbers::Counted};
use blindaug::{
    Encoded, Transfer,
    colour_space::{ColourSpace, Matrix, conversion, converted},
};
use std::path::Path;

/// How frames are read: the colour space of the files' values, and the curve of the frames that come out. Colours keep the primaries of
/// the files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The space of EXR files; `None` for light in the primaries that each file's head tells, sRGB's if it tells none.
    pub exr: Option<ColourSpace>,
    /// The space of all other images.
    pub integers: ColourSpace,
    /// The curve of the frames that come out.
    pub transfer: Transfer,
    /// Whether light below 0, which EXR files may hold, is kept; else it becomes 0.
    pub below_zero: bool,
}

impl Default for Reading {
    /// What files say, with integers as sRGB if they say nothing; frames come out as sRGB.
    fn default() -> Self {
        Self { exr: None, integers: ColourSpace::SRGB, transfer: Transfer::Srgb, below_zero: false }
    }
}

impl Reading {
    /// The colour space of a file's values.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub(crate) fn space_of(&self, path: &Path) -> Result<ColourSpace> {
        if !is_exr(path)? {
            return Ok(self.integers);
        }
        let of_head = || Ok(ColourSpace { primaries: exr::primaries(path)?, transfer: Transfer::Linear });
        self.exr.map_or_else(of_head, Ok)
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// The same as [`crate::read_frame`].
    pub fn read(&self, path: impl AsRef<Path>) -> Result<Encoded> {
        Ok(self.read_counted(path.as_ref())?.0)
    }

    /// [`Reading::read`], with the number of pixels that were not numbers (NaN) and became 0.
    pub(crate) fn read_counted(&self, path: &Path) -> Result<Counted<Encoded>> {
        let from = if is_exr(path)? {
            self.exr.map_or(Transfer::Linear, |space| space.transfer)
        } else {
            self.integers.transfer
        };
        let (values, not_numbers) = read_values(path, self.below_zero)?;
        Ok((recoded(values, from, self.transfer), not_numbers))
    }
}

/// Values of one curve as those of another.
pub(crate) fn recoded(values: Encoded, from: Transfer, to: Transfer) -> Encoded {
    match from == to {
        true => values,
        false => Encoded(values.0.map(|p| p.map(|v| to.encode(from.decode(v))))),
    }
}

/// How frames are written: their own colour space, and that of the files.
#[derive(Clone, Debug, PartialEq)]
pub struct Coding {
    frames: ColourSpace,
    file: ColourSpace,
    matrix: Option<Matrix>,
    profile: Option<IccProfile>,
}

impl Default for Coding {
    /// Frames in sRGB into files in sRGB.
    fn default() -> Self {
        Self::new(ColourSpace::SRGB, ColourSpace::SRGB)
    }
}

impl Coding {
    /// Frames of one colour space into files of another.
    pub fn new(frames: ColourSpace, file: ColourSpace) -> Self {
        Self { frames, file, matrix: conversion(frames.primaries, file.primaries), profile: None }
    }

    /// The same, with an ICC profile that PNG and TIFF files get.
    pub fn with_profile(self, profile: Option<IccProfile>) -> Self {
        Self { profile, ..self }
    }

    /// The ICC profile that PNG and TIFF files get.
    pub fn profile(&self) -> Option<&IccProfile> {
        self.profile.as_ref()
    }

    /// The colour space of the files.
    pub fn file(&self) -> ColourSpace {
        self.file
    }

    /// The light of a frame's pixel in the primaries of the file. Light is linear: this holds for differences of light as well.
    pub fn light(&self, light: [f32; 3]) -> [f32; 3] {
        self.matrix.as_ref().map_or(light, |matrix| converted(matrix, light))
    }

    /// Whether files hold the frames' own values.
    pub fn keeps(&self) -> bool {
        self.frames == self.file
    }

    /// The values in the file of a pixel of another file, whose colour space has the frames' primaries.
    pub(crate) fn pixel_of(&self, values: [f32; 3], space: &ColourSpace) -> [f32; 3] {
        if *space == self.file {
            return values;
        }
        self.light(values.map(|v| space.transfer.decode(v))).map(|v| self.file.transfer.encode(v))
    }

    /// The values of a frame's pixel in the file.
    pub fn pixel(&self, values: [f32; 3]) -> [f32; 3] {
        if self.keeps() {
            return values;
        }
        let light = self.light(values.map(|v| self.frames.transfer.decode(v)));
        light.map(|v| self.file.transfer.encode(v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ExrHead, FileKind, FrameFormat};
    use blindaug::{Raster, colour_space::Primaries};

    /// The largest difference of two frames.
    fn difference(a: &Encoded, b: &Encoded) -> f32 {
        let pairs = a.0.data().iter().flatten().zip(b.0.data().iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn frames_go_through_files_of_every_space_and_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let log = Transfer::SLog3;
        let frames = ColourSpace { transfer: log, .."s-log3".parse().unwrap() };
        let frame =
            Encoded(Raster::from_fn(9, 7, |x, y| [0.2 + 0.04 * x as f32, 0.25 + 0.04 * y as f32, 0.4]));
        for (name, file, _) in ColourSpace::NAMED {
            let kind = if file.transfer == Transfer::Linear { FileKind::Exr } else { FileKind::Tiff };
            let format = FrameFormat::PNG8
                .with(Some(kind), Some(if kind == FileKind::Exr { 32 } else { 16 }))
                .unwrap();
            let path = folder.path().join(name).with_extension(kind.extension());
            // All these colours lie within the wide spaces; the camera's own are the only ones sure to hold them unclipped.
            let same = ColourSpace { primaries: frames.primaries, ..file };
            format.write(&path, &frame, None, None, &Coding::new(frames, same)).unwrap();
            let reading = Reading { exr: Some(same), integers: same, transfer: log, below_zero: false };
            let lost = difference(&reading.read(&path).unwrap(), &frame);
            assert!(lost < 1e-3, "{name}: {lost}");
            // Negative control: the values themselves are others.
            let as_log = Reading { exr: Some(frames), integers: frames, ..reading };
            let values = difference(&as_log.read(&path).unwrap(), &frame);
            assert!((values > 0.01) == (file.transfer != log), "{name}: {values}");
        }
    }

    #[test]
    fn an_exr_file_tells_its_primaries() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1.exr");
        let half = FrameFormat::PNG8.with(Some(FileKind::Exr), None).unwrap();
        let grey = Encoded(Raster::filled(3, 2, [0.5; 3]));
        let acescg: ColourSpace = "acescg".parse().unwrap();
        half.write(&path, &grey, None, None, &Coding::new(ColourSpace::SRGB, acescg)).unwrap();
        assert_eq!(Reading::default().space_of(&path).unwrap(), acescg);
        // A head of a plate in other primaries does not stay.
        let head = ExrHead::read(&path).unwrap();
        half.write(
            &path,
            &grey,
            None,
            Some(&head),
            &Coding::new(ColourSpace::SRGB, ColourSpace::LINEAR_SRGB),
        )
        .unwrap();
        let space = Reading::default().space_of(&path).unwrap();
        assert_eq!((space, space.primaries), (ColourSpace::LINEAR_SRGB, Primaries::REC709));
        // Grey is grey in all of them.
        let read = Reading::default().read(&path).unwrap();
        assert!(difference(&read, &grey) < 1e-3);
    }
}
