//! Removal over a window of frames, in the paper's order: noise, then motion blur of the frames without noise, then defocus of the
//! frames without both. Flow and depth are those of the frames after the removal.

use crate::manifest::{Manifest, Slot};
use crate::network::Network;
use blindaug::model::DepthKind;
use blindaug::{Encoded, Flow, Plane};
use blindaug_io::{Error, Result};
use std::collections::BTreeMap;
use std::sync::Arc;

/// An operator on a frame and its neighbours. It gives an `Encoded` frame, a `Flow`, or a `(Plane, DepthKind)` of inverse depth,
/// each of the frame's size.
pub trait Operator<T>: Send + Sync {
    /// The frames that the operator takes, relative to the one asked for: 0 is that frame, 1 the next one.
    fn frames(&self) -> &[i32];

    /// Runs the operator on these frames.
    ///
    /// # Errors
    /// If the operator fails; the sentence names the network's file.
    fn run(&self, frames: &[&Encoded]) -> Result<T>;
}

impl Operator<Encoded> for Network {
    fn frames(&self) -> &[i32] {
        &self.manifest().input.frames
    }

    fn run(&self, frames: &[&Encoded]) -> Result<Encoded> {
        self.image(frames)
    }
}

impl Operator<Flow> for Network {
    fn frames(&self) -> &[i32] {
        &self.manifest().input.frames
    }

    fn run(&self, frames: &[&Encoded]) -> Result<Flow> {
        self.flow(frames)
    }
}

impl Operator<(Plane, DepthKind)> for Network {
    fn frames(&self) -> &[i32] {
        &self.manifest().input.frames
    }

    fn run(&self, frames: &[&Encoded]) -> Result<(Plane, DepthKind)> {
        self.inverse_depth(frames)
    }
}

/// The operator in a slot, or `None` if the slot is empty.
pub type Filled<T> = Option<Arc<dyn Operator<T>>>;

/// The operators in the five slots; the classical methods stand in for empty slots.
#[derive(Default)]
pub struct Slots {
    /// Removes noise.
    pub remove_noise: Filled<Encoded>,
    /// Removes motion blur.
    pub remove_motion_blur: Filled<Encoded>,
    /// Removes defocus.
    pub remove_defocus: Filled<Encoded>,
    /// Estimates optical flow to the next frame, px.
    pub get_flow: Filled<Flow>,
    /// Estimates inverse depth.
    pub get_depth: Filled<(Plane, DepthKind)>,
}

impl Slots {
    /// Puts a network into its slot.
    pub fn fill(&mut self, network: Network) {
        let Manifest { operator, .. } = *network.manifest();
        match operator {
            Slot::RemoveNoise => self.remove_noise = Some(Arc::new(network)),
            Slot::RemoveMotionBlur => self.remove_motion_blur = Some(Arc::new(network)),
            Slot::RemoveDefocus => self.remove_defocus = Some(Arc::new(network)),
            Slot::GetFlow => self.get_flow = Some(Arc::new(network)),
            Slot::GetDepth => self.get_depth = Some(Arc::new(network)),
        }
    }

    /// Whether no slot is filled.
    pub fn is_empty(&self) -> bool {
        !self.remove() && self.get_flow.is_none() && self.get_depth.is_none()
    }

    /// Whether a slot for removal is filled.
    pub fn remove(&self) -> bool {
        self.removal().iter().any(|o| o.1.is_some())
    }

    /// Empties a slot.
    fn empty(&mut self, slot: Slot) {
        match slot {
            Slot::RemoveNoise => self.remove_noise = None,
            Slot::RemoveMotionBlur => self.remove_motion_blur = None,
            Slot::RemoveDefocus => self.remove_defocus = None,
            Slot::GetFlow => self.get_flow = None,
            Slot::GetDepth => self.get_depth = None,
        }
    }

    fn removal(&self) -> [(Slot, &Filled<Encoded>); 3] {
        [
            (Slot::RemoveNoise, &self.remove_noise),
            (Slot::RemoveMotionBlur, &self.remove_motion_blur),
            (Slot::RemoveDefocus, &self.remove_defocus),
        ]
    }
}

/// The results of the networks for a frame. A result is `None` if the slot is empty or its network failed.
#[derive(Default)]
pub struct Removed {
    /// The frame without noise.
    pub denoised: Option<Arc<Encoded>>,
    /// The frame without noise and motion blur.
    pub motion_deblurred: Option<Arc<Encoded>>,
    /// The frame without defocus, and without the distortions that the slots before removed.
    pub defocus_deblurred: Option<Arc<Encoded>>,
    /// Optical flow to the next frame, px.
    pub flow: Option<Flow>,
    /// Inverse depth, and whether it is metric (1/m) or relative.
    pub inverse_depth: Option<(Plane, DepthKind)>,
    /// The slots whose networks failed, and the errors; these slots are empty from now on.
    pub failed: Vec<(Slot, Error)>,
}

/// The slots, run on one frame after another; frames after a removal are kept while they are needed again.
#[derive(Default)]
pub struct Chain {
    slots: Slots,
    kept: BTreeMap<(Slot, u64), Arc<Encoded>>,
    /// The least and the greatest relative inverse depth in the clip's first frame.
    depth_range: Option<[f32; 2]>,
}

/// Successive frames with their numbers.
type Window<'a> = [(u64, &'a Encoded)];

impl Chain {
    /// A chain of these slots.
    pub fn new(slots: Slots) -> Self {
        Self { slots, ..Self::default() }
    }

    /// Forgets the frames so far, because another clip begins.
    pub fn clear(&mut self) {
        self.kept.clear();
        self.depth_range = None;
    }

    /// The slots, in which those of failed networks are empty.
    pub fn slots(&self) -> &Slots {
        &self.slots
    }

    /// The number of frames before and after a frame that the chain looks at.
    pub fn reach(&self) -> usize {
        fn of<T>(operator: &Filled<T>) -> usize {
            let frames = operator.iter().flat_map(|o| o.frames());
            frames.map(|f| f.unsigned_abs() as usize).max().unwrap_or(0)
        }
        let removal: usize = self.slots.removal().iter().map(|o| of(o.1)).sum();
        removal + of(&self.slots.get_flow).max(of(&self.slots.get_depth))
    }

    /// Runs all slots on frame `at` of successive frames, numbered without gaps. The nearest frame stands in for a missing neighbour,
    /// but there is no flow without the next frame.
    pub fn run(&mut self, frames: &[(u64, &Encoded)], at: usize) -> Removed {
        let mut removed = Removed::default();
        for (stage, slot) in
            [Slot::RemoveNoise, Slot::RemoveMotionBlur, Slot::RemoveDefocus].into_iter().enumerate()
        {
            if self.slots.removal()[stage].1.is_none() {
                continue;
            }
            let image = self.image(stage + 1, at, frames);
            let image = self.unless_failed(slot, image, &mut removed);
            match slot {
                Slot::RemoveNoise => removed.denoised = image,
                Slot::RemoveMotionBlur => removed.motion_deblurred = image,
                _ => removed.defocus_deblurred = image,
            }
        }
        if let Some(operator) = self.slots.get_flow.clone().filter(|_| at + 1 < frames.len()) {
            let flow = self.of_stage(3, at, frames, &*operator);
            removed.flow = self.unless_failed(Slot::GetFlow, flow, &mut removed);
        }
        if let Some(operator) = self.slots.get_depth.clone() {
            let depth = self.of_stage(3, at, frames, &*operator);
            let depth = self.unless_failed(Slot::GetDepth, depth, &mut removed);
            removed.inverse_depth = depth.map(|(depth, kind)| match kind {
                DepthKind::Relative => (self.scaled(depth), kind),
                DepthKind::Metric => (depth, kind),
            });
        }
        let oldest = frames[at].0.saturating_sub(self.reach() as u64);
        self.kept.retain(|(_, number), _| *number >= oldest);
        removed
    }

    /// Scales relative inverse depth so that it is 0 (far) to 1 in the clip's first frame; all frames of the clip have the same scale.
    fn scaled(&mut self, depth: Plane) -> Plane {
        let range = || depth.data().iter().fold([f32::MAX, f32::MIN], |[lo, hi], &v| [lo.min(v), hi.max(v)]);
        let [lo, hi] = *self.depth_range.get_or_insert_with(range);
        depth.map(|v| ((v - lo) / (hi - lo).max(1e-6)).max(0.0))
    }

    /// The result of a slot. If it failed, the slot is empty from now on, and the chain goes on without it.
    fn unless_failed<T>(&mut self, slot: Slot, result: Result<T>, removed: &mut Removed) -> Option<T> {
        result
            .map_err(|e| {
                self.slots.empty(slot);
                removed.failed.push((slot, e));
            })
            .ok()
    }

    /// The result of an operator on the frames around `i`, after the first `stages` of the removal.
    fn of_stage<T>(
        &mut self,
        stages: usize,
        i: usize,
        window: &Window,
        operator: &dyn Operator<T>,
    ) -> Result<T> {
        // The index of the frame that is `later` frames after `i`, or of the last frame of the window in that direction.
        let beside = |later: i32| i.saturating_add_signed(later as isize).min(window.len() - 1);
        let frames = operator.frames().iter().map(|f| self.image(stages, beside(*f), window));
        let frames = frames.collect::<Result<Vec<_>>>()?;
        operator.run(&frames.iter().map(Arc::as_ref).collect::<Vec<_>>())
    }

    /// Frame `i` of the window after the first `stages` of the removal.
    fn image(&mut self, stages: usize, i: usize, window: &Window) -> Result<Arc<Encoded>> {
        let (number, frame) = window[i];
        let Some(stage) = stages.checked_sub(1) else { return Ok(Arc::new(frame.clone())) };
        let (slot, operator) = self.slots.removal()[stage];
        let Some(operator) = operator.clone() else { return self.image(stage, i, window) };
        if let Some(image) = self.kept.get(&(slot, number)) {
            return Ok(image.clone());
        }
        let image = Arc::new(self.of_stage(stage, i, window, &*operator)?);
        self.kept.insert((slot, number), image.clone());
        Ok(image)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// An operator that gives the mean of its frames plus a constant, and counts its runs; it fails if the constant is NaN.
    struct Mean(Vec<i32>, f32, Arc<AtomicUsize>);

    impl Operator<Encoded> for Mean {
        fn frames(&self) -> &[i32] {
            &self.0
        }

        fn run(&self, frames: &[&Encoded]) -> Result<Encoded> {
            self.2.fetch_add(1, Ordering::Relaxed);
            let sum: f32 = frames.iter().map(|f| f.0.at(0, 0)[0]).sum();
            if self.1.is_nan() {
                return Err(Error::new("x.onnx", "it fails"));
            }
            Ok(Encoded(Raster::filled(1, 1, [sum / frames.len() as f32 + self.1; 3])))
        }
    }

    fn frames(n: usize) -> Vec<Encoded> {
        (0..n).map(|i| Encoded(Raster::filled(1, 1, [0.1 * i as f32; 3]))).collect()
    }

    fn run(chain: &mut Chain, frames: &[Encoded], at: usize) -> Removed {
        let numbered: Vec<(u64, &Encoded)> = (5..).zip(frames).collect();
        chain.run(&numbered, at)
    }

    #[test]
    fn each_step_sees_what_the_one_before_made_and_nothing_is_made_twice() {
        let count = Arc::new(AtomicUsize::new(0));
        let of = |frames: &[i32], add| -> Filled<Encoded> {
            Some(Arc::new(Mean(frames.to_vec(), add, count.clone())))
        };
        let slots = Slots {
            remove_noise: of(&[0], 1.0),
            remove_motion_blur: of(&[-1, 0, 1], 0.0),
            ..Slots::default()
        };
        let mut chain = Chain::new(slots);
        assert_eq!(chain.reach(), 1);
        let frames = frames(4);
        let value = |i: &Option<Arc<Encoded>>| i.as_ref().map(|i| (i.0.at(0, 0)[0] * 1000.0).round());
        let first = run(&mut chain, &frames, 0);
        // At the start of the window, frame 0 stands in for the frame before it.
        assert_eq!((value(&first.denoised), value(&first.motion_deblurred)), (Some(1000.0), Some(1033.0)));
        assert!(first.defocus_deblurred.is_none() && first.failed.is_empty());
        let second = run(&mut chain, &frames, 1);
        assert_eq!((value(&second.denoised), value(&second.motion_deblurred)), (Some(1100.0), Some(1100.0)));
        // Three frames were denoised, and two deblurred.
        assert_eq!(count.load(Ordering::Relaxed), 5);
    }

    /// An operator whose relative inverse depth is its frame's red, with a scale and an offset.
    struct Red;

    impl Operator<(Plane, DepthKind)> for Red {
        fn frames(&self) -> &[i32] {
            &[0]
        }

        fn run(&self, frames: &[&Encoded]) -> Result<(Plane, DepthKind)> {
            Ok((frames[0].0.map(|p| 40.0 * p[0] - 3.0), DepthKind::Relative))
        }
    }

    #[test]
    fn relative_depth_has_one_scale_in_all_frames() {
        let mut chain = Chain::new(Slots { get_depth: Some(Arc::new(Red)), ..Slots::default() });
        let frame = |most: f32| Encoded(Raster::from_fn(11, 1, |x, _| [0.1 * x as f32 * most; 3]));
        let frames = [frame(0.5), frame(1.0)];
        let of = |removed: Removed| {
            removed.inverse_depth.map(|d| [0, 5, 10].map(|x| (d.0.at(x, 0) * 100.0).round()))
        };
        assert_eq!(of(run(&mut chain, &frames, 0)), Some([0.0, 50.0, 100.0]));
        assert_eq!(of(run(&mut chain, &frames, 1)), Some([0.0, 100.0, 200.0]));
        chain.clear();
        assert_eq!(of(run(&mut chain, &frames, 1)), Some([0.0, 50.0, 100.0]));
    }

    #[test]
    fn a_network_that_fails_is_left_out_and_named() {
        let count = Arc::new(AtomicUsize::new(0));
        let slots = Slots {
            remove_noise: Some(Arc::new(Mean(vec![0], 1.0, count.clone()))),
            remove_motion_blur: Some(Arc::new(Mean(vec![0], f32::NAN, count.clone()))),
            remove_defocus: Some(Arc::new(Mean(vec![0], 0.5, count))),
            ..Slots::default()
        };
        let mut chain = Chain::new(slots);
        let first = run(&mut chain, &frames(1), 0);
        assert!(matches!(&first.failed[..], [(Slot::RemoveMotionBlur, e)] if e.sentence() == "it fails"));
        assert!(first.denoised.is_some() && first.motion_deblurred.is_none());
        assert_eq!(first.defocus_deblurred.map(|i| i.0.at(0, 0)[0]), Some(1.5));
        assert!(run(&mut chain, &frames(2), 1).failed.is_empty());
    }
}
