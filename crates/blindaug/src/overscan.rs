//! Pictures that reach beyond the frame.

use crate::Raster;

/// How far a picture reaches beyond the frame on each side, px. Renderers call it overscan: the data window of an EXR file is then larger than
/// its display window, which is the frame.
///
/// ```
/// use blindaug::{Overscan, Plane};
/// let overscan = Overscan { left: 2, top: 1, right: 0, bottom: 3 };
/// assert_eq!(overscan.picture_of((160, 90)), (162, 94));
/// assert_eq!(overscan.frame_of(&Plane::filled(162, 94, 0.5)).size(), (160, 90));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overscan {
    /// Columns left of the frame.
    pub left: usize,
    /// Rows above the frame.
    pub top: usize,
    /// Columns right of the frame.
    pub right: usize,
    /// Rows below the frame.
    pub bottom: usize,
}

impl Overscan {
    /// Whether the picture ends with the frame.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// The size of the picture around a frame of this size, px.
    pub fn picture_of(&self, (width, height): (usize, usize)) -> (usize, usize) {
        (width + self.left + self.right, height + self.top + self.bottom)
    }

    /// The size of the frame in a picture of this size, px; 0 if the picture is smaller than the overscan.
    pub fn frame_size(&self, (width, height): (usize, usize)) -> (usize, usize) {
        (width.saturating_sub(self.left + self.right), height.saturating_sub(self.top + self.bottom))
    }

    /// The frame, cut out of a picture, which must be at least as large as the overscan.
    pub fn frame_of<T: Copy + Send + Sync>(&self, picture: &Raster<T>) -> Raster<T> {
        let (width, height) = self.frame_size(picture.size());
        picture.crop(self.left, self.top, width, height)
    }

    /// A picture around a frame, in which the frame's edge is repeated beyond it.
    pub fn continued<T: Copy + Default + Send + Sync>(&self, frame: &Raster<T>) -> Raster<T> {
        let (width, height) = self.picture_of(frame.size());
        Raster::from_fn(width, height, |x, y| {
            frame.at_clamped(x as isize - self.left as isize, y as isize - self.top as isize)
        })
    }

    /// Puts a frame into a picture.
    pub fn put_frame<T: Copy>(&self, frame: &Raster<T>, picture: &mut Raster<T>) {
        for y in 0..frame.height() {
            picture.row_mut(self.top + y)[self.left..][..frame.width()].copy_from_slice(frame.row(y));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Plane;

    #[test]
    fn a_frame_is_continued_cut_out_and_put_back() {
        let overscan = Overscan { left: 2, top: 1, right: 3, bottom: 4 };
        let frame = Plane::from_fn(5, 4, |x, y| (x + 10 * y) as f32);
        let picture = overscan.continued(&frame);
        assert_eq!(picture.size(), (10, 9));
        assert_eq!(
            [picture.at(0, 0), picture.at(2, 1), picture.at(9, 8), picture.at(4, 0)],
            [0.0, 0.0, 34.0, 2.0]
        );
        assert_eq!(overscan.frame_of(&picture), frame);
        let mut other = Plane::filled(10, 9, -1.0);
        overscan.put_frame(&frame, &mut other);
        assert_eq!(overscan.frame_of(&other), frame);
        assert_eq!([other.at(1, 1), other.at(7, 4)], [-1.0; 2]);
        // Negative control: the frame does not begin at the picture's corner.
        assert_ne!(picture.crop(0, 0, 5, 4), frame);
    }
}
