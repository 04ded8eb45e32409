//! The lens from frame to frame.

use super::memory::{AGREEING, Memory, SURE, walked};
use super::shape::ShapeMemory;
use crate::Result;
use crate::fit::agreement::{self, FineTables, LensObservation};
use crate::fit::bokeh::{self, ShapeObservation};
use crate::fit::defocus::{self, Lens};
use crate::fit::{likelihood, tiles};
use crate::model::{Bokeh, DefocusCurve, DefocusModel, DepthKind, Estimate, Method, Unknown};
use crate::portable::Portable;

/// The largest difference of mean blur that is not a change: in px, plus a share of the blur before.
const SAME_BLUR: (f32, f32) = (0.25, 0.1);
/// The largest share of the old lens's loss (minus its log-likelihood) that a new lens may have: some lens always suits a few tiles better.
const LEFT_OF_LOSS: f32 = 0.33;
/// The share of its weight that evidence keeps from one frame to the next.
const KEPT: f32 = 0.98;
/// The relative std, per frame, of the random walk of a lens that is not seen.
const WALK: f32 = 0.02;
/// The number of blurs in a table.
pub(super) const SIGMAS: usize = likelihood::SIGMAS;
/// The length of a cell of the evidence. There is a cell for each block of the image and bin of inverse depth, with its table, the sum of
/// its tiles' inverse depths, and the number of its tiles.
const CELL: usize = SIGMAS + 2;
/// The number of bins of inverse depth: 8 per octave from 1/256 to 16; the first and the last bin also hold values outside this range.
const DEPTHS: usize = 96;

/// What the tiles of a frame tell of a lens.
#[derive(Default)]
pub(super) struct OfLens {
    /// The observations of the lens, if out-of-focus points are disks.
    pub as_disks: Vec<LensObservation>,
    /// The observations of the lens by the tiles that were looked at for the shape, if points are Gaussians.
    pub as_gaussians: Vec<LensObservation>,
    /// The observations of the points' shape, with the lens of the frame before; `None` if the frame was not looked at for it.
    pub shape: Option<Vec<ShapeObservation>>,
}

/// The summed log-likelihood of the blur, per block and inverse depth, and the last known lens.
pub(super) struct LensMemory {
    as_disks: Memory,
    as_gaussians: Memory,
    shape: ShapeMemory,
    known: Option<(Lens, DefocusModel)>,
    /// Why the last evidence told no lens.
    unknown: Option<Unknown>,
}

impl Default for LensMemory {
    fn default() -> Self {
        let [as_disks, as_gaussians] = [0; 2].map(|_| Memory::new(tiles::BLOCK_COUNT * DEPTHS * CELL, KEPT));
        Self { as_disks, as_gaussians, shape: ShapeMemory::default(), known: None, unknown: None }
    }
}

impl LensMemory {
    /// The last known lens, and the number of the look, if the next frame is to be looked at for the shape of points.
    pub fn wants_shape(&self) -> Option<(Lens, usize)> {
        Some((self.known?.0, self.shape.next_look()?))
    }

    /// The lens with what another frame tells, and whether it has changed. Without any known lens, and without an estimate that says more,
    /// `why` is the reason.
    ///
    /// # Errors
    /// If the observations fit no lens at all.
    pub fn follow(
        &mut self,
        found: &OfLens,
        depth_kind: Option<DepthKind>,
        why: Unknown,
    ) -> Result<(Estimate<DefocusModel>, bool)> {
        self.as_disks.fade();
        self.as_gaussians.fade();
        self.shape.fade();
        let depth_kind = depth_kind.filter(|_| !found.as_disks.is_empty());
        if depth_kind.is_some() {
            self.as_disks.add(evidence_of(&found.as_disks));
        }
        let changed = depth_kind.is_some() && lens_changed(&self.as_disks);
        if changed {
            self.as_disks.forget_old();
            // What was seen less often is not known to be of the new lens, and the shape was looked at with the old one.
            self.as_gaussians.forget();
            self.shape.forget_recent();
            self.known = None;
        } else {
            if !found.as_gaussians.is_empty() {
                self.as_gaussians.add(evidence_of(&found.as_gaussians));
            }
            if let Some(shape) = &found.shape {
                self.shape.add(shape);
            }
        }
        if let Some(depth_kind) = depth_kind {
            match agreement::lens_of(&observations_of(&self.as_disks.sum()), super::BOOTSTRAPS)? {
                Estimate::Known(mut fit) => {
                    fit.bokeh = self.shape.told();
                    if fit.bokeh == Some(Bokeh::Gaussian) {
                        let seen = observations_of(&self.as_gaussians.sum());
                        bokeh::take_in_gaussians(&mut fit, &seen, super::BOOTSTRAPS)?;
                    }
                    self.as_disks.age = 0;
                    let model = fit.model(fit.thin_lens(), Method::Spectral, depth_kind);
                    self.known = Some((fit.lens, model));
                }
                Estimate::Unknown(reason) => self.unknown = Some(reason),
            }
        }
        let Some((_, mut known)) = self.known else {
            return Ok((Estimate::Unknown(self.unknown.clone().unwrap_or(why)), changed));
        };
        if let DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval: Some(i) } =
            &mut known.curve
        {
            i.sigma_px_at_infinity = walked(i.sigma_px_at_infinity, *s, WALK * *s, self.as_disks.age);
            i.focus_inverse_depth = walked(i.focus_inverse_depth, *f, WALK * *f, self.as_disks.age);
        }
        Ok((Estimate::Known(known), changed))
    }

    /// Forgets all evidence and what is known.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Forgets the evidence of the last frames.
    pub fn forget_recent(&mut self) {
        self.as_disks.forget_recent();
        self.as_gaussians.forget_recent();
        self.shape.forget_recent();
    }
}

/// The evidence of a frame, in cells.
fn evidence_of(found: &[LensObservation]) -> Vec<f32> {
    let mut evidence = vec![0.0; tiles::BLOCK_COUNT * DEPTHS * CELL];
    for w in found {
        let cell = w.block as usize * DEPTHS + depth_bin(w.inverse_depth);
        let cell = &mut evidence[cell * CELL..][..CELL];
        cell.iter_mut().zip(&w.table).for_each(|(s, v)| *s += v.max(-likelihood::CLIP * w.tiles));
        cell[SIGMAS] += w.tiles * w.inverse_depth;
        cell[SIGMAS + 1] += w.tiles;
    }
    evidence
}

fn depth_bin(inverse_depth: f32) -> usize {
    (8.0 * (inverse_depth.max(1e-6).portable_log2() + 8.0)).clamp(0.0, (DEPTHS - 1) as f32) as usize
}

fn observations_of(evidence: &[f32]) -> Vec<LensObservation> {
    evidence
        .chunks(CELL)
        .enumerate()
        .filter(|(_, cell)| cell[SIGMAS + 1] > 0.05)
        .map(|(i, cell)| LensObservation {
            inverse_depth: cell[SIGMAS] / cell[SIGMAS + 1],
            table: cell[..SIGMAS].to_vec(),
            tiles: cell[SIGMAS + 1],
            block: (i / DEPTHS) as u32,
            part: 0,
        })
        .collect()
}

/// Whether the last frames agree on a lens that differs from that of the frames before them.
fn lens_changed(memory: &Memory) -> bool {
    if memory.recent.len() < AGREEING {
        return false;
    }
    let best = |observations: &[LensObservation], tables: &FineTables| -> Option<Lens> {
        (observations.iter().map(|w| w.tiles).sum::<f32>() >= 8.0).then(|| {
            defocus::best_lens(agreement::lens_range(observations), |l| tables.log_likelihood(l, None))
        })
    };
    let [old, recent] = [observations_of(&memory.old), observations_of(&memory.recent_sum())];
    let of_recent = FineTables::new(&recent);
    let (Some(before), Some(now)) = (best(&old, &FineTables::new(&old)), best(&recent, &of_recent)) else {
        return false;
    };
    let mean = |of: &dyn Fn(f32) -> f32| {
        let tiles: f32 = recent.iter().map(|w| w.tiles).sum();
        recent.iter().map(|w| w.tiles * of(w.inverse_depth)).sum::<f32>() / tiles
    };
    let likelihood = |lens| of_recent.log_likelihood(lens, None);
    mean(&|d| (now.sigma_px(d) - before.sigma_px(d)).abs())
        > SAME_BLUR.0 + SAME_BLUR.1 * mean(&|d| before.sigma_px(d))
        && likelihood(now) >= LEFT_OF_LOSS * likelihood(before)
        && memory.recent.iter().all(|frame| {
            let tables = FineTables::new(&observations_of(frame));
            let of = |lens| tables.log_likelihood(lens, None);
            of(now) - of(before) > SURE
        })
}
