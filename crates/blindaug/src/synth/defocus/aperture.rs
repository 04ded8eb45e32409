//! The shapes that apertures other than a plain disk give to out-of-focus points: polygons, stretched and cut ones, as rows of spans.
//!
//! A shape is described once, with a std of 1 along each axis, by the area and the first moment that lie above each height. A kernel of any
//! size then takes two look-ups per row.

use super::{DISK_STEP, Span, Spans, solve};
use crate::model::{Aperture, Bokeh};
use crate::{Plane, par};
use std::f64::consts::{FRAC_PI_2, TAU};

/// The std along an axis, px, up to which an aperture's shape cannot be seen, and that from which on it is seen in full. Between the two, the
/// blades are rounder than they are.
const SEEN_FROM: [f32; 2] = [0.5, 1.0];

/// The number of cells of the tables over a shape's height.
const CELLS: usize = 2048;

/// The radius, in stds, of the circle around an aperture's shape.
pub(crate) fn reach(bokeh: Bokeh) -> f32 {
    match bokeh {
        Bokeh::Gaussian => 4.5,
        Bokeh::Disk => 2.0,
        // Straight blades; rounder ones reach less far.
        Bokeh::Polygon { blades, .. } => {
            (12.0 / (2.0 + (std::f32::consts::TAU / f32::from(blades)).cos())).sqrt()
        }
    }
}

/// A shape of std 1 along each axis, x right and y down.
struct Outline {
    /// The radius of the circle through the corners.
    radius: f64,
    /// The area, and the integral of x over it, above each of the heights that divide the range from `-radius` to `radius` evenly.
    above: Vec<[f64; 2]>,
}

impl Outline {
    /// The outline of a shape whose blades are at least as round as `least_roundness`.
    fn new(bokeh: Bokeh, least_roundness: f32) -> Self {
        let (blades, roundness, rotation) = match bokeh {
            Bokeh::Polygon { blades, roundness, rotation_degrees } => (blades, roundness, rotation_degrees),
            _ => (16, 1.0, 0.0),
        };
        let corners = corners(
            usize::from(blades),
            f64::from(roundness.max(least_roundness)),
            f64::from(rotation).to_radians(),
        );
        let edges =
            || corners.iter().zip(corners.iter().cycle().skip(1)).map(|(&[a, b], &[c, d])| [a, b, c, d]);
        // Twice the area, and 24 times the mean of both axes' second moments times the area (Green's theorem).
        let (mut area, mut square) = (0.0, 0.0);
        for [a, b, c, d] in edges() {
            let cross = a * d - c * b;
            area += cross;
            square += cross * (a * a + a * c + c * c + b * b + b * d + d * d);
        }
        let radius = (12.0 * area / square).sqrt();
        // The ends of the row at each height.
        let mut ends = vec![[f64::MAX, f64::MIN]; CELLS + 1];
        let height = |i: usize| 2.0 * i as f64 / CELLS as f64 - 1.0;
        for [a, b, c, d] in edges() {
            let cell = |y: f64| (0.5 * (y + 1.0) * CELLS as f64).clamp(0.0, CELLS as f64);
            let (first, last) = (cell(b.min(d)).ceil() as usize, cell(b.max(d)).floor() as usize);
            for (i, end) in ends.iter_mut().enumerate().take(last + 1).skip(first) {
                let t = if b == d { 0.0 } else { ((height(i) - b) / (d - b)).clamp(0.0, 1.0) };
                let [left, right] = *end;
                let x = a + t * (c - a);
                *end = [left.min(x), right.max(x)];
            }
        }
        let row = |i: usize| {
            let [left, right] = ends[i];
            let width = (right - left).max(0.0);
            [width, if width > 0.0 { 0.5 * width * (left + right) } else { 0.0 }]
        };
        let step = 2.0 * radius / CELLS as f64;
        let mut above = vec![[0.0; 2]];
        for i in 0..CELLS {
            let ([w0, m0], [w1, m1], [area, first]) = (row(i), row(i + 1), above[i]);
            above.push([
                area + 0.5 * step * radius * (w0 + w1),
                first + 0.5 * step * radius * radius * (m0 + m1),
            ]);
        }
        Self { radius, above }
    }

    /// The area and the first moment above a height.
    fn above(&self, y: f64) -> [f64; 2] {
        let at = (0.5 * (y / self.radius + 1.0) * CELLS as f64).clamp(0.0, CELLS as f64);
        let i = (at as usize).min(CELLS - 1);
        let t = at - i as f64;
        let ([a, b], [c, d]) = (self.above[i], self.above[i + 1]);
        [a + t * (c - a), b + t * (d - b)]
    }

    /// The rows of pixels of the shape when it is stretched by `scale` down the picture and moved by `shift`: the row's number, the mean
    /// length of the shape's part in it before any stretch along the picture, and the middle of that part.
    fn rows(&self, scale: f64, shift: f64) -> impl Iterator<Item = (i32, f64, f64)> + '_ {
        let [first, last] = [-1.0, 1.0].map(|side| (side * self.radius * scale + shift).round() as i32);
        (first..=last).filter_map(move |dy| {
            let [from, to] = [-0.5, 0.5].map(|half| self.above((f64::from(dy) + half - shift) / scale));
            let (area, moment) = (to[0] - from[0], to[1] - from[1]);
            (area > 1e-9).then(|| (dy, area * scale, moment / area))
        })
    }
}

/// The corners of a polygon in the unit circle, clockwise from the top; rounded blades have many.
fn corners(blades: usize, roundness: f64, rotation: f64) -> Vec<[f64; 2]> {
    let half = TAU / 2.0 / blades as f64;
    let parts = if roundness > 1e-4 { 1024 / blades } else { 1 };
    let on_circle = |angle: f64| [angle.sin(), -angle.cos()];
    let mut points = vec![];
    for blade in 0..blades {
        let middle = rotation + TAU * (blade as f64 + 0.5) / blades as f64;
        let (out, along) = (on_circle(middle), on_circle(middle + FRAC_PI_2));
        // A blade is an arc of the angle 2 `bend`, whose radius is 1 / roundness.
        let bend = (half.sin() * roundness).asin();
        for part in 0..parts {
            let s = 2.0 * part as f64 / parts as f64 - 1.0;
            let (side, bulge) = if parts == 1 {
                (s * half.sin(), 0.0)
            } else {
                ((bend * s).sin() / roundness, ((bend * s).cos() - bend.cos()) / roundness)
            };
            let from_centre = half.cos() + bulge;
            points.push([0, 1].map(|c| from_centre * out[c] + side * along[c]));
        }
    }
    points
}

/// The sums over pixels of their centres and of the squares of these, up to the position `e` in px, from the pixel at 0 on; a pixel at the end
/// counts in part.
fn sums_up_to(e: f64) -> [f64; 2] {
    let n = (e + 0.5).floor();
    let part = e + 0.5 - n;
    [0.5 * n * (n - 1.0) + part * n, (n - 1.0) * n * (2.0 * n - 1.0) / 6.0 + part * n * n]
}

/// The scale and the shift for which the mean is 0 and the second moment `std`^2; `moments` gives both of a scale and a shift.
fn fitted(std: f64, moments: impl Fn(f64, f64) -> [f64; 2]) -> [f64; 2] {
    let (mut scale, mut shift) = (std, 0.0);
    for _ in 0..3 {
        if std < 2.0 {
            scale = solve(0.25 * std, 2.0 * std + 1.0, |k| moments(k, shift)[1] > std * std);
        } else {
            scale *= std / moments(scale, shift)[1].sqrt();
        }
        shift -= moments(scale, shift)[0];
    }
    [scale, shift]
}

/// A shape of one size.
struct Kernel {
    /// The spans as points in front of the focus gather them, and as those behind it do.
    spans: [Spans; 2],
    /// The scale and the shift along x and y, px, of the shape of std 1.
    placed: [[f64; 2]; 2],
    /// The radius of the circle around the shape of std 1.
    radius: f64,
}

impl Kernel {
    fn new(outline: &Outline, stds: [f64; 2]) -> Self {
        let weighted = |moments: &dyn Fn((i32, f64, f64)) -> [f64; 3], rows: &[(i32, f64, f64)]| {
            let mut sums = [0.0; 3];
            for &row in rows {
                let of = moments(row);
                (0..3).for_each(|i| sums[i] += of[i]);
            }
            [sums[1] / sums[0], sums[2] / sums[0]]
        };
        let down = fitted(stds[1], |scale, shift| {
            let rows: Vec<_> = outline.rows(scale, shift).collect();
            weighted(&|(dy, area, _)| [area, area * f64::from(dy), area * f64::from(dy * dy)], &rows)
        });
        let rows: Vec<_> = outline.rows(down[0], down[1]).collect();
        let ends = |scale: f64, shift: f64, (_, length, middle): (i32, f64, f64)| {
            [-0.5, 0.5].map(|side| scale * (middle + side * length) + shift)
        };
        let along = fitted(stds[0], |scale, shift| {
            let of_row = |row| {
                let [left, right] = ends(scale, shift, row);
                let ([a, b], [c, d]) = (sums_up_to(left), sums_up_to(right));
                [right - left, c - a, d - b]
            };
            weighted(&of_row, &rows)
        });
        let spans = |turned: bool| {
            let rows: Vec<Span> = rows
                .iter()
                .map(|&row| {
                    let [left, right] = ends(along[0], along[1], row).map(|v| v as f32);
                    match turned {
                        false => Span { dy: row.0, left, right },
                        true => Span { dy: -row.0, left: -right, right: -left },
                    }
                })
                .collect();
            Spans { area: rows.iter().map(|r| r.right - r.left).sum(), rows }
        };
        Self { spans: [false, true].map(spans), placed: [along, down], radius: outline.radius }
    }
}

/// An aperture's kernels, of all sizes that an image needs.
pub(super) struct Apertures {
    /// The kernels of the stds 0, [`DISK_STEP`], 2 [`DISK_STEP`] and so on; `None` where a size is not needed.
    kernels: Vec<Option<Kernel>>,
    cats_eye: f32,
    /// The integral of `sqrt(1 - t^2)` from -1 to each of the heights that divide the range from -1 to 1 evenly.
    half_disk: Vec<f32>,
}

impl Apertures {
    /// The kernels for a map of stds, px; `stds` are those along x and y of a std of 1.
    pub fn new(aperture: &Aperture, stds: [f32; 2], sigma: &Plane) -> Self {
        let index = |s: f32| (s.abs() / DISK_STEP).round() as usize;
        let largest = sigma.data().iter().map(|&s| index(s)).max().unwrap_or(0);
        let mut used = vec![false; largest + 1];
        sigma.data().iter().for_each(|&s| used[index(s)] = true);
        let of_sizes_seen = Outline::new(aperture.bokeh, 0.0);
        let kernels = par::map(used.len(), |i| {
            if i == 0 || !used[i] {
                return None;
            }
            let stds = stds.map(|s| i as f32 * DISK_STEP * s);
            let [from, to] = SEEN_FROM;
            let unseen = ((to - stds[0].min(stds[1])) / (to - from)).clamp(0.0, 1.0);
            let stds = stds.map(f64::from);
            Some(match unseen > 0.0 {
                true => Kernel::new(&Outline::new(aperture.bokeh, unseen), stds),
                false => Kernel::new(&of_sizes_seen, stds),
            })
        });
        let half_disk = |i: usize| {
            let t = 2.0 * i as f64 / CELLS as f64 - 1.0;
            (0.5 * (t * (1.0 - t * t).max(0.0).sqrt() + t.asin() + FRAC_PI_2)) as f32
        };
        Self { kernels, cats_eye: aperture.cats_eye, half_disk: (0..=CELLS).map(half_disk).collect() }
    }

    fn of(&self, sigma: f32) -> Option<&Kernel> {
        self.kernels[((sigma.abs() / DISK_STEP).round() as usize).min(self.kernels.len() - 1)].as_ref()
    }

    /// The spans that a pixel of a std gathers; a std is negative in front of the focus.
    pub fn kernel(&self, sigma: f32) -> &Spans {
        const NONE: &Spans = &Spans { rows: vec![], area: 0.0 };
        self.of(sigma).map_or(NONE, |kernel| &kernel.spans[usize::from(sigma > 0.0)])
    }

    /// The cut of the shape at a position from the picture's centre, in halves of its diagonal; `None` without a cat's eye. Beyond the
    /// picture's corners the cut is that of the corners: farther out nothing would be left of the shape.
    pub fn cut(&self, field: [f32; 2], sigma: f32) -> Option<Cut<'_>> {
        let kernel = self.of(sigma).filter(|_| self.cats_eye > 0.0)?;
        let side = if sigma > 0.0 { -1.0 } else { 1.0 };
        let inwards = field[0].hypot(field[1]).max(1.0).recip();
        let [x, y] = field.map(|f| side * self.cats_eye * inwards * f * kernel.radius as f32);
        let [[along, right], [down, below]] = kernel.placed.map(|p| p.map(|v| v as f32));
        let radius = kernel.radius as f32;
        Some(Cut {
            half_disk: &self.half_disk,
            centre: [side * right + along * x, side * below + down * y],
            radii: [along * radius, down * radius],
        })
    }
}

/// An ellipse within which a shape is kept: the image of the lens's barrel.
pub(super) struct Cut<'a> {
    half_disk: &'a [f32],
    /// The centre, px from the pixel.
    centre: [f32; 2],
    /// The radius along x and y, px.
    radii: [f32; 2],
}

impl Cut<'_> {
    /// The part of a row that is left, if there is one.
    pub fn of(&self, Span { dy, left, right }: Span) -> Option<Span> {
        let below = |y: f32| {
            let at =
                (0.5 * ((y - self.centre[1]) / self.radii[1] + 1.0) * CELLS as f32).clamp(0.0, CELLS as f32);
            let i = (at as usize).min(CELLS - 1);
            let (a, b) = (self.half_disk[i], self.half_disk[i + 1]);
            a + (at - i as f32) * (b - a)
        };
        // Half the mean length of the ellipse's part in the row.
        let half = self.radii[0] * self.radii[1] * (below(dy as f32 + 0.5) - below(dy as f32 - 0.5));
        let (left, right) = (left.max(self.centre[0] - half), right.min(self.centre[0] + half));
        (right > left).then_some(Span { dy, left, right })
    }
}

#[cfg(test)]
mod tests {
    use crate::model::{Aperture, Bokeh};
    use crate::synth::defocus::{Lens, defocus, defocus_through};
    use crate::{Plane, Raster};

    const N: usize = 121;
    const MIDDLE: f64 = 60.0;

    #[test]
    fn beyond_the_picture_a_cat_s_eye_is_that_of_its_corners() {
        let aperture = Aperture { bokeh: Bokeh::Disk, squeeze: 1.0, cats_eye: 1.0 };
        let apertures = super::Apertures::new(&aperture, [1.0; 2], &Plane::filled(1, 1, 4.0));
        let area = |field: [f32; 2]| -> f32 {
            let cut = apertures.cut(field, 4.0).expect("it is cut");
            let rows = apertures.kernel(4.0).rows.iter().filter_map(|&row| cut.of(row));
            rows.map(|row| row.right - row.left).sum()
        };
        let corner = area([0.8, 0.6]);
        assert!(corner > 0.0 && area([0.0; 2]) > corner);
        assert!((area([8.0, 6.0]) - corner).abs() < 1e-3);
    }

    fn polygon(blades: u8, roundness: f32, rotation_degrees: f32) -> Bokeh {
        Bokeh::Polygon { blades, roundness, rotation_degrees }
    }

    /// The image of a point in the middle of a picture, or of a part of a larger one.
    fn point(sigma: f32, lens: impl Fn(&mut Lens)) -> Plane {
        let mut p = Plane::filled(N, N, 0.0);
        p.row_mut(N / 2)[N / 2] = 1.0;
        let mut through = Lens::new(Aperture::default(), (N, N));
        lens(&mut through);
        defocus_through(&p, &Plane::filled(N, N, sigma), &through).unwrap()
    }

    /// The energy, the mean and the variance along both axes, and the covariance, px.
    fn moments(q: &Plane) -> [f64; 6] {
        let sum = |g: &dyn Fn(f64, f64) -> f64| -> f64 {
            (0..N * N)
                .map(|i| f64::from(q.data()[i]) * g((i % N) as f64 - MIDDLE, (i / N) as f64 - MIDDLE))
                .sum()
        };
        let energy = sum(&|_, _| 1.0);
        let (x, y) = (sum(&|x, _| x) / energy, sum(&|_, y| y) / energy);
        let about = |g: &dyn Fn(f64, f64) -> f64| sum(&|i, j| g(i - x, j - y)) / energy;
        [energy, x, y, about(&|x, _| x * x), about(&|_, y| y * y), about(&|x, y| x * y)]
    }

    #[test]
    fn every_shape_keeps_energy_and_place_and_has_the_gaussian_s_second_moment() {
        let shapes = [
            polygon(3, 0.0, 10.0),
            polygon(5, 0.0, 0.0),
            polygon(6, 0.5, 20.0),
            polygon(9, 0.3, 3.0),
            polygon(16, 0.0, 0.0),
            polygon(4, 1.0, 0.0),
        ];
        for bokeh in shapes {
            for (squeeze, aspect) in [(1.0, 1.0), (2.0, 1.0), (0.5, 1.0), (1.0, 2.0), (2.0, 2.0)] {
                let aperture = Aperture { squeeze, ..bokeh.into() };
                let [x, y] = aperture.stds(aspect).map(f64::from);
                // These are multiples of the step between prepared kernels.
                for sigma in [0.3125, 0.5, 0.796_875, 1.3125, 2.5, 6.0, 11.0, -2.5] {
                    let q = point(sigma, |l| (l.aperture, l.pixel_aspect) = (aperture, aspect));
                    let [energy, mx, my, vx, vy, _] = moments(&q);
                    let want = [x, y].map(|s| (s * f64::from(sigma)).powi(2));
                    let what = format!("{bokeh:?} {squeeze} {aspect} {sigma}");
                    assert!((energy - 1.0).abs() < 1e-3, "{what}: energy {energy}");
                    assert!(mx.abs() < 0.01 && my.abs() < 0.01, "{what}: middle {mx} {my}");
                    assert!((vx / want[0] - 1.0).abs() < 0.02, "{what}: {vx} along x, not {}", want[0]);
                    assert!((vy / want[1] - 1.0).abs() < 0.02, "{what}: {vy} along y, not {}", want[1]);
                    // Negative control: a std that is wrong by a twentieth would be found.
                    assert!((vx / (1.1 * want[0]) - 1.0).abs() > 0.02);
                }
            }
        }
        // A squeeze of 2 makes points twice as high as wide, and pixels twice as wide as high halve the width.
        let stds = |squeeze, aspect| Aperture { squeeze, ..Bokeh::Disk.into() }.stds(aspect);
        assert!((stds(2.0, 1.0)[1] / stds(2.0, 1.0)[0] - 2.0).abs() < 1e-6);
        assert_eq!(stds(1.0, 2.0), [0.5, 1.0]);
        assert_eq!(stds(1.0, 1.0), [1.0, 1.0]);
    }

    #[test]
    fn gaussians_are_stretched_too() {
        for (squeeze, aspect) in [(2.0, 1.0), (1.0, 2.0), (0.5, 1.5)] {
            let aperture = Aperture { squeeze, ..Bokeh::Gaussian.into() };
            for sigma in [0.4f32, 1.5, 4.0, 9.0] {
                let [energy, mx, my, vx, vy, _] =
                    moments(&point(sigma, |l| (l.aperture, l.pixel_aspect) = (aperture, aspect)));
                let [x, y] = aperture.stds(aspect).map(|s| f64::from(s * sigma).powi(2));
                assert!((energy - 1.0).abs() < 2e-3 && mx.abs() < 1e-3 && my.abs() < 1e-3);
                assert!(
                    (vx / x - 1.0).abs() < 0.01 && (vy / y - 1.0).abs() < 0.01,
                    "{sigma}: {vx} {vy}, not {x} {y}"
                );
            }
        }
    }

    #[test]
    fn a_polygon_of_full_roundness_is_the_disk_and_a_straight_one_is_not() {
        let disk = defocus(
            &{
                let mut p = Plane::filled(N, N, 0.0);
                p.row_mut(N / 2)[N / 2] = 1.0;
                p
            },
            &Plane::filled(N, N, 6.0),
            Bokeh::Disk,
        )
        .unwrap();
        let largest = |bokeh: Bokeh| {
            let q = point(6.0, |l| l.aperture = bokeh.into());
            q.data().iter().zip(disk.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) * 452.4
        };
        assert!(largest(polygon(5, 1.0, 7.0)) < 0.05, "{}", largest(polygon(5, 1.0, 7.0)));
        assert!(largest(polygon(5, 0.0, 7.0)) > 0.9);
        // Unseen shapes of a small blur are the disk's.
        let small = |bokeh: Bokeh| point(0.45, |l| l.aperture = bokeh.into());
        let (a, b) = (small(polygon(3, 0.0, 0.0)), small(polygon(16, 1.0, 0.0)));
        assert!(a.data().iter().zip(b.data()).all(|(a, b)| (a - b).abs() < 2e-3));
    }

    #[test]
    fn a_polygon_has_its_corners_where_they_should_be_and_turns_upside_down_before_the_focus() {
        // A triangle of std 6 has its corners 17 px from the middle, one of them on top.
        let at = |q: &Plane, x: i32, y: i32| q.at((60 + x) as usize, (60 + y) as usize) > 1e-4;
        for (sigma, rotation, up) in
            [(6.0, 0.0, true), (-6.0, 0.0, false), (6.0, 180.0, false), (6.0, 120.0, true)]
        {
            let q = point(sigma, |l| l.aperture = polygon(3, 0.0, rotation).into());
            assert_eq!((at(&q, 0, -14), at(&q, 0, 14)), (up, !up), "{sigma} {rotation}");
        }
        // A clockwise turn by 30 degrees brings the upper corner to the right.
        let q = point(6.0, |l| l.aperture = polygon(3, 0.0, 30.0).into());
        assert!(at(&q, 7, -12) && !at(&q, -7, -12));
        // Hexagons look the same turned by 60 degrees, and mirrored, but not turned by 30 degrees.
        let of = |rotation| point(6.0, |l| l.aperture = polygon(6, 0.0, rotation).into());
        let apart =
            |a: &Plane, b: &Plane| -> f32 { a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).sum() };
        assert!(apart(&of(10.0), &of(70.0)) < 1e-3);
        let ten = of(10.0);
        let mirrored = Raster::from_fn(N, N, |x, y| ten.at(N - 1 - x, y));
        assert!(apart(&mirrored, &of(-10.0)) < 1e-3, "{}", apart(&mirrored, &of(-10.0)));
        assert!(apart(&of(0.0), &of(30.0)) > 0.05);
    }

    #[test]
    fn a_cat_s_eye_has_the_area_of_two_disks_overlap_and_lies_outwards() {
        let (w, h) = (1001, 801);
        let half_diagonal = 0.5 * (w as f32).hypot(h as f32);
        for (strength, sigma) in [(1.0, 8.0f32), (0.5, 8.0), (1.0, 4.0), (1.0, -8.0)] {
            // The point lies right of the picture's centre.
            let origin = (700, 340);
            let q = point(sigma, |l| {
                *l = Lens {
                    picture: (w, h),
                    origin,
                    ..Lens::new(Aperture { cats_eye: strength, ..Bokeh::Disk.into() }, (w, h))
                };
            });
            // A disk's area that is left, at this distance of the centres in radii.
            let t = strength * (760.0 - 500.0) / half_diagonal;
            let left = (2.0 * (0.5 * t).acos() - t * (1.0 - 0.25 * t * t).sqrt()) / std::f32::consts::PI;
            // The image is as bright in its middle as its area says; the cut changes a little from one side to the other.
            let middle = q.at((60.0 + t * sigma).round() as usize, 60);
            let area = 1.0 / (middle * std::f32::consts::PI * 4.0 * sigma * sigma);
            assert!((area / left - 1.0).abs() < 0.015, "{strength} {sigma}: {area}, not {left}");
            let [energy, mx, my, vx, vy, _] = moments(&q);
            // The images of points move outwards the more the farther out they are, so that the picture is a little larger, and what is even
            // stays as bright: a point then has so much more energy.
            let larger = f64::from(0.5 * sigma.abs() * 2.0 * strength / half_diagonal * sigma.signum());
            assert!((energy - (1.0 + 2.0 * larger)).abs() < 2e-3, "{strength} {sigma}: {energy} {larger}");
            // The middle of the overlap is halfway between both centres; in front of the focus everything is upside down.
            let middle = f64::from(t * sigma);
            assert!(
                (mx / middle - 1.0).abs() < 0.05 && my.abs() < 0.01,
                "{strength} {sigma}: {mx}, not {middle}"
            );
            assert!(vx < vy);
            // Negative control: without the cut the area is another.
            assert!((left - 1.0).abs() > 0.1);
        }
        // Next to nothing is cut in the middle of the picture.
        let lens = |cats_eye| {
            let aperture = Aperture { cats_eye, ..Bokeh::Disk.into() };
            point(8.0, |l| *l = Lens { origin: (440, 340), ..Lens::new(aperture, (w, h)) })
        };
        let [cut, whole] = [lens(1.0), lens(0.0)].map(|q| moments(&q));
        assert!((cut[3] / whole[3] - 1.0).abs() < 0.01 && cut[1].abs() < 1e-3, "{cut:?} {whole:?}");
    }

    #[test]
    fn an_image_cut_out_of_the_picture_is_blurred_as_in_the_picture() {
        let src = Raster::from_fn(160, 140, |x, y| [((x * 7 + y * 13) % 29) as f32 / 29.0, 1.0]);
        let sigma = Plane::from_fn(160, 140, |x, y| 0.02 * (x + y) as f32 - 1.5);
        let aperture = Aperture { squeeze: 1.5, cats_eye: 0.8, ..polygon(5, 0.2, 12.0).into() };
        let lens = Lens::new(aperture, (160, 140));
        let whole = defocus_through(&src, &sigma, &lens).unwrap();
        let origin = (40, 30);
        let crop = |lens: &Lens| {
            defocus_through(&src.crop(40, 30, 110, 100), &sigma.crop(40, 30, 110, 100), lens).unwrap()
        };
        let error = |part: &Raster<[f32; 2]>| {
            let apart = |x: usize, y: usize| (part.at(x, y)[0] - whole.at(x + 40, y + 30)[0]).abs();
            (20..80).flat_map(|y| (20..90).map(move |x| (x, y))).map(|(x, y)| apart(x, y)).fold(0.0, f32::max)
        };
        assert!(error(&crop(&Lens { origin, ..lens })) < 1e-5);
        assert!(error(&crop(&lens)) > 1e-3);
        // What is even stays even, whatever the shape.
        assert!(whole.data().iter().all(|v| (v[1] - 1.0).abs() < 1e-4));
    }
}
