//! A part of the frame.

use crate::{Overscan, Raster};

/// A rectangle of the frame, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub x: usize,
    pub y: usize,
    pub w: usize,
    pub h: usize,
}

impl Place {
    /// The smallest place around the pixels of which `holds` is true.
    pub fn around((w, h): (usize, usize), holds: impl Fn(usize, usize) -> bool + Sync) -> Option<Self> {
        // The first and the last such pixel of each row.
        let spans = Raster::from_fn(1, h, |_, y| {
            (0..w)
                .find(|&x| holds(x, y))
                .map(|first| (first, (first..w).rfind(|&x| holds(x, y)).unwrap_or(first)))
        });
        let rows = || spans.data().iter().enumerate().filter_map(|(y, s)| s.map(|s| (y, s)));
        let (y, bottom) = (rows().next()?.0, rows().next_back()?.0);
        let (x, right) = (rows().map(|(_, s)| s.0).min()?, rows().map(|(_, s)| s.1).max()?);
        Some(Self { x, y, w: right + 1 - x, h: bottom + 1 - y })
    }

    /// The place with `margin` px around it, as far as the frame reaches.
    pub fn grown(self, margin: usize, (w, h): (usize, usize)) -> Self {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let end = |last: usize, size: usize| last.saturating_add(margin).min(size);
        let (right, bottom) = (end(self.x + self.w, w), end(self.y + self.h, h));
        Self { x, y, w: right - x, h: bottom - y }
    }

    pub fn union(self, b: Self) -> Self {
        let (x, y) = (self.x.min(b.x), self.y.min(b.y));
        let (right, bottom) = ((self.x + self.w).max(b.x + b.w), (self.y + self.h).max(b.y + b.h));
        Self { x, y, w: right - x, h: bottom - y }
    }

    pub fn crop<T: Copy + Send + Sync>(self, image: &Raster<T>) -> Raster<T> {
        image.crop(self.x, self.y, self.w, self.h)
    }

    /// Puts an image of this place into an image of the whole frame.
    pub fn paste<T: Copy>(self, image: &Raster<T>, into: &mut Raster<T>) {
        for y in 0..self.h {
            into.row_mut(self.y + y)[self.x..][..self.w].copy_from_slice(image.row(y));
        }
    }

    /// Puts the part of an image of this place that lies in the frame into the frame, beyond which pictures reach so far.
    pub fn paste_into_frame<T: Copy>(self, image: &Raster<T>, into: &mut Raster<T>, overscan: Overscan) {
        let (left, right) = (self.x.max(overscan.left), (self.x + self.w).min(overscan.left + into.width()));
        for y in self.y.max(overscan.top)..(self.y + self.h).min(overscan.top + into.height()) {
            if left < right {
                let row = &image.row(y - self.y)[left - self.x..right - self.x];
                into.row_mut(y - overscan.top)[left - overscan.left..][..row.len()].copy_from_slice(row);
            }
        }
    }

    /// The value of an image of this place at a position in the frame.
    pub fn at<T: Copy + Send + Sync>(self, image: &Raster<T>, (x, y): (usize, usize)) -> Option<T> {
        let (x, y) = (x.checked_sub(self.x)?, y.checked_sub(self.y)?);
        (x < self.w && y < self.h).then(|| image.at(x, y))
    }
}
