//! Motion blur: the mean over the path that each pixel travels while the shutter is open (Potmesil & Chakravarty 1983).
//!
//! A sharp frame shows the scene at the frame's time, on which the exposure is centred unless the shutter has another phase.

use crate::model::Shutter;
use crate::{Error, Flow, Pixel, Raster, Result};
use std::ops::Range;

/// Blurs each pixel of `src` along its own path: the mean over x - (c + lambda t) F(x), t in [-1/2, 1/2], with c the middle of the exposure
/// after the frame's time, in frame intervals.
///
/// A centred exposure of 0 and a flow of 0 are the exact identity; unknown (NaN, infinite) flow counts as 0. Outside the
/// image, the nearest pixel inside is repeated.
///
/// # Errors
/// If the flow has another size than the image.
pub fn motion_blur<P: Pixel>(src: &Raster<P>, flow: &Flow, shutter: impl Into<Shutter>) -> Result<Raster<P>> {
    check_size(src.size(), flow)?;
    let shutter = shutter.into();
    if src.data().is_empty() || !shutter.moves() {
        return Ok(src.clone());
    }
    let rows = Rows { rows: src, top: 0, height: src.height() };
    Ok(rows.blurred(flow, shutter, 0..src.height()))
}

/// Fails if the flow is not of an image of this size.
pub(super) fn check_size((width, height): (usize, usize), flow: &Flow) -> Result<()> {
    if flow.size() != (width, height) {
        return Err(Error::new(format!(
            "the flow has {} x {} pixels but the image {width} x {height}; give flow of the image's size",
            flow.width(),
            flow.height(),
        )));
    }
    Ok(())
}

/// Some rows, from `top` on, of an image of `height` rows.
pub(super) struct Rows<'a, P> {
    pub rows: &'a Raster<P>,
    pub top: usize,
    pub height: usize,
}

impl<P: Pixel> Rows<'_, P> {
    /// The image rows `rows` of [`motion_blur`]'s result; their paths ([`reach_px`]) must lie within the rows held. The flow is
    /// that of the whole image.
    pub fn blurred(&self, flow: &Flow, shutter: Shutter, rows: Range<usize>) -> Raster<P> {
        Raster::from_fn(flow.width(), rows.len(), |x, y| {
            let y = rows.start + y;
            self.sample((x, y), flow.at(x, y), shutter)
        })
    }
}

/// The largest number of rows by which the path of a pixel of these rows reaches up or down.
pub(super) fn reach_px(flow: &Flow, shutter: Shutter, rows: Range<usize>) -> usize {
    let (w, reach) = (flow.width(), |v: f32| if v.is_finite() { v.abs() } else { 0.0 });
    let longest = flow.data()[rows.start * w..rows.end * w].iter().map(|f| reach(f[1])).fold(0.0, f32::max);
    // The two rows more are for interpolation at the path's ends and for rounding.
    ((shutter.reach() * longest).ceil() as usize).saturating_add(2)
}

/// The motion-blurred value of pixel (x, y) of a non-empty image, if it moves by `[u, v]` px per frame interval.
///
/// The integral is taken by the midpoint rule with ceil(length) + 1 bilinear taps, which are less than 1 px apart; it is continuous
/// at length 0.
#[inline]
pub fn sample<P: Pixel>(
    src: &Raster<P>,
    x: usize,
    y: usize,
    flow: [f32; 2],
    shutter: impl Into<Shutter>,
) -> P {
    Rows { rows: src, top: 0, height: src.height() }.sample((x, y), flow, shutter.into())
}

impl<P: Pixel> Rows<'_, P> {
    #[inline]
    fn sample(&self, (x, y): (usize, usize), [u, v]: [f32; 2], Shutter { exposure, centre }: Shutter) -> P {
        let Self { rows, top, height } = *self;
        // The length in px beyond which a path gets no more taps: across the whole image and back. This bounds the work for absurd flow.
        let longest = 2.0 * (rows.width() + height) as f32;
        let (dx, dy) = (exposure.0 * u, exposure.0 * v);
        let length = dx.hypot(dy);
        let away = centre * u.hypot(v);
        if !(length > 0.0 || away != 0.0) || !length.is_finite() || !away.is_finite() {
            return rows.at(x, y - top);
        }
        let taps = length.min(longest).ceil() + 1.0;
        let (x, y) = (x as f32 - centre * u, y as f32 - centre * v);
        let inside = |at: f32, by: f32, size: usize| {
            at - 0.5 * by.abs() > 0.0 && at + 0.5 * by.abs() < (size - 1) as f32
        };
        let sum = if inside(x, dx, rows.width()) && inside(y, dy, height) {
            sum_of_taps(taps, |t| rows.bilinear_inside(x + t * dx, y + t * dy, top))
        } else {
            sum_of_taps(taps, |t| rows.bilinear_of_rows(x + t * dx, y + t * dy, top, height))
        };
        let mut mean = P::default();
        mean.add_scaled(sum, 1.0 / taps);
        mean
    }
}

/// The sum of the values at the midpoints of `taps` equal parts of [-1/2, 1/2].
#[inline(always)]
fn sum_of_taps<P: Pixel>(taps: f32, value: impl Fn(f32) -> P) -> P {
    let mut sum = P::default();
    let mut i = 0.5;
    let part = 1.0 / taps;
    while i < taps {
        sum.add_scaled(value(i * part - 0.5), 1.0);
        i += 1.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Plane;
    use crate::model::{ExposureFraction, MotionBlurModel};

    fn texture(w: usize, h: usize) -> Raster<[f32; 3]> {
        Raster::from_fn(w, h, |x, y| [((x * 7 + y * 13) % 11) as f32, ((x * y) % 5) as f32, (x + y) as f32])
    }

    #[test]
    fn no_exposure_no_motion_and_unknown_motion_are_the_exact_identity() {
        let t = texture(33, 21);
        let blur = |f: [f32; 2], e| motion_blur(&t, &Flow::filled(33, 21, f), ExposureFraction(e)).unwrap();
        assert_eq!(blur([9.0, -4.0], 0.0), t);
        assert_eq!(blur([0.0, 0.0], 1.0), t);
        assert_eq!(blur([f32::NAN, 3.0], 1.0), t);
        assert_eq!(blur([f32::INFINITY, 3.0], 1.0), t);
        assert_ne!(blur([0.5, 0.0], 0.5), t);
    }

    #[test]
    fn a_point_becomes_a_centred_streak_of_the_path_s_length_with_its_energy_kept() {
        let mut p = Plane::filled(61, 41, 0.0);
        p.row_mut(20)[30] = 1.0;
        for (f, e) in [([24.0, 0.0], 0.5), ([12.0, 9.0], 0.8), ([0.0, -16.0], 1.0), ([1.0, 0.3], 0.4)] {
            let q = motion_blur(&p, &Flow::filled(61, 41, f), ExposureFraction(e)).unwrap();
            let moment = |g: &dyn Fn(f32, f32) -> f32| -> f32 {
                (0..41)
                    .flat_map(|y| (0..61).map(move |x| (x, y)))
                    .map(|(x, y)| q.at(x, y) * g(x as f32 - 30.0, y as f32 - 20.0))
                    .sum()
            };
            let energy = moment(&|_, _| 1.0);
            assert!((energy - 1.0).abs() < 1e-4, "{f:?} {energy}");
            assert!(moment(&|x, _| x).abs() < 1e-3 && moment(&|_, y| y).abs() < 1e-3);
            // A uniform streak of length L has the variance L^2 / 12; the bilinear taps add at most 1/4.
            let (dx, dy) = (f[0] * e, f[1] * e);
            for (got, l) in [(moment(&|x, _| x * x), dx), (moment(&|_, y| y * y), dy)] {
                let want = l * l / 12.0;
                assert!(got > 0.7 * want - 1e-4 && got < want + 0.26, "{f:?}: variance {got}, path {l}");
            }
        }
    }

    #[test]
    fn a_shutter_s_phase_moves_the_streak_and_nothing_else() {
        let mut p = Plane::filled(81, 41, 0.0);
        p.row_mut(20)[40] = 1.0;
        let moments = |phase_degrees: Option<f32>, e: f32, f: [f32; 2]| {
            let model = MotionBlurModel { phase_degrees, ..MotionBlurModel::given(ExposureFraction(e)) };
            let q = motion_blur(&p, &Flow::filled(81, 41, f), model.shutter()).unwrap();
            let moment = |g: &dyn Fn(f32, f32) -> f32| -> f32 {
                let of_row = |y| (0..81).map(move |x| (x, y));
                (0..41).flat_map(of_row).map(|(x, y)| q.at(x, y) * g(x as f32 - 40.0, y as f32 - 20.0)).sum()
            };
            let (energy, x, y) = (moment(&|_, _| 1.0), moment(&|x, _| x), moment(&|_, y| y));
            [energy, x, y, moment(&|x, _| x * x) - x * x]
        };
        let f = [24.0, 6.0];
        let centred = moments(None, 0.5, f);
        // A shutter of 180 degrees: opening at -90 is centred; at 0 the middle is a quarter of an interval later.
        for (phase, quarters) in [(-90.0, 0.0), (0.0, 1.0), (-180.0, -1.0), (90.0, 2.0)] {
            let [energy, x, y, variance] = moments(Some(phase), 0.5, f);
            assert!((energy - 1.0).abs() < 1e-4, "{phase}: {energy}");
            assert!((x - 0.25 * quarters * f[0]).abs() < 0.02, "{phase}: {x}");
            assert!((y - 0.25 * quarters * f[1]).abs() < 0.02, "{phase}: {y}");
            assert!((variance / centred[3] - 1.0).abs() < 0.02, "{phase}: {variance}");
        }
        // Negative control: the other direction would be wrong by twice the way.
        assert!((moments(Some(0.0), 0.5, f)[1] - -6.0).abs() > 11.0);
        // A shutter that hardly opens shows things where they are when it opens.
        assert!((moments(Some(45.0), 0.0, f)[1] - 3.0).abs() < 1e-3);
        // A centred phase is the same as none, bit by bit.
        assert_eq!(moments(Some(-90.0), 0.5, f), centred);
    }

    #[test]
    fn it_commutes_with_translation() {
        let (a, b) = (texture(60, 50), Raster::from_fn(60, 50, |x, y| texture(80, 70).at(x + 7, y + 4)));
        let f = Flow::filled(60, 50, [9.0, 5.0]);
        let (a, b) = (
            motion_blur(&a, &f, ExposureFraction(0.9)).unwrap(),
            motion_blur(&b, &f, ExposureFraction(0.9)).unwrap(),
        );
        for y in 12..34 {
            for x in 12..40 {
                for c in 0..3 {
                    assert!((a.at(x + 7, y + 4)[c] - b.at(x, y)[c]).abs() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn the_integral_is_close_to_one_with_many_taps() {
        let p = Plane::from_fn(64, 64, |x, y| (0.5 * x as f32).sin() + (0.3 * y as f32).cos());
        for (f, e) in [([13.0, 3.0], 0.5), ([1.0, 0.0], 1.0), ([-8.0, 6.0], 0.31)] {
            let q = motion_blur(&p, &Flow::filled(64, 64, f), ExposureFraction(e)).unwrap();
            for (x, y) in [(20, 20), (31, 40), (45, 27)] {
                let n = 2000;
                let fine: f32 = (0..n)
                    .map(|i| {
                        let t = (i as f32 + 0.5) / n as f32 - 0.5;
                        p.bilinear(x as f32 + t * e * f[0], y as f32 + t * e * f[1])
                    })
                    .sum::<f32>()
                    / n as f32;
                assert!((q.at(x, y) - fine).abs() < 0.01, "{f:?}: {} {fine}", q.at(x, y));
            }
        }
    }

    #[test]
    fn any_size_and_any_flow_end() {
        for (w, h) in [(0, 0), (1, 1), (1, 9), (9, 1)] {
            let t = texture(w, h);
            for f in [3.0, 1e30, f32::MAX] {
                let q = motion_blur(&t, &Flow::filled(w, h, [f, f]), ExposureFraction(1.0)).unwrap();
                assert_eq!(q.size(), (w, h));
                assert!(q.data().iter().flatten().all(|v| v.is_finite()));
            }
        }
        let e =
            motion_blur(&texture(4, 4), &Flow::filled(5, 4, [0.0; 2]), ExposureFraction(1.0)).unwrap_err();
        assert!(e.to_string().contains("5 x 4"));
    }
}
