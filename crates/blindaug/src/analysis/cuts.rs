//! Cuts between the shots of a clip.

use super::flow;
use crate::{Encoded, Plane, Result, pyramid};

/// Less than this share of confirmed matches between two frames is a cut, or nothing to rely on.
pub const MIN_CONFIRMED: f32 = 0.4;
/// Cells of a frame's thumbnail, across and down.
const CELLS: [usize; 2] = [16, 12];
/// Rows and columns of a cell that are looked at, at most.
const SAMPLES: usize = 16;
/// 1 - the correlation of two thumbnails from which on there may be a cut between them. On a montage, cuts gave 0.7 to 1.3, a bus that
/// drives past close to the camera 0.4, all else less than 0.2.
const SUSPICIOUS: f32 = 0.25;
/// px of the longer side at which flow then decides.
const SIDE: usize = 256;

/// Whether a cut lies between two successive frames of one size: they look different from afar, and hardly anything of one is found
/// again in the other.
///
/// # Errors
/// As [`flow::flow_with_occlusion`].
pub fn cut_between(frame: &Encoded, next: &Encoded) -> Result<bool> {
    Ok(look_different(frame, next)
        && flow::flow_with_occlusion(&small(frame), &small(next))?.confirmed() < MIN_CONFIRMED)
}

/// Whether two frames look so different from afar that there may be a cut between them.
pub(crate) fn look_different(frame: &Encoded, next: &Encoded) -> bool {
    1.0 - correlation(&thumbnail(frame), &thumbnail(next)) > SUSPICIOUS
}

/// Means over cells.
fn thumbnail(Encoded(frame): &Encoded) -> Vec<f32> {
    let (w, h) = frame.size();
    let places = |cell: usize, cells: usize, n: usize| {
        let (first, end) = (cell * n / cells, ((cell + 1) * n / cells).max(cell * n / cells + 1));
        (first..end).step_by((end - first).div_ceil(SAMPLES))
    };
    let mut means = Vec::with_capacity(3 * CELLS[0] * CELLS[1]);
    for row in 0..CELLS[1] {
        for column in 0..CELLS[0] {
            let (mut sum, mut count) = ([0.0f32; 3], 0);
            for y in places(row, CELLS[1], h) {
                for x in places(column, CELLS[0], w) {
                    let p = frame.at(x, y);
                    (0..3).for_each(|c| sum[c] += p[c]);
                    count += 1;
                }
            }
            means.extend(sum.map(|v| v / count as f32));
        }
    }
    means
}

/// Of values at the same places; 1 where one of them is even: that tells nothing.
fn correlation(a: &[f32], b: &[f32]) -> f32 {
    let n = a.len() as f32;
    let (mean_a, mean_b) = (a.iter().sum::<f32>() / n, b.iter().sum::<f32>() / n);
    let [mut aa, mut ab, mut bb] = [0.0f32; 3];
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
    }
    let norm = (aa * bb).sqrt();
    if norm > 1e-9 { ab / norm } else { 1.0 }
}

fn small(frame: &Encoded) -> Plane {
    let mut luma = frame.luma();
    while luma.width().max(luma.height()) > SIDE {
        luma = pyramid::downsample(&luma);
    }
    luma
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Raster;

    /// Squares of random colours, `side` px wide, seen from a place.
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
        // It moves so far that it looks different from afar, but is found again.
        let moved = picture(1, [9, 5]);
        assert!(look_different(&here, &moved));
        assert!(!cut_between(&here, &moved).unwrap());
    }

    #[test]
    fn tiny_and_even_frames_are_compared_too() {
        let even = |v: f32, w: usize, h: usize| Encoded(Raster::filled(w, h, [v; 3]));
        assert!(!cut_between(&even(0.2, 1, 1), &even(0.7, 1, 1)).unwrap());
        assert!(!cut_between(&even(0.2, 40, 3), &even(0.7, 40, 3)).unwrap());
    }
}
