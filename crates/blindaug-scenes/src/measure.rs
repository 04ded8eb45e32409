//! Comparison of estimates with the truth.

use blindaug::fit::Estimation;
use blindaug::model::{DefocusCurve, DefocusModel, DepthKind, Estimate, NOISE_LEVELS, NoiseModel};
use blindaug::{Encoded, Flow, Plane, Raster, pyramid};
use serde::{Deserialize, Serialize};

/// The evidence that is given beside the frames, and the method that estimates blur.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Given {
    /// Clean frames, depth and flow: the paper's OPTIMIZATION.
    Everything,
    /// Depth and flow.
    DepthAndFlow,
    /// Depth and flow; blur is estimated by its removal instead of from spectra.
    DepthAndFlowByRemoval,
    /// Depth and flow; networks remove the blur.
    DepthAndFlowByNetworks,
    /// Depth alone, as AR devices give it.
    Depth,
    /// Nothing: the paper's FULLPIPELINE.
    Nothing,
    /// Nothing; networks remove the blur, as in the paper's own FULLPIPELINE.
    NothingByNetworks,
}

impl Given {
    /// All cases, from the most evidence to the least.
    pub const ALL: [Self; 7] = [
        Self::Everything,
        Self::DepthAndFlow,
        Self::DepthAndFlowByRemoval,
        Self::DepthAndFlowByNetworks,
        Self::Depth,
        Self::Nothing,
        Self::NothingByNetworks,
    ];

    /// Whether networks remove the blur.
    pub fn by_networks(self) -> bool {
        matches!(self, Self::DepthAndFlowByNetworks | Self::NothingByNetworks)
    }

    /// The case in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Everything => "clean frames, depth, flow",
            Self::DepthAndFlow => "depth and flow",
            Self::DepthAndFlowByRemoval => "depth and flow, by removal",
            Self::DepthAndFlowByNetworks => "depth and flow, by networks",
            Self::Depth => "depth",
            Self::Nothing => "nothing",
            Self::NothingByNetworks => "nothing, by networks",
        }
    }
}

/// Frames, the evidence that can be given beside them, and the truth. All lists have one entry per frame.
pub struct Footage {
    /// The frames as filmed.
    pub frames: Vec<Encoded>,
    /// The frames, sharp and without noise.
    pub clean: Vec<Encoded>,
    /// Inverse depth of each frame, 1/m.
    pub inverse_depth: Vec<Plane>,
    /// Flow from each frame to the next one, px per frame interval.
    pub flow: Vec<Flow>,
    /// The true settings of the camera.
    pub truth: Truth,
    /// The true noise, if it is known.
    pub noise: Option<NoiseTruth>,
}

/// The true settings of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Exposure fraction.
    pub exposure: f32,
    /// Blur at infinity (std in px) and focus distance in m; `None`: a pinhole.
    pub lens: Option<(f32, f32)>,
}

impl Truth {
    /// The true blur at inverse depth `d` in 1/m, px.
    pub fn sigma_px(&self, d: f32) -> f32 {
        self.lens.map_or(0.0, |(sigma, focus)| sigma * (1.0 - focus * d).abs())
    }
}

/// The number of parts of the range of luminance.
const DECILES: usize = 10;

/// The noise's variance per level, channel and tenth of luminance.
#[derive(Clone, Debug, Default)]
pub struct NoiseTruth {
    /// The sums of squares and of weights, as `[level][channel][tenth of luminance]`.
    sums: [[[(f64, f64); DECILES]; 3]; NOISE_LEVELS],
}

impl NoiseTruth {
    /// Adds the noise of a frame, given the same frame without noise.
    pub fn add(&mut self, frame: &Encoded, without_noise: &Encoded) {
        let (w, h) = frame.0.size();
        self.add_where(frame, without_noise, &Plane::filled(w, h, 1.0));
    }

    /// Adds the noise of a frame only where `known` is 1; elsewhere `known` must be 0.
    pub fn add_where(&mut self, frame: &Encoded, without_noise: &Encoded, known: &Plane) {
        let (w, h) = frame.0.size();
        let noise = Raster::from_fn(w, h, |x, y| {
            let (a, b) = (frame.0.at(x, y), without_noise.0.at(x, y));
            std::array::from_fn::<f32, 3, _>(|c| known.at(x, y) * (a[c] - b[c]))
        });
        let (bands, _) = pyramid::laplacian(&noise, NOISE_LEVELS);
        let mut luma = without_noise.luma();
        // Where values clip, noise is cut off, but the model describes noise that is not cut off.
        let whole = |p: [f32; 3]| if p.iter().all(|v| (0.08..0.92).contains(v)) { 1.0 } else { 0.0 };
        let mut weight = Plane::from_fn(w, h, |x, y| known.at(x, y) * whole(without_noise.0.at(x, y)));
        for (level, band) in bands.iter().enumerate() {
            if level > 0 {
                (luma, weight) = (pyramid::downsample(&luma), pyramid::downsample(&weight));
            }
            for ((v, &y), &w) in band.data().iter().zip(luma.data()).zip(weight.data()) {
                if w < 0.99 {
                    continue;
                }
                let decile = ((y * DECILES as f32) as usize).min(DECILES - 1);
                for (sums, v) in self.sums[level].iter_mut().zip(v) {
                    sums[decile].0 += f64::from(v * v);
                    sums[decile].1 += 1.0;
                }
            }
        }
    }

    /// The truth of noise whose std is a known function of level and luminance.
    pub fn known(std: impl Fn(usize, f32) -> f32) -> Self {
        let of = |level: usize, decile: usize| {
            let y = (decile as f32 + 0.5) / DECILES as f32;
            (f64::from(std(level, y)).powi(2) * 1e6, 1e6)
        };
        Self { sums: std::array::from_fn(|l| [0; 3].map(|_| std::array::from_fn(|d| of(l, d)))) }
    }

    /// The points (level, channel, luminance, std) that have enough samples.
    pub fn points(&self) -> impl Iterator<Item = (usize, usize, f32, f32)> + '_ {
        const ENOUGH: f64 = 150.0;
        self.sums.iter().enumerate().flat_map(|(level, channels)| {
            channels.iter().enumerate().flat_map(move |(c, deciles)| {
                // The first and the last tenth are left out, since clipping cuts them off.
                deciles.iter().enumerate().take(9).skip(1).filter(|(_, s)| s.1 >= ENOUGH).map(
                    move |(d, s)| (level, c, (d as f32 + 0.5) / DECILES as f32, (s.0 / s.1).sqrt() as f32),
                )
            })
        })
    }
}

/// A number with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// The estimate.
    pub estimate: f32,
    /// The 95 % interval of the estimate.
    pub interval: [f32; 2],
}

impl Value {
    /// Whether the interval holds the true value.
    pub fn covers(&self, truth: f32) -> bool {
        (self.interval[0] - 1e-4..=self.interval[1] + 1e-4).contains(&truth)
    }
}

/// The estimate of the lens beside the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Blur at infinity, px.
    pub sigma_px_at_infinity: Value,
    /// Inverse depth in focus, in the depth's own unit.
    pub focus_inverse_depth: Value,
    /// Whether depth is metric.
    pub metric: bool,
    /// Mean over the scene's pixels of |estimated - true| blur, px.
    pub error_px: f32,
    /// Mean over the scene's pixels of the true blur, px.
    pub mean_px: f32,
    /// True inverse depth (1/m), true and estimated blur (px): means over twentieths of the pixels, from far to near.
    pub curve: Vec<[f32; 3]>,
}

/// The results of one estimate beside the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The evidence that was given.
    pub given: Given,
    /// Exposure fraction.
    pub exposure: Option<Value>,
    /// The exposure fraction of each frame alone.
    pub exposure_per_frame: Vec<f32>,
    /// The lens.
    pub lens: Option<Lens>,
    /// The error |estimated / true - 1| of the noise std: for each level, the median over channels and luminances.
    pub noise: Vec<f32>,
    /// The median of the error of the noise std over all levels, channels and luminances.
    pub noise_median: Option<f32>,
    /// The reasons why parts of the model are unknown.
    pub unknown: Vec<String>,
    /// The duration of the estimate, s.
    pub seconds: f32,
}

/// Compares an estimate of the footage's camera, which took `seconds`, with the truth.
pub fn measure(footage: &Footage, given: Given, estimation: &Estimation, seconds: f32) -> Measured {
    let model = &estimation.model;
    let noise = match (&model.noise, &footage.noise) {
        (Estimate::Known(m), Some(truth)) => noise_errors(m, truth),
        _ => vec![],
    };
    let of_level = |level: usize| median(noise.iter().filter(|e| e.0 == level).map(|e| e.1).collect());
    let why = [
        ("noise", model.noise.why_unknown()),
        ("exposure", model.motion_blur.why_unknown()),
        ("lens", model.defocus.why_unknown()),
    ];
    Measured {
        given,
        exposure: model.motion_blur.known().map(|m| Value { estimate: m.exposure.0, interval: m.interval }),
        exposure_per_frame: estimation.diagnostics.exposure_per_frame.iter().map(|f| f.1).collect(),
        lens: model.defocus.known().and_then(|m| lens(m, estimation, footage)),
        noise: (0..NOISE_LEVELS).map_while(of_level).collect(),
        noise_median: median(noise.iter().map(|e| e.1).collect()),
        unknown: why.iter().filter_map(|(what, why)| Some(format!("{what}: {}", (*why)?))).collect(),
        seconds,
    }
}

fn lens(model: &DefocusModel, estimation: &Estimation, footage: &Footage) -> Option<Lens> {
    const PARTS: usize = 20;
    let DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, interval } = model.curve else {
        return None;
    };
    let interval = interval?;
    // A relative curve is evaluated at the estimate's own depth and compared with the true depth of the same frame.
    let (frame, own) = match (&estimation.diagnostics.inverse_depth, model.depth_kind) {
        (Some((frame, own)), DepthKind::Relative) => (*frame, own),
        _ => (footage.frames.len() / 2, &footage.inverse_depth[footage.frames.len() / 2]),
    };
    let truth = &footage.inverse_depth[frame];
    let mut places: Vec<[f32; 3]> = truth
        .data()
        .iter()
        .zip(own.data())
        .filter(|(d, own)| d.is_finite() && own.is_finite())
        .map(|(&d, &own)| [d, footage.truth.sigma_px(d), model.sigma_px(own)])
        .collect();
    if places.is_empty() {
        return None;
    }
    places.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mean = |of: &[[f32; 3]], f: &dyn Fn(&[f32; 3]) -> f32| {
        of.iter().map(|p| f64::from(f(p))).sum::<f64>() as f32 / of.len() as f32
    };
    let curve = places
        .chunks(places.len().div_ceil(PARTS))
        .map(|part| [0, 1, 2].map(|k| mean(part, &|p| p[k])))
        .collect();
    Some(Lens {
        sigma_px_at_infinity: Value {
            estimate: sigma_px_at_infinity,
            interval: interval.sigma_px_at_infinity,
        },
        focus_inverse_depth: Value { estimate: focus_inverse_depth, interval: interval.focus_inverse_depth },
        metric: model.depth_kind == DepthKind::Metric,
        error_px: mean(&places, &|p| (p[1] - p[2]).abs()),
        mean_px: mean(&places, &|p| p[1]),
        curve,
    })
}

/// The errors (level, |estimated / true - 1|) of each level, channel and luminance.
pub fn noise_errors(model: &NoiseModel, truth: &NoiseTruth) -> Vec<(usize, f32)> {
    truth
        .points()
        .map(|(level, c, y, std)| (level, (model.std(level, y)[c] / std.max(1e-6) - 1.0).abs()))
        .collect()
}

/// The median; `None` if there are no values.
pub fn median(mut v: Vec<f32>) -> Option<f32> {
    v.sort_by(f32::total_cmp);
    v.get(v.len() / 2).copied()
}
