//! docs/camera-json.md names every field and every name that files of cameras can have, and no other fields.

use blindaug::model::{
    Aperture, BlurSpace, Bokeh, CameraModel, Capture, Changes, CurveLevel, DefocusCurve, DefocusModel,
    DepthKind, Distortion, Estimate, ExposureFraction, Method, MotionBlurModel, NOISE_LEVELS, NoiseCurves,
    NoiseInterval, NoiseLevel, NoiseModel, Reason, SceneDepth, SharpeningModel, Stopped, ThinLensInterval,
    TrackedCamera, Unknown,
};
use blindaug::{Transfer, model};
use serde_json::Value;
use std::collections::BTreeSet;

const PAGE: &str = include_str!("../../../docs/camera-json.md");

/// The names of the fields of a JSON value, at all depths.
fn fields(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(object) => {
            for (name, value) in object {
                found.insert(name.clone());
                fields(value, found);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| fields(value, found)),
        _ => {}
    }
}

/// Cameras that have, together, every field.
fn cameras() -> Vec<CameraModel> {
    let capture = Capture { width: 64, height: 48, fps: Some(24.0), frames_used: 5, pixel_aspect: 2.0 };
    let mut unknown = CameraModel::unknown(capture, "not asked for");
    unknown.motion_blur =
        Estimate::Unknown(Unknown::new(Reason::Uncertain, "much fits").with_fits([0.1, 0.9]));
    let mut known = unknown.clone();
    known.stopped = Some(Stopped { after: 3, of: Some(9) });
    known.warnings = vec!["one frame only".into()];
    let levels = [NoiseLevel { slope: [0.0; 3], intercept: [0.01; 3] }; NOISE_LEVELS];
    let mut lines = NoiseModel::given(levels, 1.0).lines().clone();
    lines.interval = Some([NoiseInterval::default(); NOISE_LEVELS]);
    let levels = [CurveLevel::default(); NOISE_LEVELS];
    let curves = NoiseCurves { lines, levels, temporal_correlation: 0.5 };
    known.noise = Estimate::Known(NoiseModel::Curves(Box::new(curves)));
    let shutter = MotionBlurModel::given(ExposureFraction(0.5));
    known.motion_blur = Estimate::Known(MotionBlurModel { phase_degrees: Some(0.0), ..shutter });
    let interval = ThinLensInterval { sigma_px_at_infinity: [1.0, 3.0], focus_inverse_depth: [0.4, 0.6] };
    let thin_lens = DefocusCurve::ThinLens {
        sigma_px_at_infinity: 2.0,
        focus_inverse_depth: 0.5,
        interval: Some(interval),
    };
    let bokeh = Bokeh::Polygon { blades: 7, roundness: 0.5, rotation_degrees: 10.0 };
    known.defocus = Estimate::Known(DefocusModel {
        bokeh: Aperture { bokeh, squeeze: 2.0, cats_eye: 0.5 },
        inverse_depth_seen: Some([0.1, 1.0]),
        ..DefocusModel::given(thin_lens, DepthKind::Metric)
    });
    known.sharpening = Estimate::Known(SharpeningModel::given(1.0, 1.0));
    known.scene_depth = Some(SceneDepth {
        frame: 1,
        kind: DepthKind::Metric,
        cell_px: 16.0,
        columns: 1,
        inverse_depth: vec![Some(0.5)],
    });
    let mut of_the_paper = unknown.clone();
    let quadratic = DefocusCurve::Quadratic { a: 1.0, b: 0.0, c: 0.0, inverse_depth_range: [0.0, 1.0] };
    of_the_paper.defocus = Estimate::Known(DefocusModel::given(quadratic, DepthKind::Relative));
    vec![unknown, known, of_the_paper]
}

/// A line of a file of per-frame cameras in which everything has changed.
fn line(camera: &CameraModel) -> Value {
    let mut changed = Changes::default();
    Distortion::ALL.into_iter().for_each(|d| changed.set(d, true));
    let line = TrackedCamera { frame: 7, changed, camera: camera.clone() }.to_json_line();
    serde_json::from_str(&line).unwrap()
}

/// What stands between backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

#[test]
fn the_page_names_all_fields_and_no_others() {
    let mut in_files = BTreeSet::new();
    for camera in cameras() {
        assert_eq!(CameraModel::from_json(&camera.to_json()).unwrap(), camera);
        fields(&line(&camera), &mut in_files);
    }
    let on_the_page: BTreeSet<&str> = quoted(PAGE).flat_map(|q| q.split(['[', ' '])).collect();
    let missing: Vec<_> = in_files.iter().filter(|f| !on_the_page.contains(f.as_str())).collect();
    assert!(missing.is_empty(), "the page does not name {missing:?}");
    let first_columns = PAGE.lines().filter(|l| l.starts_with("| `")).filter_map(|l| l.split('|').nth(1));
    let gone: Vec<_> = first_columns.flat_map(quoted).filter(|f| !in_files.contains(*f)).collect();
    assert!(gone.is_empty(), "no file has {gone:?}");
}

#[test]
fn the_page_names_what_text_fields_can_say() {
    let on_the_page: BTreeSet<&str> = quoted(PAGE).collect();
    let name = |value: Value| match value {
        Value::String(name) => name,
        other => other["shape"].as_str().expect("it has a shape").into(),
    };
    let mut names = vec![];
    let mut add = |value: serde_json::Result<Value>| names.push(name(value.unwrap()));
    Transfer::ALL.iter().for_each(|v| add(serde_json::to_value(v)));
    [BlurSpace::Linear, BlurSpace::Encoded].iter().for_each(|v| add(serde_json::to_value(v)));
    [DepthKind::Metric, DepthKind::Relative].iter().for_each(|v| add(serde_json::to_value(v)));
    use Method::{Given, Removal, Spatial, Spectral, Temporal};
    [Temporal, Spatial, Spectral, Removal, Given].iter().for_each(|v| add(serde_json::to_value(v)));
    use Reason::*;
    let reasons = [
        NotEstimated,
        TooShort,
        NoMotion,
        NotFollowed,
        SceneMoves,
        NoDepth,
        OneDepth,
        Flat,
        Contradicting,
        UnevenMotion,
        Uncertain,
        NotSeen,
    ];
    reasons.iter().for_each(|v| add(serde_json::to_value(v)));
    let polygon = Bokeh::Polygon { blades: 3, roundness: 0.0, rotation_degrees: 0.0 };
    [Bokeh::Gaussian, Bokeh::Disk, polygon].iter().for_each(|v| add(serde_json::to_value(v)));
    let missing: Vec<_> = names.iter().filter(|n| !on_the_page.contains(n.as_str())).collect();
    assert!(missing.is_empty(), "the page does not name {missing:?}");
    let knots = model::KNOTS.map(|k| k.to_string());
    assert!(knots.iter().all(|k| PAGE.contains(k)), "the page does not have the points of curves, {knots:?}");
}
