//! Defocus: a blur whose std varies from pixel to pixel (Potmesil & Chakravarty 1982).
//!
//! This is a gather: each pixel is the mean of its surroundings by its own kernel.

mod aperture;

use crate::model::Aperture;
use crate::{Error, Pixel, Plane, Raster, Result, filter, par, pyramid};
pub(crate) use aperture::reach as aperture_reach;
use aperture::{Apertures, Cut};

pub use crate::model::Bokeh;

/// The largest std, px, to which larger ones are cut; it bounds the work that an absurd depth can cause.
pub const MAX_SIGMA_PX: f32 = 200.0;

/// The side of the squares that are processed one by one, px: small enough for the cache, large beside common kernels.
const TILE: usize = 64;

/// Blurs each pixel by the kernel of its own std `sigma_px`, px per axis.
///
/// A std of 0 is the exact identity; negative, NaN and infinite ones count as 0. Outside the image, the nearest pixel
/// inside is repeated.
///
/// # Errors
/// If the map of stds has another size than the image.
pub fn defocus<P: Pixel>(src: &Raster<P>, sigma_px: &Plane, bokeh: Bokeh) -> Result<Raster<P>> {
    let behind = sigma_px.map(|s| if s > 0.0 { s } else { 0.0 });
    defocus_through(src, &behind, &Lens::new(bokeh.into(), src.size()))
}

/// The shape of a lens's blur, and the part of the picture that an image shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The shape of out-of-focus points.
    pub aperture: Aperture,
    /// The width of a pixel over its height.
    pub pixel_aspect: f32,
    /// The size of the whole picture, px.
    pub picture: (usize, usize),
    /// The place of the image's top left pixel in the picture, px; negative where the image reaches beyond the picture.
    pub origin: (isize, isize),
}

impl Lens {
    /// A lens before square pixels, and an image of the whole picture.
    pub fn new(aperture: Aperture, picture: (usize, usize)) -> Self {
        Self { aperture, pixel_aspect: 1.0, picture, origin: (0, 0) }
    }

    /// The std along x and along y, px, of a point whose equivalent Gaussian has a std of 1 px of the picture's height.
    pub fn stds(&self) -> [f32; 2] {
        self.aperture.stds(self.pixel_aspect)
    }

    /// The position of a pixel of the image from the picture's centre, as the picture is shown, in halves of its diagonal.
    fn field(&self, x: usize, y: usize) -> [f32; 2] {
        let (w, h) = (self.picture.0 as f32, self.picture.1 as f32);
        let from = |at: usize, origin: isize, size: f32| (at as isize + origin) as f32 - 0.5 * (size - 1.0);
        let half = 0.5 * (w * self.pixel_aspect).hypot(h).max(1.0);
        [from(x, self.origin.0, w) * self.pixel_aspect / half, from(y, self.origin.1, h) / half]
    }
}

/// Blurs each pixel by its own std, px of the picture's height, through the aperture of a lens. A std is positive behind the focus and negative
/// in front of it, where the aperture's image is upside down.
///
/// A std of 0 is the exact identity; NaN and infinite ones count as 0. Outside the image, the nearest pixel inside is repeated.
///
/// # Errors
/// If the map of stds has another size than the image.
pub fn defocus_through<P: Pixel>(src: &Raster<P>, sigma_px: &Plane, lens: &Lens) -> Result<Raster<P>> {
    let (w, h) = src.size();
    if (w, h) != sigma_px.size() {
        return Err(Error::new(format!(
            "the map of blur stds has {} x {} pixels but the image {w} x {h}; give one of the image's size",
            sigma_px.width(),
            sigma_px.height()
        )));
    }
    let sigma = sigma_px.map(|s| if s.is_finite() { s.clamp(-MAX_SIGMA_PX, MAX_SIGMA_PX) } else { 0.0 });
    let largest = sigma.data().iter().map(|s| s.abs()).fold(0.0, f32::max);
    if largest == 0.0 {
        return Ok(src.clone());
    }
    let stds = lens.stds();
    let blurred_tile: Box<dyn Fn(Tile) -> Raster<P> + Sync + Send> = match lens.aperture.bokeh {
        Bokeh::Gaussian => {
            let greater = stds[0].max(stds[1]);
            let stack = GaussianStack::new(src, greater * largest, stds.map(|s| s / greater));
            let sigma = sigma.map(|s| greater * s.abs());
            Box::new(move |tile| stack.blurred(&sigma, tile))
        }
        Bokeh::Disk if stds == [1.0; 2] && lens.aperture.cats_eye == 0.0 => {
            let disks = disks(largest);
            Box::new(move |tile| {
                let of = |s: f32| &disks[((s.abs() / DISK_STEP).round() as usize).min(disks.len() - 1)];
                span_blurred(src, &sigma, (&of, &|_, _, _| None), tile)
            })
        }
        _ => {
            let apertures = Apertures::new(&lens.aperture, stds, &sigma);
            let lens = *lens;
            Box::new(move |tile| {
                let cut = |x, y, s| apertures.cut(lens.field(x, y), s);
                span_blurred(src, &sigma, (&|s| apertures.kernel(s), &cut), tile)
            })
        }
    };
    let columns = w.div_ceil(TILE);
    let tiles = par::map(columns * h.div_ceil(TILE), |i| {
        let (x, y) = (i % columns * TILE, i / columns * TILE);
        let tile = Tile { x, y, w: TILE.min(w - x), h: TILE.min(h - y) };
        (tile, blurred_tile(tile))
    });
    let mut out = src.clone();
    for (tile, values) in tiles {
        for y in 0..tile.h {
            out.row_mut(tile.y + y)[tile.x..][..tile.w].copy_from_slice(values.row(y));
        }
    }
    Ok(out)
}

#[derive(Clone, Copy)]
struct Tile {
    x: usize,
    y: usize,
    w: usize,
    h: usize,
}

impl Tile {
    /// The tile's part of an image, pixel by pixel.
    fn pixels<'a, T: Copy + Send + Sync>(self, image: &'a Raster<T>) -> impl Iterator<Item = T> + 'a {
        (self.y..self.y + self.h).flat_map(move |y| image.row(y)[self.x..][..self.w].iter().copied())
    }
}

/// Blurs by a few levels of variance, between which each pixel is interpolated linearly to its own variance: so that variance is
/// exact, and the kernel's shape differs from a Gaussian's by what [`LEVEL_RATIO`] allows.
///
/// Levels of large variance are computed on a binomial pyramid. Halving and doubling with the binomial kernel each add a variance
/// of 1 px^2 of the finer size, the same at even and odd pixels, which is subtracted from the blur in between.
struct GaussianStack<P> {
    /// The image, halved again and again.
    octaves: Vec<Raster<P>>,
    /// Variances in px^2, rising from 0.
    variances: Vec<f32>,
    /// For each variance, the octave on which it is computed, and the kernels along and down the picture there.
    kernels: Vec<(usize, [Vec<f32>; 2])>,
}

/// The ratio r of successive variances: between variances t and r t, the error of the response exp(-t w^2 / 2) is at most about
/// 0.07 ((r - 1) / r)^2, here 0.3 %.
const LEVEL_RATIO: f32 = 1.25;

/// The least difference of successive variances, px^2, which near variance 0 is limited by the error at the highest frequency.
const LEVEL_DISTANCE: f32 = 0.03;

/// The least variance, in px^2 of the octave, that must be left to blur for a level to be computed on an octave: the errors of
/// halving and doubling (aliases) are then below 0.1 %.
const OCTAVE_VARIANCE: f32 = 8.0;

impl<P: Pixel> GaussianStack<P> {
    /// A stack up to a std along the axis of greater blur; `stds` are those of both axes, the greater one 1.
    fn new(src: &Raster<P>, largest_sigma: f32, stds: [f32; 2]) -> Self {
        let largest = largest_sigma * largest_sigma;
        let mut variances = vec![0.0];
        let mut t: f32 = 0.0;
        while t < largest {
            t = (t * LEVEL_RATIO).max(t + LEVEL_DISTANCE);
            variances.push(t);
        }
        let shares = stds.map(|s| s * s);
        let least = shares[0].min(shares[1]);
        let mut octaves = vec![src.clone()];
        while octave_variance(octaves.len(), least * t) >= OCTAVE_VARIANCE {
            octaves.push(pyramid::downsample(&octaves[octaves.len() - 1]));
        }
        let kernel = |i: usize| {
            let t = variances[i];
            let octave = (0..octaves.len())
                .rev()
                .find(|&o| octave_variance(o, least * t) >= OCTAVE_VARIANCE)
                .unwrap_or(0);
            let of = |share: f32| filter::gaussian_kernel(octave_variance(octave, share * t).max(0.0).sqrt());
            let along = of(shares[0]);
            let down = if shares[0] == shares[1] { along.clone() } else { of(shares[1]) };
            (octave, [along, down])
        };
        let kernels = par::map(variances.len(), kernel);
        Self { octaves, variances, kernels }
    }

    fn blurred(&self, sigma: &Plane, tile: Tile) -> Raster<P> {
        // For each pixel, the level below its variance, and the weight of the next level, in [0, 1].
        let place: Vec<(usize, f32)> = tile
            .pixels(sigma)
            .map(|s| {
                let t = s * s;
                let below = (self.variances.partition_point(|&v| v <= t) - 1).min(self.variances.len() - 2);
                let [a, b] = [self.variances[below], self.variances[below + 1]];
                (below, (t - a) / (b - a))
            })
            .collect();
        let mut out = Raster::filled(tile.w, tile.h, P::default());
        for level in 0..self.variances.len() {
            let weight = |&(below, f): &(usize, f32)| match level.checked_sub(below) {
                Some(0) => 1.0 - f,
                Some(1) => f,
                _ => 0.0,
            };
            if place.iter().all(|p| weight(p) == 0.0) {
                continue;
            }
            let image = self.level(level, tile);
            for ((o, v), p) in out.data_mut().iter_mut().zip(image.data()).zip(&place) {
                o.add_scaled(*v, weight(p));
            }
        }
        out
    }

    /// The tile of the image blurred by the variance of a level.
    fn level(&self, level: usize, Tile { x, y, w, h }: Tile) -> Raster<P> {
        let (octave, [along, down]) = &self.kernels[level];
        let octave = *octave;
        // The rectangle of each octave, from the finest, that the tile needs: its first pixel and its size.
        let mut needed = vec![((x as isize, y as isize), (w, h))];
        for o in 0..octave {
            let ((x, y), (w, h)) = needed[o];
            needed.push(((x.div_euclid(2) - 1, y.div_euclid(2) - 1), (w / 2 + 4, h / 2 + 4)));
        }
        let (at, size) = needed[octave];
        let mut image = filter::convolve_rectangle(&self.octaves[octave], [along, down], at, size);
        for o in (0..octave).rev() {
            let ((cx, cy), (x, y), (w, h)) = (needed[o + 1].0, needed[o].0, needed[o].1);
            let doubled = pyramid::upsample(&image, 2 * image.width(), 2 * image.height());
            image = doubled.crop((x - 2 * cx) as usize, (y - 2 * cy) as usize, w, h);
        }
        image
    }
}

/// The variance, in px^2 of octave `o`, that is left to blur there for a variance of `t` px^2 of the image.
fn octave_variance(o: usize, t: f32) -> f32 {
    let scale = 4f32.powi(o as i32);
    (t - 2.0 * (scale - 1.0) / 3.0) / scale
}

/// A uniform convex shape as rows of spans, pixels at whose ends count in part.
#[derive(Debug, Default)]
struct Spans {
    rows: Vec<Span>,
    /// The sum of the rows' lengths, px.
    area: f32,
}

/// A row of a shape, px from its centre.
#[derive(Clone, Copy, Debug)]
struct Span {
    dy: i32,
    left: f32,
    right: f32,
}

impl Spans {
    /// The distance in px to which the shape reaches along an axis, rounded up.
    fn reach(&self) -> usize {
        let of = |s: &Span| (s.dy.unsigned_abs() as usize + 1).max(s.right.max(-s.left).ceil() as usize);
        self.rows.iter().map(of).max().unwrap_or(0)
    }
}

/// A disk as rows of spans: row dy extends `half_widths[|dy|]` px on either side of the centre.
struct Disk {
    half_widths: Vec<f32>,
    area: f32,
}

impl From<Disk> for Spans {
    fn from(disk: Disk) -> Self {
        let span = |dy: i32, half: f32| Span { dy, left: -half, right: half };
        let rows = (0..).zip(&disk.half_widths).flat_map(|(dy, &half)| {
            [Some(span(dy, half)), (dy > 0).then(|| span(-dy, half))].into_iter().flatten()
        });
        Self { rows: rows.collect(), area: disk.area }
    }
}

/// The distance between the stds for which a disk is prepared, px.
const DISK_STEP: f32 = 1.0 / 64.0;

impl Disk {
    /// The disk whose variance along x and y is exactly `variance` px^2 when it is sampled in pixels.
    ///
    /// A row's weight is the area that a disk covers in the row; the disk's radius is chosen for the variance along y. The lengths
    /// of the spans are then stretched by a common factor near 1, which is chosen for the variance along x.
    fn of_variance(variance: f64) -> Self {
        let sigma = variance.sqrt();
        let radius =
            solve(2.0 * sigma - 1.0, 2.0 * sigma + 1.0, |r| variance_along_y(&row_halves(r)) > variance);
        let halves = row_halves(radius);
        let stretched = |k: f64| halves.iter().map(|a| a * k).collect::<Vec<_>>();
        let stretch = solve(0.5, 1.5, |k| variance_along_x(&stretched(k)) > variance);
        let halves = stretched(stretch);
        let area = 2.0 * (2.0 * halves.iter().sum::<f64>() - halves[0]);
        Self { half_widths: halves.iter().map(|&a| a as f32).collect(), area: area as f32 }
    }
}

/// The point between `lo` and `hi` at which `too_much` turns true, to a millionth of their distance.
fn solve(mut lo: f64, mut hi: f64, too_much: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..20 {
        let mid = 0.5 * (lo + hi);
        if too_much(mid) { hi = mid } else { lo = mid }
    }
    lo
}

/// Half the area that a disk of this radius, at least 1/2 px, covers in the rows 0, 1, .. px from its centre.
fn row_halves(radius: f64) -> Vec<f64> {
    let r = radius.max(0.5);
    // The integral of sqrt(r^2 - y^2) from 0 to y.
    let integral = |y: f64| {
        let y = y.min(r);
        0.5 * (y * (r * r - y * y).sqrt() + r * r * (y / r).asin())
    };
    let rows = (r + 0.5).ceil() as usize;
    let edges: Vec<f64> = (0..rows).map(|dy| integral(dy as f64 + 0.5)).collect();
    (0..rows).map(|dy| if dy == 0 { 2.0 * edges[0] } else { edges[dy] - edges[dy - 1] }).collect()
}

/// The mean of `of(dy, half width)` over the kernel's rows on both sides of the centre, weighted by their area.
fn mean_over_rows(halves: &[f64], of: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for (dy, &a) in halves.iter().enumerate() {
        let weight = if dy == 0 { a } else { 2.0 * a };
        sum += weight * of(dy as f64, a);
        area += weight;
    }
    sum / area
}

fn variance_along_y(halves: &[f64]) -> f64 {
    mean_over_rows(halves, |dy, _| dy * dy)
}

fn variance_along_x(halves: &[f64]) -> f64 {
    mean_over_rows(halves, |_, a| {
        // Pixels -n to n count whole, the next ones on both sides in part.
        let n = (a - 0.5).max(0.0).floor();
        let part = (a - 0.5 - n).max(0.0);
        (n * (n + 1.0) * (2.0 * n + 1.0) / 3.0 + 2.0 * part * (n + 1.0) * (n + 1.0)) / (2.0 * a).max(1e-12)
    })
}

/// The disk of a std, px, as rows of spans: half the length of each row's span, px, from the centre's row on.
///
/// A pixel at the end of a span counts by the part of it that the span covers. The disk's std is exactly `sigma_px`.
pub fn disk_half_widths(sigma_px: f32) -> Vec<f32> {
    Disk::of_variance(f64::from(sigma_px).powi(2)).half_widths
}

/// The disks of std 0, [`DISK_STEP`], 2 [`DISK_STEP`], .. up to `largest_sigma`.
fn disks(largest_sigma: f32) -> Vec<Spans> {
    let n = (largest_sigma / DISK_STEP).round() as usize + 1;
    par::map(n, |i| Disk::of_variance((i as f64 * f64::from(DISK_STEP)).powi(2)).into())
}

/// The values of some pixels of an image blurred by disks of several constant stds, as `[place][std]`; each is that of [`defocus`].
pub(crate) fn disk_values_at<const N: usize>(
    src: &Plane,
    places: &[(usize, usize)],
    sigmas: &[f32; N],
) -> Vec<[f32; N]> {
    let largest = sigmas.iter().copied().fold(0.0, f32::max);
    let all = disks(largest);
    let used = sigmas.map(|s| &all[((s / DISK_STEP).round() as usize).min(all.len() - 1)]);
    let reach = used.iter().map(|d| d.reach()).max().unwrap_or(0);
    let (w, h) = src.size();
    // The sums of each row's pixels before each column, from `reach` px left of the image on; the mean is subtracted for precision.
    let mean = src.data().iter().sum::<f32>() / src.data().len().max(1) as f32;
    let width = w + 2 * reach;
    let mut sums = Plane::filled(width + 1, h, 0.0);
    par::for_each_row(sums.data_mut(), width + 1, |y, row| {
        for i in 0..width {
            row[i + 1] =
                row[i] + src.at((i as isize - reach as isize).clamp(0, w as isize - 1) as usize, y) - mean;
        }
    });
    par::map(places.len(), |i| {
        let (x, y) = places[i];
        let centre = (x + reach) as f32 + 0.5;
        std::array::from_fn(|k| {
            if sigmas[k] < 0.5 * DISK_STEP {
                return src.at(x, y);
            }
            let mut sum = 0.0;
            for &Span { dy, left, right } in &used[k].rows {
                let row = sums.row((y as isize + dy as isize).clamp(0, h as isize - 1) as usize);
                let up_to = |e: f32| f32::lerp(row[e as usize], row[(e as usize + 1).min(width)], e.fract());
                sum += up_to(centre + right) - up_to(centre + left);
            }
            mean + sum / used[k].area
        })
    })
}

/// The shape of a std, px.
type ShapeOf<'f, 'a> = &'f dyn Fn(f32) -> &'a Spans;

/// The cut of the shape at a pixel (x, y) of a std, px.
type CutAt<'f, 'a> = &'f dyn Fn(usize, usize, f32) -> Option<Cut<'a>>;

/// The tile, each pixel blurred by the shape of its std, which is cut where there is a cut for the pixel (x, y, std); O(radius) per pixel by
/// sums along the rows. The shapes are those of points in front of the focus; behind it, they are turned by 180 degrees, and a gather turns
/// them once more.
fn span_blurred<'a, P: Pixel>(
    src: &Raster<P>,
    sigma: &Plane,
    (kernel, cut): (ShapeOf<'_, 'a>, CutAt<'_, 'a>),
    tile: Tile,
) -> Raster<P> {
    let widest = kernel(tile.pixels(sigma).fold(0.0, |a, s| s.abs().max(a)));
    let reach = widest.reach() as isize;
    // sums(i, j) is the sum of the first i pixels of row j; columns and rows are counted from `reach` px before the tile.
    let width = tile.w + 2 * reach as usize;
    let mut sums = Raster::filled(width + 1, tile.h + 2 * reach as usize, P::default());
    for j in 0..sums.height() {
        let y = (tile.y as isize + j as isize - reach).clamp(0, src.height() as isize - 1) as usize;
        let (line, row) = (src.row(y), sums.row_mut(j));
        for i in 0..width {
            let x = (tile.x as isize + i as isize - reach).clamp(0, line.len() as isize - 1) as usize;
            row[i + 1] = row[i];
            row[i + 1].add_scaled(line[x], 1.0);
        }
    }
    let mut out = Raster::filled(tile.w, tile.h, P::default());
    for y in 0..tile.h {
        for x in 0..tile.w {
            let s = sigma.at(tile.x + x, tile.y + y);
            out.row_mut(y)[x] = if s.abs() < 0.5 * DISK_STEP {
                src.at(tile.x + x, tile.y + y)
            } else {
                let centre = (x as isize + reach) as f32 + 0.5;
                let mut sum = P::default();
                let mut span = |Span { dy, left, right }: Span| {
                    let row = sums.row((y as isize + reach + dy as isize) as usize);
                    let up_to =
                        |e: f32| P::lerp(row[e as usize], row[(e as usize + 1).min(width)], e.fract());
                    sum.add_scaled(up_to(centre + right), 1.0);
                    sum.add_scaled(up_to(centre + left), -1.0);
                };
                let spans = kernel(s);
                let area = match cut(tile.x + x, tile.y + y, s) {
                    None => {
                        spans.rows.iter().copied().for_each(&mut span);
                        spans.area
                    }
                    Some(cut) => {
                        let mut area = 0.0;
                        for row in spans.rows.iter().filter_map(|&row| cut.of(row)) {
                            area += row.right - row.left;
                            span(row);
                        }
                        area
                    }
                };
                let mut mean = P::default();
                mean.add_scaled(sum, 1.0 / area);
                mean
            };
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest allowed error of [`Bokeh::Gaussian`], as a share of the image's range: see [`LEVEL_RATIO`] and [`OCTAVE_VARIANCE`].
    const GAUSSIAN_TOLERANCE: f32 = 0.006;

    fn random(w: usize, h: usize, blob: usize) -> Raster<[f32; 3]> {
        // The channels are white noise, squares of about `blob` px, and waves, in [0, 1].
        Raster::from_fn(w, h, |x, y| {
            let hash = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
            let hash = (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D);
            let edge = if (3 * x / (4 * blob) + y / blob).is_multiple_of(2) { 1.0 } else { 0.0 };
            [(hash >> 16) as f32 / 65535.0, edge, 0.5 + 0.5 * (0.11 * x as f32 + 0.17 * y as f32).sin()]
        })
    }

    /// The largest difference from each pixel's own discrete Gaussian, all taps, over every 7th pixel `margin` px from the edge.
    fn largest_error(
        blurred: &Raster<[f32; 3]>,
        src: &Raster<[f32; 3]>,
        sigma: &Plane,
        margin: usize,
    ) -> f32 {
        let mut largest = 0.0f32;
        for y in (margin..src.height() - margin).step_by(7) {
            for x in (margin..src.width() - margin).step_by(7) {
                let k = filter::gaussian_kernel(sigma.at(x, y));
                let r = k.len() as isize - 1;
                let mut exact = [0.0; 3];
                for j in -r..=r {
                    for i in -r..=r {
                        let weight = k[i.unsigned_abs()] * k[j.unsigned_abs()];
                        exact.add_scaled(src.at_clamped(x as isize + i, y as isize + j), weight);
                    }
                }
                for (a, b) in blurred.at(x, y).iter().zip(exact) {
                    largest = largest.max((a - b).abs());
                }
            }
        }
        largest
    }

    #[test]
    fn every_std_agrees_with_the_exact_gaussian() {
        for (low, high, blob, margin) in [
            (0.0, 1.0, 2, 0),
            (0.5, 4.0, 6, 20),
            (3.0, 11.0, 10, 50),
            (3.0, 11.0, 20, 50),
            (9.0, 34.0, 40, 150),
        ] {
            let (w, h) = (2 * margin + 100, 2 * margin + 60);
            let src = random(w, h, blob);
            let sigma = Plane::from_fn(w, h, |x, y| low + (high - low) * ((x + y) as f32 / (w + h) as f32));
            let error = |sigma_used| {
                largest_error(&defocus(&src, &sigma_used, Bokeh::Gaussian).unwrap(), &src, &sigma, margin)
            };
            println!(
                "{low} to {high} px: {} wrong {}",
                error(sigma.clone()),
                error(sigma.map(|s| 1.05 * s + 0.02))
            );
            assert!(
                error(sigma.clone()) < GAUSSIAN_TOLERANCE,
                "{low} to {high} px: {}",
                error(sigma.clone())
            );
            // Negative control: a std that is wrong by a twentieth exceeds the tolerance.
            assert!(error(sigma.map(|s| 1.05 * s + 0.02)) > GAUSSIAN_TOLERANCE);
        }
    }

    #[test]
    fn stds_may_jump() {
        let src = random(250, 190, 10);
        let sigma = Plane::from_fn(250, 190, |x, _| if x < 120 { 0.0 } else { 12.0 });
        let blurred = defocus(&src, &sigma, Bokeh::Gaussian).unwrap();
        assert!(largest_error(&blurred, &src, &sigma, 55) < GAUSSIAN_TOLERANCE);
        assert_eq!(blurred.row(90)[..120], src.row(90)[..120]);
    }

    #[test]
    fn no_blur_and_unknown_blur_are_the_exact_identity() {
        let src = random(70, 66, 10);
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            for s in [0.0, -3.0, f32::NAN, f32::INFINITY] {
                assert_eq!(defocus(&src, &Plane::filled(70, 66, s), bokeh).unwrap(), src);
                let mut some = Plane::filled(70, 66, s);
                some.row_mut(20)[20] = 4.0;
                let blurred = defocus(&src, &some, bokeh).unwrap();
                assert_eq!(blurred.at(19, 20), src.at(19, 20));
                assert_ne!(blurred.at(20, 20), src.at(20, 20));
            }
        }
    }

    #[test]
    fn a_point_keeps_its_energy_and_gets_the_std_it_should_in_x_and_y() {
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            for sigma in [0.125, 0.25, 0.40625, 0.6875, 1.0, 1.625, 2.5, 4.0, 7.3125, 10.0, 16.0] {
                let n = 161;
                let mut p = Plane::filled(n, n, 0.0);
                p.row_mut(n / 2)[n / 2] = 1.0;
                let q = defocus(&p, &Plane::filled(n, n, sigma), bokeh).unwrap();
                let moment = |g: &dyn Fn(f64, f64) -> f64| -> f64 {
                    let c = |i: usize| i as f64 - (n / 2) as f64;
                    (0..n * n).map(|i| f64::from(q.data()[i]) * g(c(i % n), c(i / n))).sum()
                };
                let energy = moment(&|_, _| 1.0);
                assert!((energy - 1.0).abs() < 2e-3, "{bokeh:?} {sigma}: {energy}");
                let (x, y) = (moment(&|x, _| x * x).sqrt() as f32, moment(&|_, y| y * y).sqrt() as f32);

                assert!((x / sigma - 1.0).abs() < 0.005, "{bokeh:?} {sigma}: {x}");
                assert!((y / sigma - 1.0).abs() < 0.005, "{bokeh:?} {sigma}: {y}");
            }
        }
    }

    #[test]
    fn a_disk_is_uniform_and_ends_at_two_stds() {
        let n = 61;
        let mut p = Plane::filled(n, n, 0.0);
        p.row_mut(n / 2)[n / 2] = 1.0;
        let q = defocus(&p, &Plane::filled(n, n, 5.0), Bokeh::Disk).unwrap();
        for y in 0..n {
            for x in 0..n {
                let r = (x as f32 - 30.0).hypot(y as f32 - 30.0);
                let density = q.at(x, y) * std::f32::consts::PI * 100.0;
                assert!(r > 9.2 || (density - 1.0).abs() < 0.02, "{r}: {density}");
                assert!(r < 10.8 || density == 0.0, "{r}: {density}");
            }
        }
    }

    #[test]
    fn a_constant_stays_and_any_size_and_std_end() {
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            for (w, h) in [(0, 0), (1, 1), (1, 90), (90, 1), (70, 65)] {
                let sigma = Plane::from_fn(w, h, |x, y| 0.3 * (x + y) as f32);
                let q = defocus(&Raster::filled(w, h, [0.25, 2.0, -1.0]), &sigma, bokeh).unwrap();
                assert_eq!(q.size(), (w, h));
                for v in q.data() {
                    assert!(
                        v.iter().zip([0.25, 2.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-4),
                        "{bokeh:?} {v:?}"
                    );
                }
            }
            let q = defocus(&random(40, 30, 10), &Plane::filled(40, 30, 1e30), bokeh).unwrap();
            assert!(q.data().iter().flatten().all(|v| (0.0..=1.0).contains(v)));
            let e = defocus(&random(4, 4, 2), &Plane::filled(4, 5, 1.0), bokeh).unwrap_err();
            assert!(e.to_string().contains("4 x 5"));
        }
    }

    #[test]
    fn values_at_places_are_those_of_the_whole_image() {
        let src = random(70, 50, 2).map(|p| p[0]);
        let sigmas = [0.0, 0.4, 1.7, 6.0];
        let places = [(0, 0), (35, 20), (69, 49), (3, 44)];
        let values = disk_values_at(&src, &places, &sigmas);
        for (k, &sigma) in sigmas.iter().enumerate() {
            let whole = defocus(&src, &Plane::filled(70, 50, sigma), Bokeh::Disk).unwrap();
            for (value, &(x, y)) in values.iter().zip(&places) {
                assert!((value[k] - whole.at(x, y)).abs() < 1e-5, "{sigma} at {x}, {y}");
            }
        }
    }
}
