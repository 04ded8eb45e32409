//! The depth of a camera's scene as a picture, of characters or drawn, with what is in focus.

use crate::{
    numbers::{metres, number},
    pictures::of_nearness,
    words::short,
};
use blindaug::{
    CameraModel,
    model::{DepthKind, SceneDepth, VISIBLE_PX},
};
use maud::{Markup, html};
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

/// The scene's depth as a drawing in which each cell tells its place, its depth and its blur; what is in focus has a frame.
pub(crate) fn picture(model: &CameraModel) -> Markup {
    /// The side of a cell in the drawing's own units.
    const SIDE: usize = 10;
    let Some(depth) = &model.scene_depth else { return html! {} };
    let lens = model.defocus.known();
    let known = || depth.inverse_depth.iter().flatten().copied();
    let (far, near) = known().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), d| (a.min(d), b.max(d)));
    let shown = |d: f32| match depth.kind {
        DepthKind::Metric => metres(d.into()),
        DepthKind::Relative => number(d.into()),
    };
    let cell = |(i, d): (usize, &Option<f32>)| {
        let [x, y] = depth.middle(i).map(|v| format!("{v:.0}"));
        let (column, row) = (i % depth.columns * SIDE, i / depth.columns * SIDE);
        let Some(d) = *d else {
            return html! { rect x=(column) y=(row) width=(SIDE) height=(SIDE) fill="none" { title { (x) "," (y) ": depth unknown" } } };
        };
        let sigma = lens.map(|lens| lens.sigma_px(d));
        let focused = sigma.is_some_and(|s| s < VISIBLE_PX);
        let [r, g, b] = of_nearness((d - far) / (near - far).max(1e-9)).map(|v| (255.0 * v).round() as u8);
        html! {
            rect x=(column) y=(row) width=(SIDE) height=(SIDE) fill=(format!("#{r:02x}{g:02x}{b:02x}")) {
                title { (x) "," (y) ": " (shown(d)) @if let Some(s) = sigma { ", blur " (number(s.into())) " px" } }
            }
            @if focused { rect x=(column + 2) y=(row + 2) width=(SIDE - 4) height=(SIDE - 4) fill="none" stroke="#D03A2F" stroke-width="1.5" pointer-events="none" {} }
        }
    };
    let (width, height) = (depth.columns * SIDE, depth.rows() * SIDE);
    let place = place_of(depth, near);
    html! {
        figure {
            svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {height}")) role="img" aria-label="The depth of the scene" {
                @for c in depth.inverse_depth.iter().enumerate() { (cell(c)) }
            }
            figcaption {
                "The depth that was found in frame " (depth.frame) ": dark is far (" (shown(far)) "), bright is near (" (shown(near)) "); framed: in focus, with less than "
                (number(VISIBLE_PX.into())) " px of blur. Point at a place for its numbers."
                @if depth.kind == DepthKind::Relative {
                    " Name the distance of a place, as --at " (place) "=METRES, to have this camera in metres, or let composite --match-at " (place) " blur an object like what is seen there."
                }
            }
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
        let svg = picture(&model).into_string();
        assert_eq!(svg.matches("fill=\"none\" stroke").count(), text.matches('*').count() - 1);
        assert!(svg.contains("depth unknown") && svg.contains("63,1: 0.969"), "{svg}");
        // Negative control: in metres nothing is asked for.
        let metric = model.to_metric(blindaug::model::SceneScale { scale: 1.0, offset: 0.0 });
        assert!(!drawn(&metric).contains("--at"));
    }
}
