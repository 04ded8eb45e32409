use super::bokeh::Aperture;
use super::distortion::DistortionModel;
use super::{DepthKind, Method, Parameter, check, lerp, lerp_all, rise};
use crate::Result;
use serde::{Deserialize, Serialize};

/// The std of the Gaussian that is equivalent to the defocus blur, over inverse depth d.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum DefocusCurve {
    /// `sigma_px_at_infinity * |1 - d / focus_inverse_depth|`.
    ThinLens {
        /// The std of the blur at d = 0, px.
        sigma_px_at_infinity: f32,
        /// The inverse depth that is in focus, > 0.
        focus_inverse_depth: f32,
        /// The 95 % confidence intervals of both numbers.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        interval: Option<ThinLensInterval>,
    },
    /// `max(a d^2 + b d + c, 0)`, the paper's model, px; constant outside the range it was fitted on.
    Quadratic {
        /// The coefficient of d^2, px per squared inverse depth.
        a: f32,
        /// The coefficient of d, px per inverse depth.
        b: f32,
        /// The constant term, px.
        c: f32,
        /// The lowest and the highest inverse depth that the curve was fitted on.
        inverse_depth_range: [f32; 2],
    },
}

/// The 95 % confidence intervals of a thin lens, low and high.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThinLensInterval {
    /// The interval of the std at infinity, px.
    pub sigma_px_at_infinity: [f32; 2],
    /// The interval of the inverse depth in focus, in the model's own unit.
    pub focus_inverse_depth: [f32; 2],
}

/// Defocus blur over inverse depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DefocusModel {
    /// The curve.
    #[serde(flatten)]
    pub curve: DefocusCurve,
    /// The unit of the curve's inverse depth.
    pub depth_kind: DepthKind,
    /// The shape of out-of-focus points.
    #[serde(default, skip_serializing_if = "Aperture::is_default")]
    pub bokeh: Aperture,
    /// The method of the estimate.
    pub method: Method,
    /// The number of tiles (spectral) or places (removal) that the estimate rests on.
    pub samples: u64,
    /// The inverse depths, the farthest and the nearest, of what the estimate rests on; `None` if that is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inverse_depth_seen: Option<[f32; 2]>,
}

impl DefocusModel {
    /// A model of a curve that is known beforehand, whose points are Gaussians.
    pub fn given(curve: DefocusCurve, depth_kind: DepthKind) -> Self {
        let bokeh = Aperture::default();
        Self { curve, depth_kind, bokeh, method: Method::Given, samples: 0, inverse_depth_seen: None }
    }

    /// A thin lens over metric depth that is known beforehand.
    pub fn given_lens(sigma_px_at_infinity: f32, focus_inverse_depth: f32) -> Self {
        let curve = DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, interval: None };
        Self::given(curve, DepthKind::Metric)
    }

    /// The std of the equivalent Gaussian at inverse depth `d` (of [`DefocusModel::depth_kind`]), px of the capture's width.
    #[inline]
    pub fn sigma_px(&self, d: f32) -> f32 {
        match self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. } => {
                sigma_px_at_infinity * (1.0 - d / focus_inverse_depth).abs()
            }
            DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [lo, hi] } => {
                let d = d.clamp(lo, hi);
                ((a * d + b) * d + c).max(0.0)
            }
        }
    }

    /// Whether inverse depth `d` is nearer than the focus, where the images of points are upside down.
    pub fn is_before_focus(&self, d: f32) -> bool {
        match self.curve {
            DefocusCurve::ThinLens { focus_inverse_depth, .. } => d > focus_inverse_depth,
            // Blur grows with nearness in front of the focus only.
            DefocusCurve::Quadratic { a, b, inverse_depth_range: [lo, hi], .. } => {
                2.0 * a * d.clamp(lo, hi) + b > 0.0
            }
        }
    }

    /// The inverse depths behind and before the focus at which the std reaches `sigma_px`; infinite on a side where it never does.
    pub fn focus_range(&self, sigma_px: f32) -> [f32; 2] {
        let everything = [f32::NEG_INFINITY, f32::INFINITY];
        match self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, .. } => {
                if s > 0.0 {
                    [f * (1.0 - sigma_px / s), f * (1.0 + sigma_px / s)]
                } else {
                    everything
                }
            }
            DefocusCurve::Quadratic { inverse_depth_range: [lo, hi], .. } => {
                // Beyond the range the std is constant. Inside the range, bisection runs from the place of least std to either end.
                let least = |a: f32, b: f32| if self.sigma_px(b) < self.sigma_px(a) { b } else { a };
                let focus = (0..=64).map(|i| lo + (hi - lo) * i as f32 / 64.0).reduce(least).unwrap_or(lo);
                if self.sigma_px(focus) >= sigma_px {
                    return everything;
                }
                let towards = |end: f32| {
                    let (mut inside, mut outside) = (focus, end);
                    for _ in 0..32 {
                        let middle = 0.5 * (inside + outside);
                        if self.sigma_px(middle) < sigma_px { inside = middle } else { outside = middle }
                    }
                    (self.sigma_px(end) > sigma_px).then_some(outside)
                };
                [towards(lo).unwrap_or(everything[0]), towards(hi).unwrap_or(everything[1])]
            }
        }
    }

    /// The same lens over metric inverse depth, given that relative inverse depth is `scale / Z + offset`.
    ///
    /// A focus that the offset would move beyond infinity is placed at a very large distance instead.
    pub fn to_metric(mut self, scale: f32, offset: f32) -> Self {
        match &mut self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, interval } => {
                // k |f - (scale m + offset)| = k scale |(f - offset) / scale - m|
                let k = *sigma_px_at_infinity / *focus_inverse_depth;
                let metric = |f: f32| ((f - offset) / scale).max(1e-6);
                let focus = metric(*focus_inverse_depth);
                // Blur at infinity grows by the same factor throughout its interval, as long as the focus stays.
                let factor = scale * focus / *focus_inverse_depth;
                if let Some(i) = interval {
                    i.sigma_px_at_infinity = i.sigma_px_at_infinity.map(|s| s * factor);
                    i.focus_inverse_depth = i.focus_inverse_depth.map(metric);
                }
                *focus_inverse_depth = focus;
                *sigma_px_at_infinity = k * scale * focus;
            }
            DefocusCurve::Quadratic { a, b, c, inverse_depth_range } => {
                *c += *b * offset + *a * offset * offset;
                *b = scale * (*b + 2.0 * *a * offset);
                *a *= scale * scale;
                *inverse_depth_range = inverse_depth_range.map(|d| (d - offset) / scale);
            }
        }
        self.inverse_depth_seen = self.inverse_depth_seen.map(|seen| seen.map(|d| (d - offset) / scale));
        self.depth_kind = DepthKind::Metric;
        self
    }
}

impl DistortionModel for DefocusModel {
    fn scaled(mut self, s: f32) -> Self {
        match &mut self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity, interval, .. } => {
                *sigma_px_at_infinity *= s;
                if let Some(i) = interval {
                    i.sigma_px_at_infinity = i.sigma_px_at_infinity.map(|v| v * s);
                }
            }
            DefocusCurve::Quadratic { a, b, c, .. } => [a, b, c].into_iter().for_each(|v| *v *= s),
        }
        self
    }

    /// Lenses of different kinds or units cannot be interpolated: the result is then the model that is nearer in t.
    fn between(&self, other: &Self, t: f32) -> Self {
        let nearer = if t < 0.5 { *self } else { *other };
        match (self.curve, other.curve) {
            (
                DefocusCurve::ThinLens { sigma_px_at_infinity: sa, focus_inverse_depth: fa, interval: ia },
                DefocusCurve::ThinLens { sigma_px_at_infinity: sb, focus_inverse_depth: fb, interval: ib },
            ) if self.depth_kind == other.depth_kind => {
                let interval = ia.zip(ib).map(|(a, b)| ThinLensInterval {
                    sigma_px_at_infinity: lerp_all(a.sigma_px_at_infinity, b.sigma_px_at_infinity, t),
                    focus_inverse_depth: lerp_all(a.focus_inverse_depth, b.focus_inverse_depth, t),
                });
                let curve = DefocusCurve::ThinLens {
                    sigma_px_at_infinity: lerp(sa, sb, t),
                    focus_inverse_depth: lerp(fa, fb, t),
                    interval,
                };
                DefocusModel { curve, bokeh: self.bokeh.between(&other.bokeh, t), ..nearer }
            }
            _ => nearer,
        }
    }

    fn validate(&self) -> Result<()> {
        self.bokeh.validate()?;
        check(
            self.inverse_depth_seen
                .is_none_or(|[far, near]| far.is_finite() && near.is_finite() && far <= near),
            "defocus.inverse_depth_seen must be two rising numbers",
        )?;
        match self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval } => {
                check(s.is_finite() && s >= 0.0, "defocus.sigma_px_at_infinity must be a number >= 0")?;
                check(f.is_finite() && f > 0.0, "defocus.focus_inverse_depth must be a number > 0")?;
                check(
                    interval.is_none_or(|i| rise(i.sigma_px_at_infinity) && rise(i.focus_inverse_depth)),
                    "defocus.interval must hold two rising numbers each",
                )
            }
            DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [lo, hi] } => {
                check([a, b, c].iter().all(|v| v.is_finite()), "defocus.a, b and c must be finite numbers")?;
                check(
                    lo.is_finite() && hi.is_finite() && lo <= hi,
                    "defocus.inverse_depth_range must be two rising numbers",
                )
            }
        }
    }

    fn parameters(&self) -> Vec<Parameter> {
        let metric = self.depth_kind == DepthKind::Metric;
        let number =
            |name, unit, value, interval, meaning| Parameter { name, unit, value, interval, meaning };
        match self.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval: i } => vec![
                number(
                    "blur at infinity",
                    "px",
                    s,
                    i.map(|i| i.sigma_px_at_infinity),
                    "The std of the Gaussian that is equivalent to the blur at inverse depth 0.",
                ),
                number(
                    "focus",
                    if metric { "1/m" } else { "" },
                    f,
                    i.map(|i| i.focus_inverse_depth),
                    "The inverse depth that is in focus; larger is nearer.",
                ),
            ],
            DefocusCurve::Quadratic { a, b, c, .. } => {
                let meaning = "The std of the blur is the quadratic a d² + b d + c of the inverse depth d.";
                let units = if metric { ["px m²", "px m", "px"] } else { ["px"; 3] };
                let coefficients = ["a", "b", "c"].into_iter().zip(units).zip([a, b, c]);
                coefficients.map(|((name, unit), v)| number(name, unit, v, None, meaning)).collect()
            }
        }
    }

    fn basis(&self) -> (Method, u64) {
        (self.method, self.samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(curve: DefocusCurve) -> DefocusModel {
        DefocusModel::given(curve, DepthKind::Relative)
    }

    #[test]
    fn changing_units_leaves_the_blur_of_a_point_as_it_is() {
        let (scale, offset) = (0.4, 0.05);
        for curve in [
            DefocusCurve::ThinLens { sigma_px_at_infinity: 3.0, focus_inverse_depth: 0.3, interval: None },
            DefocusCurve::Quadratic { a: 9.0, b: -5.0, c: 2.0, inverse_depth_range: [0.06, 0.9] },
        ] {
            let (relative, metric) = (model(curve), model(curve).to_metric(scale, offset));
            for z in [0.5, 1.0, 2.0, 5.0] {
                let (want, got) = (relative.sigma_px(scale / z + offset), metric.sigma_px(1.0 / z));
                assert!((want - got).abs() < 1e-4, "{curve:?} at {z} m: {want} {got}");
            }
        }
    }

    #[test]
    fn the_quadratic_is_not_extrapolated_and_not_negative() {
        let m = model(DefocusCurve::Quadratic { a: 4.0, b: -4.0, c: 0.5, inverse_depth_range: [0.0, 1.0] });
        assert_eq!(m.sigma_px(5.0), m.sigma_px(1.0));
        assert_eq!(m.sigma_px(0.5), 0.0);
    }

    #[test]
    fn the_focus_ends_where_the_curve_says() {
        let quadratic = |a, b, c| DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [0.1, 0.9] };
        let lens =
            DefocusCurve::ThinLens { sigma_px_at_infinity: 4.0, focus_inverse_depth: 0.5, interval: None };
        for curve in
            [lens, quadratic(30.0, -30.0, 7.6), quadratic(0.0, 5.0, -1.0), quadratic(-10.0, 14.0, -2.5)]
        {
            let model = model(curve);
            let [behind, before] = model.focus_range(1.0);
            assert!(behind < before);
            let ends: Vec<f32> = [behind, before].into_iter().filter(|d| d.is_finite()).collect();
            assert!(!ends.is_empty());
            for end in ends {
                assert!((model.sigma_px(end) - 1.0).abs() < 1e-3, "{curve:?}: {end} {}", model.sigma_px(end));
            }
            let inside = behind.max(0.1).midpoint(before.min(0.9));
            assert!(model.sigma_px(inside) < 1.0, "{curve:?}: {inside}");
        }
        // These curves are blurred everywhere, sharp everywhere, or would reach 1 px only outside the range.
        for curve in [quadratic(0.0, 0.0, 2.0), quadratic(0.0, 0.0, 0.5), quadratic(0.0, 1.0, 0.05)] {
            assert_eq!(model(curve).focus_range(1.0), [f32::NEG_INFINITY, f32::INFINITY], "{curve:?}");
        }
    }
}
