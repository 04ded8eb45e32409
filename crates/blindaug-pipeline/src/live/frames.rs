//! The frames of a camera, or of a clip that starts again at its end, with their neighbours.

use crate::{
    Result,
    footage::{Clip, Frames, all_frames},
};
use blindaug::{Encoded, Frame};
use std::sync::Arc;

/// A frame and its neighbours.
#[derive(Clone, Debug)]
pub struct LiveFrame {
    /// The frame's number: it counts from 1 on, and goes on when a clip starts again.
    pub number: u64,
    /// The number of times that the clip had started again.
    pub lap: u64,
    /// The frame.
    pub frame: Arc<Encoded>,
    /// The next frame; `None` for the last one of a clip.
    pub next: Option<Arc<Encoded>>,
    /// The previous frame; `None` for the first one of a clip.
    pub previous: Option<Arc<Encoded>>,
}

/// The frames of a clip without an end: after the last one comes the first again.
pub struct Loop<'a> {
    clip: &'a dyn Clip,
    frames: Frames<'a>,
    previous: Option<Arc<Encoded>>,
    current: Option<Arc<Encoded>>,
    /// The number of frames given so far.
    count: u64,
    lap: u64,
}

impl<'a> Loop<'a> {
    /// Starts with the first frame.
    pub fn new(clip: &'a dyn Clip) -> Self {
        Self { clip, frames: all_frames(clip), previous: None, current: None, count: 0, lap: 0 }
    }

    /// The next frame; `None` if there are no frames at all.
    ///
    /// # Errors
    /// If the frame or the one after it cannot be read.
    pub fn next_frame(&mut self) -> Result<Option<LiveFrame>> {
        let read = |frames: &mut Frames| -> Result<Option<Arc<Encoded>>> {
            Ok(frames.next().transpose()?.map(|Frame { image, .. }| Arc::new(image)))
        };
        let frame = match self.current.take() {
            Some(frame) => frame,
            None => {
                if self.count > 0 {
                    self.frames = all_frames(self.clip);
                    self.previous = None;
                    self.lap += 1;
                }
                let Some(first) = read(&mut self.frames)? else { return Ok(None) };
                first
            }
        };
        let next = read(&mut self.frames)?;
        self.count += 1;
        self.current.clone_from(&next);
        let previous = self.previous.replace(frame.clone());
        Ok(Some(LiveFrame { number: self.count, lap: self.lap, frame, next, previous }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MemoryClip;
    use blindaug::Raster;

    #[test]
    fn a_clip_starts_again_and_its_ends_are_no_neighbours() {
        let frame = |i: u8| Encoded(Raster::filled(4, 4, [f32::from(i) / 255.0; 3]));
        let clip = MemoryClip { frames: (1..=3).map(frame).collect(), fps: None };
        let mut frames = Loop::new(&clip);
        let value =
            |f: &Option<Arc<Encoded>>| f.as_ref().map_or(0, |f| (255.0 * f.0.at(0, 0)[0]).round() as u8);
        for number in 1..=8u64 {
            let frame = frames.next_frame().unwrap().unwrap();
            let [before, here, after] = [&frame.previous, &Some(frame.frame.clone()), &frame.next].map(value);
            let wanted = [[0, 1, 2], [1, 2, 3], [2, 3, 0]][(number as usize - 1) % 3];
            assert_eq!((frame.number, frame.lap), (number, (number - 1) / 3));
            assert_eq!([before, here, after], wanted);
        }
    }
}
