//! docs/camera-json.md names every field and every name that files of cameras can have, and no other fields.

use blindaug::model::{
    Aperture, BlurSpace, Bokeh, CameraModel, Capture, Changes, CurveLevel, DefocusCurve, DefocusModel,
    DepthKind, Distortion, Estimate, ExposureFraction, Method, MotionBlurModel, NOISE_LEVELS, NoiseCurves,
    NoiseInterval, NoiseLevel, NoiseModel, Reason, SceneDepth, SharpeningModel, Stopped, ThinLensInterval,
    TrackedCamera, Unknown,
};
use blindaug::{Transfer, model};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

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

/// The fields of lines of files, at all depths, by the heading of [`sections`] under which the page must name them.
fn by_heading(lines: &[Value]) -> BTreeMap<&str, BTreeSet<String>> {
    let sections = sections();
    let mut found: BTreeMap<_, BTreeSet<String>> = BTreeMap::new();
    for (name, value) in lines.iter().flat_map(|line| line.as_object().unwrap()) {
        let heading = match name.as_str() {
            _ if value.get("unknown").is_some() => "Unknown",
            "frame" | "changed" => "Over time",
            name if sections.contains_key(name) => name,
            _ => "",
        };
        let of_name = if heading == "Over time" { heading } else { "" };
        found.entry(of_name).or_default().insert(name.clone());
        fields(value, found.entry(heading).or_default());
    }
    found
}

/// The text of the page under each heading; that before the first one has none.
fn sections() -> BTreeMap<&'static str, &'static str> {
    let with_heading = |text: &'static str| text.split_once('\n').unwrap();
    let mut parts = PAGE.split("\n## ");
    let first = parts.next().unwrap();
    [("", first)].into_iter().chain(parts.map(with_heading)).collect()
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
fn the_page_names_all_fields_where_they_belong_and_no_others() {
    let cameras = cameras();
    for camera in &cameras {
        assert_eq!(&CameraModel::from_json(&camera.to_json()).unwrap(), camera);
    }
    let sections = sections();
    let lines: Vec<Value> = cameras.iter().map(line).collect();
    let headings = by_heading(&lines);
    assert!(sections.keys().all(|heading| *heading == "Methods" || headings.contains_key(heading)));
    for (heading, fields) in headings {
        let text = sections[heading];
        let named: BTreeSet<&str> = quoted(text).flat_map(|q| q.split('[')).collect();
        let missing: Vec<_> = fields.iter().filter(|f| !named.contains(f.as_str())).collect();
        assert!(missing.is_empty(), "under {heading:?} the page does not name {missing:?}");
        let first_columns = text.lines().filter(|l| l.starts_with("| `")).filter_map(|l| l.split('|').nth(1));
        let gone: Vec<_> = first_columns.flat_map(quoted).filter(|f| !fields.contains(*f)).collect();
        assert!(gone.is_empty(), "under {heading:?} the page names {gone:?}, which no file has");
    }
}

/// What the fields of text can say.
fn names() -> BTreeSet<String> {
    use Method::{Given, Removal, Spatial, Spectral, Temporal};
    let of = |value: serde_json::Result<Value>| match value.unwrap() {
        Value::String(name) => name,
        shape => shape["shape"].as_str().expect("it has a shape").to_owned(),
    };
    let polygon = Bokeh::Polygon { blades: 3, roundness: 0.0, rotation_degrees: 0.0 };
    let mut names = BTreeSet::new();
    names.extend(Transfer::ALL.iter().map(|v| of(serde_json::to_value(v))));
    names.extend([BlurSpace::Linear, BlurSpace::Encoded].iter().map(|v| of(serde_json::to_value(v))));
    names.extend([DepthKind::Metric, DepthKind::Relative].iter().map(|v| of(serde_json::to_value(v))));
    names.extend([Temporal, Spatial, Spectral, Removal, Given].iter().map(|v| of(serde_json::to_value(v))));
    names.extend([Bokeh::Gaussian, Bokeh::Disk, polygon].iter().map(|v| of(serde_json::to_value(v))));
    names
}

#[test]
fn the_page_names_what_text_can_say_and_nothing_else() {
    let on_the_page: BTreeSet<&str> = quoted(PAGE).collect();
    let names = names();
    let missing: Vec<_> = names.iter().filter(|n| !on_the_page.contains(n.as_str())).collect();
    assert!(missing.is_empty(), "the page does not name {missing:?}");
    let of_reasons = PAGE.lines().find(|line| line.starts_with("| `reason`")).expect("there is a row");
    let reasons: Vec<&str> = quoted(of_reasons).skip(1).collect();
    let is_reason =
        |name: &&&str| serde_json::from_value::<Reason>((**name).into()).unwrap() != Reason::Other;
    assert!(reasons.len() > 10 && reasons.iter().all(|r| is_reason(&r)), "{reasons:?}");
    let mut known = names;
    known.extend(reasons.into_iter().map(String::from));
    cameras().iter().for_each(|camera| fields(&line(camera), &mut known));
    // Two commands, and the names of curves, which are no field's but a tag's.
    known.extend(["estimate", "inspect", "thin_lens", "quadratic"].map(String::from));
    let is_name = |word: &&&str| word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
    let gone: Vec<_> = on_the_page.iter().filter(is_name).filter(|w| !known.contains(**w)).collect();
    assert!(gone.is_empty(), "the page has {gone:?}, which are neither fields nor what fields say");
    let [knots @ .., last] = model::KNOTS.map(|k| k.to_string());
    let list = format!("{} and {last}", knots.join(", "));
    assert!(PAGE.contains(&list), "the page does not have the points of curves: {list}");
}
