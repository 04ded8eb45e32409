//! Decoded video frames in YCbCr, and their conversion to RGB.
//!
//! The conversion is our own code, because ffmpeg's scaler repeats chroma samples by default, and with its more accurate settings
//! puts them half a pixel too low. Frames of both decoders are converted by this code, so that they agree.

use blindaug::{Encoded, Raster};

/// The layout of a planar YCbCr frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct YuvFormat {
    /// Width and height of luma, px.
    pub size: (usize, usize),
    /// log2 of luma columns and rows per chroma sample: (1, 1) is 4:2:0.
    pub chroma_shift: (u32, u32),
    /// Bits per sample, 8 to 16. Samples of more than 8 bits take two bytes, the low one first.
    pub bits: u32,
}

impl YuvFormat {
    /// Columns and rows of a chroma plane, samples.
    pub(crate) fn chroma_size(self) -> (usize, usize) {
        let part = |n: usize, shift: u32| n.div_ceil(1 << shift);
        (part(self.size.0, self.chroma_shift.0), part(self.size.1, self.chroma_shift.1))
    }

    fn bytes_per_sample(self) -> usize {
        if self.bits > 8 { 2 } else { 1 }
    }

    /// The number of bytes of a frame.
    pub(crate) fn bytes(self) -> usize {
        let (w, h) = self.chroma_size();
        (self.size.0 * self.size.1 + 2 * w * h) * self.bytes_per_sample()
    }
}

/// A frame: the samples of Y, then Cb, then Cr, row by row.
pub(crate) struct YuvFrame {
    pub format: YuvFormat,
    /// The samples as [`YuvFormat::bytes`] bytes.
    pub data: Vec<u8>,
}

/// The coding of RGB as YCbCr.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Colour {
    /// Weights of red (`kr`) and blue (`kb`) in luma.
    kr: f32,
    kb: f32,
    full_range: bool,
    /// Whether chroma samples lie between luma columns (JPEG), not on them (MPEG-2 and later). They always lie between luma rows.
    centred_chroma: bool,
}

impl Colour {
    /// The coding for a `matrix` index of Table E-5 of Rec. ITU-T H.264. Other indices and "unspecified" stand for Rec. 709 if the
    /// picture is at least 720 px high, else for Rec. 601.
    pub(crate) fn new(matrix: u32, height: usize, full_range: bool, centred_chroma: bool) -> Self {
        let (kr, kb) = match matrix {
            1 => (0.2126, 0.0722),
            4 => (0.30, 0.11),
            5 | 6 => (0.299, 0.114),
            7 => (0.212, 0.087),
            9 | 10 => (0.2627, 0.0593),
            _ if height >= 720 => (0.2126, 0.0722),
            _ => (0.299, 0.114),
        };
        Self { kr, kb, full_range, centred_chroma }
    }
}

impl YuvFrame {
    /// The frame as RGB in [0, 1]; chroma is interpolated linearly.
    pub(crate) fn to_encoded(&self, colour: Colour) -> Encoded {
        let YuvFormat { size: (width, height), chroma_shift, bits } = self.format;
        let (chroma_width, chroma_height) = self.format.chroma_size();
        let cb_start = width * height;
        let planes = [cb_start, cb_start + chroma_width * chroma_height];
        let step = (1u32 << (bits - 8)) as f32;
        let largest = ((1u32 << bits) - 1) as f32;
        let (black, luma_range, chroma_range) = if colour.full_range {
            (0.0, largest, largest)
        } else {
            (16.0 * step, 219.0 * step, 224.0 * step)
        };
        let Colour { kr, kb, .. } = colour;
        let (red, blue) = (2.0 * (1.0 - kr) / chroma_range, 2.0 * (1.0 - kb) / chroma_range);
        let (green_cr, green_cb) = (kr * red / (1.0 - kr - kb), kb * blue / (1.0 - kr - kb));

        let mut out = Raster::filled(width, height, [0.0; 3]);
        let mut luma = vec![0.0; width];
        let (mut upper, mut lower) = (vec![0.0; chroma_width], vec![0.0; chroma_width]);
        let mut chroma = [vec![0.0; width], vec![0.0; width]];
        for y in 0..height {
            self.samples(y * width, &mut luma);
            let (top, bottom, weight) = rows_around(y, chroma_shift.1, chroma_height);
            for (start, row) in planes.iter().zip(&mut chroma) {
                self.samples(start + top * chroma_width, &mut upper);
                self.samples(start + bottom * chroma_width, &mut lower);
                for (u, l) in upper.iter_mut().zip(&lower) {
                    *u += weight * (l - *u) - 128.0 * step;
                }
                widen(&upper, chroma_shift.0, colour.centred_chroma, row);
            }
            let [cb, cr] = &chroma;
            for (((rgb, &l), &cb), &cr) in out.row_mut(y).iter_mut().zip(&luma).zip(cb).zip(cr) {
                let l = (l - black) / luma_range;
                let [r, g, b] = [l + red * cr, l - green_cr * cr - green_cb * cb, l + blue * cb];
                *rgb = [r.clamp(0.0, 1.0), g.clamp(0.0, 1.0), b.clamp(0.0, 1.0)];
            }
        }
        Encoded(out)
    }

    /// Reads the samples from index `start` on into `out`.
    fn samples(&self, start: usize, out: &mut [f32]) {
        if self.format.bits > 8 {
            let stored = &self.data.as_chunks::<2>().0[start..];
            out.iter_mut().zip(stored).for_each(|(o, &s)| *o = f32::from(u16::from_le_bytes(s)));
        } else {
            out.iter_mut().zip(&self.data[start..]).for_each(|(o, &s)| *o = f32::from(s));
        }
    }
}

/// The two chroma rows around a luma row, and the weight of the second one. Chroma rows lie between luma rows.
fn rows_around(y: usize, shift: u32, rows: usize) -> (usize, usize, f32) {
    match (shift, y % 2) {
        (0, _) => (y, y, 0.0),
        (_, 0) => ((y / 2).saturating_sub(1), y / 2, 0.75),
        (_, _) => (y / 2, (y / 2 + 1).min(rows - 1), 0.25),
    }
}

/// Interpolates a row of chroma samples to all luma columns.
fn widen(chroma: &[f32], shift: u32, centred: bool, out: &mut [f32]) {
    if shift == 0 {
        out.copy_from_slice(chroma);
        return;
    }
    let last = chroma.len() - 1;
    let pair = |i: usize| {
        let (before, here, after) = (chroma[i.saturating_sub(1)], chroma[i], chroma[(i + 1).min(last)]);
        if centred {
            [0.75 * here + 0.25 * before, 0.75 * here + 0.25 * after]
        } else {
            [here, 0.5 * (here + after)]
        }
    };
    let (pairs, rest) = out.as_chunks_mut::<2>();
    let whole = pairs.len();
    pairs.iter_mut().enumerate().for_each(|(i, out)| *out = pair(i));
    rest.iter_mut().for_each(|out| *out = pair(whole)[0]);
}

/// The frame turned clockwise by `quarter_turns` times 90 degrees.
pub(crate) fn turned(image: Encoded, quarter_turns: u8) -> Encoded {
    let i = &image.0;
    let (w, h) = i.size();
    Encoded(match quarter_turns {
        1 => Raster::from_fn(h, w, |x, y| i.at(y, h - 1 - x)),
        2 => Raster::from_fn(w, h, |x, y| i.at(w - 1 - x, h - 1 - y)),
        3 => Raster::from_fn(h, w, |x, y| i.at(w - 1 - y, x)),
        _ => return image,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(
        size: (usize, usize),
        shift: (u32, u32),
        bits: u32,
        value: impl Fn(usize, usize, usize) -> u16,
    ) -> YuvFrame {
        let format = YuvFormat { size, chroma_shift: shift, bits };
        let mut data = Vec::new();
        for plane in 0..3 {
            let (w, h) = if plane == 0 { size } else { format.chroma_size() };
            for y in 0..h {
                for x in 0..w {
                    let bytes = value(plane, x, y).to_le_bytes();
                    data.extend(&bytes[..format.bytes_per_sample()]);
                }
            }
        }
        assert_eq!(data.len(), format.bytes());
        YuvFrame { format, data }
    }

    #[test]
    fn known_colours() {
        // 8-bit code values of saturated colours (limited range), from the equations of Rec. 709 (matrix 1) and Rec. 601 (6 and 2).
        for (matrix, ycc, rgb) in [
            (1, [63, 102, 240], [1.0, 0.0, 0.0]),
            (1, [173, 42, 26], [0.0, 1.0, 0.0]),
            (6, [41, 240, 110], [0.0, 0.0, 1.0]),
            (6, [235, 128, 128], [1.0, 1.0, 1.0]),
            (2, [16, 128, 128], [0.0, 0.0, 0.0]),
        ] {
            for bits in [8, 10] {
                let f = frame((3, 3), (1, 1), bits, |p, _, _| ycc[p] << (bits - 8));
                let out = f.to_encoded(Colour::new(matrix, 100, false, false)).0.at(2, 2);
                assert!(
                    (0..3).all(|c| (out[c] - rgb[c]).abs() < 0.01f32),
                    "{matrix} {bits}: {out:?} {rgb:?}"
                );
            }
        }
        let full = frame((2, 2), (0, 0), 16, |p, _, _| if p == 0 { u16::MAX } else { 1 << 15 });
        let out = full.to_encoded(Colour::new(1, 100, true, false)).0.at(0, 0);
        assert!(out.iter().all(|v| (v - 1.0).abs() < 1e-3), "{out:?}");
    }

    #[test]
    fn a_ramp_of_chroma_stays_a_ramp_at_its_place() {
        for (shift, centred) in [((1, 1), false), ((1, 1), true), ((1, 0), false), ((0, 0), false)] {
            // The position of a chroma sample in luma coordinates, px.
            let place = |i: usize, shift: u32, centred: bool| {
                (i << shift) as f32 + if centred && shift == 1 { 0.5 } else { 0.0 }
            };
            let f = frame((20, 12), shift, 16, |p, x, y| match p {
                0 => 30_000,
                1 => (32_768.0 + 100.0 * place(x, shift.0, centred)) as u16,
                _ => (32_768.0 + 100.0 * place(y, shift.1, true)) as u16,
            });
            let out = f.to_encoded(Colour::new(1, 100, true, centred));
            let (kr, kb) = (0.2126, 0.0722);
            for y in 2..10 {
                for x in 2..18 {
                    let [r, _, b] = out.0.at(x, y);
                    let luma = 30_000.0 / 65_535.0;
                    let blue = luma + 2.0 * (1.0 - kb) * 100.0 * x as f32 / 65_535.0;
                    let red = luma + 2.0 * (1.0 - kr) * 100.0 * y as f32 / 65_535.0;
                    assert!((b - blue).abs() < 1e-4 && (r - red).abs() < 1e-4, "{shift:?} {centred} {x} {y}");
                }
            }
        }
    }

    #[test]
    fn four_quarter_turns_are_none() {
        let i = Encoded(Raster::from_fn(3, 2, |x, y| [x as f32, y as f32, 0.0]));
        let once = turned(i.clone(), 1);
        assert_eq!((once.0.size(), once.0.at(1, 0)), ((2, 3), [0.0, 0.0, 0.0]));
        assert_eq!(turned(once.clone(), 1), turned(i.clone(), 2));
        assert_eq!(turned(once.clone(), 2), turned(i.clone(), 3));
        assert_eq!(turned(once, 3), i);
    }
}
