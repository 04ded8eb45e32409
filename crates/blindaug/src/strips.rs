//! Strips: bands of rows in which a large image is processed, one after another, so that intermediate images are never held whole.

use crate::Raster;
use std::ops::Range;

/// The rows around a strip that are processed with it: results on a pyramid of up to [`GRID`] px depend on no row farther away.
const HALO: usize = 128;
/// Strips and the rows around them begin at multiples of this many rows, so that the pyramid of a strip has the pixels of the whole
/// image's.
const GRID: usize = 32;
/// The number of pixels above which an image is processed in strips.
pub(crate) const STRIP: usize = 1 << 22;

/// Rows of an image, and the larger range of rows on which their result depends.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Strip {
    pub rows: Range<usize>,
    pub around: Range<usize>,
}

/// The strips of an image of `width` x `height` px, from the top; a single one if the image has at most `most` pixels.
pub(crate) fn strips(size: (usize, usize), most: usize) -> impl Iterator<Item = Strip> {
    strips_of(0..size.1, size, most)
}

/// The strips of some rows of an image, which begin on the pyramids' grid; one if they have at most `most` pixels.
pub(crate) fn strips_of(
    of: Range<usize>,
    (width, height): (usize, usize),
    most: usize,
) -> impl Iterator<Item = Strip> {
    let rows = if width * of.len() <= most { of.len() } else { (most / width / GRID).max(1) * GRID };
    of.clone().step_by(rows.max(1)).map(move |top| {
        let rows = top..(top + rows).min(of.end);
        Strip { around: grown(&rows, HALO, height), rows }
    })
}

/// The rows that are looked at in turn `i` of `turns`, which together are all rows once. They begin on the pyramids' grid.
pub(crate) fn rows_in_turn(i: usize, turns: usize, height: usize) -> Range<usize> {
    let edge = |k: usize| if k == turns { height } else { k * (height / GRID) / turns * GRID };
    edge(i % turns)..edge(i % turns + 1)
}

/// The number of turns ([`rows_in_turn`]) in which strips of about so many px make up an image of this size.
pub(crate) fn turns_of((width, height): (usize, usize), px: usize) -> usize {
    (width * height).div_ceil(px).min((height / GRID).max(1))
}

/// Pixels of the largest strip of an image with what is around it.
pub(crate) fn largest_strip(size: (usize, usize)) -> u64 {
    strips(size, STRIP).map(|s| (s.around.len() * size.0) as u64).max().unwrap_or(0)
}

/// The rows and up to `by` more on both sides, within an image of `height` rows.
pub(crate) fn grown(rows: &Range<usize>, by: usize, height: usize) -> Range<usize> {
    rows.start.saturating_sub(by)..rows.end.saturating_add(by).min(height)
}

/// The rows `keep` of an image that consists of the rows `of`; `keep` must lie within `of`.
pub(crate) fn kept<T>(image: Raster<T>, of: &Range<usize>, keep: &Range<usize>) -> Raster<T> {
    image.into_rows(keep.start - of.start..keep.end - of.start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_cover_every_row_once_and_begin_on_the_grid() {
        for (size, most) in [((100, 100), 10_000), ((100, 101), 10_000), ((7, 1000), 700), ((40, 333), 1)] {
            let all: Vec<Strip> = strips(size, most).collect();
            assert_eq!(all.len() == 1, size.0 * size.1 <= most);
            let mut next = 0;
            for Strip { rows, around } in all {
                assert!(
                    rows.start == next
                        && rows.start.is_multiple_of(GRID)
                        && around.start.is_multiple_of(GRID)
                );
                assert!(around.start <= rows.start && around.end >= rows.end);
                assert!(around.end.is_multiple_of(GRID) || around.end == size.1);
                next = rows.end;
            }
            assert_eq!(next, size.1);
        }
        assert_eq!(strips((5, 0), 9).count(), 0);
    }

    #[test]
    fn turns_cover_every_row_once_and_begin_on_the_grid() {
        for (turns, height) in [(1, 1080), (4, 1080), (8, 2160), (5, 167), (3, 20)] {
            let mut next = 0;
            for turn in 0..turns {
                let rows = rows_in_turn(turn, turns, height);
                assert_eq!(rows, rows_in_turn(turn + turns, turns, height));
                assert!(rows.start == next && rows.start.is_multiple_of(GRID), "{turns} {height} {rows:?}");
                next = rows.end;
            }
            assert_eq!(next, height);
        }
    }
}
