//! Images with repeated edge pixels, so that optical flow can read beyond the edges.

use crate::{Plane, par};

/// The side of a patch, px. An image is padded to hold one.
pub(super) const PATCH: usize = 8;

/// The width, in px, of the repeated edge around an image, so that patches may leave the image.
pub(super) const PAD: usize = 16;

/// An image with its edge pixels repeated [`PAD`] times on each side, and more on the right and below if a patch would not fit in.
pub(super) struct Padded {
    /// Width without the padding, px.
    pub w: usize,
    /// Height without the padding, px.
    pub h: usize,
    /// Width with the padding, px.
    pub stride: usize,
    /// The rows of the image with the padding.
    pub data: Vec<f32>,
}

impl Padded {
    pub fn new(p: &Plane) -> Self {
        let (w, h) = p.size();
        let stride = w.max(PATCH) + 2 * PAD;
        let mut data = vec![0.0; stride * (h.max(PATCH) + 2 * PAD)];
        par::for_each_row(&mut data, stride, |y, out| {
            let row = p.row(y.saturating_sub(PAD).min(h - 1));
            out[..PAD].fill(row[0]);
            out[PAD..PAD + w].copy_from_slice(row);
            out[PAD + w..].fill(row[w - 1]);
        });
        Self { w, h, stride, data }
    }

    /// The data from a pixel on, whose coordinates count the padding.
    #[inline(always)]
    pub fn from(&self, x: usize, y: usize) -> &[f32] {
        &self.data[y * self.stride + x..]
    }

    /// The pixels of row `y` of the image, with `margin` more on both sides.
    #[inline(always)]
    pub fn row(&self, y: isize, margin: usize) -> &[f32] {
        &self.from(PAD - margin, (y + PAD as isize) as usize)[..self.w + 2 * margin]
    }

    /// The corner of `size` x `size` pixels for bilinear interpolation at (x, y): its pixel, counted with the padding, and the fractions.
    #[inline(always)]
    pub fn place(&self, x: f32, y: f32, size: usize) -> (usize, usize, f32, f32) {
        // The methods of floats, which look for NaN, are calls in WebAssembly.
        let within = |v: f32, most: usize| {
            let (v, most) = (if v > 0.0 { v } else { 0.0 }, most as f32);
            if v < most { v } else { most }
        };
        let x = within(x + PAD as f32, self.stride - size - 1);
        let y = within(y + PAD as f32, self.data.len() / self.stride - size - 1);
        let (xi, yi) = (x as i32, y as i32);
        (xi as usize, yi as usize, x - xi as f32, y - yi as f32)
    }
}

/// Splits a slice into the `K` rows of `w` values that it holds one after another.
#[inline(always)]
pub(super) fn split<const K: usize>(rows: &[f32], w: usize) -> [&[f32]; K] {
    std::array::from_fn(|k| &rows[k * w..][..w])
}

/// Splits a slice into the `K` rows of `w` values that it holds one after another.
#[inline(always)]
pub(super) fn split_mut<const K: usize>(rows: &mut [f32], w: usize) -> [&mut [f32]; K] {
    let mut rest = rows;
    std::array::from_fn(|_| {
        let (row, others) = std::mem::take(&mut rest).split_at_mut(w);
        rest = others;
        row
    })
}
