//! Evidence that fades with time, and intervals that widen with it.

use crate::portable::Portable;
use std::collections::VecDeque;

/// The number of last frames with evidence that must agree on a change.
pub(super) const AGREEING: usize = 3;
/// The number of nats by which each of those frames must find the new value more likely than the old one.
pub(super) const SURE: f32 = 4.0;

/// Sums of evidence, in which older frames count less and less. The last [`AGREEING`] frames are kept apart.
#[derive(Clone)]
pub(super) struct Memory {
    /// The faded sum of the evidence of all but the last frames.
    pub old: Vec<f32>,
    /// The faded evidence of each of the last frames.
    pub recent: VecDeque<Vec<f32>>,
    /// The share of its weight that evidence keeps from one frame to the next.
    kept: f32,
    /// The number of frames in the memory, older frames counting less.
    pub weight: f32,
    /// The number of frames since the last estimate.
    pub age: usize,
}

impl Memory {
    pub fn new(len: usize, kept: f32) -> Self {
        Self { old: vec![0.0; len], recent: VecDeque::new(), kept, age: 0, weight: 0.0 }
    }

    /// Lets a frame pass: all evidence fades.
    pub fn fade(&mut self) {
        self.age += 1;
        self.weight *= self.kept;
        // Sums that get no new evidence would fade into denormal numbers, which are slow.
        let fade = |v: &mut f32| *v = if v.abs() < 1e-12 { 0.0 } else { *v * self.kept };
        self.old.iter_mut().chain(self.recent.iter_mut().flatten()).for_each(fade);
    }

    /// Adds a frame's evidence.
    pub fn add(&mut self, evidence: Vec<f32>) {
        self.weight += 1.0;
        self.recent.push_back(evidence);
        if self.recent.len() > AGREEING
            && let Some(first) = self.recent.pop_front()
        {
            self.old.iter_mut().zip(first).for_each(|(s, v)| *s += v);
        }
    }

    pub fn recent_sum(&self) -> Vec<f32> {
        let mut sum = vec![0.0; self.old.len()];
        self.recent.iter().for_each(|r| sum.iter_mut().zip(r).for_each(|(s, v)| *s += v));
        sum
    }

    pub fn sum(&self) -> Vec<f32> {
        let mut sum = self.recent_sum();
        sum.iter_mut().zip(&self.old).for_each(|(s, v)| *s += v);
        sum
    }

    pub fn forget_old(&mut self) {
        self.old.fill(0.0);
        self.weight = self.recent.len() as f32;
    }

    pub fn forget_recent(&mut self) {
        self.weight = (self.weight - self.recent.len() as f32).max(0.0);
        self.recent.clear();
    }

    pub fn forget(&mut self) {
        self.forget_old();
        self.forget_recent();
    }
}

/// Widens the 95 % interval of a value that was last estimated `age` frames ago and walks randomly by `step` (std) per frame.
pub(super) fn walked([low, high]: [f32; 2], value: f32, step: f32, age: usize) -> [f32; 2] {
    let reach = 1.96 * step * (age as f32).sqrt();
    [
        (value - (value - low).max(0.0).portable_hypot(reach)).max(0.0),
        value + (high - value).max(0.0).portable_hypot(reach),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_widens_with_the_root_of_time() {
        let [low, high] = walked([0.4, 0.6], 0.5, 0.01, 100);
        assert!((high - 0.5 - 0.1f32.hypot(0.196)).abs() < 1e-5 && (low + high - 1.0).abs() < 1e-5);
        assert_eq!(walked([0.4, 0.6], 0.5, 0.01, 0).map(|v| (v * 1e4).round()), [4000.0, 6000.0]);
    }
}
