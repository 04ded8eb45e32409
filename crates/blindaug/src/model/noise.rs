use super::distortion::DistortionModel;
use super::noise_curves::NoiseCurves;
use super::{Estimate, Method, Parameter, check, lerp, lerp_all, rise};
use crate::portable::Portable;
use crate::{Result, Transfer, luma};
use serde::{Deserialize, Serialize};

/// The number of levels of the Laplacian pyramid in which noise is modelled, finest first. The remaining low-pass has no noise.
pub const NOISE_LEVELS: usize = 4;

/// The luminances of grey over which noises are held against each other, or against their intervals.
pub const GREYS: [f32; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];

/// The noise std in one pyramid level: `slope * Y + intercept` per channel (RGB), never negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseLevel {
    /// The change of the std per unit of luminance Y, in R, G and B.
    pub slope: [f32; 3],
    /// The std at Y = 0, in R, G and B, as encoded values in [0, 1].
    pub intercept: [f32; 3],
}

impl NoiseLevel {
    /// The std in each channel at luminance `y` (Rec. 601 Y of encoded values), >= 0.
    #[inline]
    pub fn sigma(&self, y: f32) -> [f32; 3] {
        std::array::from_fn(|c| (self.slope[c] * y + self.intercept[c]).max(0.0))
    }
}

/// The 95 % confidence intervals, low and high, of a level's numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseInterval {
    /// The intervals of the slopes in R, G and B.
    pub slope: [[f32; 2]; 3],
    /// The intervals of the intercepts in R, G and B.
    pub intercept: [[f32; 2]; 3],
}

/// The noise of encoded frames. All code but the fit, the synthesis and the file of noise uses only the methods of this type, so that
/// another kind of noise needs a variant here and changes in those three places.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "NoiseFile", into = "NoiseFile")]
#[allow(
    clippy::large_enum_variant,
    reason = "there are few models, and the lines are the usual ones of exports and tests"
)]
pub enum NoiseModel {
    /// The paper's model: in each pyramid level and channel the std is a straight line over luminance.
    Lines(NoiseLines),
    /// The variance is a sum of curves over the picture's colour, and channels and successive frames are correlated.
    Curves(Box<NoiseCurves>),
}

/// The kind of noise model that an estimate gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoiseKind {
    /// [`NoiseModel::Curves`] where the footage tells them.
    #[default]
    Curves,
    /// [`NoiseModel::Lines`], the paper's 24 numbers.
    Lines,
}

impl NoiseKind {
    /// Reduces a noise to this kind.
    pub fn reduce(self, noise: &mut Estimate<NoiseModel>) {
        if let (Self::Lines, Estimate::Known(known)) = (self, noise) {
            *known = NoiseModel::Lines(known.lines().clone());
        }
    }
}

/// The noise as camera.json holds it: always the straight lines, and the curves beside them where they are known.
#[derive(Clone, Serialize, Deserialize)]
struct NoiseFile {
    #[serde(flatten)]
    lines: NoiseLines,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    curves: Option<Box<NoiseCurves>>,
}

/// Noise whose std is a straight line over luminance, per pyramid level and channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseLines {
    /// The levels, finest first.
    pub levels: [NoiseLevel; NOISE_LEVELS],
    /// The 95 % intervals of the levels' numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval: Option<[NoiseInterval; NOISE_LEVELS]>,
    /// The encoded value at and above which the sensor clips, so that there is no noise; above 1, the end of footage that goes beyond white.
    pub clip: f32,
    /// The method of the estimate.
    pub method: Method,
    /// The number of local stds that the estimate rests on.
    pub samples: u64,
}

/// The covariance between the levels of noise that has std 1 in each level, at full resolution: the bands of a Laplacian pyramid
/// overlap, so their variances do not just add. Measured on 512 x 512 px of white noise; a test in `synth::noise` measures it again.
pub(crate) const BAND_COVARIANCE: [[f32; NOISE_LEVELS]; NOISE_LEVELS] = [
    [0.99978894, 0.15481946, 0.02422532, 0.0031789874],
    [0.15481946, 0.3967273, 0.1953662, 0.042550743],
    [0.02422532, 0.1953662, 0.36394912, 0.2017897],
    [0.0031789874, 0.042550743, 0.2017897, 0.3631104],
];

impl From<NoiseLines> for NoiseModel {
    fn from(lines: NoiseLines) -> Self {
        Self::Lines(lines)
    }
}

impl From<NoiseModel> for NoiseFile {
    fn from(model: NoiseModel) -> Self {
        match model {
            NoiseModel::Lines(lines) => Self { lines, curves: None },
            NoiseModel::Curves(curves) => Self { lines: curves.lines.clone(), curves: Some(curves) },
        }
    }
}

impl From<NoiseFile> for NoiseModel {
    fn from(NoiseFile { lines, curves }: NoiseFile) -> Self {
        match curves {
            Some(curves) => Self::Curves(Box::new(NoiseCurves { lines, ..*curves })),
            None => Self::Lines(lines),
        }
    }
}

impl NoiseModel {
    /// A model of straight lines that are known beforehand.
    pub fn given(levels: [NoiseLevel; NOISE_LEVELS], clip: f32) -> Self {
        Self::Lines(NoiseLines { levels, interval: None, clip, method: Method::Given, samples: 0 })
    }

    /// The weighted mean of those of some models that are of this one's kind, by their method and by whether they have curves; `None` if none is
    /// that has weight. Weights are not negative. The number of samples is this one's.
    pub fn mean_of_kind<'a>(&self, models: impl Iterator<Item = (f32, &'a Self)>) -> Option<Self> {
        let kind = |model: &Self| (model.method(), model.curves().is_some());
        let (mut mean, mut sum): (Option<Self>, f32) = (None, 0.0);
        for (weight, model) in models.filter(|(weight, model)| *weight > 0.0 && kind(model) == kind(self)) {
            sum += weight;
            mean = Some(mean.map_or_else(|| model.clone(), |mean| mean.between(model, weight / sum)));
        }
        let mut mean = mean?;
        mean.lines_mut().samples = self.samples();
        Some(mean)
    }

    /// The noise as the paper's straight lines, or the straight lines that are nearest to the noise.
    pub fn lines(&self) -> &NoiseLines {
        match self {
            Self::Lines(lines) => lines,
            Self::Curves(curves) => &curves.lines,
        }
    }

    /// The nearest lines of the same noise over values of another encoding: each std is multiplied by the ratio of the curves' slopes.
    pub fn recoded(&self, from: Transfer, to: Transfer) -> NoiseLines {
        /// The luminances, in the other encoding, that the lines are fitted to; close to black slopes are huge.
        const PLACES: [f32; 7] = [0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9];
        let lines = self.lines();
        let level = |l: &NoiseLevel| {
            let points = PLACES.map(|y| {
                let light = to.decode(y);
                (y, l.sigma(from.encode(light)).map(|std| std * to.slope(light) / from.slope(light)))
            });
            let lines = [0, 1, 2].map(|c| line_through(&points.map(|(y, std)| (y, std[c]))));
            NoiseLevel { slope: lines.map(|l| l.0), intercept: lines.map(|l| l.1) }
        };
        NoiseLines { levels: lines.levels.each_ref().map(level), interval: None, clip: 1.0, ..lines.clone() }
    }

    /// The same noise, with lines that do not contradict its curves: those of a channel whose curves lie outside the lines' 95 % interval over
    /// some grey are laid through the curves' std over grey, and the interval holds both.
    pub fn with_agreeing_lines(mut self) -> Self {
        let Self::Curves(curves) = &self else { return self };
        let contradicted: [bool; 3] = std::array::from_fn(|c| {
            GREYS.into_iter().any(|y| {
                let [low, high] = self.interval_of_total_std(y).map(|end| end[c]);
                !(low..=high).contains(&self.total_std_over([y; 3])[c])
            })
        });
        let levels = curves.levels;
        let lines = self.lines_mut();
        for (l, level) in levels.iter().enumerate() {
            for c in (0..3).filter(|&c| contradicted[c]) {
                let own = (lines.levels[l].slope[c], lines.levels[l].intercept[c]);
                let (slope, intercept) = line_through(&GREYS.map(|y| (y, level.std([y; 3])[c])));
                (lines.levels[l].slope[c], lines.levels[l].intercept[c]) = (slope, intercept);
                let Some(interval) = &mut lines.interval else { continue };
                let both = |[low, high]: [f32; 2], moved: f32| [low + moved.min(0.0), high + moved.max(0.0)];
                interval[l].slope[c] = both(interval[l].slope[c], slope - own.0);
                interval[l].intercept[c] = both(interval[l].intercept[c], intercept - own.1);
            }
        }
        self
    }

    /// [`NoiseModel::lines`], to be changed.
    pub fn lines_mut(&mut self) -> &mut NoiseLines {
        match self {
            Self::Lines(lines) => lines,
            Self::Curves(curves) => &mut curves.lines,
        }
    }

    /// The curves, if this is their model.
    pub fn curves(&self) -> Option<&NoiseCurves> {
        match self {
            Self::Lines(_) => None,
            Self::Curves(curves) => Some(curves),
        }
    }

    /// The std of R, G and B in a pyramid level (0: the finest) at luminance `y` (Rec. 601 Y of encoded values) by the straight lines, >= 0.
    #[inline]
    pub fn std(&self, level: usize, y: f32) -> [f32; 3] {
        self.lines().levels[level].sigma(y)
    }

    /// The std of R, G and B in a pyramid level (0: the finest) over content of this encoded colour, >= 0.
    #[inline]
    pub fn std_over(&self, level: usize, colour: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Lines(lines) => lines.levels[level].sigma(luma(colour)),
            Self::Curves(curves) => curves.levels[level].std(colour),
        }
    }

    /// The correlation of the noise of a frame with that of the frame before it, 0 to less than 1.
    pub fn temporal_correlation(&self) -> f32 {
        self.curves().map_or(0.0, |c| c.temporal_correlation)
    }

    /// The 95 % interval of [`NoiseModel::std`] in one channel, low and high; the std itself if there is no interval. The errors of slope and
    /// intercept are taken as independent, which makes the interval too wide, since they are in fact negatively correlated.
    pub fn interval_of_std(&self, level: usize, channel: usize, y: f32) -> [f32; 2] {
        let std = self.std(level, y)[channel];
        let lines = self.lines();
        let Some(interval) = &lines.interval else { return [std; 2] };
        // The ends may lie at different distances, as a coder hides noise and adds none.
        let distance = |end: usize| {
            let of = |value: [f32; 3], ends: [[f32; 2]; 3]| (ends[channel][end] - value[channel]).abs();
            let (line, ends) = (&lines.levels[level], &interval[level]);
            let distance = of(line.intercept, ends.intercept).portable_hypot(y * of(line.slope, ends.slope));
            if distance.is_finite() { distance } else { 0.0 }
        };
        [(std - distance(0)).max(0.0), std + distance(1)]
    }

    /// The std of R, G and B over a flat area of this luminance, all levels together.
    pub fn total_std(&self, y: f32) -> [f32; 3] {
        let std: [[f32; 3]; NOISE_LEVELS] = std::array::from_fn(|level| self.std(level, y));
        total_of_levels(&std)
    }

    /// The std of R, G and B over a flat area of this encoded colour, all levels together.
    pub fn total_std_over(&self, colour: [f32; 3]) -> [f32; 3] {
        total_of_levels(&std::array::from_fn(|level| self.std_over(level, colour)))
    }

    /// The 95 % interval of [`NoiseModel::total_std`], the low ends and the high ends in R, G and B: the ends of all levels together.
    pub fn interval_of_total_std(&self, y: f32) -> [[f32; 3]; 2] {
        let ends: [[[f32; 2]; 3]; NOISE_LEVELS] =
            std::array::from_fn(|level| std::array::from_fn(|c| self.interval_of_std(level, c, y)));
        [0, 1].map(|end| total_of_levels(&ends.map(|level| level.map(|interval| interval[end]))))
    }

    /// What people are told of the noise over grey of this luminance: the low ends, the values and the high ends of the std of R, G and B, all
    /// levels together. The straight lines tell it, which scatter least where there are few blocks, unless the curves lie outside the lines'
    /// interval, as over log values, of which noise is no straight line. Then the curves tell it, and the interval holds both.
    pub fn told_std(&self, y: f32) -> [[f32; 3]; 3] {
        let (lines, curves) = (self.total_std(y), self.total_std_over([y; 3]));
        let [low, high] = self.interval_of_total_std(y);
        let told: [[f32; 3]; 3] = std::array::from_fn(|c| {
            let (line, curve) = (lines[c], curves[c]);
            match (low[c]..=high[c]).contains(&curve) {
                true => [low[c], line, high[c]],
                false => {
                    let moved = curve - line;
                    [low[c].min(low[c] + moved).max(0.0), curve, high[c].max(high[c] + moved)]
                }
            }
        });
        [0, 1, 2].map(|i| told.map(|of_channel| of_channel[i]))
    }

    /// Widens the 95 % intervals for an error that is independent of theirs, and the logarithm of whose factor on the std has the std `spread`.
    pub fn allow_for(&mut self, spread: f32) {
        if spread <= 0.0 {
            return;
        }
        let distance = |model: &Self, end: usize| {
            let std = |y: f32| luma(model.total_std(y));
            let at =
                |y: f32| (luma(model.interval_of_total_std(y)[end]) / std(y)).max(1e-6).portable_ln().abs();
            // Where an end lies nearest to the std: of luminances that do not occur in the footage, lines tell next to nothing. Where a line falls
            // to 0, its interval has no scale.
            GREYS.into_iter().filter(|&y| std(y) > 1e-4).map(at).fold(f32::INFINITY, f32::min)
        };
        // What an end must be multiplied by follows from the lines and intervals of all levels: bisection finds it.
        let factor = |end: usize, outermost: f32| {
            let wanted = distance(self, end).portable_hypot(1.96 * spread);
            let (mut inner, mut outer) = (1.0, outermost);
            for _ in 0..16 {
                let middle = 0.5 * (inner + outer);
                let mut widened = self.clone();
                widened.widen(if end == 0 { middle } else { 1.0 }, if end == 1 { middle } else { 1.0 });
                *(if distance(&widened, end) < wanted { &mut inner } else { &mut outer }) = middle;
            }
            outer
        };
        let (lower, upper) = (factor(0, 0.0), factor(1, 100.0));
        self.widen(lower, upper);
    }

    /// Multiplies the std, with its intervals, by a factor, >= 0.
    pub fn multiply(&mut self, factor: f32) {
        if let Self::Curves(curves) = self {
            let variances =
                curves.levels.iter_mut().flat_map(|l| l.variance.as_flattened_mut().as_flattened_mut());
            variances.for_each(|v| *v *= factor * factor);
        }
        let lines = self.lines_mut();
        lines.levels = lines.levels.map(|l| NoiseLevel {
            slope: l.slope.map(|v| factor * v),
            intercept: l.intercept.map(|v| factor * v),
        });
        for level in lines.interval.iter_mut().flatten() {
            level.slope = level.slope.map(|i| i.map(|v| factor * v));
            level.intercept = level.intercept.map(|i| i.map(|v| factor * v));
        }
    }

    /// Multiplies the lower ends of the std's intervals by a factor in [0, 1], and the upper ends by one that is at least 1; no end comes nearer.
    pub(crate) fn widen(&mut self, lower: f32, upper: f32) {
        for level in self.lines_mut().interval.iter_mut().flatten() {
            let widened = |[low, high]: [f32; 2]| [low.min(lower * low), high.max(upper * high)];
            level.slope = level.slope.map(widened);
            level.intercept = level.intercept.map(widened);
        }
    }

    /// Widens the std's intervals so that they hold the std and `reach` times it.
    pub(crate) fn widen_to(&mut self, reach: f32) {
        let lines = self.lines_mut();
        for (level, interval) in lines.levels.iter().zip(lines.interval.iter_mut().flatten()) {
            let widened = |value: f32, [low, high]: [f32; 2]| [low.min(value), high.max(reach * value)];
            interval.slope = std::array::from_fn(|c| widened(level.slope[c], interval.slope[c]));
            interval.intercept = std::array::from_fn(|c| widened(level.intercept[c], interval.intercept[c]));
        }
    }

    /// The same noise with this correlation between successive frames, in [0, 1), if it is one by curves: lines have none.
    pub(crate) fn with_temporal_correlation(mut self, correlation: f32) -> Self {
        if let Self::Curves(curves) = &mut self {
            curves.temporal_correlation = correlation;
        }
        self
    }

    /// The encoded value at and above which the sensor clips, so that there is no noise; above 1, the end of footage that goes beyond white.
    pub fn clip(&self) -> f32 {
        self.lines().clip
    }

    /// The method of the estimate.
    pub fn method(&self) -> Method {
        self.lines().method
    }

    /// The number of local stds that the estimate rests on.
    pub fn samples(&self) -> u64 {
        self.lines().samples
    }
}

impl DistortionModel for NoiseModel {
    /// The noise of a pixel does not depend on the frame's size.
    fn scaled(self, _: f32) -> Self {
        self
    }

    fn between(&self, other: &Self, t: f32) -> Self {
        let lines = self.lines().between(other.lines(), t);
        match (self, other) {
            (Self::Curves(a), Self::Curves(b)) => Self::Curves(Box::new(a.between(b, t, lines))),
            // Between curves and straight lines there is no mixture: the nearer one counts.
            (Self::Curves(curves), _) if t < 0.5 => Self::Curves(curves.clone()),
            (_, Self::Curves(curves)) if t >= 0.5 => Self::Curves(curves.clone()),
            _ => Self::Lines(lines),
        }
    }

    fn validate(&self) -> Result<()> {
        self.lines().validate()?;
        self.curves().map_or(Ok(()), NoiseCurves::validate)
    }

    fn parameters(&self) -> Vec<Parameter> {
        let channel = |(name, std)| Parameter {
            name,
            unit: "1/255",
            value: 255.0 * std,
            interval: None,
            meaning: "The std of the grain of all sizes in encoded values, over an even grey of luminance 0.5.",
        };
        let mut all: Vec<Parameter> = ["std in R", "std in G", "std in B"]
            .into_iter()
            .zip(self.told_std(0.5)[1])
            .map(channel)
            .collect();
        if let Some(curves) = self.curves() {
            let correlation =
                |name, value, meaning| Parameter { name, unit: "", value, interval: None, meaning };
            all.push(correlation(
                "correlation of channels",
                curves.levels[0].correlation().iter().sum::<f32>() / 3.0,
                "How alike the finest grain is in red, green and blue, their mean: at 0 grain is coloured, at 1 it is grey.",
            ));
            all.push(correlation(
                "correlation of frames",
                curves.temporal_correlation,
                "How much of a frame's grain is that of the frame before it, in place: at 0 grain boils.",
            ));
        }
        all
    }

    fn basis(&self) -> (Method, u64) {
        (self.method(), self.samples())
    }
}

/// The slope and the intercept, >= 0, of the line that is nearest to these stds at these luminances.
fn line_through(points: &[(f32, f32)]) -> (f32, f32) {
    let n = points.len() as f32;
    let [mean_y, mean] =
        [points.iter().map(|p| p.0).sum::<f32>() / n, points.iter().map(|p| p.1).sum::<f32>() / n];
    let spread: f32 = points.iter().map(|(y, _)| (y - mean_y).powi(2)).sum();
    let slope = points.iter().map(|(y, std)| (y - mean_y) * (std - mean)).sum::<f32>() / spread;
    match mean - slope * mean_y {
        intercept if intercept >= 0.0 => (slope, intercept),
        // A std is never negative: the line then goes through 0.
        _ => {
            let squares = spread + n * mean_y * mean_y;
            (points.iter().map(|(y, std)| y * std).sum::<f32>() / squares, 0.0)
        }
    }
}

/// The std of R, G and B of noise over a flat area, given the std of each level.
pub fn total_of_levels(std: &[[f32; 3]; NOISE_LEVELS]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let pairs = (0..NOISE_LEVELS).flat_map(|i| (0..NOISE_LEVELS).map(move |j| (i, j)));
        pairs.map(|(i, j)| std[i][c] * std[j][c] * BAND_COVARIANCE[i][j]).sum::<f32>().max(0.0).sqrt()
    })
}

impl NoiseLines {
    fn between(&self, other: &Self, t: f32) -> Self {
        let intervals =
            |a: &[[f32; 2]; 3], b: &[[f32; 2]; 3]| std::array::from_fn(|c| lerp_all(a[c], b[c], t));
        Self {
            levels: std::array::from_fn(|l| NoiseLevel {
                slope: lerp_all(self.levels[l].slope, other.levels[l].slope, t),
                intercept: lerp_all(self.levels[l].intercept, other.levels[l].intercept, t),
            }),
            interval: self.interval.zip(other.interval).map(|(a, b)| {
                std::array::from_fn(|l| NoiseInterval {
                    slope: intervals(&a[l].slope, &b[l].slope),
                    intercept: intervals(&a[l].intercept, &b[l].intercept),
                })
            }),
            clip: lerp(self.clip, other.clip, t),
            ..if t < 0.5 { self.clone() } else { other.clone() }
        }
    }

    fn validate(&self) -> Result<()> {
        let finite = self.levels.iter().all(|l| l.slope.iter().chain(&l.intercept).all(|v| v.is_finite()));
        check(finite, "noise.levels must be finite numbers")?;
        check(
            self.levels.iter().all(|l| l.intercept.iter().all(|&v| v >= 0.0)),
            "noise.levels' intercept must not be negative",
        )?;
        let rises = |level: &NoiseInterval| {
            level.slope.iter().chain(&level.intercept).all(|&interval| rise(interval))
        };
        check(
            self.interval.iter().flatten().all(rises),
            "noise.interval must hold two rising numbers for each slope and intercept",
        )?;
        check(self.clip.is_finite() && self.clip > 0.0, "noise.clip must be a positive number")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_lines_contradict_the_curves_the_curves_are_told() {
        use crate::model::CurveLevel;
        let line = NoiseLevel { slope: [0.0; 3], intercept: [0.01; 3] };
        let interval = NoiseInterval { slope: [[0.0; 2]; 3], intercept: [[0.009, 0.011]; 3] };
        let NoiseModel::Lines(mut lines) = NoiseModel::given([line; NOISE_LEVELS], 1.0) else {
            unreachable!()
        };
        lines.interval = Some([interval; NOISE_LEVELS]);
        let of_curves = |std: f32| {
            let own = |c: usize| std::array::from_fn(|k| [if k == c { std * std } else { 0.0 }; 8]);
            let mixing = std::array::from_fn(|c| std::array::from_fn(|k| if k == c { 1.0 } else { 0.0 }));
            let levels = [CurveLevel { variance: std::array::from_fn(own), mixing }; NOISE_LEVELS];
            NoiseModel::Curves(Box::new(NoiseCurves {
                lines: lines.clone(),
                levels,
                temporal_correlation: 0.0,
            }))
        };
        let close = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-3;
        let near = of_curves(0.0105);
        let [low, told, high] = near.told_std(0.5).map(|of| of[1]);
        assert_eq!(
            (told, [low, high]),
            (near.total_std(0.5)[1], near.interval_of_total_std(0.5).map(|e| e[1]))
        );
        let far = of_curves(0.02);
        let [low, told, high] = far.told_std(0.5).map(|of| of[1]);
        let line = far.total_std(0.5)[1];
        assert!(
            close(told, 2.0 * line) && close(low, 0.9 * line) && close(high, 2.1 * line),
            "{low} {told} {high}"
        );
    }

    #[test]
    fn intervals_are_widened_for_an_independent_error() {
        // Noise that grows or falls with luminance, and noise that does not depend on it.
        for slope in [0.004, -0.006, 0.0, -0.013] {
            let level = NoiseLevel { slope: [slope; 3], intercept: [0.01; 3] };
            let mut model = NoiseModel::given([level; NOISE_LEVELS], 1.0);
            let interval =
                NoiseInterval { slope: [[slope - 0.001, slope + 0.001]; 3], intercept: [[0.008, 0.013]; 3] };
            model.lines_mut().interval = Some([interval; NOISE_LEVELS]);
            let ends = |model: &NoiseModel, y: f32| {
                model.interval_of_total_std(y).map(|end| (end[1] / model.total_std(y)[1]).ln().abs())
            };
            for spread in [0.1, 0.45] {
                let mut wide = model.clone();
                wide.allow_for(spread);
                for end in [0, 1] {
                    // It is as wide as it should be where it was narrowest, and elsewhere not much narrower.
                    let has_scale = |y: &f32| {
                        model.total_std(*y)[1] > 0.0 && model.interval_of_total_std(*y)[end][1] > 0.0
                    };
                    let seen = GREYS.into_iter().filter(has_scale);
                    let over: Vec<f32> = seen
                        .map(|y| ends(&wide, y)[end] / ends(&model, y)[end].hypot(1.96 * spread))
                        .collect();
                    assert!(over.iter().all(|&o| o > 0.8), "{slope} {spread} {end}: {over:?}");
                    assert!(over.iter().any(|o| (o - 1.0).abs() < 0.02), "{slope} {spread} {end}: {over:?}");
                }
                assert!(wide.total_std(0.5) == model.total_std(0.5) && wide.validate().is_ok());
            }
            // Without an error it stays as it is.
            let mut same = model.clone();
            same.allow_for(0.0);
            assert_eq!(same, model);
        }
    }

    #[test]
    fn noise_over_log_values_becomes_that_over_srgb() {
        let level = NoiseLevel { slope: [0.004, 0.002, 0.0], intercept: [0.01, 0.012, 0.011] };
        let lines = NoiseLines {
            levels: [level; NOISE_LEVELS],
            interval: None,
            clip: 0.95,
            method: Method::Given,
            samples: 0,
        };
        let model = NoiseModel::Lines(lines);
        let (log, srgb) = (Transfer::SLog3, Transfer::Srgb);
        let recoded = model.recoded(log, srgb);
        for y in [0.3, 0.5, 0.7] {
            let light = srgb.decode(y);
            for c in 0..3 {
                let want = model.std(1, log.encode(light))[c] * srgb.slope(light) / log.slope(light);
                let got = recoded.levels[1].sigma(y)[c];
                assert!((got / want - 1.0).abs() < 0.15, "{y} {c}: {got} {want}");
                // Negative control: taken as it is, the noise is another one.
                let as_it_is = model.std(1, y)[c];
                assert!((as_it_is / want - 1.0).abs() > 0.2, "{y} {c}: {as_it_is} {want}");
            }
        }
        assert!(recoded.validate().is_ok());
        // Nothing changes where the encoding stays.
        let same = model.recoded(log, log);
        assert!(
            (same.levels[0].slope[0] - 0.004).abs() < 1e-5
                && (same.levels[0].intercept[0] - 0.01).abs() < 1e-5
        );
    }
}
