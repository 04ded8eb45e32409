//! The exposure by the streaks of the last frames, while motion is uneven.

use super::exposure::SAME;
use crate::fit::agreement::ExposureFit;
use crate::fit::likelihood::index_of_exposure;
use crate::fit::noise::LumaNoise;
use crate::fit::streaks::{self, Link, Run, Told};
use std::collections::VecDeque;

/// The links of a run. The longer a run, the more its frames tell of each other, and the longer takes its fit.
const LONGEST: usize = 6;
/// The links from which on a run is believed against what was known before: fewer may be those of a camera that stops, or is moved so suddenly
/// that flow goes wrong.
const MANY: usize = 5;
/// The number of new links after which a run is looked at again.
const STRIDE: usize = 2;
/// The number of frames for which a run that has ended still counts.
const REMEMBERED: usize = 24;

/// The nats by which a run must find its own exposure likelier than that of the runs before it, and these theirs, if it has changed.
const SURE: f32 = 8.0;

/// The exposure that the streaks of the last runs agree on.
pub(super) struct ByStreaks<'a> {
    /// The exposure with its interval.
    pub fit: &'a ExposureFit,
    /// The number of frames since it was found.
    pub age: usize,
    /// Whether the run that goes on has just told another exposure than the runs before it.
    pub changed: bool,
    /// Whether a run of [`MANY`] links tells it.
    pub by_many: bool,
}

/// The links of the last frames, and what they tell.
#[derive(Default)]
pub(super) struct StreaksMemory {
    /// The links of the run that goes on.
    links: Vec<Link>,
    /// The number of links that were not looked at so far.
    fresh: usize,
    /// What that run tells so far.
    told: Option<Told>,
    /// What the runs before it tell, each with the frame in which it ended.
    ended: VecDeque<(usize, Told)>,
    /// What all of them agree on.
    agreed: Option<ExposureFit>,
    /// The number of frames since they did.
    age: usize,
}

impl StreaksMemory {
    /// Takes the links to and from the frame of this index; none if its motion is even or not known, which ends the run. Gives what the last
    /// runs agree on.
    pub fn follow(&mut self, links: Vec<Link>, frame: usize, noise: &LumaNoise) -> Option<ByStreaks<'_>> {
        let ends = links.is_empty();
        self.fresh += links.len();
        self.links.extend(links);
        let is_full = self.links.len() >= LONGEST;
        let looked = self.fresh > 0 && (self.fresh >= STRIDE || ends || is_full);
        let mut changed = false;
        if looked {
            self.look(noise);
            changed = self.has_changed();
        }
        if changed {
            self.ended.clear();
            // The first links of the run may be older than the change.
            self.links.drain(..self.links.len().saturating_sub(STRIDE));
            self.told = None;
            self.look(noise);
        }
        if ends || is_full {
            self.ended.extend(self.told.take().map(|told| (frame, told)));
            self.links.clear();
        }
        let oldest = self.ended.front().is_some_and(|(ended, _)| ended + REMEMBERED < frame);
        if oldest {
            self.ended.pop_front();
        }
        if looked || oldest {
            let told: Vec<&Told> = self.ended.iter().map(|(_, told)| told).chain(&self.told).collect();
            self.agreed = streaks::agreed(&told, noise.coding_error);
        }
        self.age = if looked { 0 } else { self.age + 1 };
        let mut told = self.ended.iter().map(|(_, told)| told).chain(&self.told);
        let by_many = told.any(|told| told.links() >= MANY);
        self.agreed.as_ref().map(|fit| ByStreaks { fit, age: self.age, changed, by_many })
    }

    /// Finds what the run that goes on tells.
    fn look(&mut self, noise: &LumaNoise) {
        let run = Run { links: self.links.iter().collect(), frames: vec![None; self.links.len() + 1] };
        self.told = streaks::told_by(&run, self.told.as_ref(), noise);
        self.fresh = 0;
    }

    /// Whether the run that goes on and those before it contradict each other.
    fn has_changed(&self) -> bool {
        let ended: Vec<&Told> = self.ended.iter().map(|(_, told)| told).collect();
        let (Some(now), false) = (&self.told, ended.is_empty()) else { return false };
        let [now, before] = [streaks::summed(&[now]), streaks::summed(&ended)];
        let [own, others] = [&now, &before].map(|curve| streaks::likeliest(curve));
        let at = |curve: &[f32], exposure: f32| curve[index_of_exposure(exposure)];
        let prefers = |curve: &[f32], a: f32, b: f32| at(curve, a) - at(curve, b) > SURE;
        (own - others).abs() > SAME && prefers(&now, own, others) && prefers(&before, others, own)
    }

    /// Forgets everything, since the next frame belongs to another shot, or the noise is not known.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}
