//! From the numbers of the frames to findings.

use super::measure::{Between, Pair, STREAK_STEP, Seen, largest, mean_of};
use super::{Cadence, Event, FOUND, Finding, Interpolation, Kind, Timing, Untold, WhyUntold};
use std::ops::Range;

/// The number of pairs of frames before and after a pair that say how much it should differ, and how it should move.
const NEAR: usize = 3;
/// The number of frames before and after a frame from which the spread of a sign is found.
const AROUND: usize = 24;
/// The fewest values that have a spread.
const ENOUGH: usize = 8;
/// The steps of 8 bits by which pictures around must differ for a doubled frame to stand out.
pub(super) const MOVES: f32 = 0.5;
/// The steps of 8 bits below which two frames are the same.
const SAME: f32 = 0.05;
/// The steps of 8 bits that are added to differences, so that none is 0.
const ROUNDING: f32 = 0.02;
/// The speed, px of the halved frame per frame interval, from which on a cell tells of the motion.
const MOVING_PX: f32 = 0.3;
/// The least share of the larger one that the smaller one of the speeds before and after has where a cell tells of the motion.
const EVEN: f32 = 0.5;
/// The fewest such cells.
const MOVING_CELLS: usize = 3;
/// The share of the motion that must have a common direction before and after: where it turns around, nothing moves for a moment.
const COHERENT: f32 = 0.3;
/// The largest log-likelihood ratio of a sign, nats: no more is believed of it.
const MOST: f32 = 10.0;
/// The most frames in a row that are looked for as missing.
const MOST_MISSING: u32 = 4;
/// The number of tiles of a frame that tell as much as one, since their errors are alike.
const ALIKE: f32 = 4.0;
/// The limit of what streaks tell, nats.
const MOST_OF_STREAKS: f32 = 8.0;
/// The nats by which an exposure must be likelier than others to be known.
const SURE: f32 = 8.0;

/// A sign: its least spread, and the value from which on it is that of a finding.
pub(super) struct Sign {
    floor: f32,
    found: f32,
}

/// The log of a pair's difference over that of the pairs around.
pub(super) const DIFFERENCE: Sign = Sign { floor: 0.15, found: -2.3 };
/// The log of the difference to the mixture in place, beside that of frames around.
const BLEND: Sign = Sign { floor: 0.15, found: -1.4 };
/// The log of the difference to the mixture along the motion, beside the smaller one of its neighbours': the larger one may be that of a
/// frame beside a gap.
const WARP: Sign = Sign { floor: 0.08, found: -0.8 };
/// The log of the finest detail beside that of both neighbours.
const DETAIL: Sign = Sign { floor: 0.06, found: -0.25 };
/// The least spread of the log of the ratio of motions.
const RATIO_FLOOR: f32 = 0.07;
/// What the finest detail may tell, nats: a coder changes it from frame to frame.
const OF_DETAIL: Range<f32> = -2.0..5.0;

impl Sign {
    /// What a value at or below 0 tells for a finding, nats.
    pub fn tells(&self, value: f32, spread: f32) -> f32 {
        ((value.abs() - (value - self.found).max(0.0)) / spread).min(MOST)
    }

    /// The scale of the Laplace distribution of those of these values that are none of a finding; `None` if they are too few. Values as far
    /// above 0 as no other lies below it do not count for more: at the end of a shot of copies one frame alone moves.
    pub fn spread(&self, values: impl Iterator<Item = f32>) -> Option<f32> {
        let most = -0.5 * self.found;
        let (mut sum, mut count) = (0.0, 0);
        for value in values.filter(|&v| v > -most) {
            sum += value.abs().min(most);
            count += 1;
        }
        (count >= ENOUGH).then(|| (sum / count as f32).max(self.floor))
    }
}

/// The sign of a doubled frame by its difference to the one before and the expected one, in steps of 8 bits.
pub(super) fn difference_sign([own, expected]: [f32; 2]) -> f32 {
    ((own + ROUNDING) / (expected + ROUNDING)).ln()
}

pub(super) fn timing(seen: &[Seen]) -> Timing {
    let mut shots = 0;
    let shot_of: Vec<usize> = seen
        .iter()
        .map(|s| {
            shots += usize::from(s.opens);
            shots
        })
        .collect();
    let clip = Clip { seen, shot_of };
    let (doubled, untold_doubled) = clip.doubled();
    let copies: Vec<bool> = doubled.iter().map(|d| d.is_some()).collect();
    let (interpolated, untold_interpolated) = clip.interpolated(&copies);
    let made: Vec<bool> = interpolated.iter().map(|d| d.is_some()).collect();
    let exposure = clip.exposure(&copies, &made);
    let (dropped, untold_dropped) = clip.dropped(&copies, &made, exposure);
    let mut findings: Vec<Finding> =
        [doubled, dropped, interpolated].into_iter().flatten().flatten().collect();
    findings.sort_by_key(|f| (f.frame, f.event.kind()));
    let cadences = Kind::ALL.into_iter().filter_map(|kind| clip.cadence(kind, &findings)).collect();
    let unknown = [untold_doubled, untold_dropped, untold_interpolated];
    let unknown = Kind::ALL.into_iter().zip(unknown).flat_map(|(kind, u)| clip.ranges(kind, &u)).collect();
    Timing { frames: seen.len(), shots, exposure, findings, cadences, unknown }
}

/// The findings of a kind by the index of their frame, and the reasons why some frames tell nothing.
type Told = (Vec<Option<Finding>>, Vec<Option<WhyUntold>>);

struct Clip<'a> {
    seen: &'a [Seen],
    shot_of: Vec<usize>,
}

impl Clip<'_> {
    fn len(&self) -> usize {
        self.seen.len()
    }

    /// The frames of frame `i`'s shot among these.
    fn same_shot(&self, i: usize, range: Range<usize>) -> impl DoubleEndedIterator<Item = usize> {
        range.filter(move |&j| self.shot_of[j] == self.shot_of[i])
    }

    /// The frames of the shot within a distance before and after frame `i`.
    fn around(&self, i: usize, by: usize) -> impl Iterator<Item = usize> {
        self.same_shot(i, i.saturating_sub(by)..(i + by + 1).min(self.len())).filter(move |&j| j != i)
    }

    /// The scale of the Laplace distribution of a sign in the frames around frame `i`, or in all frames if these are too few. A low
    /// quantile is taken, since findings are among the values, and may even be the most.
    fn spread(&self, signs: &[Option<f32>], i: usize, floor: f32) -> Option<f32> {
        const QUANTILE: f32 = 0.3;
        let mut values: Vec<f32> = self.around(i, AROUND).filter_map(|j| signs[j]).map(f32::abs).collect();
        if values.len() < ENOUGH {
            values = signs.iter().flatten().map(|v| v.abs()).collect();
        }
        if values.len() < ENOUGH {
            return None;
        }
        values.sort_by(f32::total_cmp);
        let quantile = values[(QUANTILE * values.len() as f32) as usize];
        Some((quantile / -(1.0 - QUANTILE).ln()).max(floor))
    }

    /// The difference of frame `i` to the next one, and that of the pairs around, where these differ most, in steps of 8 bits. What is
    /// expected is the smaller one of the largest differences before and after.
    fn differences(&self, i: usize) -> Option<[f32; 2]> {
        let own = &self.seen[i].pair.as_ref()?.difference;
        let largest_of = |range: Range<usize>| {
            let pairs = self.same_shot(i, range).filter_map(|j| self.seen[j].pair.as_ref());
            pairs
                .map(|p| p.difference.clone())
                .reduce(|a, b| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect())
        };
        let (before, after) =
            (largest_of(i.saturating_sub(NEAR)..i), largest_of(i + 1..(i + 1 + NEAR).min(self.len())));
        let expected: Vec<f32> = match (before, after) {
            (Some(a), Some(b)) => a.iter().zip(&b).map(|(a, b)| a.min(*b)).collect(),
            (a, b) => a.or(b)?,
        };
        let most = largest(&expected);
        Some([own, &expected].map(|v| 255.0 * mean_of(v, &most)))
    }

    /// The motion around pair `i`: that of the nearest pairs before and after that are none of these copies.
    fn neighbours(&self, i: usize, copies: &[bool]) -> Option<[&Pair; 2]> {
        let moving = |j: usize| {
            let is_copy = copies.get(j + 1) == Some(&true);
            self.seen[j].pair.as_ref().filter(|p| p.followed && !is_copy)
        };
        let before = self.same_shot(i, i.saturating_sub(NEAR)..i).rev().find_map(moving)?;
        let after = self.same_shot(i, i + 1..(i + 1 + NEAR).min(self.len())).find_map(moving)?;
        Some([before, after])
    }

    /// Doubled frames, by the index of the copy.
    fn doubled(&self) -> Told {
        let n = self.len();
        let differences: Vec<Option<[f32; 2]>> = (0..n).map(|i| self.differences(i)).collect();
        let signs: Vec<Option<f32>> = differences.iter().map(|d| d.map(difference_sign)).collect();
        // Pairs that hardly differ have no motion that others could be compared with.
        let alike: Vec<bool> =
            (0..n).map(|i| i > 0 && signs[i - 1].is_some_and(|s| s < 0.5 * DIFFERENCE.found)).collect();
        let (mut found, mut untold) = (vec![None; n], vec![None; n]);
        for i in 0..n.saturating_sub(1) {
            if self.seen[i].pair.is_none() {
                continue;
            }
            let (Some([difference, expected]), Some(sign)) = (differences[i], signs[i]) else {
                untold[i + 1] = Some(WhyUntold::TooShort);
                continue;
            };
            let turns_around = self.neighbours(i, &alike).is_some_and(|pairs| coherence(pairs) < COHERENT);
            if expected < MOVES || (turns_around && difference >= SAME) {
                untold[i + 1] = Some(WhyUntold::Still);
                continue;
            }
            let around = DIFFERENCE.spread(self.around(i, AROUND).filter_map(|j| signs[j]));
            let Some(spread) = around.or_else(|| DIFFERENCE.spread(signs.iter().copied().flatten())) else {
                untold[i + 1] = Some(WhyUntold::TooShort);
                continue;
            };
            let log_likelihood_ratio = DIFFERENCE.tells(sign, spread);
            if sign < 0.0 && log_likelihood_ratio >= FOUND {
                let event = Event::Doubled { difference, expected };
                found[i + 1] = Some(Finding { frame: self.seen[i + 1].number, event, log_likelihood_ratio });
            }
        }
        (found, untold)
    }

    /// Frames that were made from their neighbours.
    fn interpolated(&self, copies: &[bool]) -> Told {
        let n = self.len();
        // Beside a copy nothing lies between its neighbours.
        let usable = |i: usize| {
            let beside_copy = copies[i] || copies.get(i + 1) == Some(&true);
            self.seen.get(i)?.between.as_ref().filter(|b| !beside_copy && b.apart > 0.0)
        };
        let log = |of: &dyn Fn(&Between) -> f32| -> Vec<Option<f32>> {
            (0..n).map(|i| usable(i).map(|b| ((of(b) + 1e-6) / b.apart).ln())).collect()
        };
        let (blends, warps) = (log(&|b| b.to_blend), log(&|b| b.to_warp));
        let beside = |i: usize| {
            let mut near: Vec<f32> = self.around(i, 4).filter_map(|j| blends[j]).collect();
            near.sort_by(f32::total_cmp);
            (near.len() >= 3).then(|| near[near.len() / 2])
        };
        let blend: Vec<Option<f32>> = (0..n).map(|i| Some(blends[i]? - beside(i)?)).collect();
        let warp: Vec<Option<f32>> = (0..n)
            .map(|i| {
                let (before, after) = (i.checked_sub(1)?, i + 1);
                Some(warps[i]? - warps[before]?.min((*warps.get(after)?)?))
            })
            .collect();
        let detail: Vec<Option<f32>> = (0..n).map(|i| usable(i).map(|b| b.detail)).collect();
        let (mut found, mut untold): Told = (vec![None; n], vec![None; n]);
        for i in 0..n {
            let spreads = [(&blend, BLEND), (&warp, WARP), (&detail, DETAIL)]
                .map(|(signs, sign)| Some((signs[i]?, self.spread(signs, i, sign.floor)?)));
            let Some(between) = usable(i) else {
                let beside_copy = self.seen[i].between.is_some();
                untold[i] = Some(if beside_copy { WhyUntold::BesideAnother } else { WhyUntold::TooShort });
                continue;
            };
            if 255.0 * between.apart < MOVES {
                untold[i] = Some(WhyUntold::Still);
                continue;
            }
            let [Some(blend), warp, Some(detail)] = spreads else {
                untold[i] = Some(WhyUntold::TooShort);
                continue;
            };
            if !between.is_mixed() {
                continue;
            }
            // What lies along the motion is no mixture in place.
            let in_place = between.to_blend < 0.8 * between.to_warp && blend.0 < 0.0;
            let of_blend = if in_place { BLEND.tells(blend.0, blend.1) } else { 0.0 };
            let of_warp = warp.filter(|w| w.0 < 0.0).map_or(0.0, |(value, spread)| {
                let of_detail = DETAIL.tells(detail.0, detail.1).clamp(OF_DETAIL.start, OF_DETAIL.end);
                WARP.tells(value, spread) + of_detail
            });
            let log_likelihood_ratio = of_blend.max(of_warp);
            if log_likelihood_ratio < FOUND {
                continue;
            }
            let Between { share, to_blend, to_warp, detail, .. } = *between;
            let how = if of_blend > of_warp { Interpolation::Blend } else { Interpolation::Warp };
            let [to_blend, to_warp] = [to_blend, to_warp].map(|v| 255.0 * v);
            let event = Event::Interpolated { how, share, to_blend, to_warp, detail: detail.exp() };
            found[i] = Some(Finding { frame: self.seen[i].number, event, log_likelihood_ratio });
        }
        (without_echoes(found), untold)
    }

    /// The exposure fraction that the streaks of all frames agree on but of those beside these.
    fn exposure(&self, copies: &[bool], made: &[bool]) -> Option<f32> {
        let odd = |i: usize| {
            (i.saturating_sub(1)..=i + 1).any(|j| [copies, made].iter().any(|m| m.get(j) == Some(&true)))
        };
        let curves = (0..self.len()).filter(|&i| !odd(i)).filter_map(|i| self.seen[i].streaks.clone());
        let sum = curves.reduce(|a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect())?;
        let best = (0..sum.len()).max_by(|&a, &b| sum[a].total_cmp(&sum[b]))?;
        let least = sum.iter().copied().fold(f32::INFINITY, f32::min);
        let exposure = best as f32 * STREAK_STEP;
        (sum[best] - least > SURE && exposure <= 1.1).then_some(exposure)
    }

    /// Frames after which others are missing.
    fn dropped(&self, copies: &[bool], made: &[bool], exposure: Option<f32>) -> Told {
        let n = self.len();
        let is_copy = |i: usize| copies.get(i) == Some(&true);
        // The motion to and from a frame that was made from its neighbours is that of no frame.
        let beside_made = |i: usize| (i.saturating_sub(1)..=i + 2).any(|j| made.get(j) == Some(&true));
        let mut untold = vec![None; n];
        let mut ratios = vec![None; n];
        for i in 0..n {
            let Some(pair) = self.seen[i].pair.as_ref().filter(|_| !is_copy(i + 1)) else { continue };
            let ratio = if beside_made(i) {
                Err(WhyUntold::BesideAnother)
            } else if !pair.followed {
                Err(WhyUntold::NotFollowed)
            } else {
                let around = self.neighbours(i, copies).ok_or(WhyUntold::TooShort);
                around.and_then(|around| ratio(pair, around).ok_or(WhyUntold::Still))
            };
            match ratio {
                Ok(ratio) => ratios[i] = Some(ratio),
                Err(why) => untold[i] = Some(why),
            }
        }
        let logs: Vec<Option<f32>> =
            ratios.iter().map(|r| r.map(|(ratio, _)| ratio.max(0.05).ln())).collect();
        let mut found = vec![None; n];
        for i in 0..n {
            let (Some((motion_ratio, across)), Some(log)) = (ratios[i], logs[i]) else { continue };
            let Some(spread) = self.spread(&logs, i, RATIO_FLOOR) else {
                untold[i] = Some(WhyUntold::TooShort);
                continue;
            };
            // All that moves must move alike, too.
            let spread = spread.hypot(0.5 * across);
            let tells = |missing: u32| (log.abs() - (log - (missing as f32 + 1.0).ln()).abs()) / spread;
            let Some(missing) = (1..=MOST_MISSING).max_by(|&a, &b| tells(a).total_cmp(&tells(b))) else {
                continue;
            };
            // A copy shows the motion of the frame that it repeats.
            let frames = [i, i + 1].into_iter().filter(|&j| !is_copy(j) && !is_copy(j + 1));
            let streaks = exposure.and_then(|exposure| self.streaks(frames, missing, exposure));
            let log_likelihood_ratio = tells(missing).min(MOST) + streaks.unwrap_or(0.0);
            if log_likelihood_ratio >= FOUND {
                let event = Event::Dropped { missing, motion_ratio, streaks };
                found[i] = Some(Finding { frame: self.seen[i].number, event, log_likelihood_ratio });
            }
        }
        (found, untold)
    }

    /// How much better the streaks of frames around a gap fit the motion of the frames around than the mean of that and the motion over the
    /// gap, which they would show if the camera really moved faster, nats. The curves of the frames are those of that mean.
    fn streaks(&self, frames: impl Iterator<Item = usize>, missing: u32, exposure: f32) -> Option<f32> {
        /// The exposures this many steps away fit as well.
        const NEAR: usize = 2;
        let mean = 0.5 * (missing as f32 + 2.0);
        let told = frames.filter_map(|i| self.seen[i].streaks.as_ref()).map(|curve| {
            let likely = |exposure: f32| {
                let at = ((exposure / STREAK_STEP).round() as usize).min(curve.len() - 1);
                curve[at.saturating_sub(NEAR)..(at + NEAR + 1).min(curve.len())]
                    .iter()
                    .copied()
                    .fold(f32::MIN, f32::max)
            };
            (likely(exposure / mean) - likely(exposure)) / ALIKE
        });
        told.reduce(|a, b| a + b).map(|sum| sum.clamp(-MOST_OF_STREAKS, MOST_OF_STREAKS))
    }

    /// The period of a kind of finding, if there is one.
    fn cadence(&self, kind: Kind, findings: &[Finding]) -> Option<Cadence> {
        /// The longest period that is looked for.
        const LONGEST: u64 = 30;
        /// The fewest periods.
        const PERIODS: u64 = 4;
        /// The share of the frames of one place in the period that must be alike.
        const ALIKE: f32 = 0.85;
        let of_kind: Vec<u64> = findings.iter().filter(|f| f.event.kind() == kind).map(|f| f.frame).collect();
        let (first, last) = (*of_kind.first()?, *of_kind.last()?);
        (2..=LONGEST).take_while(|period| PERIODS * period <= last - first + 1).find_map(|period| {
            let mut of_period = 0;
            for place in 0..period {
                let all = (first + place..=last).step_by(period as usize).count() as f32;
                let found = of_kind.iter().filter(|f| (*f - first) % period == place).count() as f32;
                match found / all {
                    share if share >= ALIKE => of_period += 1,
                    share if share > 1.0 - ALIKE => return None,
                    _ => {}
                }
            }
            (of_period > 0).then_some(Cadence { kind, period, of_period })
        })
    }

    /// Successive frames of one reason as ranges.
    fn ranges(&self, kind: Kind, untold: &[Option<WhyUntold>]) -> Vec<Untold> {
        let mut ranges: Vec<Untold> = vec![];
        for (seen, reason) in self.seen.iter().zip(untold).filter_map(|(s, u)| Some((s, (*u)?))) {
            match ranges.last_mut() {
                Some(last) if last.reason == reason && last.last + 1 == seen.number => {
                    last.last = seen.number
                }
                _ => ranges.push(Untold { kind, first: seen.number, last: seen.number, reason }),
            }
        }
        ranges
    }
}

/// The findings without those beside a stronger one: a made frame makes its neighbours stand out, too.
fn without_echoes(found: Vec<Option<Finding>>) -> Vec<Option<Finding>> {
    let strength = |i: usize| found[i].map_or(f32::MIN, |f| f.log_likelihood_ratio);
    let is_echo = |i: usize| {
        let near = i.saturating_sub(2)..(i + 3).min(found.len());
        near.into_iter().any(|j| j != i && strength(j) > strength(i))
    };
    (0..found.len()).map(|i| found[i].filter(|_| !is_echo(i))).collect()
}

fn length([u, v]: [f32; 2]) -> f32 {
    u.hypot(v)
}

/// The mean motion of a cell before and after.
fn mean_motion([before, after]: [&Pair; 2], cell: usize) -> [f32; 2] {
    [0, 1].map(|c| 0.5 * (before.flow[cell][c] + after.flow[cell][c]))
}

/// The share of the motion before and after that has a common direction, in [0, 1].
fn coherence(pairs @ [before, after]: [&Pair; 2]) -> f32 {
    let (mut common, mut all) = (0.0, 0.0);
    for cell in 0..before.flow.len() {
        let mean = length(mean_motion(pairs, cell));
        if mean.is_finite() {
            common += mean;
            all += 0.5 * (length(before.flow[cell]) + length(after.flow[cell]));
        }
    }
    if all > 0.0 { common / all } else { 0.0 }
}

/// The motion of a pair over that of the pairs around, and how much cells differ in it; `None` if too little moves. Only cells count in
/// which something moves both before and after: a thing that enters or leaves a cell moves it twice as fast as the mean of both.
fn ratio(pair: &Pair, around: [&Pair; 2]) -> Option<(f32, f32)> {
    let ratios: Vec<[f32; 2]> = (0..pair.flow.len())
        .filter_map(|cell| {
            let ([u, v], mean) = (pair.flow[cell], mean_motion(around, cell));
            let [before, after] = around.map(|p| length(p.flow[cell]));
            let speed = length(mean);
            let ratio = (u * mean[0] + v * mean[1]) / (speed * speed);
            let counts = speed > MOVING_PX && before.min(after) > EVEN * before.max(after);
            (counts && ratio.is_finite()).then_some([ratio, speed])
        })
        .collect();
    if ratios.len() < MOVING_CELLS {
        return None;
    }
    let middle = weighted_median(ratios.clone());
    let across = weighted_median(ratios.into_iter().map(|[r, w]| [(r - middle).abs(), w]).collect());
    Some((middle, across))
}

/// The median of values with weights.
fn weighted_median(mut values: Vec<[f32; 2]>) -> f32 {
    values.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let half = 0.5 * values.iter().map(|v| v[1]).sum::<f32>();
    let mut sum = 0.0;
    let middle = values.iter().find(|[_, weight]| {
        sum += weight;
        sum >= half
    });
    middle.map_or(f32::NAN, |v| v[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_comes_back_has_a_cadence() {
        let clip = Clip { seen: &[], shot_of: vec![] };
        let cadence = |frames: &[u64]| {
            let event = Event::Dropped { missing: 1, motion_ratio: 2.0, streaks: None };
            let finding = |&frame| Finding { frame, event, log_likelihood_ratio: 9.0 };
            clip.cadence(Kind::Dropped, &frames.iter().map(finding).collect::<Vec<_>>())
        };
        let every = |period, of_period| Some(Cadence { kind: Kind::Dropped, period, of_period });
        assert_eq!(cadence(&[3, 8, 13, 18, 23]), every(5, 1));
        assert_eq!(cadence(&[3, 4, 8, 9, 13, 14, 18, 19, 23]), every(5, 2));
        // A few findings at any places.
        assert_eq!(cadence(&[9, 18, 36, 45, 63, 153, 198, 207]), None);
        assert_eq!(cadence(&[]), None);
    }
}
