//! The shape of out-of-focus points from frame to frame.

use super::memory::Memory;
use crate::fit::bokeh::{self, SCALES, ShapeObservation};
use crate::fit::defocus::Lens;
use crate::fit::likelihood::PARTS;
use crate::fit::tiles::{self, BLOCK_COUNT, MotionOf, Tile};
use crate::model::{Bokeh, Space};
use crate::{Encoded, Plane};

/// The shape is looked at in at most one of this many frames: it says the same for as long as the lens is the same.
const STRIDE: usize = 3;
/// The most tiles of such a frame that are looked at, at each resolution.
const TILES: usize = 10;
/// The number of resolutions: blur of up to 10 px shows its shape at one of them.
const RESOLUTIONS: usize = 3;
/// The share of its weight that evidence keeps from one frame to the next.
const KEPT: f32 = 0.98;
/// The log-likelihoods of both shapes, which there are for each block of each part.
const CELL: usize = 2 * SCALES;

/// The summed log-likelihoods of both shapes per part and block of the image, and the shape that they last told.
pub(super) struct ShapeMemory {
    memory: Memory,
    told: Option<Bokeh>,
    /// The number of frames that were looked at; the memory's age counts from the last of them.
    looks: usize,
}

impl Default for ShapeMemory {
    fn default() -> Self {
        // The first frame is looked at.
        let mut memory = Memory::new(PARTS * BLOCK_COUNT * CELL, KEPT);
        memory.age = STRIDE;
        Self { memory, told: None, looks: 0 }
    }
}

impl ShapeMemory {
    /// The number of the look, from 0, if the next frame is to be looked at.
    pub fn next_look(&self) -> Option<usize> {
        (self.memory.age + 1 >= STRIDE).then_some(self.looks)
    }

    /// The shape that was told last; `None` if the evidence was never enough.
    pub fn told(&self) -> Option<Bokeh> {
        self.told
    }

    /// Lets a frame pass.
    pub fn fade(&mut self) {
        self.memory.fade();
    }

    /// Adds the observations of the frame, if it was looked at. The looks are dealt to the parts in turn.
    pub fn add(&mut self, found: &[ShapeObservation]) {
        let part = self.looks % PARTS;
        (self.looks, self.memory.age) = (self.looks + 1, 0);
        if found.is_empty() {
            return;
        }
        let mut evidence = vec![0.0; self.memory.old.len()];
        for w in found {
            let cell = &mut evidence[(part * BLOCK_COUNT + w.block as usize) * CELL..][..CELL];
            cell.iter_mut().zip(w.log_likelihood.as_flattened()).for_each(|(s, v)| *s += v);
        }
        self.memory.add(evidence);
        self.told = self.shape().or(self.told);
    }

    /// Forgets the evidence of the last looks, and what it told.
    pub fn forget_recent(&mut self) {
        self.memory.forget_recent();
        self.told = self.shape();
    }

    fn shape(&self) -> Option<Bokeh> {
        bokeh::shape_of(&observations_of(&self.memory.sum()), super::BOOTSTRAPS)
    }
}

/// Tiles of a frame that may tell the shape, since this lens blurs them by as much; at full resolution sharper ones, too, which the fit of a lens
/// of Gaussians needs. Each look has corners of its own.
pub(super) fn tiles_of(
    frame: &Encoded,
    look: usize,
    motion: Option<&MotionOf>,
    depth: &Plane,
    lens: Lens,
    space: Space,
) -> Vec<Tile> {
    let telling = bokeh::telling();
    let at_resolution = |(halvings, size): (usize, (usize, usize))| {
        let scale = 1 << halvings;
        let tells = |&corner: &(usize, usize)| {
            let sigma = |d: f32| lens.sigma_px(d) / scale as f32;
            tiles::common_depth(depth, corner, scale)
                .is_some_and(|d| sigma(d) < telling.end && (scale == 1 || sigma(d) >= telling.start))
        };
        let tried = tiles::corners_in_turn(size, look, 4 * TILES).filter(tells);
        let chosen = tiles::of_most_contrast(frame, tried, scale, None, Some(depth), TILES);
        tiles::tiles_at(frame, &chosen, scale, motion, Some(depth), space)
    };
    tiles::levels(frame.0.size()).take(RESOLUTIONS).enumerate().flat_map(at_resolution).collect()
}

fn observations_of(evidence: &[f32]) -> Vec<ShapeObservation> {
    let told = evidence.chunks(CELL).enumerate().filter(|(_, cell)| cell.iter().any(|&v| v < 0.0));
    told.map(|(i, cell)| ShapeObservation {
        log_likelihood: std::array::from_fn(|shape| std::array::from_fn(|k| cell[shape * SCALES + k])),
        block: (i % BLOCK_COUNT) as u32,
        part: i / BLOCK_COUNT,
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Observations of tiles in four blocks, each of which finds one shape likelier by 4 nats at all shares.
    fn tiles_that_tell(shape: Bokeh) -> Vec<ShapeObservation> {
        let nats = if shape == Bokeh::Disk { [0.0, -4.0] } else { [-4.0, 0.0] };
        let of = |block: u32| ShapeObservation { log_likelihood: nats.map(|v| [v; SCALES]), block, part: 0 };
        (0..4).map(of).collect()
    }

    #[test]
    fn a_shape_is_told_by_a_few_looks_and_forgotten_with_them() {
        let mut memory = ShapeMemory::default();
        let mut look = |shape: Bokeh, looks: usize| {
            for _ in 0..looks {
                assert!(memory.next_look().is_some());
                memory.fade();
                memory.add(&tiles_that_tell(shape));
                assert!(memory.next_look().is_none());
                (1..STRIDE).for_each(|_| memory.fade());
            }
            let told = memory.told();
            let mut recent_forgotten =
                ShapeMemory { memory: memory.memory.clone(), ..ShapeMemory::default() };
            recent_forgotten.forget_recent();
            (told, recent_forgotten.told())
        };
        // A look is 16 nats, which is not enough.
        assert_eq!(look(Bokeh::Disk, 1), (None, None));
        assert_eq!(look(Bokeh::Disk, 2), (Some(Bokeh::Disk), None));
        assert_eq!(look(Bokeh::Disk, 3), (Some(Bokeh::Disk), Some(Bokeh::Disk)));
        // What was told stays until the other shape is told.
        assert_eq!(look(Bokeh::Gaussian, 4).0, Some(Bokeh::Disk));
        assert_eq!(look(Bokeh::Gaussian, 12).0, Some(Bokeh::Gaussian));
    }
}
