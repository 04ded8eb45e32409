//! A part of the model that is known, or unknown for a reason that a person can read and a program can branch on.

use crate::text;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};

/// A part of the model: known, or unknown for a reason.
#[derive(Clone, Debug, PartialEq)]
pub enum Estimate<T> {
    /// The estimate.
    Known(T),
    /// The reason why the footage cannot tell.
    Unknown(Unknown),
}

/// The reason why a part of the model is unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknown {
    /// The reason for programs.
    pub reason: Reason,
    /// The reason for people: one clause without a full stop. A sentence read from a file is one printable line ([`text::one_line`]).
    pub sentence: String,
    /// The lowest and the highest value of the distortion's most important number that fit the footage, in that number's unit; `None` if the
    /// footage does not even tell that.
    pub fits: Option<[f32; 2]>,
}

/// The kinds of reasons for which something is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Reason {
    /// The estimate was not asked for, or was left out on purpose.
    NotEstimated,
    /// There are too few frames: one image has no motion, for instance.
    TooShort,
    /// Nothing moves, or parallax is needed and the camera only turns.
    NoMotion,
    /// Frames could not be followed to their neighbours: a cut lies between them, or too much changes.
    NotFollowed,
    /// The scene moves by itself, and the estimate needs a scene at rest.
    SceneMoves,
    /// No depth was given and none could be found.
    NoDepth,
    /// All places that could be measured lie at about one depth.
    OneDepth,
    /// The picture is too flat, too small or clipped.
    Flat,
    /// Shots, frames or parts of the picture contradict each other.
    Contradicting,
    /// What moves changes its speed or direction within few frames, as under a shaking hand.
    UnevenMotion,
    /// Values that lie far apart fit about equally well.
    Uncertain,
    /// The distortion was looked for, and no trace was found that only this distortion leaves.
    NotSeen,
    /// A file gave no reason, or one that this version does not know.
    #[default]
    #[serde(other)]
    Other,
}

impl Unknown {
    /// An unknown part with a reason for programs and a sentence for people.
    pub fn new(reason: Reason, sentence: impl Into<String>) -> Self {
        Self { reason, sentence: sentence.into(), fits: None }
    }

    /// The same, with the range of values that fit.
    pub fn with_fits(self, fits: [f32; 2]) -> Self {
        Self { fits: Some(fits), ..self }
    }
}

impl std::fmt::Display for Unknown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.sentence)
    }
}

impl<T> Estimate<T> {
    /// An unknown estimate with its reason for programs and a sentence for people.
    pub fn unknown(reason: Reason, sentence: impl Into<String>) -> Self {
        Self::Unknown(Unknown::new(reason, sentence))
    }

    /// The estimate after a function was applied to its value; an unknown estimate stays unknown.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Estimate<U> {
        match self {
            Self::Known(t) => Estimate::Known(f(t)),
            Self::Unknown(why) => Estimate::Unknown(why),
        }
    }

    /// The estimate, if it is known.
    pub fn known(&self) -> Option<&T> {
        match self {
            Self::Known(t) => Some(t),
            Self::Unknown(_) => None,
        }
    }

    /// The estimate by value, if it is known.
    pub fn into_known(self) -> Option<T> {
        match self {
            Self::Known(t) => Some(t),
            Self::Unknown(_) => None,
        }
    }

    /// The reason why the estimate is unknown; `None` if it is known.
    pub fn why_unknown(&self) -> Option<&Unknown> {
        match self {
            Self::Known(_) => None,
            Self::Unknown(why) => Some(why),
        }
    }
}

/// An unknown part as it is written in camera.json.
#[derive(Serialize, Deserialize)]
struct UnknownInFile {
    unknown: String,
    #[serde(default, skip_serializing_if = "is_other")]
    reason: Reason,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fits: Option<[f32; 2]>,
}

fn is_other(reason: &Reason) -> bool {
    *reason == Reason::Other
}

impl Serialize for Unknown {
    fn serialize<S: Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        UnknownInFile { unknown: self.sentence.clone(), reason: self.reason, fits: self.fits }.serialize(s)
    }
}

impl<T: Serialize> Serialize for Estimate<T> {
    fn serialize<S: Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Known(t) => t.serialize(s),
            Self::Unknown(why) => why.serialize(s),
        }
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Estimate<T> {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        // Serde's `untagged` is not used, since its messages do not say which field is missing.
        let value = serde_json::Value::deserialize(d)?;
        let custom = |e: serde_json::Error| serde::de::Error::custom(e);
        Ok(if value.get("unknown").is_some() {
            let UnknownInFile { unknown, reason, fits } = serde_json::from_value(value).map_err(custom)?;
            Self::Unknown(Unknown { reason, sentence: text::one_line(&unknown), fits })
        } else {
            Self::Known(serde_json::from_value(value).map_err(custom)?)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_read_back_and_one_that_is_not_known_is_another() {
        type Number = Estimate<f32>;
        let still = Number::unknown(Reason::NoMotion, "nothing moves");
        let text = serde_json::to_string(&still).unwrap();
        assert_eq!(text, r#"{"unknown":"nothing moves","reason":"no_motion"}"#);
        assert_eq!(serde_json::from_str::<Number>(&text).unwrap(), still);
        for old in [r#"{"unknown":"x"}"#, r#"{"unknown":"x","reason":"of a later version"}"#] {
            let read: Number = serde_json::from_str(old).unwrap();
            assert_eq!(read, Number::unknown(Reason::Other, "x"));
            assert_eq!(serde_json::to_string(&read).unwrap(), r#"{"unknown":"x"}"#);
        }
        assert_eq!(serde_json::from_str::<Number>("1.5").unwrap(), Estimate::Known(1.5));
        let between = Number::Unknown(Unknown::new(Reason::Uncertain, "x").with_fits([0.25, 0.75]));
        let text = serde_json::to_string(&between).unwrap();
        assert_eq!(text, r#"{"unknown":"x","reason":"uncertain","fits":[0.25,0.75]}"#);
        assert_eq!(serde_json::from_str::<Number>(&text).unwrap(), between);
    }
}
