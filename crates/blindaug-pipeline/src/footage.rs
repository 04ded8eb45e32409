//! Frames and their accompanying data, from any source.

use crate::{Error, Result};
use blindaug::{Encoded, Flow, Frame, Plane, model::DepthKind};
use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicBool, Ordering},
    time::SystemTime,
};

/// Frames, one after another.
pub type Frames<'a> = Box<dyn Iterator<Item = Result<Frame>> + 'a>;

/// A clip: numbered frames of one size, in the order of time, which can be gone through any number of times.
pub trait Clip: Sync {
    /// The name of the clip in messages.
    fn name(&self) -> String;

    /// Width and height, px.
    fn size(&self) -> (usize, usize);

    /// Frames per second, if that is known.
    fn fps(&self) -> Option<f64>;

    /// The width of a pixel over its height, as the picture is shown, if that is known. By default nothing is known.
    fn pixel_aspect(&self) -> Option<f32> {
        None
    }

    /// The number of frames, if it is known without going through them.
    fn len_hint(&self) -> Option<usize>;

    /// The frames whose numbers are wanted.
    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a>;

    /// [`Clip::frames_if`], and besides the frames next to the clip's own, one on each side, where the clip is a part of a longer one and they are
    /// wanted. By default there are none.
    fn frames_and_beside<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        self.frames_if(wanted)
    }

    /// Whether a frame of this number, which the clip gave, is one of its own, rather than one next to them.
    fn contains(&self, number: u64) -> bool {
        let _ = number;
        true
    }

    /// Whether `wanted` holds for the number of any frame. By default the numbers are gone through without reading a frame.
    ///
    /// # Errors
    /// If the numbers cannot be found out.
    fn any_number(&self, wanted: &(dyn Fn(u64) -> bool + Sync)) -> Result<bool> {
        let found = AtomicBool::new(false);
        let mut none = self.frames_if(Box::new(|number| {
            found.fetch_or(wanted(number), Ordering::Relaxed);
            false
        }));
        none.next().transpose()?;
        drop(none);
        Ok(found.into_inner())
    }

    /// When the frame of this number was last changed, if that is known. By default it is not.
    fn changed(&self, number: u64) -> Option<SystemTime> {
        let _ = number;
        None
    }

    /// Whether frames may be read ahead in a thread of their own, as they are by default. A clip whose frames come out of the caller's own code
    /// says no: that code then runs in the caller's thread.
    fn reads_ahead(&self) -> bool {
        true
    }

    /// What is wrong with the frames that were read so far, a sentence without a full stop. By default nothing is.
    fn warning(&self) -> Option<String> {
        None
    }

    /// Fails if `what` takes more bytes than the memory budget has. By default any number is fine.
    ///
    /// # Errors
    /// If the budget does not suffice; the sentence has both numbers.
    fn check_memory(&self, what: &str, bytes: u64) -> Result<()> {
        let _ = (what, bytes);
        Ok(())
    }
}

/// All frames of a clip.
pub(crate) fn all_frames(clip: &dyn Clip) -> Frames<'_> {
    clip.frames_if(Box::new(|_| true))
}

/// All frames of a clip and the frame after them, where the clip is a part of a longer one.
pub(crate) fn all_frames_and_one(clip: &dyn Clip) -> Frames<'_> {
    let mut before = true;
    let frames = clip.frames_and_beside(Box::new(|_| true));
    Box::new(frames.skip_while(move |frame| {
        before &= frame.as_ref().is_ok_and(|frame| !clip.contains(frame.number));
        before
    }))
}

/// How many frames beside those that are looked at are in memory while a clip is read ahead: one waits, one is being read.
pub(crate) const READ_AHEAD: usize = 2;

/// What `look` makes of the frames of a clip, such as [`all_frames`], which are read ahead in a thread of their own if the clip allows it.
#[cfg(feature = "threads")]
pub(crate) fn read_ahead<R>(
    clip: &dyn Clip,
    frames_of: fn(&dyn Clip) -> Frames<'_>,
    look: impl FnOnce(Frames) -> R,
) -> R {
    if !clip.reads_ahead() {
        return look(frames_of(clip));
    }
    std::thread::scope(|scope| {
        let (sender, frames) = std::sync::mpsc::sync_channel(READ_AHEAD - 1);
        let reader = scope.spawn(move || {
            // Nobody takes any more once `look` has ended.
            frames_of(clip).try_for_each(|frame| sender.send(frame)).ok();
        });
        let seen = look(Box::new(frames.into_iter()));
        if let Err(panic) = reader.join() {
            std::panic::resume_unwind(panic);
        }
        seen
    })
}

/// What `look` makes of the frames of a clip, such as [`all_frames`].
#[cfg(not(feature = "threads"))]
pub(crate) fn read_ahead<R>(
    clip: &dyn Clip,
    frames_of: fn(&dyn Clip) -> Frames<'_>,
    look: impl FnOnce(Frames) -> R,
) -> R {
    look(frames_of(clip))
}

/// Data that accompany the frames of a clip, such as depth or flow, by the frames' numbers.
pub trait Side<T>: Sync {
    /// The name of the data in messages.
    fn name(&self) -> String;

    /// Whether there are data for the frame of this number.
    fn has(&self, number: u64) -> bool;

    /// The data of a frame of this number and size, if there are any.
    ///
    /// # Errors
    /// If the data cannot be read, or have another size.
    fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<T>>;

    /// When the data of the frame of this number were last changed, if that is known. By default it is not.
    fn changed(&self, number: u64) -> Option<SystemTime> {
        let _ = number;
        None
    }

    /// What is wrong with the data that were read so far, a sentence without a full stop. By default nothing is.
    fn warning(&self) -> Option<String> {
        None
    }
}

/// When the data for the frame of this number were last changed, if there are any and that is known.
pub(crate) fn changed<T>(side: Option<&BoxedSide<T>>, number: u64) -> Option<SystemTime> {
    side.and_then(|side| side.changed(number))
}

/// Accompanying data from any source.
pub type BoxedSide<T> = Box<dyn Side<T>>;

/// Frames in memory, numbered from 1 on.
#[derive(Clone, Debug, Default)]
pub struct MemoryClip {
    /// The frames, all of one size.
    pub frames: Vec<Encoded>,
    /// Frames per second, if that is known.
    pub fps: Option<f64>,
}

impl Clip for MemoryClip {
    fn name(&self) -> String {
        "the frames".into()
    }

    fn size(&self) -> (usize, usize) {
        self.frames.first().map_or((0, 0), |f| f.0.size())
    }

    fn fps(&self) -> Option<f64> {
        self.fps
    }

    fn len_hint(&self) -> Option<usize> {
        Some(self.frames.len())
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        let numbered = (1..).zip(&self.frames).filter(move |(number, _)| wanted(*number));
        Box::new(numbered.map(|(number, image)| Ok(Frame { number, image: image.clone() })))
    }
}

impl<T: Clone + Sync> Side<T> for BTreeMap<u64, T> {
    fn name(&self) -> String {
        "what belongs to the frames".into()
    }

    fn has(&self, number: u64) -> bool {
        self.contains_key(&number)
    }

    fn get(&self, number: u64, _: (usize, usize)) -> Result<Option<T>> {
        Ok(BTreeMap::get(self, &number).cloned())
    }
}

#[cfg(feature = "files")]
impl Clip for blindaug_io::FrameSource {
    fn name(&self) -> String {
        blindaug_io::Error::shown_path(self.path())
    }

    fn size(&self) -> (usize, usize) {
        self.size()
    }

    fn fps(&self) -> Option<f64> {
        self.fps()
    }

    fn pixel_aspect(&self) -> Option<f32> {
        self.pixel_aspect()
    }

    fn len_hint(&self) -> Option<usize> {
        self.len_hint()
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        Box::new(self.frames_if(wanted).map(|frame| Ok(frame?)))
    }

    fn frames_and_beside<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        Box::new(self.frames_and_beside(wanted).map(|frame| Ok(frame?)))
    }

    fn contains(&self, number: u64) -> bool {
        self.contains(number)
    }

    fn any_number(&self, wanted: &(dyn Fn(u64) -> bool + Sync)) -> Result<bool> {
        // The frames of a video are slow to count.
        if self.is_video() {
            let first = self.first_number();
            return Ok(self.len_hint().is_none_or(|n| (first..first + n as u64).any(wanted)));
        }
        let found = AtomicBool::new(false);
        let mut none = self.frames_if(|number| {
            found.fetch_or(wanted(number), Ordering::Relaxed);
            false
        });
        none.next().transpose()?;
        drop(none);
        Ok(found.into_inner())
    }

    fn changed(&self, number: u64) -> Option<SystemTime> {
        self.changed(number)
    }

    fn warning(&self) -> Option<String> {
        self.warning()
    }

    fn check_memory(&self, what: &str, bytes: u64) -> Result<()> {
        Ok(blindaug_io::memory::fits(self.path(), what, bytes)?)
    }
}

#[cfg(feature = "files")]
impl<T> Side<T> for blindaug_io::SideFolder<T> {
    fn name(&self) -> String {
        blindaug_io::Error::shown_path(self.path())
    }

    fn has(&self, number: u64) -> bool {
        self.has(number)
    }

    fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<T>> {
        Ok(self.get(number, size)?)
    }

    fn changed(&self, number: u64) -> Option<SystemTime> {
        self.changed(number)
    }

    fn warning(&self) -> Option<String> {
        self.warning()
    }
}

/// Whether a map of inverse depth has a reading anywhere: all of it may be infinitely far.
pub(crate) fn has_reading(map: &Plane) -> bool {
    map.data().iter().any(|v| !v.is_nan())
}

/// Fails if there are no data for any of a clip's frames.
///
/// # Errors
/// [`Error::NoMatch`], or if the frames' numbers cannot be found out.
pub fn check_match<T>(clip: &dyn Clip, side: Option<&dyn Side<T>>) -> Result<()> {
    let Some(side) = side else { return Ok(()) };
    if clip.any_number(&|number| side.has(number))? {
        return Ok(());
    }
    Err(Error::NoMatch { side: side.name(), clip: clip.name() })
}

/// Frames and the evidence that is given for them.
pub struct Footage {
    /// The frames.
    pub clip: Box<dyn Clip>,
    /// Inverse depth (NaN: no reading) and its kind.
    pub depth: Option<(BoxedSide<Plane>, DepthKind)>,
    /// Optical flow to the next frame, px.
    pub flow: Option<BoxedSide<Flow>>,
    /// The frames without noise.
    pub denoised: Option<BoxedSide<Encoded>>,
    /// The frames without noise and motion blur.
    pub motion_deblurred: Option<BoxedSide<Encoded>>,
    /// The frames without noise and defocus.
    pub defocus_deblurred: Option<BoxedSide<Encoded>>,
    /// The frames without noise, motion blur and defocus.
    pub clean: Option<BoxedSide<Encoded>>,
    /// Whether networks made the frames from which something was removed, which widens intervals.
    pub by_network: bool,
    /// Whether the flow was found in these frames by an earlier estimate, rather than given.
    pub flow_found: bool,
}

impl Footage {
    /// Frames without any evidence.
    pub fn new(clip: impl Clip + 'static) -> Self {
        Self::of(Box::new(clip))
    }

    /// [`Footage::new`] of a clip that is boxed already.
    pub fn of(clip: Box<dyn Clip>) -> Self {
        Self {
            clip,
            depth: None,
            flow: None,
            denoised: None,
            motion_deblurred: None,
            defocus_deblurred: None,
            clean: None,
            by_network: false,
            flow_found: false,
        }
    }

    /// All four kinds of frames from which something was removed.
    pub(crate) fn removed(&self) -> [&Option<BoxedSide<Encoded>>; 4] {
        [&self.denoised, &self.motion_deblurred, &self.defocus_deblurred, &self.clean]
    }

    /// Whether there are frames from which something was removed.
    pub fn has_removed(&self) -> bool {
        self.removed().iter().any(|f| f.is_some())
    }
}

/// Frames in memory as a clip that says or does something else than [`MemoryClip`].
#[cfg(test)]
pub(crate) struct AlteredClip {
    pub clip: MemoryClip,
    pub len_hint: Option<usize>,
    pub pixel_aspect: Option<f32>,
    pub reads_ahead: bool,
    /// What is done with the number of each frame that is asked for.
    pub on_frame: Box<dyn Fn(u64) + Send + Sync>,
}

#[cfg(test)]
impl AlteredClip {
    pub fn of(frames: Vec<Encoded>) -> Self {
        let len_hint = Some(frames.len());
        let clip = MemoryClip { frames, fps: None };
        Self { clip, len_hint, pixel_aspect: None, reads_ahead: true, on_frame: Box::new(|_| {}) }
    }
}

#[cfg(test)]
impl Clip for AlteredClip {
    fn name(&self) -> String {
        self.clip.name()
    }

    fn size(&self) -> (usize, usize) {
        self.clip.size()
    }

    fn fps(&self) -> Option<f64> {
        self.clip.fps()
    }

    fn pixel_aspect(&self) -> Option<f32> {
        self.pixel_aspect
    }

    fn len_hint(&self) -> Option<usize> {
        self.len_hint
    }

    fn reads_ahead(&self) -> bool {
        self.reads_ahead
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        Box::new(self.clip.frames_if(wanted).inspect(|frame| {
            if let Ok(frame) = frame {
                (self.on_frame)(frame.number);
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;
    use std::sync::{Arc, Mutex};

    #[test]
    fn the_frames_of_a_clip_that_is_not_read_ahead_are_asked_for_in_the_caller_s_thread() {
        for reads_ahead in [false, true] {
            let frames = vec![Encoded(Raster::filled(2, 2, [0.5; 3])); 3];
            let threads = Arc::new(Mutex::new(vec![]));
            let noted = threads.clone();
            let clip = AlteredClip {
                reads_ahead,
                on_frame: Box::new(move |_| noted.lock().unwrap().push(std::thread::current().id())),
                ..AlteredClip::of(frames)
            };
            assert_eq!(read_ahead(&clip, all_frames, |frames| frames.count()), 3);
            let seen = threads.lock().unwrap();
            // Negative control: read ahead, they come from another thread.
            assert!(
                seen.iter().all(|&id| (id == std::thread::current().id()) != reads_ahead),
                "{reads_ahead}"
            );
            assert_eq!(seen.len(), 3);
        }
    }

    #[test]
    fn a_clip_that_is_read_ahead_gives_its_frames_in_order_and_its_panics() {
        let frames = (0..9).map(|i| Encoded(Raster::filled(2, 2, [0.1 * i as f32; 3]))).collect();
        let clip = MemoryClip { frames, fps: None };
        let numbers = |clip: &dyn Clip, most: usize| {
            read_ahead(clip, all_frames, |frames| {
                frames
                    .take(most)
                    .map(|f| f.unwrap())
                    .map(|f| (f.number, f.image.0.at(0, 0)[0]))
                    .collect::<Vec<_>>()
            })
        };
        let all: Vec<_> = (1..=9).map(|n| (n, 0.1 * (n - 1) as f32)).collect();
        assert_eq!(numbers(&clip, usize::MAX), all);
        // Whoever has seen enough is not kept waiting.
        assert_eq!(numbers(&clip, 3), all[..3]);
        let panics = AlteredClip {
            on_frame: Box::new(|number| assert!(number != 5, "the frame that panics")),
            ..AlteredClip::of(clip.frames)
        };
        let seen = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| numbers(&panics, usize::MAX)));
        let why = seen.expect_err("frame 5 panics");
        assert_eq!(why.downcast_ref(), Some(&"the frame that panics"));
        // Negative control: a frame that is not read does no harm.
        assert_eq!(numbers(&panics, 2), all[..2]);
    }
}
