//! Colour spaces by name, and the conversion of light between their primaries.

use crate::{Encoded, Error, Result, Transfer, luma};

/// The colours of a space's red, green and blue, and of its white, as CIE 1931 chromaticities x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Primaries {
    /// Red, green, blue and white.
    pub xy: [[f64; 2]; 4],
    /// How white is brought to another white.
    adaptation: Adaptation,
}

/// The transform of cone responses by which white is brought to another white. Makers of cameras publish which one takes their colours to
/// ACES, the only space here with another white.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Adaptation {
    Bradford,
    Cat02,
}

const D65: [f64; 2] = [0.312_7, 0.329];
const D50: [f64; 2] = [0.345_7, 0.358_5];
const ACES_WHITE: [f64; 2] = [0.321_68, 0.337_67];

const fn primaries(r: [f64; 2], g: [f64; 2], b: [f64; 2], adaptation: Adaptation) -> Primaries {
    Primaries { xy: [r, g, b, D65], adaptation }
}

/// A matrix from R, G and B to R, G and B: rows of the result.
pub type Matrix = [[f64; 3]; 3];

impl Primaries {
    /// Rec. 709 and sRGB.
    pub const REC709: Self = primaries([0.64, 0.33], [0.3, 0.6], [0.15, 0.06], Adaptation::Bradford);
    /// Rec. 2020 and Rec. 2100.
    pub const REC2020: Self = primaries([0.708, 0.292], [0.17, 0.797], [0.131, 0.046], Adaptation::Bradford);
    /// DCI-P3 with the white of D65.
    pub const P3: Self = primaries([0.68, 0.32], [0.265, 0.69], [0.15, 0.06], Adaptation::Bradford);
    /// ACES2065-1.
    pub const AP0: Self = Self {
        xy: [[0.734_7, 0.265_3], [0.0, 1.0], [0.000_1, -0.077], ACES_WHITE],
        adaptation: Adaptation::Bradford,
    };
    /// ACEScg.
    pub const AP1: Self = Self {
        xy: [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044], ACES_WHITE],
        adaptation: Adaptation::Bradford,
    };
    /// Sony S-Gamut3.
    pub const S_GAMUT3: Self = primaries([0.73, 0.28], [0.14, 0.855], [0.1, -0.05], Adaptation::Cat02);
    /// Sony S-Gamut3.Cine.
    pub const S_GAMUT3_CINE: Self =
        primaries([0.766, 0.275], [0.225, 0.8], [0.089, -0.087], Adaptation::Cat02);
    /// ARRI Wide Gamut 3.
    pub const ARRI_WIDE_GAMUT3: Self =
        primaries([0.684, 0.313], [0.221, 0.848], [0.086_1, -0.102], Adaptation::Cat02);
    /// ARRI Wide Gamut 4.
    pub const ARRI_WIDE_GAMUT4: Self =
        primaries([0.734_7, 0.265_3], [0.142_4, 0.857_6], [0.099_1, -0.030_8], Adaptation::Cat02);
    /// Panasonic V-Gamut.
    pub const V_GAMUT: Self = primaries([0.73, 0.28], [0.165, 0.84], [0.1, -0.03], Adaptation::Bradford);
    /// RED Wide Gamut RGB.
    pub const RED_WIDE_GAMUT: Self = primaries(
        [0.780_308, 0.304_253],
        [0.121_595, 1.493_994],
        [0.095_612, -0.084_589],
        Adaptation::Bradford,
    );
    /// Canon Cinema Gamut.
    pub const CINEMA_GAMUT: Self = primaries([0.74, 0.27], [0.17, 1.14], [0.08, -0.1], Adaptation::Cat02);

    /// Adobe RGB (1998).
    pub const ADOBE_RGB: Self = primaries([0.64, 0.33], [0.21, 0.71], [0.15, 0.06], Adaptation::Bradford);
    /// ProPhoto RGB (ROMM), whose white is D50.
    pub const PROPHOTO: Self = Self {
        xy: [[0.734_7, 0.265_3], [0.159_6, 0.840_4], [0.036_6, 0.000_1], D50],
        adaptation: Adaptation::Bradford,
    };

    /// All primaries with a name.
    const NAMED: [(Self, &str); 14] = [
        (Self::REC709, "Rec. 709"),
        (Self::REC2020, "Rec. 2020"),
        (Self::P3, "P3"),
        (Self::AP0, "ACES AP0"),
        (Self::AP1, "ACES AP1"),
        (Self::S_GAMUT3, "S-Gamut3"),
        (Self::S_GAMUT3_CINE, "S-Gamut3.Cine"),
        (Self::ARRI_WIDE_GAMUT3, "ARRI Wide Gamut 3"),
        (Self::ARRI_WIDE_GAMUT4, "ARRI Wide Gamut 4"),
        (Self::V_GAMUT, "V-Gamut"),
        (Self::RED_WIDE_GAMUT, "RED Wide Gamut"),
        (Self::CINEMA_GAMUT, "Cinema Gamut"),
        (Self::ADOBE_RGB, "Adobe RGB"),
        (Self::PROPHOTO, "ProPhoto RGB"),
    ];

    /// The primaries of red, green, blue and white with these chromaticities: those with a name, if they differ from these by roundings only.
    ///
    /// # Errors
    /// If a chromaticity is not finite, or colours lie on one line, so that they span no space.
    pub fn new(xy: [[f64; 2]; 4]) -> Result<Self> {
        let same =
            |p: &Self| p.xy.as_flattened().iter().zip(xy.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-3);
        if let Some((named, _)) = Self::NAMED.iter().find(|(p, _)| same(p)) {
            return Ok(*named);
        }
        let new = Self { xy, adaptation: Adaptation::Bradford };
        let whole = |m: &Matrix| m.as_flattened().iter().all(|v| v.is_finite() && v.abs() < 1e3);
        let sound = xy.iter().all(|[x, y]| x.is_finite() && y.is_finite() && y.abs() > 1e-6)
            && inverse(&new.to_xyz()).is_some_and(|m| whole(&m));
        match sound {
            true => Ok(new),
            false => Err(Error::new("the chromaticities of red, green, blue and white span no colour space")),
        }
    }

    /// The primaries of an ICC profile: `colorants` are the XYZ of red, green and blue as the profile has them, adapted to D50. Those with a name
    /// are known whether their white is D50 or was adapted from D65, which profiles seldom tell; all others keep the white of D50.
    ///
    /// # Errors
    /// If the colours lie on one line, so that they span no space.
    pub fn of_icc(colorants: [[f64; 3]; 3]) -> Result<Self> {
        let white: [f64; 3] = std::array::from_fn(|i| colorants.iter().map(|c| c[i]).sum());
        let all = [colorants[0], colorants[1], colorants[2], white];
        let xy = |v: [f64; 3]| [v[0], v[1]].map(|c| c / v.iter().sum::<f64>());
        let to_d65 = adaptation(&BRADFORD, D50, D65);
        let of_d65 = to_d65.map(|m| Self::new(all.map(|v| xy(product(&m, v)))));
        match of_d65 {
            Some(Ok(named)) if named.name().is_some() => Ok(named),
            _ => Self::new(all.map(xy)),
        }
    }

    /// The name of the primaries; `None` if they have none.
    pub fn name(&self) -> Option<&'static str> {
        Self::NAMED.iter().find(|(p, _)| p.xy == self.xy).map(|(_, name)| *name)
    }

    /// The matrix to CIE XYZ, in which white has a Y of 1.
    fn to_xyz(self) -> Matrix {
        let [r, g, b, white] = self.xy.map(xyz);
        let columns = transposed(&[r, g, b]);
        let share = inverse(&columns).map_or([f64::NAN; 3], |m| product(&m, white));
        columns.map(|row| std::array::from_fn(|c| row[c] * share[c]))
    }
}

/// The XYZ of a chromaticity, with Y = 1.
fn xyz([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

fn transposed(m: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

fn product(m: &Matrix, v: [f64; 3]) -> [f64; 3] {
    m.map(|row| (0..3).map(|c| row[c] * v[c]).sum())
}

fn multiplied(a: &Matrix, b: &Matrix) -> Matrix {
    let b = transposed(b);
    a.map(|row| b.map(|column| (0..3).map(|k| row[k] * column[k]).sum()))
}

/// The inverse of a matrix by its cofactors; `None` if it has none.
fn inverse(m: &Matrix) -> Option<Matrix> {
    let cofactor = |i: usize, j: usize| {
        let [a, b] = [(i + 1) % 3, (i + 2) % 3];
        let [c, d] = [(j + 1) % 3, (j + 2) % 3];
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    (determinant.abs() > 1e-12)
        .then(|| std::array::from_fn(|i| std::array::from_fn(|j| cofactor(j, i) / determinant)))
}

const BRADFORD: Matrix =
    [[0.895_1, 0.266_4, -0.161_4], [-0.750_2, 1.713_5, 0.036_7], [0.038_9, -0.068_5, 1.029_6]];
const CAT02: Matrix = [[0.732_8, 0.429_6, -0.162_4], [-0.703_6, 1.697_5, 0.006_1], [0.003, 0.013_6, 0.983_4]];

/// The matrix by which XYZ under a white become those under another, scaled in cone responses; `None` if these have no inverse.
fn adaptation(cones: &Matrix, from: [f64; 2], to: [f64; 2]) -> Option<Matrix> {
    let [before, after] = [from, to].map(|white| product(cones, xyz(white)));
    let scaled = std::array::from_fn(|i| cones[i].map(|v| v * after[i] / before[i]));
    Some(multiplied(&inverse(cones)?, &scaled))
}

/// The matrix by which light of these primaries becomes light of others; `None` if they are the same. White stays white.
pub fn conversion(from: Primaries, to: Primaries) -> Option<Matrix> {
    if from.xy == to.xy {
        return None;
    }
    let mut matrix = from.to_xyz();
    if from.xy[3] != to.xy[3] {
        let cat02 = [from, to].iter().any(|p| p.adaptation == Adaptation::Cat02);
        let cones = if cat02 { CAT02 } else { BRADFORD };
        matrix = multiplied(&adaptation(&cones, from.xy[3], to.xy[3])?, &matrix);
    }
    Some(multiplied(&inverse(&to.to_xyz())?, &matrix))
}

/// Light of one pixel in other primaries.
pub fn converted(matrix: &Matrix, light: [f32; 3]) -> [f32; 3] {
    product(matrix, light.map(f64::from)).map(|v| v as f32)
}

/// A colour space: what its red, green, blue and white are, and how light is encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourSpace {
    /// Red, green, blue and white.
    pub primaries: Primaries,
    /// The curve of the encoded values.
    pub transfer: Transfer,
}

const fn space(primaries: Primaries, transfer: Transfer) -> ColourSpace {
    ColourSpace { primaries, transfer }
}

impl ColourSpace {
    /// sRGB, which integer images are in if nothing else is said.
    pub const SRGB: Self = space(Primaries::REC709, Transfer::Srgb);
    /// The light of sRGB, which EXR images are in if nothing else is said.
    pub const LINEAR_SRGB: Self = space(Primaries::REC709, Transfer::Linear);

    /// The spaces that have a name, and what they are.
    pub const NAMED: [(&str, Self, &str); 17] = [
        ("srgb", Self::SRGB, "display-encoded sRGB"),
        ("rec709", space(Primaries::REC709, Transfer::Bt1886), "Rec. 709 as a display shows it (BT.1886)"),
        ("linear-srgb", Self::LINEAR_SRGB, "scene-linear, primaries of sRGB and Rec. 709"),
        ("acescg", space(Primaries::AP1, Transfer::Linear), "scene-linear, ACES AP1"),
        ("aces2065-1", space(Primaries::AP0, Transfer::Linear), "scene-linear, ACES AP0"),
        ("s-log3", space(Primaries::S_GAMUT3, Transfer::SLog3), "Sony S-Log3, S-Gamut3"),
        ("s-log3-cine", space(Primaries::S_GAMUT3_CINE, Transfer::SLog3), "Sony S-Log3, S-Gamut3.Cine"),
        ("logc3", space(Primaries::ARRI_WIDE_GAMUT3, Transfer::LogC3), "ARRI LogC3 (EI 800), Wide Gamut 3"),
        ("logc4", space(Primaries::ARRI_WIDE_GAMUT4, Transfer::LogC4), "ARRI LogC4, Wide Gamut 4"),
        ("v-log", space(Primaries::V_GAMUT, Transfer::VLog), "Panasonic V-Log, V-Gamut"),
        ("log3g10", space(Primaries::RED_WIDE_GAMUT, Transfer::Log3G10), "RED Log3G10, Wide Gamut RGB"),
        ("canon-log3", space(Primaries::CINEMA_GAMUT, Transfer::CanonLog3), "Canon Log 3, Cinema Gamut"),
        ("pq", space(Primaries::REC2020, Transfer::Pq), "PQ (ST 2084), Rec. 2020"),
        ("hlg", space(Primaries::REC2020, Transfer::Hlg), "HLG (BT.2100), Rec. 2020"),
        ("display-p3", space(Primaries::P3, Transfer::Srgb), "Display P3, as phones record photographs"),
        ("adobe-rgb", space(Primaries::ADOBE_RGB, Transfer::AdobeRgb), "Adobe RGB (1998)"),
        ("prophoto", space(Primaries::PROPHOTO, Transfer::Prophoto), "ProPhoto RGB"),
    ];

    /// The space as people call it: its short name if it has one, else its primaries and its curve.
    pub fn name(&self) -> String {
        match Self::NAMED.iter().find(|(_, s, _)| s == self) {
            Some((name, ..)) => (*name).into(),
            None => {
                let primaries = self.primaries.name().unwrap_or("primaries of its own");
                format!("{}, {primaries}", self.transfer.name())
            }
        }
    }
}

impl std::str::FromStr for ColourSpace {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let plain = |t: &str| t.to_ascii_lowercase().replace(['-', '_', '.', ' '], "");
        let found = Self::NAMED.iter().find(|(name, ..)| plain(name) == plain(text));
        found.map(|(_, space, _)| *space).ok_or_else(|| {
            let names = Self::NAMED.map(|(name, ..)| name).join(", ");
            Error::new(format!(
                "\"{text}\" is no colour space that is known here: give one of {names}; OpenColorIO's ocioconvert brings others to these"
            ))
        })
    }
}

/// A sentence on what speaks against a frame's being of the colour space that is said of its file; `None` if nothing does. `coded` is the
/// colour space of the frame itself, `file` that of its file.
pub fn doubts(coded: &ColourSpace, file: &ColourSpace, frame: &Encoded) -> Option<String> {
    /// Every so many pixels are looked at.
    const STRIDE: usize = 7;
    let in_file = |v: f32| match coded.transfer == file.transfer {
        true => v,
        false => file.transfer.encode(coded.transfer.decode(v)),
    };
    let mut values: Vec<f32> = frame.0.data().iter().step_by(STRIDE).map(|p| in_file(luma(*p))).collect();
    if values.len() < 1000 {
        return None;
    }
    values.sort_unstable_by(f32::total_cmp);
    let share = |of: f32| values[((values.len() - 1) as f32 * of) as usize];
    let (dark, bright) = (share(0.001), share(0.999));
    let named = file.name();
    match file.transfer {
        // Light of a scene has deep blacks beside its whites; log footage has neither.
        Transfer::Linear if dark > 0.06 && bright < 0.9 && share(0.99) / share(0.01) < 12.0 => Some(format!(
            "said to be {named}, but its values lie between {dark:.2} and {bright:.2} as those of log footage do; if it is log, \
             give --colour-space s-log3, logc4, .."
        )),
        Transfer::Srgb | Transfer::Bt1886 | Transfer::AdobeRgb | Transfer::Prophoto | Transfer::Linear => {
            None
        }
        curve => {
            // Cameras' curves encode black well above 0, and no camera reaches the end of its curve in a large part of the picture.
            let black = curve.encode(0.0);
            let below = values.partition_point(|v| *v < 0.6 * black) as f32 / values.len() as f32;
            let white = 1.0 - values.partition_point(|v| *v < 0.99) as f32 / values.len() as f32;
            let percent = |v: f32| format!("{:.0} %", 100.0 * v);
            if black > 0.05 && below > 0.02 {
                return Some(format!(
                    "said to be {named}, but {} of its values are darker than that curve's black ({black:.3}): it is probably not log",
                    percent(below)
                ));
            }
            (white > 0.05).then(|| {
                format!(
                    "said to be {named}, but {} of its values are at the end of that curve, {:.0} times as bright as white: it is \
                     probably another encoding",
                    percent(white),
                    curve.decode(1.0)
                )
            })
        }
    }
}
