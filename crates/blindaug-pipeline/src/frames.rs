//! The loop that makes a frame from each frame of a clip.

use crate::{
    Error, Result,
    estimate::of_frame,
    footage::Clip,
    observer::{Observer, Steps},
};
use blindaug::{Encoded, Flow, Frame, Overscan, Plane, Raster, analysis, composite::DistortedLayer};
use std::{
    collections::{BTreeMap, BTreeSet},
    time::SystemTime,
};

/// Bytes per pixel of a frame, of flow, and of depth.
pub(crate) const FRAME: u64 = 12;
pub(crate) const FLOW: u64 = 8;
pub(crate) const DEPTH: u64 = 4;

/// The destination of frames, which takes them a few rows at a time from the top.
pub trait Sink {
    /// The numbers of the frames that are there already, and when each was made: it is made again if what it is made from has changed since.
    /// Without a time it is left as it is. By default there are none.
    fn there(&self) -> BTreeMap<u64, Option<SystemTime>> {
        BTreeMap::new()
    }

    /// Begins a frame of this number, width and height.
    ///
    /// # Errors
    /// If the frame cannot be begun.
    fn begin(&mut self, number: u64, size: (usize, usize)) -> Result<()>;

    /// Takes the next rows of the frame.
    ///
    /// # Errors
    /// If the rows cannot be kept.
    fn put(&mut self, rows: &Raster<[f32; 3]>) -> Result<()>;

    /// Takes a whole frame, premultiplied by its alpha, which reaches beyond the frame as far as `overscan` says. By default alpha and what
    /// lies beyond are left out.
    ///
    /// # Errors
    /// If the frame cannot be kept.
    fn put_with_alpha(&mut self, picture: &Encoded, alpha: &Plane, overscan: Overscan) -> Result<()> {
        let _ = alpha;
        self.put(&overscan.frame_of(&picture.0))
    }

    /// Takes the frame's virtual layer, distorted, in place of the frame itself.
    ///
    /// # Errors
    /// If the layer cannot be kept; by default it cannot.
    fn put_layer(&mut self, layer: &DistortedLayer) -> Result<()> {
        let _ = layer;
        Err(Error::NoLayers)
    }

    /// Completes the frame.
    ///
    /// # Errors
    /// If the frame cannot be kept.
    fn end(&mut self) -> Result<()>;

    /// Drops the frame that was begun, since it could not be made.
    fn abandon(&mut self);
}

/// Keeps frames in memory, by number.
#[derive(Clone, Debug, Default)]
pub struct MemorySink {
    /// The frames that are complete.
    pub frames: BTreeMap<u64, Encoded>,
    /// The number, the width and the pixels so far of the frame that was begun.
    begun: Option<(u64, usize, Vec<[f32; 3]>)>,
}

impl Sink for MemorySink {
    fn begin(&mut self, number: u64, (width, height): (usize, usize)) -> Result<()> {
        self.begun = Some((number, width, Vec::with_capacity(width * height)));
        Ok(())
    }

    fn put(&mut self, rows: &Raster<[f32; 3]>) -> Result<()> {
        if let Some((.., pixels)) = &mut self.begun {
            pixels.extend_from_slice(rows.data());
        }
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        if let Some((number, width, pixels)) = self.begun.take() {
            let frame = whole(width, pixels).map_err(|error| crate::Error::Frame {
                clip: "the composite".into(),
                number,
                error,
            })?;
            self.frames.insert(number, frame);
        }
        Ok(())
    }

    fn abandon(&mut self) {
        self.begun = None;
    }
}

/// Makes a frame from its pixels, row by row.
pub(crate) fn whole(width: usize, pixels: Vec<[f32; 3]>) -> blindaug::Result<Encoded> {
    let height = pixels.len() / width.max(1);
    Ok(Encoded(Raster::from_vec(width, height, pixels)?))
}

/// The progress of a job that makes frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Made {
    /// The number of frames that were made.
    pub frames: u64,
    /// If the observer stopped the job: the numbers of the last frame that was made and of the next one.
    pub stopped: Option<(u64, u64)>,
}

/// Fails if frames of a clip with their accompanying data, `per_pixel` bytes per pixel, and the work on one of them, `work` bytes, do not
/// fit into the budget. Flow is estimated before that work, so that only the larger of both counts.
pub(crate) fn check_memory(clip: &dyn Clip, per_pixel: u64, finds_flow: bool, work: u64) -> Result<()> {
    let (width, height) = clip.size();
    let pixels = (width * height) as u64;
    let flow = if finds_flow { analysis::flow::BYTES_PER_PIXEL * pixels } else { 0 };
    clip.check_memory(
        &format!("work on frames of {width} x {height} pixels"),
        per_pixel * pixels + work.max(flow),
    )
}

/// The frames before and after a frame, if they are at hand.
pub(crate) struct Neighbours<'a> {
    clip: &'a dyn Clip,
    previous: Option<&'a Encoded>,
    next: Option<&'a Encoded>,
}

impl Neighbours<'_> {
    /// The estimated flow to the next frame; for the last frame, minus the flow to the previous one.
    pub fn flow(&self, frame: &Frame) -> Result<Option<Flow>> {
        let (other, sign) = match (self.next, self.previous) {
            (Some(next), _) => (next, 1.0),
            (None, Some(previous)) => (previous, -1.0),
            (None, None) => return Ok(None),
        };
        let flow = analysis::flow::flow(&frame.image.luma(), &other.luma())
            .map_err(|e| of_frame(self.clip, frame.number, e))?;
        Ok(Some(flow.map(|v| v.map(|c| sign * c))))
    }
}

/// The clip's frames that the sink has and that are not made again: they are no older than what they are made from. A change that lies in the
/// future, by another machine's clock, does not count: it would lie there after the frame is made anew, too.
fn kept(
    clip: &dyn Clip,
    sink: &dyn Sink,
    observer: &dyn Observer,
    changed: impl Fn(u64) -> Vec<SystemTime>,
) -> BTreeSet<u64> {
    let mut there = sink.there();
    there.retain(|n, _| clip.contains(*n));
    if there.is_empty() {
        return BTreeSet::new();
    }
    let now = SystemTime::now();
    let is_newer = |n: u64, made: SystemTime| changed(n).into_iter().any(|at| at > made && at <= now);
    let is_kept = |n: u64, made: Option<SystemTime>| made.is_none_or(|made| !is_newer(n, made));
    let kept: BTreeSet<u64> =
        there.iter().filter(|(n, made)| is_kept(**n, **made)).map(|(n, _)| *n).collect();
    let older = there.len() - kept.len();
    for (count, what) in [(kept.len(), "left as they are"), (older, "made anew, since an input is newer")] {
        if count > 0 {
            observer.note(&format!("frames that are there already and are {what}: {count}"));
        }
    }
    kept
}

/// Calls `make` for each frame that the sink does not have yet, which puts the rows of the result into the sink. Only with `neighbours` are the
/// frames before and after that frame at hand, those next to a part of a longer clip among them, so that a frame is the same whichever part it
/// is made with; else one frame is in memory at a time. `changed` tells when what is given beside a frame was last changed.
pub(crate) fn for_each_frame(
    what: &'static str,
    (clip, changed): (&dyn Clip, &dyn Fn(u64) -> Vec<SystemTime>),
    sink: &mut dyn Sink,
    neighbours: bool,
    observer: &dyn Observer,
    mut make: impl FnMut(&Frame, &Neighbours, &mut dyn Sink) -> Result<()>,
) -> Result<Made> {
    let done = kept(clip, sink, observer, |n| {
        let around = if neighbours { n.saturating_sub(1)..=n.saturating_add(1) } else { n..=n };
        around.filter_map(|n| clip.changed(n)).chain(changed(n)).collect()
    });
    let is_due = |n: u64| clip.contains(n) && !done.contains(&n);
    let needed = |n: u64| {
        let beside = |n: u64| neighbours && is_due(n);
        is_due(n) || beside(n.saturating_add(1)) || beside(n.saturating_sub(1))
    };
    let mut made = Made::default();
    let steps = Steps::begin(observer, what, "frames", clip.len_hint().map(|n| n.saturating_sub(done.len())));
    let needed = Box::new(needed);
    let mut frames = if neighbours { clip.frames_and_beside(needed) } else { clip.frames_if(needed) };
    let mut previous: Option<Frame> = None;
    let mut current = frames.next().transpose()?;
    while let Some(frame) = current.take() {
        let number = frame.number;
        // If the next frame is damaged, the loop ends here, since without it this frame's motion would be another.
        let next = if neighbours { frames.next().transpose()? } else { None };
        if is_due(number) {
            let around = Neighbours {
                clip,
                previous: previous.as_ref().filter(|p| p.number + 1 == number).map(|p| &p.image),
                next: next.as_ref().filter(|n| n.number == number + 1).map(|n| &n.image),
            };
            sink.begin(number, frame.image.0.size())?;
            if let Err(e) = make(&frame, &around, sink) {
                sink.abandon();
                return Err(e);
            }
            sink.end()?;
            made.frames += 1;
            steps.step();
        }
        (previous, current) = if neighbours {
            (Some(frame), next)
        } else {
            drop(frame);
            (None, frames.next().transpose()?)
        };
        if let (true, Some(next)) = (observer.stops(), current.as_ref().filter(|f| clip.contains(f.number))) {
            made.stopped = Some((number, next.number));
            break;
        }
    }
    Ok(made)
}
