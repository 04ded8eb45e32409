//! ICC profiles, which images carry to say what their values mean.

use crate::{Error, Result, error::guarded, files::read_file};
use blindaug::{
    Transfer,
    colour_space::{ColourSpace, Primaries},
    text::{cut, one_line},
};
use moxcms::{ColorProfile, DataColorSpace, ParametricCurve, ProfileText, ToneReprCurve, Xyzd};
use std::{path::Path, sync::Arc};

/// The most bytes of a profile that is read from a file of its own.
const MAX_PROFILE: u64 = 4 << 20;

/// What can be done about a profile that cannot be believed.
const WHAT_TO_DO: &str = "convert the image to sRGB, Display P3 or Adobe RGB in the program that made it, or say which colour space it is in";

/// The ICC profile of an image, as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct IccProfile {
    bytes: Arc<[u8]>,
    name: String,
    /// The colour space, or what the profile is instead of one that is known here.
    space: std::result::Result<ColourSpace, &'static str>,
}

impl IccProfile {
    /// Reads a profile from a file of its own.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::of(path, &read_file(path, MAX_PROFILE)?)
    }

    /// The profile that a file holds.
    ///
    /// # Errors
    /// If the profile is damaged.
    pub(crate) fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let damaged = Error::new(path, format!("its ICC profile is damaged or cut short: {WHAT_TO_DO}"));
        // The head tells how many bytes there are: what was cut between two tags could be read as a whole profile.
        let told = bytes.first_chunk().map_or(0, |b| u32::from_be_bytes(*b));
        let parsed = guarded(path, || {
            let profile = ColorProfile::new_from_slice(bytes).ok();
            Ok(profile.map(|p| Self { bytes: bytes.into(), name: name_of(&p), space: space_of(&p) }))
        });
        match parsed {
            Ok(Some(profile)) if bytes.len() as u64 >= u64::from(told) => Ok(profile),
            _ => Err(damaged),
        }
    }

    /// The bytes of the profile.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The name that the profile gives to itself, on one line; empty if it gives none.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The colour space of the values of a file that holds this profile.
    ///
    /// # Errors
    /// If the profile is not one of three colours, or grey, with a curve that is known here. The sentence says what to do about the file.
    pub fn space(&self, path: impl AsRef<Path>) -> Result<ColourSpace> {
        let named = if self.name.is_empty() { String::new() } else { format!(" ({})", self.name) };
        self.space.map_err(|what| {
            Error::new(path, format!("its ICC profile{named} {what}, which is not read: {WHAT_TO_DO}"))
        })
    }
}

fn name_of(profile: &ColorProfile) -> String {
    let text = match &profile.description {
        Some(ProfileText::PlainString(text)) => text,
        Some(ProfileText::Localizable(texts)) => {
            let english = texts.iter().find(|t| t.language == "en").or(texts.first());
            english.map_or("", |t| &t.value)
        }
        Some(ProfileText::Description(text)) => &text.ascii_string,
        None => "",
    };
    one_line(&cut(text.trim_end_matches('\0').trim(), 80))
}

/// The colour space of a profile of three colours with a curve each, or of grey; else what it is instead.
fn space_of(profile: &ColorProfile) -> std::result::Result<ColourSpace, &'static str> {
    let tables =
        [&profile.lut_a_to_b_perceptual, &profile.lut_a_to_b_colorimetric, &profile.lut_a_to_b_saturation];
    if matches!(profile.color_space, DataColorSpace::Cmyk) {
        return Err("is one of printing inks (CMYK)");
    }
    if tables.iter().any(|table| table.is_some()) {
        return Err("converts colours by a table (LUT)");
    }
    let curve = |curve: &Option<ToneReprCurve>| curve.as_ref().and_then(transfer_of);
    let unknown = "has a curve that is none of sRGB, Adobe RGB, ProPhoto, BT.1886 or light";
    match profile.color_space {
        DataColorSpace::Gray => {
            let transfer = curve(&profile.gray_trc).ok_or(unknown)?;
            Ok(ColourSpace { transfer, ..ColourSpace::SRGB })
        }
        DataColorSpace::Rgb => {
            let curves = [&profile.red_trc, &profile.green_trc, &profile.blue_trc];
            let [Some(transfer), green, blue] = curves.map(curve) else { return Err(unknown) };
            if [green, blue] != [Some(transfer); 2] {
                return Err(unknown);
            }
            let colorants = [profile.red_colorant, profile.green_colorant, profile.blue_colorant];
            let primaries = Primaries::of_icc(colorants.map(|Xyzd { x, y, z }| [x, y, z]));
            let primaries = primaries.map_err(|_| "has colours that span no space")?;
            Ok(ColourSpace { primaries, transfer })
        }
        _ => Err("is not one of red, green and blue"),
    }
}

/// The light of a value by a profile's curve; NaN if it is none.
fn light(curve: &ToneReprCurve, v: f32) -> f32 {
    match curve {
        ToneReprCurve::Lut(table) => match table[..] {
            [] => v,
            // The power, in 1/256.
            [power] => v.powf(f32::from(power) / 256.0),
            [.., _, _] => {
                let at = v * (table.len() - 1) as f32;
                let i = (at as usize).min(table.len() - 2);
                let [a, b] = [table[i], table[i + 1]].map(|entry| f32::from(entry) / 65535.0);
                a + (at - i as f32) * (b - a)
            }
        },
        ToneReprCurve::Parametric(numbers) => {
            ParametricCurve::new(numbers).map_or(f32::NAN, |curve| curve.eval(v))
        }
    }
}

/// The curve that this one is, but for roundings.
fn transfer_of(curve: &ToneReprCurve) -> Option<Transfer> {
    /// The largest difference of light. Profiles store powers in steps of 1/256 and tables of as few as 256 entries.
    const ROUNDING: f32 = 6e-4;
    const STEPS: usize = 256;
    let known = [Transfer::Srgb, Transfer::Linear, Transfer::Bt1886, Transfer::AdobeRgb, Transfer::Prophoto];
    let is = |t: &Transfer| {
        let at = (0..=STEPS).map(|i| i as f32 / STEPS as f32);
        at.map(|v| (light(curve, v) - t.decode(v)).abs()).all(|apart| apart < ROUNDING)
    };
    known.into_iter().find(is)
}
