//! The part of a frame that a camera filmed: the frame without bars of one colour at its edges, such as those above and below a film that was made for a
//! screen of another shape (letterbox, pillarbox).

use crate::{Encoded, Flow};
use std::ops::Range;

/// The most by which a channel of a bar's pixels may differ, encoded values: a coder leaves about a step of 8 bits in a bar. What a camera films is
/// noisier along a whole row or column.
const ALIKE: f32 = 2.5 / 255.0;

/// The encoded value below which all is black, however noisy: the bars of an analogue recording are.
const BLACK: f32 = 0.02;

/// The rows and columns of a frame, px, that lie within its bars.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ActiveArea {
    pub columns: Range<usize>,
    pub rows: Range<usize>,
}

impl ActiveArea {
    /// The active area of a frame. A frame that is of one colour everywhere has no bars, but is its own active area.
    pub fn of(Encoded(frame): &Encoded) -> Self {
        let (w, h) = frame.size();
        let is_black = |p: [f32; 3]| p.iter().all(|&v| v < BLACK);
        let alike = |a: [f32; 3], b: [f32; 3]| {
            (0..3).all(|c| (a[c] - b[c]).abs() <= ALIKE) || is_black(a) && is_black(b)
        };
        let rows = within(h, |edge, y| {
            let colour = frame.at(0, edge);
            frame.row(y).iter().all(|p| alike(*p, colour))
        });
        let columns =
            within(w, |edge, x| rows.clone().all(|y| alike(frame.at(x, y), frame.at(edge, rows.start))));
        if rows.is_empty() || columns.is_empty() {
            Self { columns: 0..w, rows: 0..h }
        } else {
            Self { columns, rows }
        }
    }

    /// The smallest area that holds two areas.
    pub fn and(&self, other: &Self) -> Self {
        let both = |a: &Range<usize>, b: &Range<usize>| a.start.min(b.start)..a.end.max(b.end);
        Self { columns: both(&self.columns, &other.columns), rows: both(&self.rows, &other.rows) }
    }

    /// Whether all of a frame of this size is active.
    pub fn is_all_of(&self, (width, height): (usize, usize)) -> bool {
        (self.columns.clone(), self.rows.clone()) == (0..width, 0..height)
    }

    /// A flow that was given, NaN outside the area; `None` if there is none or all of the frame is active.
    pub fn flow_within(&self, flow: Option<&Flow>) -> Option<Flow> {
        flow.and_then(|flow| self.motion(flow.size(), |x, y| flow.at(x, y)))
    }

    /// The motion of a frame of this size, px, which is `of` within the area and NaN outside; `None` if all of the frame is active.
    pub fn motion(&self, size: (usize, usize), of: impl Fn(usize, usize) -> [f32; 2] + Sync) -> Option<Flow> {
        let at = |x, y| if self.holds((x, y), 1) { of(x, y) } else { [f32::NAN; 2] };
        (!self.is_all_of(size)).then(|| Flow::from_fn(size.0, size.1, at))
    }

    /// Whether the square of this side, px, whose corner is at (x, y) lies in the area.
    pub fn holds(&self, (x, y): (usize, usize), side: usize) -> bool {
        let holds = |of: &Range<usize>, first: usize| of.start <= first && first + side <= of.end;
        holds(&self.columns, x) && holds(&self.rows, y)
    }
}

/// The lines of `0..count` between those at both ends that are `like_edge(edge, line)`.
fn within(count: usize, like_edge: impl Fn(usize, usize) -> bool) -> Range<usize> {
    let first = (0..count).find(|&i| !like_edge(0, i)).unwrap_or(count);
    let last = (first..count).rfind(|&i| !like_edge(count - 1, i));
    first..last.map_or(first, |last| last + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Raster;
    use crate::fit::noise::tests::white;

    /// A noisy picture of std 0.02 with bars of this colour outside `area`.
    fn barred(area: &ActiveArea, colour: [f32; 3]) -> Encoded {
        let noise = white(96, 64, 3);
        Encoded(Raster::from_fn(96, 64, |x, y| {
            if area.holds((x, y), 1) { noise.at(x, y).map(|n| 0.3 + 0.02 * n) } else { colour }
        }))
    }

    #[test]
    fn what_lies_within_bars_is_the_active_area() {
        let all = ActiveArea { columns: 0..96, rows: 0..64 };
        let letterbox = ActiveArea { rows: 10..55, ..all.clone() };
        let pillarbox = ActiveArea { columns: 7..80, ..all.clone() };
        let both = ActiveArea { columns: 7..80, rows: 10..55 };
        for area in [&all, &letterbox, &pillarbox, &both] {
            for colour in [[0.0; 3], [0.31; 3], [1.0, 0.2, 0.4]] {
                assert_eq!(&ActiveArea::of(&barred(area, colour)), area, "{colour:?}");
            }
        }
        // A coder leaves a step of 8 bits in a bar.
        let coded = barred(&both, [0.0; 3]).0;
        let coded = Raster::from_fn(96, 64, |x, y| coded.at(x, y).map(|v| v + ((x + y) % 3) as f32 / 255.0));
        assert_eq!(ActiveArea::of(&Encoded(coded)), both);
        let noisy = barred(&both, [0.0; 3]).0;
        let noisy = |peak: f32| {
            let at =
                |x: usize, y: usize| noisy.at(x, y).map(|v| v + peak * ((7 * x + 5 * y) % 11) as f32 / 10.0);
            ActiveArea::of(&Encoded(Raster::from_fn(96, 64, at)))
        };
        assert_eq!(noisy(0.019), both);
        // Negative control: noise that is brighter than black is a picture.
        assert_eq!(noisy(0.03), all);
        assert_eq!(letterbox.and(&pillarbox), all);
        let motion = both.motion((96, 64), |_, _| [3.0, 0.0]).unwrap();
        assert!(motion.at(6, 30)[0].is_nan() && motion.at(7, 54) == [3.0, 0.0]);
    }

    #[test]
    fn a_frame_of_one_colour_has_no_bars() {
        for size @ (w, h) in [(1, 1), (40, 3), (96, 64)] {
            let area = ActiveArea::of(&Encoded(Raster::filled(w, h, [0.0; 3])));
            assert!(area.is_all_of(size) && area.motion(size, |_, _| [1.0; 2]).is_none());
        }
    }
}
