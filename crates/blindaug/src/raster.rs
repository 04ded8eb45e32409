//! Rectangles of values: images, depth, flow.

use crate::{Error, Result, par};
use std::ops::Range;

/// A `width` x `height` rectangle of values, row by row from the top left; pixel centres are at integer coordinates.
#[derive(Debug, PartialEq)]
pub struct Raster<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T: Copy + Send + Sync> Clone for Raster<T> {
    fn clone(&self) -> Self {
        Self { width: self.width, height: self.height, data: par::copied(&self.data) }
    }
}

/// One value per pixel.
pub type Plane = Raster<f32>;

/// Optical flow: displacement of each pixel to the next frame, px per frame interval, x right, y down.
/// NaN where it is unknown (occluded, or the match failed).
pub type Flow = Raster<[f32; 2]>;

impl<T> Raster<T> {
    /// Takes `width * height` values, row by row.
    ///
    /// # Errors
    /// If the number of values is not `width * height`.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Result<Self> {
        if width.checked_mul(height) != Some(data.len()) {
            return Err(Error::new(format!("{} values do not fill {width} x {height} pixels", data.len())));
        }
        Ok(Self { width, height, data })
    }

    /// Width in px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// (width, height) in px.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All values, row by row.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All values, row by row.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The values, row by row.
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }

    /// A raster of some of the rows, in the same memory.
    pub(crate) fn into_rows(mut self, rows: Range<usize>) -> Self {
        self.data.truncate(rows.end * self.width);
        self.data.drain(..rows.start * self.width);
        self.height = rows.len();
        self
    }

    /// Row `y`.
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..][..self.width]
    }

    /// Row `y`.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..][..self.width]
    }
}

impl<T: Copy + Send + Sync> Raster<T> {
    /// A raster with `value` at every pixel.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: par::filled(width * height, value) }
    }

    /// A raster with `f(x, y)` at each pixel, computed for several rows in parallel.
    pub fn from_fn(width: usize, height: usize, f: impl Fn(usize, usize) -> T + Sync) -> Self
    where
        T: Default,
    {
        let mut data = par::filled(width * height, T::default());
        par::for_each_row(&mut data, width, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = f(x, y);
            }
        });
        Self { width, height, data }
    }

    /// The value at (x, y), which must lie inside.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        self.data[y * self.width + x]
    }

    /// The value at the pixel inside that is nearest to (x, y).
    #[inline]
    pub fn at_clamped(&self, x: isize, y: isize) -> T {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.data[y * self.width + x]
    }

    /// A raster with `f` of each value, computed for several rows in parallel.
    pub fn map<U: Copy + Default + Send + Sync>(&self, f: impl Fn(T) -> U + Sync) -> Raster<U> {
        self.map_rows(0..self.height, f)
    }

    /// A raster with `f` of each value of some rows, computed for several rows in parallel.
    pub(crate) fn map_rows<U: Copy + Default + Send + Sync>(
        &self,
        rows: Range<usize>,
        f: impl Fn(T) -> U + Sync,
    ) -> Raster<U> {
        let mut data = par::filled(self.width * rows.len(), U::default());
        par::for_each_row(&mut data, self.width, |y, row| {
            for (o, &v) in row.iter_mut().zip(self.row(rows.start + y)) {
                *o = f(v);
            }
        });
        Raster { width: self.width, height: rows.len(), data }
    }

    /// The `width` x `height` rectangle whose top left corner is (x, y), which must lie inside the raster.
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> Self {
        if width == 0 || height == 0 {
            return Self { width, height, data: vec![] };
        }
        let mut data = par::filled(width * height, self.at(x, y));
        par::for_each_row(&mut data, width, |r, row| row.copy_from_slice(&self.row(y + r)[x..x + width]));
        Self { width, height, data }
    }
}

/// A pixel of one or more f32 channels, which filters can average.
pub trait Pixel: Copy + Default + Send + Sync + 'static {
    /// The number of channels.
    const CHANNELS: usize;
    /// The channels of all pixels, interleaved.
    fn flat(pixels: &[Self]) -> &[f32];
    /// The channels of all pixels, interleaved.
    fn flat_mut(pixels: &mut [Self]) -> &mut [f32];
    /// `a + t (b - a)`, channel by channel.
    fn lerp(a: Self, b: Self, t: f32) -> Self;
    /// Adds `k v`, channel by channel.
    #[inline]
    fn add_scaled(&mut self, v: Self, k: f32) {
        for (a, v) in Self::flat_mut(std::slice::from_mut(self)).iter_mut().zip(Self::flat(&[v])) {
            *a += k * v;
        }
    }
}

impl Pixel for f32 {
    const CHANNELS: usize = 1;
    fn flat(pixels: &[f32]) -> &[f32] {
        pixels
    }
    fn flat_mut(pixels: &mut [f32]) -> &mut [f32] {
        pixels
    }
    #[inline]
    fn lerp(a: f32, b: f32, t: f32) -> f32 {
        a + t * (b - a)
    }
}

impl<const N: usize> Pixel for [f32; N]
where
    [f32; N]: Default,
{
    const CHANNELS: usize = N;
    fn flat(pixels: &[Self]) -> &[f32] {
        pixels.as_flattened()
    }
    fn flat_mut(pixels: &mut [Self]) -> &mut [f32] {
        pixels.as_flattened_mut()
    }
    #[inline]
    fn lerp(a: Self, b: Self, t: f32) -> Self {
        std::array::from_fn(|i| a[i] + t * (b[i] - a[i]))
    }
}

impl<P: Pixel> Raster<P> {
    /// Bilinear interpolation at (x, y), clamped to the edge pixels.
    #[inline]
    pub fn bilinear(&self, x: f32, y: f32) -> P {
        self.bilinear_of_rows(x, y, 0, self.height)
    }

    /// [`Raster::bilinear`] of an image of `height` rows, of which this raster holds the rows from `top` on.
    #[inline]
    pub(crate) fn bilinear_of_rows(&self, x: f32, y: f32, top: usize, height: usize) -> P {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let right = usize::from(x0 + 1 < self.width);
        let below = if y0 + 1 < height { self.width } else { 0 };
        let (d, i) = (&self.data, (y0 - top) * self.width + x0);
        P::lerp(P::lerp(d[i], d[i + right], fx), P::lerp(d[i + below], d[i + below + right], fx), fy)
    }

    /// [`Raster::bilinear_of_rows`] at 0 <= x < width - 1, 0 <= y < height - 1.
    #[inline(always)]
    pub(crate) fn bilinear_inside(&self, x: f32, y: f32, top: usize) -> P {
        let (x0, y0) = (x as u32, y as u32);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let i = (y0 as usize - top) * self.width + x0 as usize;
        let (above, below) = (&self.data[i..i + 2], &self.data[i + self.width..i + self.width + 2]);
        P::lerp(P::lerp(above[0], above[1], fx), P::lerp(below[0], below[1], fx), fy)
    }
}

/// The weights of Catmull & Rom's four taps at an offset of `f` in [0, 1) from the second.
#[inline(always)]
pub(crate) fn cubic_weights(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [
        0.5 * (2.0 * f2 - f3 - f),
        0.5 * (3.0 * f3 - 5.0 * f2 + 2.0),
        0.5 * (4.0 * f2 - 3.0 * f3 + f),
        0.5 * (f3 - f2),
    ]
}

impl<P: Pixel> Raster<P> {
    /// Cubic interpolation (Catmull & Rom 1974) at (x, y), clamped to the edge pixels. Unlike bilinear interpolation it hardly
    /// blurs: its kernel has variance 0.
    #[inline]
    pub fn cubic(&self, x: f32, y: f32) -> P {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (wx, wy) = (cubic_weights(x - x0 as f32), cubic_weights(y - y0 as f32));
        let mut sum = P::default();
        if x0 >= 1 && y0 >= 1 && x0 + 2 < self.width && y0 + 2 < self.height {
            for (j, wy) in wy.into_iter().enumerate() {
                let mut line = P::default();
                for (v, wx) in self.row(y0 + j - 1)[x0 - 1..x0 + 3].iter().zip(wx) {
                    line.add_scaled(*v, wx);
                }
                sum.add_scaled(line, wy);
            }
            return sum;
        }
        let columns: [usize; 4] = std::array::from_fn(|i| (x0 + i).saturating_sub(1).min(self.width - 1));
        for (j, wy) in wy.iter().enumerate() {
            let row = self.row((y0 + j).saturating_sub(1).min(self.height - 1));
            for (column, wx) in columns.iter().zip(wx) {
                sum.add_scaled(row[*column], wx * wy);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_number_of_values_is_refused() {
        assert!(Plane::from_vec(2, 2, vec![0.0; 3]).is_err());
    }

    #[test]
    fn bilinear_interpolates_planes_and_pixels_alike() {
        let p = Plane::from_fn(3, 2, |x, y| x as f32 + 10.0 * y as f32);
        let q = p.map(|v| [v, -v]);
        for (x, y, want) in [(0.0, 0.0, 0.0), (1.5, 0.5, 6.5), (2.0, 1.0, 12.0), (-3.0, 9.0, 10.0)] {
            assert!((p.bilinear(x, y) - want).abs() < 1e-6);
            assert_eq!(q.bilinear(x, y), [p.bilinear(x, y), -p.bilinear(x, y)]);
        }
    }

    #[test]
    fn cubic_interpolation_is_exact_on_parabolas_and_pixels() {
        let p = Plane::from_fn(9, 8, |x, y| (x * x) as f32 - 2.0 * y as f32);
        for (x, y) in [(3.0, 4.0), (3.25, 4.0), (4.5, 3.5), (5.9, 2.1)] {
            assert!((p.cubic(x, y) - (x * x - 2.0 * y)).abs() < 1e-4);
        }
        assert_eq!(p.cubic(-5.0, 99.0), p.at(0, 7));
    }
}
