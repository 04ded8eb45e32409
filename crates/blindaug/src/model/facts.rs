//! Facts that follow from a model, computed here for all that show them: `inspect`, the report, a window, a page, Python.

use super::{DefocusCurve, DefocusModel};

/// The least blur that is visible, as the std of the equivalent Gaussian in px.
pub const VISIBLE_PX: f32 = 0.5;

/// Blur below this std, in px, counts as none: a curve that stays below this std everywhere says nothing of a focus.
const NONE_PX: f32 = 0.01;

/// Blur of a smaller std, px, is not told from none: textures add or hide as much.
const LEAST_TOLD_PX: f32 = 0.2;

/// The inverse depth that a lens brings into focus, if there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Focus {
    /// The inverse depth that is in focus.
    At(f32),
    /// Nothing in the curve's range is in focus: blur is visible everywhere, and least at this inverse depth.
    LeastBlurred {
        /// The inverse depth of least blur.
        inverse_depth: f32,
        /// The std of the blur at that inverse depth, px, at least [`VISIBLE_PX`].
        sigma_px: f32,
    },
    /// Nothing is blurred at any depth, so no depth is in focus more than another.
    Everywhere,
}

/// A place of the focus outside of what was seen: how far outside, blur does not tell well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutsideFocus {
    /// The focus is nearer than all that was seen, the nearest of which is at this inverse depth.
    Nearer(f32),
    /// The focus is beyond all that was seen, the farthest of which is at this inverse depth.
    Beyond(f32),
}

impl OutsideFocus {
    /// The place in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Nearer(_) => "nearer than all that is seen",
            Self::Beyond(_) => "beyond all that is seen",
        }
    }

    /// The inverse depth of what was seen next to the focus.
    pub fn limit(self) -> f32 {
        match self {
            Self::Nearer(d) | Self::Beyond(d) => d,
        }
    }
}

/// Facts that follow from a defocus model, in the model's own unit of inverse depth and in px.
#[derive(Clone, Debug, PartialEq)]
pub struct DefocusFacts {
    /// The inverse depth in focus, if there is one.
    pub focus: Focus,
    /// The place of a focus that lies outside of what was seen; `None` if it lies within, or if what was seen is not known.
    pub outside: Option<OutsideFocus>,
    /// The 95 % interval of the inverse depth that is in focus; only a thin lens has one.
    pub focus_interval: Option<[f32; 2]>,
    /// The std of the blur at inverse depth 0, px; only a thin lens has one, since other curves are not known that far.
    pub sigma_px_at_infinity: Option<f32>,
    /// The 95 % interval of `sigma_px_at_infinity`.
    pub sigma_interval: Option<[f32; 2]>,
    /// The upper end of `sigma_interval`, px, where the blur cannot be told from none: then only this bound is known.
    pub sigma_below: Option<f32>,
    /// The ranges of inverse depth, far and near end, in which the std is at most [`VISIBLE_PX`], from far to near. An end of 0 lies
    /// infinitely far away, and an end of infinity touches the lens. The list is empty if blur is visible everywhere.
    pub sharp: Vec<[f32; 2]>,
}

impl DefocusModel {
    /// The facts that follow from the model.
    pub fn facts(&self) -> DefocusFacts {
        match self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval } => {
                let is_none = |s: f32| s < LEAST_TOLD_PX;
                let sigma_below = interval
                    .map(|i| i.sigma_px_at_infinity)
                    .filter(|i| is_none(s) && i[0] < NONE_PX)
                    .map(|i| i[1]);
                // A lens that is in focus very far away blurs what is near, although its blur at infinity is none.
                let largest = self
                    .inverse_depth_seen
                    .map_or(s, |seen| seen.into_iter().map(|d| self.sigma_px(d)).fold(0.0, f32::max));
                let everywhere = s == 0.0 || sigma_below.is_some() && is_none(largest);
                let outside = match self.inverse_depth_seen {
                    _ if everywhere => None,
                    Some([_, nearest]) if f > nearest => Some(OutsideFocus::Nearer(nearest)),
                    Some([farthest, _]) if f < farthest => Some(OutsideFocus::Beyond(farthest)),
                    _ => None,
                };
                DefocusFacts {
                    focus: if everywhere { Focus::Everywhere } else { Focus::At(f) },
                    outside,
                    sigma_below,
                    focus_interval: interval.map(|i| i.focus_inverse_depth),
                    sigma_px_at_infinity: Some(s),
                    sigma_interval: interval.map(|i| i.sigma_px_at_infinity),
                    sharp: vec![thin_lens_sharp(s, f)],
                }
            }
            DefocusCurve::Quadratic { inverse_depth_range, .. } => self.quadratic_facts(inverse_depth_range),
        }
    }

    fn quadratic_facts(&self, [low, high]: [f32; 2]) -> DefocusFacts {
        const STEPS: u16 = 1000;
        /// Stds that differ by less than this, in px, count as the same.
        const SAME_PX: f32 = 1e-4;
        let places: Vec<f32> =
            (0..=STEPS).map(|i| low + (high - low) * f32::from(i) / f32::from(STEPS)).collect();
        let least = places.iter().map(|&d| self.sigma_px(d)).fold(f32::INFINITY, f32::min);
        // If a whole stretch is equally sharp, the focus is its middle.
        let sharpest: Vec<f32> =
            places.iter().copied().filter(|&d| self.sigma_px(d) <= least + SAME_PX).collect();
        let middle = sharpest.get(sharpest.len() / 2).copied().unwrap_or(low);
        let focus = if places.iter().all(|&d| self.sigma_px(d) < NONE_PX) {
            Focus::Everywhere
        } else if least > VISIBLE_PX {
            Focus::LeastBlurred { inverse_depth: middle, sigma_px: least }
        } else {
            Focus::At(middle)
        };
        let mut sharp: Vec<[f32; 2]> = vec![];
        let mut inside = false;
        for d in places {
            let is_sharp = self.sigma_px(d) <= VISIBLE_PX;
            match sharp.last_mut() {
                Some(range) if is_sharp && inside => range[1] = d,
                _ if is_sharp => sharp.push([d, d]),
                _ => {}
            }
            inside = is_sharp;
        }
        DefocusFacts {
            focus,
            outside: None,
            focus_interval: None,
            sigma_px_at_infinity: None,
            sigma_interval: None,
            sigma_below: None,
            sharp,
        }
    }
}

/// The inverse depths between which a thin lens blurs by at most [`VISIBLE_PX`], given its std at infinity (px) and its inverse depth
/// in focus.
pub fn thin_lens_sharp(sigma_px_at_infinity: f32, focus_inverse_depth: f32) -> [f32; 2] {
    let reach = VISIBLE_PX / sigma_px_at_infinity;
    if sigma_px_at_infinity > 0.0 {
        [focus_inverse_depth * (1.0 - reach).max(0.0), focus_inverse_depth * (1.0 + reach)]
    } else {
        [0.0, f32::INFINITY]
    }
}

impl DefocusFacts {
    /// The inverse depth that is in focus, if there is one.
    pub fn in_focus(&self) -> Option<f32> {
        match self.focus {
            Focus::At(d) => Some(d),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{DepthKind, ThinLensInterval};

    fn quadratic(a: f32, b: f32, c: f32) -> DefocusModel {
        let curve = DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [0.0, 1.0] };
        DefocusModel::given(curve, DepthKind::Metric)
    }

    #[test]
    fn blur_starts_to_show_where_the_curve_says() {
        let lens = |s| DefocusModel::given_lens(s, 0.25);
        let [far, near] = lens(2.0).facts().sharp[0];
        assert!((lens(2.0).sigma_px(far) - VISIBLE_PX).abs() < 1e-5);
        assert!((lens(2.0).sigma_px(near) - VISIBLE_PX).abs() < 1e-5);
        assert!(far < 0.25 && near > 0.25);
        assert_eq!(lens(0.3).facts().sharp[0][0], 0.0);
        let bowl = quadratic(4.0, -4.0, 1.2);
        let facts = bowl.facts();
        let [lo, hi] = facts.sharp[0];
        assert!((facts.in_focus().unwrap() - 0.5).abs() < 2e-3 && (lo + hi - 1.0).abs() < 4e-3);
        assert!((bowl.sigma_px(lo) - VISIBLE_PX).abs() < 0.01);
    }

    #[test]
    fn a_lens_that_blurs_nothing_has_no_focus_and_is_sharp_throughout() {
        for model in [DefocusModel::given_lens(0.0, 0.25), quadratic(0.0, 0.0, 0.0)] {
            let facts = model.facts();
            assert_eq!(facts.focus, Focus::Everywhere);
            assert_eq!((facts.in_focus(), facts.sharp.len(), facts.sharp[0][0]), (None, 1, 0.0));
        }
    }

    #[test]
    fn a_focus_outside_of_what_was_seen_and_blur_that_cannot_be_told_are_told_as_such() {
        let seen = |s: f32, low: f32, f: f32, seen| {
            let interval = Some(ThinLensInterval {
                sigma_px_at_infinity: [low, s + 0.4],
                focus_inverse_depth: [0.5 * f, 2.0 * f],
            });
            let curve = DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval };
            let model = DefocusModel::given(curve, DepthKind::Metric);
            DefocusModel { inverse_depth_seen: seen, ..model }.facts()
        };
        let near_and_far = Some([0.2, 0.8]);
        assert_eq!(seen(3.0, 2.0, 1.0, near_and_far).outside, Some(OutsideFocus::Nearer(0.8)));
        assert_eq!(seen(3.0, 2.0, 0.1, near_and_far).outside, Some(OutsideFocus::Beyond(0.2)));
        // Negative controls: within what was seen, or where that is not known, the focus is a number.
        assert_eq!(seen(3.0, 2.0, 0.5, near_and_far).outside, None);
        assert_eq!(seen(3.0, 2.0, 1.0, None).outside, None);
        assert_eq!(seen(3.0, 2.0, 0.5, near_and_far).sigma_below, None);
        // A sharp lens has a bound; one that is in focus at infinity has it there, and still blurs what is near.
        let sharp = seen(1e-6, 0.0, 0.5, near_and_far);
        assert_eq!((sharp.focus, sharp.outside), (Focus::Everywhere, None));
        assert!(sharp.sigma_below.is_some_and(|s| (s - 0.4).abs() < 1e-5), "{sharp:?}");
        let far = seen(1e-4, 0.0, 1e-5, near_and_far);
        assert!(far.sigma_below.is_some() && far.in_focus().is_some(), "{far:?}");
        assert_eq!(far.outside, Some(OutsideFocus::Beyond(0.2)));
    }

    #[test]
    fn a_curve_that_blurs_everywhere_has_a_depth_of_least_blur_and_none_in_focus() {
        let facts = quadratic(4.0, -4.0, 1.8).facts();
        let Focus::LeastBlurred { inverse_depth, sigma_px } = facts.focus else { panic!("{facts:?}") };
        assert!((inverse_depth - 0.5).abs() < 2e-3 && (sigma_px - 0.8).abs() < 1e-3, "{facts:?}");
        assert_eq!((facts.in_focus(), facts.sharp.len()), (None, 0));
    }

    #[test]
    fn a_curve_may_be_sharp_far_away_and_near_by() {
        let facts = quadratic(-8.0, 8.0, 0.0).facts();
        assert_eq!(facts.sharp.len(), 2);
        assert!(facts.sharp[0][0] == 0.0 && facts.sharp[1][1] == 1.0, "{facts:?}");
    }
}
