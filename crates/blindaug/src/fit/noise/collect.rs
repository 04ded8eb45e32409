//! The collection of local variances: the blocks of a residual in which they are taken, and what is wrong with a block.

use super::curves::Colours;
use super::lines::DARK;
use super::mismatch::without_mismatch;
use super::{LocalVariance, NoiseEvidence};
use crate::analysis::active_area::ActiveArea;
use crate::analysis::brightness::{brightening, undone};
use crate::fit::robust::median;
use crate::model::{Method, NOISE_LEVELS};
use crate::portable::Portable;
use crate::raster::cubic_weights;
use crate::strips::{STRIP, Strip, rows_in_turn, strips_of};
use crate::{Encoded, Error, Flow, Pixel, Plane, Raster, Result, filter, luma, par, pyramid};
use std::{ops::Range, sync::OnceLock};
use wide::f32x4;

/// The side of the blocks in which variances are measured, px of the full image, for each level: small blocks are more often free of
/// structure, but a block of a coarse level needs a few values.
const BLOCK: [usize; NOISE_LEVELS] = [16, 16, 32, 32];

/// The distance from 0, and the share of white, within which encoded values count as clipped: they have lost a part of their noise.
const CLIP_MARGIN: f32 = 0.02;

/// The encoded value above which no filter lifts values that end at 1: the overshoot of one that makes frames smaller reaches to about 1.04.
const BEYOND_ONE: f32 = 1.1;

/// The share of a frame's pixels that lie above [`BEYOND_ONE`] from which on its values do not end at 1.
const ABOVE_ONE: f32 = 0.01;

/// The share of such a frame's pixels that may be brighter than where its values are taken to end: a sensor's end is that of many pixels, the
/// brightest of all is that of a lamp or of a renderer's firefly.
const HIGHLIGHTS: f32 = 0.001;

/// The largest share of clipped pixels in a block: if noise is strong, every dark block has a few, which cost little of the variance.
const MAY_CLIP: f32 = 0.04;

/// What is wrong with a pixel; 0: nothing.
pub(super) type Flaw = u8;

/// The flaw of a clipped pixel, of which a block may have a share of [`MAY_CLIP`].
const CLIPPED: Flaw = 1;

/// The flaw of a pixel that rules out every block within 4 px of it.
pub(super) const UNUSABLE: Flaw = u8::MAX;

/// The side of the blocks that video coders copy, px.
pub(super) const COPIED: usize = 8;

/// [`Residual::fraction`] of a residual that is no difference of two frames.
const ONE_FRAME: Option<fn(usize, usize) -> [f32; 2]> = None;

/// A residual from which local variances are taken, pixel by pixel.
pub(super) struct Residual<V, C, F, G> {
    /// R, G and B of the residual, and the image whose band shows the texture of which the residual may hold a share.
    pub(super) values: V,
    /// The encoded colour of the image, with as little noise as possible.
    pub(super) colour: C,
    /// The flaw of a pixel.
    pub(super) flaws: F,
    /// The fractions of a px at which the pixel of the other frame was interpolated, if the residual is a difference of two frames.
    pub(super) fraction: Option<G>,
    /// Whether the residual is known to hold nothing but noise.
    pub(super) pure: bool,
}

impl NoiseEvidence {
    /// Adds the evidence of two successive frames: their difference along the flow is pure noise wherever the match is good.
    /// A change of brightness between the frames is undone.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_pair(&mut self, frame: &Encoded, next: &Encoded, flow: &Flow) -> Result<()> {
        self.add_pair_in_turn(frame, next, flow, (0, 1)).map(|_| ())
    }

    /// [`NoiseEvidence::add_pair`] for the blocks in turn `i` of `turns` only ([`rows_in_turn`]); says whether nothing moves between the
    /// frames.
    ///
    /// # Errors
    /// If the sizes differ.
    pub(in crate::fit) fn add_pair_in_turn(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        (i, turns): (usize, usize),
    ) -> Result<bool> {
        let height = frame.0.height();
        self.add_pair_of(frame, next, flow, 0..height, rows_in_turn(i, turns, height))
    }

    /// [`NoiseEvidence::add_pair`] for some rows of `frame` as if it had no others.
    ///
    /// # Errors
    /// If the sizes differ.
    pub(in crate::fit) fn add_pair_rows(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        rows: Range<usize>,
    ) -> Result<()> {
        let all = 0..rows.len();
        self.add_pair_of(frame, next, flow, rows, all).map(|_| ())
    }

    /// What the blocks of two successive frames tell, of those that begin in `own`, which are some of `rows`, counted from the first. Says
    /// whether nothing moves between the frames.
    fn add_pair_of(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        rows: Range<usize>,
        own: Range<usize>,
    ) -> Result<bool> {
        let (w, h) = frame.0.size();
        if next.0.size() != (w, h) || flow.size() != (w, h) {
            return Err(Error::new("the two frames and the flow between them must have one size"));
        }
        let (top, height) = (rows.start, rows.len());
        let white = self.count_colours(&frame.0.data()[w * top..w * rows.end]);
        let inside = |x: f32, y: f32| x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32;
        // Where nothing moves, each pixel is compared with itself: nothing is interpolated, and nothing can mismatch.
        let still = is_still(flow, &rows);
        let target = |x: usize, y: usize| {
            let [u, v] = if still { [0.0; 2] } else { flow.at(x, top + y) };
            [x as f32 + u, (top + y) as f32 + v]
        };
        let brighter = brightening((w, height), |x, y| {
            let [tx, ty] = target(x, y);
            inside(tx, ty).then(|| [frame.0.at(x, top + y), next.0.bilinear(tx, ty)])
        });
        // Warp and difference are one pass, since the warped frame is not needed again.
        let values = |x: usize, y: usize| {
            let ([tx, ty], a) = (target(x, y), frame.0.at(x, top + y));
            if !inside(tx, ty) {
                return [0.0, 0.0, 0.0, luma(a)];
            }
            let mut b = next.0.cubic(tx, ty);
            if let Some(k) = &brighter {
                b = std::array::from_fn(|c| undone(b[c], k[y][c]));
            }
            [a[0] - b[0], a[1] - b[1], a[2] - b[2], 0.5 * (luma(a) + luma(b))]
        };
        let copied = match same_blocks(frame, next, &rows) {
            Some(same) => {
                self.count_copies(&same, frame, top);
                same
            }
            None => Raster::filled(w.div_ceil(COPIED), height.div_ceil(COPIED), false),
        };
        let flaws = |x: usize, y: usize| {
            let [tx, ty] = target(x, y);
            let usable = inside(tx, ty) && !copied.at(x / COPIED, y / COPIED);
            if usable { flaw(frame.0.at(x, top + y), white) } else { UNUSABLE }
        };
        // Targets above or left of the image, whose fractions are negative, are unusable.
        let fraction = Some(|x: usize, y: usize| target(x, y).map(|t| t - t as i32 as f32));
        let colour = |x: usize, y: usize| frame.0.at(x, top + y);
        self.add_blocks((w, height), own, &Residual { values, colour, flaws, fraction, pure: still });
        Ok(still)
    }

    /// Adds the evidence of a single frame: where the frame is flat, its bands are noise. Bars of one colour at its edges are left out.
    pub fn add_single(&mut self, frame: &Encoded) {
        let active = ActiveArea::of(frame);
        let white = self.count_colours(frame.0.data());
        let values = |x, y| {
            let p = frame.0.at(x, y);
            [p[0], p[1], p[2], luma(p)]
        };
        let residual = Residual {
            values,
            colour: |x, y| frame.0.at(x, y),
            flaws: |x, y| if active.holds((x, y), 1) { flaw(frame.0.at(x, y), white) } else { UNUSABLE },
            fraction: ONE_FRAME,
            pure: false,
        };
        self.add_blocks(frame.0.size(), 0..frame.0.height(), &residual);
    }

    /// Adds the difference between a frame and a prediction of the frame without noise. `sharp` is the clean frame that the prediction
    /// blurs: the blur may be wrong by a share of the difference of the two.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_residual(&mut self, frame: &Encoded, predicted: &Encoded, sharp: &Encoded) -> Result<()> {
        check_prediction(frame, predicted)?;
        check_prediction(frame, sharp)?;
        let values = |x, y| {
            let (a, b) = (frame.0.at(x, y), predicted.0.at(x, y));
            [a[0] - b[0], a[1] - b[1], a[2] - b[2], luma(b) - luma(sharp.0.at(x, y))]
        };
        let white = self.count_colours(frame.0.data());
        let residual = Residual {
            values,
            colour: |x, y| predicted.0.at(x, y),
            flaws: |x, y| flaw(frame.0.at(x, y), white),
            fraction: ONE_FRAME,
            pure: predicted == sharp,
        };
        self.add_blocks(frame.0.size(), 0..frame.0.height(), &residual);
        Ok(())
    }

    /// Counts the blocks that are the same in two frames, of those that could show noise: neither clipped nor dark nor of one colour, as a border.
    fn count_copies(&mut self, same: &Raster<bool>, frame: &Encoded, top: usize) {
        for by in 0..same.height() {
            for bx in 0..same.width() {
                let row =
                    &frame.0.row(top + COPIED * by)[COPIED * bx..frame.0.width().min(COPIED * (bx + 1))];
                if !clips(row[0], self.white) && luma(row[0]) >= DARK && row.iter().any(|p| *p != row[0]) {
                    self.compared[0] += 1;
                    self.compared[1] += usize::from(same.at(bx, by));
                }
            }
        }
    }

    /// Counts the colours of a frame's pixels, and gives [`NoiseEvidence::white`] with them.
    fn count_colours(&mut self, pixels: &[[f32; 3]]) -> [f32; 3] {
        let brightest = |p: &[f32; 3]| p[0].max(p[1]).max(p[2]);
        let mut above_one = vec![];
        for p in pixels {
            let v = brightest(p);
            self.brightest[(v * 255.0 + 0.5).clamp(0.0, 255.0) as usize] += 1;
            self.coloured |= v - p[0].min(p[1]).min(p[2]) > 0.5 / 255.0;
            if v > 1.0 {
                above_one.push(*p);
            }
        }
        let beyond = above_one.iter().filter(|p| brightest(p) > BEYOND_ONE).count();
        if beyond as f32 > ABOVE_ONE * pixels.len() as f32 && !ends_at_one(pixels.iter().map(brightest)) {
            let highlights = (HIGHLIGHTS * pixels.len() as f32) as usize;
            for c in 0..3 {
                let (_, brightest, _) =
                    above_one.select_nth_unstable_by(highlights, |a, b| b[c].total_cmp(&a[c]));
                self.white[c] = self.white[c].max(brightest[c]);
            }
        }
        self.white
    }

    /// Adds the variances of the blocks of the rows `own`.
    fn add_blocks<V, C, F, G>(
        &mut self,
        size: (usize, usize),
        own: Range<usize>,
        residual: &Residual<V, C, F, G>,
    ) where
        V: Fn(usize, usize) -> [f32; 4] + Sync + Send,
        C: Fn(usize, usize) -> [f32; 3] + Sync + Send,
        F: Fn(usize, usize) -> Flaw + Sync + Send,
        G: Fn(usize, usize) -> [f32; 2] + Sync + Send,
    {
        for strip in strips_of(own, size, STRIP) {
            self.add_blocks_of(&strip, size.0, residual);
        }
    }

    pub(super) fn add_blocks_of<V, C, F, G>(
        &mut self,
        Strip { rows: own, around }: &Strip,
        w: usize,
        of: &Residual<V, C, F, G>,
    ) where
        V: Fn(usize, usize) -> [f32; 4] + Sync + Send,
        C: Fn(usize, usize) -> [f32; 3] + Sync + Send,
        F: Fn(usize, usize) -> Flaw + Sync + Send,
        G: Fn(usize, usize) -> [f32; 2] + Sync + Send,
    {
        let (top, h) = (around.start, around.len());
        let residual = Raster::from_fn(w, h, |x, y| (of.values)(x, top + y));
        let flaws = Raster::from_fn(w, h, |x, y| (of.flaws)(x, top + y));
        let residual = match &of.fraction {
            // Of frames that lie apart, how much they differ tells how well they match.
            Some(fraction) if !of.pure && !self.flat => {
                let frame = Raster::from_fn(w, h, |x, y| {
                    let [r, g, b] = (of.colour)(x, top + y);
                    [r, g, b, 0.0]
                });
                without_mismatch(residual, frame, &flaws, |x, y| fraction(x, top + y))
            }
            _ => residual,
        };
        // The bands of a single frame hold its structure, so only the smoothed gradient tells structure from noise.
        let single = self.method == Method::Spatial;
        let gradient = single.then(|| squared_gradient(&residual.map(|v| v[3])));
        let (bands, _) = pyramid::laplacian(&residual, NOISE_LEVELS + 1);
        for (level, found) in self.levels.iter_mut().enumerate() {
            let block = BLOCK[level];
            let (columns, rows) = (w / block, own.len() / block);
            let of_block = |i: usize| {
                let (x0, y0) = (i % columns * block, own.start - top + i / columns * block);
                let clipped = clipped_block(&flaws, (x0, y0), block)?;
                if clipped && !of.pure {
                    return None;
                }
                // The factor of the residual on the variance of noise. The taps change the noise of the second frame, depending on the
                // distance of the target from a pixel's centre. They are cubic, since linear ones would leave as much texture as noise in
                // the coarse levels. A few places are enough for the mean, since the flow is smooth.
                let gain = of.fraction.as_ref().map_or(1.0, |fraction| {
                    let of = |(x, y)| {
                        let [fx, fy] = fraction(x0 + x, top + y0 + y);
                        cubic_gain(fx, fy, level)
                    };
                    1.0 + places(block, 4).map(of).sum::<f32>() / places(block, 4).count() as f32
                });
                let powers = |l: usize| Powers::new(&bands[l], (x0, y0), block, l);
                let own = powers(level);
                let next = powers(level + 1);
                let coarser = next.residual[3] / gain;
                let variance = own.residual.map(|v| v / gain);
                // Eight places each way are enough for the colours of a block.
                let pixels = || places(block, block / 8).map(|(x, y)| (of.colour)(x0 + x, top + y0 + y));
                Some(LocalVariance {
                    y: pixels().map(luma).sum::<f32>() / pixels().count() as f32,
                    variance,
                    with_luma: own.with_luma.map(|v| v / gain),
                    // A mismatch shows in the neighbouring bands too, whose noise is independent. A block with little
                    // texture can have little mismatch.
                    structure: match &gradient {
                        Some(gradient) => block_mean(gradient, (x0, y0), block),
                        None => {
                            let finer = if level > 0 { powers(level - 1).residual[3] / gain } else { 1.0 };
                            finer * coarser * own.image.sqrt()
                        }
                    },
                    coarser,
                    count: ((block >> level) * (block >> level)) as f32,
                    colours: Colours::of(pixels()),
                    between: own.between.map(|v| v / gain),
                    neighbours: if single && level == 0 {
                        products_of_neighbours(&bands[0], (x0, y0), block)
                    } else {
                        [0.0; 3]
                    },
                    // About half of the noise's variance is left in the mean of two frames.
                    texture: (own.image - 0.6 * variance[3]).max(0.0),
                    // Half the sum of two frames' powers is the power of their mean and a quarter of that of their difference.
                    coarser_power: next.image + 0.25 * next.residual[3],
                    pure: of.pure,
                    clipped,
                })
            };
            found.extend(par::map(columns * rows, of_block).into_iter().flatten());
        }
    }

    /// Adds the residual of a denoised frame, as the paper does: the local variance `E[x^2] - E[x]^2` under a 9x9 Gaussian
    /// (std 4 px, halved per level), sampled every 32 px (halved per level).
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_denoised(&mut self, frame: &Encoded, denoised: &Encoded) -> Result<()> {
        let (w, h) = frame.0.size();
        let residual = residual(frame, denoised)?;
        let white = self.count_colours(frame.0.data());
        self.windowed = true;
        let (bands, _) = pyramid::laplacian(&residual, NOISE_LEVELS);
        let mut y = denoised.luma();
        for (level, band) in bands.iter().enumerate() {
            let window = window_weights(level);
            let stride = (32 >> level).max(1);
            let (bw, bh) = band.size();
            for cy in (stride / 2..bh).step_by(stride) {
                for cx in (stride / 2..bw).step_by(stride) {
                    if clips(denoised.0.at((cx << level).min(w - 1), (cy << level).min(h - 1)), white) {
                        continue;
                    }
                    let (mut mean, mut square) = ([0.0f32; 4], [0.0f32; 4]);
                    for (j, row) in window.iter().enumerate() {
                        for (i, k) in row.iter().enumerate() {
                            let v = band.at_clamped((cx + i) as isize - 4, (cy + j) as isize - 4);
                            for c in 0..4 {
                                mean[c] += k * v[c];
                                square[c] += k * v[c] * v[c];
                            }
                        }
                    }
                    let bias = window_bias(level);
                    self.levels[level].push(LocalVariance {
                        y: y.at(cx, cy),
                        variance: std::array::from_fn(|c| (square[c] - mean[c] * mean[c]).max(0.0) / bias),
                        count: 16.0,
                        ..LocalVariance::default()
                    });
                }
            }
            y = pyramid::downsample(&y);
        }
        Ok(())
    }

    /// Adds the correlation of noise between successive frames, from three frames between which nothing moves.
    ///
    /// For noise n whose correlation falls off as powers of r, the covariance of the differences n1 - n0 and n2 - n1 is -(1 - r) / 2 of
    /// their variance.
    pub(in crate::fit) fn add_successive(&mut self, [before, frame, next]: [&Encoded; 3]) {
        const SIDE: usize = 16;
        let (w, h) = frame.0.size();
        let columns = w / SIDE;
        let sums_of = |i: usize| {
            let (x0, y0) = (i % columns * SIDE, i / columns * SIDE);
            let (mut sum, mut squares, mut product) = ([0.0f32; 2], 0.0f32, 0.0f32);
            for y in y0..y0 + SIDE {
                for x in x0..x0 + SIDE {
                    let values = [before, frame, next].map(|f| f.0.at(x, y));
                    if values.iter().any(|v| clips(*v, self.white)) {
                        return None;
                    }
                    let [a, b, c] = values.map(luma);
                    let (d, e) = (b - a, c - b);
                    sum = [sum[0] + d, sum[1] + e];
                    squares += 0.5 * (d * d + e * e);
                    product += d * e;
                }
            }
            // A brightness that changes is no noise.
            let n = (SIDE * SIDE) as f32;
            squares -= 0.5 * (sum[0] * sum[0] + sum[1] * sum[1]) / n;
            Some((squares, product - sum[0] * sum[1] / n))
        };
        let blocks: Vec<(f32, f32)> = par::map(columns * (h / SIDE), sums_of).into_iter().flatten().collect();
        let Some(middle) = median(blocks.iter().map(|b| b.0).collect()) else { return };
        // What moves after all differs far more than noise does.
        let noise = blocks.iter().filter(|b| b.0 <= 4.0 * middle);
        let (squares, products) = noise.fold((0.0, 0.0), |(s, p), b| (s + b.0, p + b.1));
        if squares > 0.0 {
            self.successive.push(1.0 + 2.0 * products / squares);
        }
    }
}

/// Whether each block is the same in both frames to the last bit: a coder copies a block that seems still together with its noise, so the
/// block says nothing of noise. `None` if nearly all blocks are the same: there is then no noise, or the few that differ are no fair sample of
/// the picture.
fn same_blocks(frame: &Encoded, next: &Encoded, rows: &Range<usize>) -> Option<Raster<bool>> {
    let (w, height) = (frame.0.width(), rows.len());
    let same = Raster::from_fn(w.div_ceil(COPIED), height.div_ceil(COPIED), |bx, by| {
        let columns = bx * COPIED..((bx + 1) * COPIED).min(w);
        (by * COPIED..((by + 1) * COPIED).min(height)).all(|y| {
            let y = rows.start + y;
            frame.0.row(y)[columns.clone()] == next.0.row(y)[columns.clone()]
        })
    });
    let copied = same.data().iter().filter(|s| **s).count();
    (copied * 20 <= same.data().len() * 19).then_some(same)
}

/// Fails if the sizes of the two frames differ.
fn check_prediction(frame: &Encoded, prediction: &Encoded) -> Result<()> {
    if prediction.0.size() != frame.0.size() {
        return Err(Error::new("the frame and its version without noise must have one size"));
    }
    Ok(())
}

/// The R, G, B and luma of `frame - prediction`.
fn residual(frame: &Encoded, prediction: &Encoded) -> Result<Raster<[f32; 4]>> {
    check_prediction(frame, prediction)?;
    let (w, h) = frame.0.size();
    Ok(Raster::from_fn(w, h, |x, y| {
        let (a, b) = (frame.0.at(x, y), prediction.0.at(x, y));
        let d: [f32; 3] = std::array::from_fn(|c| a[c] - b[c]);
        [d[0], d[1], d[2], luma(d)]
    }))
}

/// The squared gradient of a smoothed image.
fn squared_gradient(image: &Plane) -> Plane {
    let smooth = filter::gaussian_blur(image, 1.5);
    Plane::from_fn(image.width(), image.height(), |x, y| {
        let at = |dx: isize, dy: isize| smooth.at_clamped(x as isize + dx, y as isize + dy);
        0.25 * ((at(1, 0) - at(-1, 0)).powi(2) + (at(0, 1) - at(0, -1)).powi(2))
    })
}

/// The mean over the square of this side at (x, y).
fn block_mean<P: Pixel>(image: &Raster<P>, (x, y): (usize, usize), side: usize) -> P {
    let mut mean = P::default();
    for y in y..y + side {
        let mut row = P::default();
        image.row(y)[x..x + side].iter().for_each(|&v| row.add_scaled(v, 1.0));
        mean.add_scaled(row, 1.0 / (side * side) as f32);
    }
    mean
}

/// The places of a block of this side that are `step` apart, px from its corner.
fn places(side: usize, step: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..side).step_by(step).flat_map(move |y| (0..side).step_by(step).map(move |x| (x, y)))
}

/// Whether so many pixels of a block clip that a part of the noise is lost; `None` if a pixel is unusable. The filters of the coarser bands
/// reach outside the block, so flaws near the block count as well.
fn clipped_block(flaws: &Raster<Flaw>, (x0, y0): (usize, usize), side: usize) -> Option<bool> {
    let most = (MAY_CLIP * (side * side) as f32) as usize;
    let columns = x0.saturating_sub(4)..(x0 + side + 4).min(flaws.width());
    let mut clipped = 0;
    for y in y0.saturating_sub(4)..(y0 + side + 4).min(flaws.height()) {
        let row = &flaws.row(y)[columns.clone()];
        if row.contains(&UNUSABLE) {
            return None;
        }
        clipped += row.iter().filter(|flaw| **flaw == CLIPPED).count();
    }
    Some(clipped > most)
}

/// Whether nothing moves between two frames in these rows: the flow is about zero nearly everywhere, and has no direction in common.
fn is_still(flow: &Flow, rows: &Range<usize>) -> bool {
    /// The most of the median motion along an axis, px, and of the motion of a pixel that counts as still, px: a flow that was found among
    /// noise is not exactly zero.
    const MOST: (f32, f32) = (0.03, 0.3);
    let known = || rows.clone().flat_map(|y| flow.row(y)).filter(|f| f[0].is_finite() && f[1].is_finite());
    let all = known().count();
    let slow = known().filter(|[u, v]| u.abs().max(v.abs()) <= MOST.1).count();
    let median = |axis: usize| median(known().step_by(7).map(|f| f[axis]).collect());
    all > 0
        && slow * 20 >= all * 19
        && [0, 1].into_iter().all(|axis| median(axis).is_some_and(|m| m.abs() <= MOST.0))
}

/// The mean squares of a band of [`NoiseEvidence::add_blocks`] in a block.
struct Powers {
    /// The mean squares of R, G, B and luma of the residual.
    residual: [f32; 4],
    /// The mean products of R, G and B with luma.
    with_luma: [f32; 3],
    /// The mean products RG, RB and GB of the residual.
    between: [f32; 3],
    /// The mean square of the image itself.
    image: f32,
}

impl Powers {
    /// The powers in the block at (x, y) of this side, both in px of the full image, of a band of this level.
    fn new(band: &Raster<[f32; 4]>, (x, y): (usize, usize), side: usize, level: usize) -> Self {
        let (x, y, side) = (x >> level, y >> level, side >> level);
        let [mut squares, mut with_luma, mut between] = [f32x4::ZERO; 3];
        for row in y..y + side {
            for v in &band.row(row)[x..x + side] {
                let [r, g, b, _] = *v;
                let d = luma([r, g, b]);
                let v = f32x4::from(*v);
                squares += v * v;
                with_luma += v * f32x4::splat(d);
                between += f32x4::from([r, r, g, d]) * f32x4::from([g, b, b, d]);
            }
        }
        let mean = |sums: f32x4| sums.to_array().map(|s| s / (side * side) as f32);
        let ([r, g, b, image], [rg, rb, gb, y]) = (mean(squares), mean(between));
        let [ry, gy, by, _] = mean(with_luma);
        Self { residual: [r, g, b, y], with_luma: [ry, gy, by], between: [rg, rb, gb], image }
    }
}

/// The mean products of the finest band's values with their right and their lower neighbours, for R, G and B, in the square at (x, y).
fn products_of_neighbours(band: &Raster<[f32; 4]>, (x0, y0): (usize, usize), side: usize) -> [f32; 3] {
    let mut products = [0.0; 3];
    for (x, y) in places(side, 1).map(|(x, y)| (x0 + x, y0 + y)) {
        let (v, right) = (band.at(x, y), band.at((x + 1).min(band.width() - 1), y));
        let below = band.at(x, (y + 1).min(band.height() - 1));
        (0..3).for_each(|c| products[c] += 0.5 * v[c] * (right[c] + below[c]));
    }
    products.map(|s| s / (side * side) as f32)
}

/// Whether values accumulate at 1, where a plate ends: else five times as wide a range just below has no fewer of them.
fn ends_at_one(values: impl ExactSizeIterator<Item = f32>) -> bool {
    let fewest = values.len() / 1000;
    let (at_one, just_below) = values.fold((0, 0), |(at_one, just_below), v| {
        (
            at_one + usize::from((v - 1.0).abs() <= 0.001),
            just_below + usize::from((0.989..0.999).contains(&v)),
        )
    });
    at_one > just_below + fewest
}

/// The flaw of a pixel, where values end at `white` in R, G and B.
pub(super) fn flaw(p: [f32; 3], white: [f32; 3]) -> Flaw {
    if clips(p, white) { CLIPPED } else { 0 }
}

fn clips(p: [f32; 3], white: [f32; 3]) -> bool {
    (0..3).any(|c| !(CLIP_MARGIN..=white[c] * (1.0 - CLIP_MARGIN)).contains(&p[c]))
}

/// The paper's 9x9 Gaussian window at a level.
fn window_weights(level: usize) -> [[f32; 9]; 9] {
    let sigma = 4.0 / (1 << level) as f32;
    let g: [f32; 9] = std::array::from_fn(|i| (-0.5 * ((i as f32 - 4.0) / sigma).powi(2)).portable_exp());
    let sum: f32 = g.iter().sum();
    std::array::from_fn(|j| std::array::from_fn(|i| g[i] * g[j] / (sum * sum)))
}

/// The square of the mean std under the window over the variance, for white noise. It is below 1 since the subtracted mean is that of the
/// same few values, and since the mean of a root of few values is small. A test below checks the noise that follows.
fn window_bias(level: usize) -> f32 {
    [0.988, 0.968, 0.847, 0.423][level]
}

/// The gain of cubic interpolation at the offset (fx, fy) on the variance of white noise in a band: along each axis
/// `|H|^2 = sum of c_k cos k w`, with c the autocorrelation of the four taps, averaged over the band.
pub(super) fn cubic_gain(fx: f32, fy: f32, level: usize) -> f32 {
    static MOMENTS: OnceLock<[[[f32; 4]; 4]; NOISE_LEVELS]> = OnceLock::new();
    let moments = &MOMENTS.get_or_init(|| std::array::from_fn(band_moments))[level];
    let both_sides = |f: f32| {
        let [at_0, at_1, at_2, at_3] = cubic_covariance(f);
        [at_0, 2.0 * at_1, 2.0 * at_2, 2.0 * at_3]
    };
    let (x, y) = (both_sides(fx), both_sides(fy));
    (0..4).map(|i| y[i] * (0..4).map(|j| x[j] * moments[i][j]).sum::<f32>()).sum()
}

/// The covariance, at distances of 0 to 3 px along an axis, of white noise of variance 1 that was interpolated at this fraction of a px: the
/// autocorrelation of the four taps.
pub(super) fn cubic_covariance(fraction: f32) -> [f32; 4] {
    let k = cubic_weights(fraction);
    [0, 1, 2, 3].map(|lag| (0..4 - lag).map(|i| k[i] * k[i + lag]).sum())
}

/// The means of `cos i wy cos j wx` over the spectrum of white noise in a Laplacian band.
fn band_moments(level: usize) -> [[f32; 4]; 4] {
    const N: usize = 128;
    let low = |w: f64| (6.0 + 8.0 * w.cos() + 2.0 * (2.0 * w).cos()) / 16.0;
    let mut sums = [[0.0; 4]; 4];
    for j in 0..N {
        for i in 0..N {
            let w = [i, j].map(|i| std::f64::consts::PI * (i as f64 + 0.5) / N as f64);
            let gain = |level: usize| w.iter().map(|w| low(w * f64::from(1 << level))).product::<f64>();
            let band = (0..level).map(gain).product::<f64>() * (1.0 - gain(level).powi(2));
            for (a, row) in sums.iter_mut().enumerate() {
                for (b, sum) in row.iter_mut().enumerate() {
                    *sum += band * band * (a as f64 * w[1]).cos() * (b as f64 * w[0]).cos();
                }
            }
        }
    }
    sums.map(|row| row.map(|s| (s / sums[0][0]) as f32))
}
