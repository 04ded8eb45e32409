//! A pass over the frames of a clip with their accompanying data, a few frames at a time in memory.

use crate::{
    Result,
    footage::{
        BoxedSide, Clip, Footage, Frames, Side, all_frames, all_frames_and_one, check_match, has_reading,
        read_ahead,
    },
    observer::{Observer, Steps, warn},
    operators::{EvidenceSink, Operators},
};
use blindaug::{
    Encoded, Flow, Frame, Plane,
    fit::{Evidence, FrameObservation},
    model::Stopped,
};
use std::collections::VecDeque;

/// A consumer of the frames of a clip, one after another.
pub(crate) trait Viewer {
    /// Whether the viewer will use the next frame; else that frame is only counted.
    fn wants_next(&self) -> bool;

    /// Takes a frame and its evidence, and saves the flow and the depth that the viewer finds.
    fn view(&mut self, number: u64, observation: &FrameObservation, save: Option<Save>) -> Result<()>;
}

/// Where the evidence of a frame is saved.
pub(crate) struct Save<'a> {
    pub sink: &'a mut dyn EvidenceSink,
    /// The frame that follows the last one of a part of a longer clip. The flow to it is saved, so that parts have the flow that the whole has, but
    /// it is not looked at otherwise.
    pub after: Option<&'a Encoded>,
}

/// The frames that were seen: their number, and the numbers of the first and of the last one.
pub(crate) struct Seen {
    pub frames: usize,
    pub first: u64,
    pub last: u64,
    /// The progress, if the observer stopped the job before the end.
    pub stopped: Option<Stopped>,
}

/// Accompanying data, with a count of the frames that have them.
struct Counted<'a, T> {
    side: Option<&'a dyn Side<T>>,
    matched: u64,
}

impl<'a, T> Counted<'a, T> {
    fn new(clip: &dyn Clip, side: Option<&'a BoxedSide<T>>) -> Result<Self> {
        let side = side.map(|s| &**s);
        check_match(clip, side)?;
        Ok(Self { side, matched: 0 })
    }

    /// Counts the frame if there are data for it, and reads them if they are wanted.
    fn get(&mut self, number: u64, size: (usize, usize), wanted: bool) -> Result<Option<T>> {
        let Some(side) = self.side.filter(|s| s.has(number)) else { return Ok(None) };
        self.matched += 1;
        if wanted { side.get(number, size) } else { Ok(None) }
    }

    /// Tells the observer if not all frames have the data, and what is wrong with these.
    fn report(&self, what: &str, frames: u64, observer: &dyn Observer) {
        let Some(side) = self.side else { return };
        if self.matched < frames {
            observer.note(&format!("{what}: {} of {frames} frames have it", self.matched));
        }
        warn(observer, side.warning());
    }
}

/// The accompanying data of the frames of footage.
struct Sides<'a> {
    footage: &'a Footage,
    depth: Counted<'a, Plane>,
    /// The number of depth maps that were read, and of those among them without any reading.
    maps: [u64; 2],
    flow: Counted<'a, Flow>,
    denoised: Counted<'a, Encoded>,
    motion_deblurred: Counted<'a, Encoded>,
    defocus_deblurred: Counted<'a, Encoded>,
    clean: Counted<'a, Encoded>,
}

/// The accompanying data of one frame.
struct Given {
    depth: Option<Plane>,
    flow: Option<Flow>,
    denoised: Option<Encoded>,
    motion_deblurred: Option<Encoded>,
    defocus_deblurred: Option<Encoded>,
    clean: Option<Encoded>,
}

impl<'a> Sides<'a> {
    fn new(footage: &'a Footage) -> Result<Self> {
        let clip = &*footage.clip;
        let frames = |side: &'a Option<BoxedSide<Encoded>>| Counted::new(clip, side.as_ref());
        Ok(Self {
            footage,
            depth: Counted::new(clip, footage.depth.as_ref().map(|d| &d.0))?,
            maps: [0; 2],
            flow: Counted::new(clip, footage.flow.as_ref())?,
            denoised: frames(&footage.denoised)?,
            motion_deblurred: frames(&footage.motion_deblurred)?,
            defocus_deblurred: frames(&footage.defocus_deblurred)?,
            clean: frames(&footage.clean)?,
        })
    }

    /// Counts a frame, and reads its accompanying data if they are wanted.
    fn get(&mut self, number: u64, wanted: bool) -> Result<Given> {
        let size = self.footage.clip.size();
        let depth = self.depth.get(number, size, wanted)?;
        if let Some(map) = &depth {
            self.maps[0] += 1;
            self.maps[1] += u64::from(!has_reading(map));
        }
        Ok(Given {
            flow: self.flow.get(number, size, wanted)?,
            depth,
            denoised: self.denoised.get(number, size, wanted)?,
            motion_deblurred: self.motion_deblurred.get(number, size, wanted)?,
            defocus_deblurred: self.defocus_deblurred.get(number, size, wanted)?,
            clean: self.clean.get(number, size, wanted)?,
        })
    }

    /// Tells the observer which data not all frames have, and what is wrong with frames and data.
    fn report(&self, frames: u64, observer: &dyn Observer) {
        warn(observer, self.footage.clip.warning());
        self.depth.report("depth", frames, observer);
        match self.maps {
            [_, 0] => {}
            [all, empty] if empty == all => observer.warning(
                "depth: no map that was read has a reading, as if all were infinitely far, so no lens is found by depth",
            ),
            [all, empty] => {
                observer.note(&format!("depth: {empty} of {all} maps that were read have no reading"));
            }
        }
        self.flow.report("flow", frames, observer);
        self.denoised.report("denoised frames", frames, observer);
        self.motion_deblurred.report("motion-deblurred frames", frames, observer);
        self.defocus_deblurred.report("defocus-deblurred frames", frames, observer);
        self.clean.report("clean frames", frames, observer);
    }
}

impl Given {
    fn evidence(&self, footage: &Footage) -> Evidence<'_> {
        Evidence {
            flow: self.flow.as_ref(),
            inverse_depth: self.depth.as_ref().zip(footage.depth.as_ref().map(|d| d.1)),
            denoised: self.denoised.as_ref(),
            motion_deblurred: self.motion_deblurred.as_ref(),
            defocus_deblurred: self.defocus_deblurred.as_ref(),
            clean: self.clean.as_ref(),
            by_network: footage.by_network,
            found_before: footage.flow_found,
        }
    }
}

/// Shows the viewer a clip's frames with their evidence.
pub(crate) fn show(
    footage: &Footage,
    operators: Option<&mut dyn Operators>,
    save: Option<&mut dyn EvidenceSink>,
    what: &'static str,
    viewer: &mut impl Viewer,
    observer: &dyn Observer,
) -> Result<Seen> {
    let sides = Sides::new(footage)?;
    let steps = Steps::begin(observer, what, "frames", footage.clip.len_hint());
    let frames_of = if save.is_some() { all_frames_and_one } else { all_frames };
    read_ahead(&*footage.clip, frames_of, |frames| {
        show_frames(frames, sides, operators, save, steps, viewer, observer)
    })
}

/// [`show`] of these frames, with what belongs to them.
fn show_frames(
    mut frames: Frames,
    mut sides: Sides,
    mut operators: Option<&mut dyn Operators>,
    mut save: Option<&mut dyn EvidenceSink>,
    steps: Steps,
    viewer: &mut impl Viewer,
    observer: &dyn Observer,
) -> Result<Seen> {
    let footage = sides.footage;
    let clip = &*footage.clip;
    let mut window: VecDeque<Frame> = VecDeque::new();
    let reach = operators.as_ref().map_or(0, |o| o.reach()).max(1);
    let mut at = 0;
    let mut seen = Seen { frames: 0, first: 0, last: 0, stopped: None };
    let mut consecutive = false;
    loop {
        while window.len() <= at + reach
            && let Some(frame) = frames.next().transpose()?
        {
            window.push_back(frame);
        }
        let Some(frame) = window.get(at).filter(|f| clip.contains(f.number)) else { break };
        let number = frame.number;
        // A gap in the numbers is a gap in time.
        let (mut run, own) = successive(&window, at);
        let after = run.pop_if(|last| !clip.contains(last.0)).map(|last| last.1);
        let next = run.get(own + 1).map(|f| f.1);
        let previous = own.checked_sub(1).map(|i| run[i].1);
        consecutive |= next.is_some();
        let wanted = viewer.wants_next();
        let given = sides.get(number, wanted)?;
        let given = given.evidence(footage);
        let evidence = match &mut operators {
            Some(operators) if wanted => operators.evidence(&run, own, given, observer),
            _ => given,
        };
        if let Some(save) = &mut save {
            save.images(number, &frame.image, &evidence)?;
        }
        let observation = FrameObservation { frame: &frame.image, next, previous, evidence };
        let save =
            save.as_mut().map(|sink| Save { sink: &mut **sink, after: after.filter(|_| next.is_none()) });
        viewer.view(number, &observation, save)?;
        seen.first = if seen.frames == 0 { number } else { seen.first };
        seen.last = number;
        seen.frames += 1;
        steps.step();
        at += 1;
        if at > reach {
            window.pop_front();
            at -= 1;
        }
        if observer.stops() && window.get(at).is_some_and(|f| clip.contains(f.number)) {
            seen.stopped = Some(Stopped { after: seen.frames, of: clip.len_hint() });
            break;
        }
    }
    drop(steps);
    sides.report(seen.frames as u64, observer);
    if seen.frames > 1 && !consecutive {
        observer.warning("no two frames have successive numbers, so there is no motion to see");
    }
    Ok(seen)
}

/// The frames around frame `at` that follow each other without a gap, and the index of that frame among them.
fn successive(window: &VecDeque<Frame>, at: usize) -> (Vec<(u64, &Encoded)>, usize) {
    let follows = |i: usize| window[i].number + 1 == window[i + 1].number;
    let first = (0..at).rev().find(|&i| !follows(i)).map_or(0, |i| i + 1);
    let last = (at..window.len() - 1).find(|&i| !follows(i)).unwrap_or(window.len() - 1);
    (window.range(first..=last).map(|f| (f.number, &f.image)).collect(), at - first)
}
