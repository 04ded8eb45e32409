//! Cutting images into overlapping tiles, and the weights by which the tiles are put together again.

/// An interval of pixels along a side of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    pub start: usize,
    pub len: usize,
}

/// Evenly spaced intervals of at most `tile` px that cover a side of `side` px and overlap by `overlap` px or more.
pub fn spans(side: usize, tile: usize, overlap: usize) -> Vec<Span> {
    if side <= tile {
        return vec![Span { start: 0, len: side }];
    }
    let count = (side - overlap).div_ceil(tile - overlap);
    (0..count).map(|i| Span { start: i * (side - tile) / (count - 1), len: tile }).collect()
}

/// The pixel of a side of `side` px that stands for pixel `i`, which may lie beyond the end: mirrored at the edge pixels.
pub fn reflected(i: usize, side: usize) -> usize {
    let period = (2 * side).saturating_sub(2).max(1);
    let i = i % period;
    if i < side { i } else { period - i }
}

/// The weight of a tile's pixel `i`, up to 1; it falls towards an edge that another tile overlaps.
pub fn weight(span: Span, i: usize, side: usize, overlap: usize) -> f32 {
    let ramp = |distance: usize| ((distance + 1) as f32 / (overlap + 1) as f32).min(1.0);
    let before = if span.start == 0 { 1.0 } else { ramp(i) };
    let after = if span.start + span.len == side { 1.0 } else { ramp(span.len - 1 - i) };
    before * after
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_a_side_and_overlap() {
        for (side, tile, overlap) in
            [(1, 64, 16), (64, 64, 16), (65, 64, 16), (1000, 64, 16), (1920, 512, 32)]
        {
            let spans = spans(side, tile, overlap);
            assert_eq!(spans[0].start, 0);
            assert_eq!(spans.last().map(|s| s.start + s.len), Some(side));
            assert!(spans.iter().all(|s| s.len <= tile));
            assert!(spans.windows(2).all(|s| s[0].start + s[0].len >= s[1].start + overlap), "{spans:?}");
        }
        assert_eq!(spans(1920, 512, 32).len(), 4);
    }

    #[test]
    fn outside_is_mirrored() {
        let of = |side| (0..6).map(|i| reflected(i, side)).collect::<Vec<_>>();
        assert_eq!(of(3), [0, 1, 2, 1, 0, 1]);
        assert_eq!(of(1), [0; 6]);
    }

    #[test]
    fn weights_fall_only_where_tiles_overlap() {
        let [first, last] = spans(100, 64, 16)[..] else { panic!() };
        assert_eq!((weight(first, 0, 100, 16), weight(first, 30, 100, 16)), (1.0, 1.0));
        assert!(weight(first, 63, 100, 16) < 0.1 && weight(last, 0, 100, 16) < 0.1);
        assert_eq!(weight(last, 63, 100, 16), 1.0);
    }
}
