//! AV1 film grain: a table for encoders (`aomenc --film-grain-table`, `SvtAv1EncApp --fgs-table`, `rav1e --film-grain-table`).
//!
//! A decoder makes a tile of normal numbers (std 512 in 12 bits), filters the tile by an autoregression over 24 previous pixels in
//! reading order (lag 3), and adds the tile times a piecewise linear function of luma, in the coded YCbCr. So:
//! - the autoregression is the Yule-Walker fit to the noise's autocovariance in Y, and at half the size in Cb and Cr, together with
//!   their covariance with Y;
//! - the scaling is the noise's std in code values, divided by the std of the filtered tile.
//!
//! Source: the AV1 bitstream's specification, section 7.18.3 (film grain synthesis), and the tables that libaom reads.

use super::{Abilities, Camera, Export, File, Shapes, grain};
use crate::model::{NOISE_LEVELS, NoiseModel};
use crate::synth::noise::tileable_bands;
use crate::{Plane, Raster};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "AV1 encoders that read film grain tables (aomenc, SVT-AV1, rav1e)",
    motion_blur: "none",
    defocus: "none",
    bokeh: Shapes::DISKS,
    grain: "luma and chroma over luma, one spectrum; nothing coarser than 7 px",
    checked: "accepted by an encoder; the decoded grain's std measured over luma",
};

/// The lag of the autoregression, px.
const LAG: usize = 3;
/// The number of the autoregression's coefficients: LAG rows above of 2 LAG + 1 pixels, and LAG pixels to the left.
const TAPS: usize = 2 * LAG * (LAG + 1);
/// Std of the decoder's normal numbers at 8 bits: 512 in 12 bits.
const TILE_STD: f32 = 32.0;
/// Largest value of the filtered tile at 8 bits, beyond which decoders clip.
const TILE_MAX: f32 = 127.0;

/// The numbers of a film grain table.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The coefficients are integers divided by 2 to this power, from 6 to 9.
    pub ar_coeff_shift: u32,
    /// The number of bits by which the tile is shifted down, from 0 to 3.
    pub grain_scale_shift: u32,
    /// The number of bits by which scaled grain is shifted down, from 8 to 11.
    pub scaling_shift: u32,
    /// The scaling of Y, Cb and Cr as points (8-bit luma, scaling from 0 to 255), luma rising; at most 14 for Y and 10 for Cb and Cr.
    pub scaling: [Vec<[u8; 2]>; 3],
    /// The coefficients of Y, Cb and Cr: 24 in reading order, and for Cb and Cr one more for the grain of Y.
    pub coefficients: [Vec<i32>; 3],
}

/// The weights of R, G, B in Y, Cb and Cr by the encoder's matrix: BT.709 from 720 lines on, else BT.601.
fn ycbcr(height: usize) -> [[f32; 3]; 3] {
    let [r, b] = if height >= 720 { [0.2126, 0.0722] } else { [0.299, 0.114] };
    let y = [r, 1.0 - r - b, b];
    let difference = |channel: usize| {
        std::array::from_fn(|c| (f32::from(u8::from(c == channel)) - y[c]) / (2.0 * (1.0 - y[channel])))
    };
    [y, difference(2), difference(0)]
}

/// The autocovariance for lags of -13 to 13 columns and 0 to 7 rows, the lags that half-size chroma needs.
#[derive(Clone)]
struct Covariance(Plane);

impl Covariance {
    const COLUMNS: isize = 13;
    const ROWS: isize = 7;

    /// The covariance of the model's noise in one channel at an even luminance: bands of std 1, each times its level's `sigma`.
    fn of_channel(bands: &[Raster<[f32; 3]>; NOISE_LEVELS], sigma: [f32; NOISE_LEVELS]) -> Self {
        let side = bands[0].width();
        let noise = Raster::from_fn(side, side, |x, y| {
            let mut sum = [0.0; 3];
            for (band, s) in bands.iter().zip(sigma) {
                let n = band.at(x, y);
                (0..3).for_each(|k| sum[k] += s * n[k]);
            }
            sum
        });
        let lags = Plane::from_fn(2 * Self::COLUMNS as usize + 1, Self::ROWS as usize + 1, |i, dy| {
            let dx = (i + side) as isize - Self::COLUMNS;
            let mut sum = 0.0f64;
            for y in 0..side {
                let (row, other) = (noise.row(y), noise.row((y + dy) % side));
                for (x, a) in row.iter().enumerate() {
                    let b = other[(x + dx as usize) % side];
                    sum += f64::from(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
                }
            }
            (sum / (3 * side * side) as f64) as f32
        });
        Self(lags)
    }

    fn sum(terms: &[(f32, &Self)]) -> Self {
        let (w, h) = terms[0].1.0.size();
        Self(Plane::from_fn(w, h, |x, y| terms.iter().map(|(k, c)| k * c.0.at(x, y)).sum()))
    }

    /// The covariance at any lag within reach; the opposite lag has the same value.
    fn at(&self, dx: isize, dy: isize) -> f32 {
        let [dx, dy] = if dy < 0 { [-dx, -dy] } else { [dx, dy] };
        self.0.at((dx + Self::COLUMNS) as usize, dy as usize)
    }

    /// The covariance of the means of 2 x 2 px, at a lag in pixels of the halved image.
    fn halved(&self, dx: isize, dy: isize) -> f32 {
        let offsets = [(-1, 0.25), (0, 0.5), (1, 0.25)];
        let mut sum = 0.0;
        for (oy, wy) in offsets {
            for (ox, wx) in offsets {
                sum += wx * wy * self.at(2 * dx + ox, 2 * dy + oy);
            }
        }
        sum
    }
}

/// The offsets (x, y) of the autoregression's pixels, in the order of the table.
fn taps() -> impl Iterator<Item = [isize; 2]> {
    let lag = LAG as isize;
    (-lag..=0).flat_map(move |dy| (-lag..=lag).map(move |dx| [dx, dy])).take(TAPS)
}

/// Solves A x = b, A symmetric and positive, by Gaussian elimination with pivots; singular unknowns are set to 0.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for i in 0..n {
        let pivot = (i..n).max_by(|&p, &q| a[p][i].abs().total_cmp(&a[q][i].abs())).unwrap_or(i);
        a.swap(i, pivot);
        b.swap(i, pivot);
        if a[i][i].abs() < 1e-12 {
            continue;
        }
        for row in i + 1..n {
            let factor = a[row][i] / a[i][i];
            let (above, below) = a.split_at_mut(row);
            below[0][i..].iter_mut().zip(&above[i][i..]).for_each(|(v, p)| *v -= factor * p);
            b[row] -= factor * b[i];
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
        x[i] = if a[i][i].abs() < 1e-12 { 0.0 } else { (b[i] - known) / a[i][i] };
    }
    x
}

/// An autoregression: the coefficients of the taps, then for chroma that of the co-located luma; and the std of each pixel's innovation.
struct Autoregression {
    coefficients: Vec<f64>,
    innovation: f64,
}

/// The statistics of luma at chroma's grid that chroma's autoregression uses.
struct Luma<'a> {
    /// The covariance of luma with chroma at a lag.
    cross: &'a dyn Fn(isize, isize) -> f32,
    variance: f32,
}

/// Solves Yule & Walker's equations for `own`, the autocovariance of a plane, and for chroma its covariance with luma.
fn autoregression(own: impl Fn(isize, isize) -> f32, luma: Option<Luma>) -> Autoregression {
    let taps: Vec<_> = taps().collect();
    let n = TAPS + usize::from(luma.is_some());
    let variance = f64::from(own(0, 0));
    let cross = |lag: [isize; 2]| luma.as_ref().map_or(0.0, |l| (l.cross)(lag[0], lag[1]));
    let between = |i: usize, j: usize| -> f64 {
        f64::from(match (i < TAPS, j < TAPS) {
            (true, true) => own(taps[i][0] - taps[j][0], taps[i][1] - taps[j][1]),
            (true, false) => cross(taps[i]),
            (false, true) => cross(taps[j]),
            (false, false) => luma.as_ref().map_or(0.0, |l| l.variance),
        })
    };
    let with_this = |i: usize| f64::from(if i < TAPS { own(taps[i][0], taps[i][1]) } else { cross([0, 0]) });
    let b: Vec<f64> = (0..n).map(with_this).collect();
    // The diagonal gets a ten-thousandth of the variance more, for spectra that are zero at some frequency.
    let a = (0..n)
        .map(|i| {
            (0..n).map(|j| between(i, j) + if i == j { 1e-4 * variance.max(1e-12) } else { 0.0 }).collect()
        })
        .collect();
    let coefficients = solve(a, b.clone());
    let explained: f64 = coefficients.iter().zip(&b).map(|(c, b)| c * b).sum();
    Autoregression { coefficients, innovation: (variance - explained).max(1e-4 * variance).sqrt() }
}

/// The number of columns on either side of an impulse over which a filter's response is computed.
const REACH: isize = 64;
/// The number of rows, from the impulse's on, over which a filter's response is computed.
const DEPTH: usize = 48;

/// The filter's response to `input`, over columns from -[`REACH`] to [`REACH`] and rows from 0 on.
fn response(coefficients: &[f64], input: impl Fn(isize, isize) -> f64) -> Vec<Vec<f64>> {
    const WIDTH: usize = 2 * REACH as usize + 1;
    let taps: Vec<_> = taps().collect();
    let mut out = vec![vec![0.0; WIDTH]; DEPTH];
    for y in 0..DEPTH {
        for x in 0..WIDTH {
            let mut v = input(x as isize - REACH, y as isize);
            for ([dx, dy], c) in taps.iter().zip(coefficients) {
                let (px, py) = (x as isize + dx, y as isize + dy);
                if py >= 0 && (0..WIDTH as isize).contains(&px) {
                    v += c * out[py as usize][px as usize];
                }
            }
            out[y][x] = v;
        }
    }
    out
}

fn impulse(x: isize, y: isize) -> f64 {
    f64::from(u8::from(x == 0 && y == 0))
}

fn energy(response: &[Vec<f64>]) -> f64 {
    response.iter().flatten().map(|v| v * v).sum()
}

/// The variance that luma of this response adds to chroma: luma is halved by means of 2 x 2 px, then passes chroma's own filter.
fn from_luma(luma: &[Vec<f64>], coefficients: &[f64]) -> f64 {
    let at = |x: isize, y: isize| {
        let row = usize::try_from(y).ok().and_then(|y| luma.get(y));
        row.and_then(|row| row.get(usize::try_from(x + REACH).ok()?)).copied().unwrap_or(0.0)
    };
    // An impulse may fall on any of the four pixels of a mean.
    [(0, 0), (1, 0), (0, 1), (1, 1)].iter().fold(0.0, |sum, (px, py)| {
        let halved = |x: isize, y: isize| {
            let (x, y) = (2 * x - px, 2 * y - py);
            (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) / 4.0
        };
        sum + energy(&response(coefficients, halved))
    })
}

/// The noise as the table's numbers, for pictures of this height.
// Long, since the numbers of the table follow from each other in this order.
pub fn settings(noise: &NoiseModel, height: usize) -> Settings {
    let matrix = ycbcr(height);
    let bands = tileable_bands(256, 0);
    let channels: [Covariance; 3] = std::array::from_fn(|c| {
        Covariance::of_channel(&bands, std::array::from_fn(|l| noise.std(l, grain::TILE_LUMINANCE)[c]))
    });
    // The channels are independent, so that covariances add.
    let of = |a: usize, b: usize| {
        let terms: Vec<_> = (0..3).map(|c| (matrix[a][c] * matrix[b][c], &channels[c])).collect();
        Covariance::sum(&terms)
    };
    let y = of(0, 0);
    let luma = autoregression(|dx, dy| y.at(dx, dy), None);
    let planes: Vec<Autoregression> = std::iter::once(luma)
        .chain((1..3).map(|plane| {
            let (own, cross) = (of(plane, plane), of(plane, 0));
            autoregression(
                |dx, dy| own.halved(dx, dy),
                Some(Luma { cross: &|dx, dy| cross.halved(dx, dy), variance: y.halved(0, 0) }),
            )
        }))
        .collect();
    // In the decoder's units every plane's innovation has the same std, so that chroma's coefficient of luma is rescaled.
    let share =
        |p: &Autoregression| if p.innovation > 0.0 { planes[0].innovation / p.innovation } else { 0.0 };
    let wanted: Vec<Vec<f64>> = planes
        .iter()
        .map(|p| {
            p.coefficients.iter().enumerate().map(|(i, c)| if i < TAPS { *c } else { c * share(p) }).collect()
        })
        .collect();
    let most = wanted.iter().flatten().fold(0.0f64, |m, c| m.max(c.abs()));
    let ar_coeff_shift = (6..=9).rev().find(|s| most * f64::from(1u32 << s) <= 127.0).unwrap_or(6);
    let unit = f64::from(1u32 << ar_coeff_shift);
    let coefficients: [Vec<i32>; 3] = std::array::from_fn(|p| {
        wanted[p].iter().map(|c| (c * unit).round().clamp(-128.0, 127.0) as i32).collect()
    });
    let used = |p: usize| -> Vec<f64> { coefficients[p].iter().map(|&c| f64::from(c) / unit).collect() };
    // Std of the filtered tiles over that of the normal numbers.
    let luma = response(&used(0), impulse);
    let gains: [f64; 3] = std::array::from_fn(|p| {
        if p == 0 {
            return energy(&luma).sqrt();
        }
        let coefficients = used(p);
        let (own, of_luma) = coefficients.split_at(TAPS);
        (energy(&response(own, impulse)) + of_luma[0].powi(2) * from_luma(&luma, own)).sqrt()
    });
    // The tile must have room for 3.5 std.
    let largest = gains.iter().fold(0.0f64, |m, g| m.max(*g)) as f32 * TILE_STD;
    let grain_scale_shift = (0..=3).find(|s| 3.5 * largest / (1u32 << s) as f32 <= TILE_MAX).unwrap_or(3);
    // Std in 8-bit code values of the limited range, over the encoded luminance.
    let code_std = |plane: usize, y: f32| {
        let range = if plane == 0 { 219.0 } else { 224.0 };
        let variance: f32 = (0..3).map(|c| (matrix[plane][c] * noise.total_std(y)[c]).powi(2)).sum();
        // Chroma at half the size is a mean of 2 x 2 px, which keeps this share of the variance.
        let kept = if plane == 0 {
            1.0
        } else {
            let own = of(plane, plane);
            own.halved(0, 0) / own.at(0, 0).max(1e-12)
        };
        range * (variance * kept.max(0.0)).sqrt()
    };
    let clip = noise.clip().min(1.0);
    let code = |y: f32| (16.0 + 219.0 * y).round() as u8;
    let points = |count: usize| (0..count).map(move |i| clip * i as f32 / count as f32);
    let grain_std =
        |plane: usize| (gains[plane] as f32 * TILE_STD / (1u32 << grain_scale_shift) as f32).max(1e-6);
    let per_code: [Vec<(u8, f32)>; 3] = std::array::from_fn(|plane| {
        let count = if plane == 0 { 12 } else { 8 };
        points(count).map(|y| (code(y), code_std(plane, y) / grain_std(plane))).collect()
    });
    let most = per_code.iter().flatten().fold(0.0f32, |m, p| m.max(p.1));
    let scaling_shift = (8..=11).rev().find(|s| most * (1u32 << s) as f32 <= 255.0).unwrap_or(8);
    let scaling = per_code.map(|points| {
        let mut scaled: Vec<[u8; 2]> = vec![];
        for (luma, v) in points {
            let value = (v * (1u32 << scaling_shift) as f32).round().min(255.0) as u8;
            if scaled.last().is_none_or(|last| last[0] < luma) {
                scaled.push([luma, value]);
            }
        }
        // The last scaling holds up to the code below the level at which the sensor clips; at that level it drops to 0.
        if let (Some(&[last, value]), end) = (scaled.last(), code(clip)) {
            if last + 1 < end {
                scaled.push([end - 1, value]);
            }
            if last < end {
                scaled.push([end, 0]);
            }
        }
        scaled
    });
    Settings { ar_coeff_shift, grain_scale_shift, scaling_shift, scaling, coefficients }
}

/// The film grain table as a file.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    if camera.exposure.is_some() || camera.lens.is_some() {
        lost.push("a table holds grain only; motion blur and depth of field are in the other targets".into());
    }
    let mut text = String::from("filmgrn1\n");
    match &camera.noise {
        None => text += "E 0 9223372036854775807 0 0 0\n",
        Some(noise) => {
            let Settings { ar_coeff_shift, grain_scale_shift, scaling_shift, scaling, coefficients } =
                settings(noise, camera.height);
            lost.push(format!(
                "grain's spectrum is the model's at luminance {} throughout, as far as 24 taps can give it",
                grain::TILE_LUMINANCE
            ));
            lost.push("chroma's grain is for 4:2:0 and follows luma".into());
            if scaling.iter().flatten().any(|p| p[1] == 255) {
                lost.push("the noise is stronger than a table can say".into());
            }
            text += "E 0 9223372036854775807 1 7391 1\n";
            // Chroma is scaled by luma: multipliers 0, 64 / 64 and offset 0, as they are stored.
            text += &format!(
                "\tp {LAG} {ar_coeff_shift} {grain_scale_shift} {scaling_shift} 0 1 128 192 256 128 192 256\n"
            );
            for (name, points) in ["sY", "sCb", "sCr"].iter().zip(&scaling) {
                let pairs: Vec<String> = points.iter().map(|[x, y]| format!(" {x} {y}")).collect();
                text += &format!("\t{name} {}{}\n", points.len(), pairs.concat());
            }
            for (name, values) in ["cY", "cCb", "cCr"].iter().zip(&coefficients) {
                let values: Vec<String> = values.iter().map(|v| format!(" {v}")).collect();
                text += &format!("\t{name}{}\n", values.concat());
            }
        }
    }
    Export { files: vec![File::text("blindaug_grain.tbl", text)], lost }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::NoiseLevel;
    use crate::synth::noise::white_band_std;

    fn white(std: f32) -> NoiseModel {
        NoiseModel::given(
            white_band_std().map(|s| NoiseLevel { slope: [0.0; 3], intercept: [s * std; 3] }),
            1.0,
        )
    }

    /// Normal numbers: sums of twelve uniform ones, from a xorshift generator.
    fn normal_numbers() -> impl FnMut() -> f32 {
        let mut state = 0x1234_5678_9abc_def1u64;
        move || {
            let sum: f32 = (0..12)
                .map(|_| {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    (state >> 40) as f32 / 16_777_216.0
                })
                .sum();
            sum - 6.0
        }
    }

    /// The decoder's filtered tile of a plane; for chroma, `luma` is the tile of luma.
    fn tile(
        s: &Settings,
        plane: usize,
        side: usize,
        luma: Option<&Raster<i32>>,
        normal: &mut impl FnMut() -> f32,
    ) -> Raster<i32> {
        let mut tile = vec![vec![0i32; side + 8]; side + 4];
        for y in 0..side + 4 {
            for x in 0..side + 8 {
                let mut v = (512.0 * normal()).round() as i32;
                let shift = 4 + s.grain_scale_shift;
                v = (v + (1 << (shift - 1))) >> shift;
                if y >= 3 && x >= 3 && x < side + 5 {
                    let mut sum: i32 = taps()
                        .zip(&s.coefficients[plane])
                        .map(|([dx, dy], c)| c * tile[(y as isize + dy) as usize][(x as isize + dx) as usize])
                        .sum();
                    if let (Some(luma), Some(x), Some(y)) = (luma, x.checked_sub(4), y.checked_sub(4))
                        && x < side
                    {
                        let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
                        let mean: i32 = four.iter().map(|(i, j)| luma.at(2 * x + i, 2 * y + j)).sum();
                        sum += s.coefficients[plane][TAPS] * ((mean + 2) >> 2);
                    }
                    v += (sum + (1 << (s.ar_coeff_shift - 1))) >> s.ar_coeff_shift;
                }
                tile[y][x] = v.clamp(-128, 127);
            }
        }
        Raster::from_fn(side, side, |x, y| tile[y + 4][x + 4])
    }

    /// The tile times the scaling at a luma: grain in code values.
    fn scaled(s: &Settings, plane: usize, luma: u8, tile: &Raster<i32>) -> Plane {
        let points = &s.scaling[plane];
        let after = points.iter().position(|p| p[0] >= luma).unwrap_or(points.len() - 1).max(1);
        let [[x0, y0], [x1, y1]] = [points[after - 1], points[after]].map(|p| p.map(f32::from));
        let scale = (y0 + (y1 - y0) * (f32::from(luma) - x0) / (x1 - x0)).round() as i32;
        Plane::from_fn(tile.width(), tile.height(), |x, y| {
            ((scale * tile.at(x, y) + (1 << (s.scaling_shift - 1))) >> s.scaling_shift) as f32
        })
    }

    /// The decoder's luma grain of a table.
    fn decoded(s: &Settings, luma: u8, side: usize) -> Plane {
        scaled(s, 0, luma, &tile(s, 0, side, None, &mut normal_numbers()))
    }

    fn std(p: &Plane) -> f32 {
        (p.data().iter().map(|v| v * v).sum::<f32>() / p.data().len() as f32).sqrt()
    }

    #[test]
    fn white_noise_needs_no_autoregression_beyond_its_missing_low_frequencies() {
        let s = settings(&white(0.03), 1080);
        let unit = (1 << s.ar_coeff_shift) as f32;
        // Only the low-pass that the four octaves leave is missing.
        assert!(s.coefficients[0].iter().all(|&c| (c as f32 / unit).abs() < 0.06), "{:?}", s.coefficients[0]);
    }

    #[test]
    fn decoded_grain_has_the_model_s_std_and_correlation() {
        let share = [1.0, 0.9, 0.6, 0.3];
        let coarse = NoiseModel::given(
            share.map(|s| NoiseLevel { slope: [0.03 * s; 3], intercept: [0.015 * s; 3] }),
            1.0,
        );
        for model in [white(0.03), coarse] {
            let s = settings(&model, 1080);
            let weights = ycbcr(1080)[0];
            for luma in [40, 126, 200] {
                let y = (f32::from(luma) - 16.0) / 219.0;
                let want =
                    219.0 * (0..3).map(|c| (weights[c] * model.total_std(y)[c]).powi(2)).sum::<f32>().sqrt();
                let got = std(&decoded(&s, luma, 128));
                assert!((got / want - 1.0).abs() < 0.08, "luma {luma}: {got} for {want}");
            }
            let plane = decoded(&s, 126, 192);
            let lag = |dx: usize, dy: usize| {
                let n = 192 - dx.max(dy);
                let sum: f32 = (0..n)
                    .flat_map(|y| (0..n).map(move |x| (x, y)))
                    .map(|(x, y)| plane.at(x, y) * plane.at(x + dx, y + dy))
                    .sum();
                sum / (n * n) as f32 / std(&plane).powi(2)
            };
            let bands = tileable_bands(256, 3);
            let truth = Covariance::of_channel(&bands, std::array::from_fn(|l| model.std(l, 0.5)[0]));
            for (dx, dy) in [(1, 0), (0, 1), (1, 1), (2, 0)] {
                let want = truth.at(dx as isize, dy as isize) / truth.at(0, 0);
                assert!((lag(dx, dy) - want).abs() < 0.06, "lag {dx} {dy}: {} for {want}", lag(dx, dy));
            }
        }
        // Negative control: the table of weaker noise gives weaker grain.
        let other = settings(&white(0.015), 1080);
        assert!(
            std(&decoded(&other, 126, 128)) < 0.7 * std(&decoded(&settings(&white(0.03), 1080), 126, 128))
        );
    }

    #[test]
    fn decoded_chroma_has_the_model_s_std_where_it_shares_much_with_luma() {
        let coarse = NoiseModel::given(
            [1.0, 0.9, 0.6, 0.3].map(|s| NoiseLevel { slope: [0.0; 3], intercept: [0.03 * s; 3] }),
            1.0,
        );
        let s = settings(&coarse, 1080);
        let mut normal = normal_numbers();
        let luma = tile(&s, 0, 512, None, &mut normal);
        let bands = tileable_bands(256, 3);
        let shape = Covariance::of_channel(&bands, coarse.lines().levels.each_ref().map(|l| l.sigma(0.5)[0]));
        for plane in 1..3 {
            let weights: f32 = ycbcr(1080)[plane].iter().map(|w| w * w).sum();
            let want = 224.0 * (weights * shape.halved(0, 0)).sqrt();
            let got = std(&scaled(&s, plane, 126, &tile(&s, plane, 256, Some(&luma), &mut normal)));
            assert!((got / want - 1.0).abs() < 0.05, "plane {plane}: {got} for {want}");
        }
    }

    #[test]
    fn tables_keep_within_the_format() {
        for std in [0.0, 0.001, 0.05, 0.5] {
            let s = settings(&white(std), 480);
            assert!(
                (6..=9).contains(&s.ar_coeff_shift)
                    && s.grain_scale_shift <= 3
                    && (8..=11).contains(&s.scaling_shift)
            );
            for (points, most) in s.scaling.iter().zip([14, 10, 10]) {
                assert!(points.len() <= most && points.windows(2).all(|p| p[0][0] < p[1][0]));
            }
            for (c, n) in s.coefficients.iter().zip([24, 25, 25]) {
                assert!(c.len() == n && c.iter().all(|c| (-128..=127).contains(c)));
            }
        }
    }
}
