//! Cuts between the shots of a clip.

use super::active_area::ActiveArea;
use super::flow;
use crate::{Encoded, Plane, Result, pyramid};
use std::ops::Range;

/// The share of confirmed matches, in [0, 1], below which two frames lie on both sides of a cut, or their flow is not reliable.
pub const MIN_CONFIRMED: f32 = 0.4;
/// The number of cells of a frame's thumbnail, across and down.
const CELLS: [usize; 2] = [16, 12];
/// The most rows and columns of a cell that are sampled.
const SAMPLES: usize = 16;
/// The value of 1 minus the correlation of two thumbnails at and above which there may be a cut between them. On a montage, cuts gave
/// 0.7 to 1.3, a bus that drives past close to the camera 0.4, and all other pairs less than 0.2.
const SUSPICIOUS: f32 = 0.25;
/// The std of a thumbnail below which a frame counts as even.
const EVEN: f32 = 1e-3;
/// The largest length, in px, of the longer side of the pictures whose flow decides on a cut.
const SIDE: usize = 256;

/// Whether a cut lies between two successive frames of one size: their thumbnails differ and flow finds hardly anything of one frame
/// in the other, or just one of the frames is even, as black frames between shots are.
///
/// # Errors
/// The same as [`flow::flow_with_occlusion`].
pub fn cut_between(frame: &Encoded, next: &Encoded) -> Result<bool> {
    flow::check(frame.0.size(), next.0.size())?;
    let picture = Picture::of(frame, next);
    Ok(match picture.look(frame, next) {
        Look::Alike => false,
        // Flow would find a match for anything in an even frame.
        Look::OneIsEven => true,
        Look::Different => {
            flow::flow_with_occlusion(&picture.small(frame), &picture.small(next))?.confirmed()
                < MIN_CONFIRMED
        }
    })
}

/// Whether the thumbnails of two frames differ so much that there may be a cut between the frames.
pub(crate) fn look_different(frame: &Encoded, next: &Encoded) -> bool {
    !matches!(Picture::of(frame, next).look(frame, next), Look::Alike)
}

/// The result of a comparison of two thumbnails.
enum Look {
    Alike,
    Different,
    OneIsEven,
}

/// The active area of two frames. Bars would make any two frames look alike.
struct Picture(ActiveArea);

impl Picture {
    fn of(frame: &Encoded, next: &Encoded) -> Self {
        Self(ActiveArea::of(frame).and(&ActiveArea::of(next)))
    }

    /// The mean R, G and B of each cell, row by row.
    fn thumbnail(&self, Encoded(frame): &Encoded) -> Vec<[f32; 3]> {
        let places = |cell: usize, cells: usize, of: &Range<usize>| {
            let (first, end) = (cell * of.len() / cells, (cell + 1) * of.len() / cells);
            let end = end.max(first + 1);
            (of.start + first..of.start + end).step_by((end - first).div_ceil(SAMPLES))
        };
        let mut means = Vec::with_capacity(CELLS[0] * CELLS[1]);
        for row in 0..CELLS[1] {
            for column in 0..CELLS[0] {
                let (mut sum, mut count) = ([0.0f32; 3], 0);
                for y in places(row, CELLS[1], &self.0.rows) {
                    for x in places(column, CELLS[0], &self.0.columns) {
                        let p = frame.at(x, y);
                        (0..3).for_each(|c| sum[c] += p[c]);
                        count += 1;
                    }
                }
                means.push(sum.map(|v| v / count as f32));
            }
        }
        means
    }

    /// Compares the thumbnails of two frames by their correlation, after subtraction of each channel's mean.
    fn look(&self, frame: &Encoded, next: &Encoded) -> Look {
        let (a, b) = (self.thumbnail(frame), self.thumbnail(next));
        let n = a.len() as f32;
        let [mut aa, mut ab, mut bb] = [0.0f32; 3];
        for c in 0..3 {
            let mean = |v: &[[f32; 3]]| v.iter().map(|p| p[c]).sum::<f32>() / n;
            let (mean_a, mean_b) = (mean(&a), mean(&b));
            for (a, b) in a.iter().zip(&b) {
                let (a, b) = (a[c] - mean_a, b[c] - mean_b);
                (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
            }
        }
        let even = |sum: f32| sum < 3.0 * n * EVEN * EVEN;
        match (even(aa), even(bb)) {
            (true, true) => Look::Alike,
            (false, false) if 1.0 - ab / (aa * bb).sqrt() < SUSPICIOUS => Look::Alike,
            (false, false) => Look::Different,
            _ => Look::OneIsEven,
        }
    }

    /// Luma of the picture, halved to a size at which flow is quick.
    fn small(&self, frame: &Encoded) -> Plane {
        let ActiveArea { columns, rows } = &self.0;
        let picture = frame.0.crop(columns.start, rows.start, columns.len(), rows.len());
        pyramid::halved_luma(&picture, |w, h| w.max(h) > SIDE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Raster;

    /// A picture of 12 px wide squares of random colours, shifted by (dx, dy) px.
    fn picture(seed: u32, [dx, dy]: [usize; 2]) -> Encoded {
        Encoded(Raster::from_fn(320, 240, |x, y| {
            let cell = ((x + dx) / 12 * 7919 + (y + dy) / 12 * 104_729) as u32 + seed * 1_299_709;
            std::array::from_fn(|c| {
                let hash = (cell + 31 * c as u32).wrapping_mul(0x9e37_79b1);
                ((hash ^ (hash >> 15)).wrapping_mul(0x85eb_ca6b) >> 16) as f32 / 65535.0
            })
        }))
    }

    #[test]
    fn another_scene_is_a_cut_and_one_that_moves_or_grows_brighter_is_not() {
        let here = picture(1, [0, 0]);
        assert!(cut_between(&here, &picture(2, [0, 0])).unwrap());
        assert!(!cut_between(&here, &here).unwrap());
        let brighter = Encoded(here.0.map(|p| p.map(|v| 0.1 + 0.6 * v)));
        assert!(!cut_between(&here, &brighter).unwrap());
        // The picture moves so far that the thumbnails differ, but flow finds it again.
        let moved = picture(1, [9, 5]);
        assert!(look_different(&here, &moved));
        assert!(!cut_between(&here, &moved).unwrap());
    }

    #[test]
    fn tiny_and_even_frames_are_compared_too() {
        let even = |v: f32, w: usize, h: usize| Encoded(Raster::filled(w, h, [v; 3]));
        assert!(!cut_between(&even(0.2, 1, 1), &even(0.7, 1, 1)).unwrap());
        assert!(!cut_between(&even(0.2, 40, 3), &even(0.7, 40, 3)).unwrap());
        // A black frame between two shots belongs to neither.
        let (here, black) = (picture(1, [0, 0]), even(0.0, 320, 240));
        assert!(cut_between(&here, &black).unwrap() && cut_between(&black, &here).unwrap());
    }

    #[test]
    fn bars_and_a_common_cast_hide_no_cut() {
        let barred = |seed| {
            let Encoded(p) = picture(seed, [0, 0]);
            let inside = |x: usize| (110..210).contains(&x);
            let cast = |v: [f32; 3]| [0.2 + 0.3 * v[0], 0.1 + 0.2 * v[1], 0.2 * v[2]];
            Encoded(Raster::from_fn(320, 240, |x, y| if inside(x) { cast(p.at(x, y)) } else { [0.0; 3] }))
        };
        assert!(cut_between(&barred(1), &barred(2)).unwrap());
        assert!(!cut_between(&barred(1), &barred(1)).unwrap());
    }
}
