//! The curves by which cameras and displays encode light.

use serde::{Deserialize, Serialize};

/// The curve between linear light and encoded values.
///
/// Light is relative: 1 is diffuse white, 0.18 middle grey. The curves' numbers are those of the standards and of the makers' papers; a test
/// compares them with OpenColorIO's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transfer {
    /// sRGB (IEC 61966-2-1).
    #[default]
    Srgb,
    /// Values that are light itself.
    Linear,
    /// The display of Rec. 709 video: a power of 2.4 (ITU-R BT.1886 with a black of 0).
    Bt1886,
    /// Adobe RGB (1998): a power of 563/256.
    AdobeRgb,
    /// ProPhoto RGB as ICC profiles have it: a power of 1.8.
    Prophoto,
    /// Sony S-Log3.
    SLog3,
    /// ARRI LogC3 at an exposure index of 800.
    LogC3,
    /// ARRI LogC4.
    LogC4,
    /// Panasonic V-Log.
    VLog,
    /// RED Log3G10.
    Log3G10,
    /// Canon Log 3.
    CanonLog3,
    /// PQ (SMPTE ST 2084) in full range; light of 1 is 100 cd/m2.
    Pq,
    /// The camera's curve of HLG (ITU-R BT.2100), scaled so that middle grey is encoded as 0.424.
    Hlg,
}

/// A curve that is logarithmic from `cut` on, `c log10(a x + b) + d`, and linear below it, `e x + f`.
struct Log {
    cut: f32,
    a: f32,
    b: f32,
    c: f32,
    d: f32,
    e: f32,
    f: f32,
}

const S_LOG3: Log = Log {
    cut: 0.011_25,
    a: 1.0 / 0.19,
    b: 0.01 / 0.19,
    c: 261.5 / 1023.0,
    d: 420.0 / 1023.0,
    e: (171.210_3 - 95.0) / 0.011_25 / 1023.0,
    f: 95.0 / 1023.0,
};
const LOG_C3: Log = Log {
    cut: 0.010_591,
    a: 5.555_556,
    b: 0.052_272,
    c: 0.247_190,
    d: 0.385_537,
    e: 5.367_655,
    f: 0.092_809,
};
/// The published form, (log2(a x + 64) - 6) / 14 b + c, with a = (2^18 - 16) / 117.45, b = 928 / 1023 and c = 95 / 1023.
const LOG_C4: Log = Log {
    cut: -0.018_056_996,
    a: 2_231.826_3,
    b: 64.0,
    c: 928.0 / 1023.0 / 14.0 / std::f32::consts::LOG10_2,
    d: 95.0 / 1023.0 - 6.0 / 14.0 * 928.0 / 1023.0,
    e: 8.803_033,
    f: 0.158_956_34,
};
const V_LOG: Log = Log { cut: 0.01, a: 1.0, b: 0.008_73, c: 0.241_514, d: 0.598_206, e: 5.6, f: 0.125 };
const LOG3_G10: Log =
    Log { cut: -0.01, a: 155.975_33, b: 1.0 + 1.559_753_3, c: 0.224_282, d: 0.0, e: 15.192_7, f: 0.151_927 };
const CANON_LOG3: Log = Log {
    cut: 0.014 * 0.9,
    a: 14.983_25 / 0.9,
    b: 1.0,
    c: 0.367_268_45,
    d: 0.122_405_37,
    e: 1.975_479_8 / 0.9,
    f: 0.125_122_19,
};

impl Log {
    fn encode(&self, x: f32) -> f32 {
        if x >= self.cut { self.c * (self.a * x + self.b).log10() + self.d } else { self.e * x + self.f }
    }

    fn decode(&self, y: f32, powf: impl Fn(f32, f32) -> f32) -> f32 {
        if y >= self.e * self.cut + self.f {
            (powf(10.0, (y - self.d) / self.c) - self.b) / self.a
        } else {
            (y - self.f) / self.e
        }
    }

    fn slope(&self, x: f32) -> f32 {
        if x >= self.cut { self.c * self.a / (self.a * x + self.b) / std::f32::consts::LN_10 } else { self.e }
    }
}

/// The numbers of PQ, and the light of 1 as a share of its 10000 cd/m2.
mod pq {
    pub const M1: f32 = 2610.0 / 16384.0;
    pub const M2: f32 = 2523.0 / 32.0;
    pub const C1: f32 = 3424.0 / 4096.0;
    pub const C2: f32 = 2413.0 / 128.0;
    pub const C3: f32 = 2392.0 / 128.0;
    pub const WHITE: f32 = 0.01;
}

/// The numbers of HLG, and the light of 1 in its scale, in which it ends at 1.
mod hlg {
    pub const A: f32 = 0.178_832_77;
    pub const B: f32 = 0.284_668_92;
    pub const C: f32 = 0.559_910_7;
    pub const WHITE: f32 = 1.0 / 3.0;
}

/// The least light, as a size, at which a slope is taken of the curves that are infinitely steep at black.
const BLACK: f32 = 1e-5;

impl Transfer {
    /// All curves.
    pub const ALL: [Self; 13] = [
        Self::Srgb,
        Self::Linear,
        Self::Bt1886,
        Self::AdobeRgb,
        Self::Prophoto,
        Self::SLog3,
        Self::LogC3,
        Self::LogC4,
        Self::VLog,
        Self::Log3G10,
        Self::CanonLog3,
        Self::Pq,
        Self::Hlg,
    ];

    /// The name that people give to the curve.
    pub fn name(self) -> &'static str {
        match self {
            Self::Srgb => "sRGB",
            Self::Linear => "linear light",
            Self::Bt1886 => "BT.1886",
            Self::AdobeRgb => "Adobe RGB",
            Self::Prophoto => "ProPhoto",
            Self::SLog3 => "S-Log3",
            Self::LogC3 => "LogC3",
            Self::LogC4 => "LogC4",
            Self::VLog => "V-Log",
            Self::Log3G10 => "Log3G10",
            Self::CanonLog3 => "Canon Log 3",
            Self::Pq => "PQ",
            Self::Hlg => "HLG",
        }
    }

    /// The encoded value of a linear one. All curves continue past 1. Those of displays are mirrored below 0; those of cameras encode 0 as
    /// a value above 0, and go on below it.
    #[inline]
    pub fn encode(self, linear: f32) -> f32 {
        let x = linear.abs();
        match self {
            Self::Srgb => {
                let y = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
                y.copysign(linear)
            }
            Self::Linear => linear,
            Self::Bt1886 | Self::AdobeRgb | Self::Prophoto => x.powf(1.0 / self.power()).copysign(linear),
            Self::CanonLog3 if linear < 0.0 => 2.0 * CANON_LOG3.f - CANON_LOG3.encode(x),
            Self::Pq => {
                let p = (x * pq::WHITE).powf(pq::M1);
                ((pq::C1 + pq::C2 * p) / (1.0 + pq::C3 * p)).powf(pq::M2).copysign(linear)
            }
            Self::Hlg => {
                let e = x * hlg::WHITE;
                let y = if e <= 1.0 / 12.0 {
                    (3.0 * e).sqrt()
                } else {
                    hlg::A * (12.0 * e - hlg::B).ln() + hlg::C
                };
                y.copysign(linear)
            }
            log => log.log().map_or(linear, |log| log.encode(linear)),
        }
    }

    /// The linear value of an encoded one; the inverse of [`Transfer::encode`].
    #[inline]
    pub fn decode(self, encoded: f32) -> f32 {
        self.decode_by(encoded, f32::powf)
    }

    /// [`Transfer::decode`] by this function for powers.
    #[inline]
    pub(crate) fn decode_by(self, encoded: f32, powf: impl Fn(f32, f32) -> f32) -> f32 {
        let y = encoded.abs();
        match self {
            Self::Srgb => {
                let x = if y <= 0.040_45 { y / 12.92 } else { powf((y + 0.055) / 1.055, 2.4) };
                x.copysign(encoded)
            }
            Self::Linear => encoded,
            Self::Bt1886 | Self::AdobeRgb | Self::Prophoto => powf(y, self.power()).copysign(encoded),
            Self::CanonLog3 if encoded < CANON_LOG3.f => {
                -CANON_LOG3.decode(2.0 * CANON_LOG3.f - encoded, powf)
            }
            Self::Pq => {
                // The curve ends where its denominator would be 0, above 1.
                let v = powf(y.min(1.05), 1.0 / pq::M2);
                let p = powf((v - pq::C1).max(0.0) / (pq::C2 - pq::C3 * v), 1.0 / pq::M1);
                (p / pq::WHITE).copysign(encoded)
            }
            Self::Hlg => {
                let e = if y <= 0.5 { y * y / 3.0 } else { (((y - hlg::C) / hlg::A).exp() + hlg::B) / 12.0 };
                (e / hlg::WHITE).copysign(encoded)
            }
            log => log.log().map_or(encoded, |log| log.decode(encoded, powf)),
        }
    }

    /// The slope of the curve, d encoded / d linear, at a linear value. Where it would be infinite, at black, it is that of a little light.
    #[inline]
    pub fn slope(self, linear: f32) -> f32 {
        self.slope_by(linear, f32::powf)
    }

    /// [`Transfer::slope`] by this function for powers.
    #[inline]
    pub(crate) fn slope_by(self, linear: f32, powf: impl Fn(f32, f32) -> f32) -> f32 {
        let x = linear.abs();
        match self {
            Self::Srgb => {
                if x <= 0.003_130_8 {
                    12.92
                } else {
                    1.055 / 2.4 * powf(x, 1.0 / 2.4 - 1.0)
                }
            }
            Self::Linear => 1.0,
            Self::Bt1886 | Self::AdobeRgb | Self::Prophoto => {
                powf(x.max(BLACK), 1.0 / self.power() - 1.0) / self.power()
            }
            Self::CanonLog3 => CANON_LOG3.slope(x),
            Self::Pq => {
                let light = x.max(BLACK) * pq::WHITE;
                let p = powf(light, pq::M1);
                let below = 1.0 + pq::C3 * p;
                let of_p =
                    pq::M2 * powf((pq::C1 + pq::C2 * p) / below, pq::M2 - 1.0) * (pq::C2 - pq::C1 * pq::C3)
                        / (below * below);
                of_p * pq::M1 * p / light * pq::WHITE
            }
            Self::Hlg => {
                let e = x.max(BLACK) * hlg::WHITE;
                let of_e = if e <= 1.0 / 12.0 {
                    1.5 / (3.0 * e).sqrt()
                } else {
                    12.0 * hlg::A / (12.0 * e - hlg::B)
                };
                of_e * hlg::WHITE
            }
            log => log.log().map_or(1.0, |log| log.slope(linear)),
        }
    }

    /// The power by which values become light; 1 of curves that are no powers.
    fn power(self) -> f32 {
        match self {
            Self::Bt1886 => 2.4,
            Self::AdobeRgb => 563.0 / 256.0,
            Self::Prophoto => 1.8,
            _ => 1.0,
        }
    }

    fn log(self) -> Option<&'static Log> {
        Some(match self {
            Self::SLog3 => &S_LOG3,
            Self::LogC3 => &LOG_C3,
            Self::LogC4 => &LOG_C4,
            Self::VLog => &V_LOG,
            Self::Log3G10 => &LOG3_G10,
            Self::CanonLog3 => &CANON_LOG3,
            _ => return None,
        })
    }

    /// The curve in which frames of this encoding are worked on: noise is described by its std over encoded values, and light itself has
    /// hardly any values between black and middle grey, so that it is encoded as sRGB.
    pub fn worked_on(self) -> Self {
        if self == Self::Linear { Self::Srgb } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_round_trip_and_have_their_slopes() {
        assert!((Transfer::Srgb.encode(0.214_041_14) - 0.5).abs() < 1e-6); // IEC 61966-2-1
        for t in Transfer::ALL {
            for i in -10..40 {
                let v = i as f32 / 40.0;
                let lost = t.encode(t.decode(v)) - v;
                assert!(lost.abs() < 2e-5, "{t:?} {v}: {lost}");
            }
            // Close to black a difference says little.
            for v in (1..40).map(|i| t.decode(i as f32 / 40.0)).filter(|v| v.abs() > 1e-3) {
                let h = 1e-2 * v.abs();
                let numeric = (f64::from(t.encode(v + h)) - f64::from(t.encode(v - h))) / f64::from(2.0 * h);
                let slope = f64::from(t.slope(v));
                // At the point where two parts of a curve meet, the difference takes some of both.
                assert!((numeric / slope - 1.0).abs() < 0.03, "{t:?} {v}: {numeric} {slope}");
            }
        }
        // Negative control: another camera's curve is no inverse.
        let lost = Transfer::SLog3.encode(Transfer::LogC3.decode(0.6)) - 0.6;
        assert!(lost.abs() > 0.02, "{lost}");
    }

    #[test]
    fn middle_grey_is_where_the_makers_say() {
        for (t, grey) in [
            (Transfer::SLog3, 420.0 / 1023.0),
            (Transfer::LogC3, 0.391),
            (Transfer::LogC4, 0.2784),
            (Transfer::VLog, 0.423_3),
            (Transfer::Log3G10, 0.333_3),
            (Transfer::CanonLog3, 0.343),
            (Transfer::Hlg, 0.424_3),
        ] {
            assert!((t.encode(0.18) - grey).abs() < 1e-3, "{t:?}: {}", t.encode(0.18));
        }
        assert!((Transfer::Pq.encode(1.0) - 0.508_1).abs() < 1e-4);
    }
}
