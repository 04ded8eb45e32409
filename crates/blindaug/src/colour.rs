//! Frames and layers in their colour spaces, as types: display-encoded, scene-linear, premultiplied.

use crate::{Error, Plane, Raster, Result, Transfer};

/// A display-encoded frame (what a camera records and a screen shows), RGB, nominally in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Encoded(pub Raster<[f32; 3]>);

/// A frame in linear light, RGB, >= 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear(pub Raster<[f32; 3]>);

/// A layer in linear light, RGB premultiplied by its alpha, alpha in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Premultiplied(pub Raster<[f32; 4]>);

impl Premultiplied {
    /// The alpha of light that covers nothing, such as that of fire, flares and glows. Where alpha is 0 there is no layer.
    pub const LIGHT_ALONE: f32 = 1e-4;

    /// A layer from what renderers give ([`Premultiplied::of_rendered`]).
    pub fn from_render(render: &Raster<[f32; 4]>) -> Self {
        Self(render.map(Self::of_rendered))
    }

    /// A pixel of a layer from premultiplied R, G, B and A in linear light as renderers give them: light becomes [`finite_light`] of at least 0,
    /// and alpha is clamped to [0, 1], where NaN becomes 0. Light that covers nothing is kept: it gets an alpha of
    /// [`LIGHT_ALONE`](Self::LIGHT_ALONE).
    pub fn of_rendered([r, g, b, a]: [f32; 4]) -> [f32; 4] {
        /// A quarter of the least 8-bit step; renderers leave less where there is nothing.
        const LEAST_LIGHT: f32 = 8e-5;
        let [r, g, b] = [r, g, b].map(|v| finite_light(v, 0.0));
        let alpha = match a {
            a if a.is_nan() => 0.0,
            a if a <= 0.0 && r.max(g).max(b) > LEAST_LIGHT => Self::LIGHT_ALONE,
            a => a.clamp(0.0, 1.0),
        };
        [r, g, b, alpha]
    }

    /// The share of the pixels with light that covers nothing, in [0, 1].
    pub fn share_of_light_alone(&self) -> f32 {
        let pixels = self.0.data();
        pixels.iter().filter(|p| p[3] == Self::LIGHT_ALONE).count() as f32 / pixels.len().max(1) as f32
    }
}

/// The largest light that is worked on: the largest finite 16-bit float, so that sums over a renderer's fireflies stay finite.
pub const BRIGHTEST: f32 = 65_504.0;

/// Light of which sums stay finite: NaN becomes 0, and all else is clamped between `least` and [`BRIGHTEST`].
pub fn finite_light(v: f32, least: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(least, BRIGHTEST) }
}

/// The 8-bit value nearest to an encoded value, as files, canvases and textures hold it.
pub fn byte_from_encoded(v: f32) -> u8 {
    // The cast saturates, and maps NaN to 0.
    (255.0 * v + 0.5) as u8
}

/// The 16-bit value nearest to an encoded value, as files, canvases and textures hold it.
pub fn word_from_encoded(v: f32) -> u16 {
    (v.clamp(0.0, 1.0) * 65535.0).round() as u16
}

/// A plane of bytes in memory, such as a camera or a graphics device hands over: rows from the top, each of `bytes_per_row` bytes, of which
/// the last ones may be padding.
#[derive(Clone, Copy, Debug)]
pub struct ByteRows<'a> {
    /// The bytes of all rows; the padding of the last row may be missing.
    pub bytes: &'a [u8],
    /// The distance from the beginning of a row to that of the next one, bytes.
    pub bytes_per_row: usize,
}

impl<'a> ByteRows<'a> {
    /// ByteRows without padding, `bytes_per_row` bytes each.
    pub fn new(bytes: &'a [u8], bytes_per_row: usize) -> Self {
        Self { bytes, bytes_per_row }
    }

    /// Checks that there are `rows` rows of at least `used` bytes.
    fn check(&self, what: &str, used: usize, rows: usize) -> Result<()> {
        let Self { bytes, bytes_per_row } = *self;
        let needed = rows.checked_sub(1).and_then(|r| r.checked_mul(bytes_per_row)?.checked_add(used));
        if used == 0 || bytes_per_row < used || needed.is_none_or(|n| bytes.len() < n) {
            return Err(Error::new(format!(
                "{what} has {} bytes in rows of {bytes_per_row}, but must have {rows} rows of {used} or more, and at least one",
                bytes.len(),
            )));
        }
        Ok(())
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        f32::from(self.bytes[y * self.bytes_per_row + x])
    }
}

impl Encoded {
    /// A frame of `width` x `height` px from bytes R, G, B, A for each pixel, 0 to 255; alpha is not looked at.
    ///
    /// ```
    /// use blindaug::{ByteRows, Encoded};
    /// let bytes = [255, 0, 51, 255, 0, 255, 0, 255];
    /// let frame = Encoded::from_rgba8((2, 1), ByteRows::new(&bytes, 8))?;
    /// assert_eq!(frame.0.at(0, 0), [1.0, 0.0, 0.2]);
    /// # Ok::<(), blindaug::Error>(())
    /// ```
    ///
    /// # Errors
    /// If there are no pixels, or fewer bytes than the pixels need.
    pub fn from_rgba8((width, height): (usize, usize), rgba: ByteRows) -> Result<Self> {
        rgba.check("a frame of R, G, B, A", width.saturating_mul(4), height)?;
        let value = |x, y| rgba.at(x, y) / 255.0;
        Ok(Self(Raster::from_fn(width, height, |x, y| std::array::from_fn(|c| value(4 * x + c, y)))))
    }

    /// A frame of `width` x `height` px from NV12, as cameras and video decoders give it: a plane of Y', and one of half the size (rounded
    /// up) of Cb and Cr side by side. The colours are those of Rec. 709 in its limited range (Y' from 16 to 235, Cb and Cr from 16 to 240);
    /// what lies beyond is clamped. Cb and Cr are interpolated; each pair lies on the left one of its four pixels, between the two rows.
    ///
    /// # Errors
    /// If there are no pixels, or fewer bytes than the pixels need.
    pub fn from_nv12((width, height): (usize, usize), luma: ByteRows, chroma: ByteRows) -> Result<Self> {
        let (w, h) = (width.div_ceil(2), height.div_ceil(2));
        luma.check("a plane of Y'", width, height)?;
        chroma.check("a plane of Cb and Cr", w.saturating_mul(2), h)?;
        Ok(Self(Raster::from_fn(width, height, |x, y| {
            // The pair of this pixel, and the nearest other one with the share that it has.
            let (i, j) = (x / 2, y / 2);
            let (right, across) = if x % 2 == 1 { ((i + 1).min(w - 1), 0.5) } else { (i, 0.0) };
            let other = if y % 2 == 1 { (j + 1).min(h - 1) } else { j.saturating_sub(1) };
            let [cb, cr] = [0, 1].map(|c| {
                let row = |j: usize| {
                    (1.0 - across) * chroma.at(2 * i + c, j) + across * chroma.at(2 * right + c, j)
                };
                (0.75 * row(j) + 0.25 * row(other) - 128.0) / 224.0
            });
            let y = (luma.at(x, y) - 16.0) / 219.0;
            let rgb = [y + 1.5748 * cr, y - 0.187_324 * cb - 0.468_124 * cr, y + 1.8556 * cb];
            rgb.map(|v| v.clamp(0.0, 1.0))
        })))
    }

    /// The same frame in linear light.
    pub fn to_linear(&self, transfer: Transfer) -> Linear {
        Linear(self.0.map(|p| p.map(|v| transfer.decode(v))))
    }

    /// Y of YCbCr (Rec. 601) of the encoded values: the luminance on which the noise model depends.
    pub fn luma(&self) -> Plane {
        self.0.map(luma)
    }
}

impl Linear {
    /// The same frame, display-encoded.
    pub fn to_encoded(&self, transfer: Transfer) -> Encoded {
        Encoded(self.0.map(|p| p.map(|v| transfer.encode(v))))
    }
}

impl Premultiplied {
    /// A layer whose colour was display-encoded before it was premultiplied by its alpha, as programs have it that composite encoded values.
    pub fn from_encoded(values: &Raster<[f32; 4]>, transfer: Transfer) -> Self {
        Self(values.map(|[r, g, b, a]| {
            // Colour without alpha is light that is added.
            let alpha = if a > 0.0 { a } else { 1.0 };
            let [r, g, b] = [r, g, b].map(|v| alpha * transfer.decode(v / alpha));
            [r, g, b, a]
        }))
    }
}

/// Weights of R, G and B in Y of YCbCr (Rec. 601).
pub const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Y of YCbCr (Rec. 601) of encoded RGB; of linear RGB, the sum with the same weights.
#[inline]
pub fn luma([r, g, b]: [f32; 3]) -> f32 {
    LUMA[0] * r + LUMA[1] * g + LUMA[2] * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_renderers_write_becomes_a_layer() {
        let of = |pixel: [f32; 4]| Premultiplied::from_render(&Raster::filled(1, 1, pixel)).0.at(0, 0);
        assert_eq!(of([0.5, f32::NAN, -1.0, 1.5]), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(of([f32::INFINITY, 0.0, 0.0, 0.5]), [BRIGHTEST, 0.0, 0.0, 0.5]);
        assert_eq!(of([0.5, 0.0, 0.0, 0.0]), [0.5, 0.0, 0.0, Premultiplied::LIGHT_ALONE]);
        // What a renderer leaves where there is nothing, and what is no number, is no layer.
        assert_eq!((of([1e-5, 0.0, 0.0, 0.0])[3], of([0.5, 0.0, 0.0, f32::NAN])[3]), (0.0, 0.0));
    }

    #[test]
    fn bytes_of_colours_and_of_video_become_frames() {
        let bytes = [10, 20, 30, 0, 40, 50, 60, 0, 99, 99, 99, 99, 255, 0, 255, 7, 0, 0, 0, 7];
        let frame = Encoded::from_rgba8((2, 2), ByteRows::new(&bytes, 12)).unwrap();
        assert_eq!(frame.0.at(1, 0), [40.0, 50.0, 60.0].map(|v| v / 255.0));
        assert_eq!(frame.0.at(0, 1), [1.0, 0.0, 1.0]);
        // Bars of 75 % in Rec. 709 (ITU-R BT.709, rounded to 8 bits): white, yellow, cyan, green, magenta, red, blue, black.
        let bars = [
            ([180, 128, 128], [0.75, 0.75, 0.75]),
            ([168, 44, 136], [0.75, 0.75, 0.0]),
            ([145, 147, 44], [0.0, 0.75, 0.75]),
            ([134, 63, 52], [0.0, 0.75, 0.0]),
            ([63, 193, 204], [0.75, 0.0, 0.75]),
            ([51, 109, 212], [0.75, 0.0, 0.0]),
            ([28, 212, 120], [0.0, 0.0, 0.75]),
            ([16, 128, 128], [0.0, 0.0, 0.0]),
        ];
        for ([y, cb, cr], want) in bars {
            // The size is odd, and rows are padded.
            let (luma, chroma) = ([y; 3 * 4], [cb, cr].repeat(2 * 3));
            let frame =
                Encoded::from_nv12((3, 3), ByteRows::new(&luma, 4), ByteRows::new(&chroma, 6)).unwrap();
            for got in frame.0.data() {
                assert!(got.iter().zip(want).all(|(g, w)| (g - w).abs() < 0.008), "{got:?} {want:?}");
            }
        }
        // Negative control: red as Rec. 601 has it is another colour.
        let frame =
            Encoded::from_nv12((1, 1), ByteRows::new(&[65], 1), ByteRows::new(&[100, 212], 2)).unwrap();
        assert!((frame.0.at(0, 0)[0] - 0.75).abs() > 0.03, "{frame:?}");
        // Cb rises from left to right and from top to bottom; a pixel on the right, or between two rows, lies between.
        let chroma = [100, 128, 140, 128, 120, 128, 160, 128];
        let frame =
            Encoded::from_nv12((4, 4), ByteRows::new(&[128; 16], 4), ByteRows::new(&chroma, 4)).unwrap();
        let cb = |x, y| 128.0 + 224.0 * (frame.0.at(x, y)[2] - 112.0 / 219.0) / 1.8556;
        for ((x, y), want) in [
            ((0, 0), 100.0),
            ((1, 0), 120.0),
            ((2, 0), 140.0),
            ((0, 1), 105.0),
            ((0, 2), 115.0),
            ((3, 3), 160.0),
        ] {
            assert!((cb(x, y) - want).abs() < 0.01, "({x}, {y}): {} {want}", cb(x, y));
        }
        for (size, bytes, row) in [((2, 2), 15, 8), ((2, 2), 16, 7), ((0, 2), 16, 8), ((2, 0), 16, 8)] {
            let e = Encoded::from_rgba8(size, ByteRows::new(&[0; 16][..bytes], row)).unwrap_err().to_string();
            assert!(e.contains("bytes in rows of") && !e.contains('\n'), "{e}");
        }
        let few = Encoded::from_nv12((4, 4), ByteRows::new(&[0; 16], 4), ByteRows::new(&[0; 7], 4));
        assert!(few.unwrap_err().to_string().contains("Cb and Cr"));
    }

    #[test]
    fn an_encoded_layer_has_the_light_of_its_opaque_colour() {
        let t = Transfer::Srgb;
        let of = |v: [f32; 4]| Premultiplied::from_encoded(&Raster::filled(1, 1, v), t).0.at(0, 0);
        let half = of([0.4, 0.2, 0.0, 0.5]);
        assert!((half[0] - 0.5 * t.decode(0.8)).abs() < 1e-6 && (half[1] - 0.5 * t.decode(0.4)).abs() < 1e-6);
        assert_eq!((half[2], half[3]), (0.0, 0.5));
        // Negative control: the premultiplied value, decoded, is another light.
        assert!((half[0] - t.decode(0.4)).abs() > 0.1);
        assert_eq!(of([0.5, 0.0, 0.0, 0.0]), [t.decode(0.5), 0.0, 0.0, 0.0]);
    }
}
