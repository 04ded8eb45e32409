//! What makes a model's numbers less sure than their intervals say, in words: [`CameraModel::warnings`](crate::model::CameraModel::warnings).

use super::noise::LumaNoise;

/// A model of so many frames rests on few, if it does.
pub(super) fn few_frames(frames: usize) -> Option<String> {
    /// A model of at least as many frames rests on enough of them.
    const ENOUGH: usize = 5;
    let few = match frames {
        1 => "one frame".into(),
        few if few < ENOUGH => format!("{few} frames"),
        _ => return None,
    };
    Some(format!("the model rests on {few} only: more frames would make it surer"))
}

/// The footage was compressed or denoised, if its noise says so. `coding_spread` is that of
/// [`NoiseFit`](super::noise::NoiseFit::coding_spread), `frames` the number of frames that were looked at.
pub(super) fn coding_warning(luma: Option<&LumaNoise>, coding_spread: f32, frames: usize) -> Option<String> {
    if let Some(LumaNoise { coding_error, .. }) = luma.filter(|luma| luma.is_compressed()) {
        return Some(format!(
            "there is less noise than a sensor has, or none of it in chroma: the footage was compressed or denoised, and detail weaker than {:.1} % of full scale is not relied on for blur",
            100.0 * coding_error
        ));
    }
    let why = match frames {
        _ if coding_spread <= 0.0 => return None,
        1 => "some of the picture has hardly any noise",
        _ => {
            "some of the picture has hardly any noise, or much of it is the same in successive frames to the last bit"
        }
    };
    Some(format!(
        "{why}: if it was compressed, a flat surface in it may have less or more noise, as the interval says"
    ))
}
