//! Grain as textures and responses: the bands of the noise as a tile, a tile of the whole noise for tools that take only one, and
//! the std over luminance.

use super::{Camera, number, numbers, short};
use crate::model::{NOISE_LEVELS, NoiseModel};
use crate::synth::noise::tileable_bands;
use crate::{Raster, Transfer};
use std::sync::OnceLock;

/// The side of the textures, px. The textures tile; a random offset for each frame hides that they repeat.
pub const SIDE: usize = 512;

/// The factor by which noise n of std 1 is stored, as `0.5 + 0.125 n`, so that 4 std fit on both sides.
pub const GAIN: f32 = 0.125;

/// The name of the file that holds [`bands`].
pub const BANDS: &str = "blindaug_bands.png";

/// The name of the file that holds [`tile`].
pub const TILE: &str = "blindaug_grain.png";

/// The offsets (x, y), px, at which a shader reads [`bands`] for R, G and B: far enough apart for the channels to be independent.
pub const CHANNEL_OFFSETS: [[usize; 2]; 3] = [[0, 0], [171, 293], [347, 97]];

/// Encoded luminance at which the spectrum of [`tile`] is the model's.
pub const TILE_LUMINANCE: f32 = 0.5;

fn stored(n: f32) -> f32 {
    (0.5 + GAIN * n).clamp(0.0, 1.0)
}

/// The noise's four levels at full resolution, each for a std of 1, in R, G, B, A, finest first, stored with [`GAIN`].
///
/// Noise of channel c over content of encoded luminance Y is the sum over levels l of
/// `max(slope[l][c] Y + intercept[l][c], 0) (texel[l] - 0.5) / GAIN`, each channel reading at its own offset.
pub fn bands() -> Raster<[f32; 4]> {
    static BANDS: OnceLock<Raster<[f32; 4]>> = OnceLock::new();
    let make = || {
        let bands = tileable_bands(SIDE, 0);
        Raster::from_fn(SIDE, SIDE, |x, y| std::array::from_fn(|l| stored(bands[l].at(x, y)[0])))
    };
    BANDS.get_or_init(make).clone()
}

/// The model's noise at [`TILE_LUMINANCE`], scaled to std 1: the noise of R, G and B in these channels, and in A one noise for all three.
pub fn tile(model: &NoiseModel) -> Raster<[f32; 4]> {
    let bands = tileable_bands(SIDE, 1);
    let one = self::bands();
    let sigma: [[f32; 3]; NOISE_LEVELS] = std::array::from_fn(|l| model.std(l, TILE_LUMINANCE));
    let mean = sigma.map(root_mean_square);
    let mut tile = Raster::from_fn(SIDE, SIDE, |x, y| {
        let mut sum = [0.0; 4];
        for l in 0..NOISE_LEVELS {
            let n = bands[l].at(x, y);
            (0..3).for_each(|c| sum[c] += sigma[l][c] * n[c]);
            sum[3] += mean[l] * (one.at(x, y)[l] - 0.5) / GAIN;
        }
        sum
    });
    let mut squares = [0.0f64; 4];
    for p in tile.data() {
        (0..4).for_each(|c| squares[c] += f64::from(p[c]).powi(2));
    }
    let std = squares.map(|s| (s / (SIDE * SIDE) as f64).sqrt() as f32);
    for p in tile.data_mut() {
        *p = std::array::from_fn(|c| stored(if std[c] > 0.0 { p[c] / std[c] } else { 0.0 }));
    }
    tile
}

/// The root mean square of the stds of R, G and B, for grain that is the same in all channels.
pub(super) fn root_mean_square(std: [f32; 3]) -> f32 {
    (std.iter().map(|s| s * s).sum::<f32>() / 3.0).sqrt()
}

/// Encoded luminances of look-up tables and fits, from black to white.
pub fn luminances(count: usize) -> impl Iterator<Item = f32> {
    (0..count).map(move |i| i as f32 / (count - 1) as f32)
}

/// Std over luminance as comma-separated values: all levels together, then each alone, in R, G and B.
pub fn table(model: &NoiseModel) -> String {
    let mut text = String::from(
        "# Std of the noise over encoded (sRGB) luminance Y (Rec. 601), in encoded values from 0 to 1.\n\
         # std_*: all levels together; levelN_*: octaves of the Laplacian pyramid, 0 the finest.\n",
    );
    text += &format!(
        "# Nothing is noisy at and above {}, where the sensor clips.\nluminance",
        number(model.clip())
    );
    let names = std::iter::once("std".into()).chain((0..NOISE_LEVELS).map(|l| format!("level{l}")));
    for name in names {
        ["r", "g", "b"].iter().for_each(|c| text += &format!(",{name}_{c}"));
    }
    text.push('\n');
    for y in luminances(33) {
        let levels = (0..NOISE_LEVELS).map(|l| model.std(l, y));
        let row: Vec<String> =
            std::iter::once(model.total_std(y)).chain(levels).flatten().map(number).collect();
        text += &format!("{},{}\n", number(y), row.join(","));
    }
    text
}

/// The film grain of Unity's pipelines, `out = in + in g(x) 4 I (1 - r sqrt(L))` in linear light, L the luminance, g the texture's
/// alpha from -1 to 1 (URP's and HDRP's `ApplyGrain`; the factor 4 is applied where the parameters are set). With [`GAIN`]
/// the std of `4 g` is 1, so that I itself is the std over L.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// `intensity`, in [0, 1].
    pub intensity: f32,
    /// `response`, in [0, 1].
    pub response: f32,
    /// Root mean square over luminance of the difference from the model's std, in encoded values.
    pub residual: f32,
    /// Root mean square over luminance of the model's std, in encoded values.
    pub wanted: f32,
}

impl Response {
    /// The response nearest to the model's root mean square std of R, G and B, in least squares of the encoded std over encoded luminance.
    pub fn nearest(model: &NoiseModel, transfer: Transfer) -> Self {
        // Black is left out, where the response is zero whatever its parameters.
        let points: Vec<[f32; 3]> = luminances(64)
            .skip(1)
            .filter(|y| *y < model.clip())
            .map(|y| {
                let light = transfer.decode(y);
                [light * transfer.slope(light), light.sqrt(), root_mean_square(model.total_std(y))]
            })
            .collect();
        // The response's encoded std is sigma = I s - I r s sqrt(L) with s = L dE/dL; each r has its least-squares I.
        let fit = |r: f32| {
            let [mut wanted, mut squares] = [0.0; 2];
            for [s, root, sigma] in &points {
                let shape = s * (1.0 - r * root);
                wanted += shape * sigma;
                squares += shape * shape;
            }
            let intensity = (wanted / squares.max(1e-12)).clamp(0.0, 1.0);
            let loss: f32 = points
                .iter()
                .map(|[s, root, sigma]| (sigma - intensity * s * (1.0 - r * root)).powi(2))
                .sum();
            (intensity, loss)
        };
        let response = luminances(101).min_by(|a, b| fit(*a).1.total_cmp(&fit(*b).1)).unwrap_or(0.0);
        let (intensity, loss) = fit(response);
        let count = points.len().max(1) as f32;
        let wanted = (points.iter().map(|p| p[2] * p[2]).sum::<f32>() / count).sqrt();
        Self { intensity, response, residual: (loss / count).sqrt(), wanted }
    }

    /// Notes on what the response cannot reproduce.
    pub(super) fn lost(&self) -> Vec<String> {
        vec![
            "grain is the same in all channels, and none at black".into(),
            format!(
                "its std over luminance differs from the model's by {} (root mean square, of {})",
                short(self.residual),
                short(self.wanted)
            ),
            format!("its spectrum is the model's at luminance {TILE_LUMINANCE} throughout"),
        ]
    }
}

/// The slopes and the intercepts as `[channel][level]`, as a shader that reads [`bands`] takes them.
pub(super) fn by_channel(model: &NoiseModel) -> ([[f32; 4]; 3], [[f32; 4]; 3]) {
    let of = |f: &dyn Fn(usize) -> [f32; 3]| std::array::from_fn(|c| std::array::from_fn(|l| f(l)[c]));
    (of(&|l| model.lines().levels[l].slope), of(&|l| model.lines().levels[l].intercept))
}

/// The values of the markers in a text of HLSL that reads [`bands`] for a model.
pub(super) fn hlsl_values(noise: &NoiseModel) -> [(&'static str, String); 7] {
    let (slope, intercept) = by_channel(noise);
    let vectors = |v: [[f32; 4]; 3]| v.map(|v| format!("float4({})", numbers(&v))).join(", ");
    [
        ("bands", BANDS.into()),
        ("slope", vectors(slope)),
        ("intercept", vectors(intercept)),
        ("offsets", CHANNEL_OFFSETS.map(|[x, y]| format!("int2({x}, {y})")).join(", ")),
        ("clip", number(noise.clip())),
        ("mask", (SIDE - 1).to_string()),
        ("gain", number(GAIN)),
    ]
}

/// Notes on the limits of all passes that take the whole model.
pub(super) fn full_pass_lost(camera: &Camera) -> Vec<String> {
    camera.noise.as_ref().map_or(vec![], |_| {
        vec!["where the object is transparent, noise is added to all of the picture alike".into()]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::NoiseLevel;

    fn model(slope: f32, intercept: f32) -> NoiseModel {
        let share = [1.0, 0.6, 0.3, 0.1];
        NoiseModel::given(
            share.map(|s| NoiseLevel {
                slope: [slope * s; 3],
                intercept: [intercept * s, 0.7 * intercept * s, 1.3 * intercept * s],
            }),
            1.0,
        )
    }

    #[test]
    fn a_shader_that_reads_the_bands_makes_the_model_s_noise() {
        let (m, bands, y) = (model(0.02, 0.03), bands(), 0.3);
        let (slope, intercept) = by_channel(&m);
        let noise = |x: usize, yy: usize, c: usize| {
            let [dx, dy] = CHANNEL_OFFSETS[c];
            let texel = bands.at((x + dx) % SIDE, (yy + dy) % SIDE);
            (0..4).map(|l| (slope[c][l] * y + intercept[c][l]) * (texel[l] - 0.5) / GAIN).sum::<f32>()
        };
        let all = |f: &dyn Fn(usize, usize) -> f32| {
            let sum: f64 = (0..SIDE * SIDE).map(|i| f64::from(f(i % SIDE, i / SIDE))).sum();
            sum / (SIDE * SIDE) as f64
        };
        for (c, want) in m.total_std(y).into_iter().enumerate() {
            let got = all(&|x, y| noise(x, y, c).powi(2)).sqrt();
            assert!((got as f32 / want - 1.0).abs() < 0.03, "{got} {want}");
            assert!(all(&|x, y| noise(x, y, c)).abs() < 0.02 * f64::from(want));
        }
        let [a, b] = [0, 1].map(|c| all(&|x, y| noise(x, y, c).powi(2)).sqrt());
        assert!(all(&|x, y| noise(x, y, 0) * noise(x, y, 1)).abs() < 0.03 * a * b);
    }

    #[test]
    fn the_tile_has_std_1_the_model_s_spectrum_and_no_seam() {
        let tile = tile(&model(0.0, 0.03));
        for c in 0..4 {
            let n = |x: usize, y: usize| f64::from((tile.at(x % SIDE, y % SIDE)[c] - 0.5) / GAIN);
            let mean = |f: &dyn Fn(usize, usize) -> f64| {
                (0..SIDE * SIDE).map(|i| f(i % SIDE, i / SIDE)).sum::<f64>() / (SIDE * SIDE) as f64
            };
            assert!((mean(&|x, y| n(x, y).powi(2)) - 1.0).abs() < 0.01);
            // The tile wraps: the mean product of neighbours is the same across the edge as inside, where this model's noise is correlated.
            let inside = mean(&|x, y| n(x, y) * n(x + 1, y));
            let edge = (0..SIDE).map(|y| n(SIDE - 1, y) * n(SIDE, y)).sum::<f64>() / SIDE as f64;
            assert!(inside > 0.05 && (edge - inside).abs() < 0.2, "{inside} {edge}");
            // Nothing repeats inside the tile.
            for (dx, dy) in [(SIDE / 2, 0), (0, SIDE / 2), (SIDE / 4, SIDE / 4), (100, 0)] {
                assert!(mean(&|x, y| n(x, y) * n(x + dx, y + dy)).abs() < 0.02);
            }
        }
    }

    #[test]
    fn the_response_that_was_meant_is_found_again() {
        // The model's lines do not have the response's shape, but the nearest response leaves a small residual.
        let near = Response::nearest(&model(0.03, 0.01), Transfer::Srgb);
        assert!((0.0..=1.0).contains(&near.intensity) && (0.0..=1.0).contains(&near.response));
        assert!(near.residual < 0.5 * near.wanted, "{near:?}");
        let worse = |i: f32, r: f32| {
            let t = Transfer::Srgb;
            luminances(64)
                .skip(1)
                .filter(|y| *y < 1.0)
                .map(|y| {
                    let light = t.decode(y);
                    let rms =
                        (model(0.03, 0.01).total_std(y).iter().map(|s| s * s).sum::<f32>() / 3.0).sqrt();
                    (rms - i * light * t.slope(light) * (1.0 - r * light.sqrt())).powi(2)
                })
                .sum::<f32>()
        };
        let best = worse(near.intensity, near.response);
        for (i, r) in [(1.03, 1.0), (0.97, 1.0)] {
            assert!(worse(near.intensity * i, near.response * r) > best);
        }
        assert_eq!(Response::nearest(&model(0.0, 0.0), Transfer::Srgb).intensity, 0.0);
    }

    #[test]
    fn the_table_says_what_the_model_says() {
        let m = model(0.02, 0.01);
        let text = table(&m);
        let rows: Vec<Vec<f32>> = text
            .lines()
            .filter(|l| !l.starts_with('#') && !l.starts_with('l'))
            .map(|l| l.split(',').map(|v| v.parse().unwrap()).collect())
            .collect();
        assert_eq!(rows.len(), 33);
        for row in rows {
            assert_eq!(row.len(), 16);
            assert!((row[1] - m.total_std(row[0])[0]).abs() < 1e-5);
            assert!((row[4 + 1] - m.std(0, row[0])[1]).abs() < 1e-5);
        }
    }
}
