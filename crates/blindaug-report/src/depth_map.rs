//! The depth of a camera's scene as a picture of characters, with what is in focus.

use crate::words::short;
use blindaug::{
    CameraModel,
    model::{DepthKind, SceneDepth, VISIBLE_PX},
};
use std::fmt::Write;

/// The scene's depth as lines of text, and how to bring it to metres if it is relative; empty if the model holds none.
pub(crate) fn words(text: &mut String, model: &CameraModel) -> std::fmt::Result {
    let Some(depth) = &model.scene_depth else { return Ok(()) };
    let known = || depth.inverse_depth.iter().flatten().copied();
    let (far, near) = known().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), d| (a.min(d), b.max(d)));
    let focused = |d: f32| model.defocus.known().is_some_and(|lens| lens.sigma_px(d) < VISIBLE_PX);
    writeln!(
        text,
        "Depth      found in frame {}: 9 is nearest, 0 farthest, * in focus (blur below {VISIBLE_PX} px), . unknown; a character is {} px",
        depth.frame,
        short(depth.cell_px.into())
    )?;
    for row in depth.inverse_depth.chunks(depth.columns) {
        let character = |d: &Option<f32>| match d {
            None => '.',
            Some(d) if focused(*d) => '*',
            Some(d) => {
                let nearness = ((d - far) / (near - far).max(1e-9) * 9.0).round().clamp(0.0, 9.0);
                char::from(b'0' + nearness as u8)
            }
        };
        writeln!(text, "             {}", row.iter().map(character).collect::<String>())?;
    }
    match depth.kind {
        DepthKind::Metric => {
            let [far, near] =
                [far, near].map(|d| if d > 1e-3 { format!("{:.2} m", 1.0 / d) } else { "infinity".into() });
            writeln!(text, "           from {near} to {far}")
        }
        DepthKind::Relative => {
            let [a, b] = [near, far].map(|d| place_of(depth, d));
            writeln!(
                text,
                "           it has no unit: name the distance of one place, or better of two, as --at {a}=METRES --at {b}=METRES (estimate, \
                 composite, apply), or blur an object like what is seen at a place: composite --match-at X,Y"
            )
        }
    }
}

/// The middle of the first cell of this inverse depth, as X,Y.
fn place_of(depth: &SceneDepth, d: f32) -> String {
    let cell = depth.inverse_depth.iter().position(|v| *v == Some(d)).unwrap_or(0);
    let [x, y] = depth.middle(cell);
    format!("{x:.0},{y:.0}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::{
        Plane,
        model::{Capture, DefocusModel, Estimate},
    };

    #[test]
    fn the_depth_is_drawn_with_what_is_in_focus() {
        let capture = Capture { width: 64, height: 32, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let mut model = CameraModel::unknown(capture, "test");
        let lens = DefocusModel { depth_kind: DepthKind::Relative, ..DefocusModel::given_lens(20.0, 0.5) };
        model.defocus = Estimate::Known(lens);
        // Nearer to the right; the middle is in focus, and nothing is known below.
        let plane = Plane::from_fn(64, 32, |x, y| if y < 16 { (x / 2) as f32 / 32.0 } else { f32::NAN });
        let drawn = |model: &CameraModel| {
            let mut text = String::new();
            words(&mut text, model).unwrap();
            text
        };
        assert_eq!(drawn(&model), "");
        model.scene_depth = SceneDepth::of(&plane, DepthKind::Relative, 12);
        let text = drawn(&model);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].contains("frame 12") && lines[0].contains("2 px"), "{text}");
        let row = lines[1].trim();
        assert!(row.starts_with("00") && row.ends_with("99") && row.len() == 32, "{text}");
        assert_eq!(row.find('*'), Some(16), "{text}");
        assert_eq!(lines[16].trim(), ".".repeat(32));
        assert!(text.contains("--at 63,1=METRES --at 1,1=METRES"), "{text}");
        // Negative control: in metres nothing is asked for.
        let metric = model.to_metric(blindaug::model::SceneScale { scale: 1.0, offset: 0.0 });
        assert!(!drawn(&metric).contains("--at"));
    }
}
