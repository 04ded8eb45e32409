//! Tests of exported settings: each file is parsed by a parser of its language, and the numbers are put into the tool's own formulas.

use blindaug::CameraModel;
use blindaug::export::{Camera, Content, Export, Target, View, av1_grain, grain, probes};
use blindaug::model::{
    Aperture, Bokeh, Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction,
    MotionBlurModel, NOISE_LEVELS, NoiseLevel, NoiseModel,
};

fn camera_model(exposure: f32, sigma: f32, focus_m: f32) -> CameraModel {
    let capture = Capture { width: 1920, height: 1080, fps: Some(25.0), frames_used: 9, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "nobody looked");
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
    model.defocus = Estimate::Known(DefocusModel::given_lens(sigma, focus_m.recip()));
    let levels: [NoiseLevel; NOISE_LEVELS] = std::array::from_fn(|l| {
        let share = [1.0, 0.8, 0.5, 0.2][l];
        NoiseLevel { slope: [0.010 * share, 0.008 * share, 0.016 * share], intercept: [0.006 * share; 3] }
    });
    model.noise = Estimate::Known(NoiseModel::given(levels, 1.0));
    model
}

fn exported(model: &CameraModel, target: Target) -> Export {
    let view = View { fov_y_degrees: Some(34.0), ..View::default() };
    target.export(&Camera::new(model, &view).unwrap())
}

fn text(export: &Export) -> &str {
    match &export.files[0].content {
        Content::Text(text) => text,
        Content::Texture(_) => panic!("{} is no text", export.files[0].name),
    }
}

/// The first number after `key` in a text.
fn value(text: &str, key: &str) -> f32 {
    let at = text.find(key).unwrap_or_else(|| panic!("there is no {key:?} in:\n{text}")) + key.len();
    let rest = text[at..].trim_start_matches(|c: char| !(c.is_ascii_digit() || c == '-'));
    let end = rest.find(|c: char| !(c.is_ascii_digit() || ".e-".contains(c))).unwrap_or(rest.len());
    rest[..end]
        .trim_end_matches('.')
        .parse()
        .unwrap_or_else(|_| panic!("{key:?} is followed by no number in:\n{text}"))
}

const W: f32 = 1920.0;
const H: f32 = 1080.0;

/// The blur, as a std in px over depth in m, that an engine's own formula gives with the exported settings.
fn blur_of(target: Target, text: &str) -> Box<dyn Fn(f32) -> f32> {
    let v = |key: &str| value(text, key);
    // `tan` is half the picture's height over the focal length.
    let tan = (0.5 * 34.0f32.to_radians()).tan();
    match target {
        Target::UnityUrp => {
            let (p, f, n) = (v("focusDistance.Override"), v("focalLength.Override"), v("aperture.Override"));
            let max_coc = f / n * (f / 1000.0) / (p - f / 1000.0);
            Box::new(move |z| 7.0 * ((1.0 - p / z) * max_coc).clamp(-1.0, 1.0).abs())
        }
        Target::UnityHdrp => {
            let (p, f, n) = (v("camera.focusDistance"), v("camera.focalLength"), v("camera.aperture"));
            let (near, far) = (v("nearMaxBlur"), v("farMaxBlur"));
            let max_coc = f / n * (f / 1000.0) / (p - f / 1000.0);
            Box::new(move |z| {
                let coc = ((1.0 - p / z) * max_coc).clamp(-1.0, 1.0);
                let most = if coc < 0.0 { near } else { far };
                0.5 * 2.0 * most * H / 1080.0 * coc.abs()
            })
        }
        Target::Unreal => {
            let (n, p) = (v("depth_of_field_fstop"), v("depth_of_field_focal_distance") / 100.0);
            let sensor = v("depth_of_field_sensor_width") / 1000.0;
            let f = 0.5 * sensor / (tan * W / H);
            let coc = f * f / (n * (p - f));
            Box::new(move |z| 0.5 * (W * ((z - p) / z).abs() * 0.5 * coc / sensor).min(0.025 * W))
        }
        Target::Godot => {
            let (amount, p) = (v("dof_blur_amount"), v("dof_blur_far_distance"));
            assert_eq!(v("dof_blur_near_distance"), p);
            assert!(v("dof_blur_far_transition") < 0.0 && v("dof_blur_near_transition") < 0.0);
            Box::new(move |z| 0.5 * (64.0 * amount * (z - p).abs() / z).min(32.0))
        }
        Target::Bevy => {
            let (p, h, n) = (v("focal_distance"), v("sensor_height"), v("aperture_f_stops"));
            let most = v("max_circle_of_confusion_diameter");
            let f = 0.5 * h / tan;
            Box::new(move |z| {
                let c = H * f * f / (h * n) * (z - p).abs() / (z * (p - f));
                0.743 * c.min(most) / 4.0
            })
        }
        Target::Filament => {
            let (p, n) = (v("setFocusDistance"), v("camera.getAperture()"));
            let f = 0.5 * 0.024 / tan;
            Box::new(move |z| {
                let c = H / 0.024 * (f / n) * f / (p - f) * (1.0 - p / z).abs();
                if c < 1.0 { 0.0 } else { c.min(64.0) / 4.0 }
            })
        }
        Target::Blender => {
            // The formulas are those of the exported script.
            let (sigma, p, height, fov) = (
                v("\"sigma_px_at_infinity\":"),
                v("\"focus_m\":"),
                v("\"height\":"),
                v("\"fov_y_degrees\":").to_radians(),
            );
            let per_height = 0.5 / (0.5 * fov).tan();
            let f = 0.024 * per_height;
            let n = f * per_height / (4.0 * sigma / height * p);
            // Rays come from a disk of diameter f / N through the plane in focus, whose visible height is P / per_height.
            Box::new(move |z| f / n * (z - p).abs() / z / (p / per_height) * H / 4.0)
        }
        Target::Three => {
            let at = &text[text.find("export const depthOfField").unwrap()..];
            let (p, f, scale) =
                (value(at, "focusDistance:"), value(at, "focalLength:"), value(at, "bokehScale:"));
            Box::new(move |z| {
                let t = ((z - p).abs() / f).clamp(0.0, 1.0);
                let coc = t * t * (3.0 - 2.0 * t);
                // The result mixes the sharp picture with a blurred, dilated one of half the resolution.
                let (b, r) = ((2.0 * coc).min(1.0), scale * coc);
                (b * (r * r / 4.0 + 1.7) + b * (1.0 - b) * 0.64 * r * r).sqrt()
            })
        }
        Target::Nuke => {
            let nodes = read_nk(text).unwrap();
            let defocus = nodes[0].of_class("ZDefocus2");
            let [p, size, most] = ["center", "size", "max_size"].map(|k| nodes[0].evaluated(defocus.knob(k)));
            Box::new(move |z| 0.5 * (size * (1.0 - p / z).abs()).min(most))
        }
        _ => panic!("{target} has no blur"),
    }
}

const WITH_BLUR: [Target; 9] = [
    Target::UnityUrp,
    Target::UnityHdrp,
    Target::Unreal,
    Target::Godot,
    Target::Bevy,
    Target::Filament,
    Target::Blender,
    Target::Three,
    Target::Nuke,
];

/// The mean and the largest difference of the exported blur from the model's over the depths of [`probes`], px.
fn blur_error(target: Target, model: &CameraModel) -> (f32, f32) {
    let export = exported(model, target);
    let blur = blur_of(target, text(&export));
    let wanted = model.defocus.known().unwrap();
    let focus = match wanted.curve {
        DefocusCurve::ThinLens { focus_inverse_depth, .. } => focus_inverse_depth.recip(),
        DefocusCurve::Quadratic { .. } => 2.0,
    };
    let errors: Vec<f32> = probes(focus).map(|z| (blur(z) - wanted.sigma_px(z.recip())).abs()).collect();
    (errors.iter().sum::<f32>() / errors.len() as f32, errors.iter().copied().fold(0.0, f32::max))
}

#[test]
fn the_tool_s_own_formula_gives_the_model_s_blur_back() {
    for (sigma, focus) in [(4.0, 3.0), (1.2, 0.6), (6.5, 12.0)] {
        let model = camera_model(0.5, sigma, focus);
        for target in WITH_BLUR {
            let (mean, worst) = blur_error(target, &model);
            println!("sigma {sigma} px, focus {focus} m, {target}: mean {mean:.4} px, worst {worst:.4} px");
            let lost = exported(&model, target).lost.iter().any(|s| s.contains("blur differs"));
            match target {
                // Three.js has no thin lens, and the export says so.
                Target::Three => assert!(lost && worst < 0.7 * sigma),
                // Filament does not blur below a diameter of 1 px.
                Target::Filament => assert!(worst < 0.26),
                _ => assert!(worst < 0.01 && !lost, "{target}: {worst} px"),
            }
        }
        // Negative control: the settings of a camera with stronger blur give a stronger blur.
        let other = camera_model(0.5, 1.2 * sigma, focus);
        // Below a std of 1.3 px, the blur of three.js hardly depends on its settings.
        for target in WITH_BLUR.into_iter().filter(|t| *t != Target::Three || sigma > 2.0) {
            let [this, other] =
                [&model, &other].map(|m| blur_of(target, text(&exported(m, target)))(10.0 * focus));
            assert!((other / this - 1.2).abs() < 0.15, "{target}: {this} {other}");
        }
    }
}

#[test]
fn clamps_that_are_hit_are_told() {
    let strong = camera_model(0.5, 30.0, 2.0);
    for target in [Target::UnityUrp, Target::UnityHdrp, Target::Godot, Target::Unreal, Target::Filament] {
        let (_, worst) = blur_error(target, &strong);
        assert!(worst > 1.0, "{target}");
        let lost = exported(&strong, target).lost;
        assert!(lost.iter().any(|s| s.contains("blur differs from the model's")), "{target}: {lost:?}");
    }
    for target in [Target::Bevy, Target::Blender, Target::Nuke] {
        assert!(blur_error(target, &strong).1 < 0.05, "{target}");
    }
}

#[test]
fn exposure_by_target_as_is_known() {
    let model = camera_model(0.5, 4.0, 3.0);
    for (target, key, want) in [
        (Target::UnityUrp, "motionBlur.intensity.Override", 0.25),
        (Target::UnityHdrp, "motionBlur.intensity.Override", 1.0),
        (Target::Unreal, "\"motion_blur_amount\":", 0.5),
        (Target::Unreal, "a shutter angle of", 180.0),
        (Target::Godot, "motion_blur_intensity =", 0.5),
        (Target::Bevy, "shutter_angle:", 0.5),
        (Target::Blender, "\"exposure\":", 0.5),
        (Target::Three, "exposure:", 0.5),
        (Target::Nuke, "\n exposure", 0.5),
    ] {
        let export = exported(&model, target);
        assert!((value(text(&export), key) - want).abs() < 1e-6, "{target}: {key}");
    }
}

#[test]
fn the_shutter_s_phase_is_a_position_in_blender_and_told_elsewhere() {
    // An exposure of 0.5 is 180 degrees long.
    for (phase, position, told) in [
        (None, "CENTER", None),
        (Some(-90.0), "CENTER", None),
        (Some(0.0), "START", None),
        (Some(-180.0), "END", None),
        (Some(-10.0), "START", Some("off by 0.0278 of the frame interval")),
    ] {
        let mut model = camera_model(0.5, 4.0, 3.0);
        let given = MotionBlurModel::given(ExposureFraction(0.5));
        model.motion_blur = Estimate::Known(MotionBlurModel { phase_degrees: phase, ..given });
        let export = exported(&model, Target::Blender);
        assert!(text(&export).contains(&format!("\"position\": \"{position}\"")), "{phase:?}");
        let off = export.lost.iter().find(|s| s.contains("the middle of the exposure"));
        assert_eq!(off.is_some(), told.is_some(), "{phase:?}: {off:?}");
        assert!(told.is_none_or(|told| off.unwrap().contains(told)), "{off:?}");
        let nuke = exported(&model, Target::Nuke).lost;
        let left = nuke.iter().any(|s| s.contains("the shutter's phase is not exported"));
        assert_eq!(left, position != "CENTER", "{phase:?}");
    }
}

#[test]
fn unity_s_grain_gives_the_model_s_std_where_it_can() {
    let model = camera_model(0.5, 4.0, 3.0);
    let noise = model.noise.known().unwrap();
    for target in [Target::UnityUrp, Target::UnityHdrp] {
        let export = exported(&model, target);
        let (intensity, response) = (
            value(text(&export), "grain.intensity.Override"),
            value(text(&export), "grain.response.Override"),
        );
        let Some(Content::Texture(tile)) =
            export.files.iter().find(|f| f.name == grain::TILE).map(|f| &f.content)
        else {
            panic!("there is no texture")
        };
        let t = model.transfer;
        for y in [0.3f32, 0.5, 0.7] {
            let light = t.decode(y);
            // Unity's ApplyGrain is applied to every texel, and the result is encoded again.
            let squares: f32 = tile
                .data()
                .iter()
                .map(|texel| {
                    let g = (texel[3] - 0.5) * 2.0;
                    let out = light
                        + light * g * (4.0 * intensity) * (1.0 + response * ((1.0 - light.sqrt()) - 1.0));
                    (t.encode(out) - y).powi(2)
                })
                .sum();
            let std = (squares / tile.data().len() as f32).sqrt();
            let want = (noise.total_std(y).iter().map(|s| s * s).sum::<f32>() / 3.0).sqrt();
            println!("{target}, luminance {y}: {std:.5} for {want:.5}");
            assert!((std / want - 1.0).abs() < 0.25, "{target} at {y}: {std} for {want}");
        }
    }
}

/// Fails on the first error or missing node of a syntax tree.
fn parse(language: tree_sitter::Language, name: &str, source: &str) -> Result<(), String> {
    let mut parser = tree_sitter::Parser::new();
    parser.set_language(&language).unwrap();
    let tree = parser.parse(source, None).unwrap();
    if !tree.root_node().has_error() {
        return Ok(());
    }
    let mut cursor = tree.walk();
    let mut at = tree.root_node();
    while let Some(child) = at.children(&mut cursor).find(|c| c.has_error()) {
        at = child;
    }
    Err(format!("{name}, line {}: {}", at.start_position().row + 1, &source[at.byte_range()]))
}

/// A node of Nuke.
#[derive(Debug)]
struct Node {
    class: String,
    /// The names and values of its knobs.
    knobs: Vec<(String, String)>,
    /// The knobs that were added by hand.
    added: Vec<AddedKnob>,
    /// The places of its inputs in the list of nodes that it stands in, the first input first.
    inputs: Vec<Option<usize>>,
    /// The nodes of a group.
    group: Vec<Node>,
}

impl Node {
    fn knob(&self, name: &str) -> &str {
        let found = self.knobs.iter().find(|k| k.0 == name);
        found.map(|k| k.1.as_str()).unwrap_or_else(|| panic!("{} has no knob {name}", self.class))
    }

    /// The node of this class in a group.
    fn of_class(&self, class: &str) -> &Node {
        self.group.iter().find(|n| n.class == class).unwrap_or_else(|| panic!("there is no {class}"))
    }

    /// The value of an expression of a node in this group: products and maxima of numbers and of the group's knobs.
    fn evaluated(&self, expression: &str) -> f32 {
        let inner = expression.strip_prefix("max(").and_then(|e| e.strip_suffix(')'));
        if let Some((a, b)) = inner.and_then(|e| e.split_once(',')) {
            return self.evaluated(a).max(self.evaluated(b));
        }
        let factor = |f: &str| match f.strip_prefix("parent.") {
            Some(name) => self.knob(name).parse::<f32>().unwrap(),
            None => f.parse().unwrap(),
        };
        expression.split('*').map(factor).product()
    }
}

/// A knob that was added to a group.
#[derive(Debug)]
struct AddedKnob {
    name: String,
    tooltip: String,
    range: Option<[f32; 2]>,
}

type Lines<'a> = std::iter::Peekable<std::iter::Enumerate<std::str::Lines<'a>>>;

/// Reads the nodes of a Nuke script. Of its stack language only the parts that the export writes are read: comments, `set`, `push`,
/// `version`, groups, and nodes of knobs with one value each. Whatever a node takes must be on the stack.
fn read_nk(source: &str) -> Result<Vec<Node>, String> {
    read_nodes(&mut source.lines().enumerate().peekable(), None)
}

/// Reads nodes up to the end of the script, or of the group with the knobs `parent`.
fn read_nodes(lines: &mut Lines, parent: Option<&[(String, String)]>) -> Result<Vec<Node>, String> {
    let mut nodes: Vec<Node> = vec![];
    let mut stack: Vec<Option<usize>> = vec![];
    let mut names: Vec<(String, Option<usize>)> = vec![];
    while let Some((i, line)) = lines.next() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            [] => {}
            [comment, ..] if comment.starts_with('#') => {}
            ["version", _, _] => {}
            // Outside of groups the stack begins with the node that was chosen before pasting.
            ["set", name, "[stack", "0]"] => {
                let top = match (stack.last(), parent) {
                    (Some(top), _) => *top,
                    (None, None) => None,
                    (None, Some(_)) => return Err(format!("line {}: the stack is empty", i + 1)),
                };
                names.push((format!("${name}"), top));
            }
            ["push", "0"] => stack.push(None),
            ["push", name] => match names.iter().rev().find(|n| n.0 == name) {
                Some((_, node)) => stack.push(*node),
                None => return Err(format!("line {}: {name} was not set", i + 1)),
            },
            ["end_group"] if parent.is_some() => {
                let [Some(last)] = stack[..] else {
                    return Err(format!("line {}: {stack:?} is left", i + 1));
                };
                return match nodes[last].class.as_str() {
                    "Output" => Ok(nodes),
                    other => Err(format!("line {}: the group ends in {other}", i + 1)),
                };
            }
            [class, "{"] => {
                let (knobs, added) = read_knobs(lines, parent)?;
                let count = knobs.iter().find(|k| k.0 == "inputs").map_or(Ok(1), |k| k.1.parse());
                let count: usize = count.map_err(|e| format!("line {}: {e}", i + 1))?;
                let left =
                    stack.len().checked_sub(count).ok_or(format!("line {}: inputs are missing", i + 1))?;
                let inputs = stack.split_off(left).into_iter().rev().collect();
                let group = if class == "Group" { read_nodes(lines, Some(&knobs))? } else { vec![] };
                stack.push(Some(nodes.len()));
                nodes.push(Node { class: class.to_string(), knobs, added, inputs, group });
            }
            _ => return Err(format!("line {}: {line}", i + 1)),
        }
    }
    if parent.is_some() { Err("a group does not end".into()) } else { Ok(nodes) }
}

/// Reads a node's knobs up to its closing brace. An expression may refer to the knobs of the group that the node stands in.
#[allow(clippy::type_complexity, reason = "the two parts of a node are used at once")]
fn read_knobs(
    lines: &mut Lines,
    parent: Option<&[(String, String)]>,
) -> Result<(Vec<(String, String)>, Vec<AddedKnob>), String> {
    let (mut knobs, mut added) = (vec![], vec![]);
    loop {
        let (i, line) = lines.next().ok_or("a node is not closed")?;
        let wrong = |what: &str| format!("line {}: {what}: {line}", i + 1);
        if line == "}" {
            return Ok((knobs, added));
        }
        let (knob, value) = line.trim().split_once(' ').ok_or(wrong("a knob without a value"))?;
        let refers = |text: &str| -> Result<(), String> {
            for (at, _) in text.match_indices("parent.") {
                let name: String = text[at + 7..].chars().take_while(char::is_ascii_alphanumeric).collect();
                if !parent.is_some_and(|p| p.iter().any(|k| k.0 == name)) {
                    return Err(wrong(&format!("the group has no knob {name}")));
                }
            }
            Ok(())
        };
        let value = if knob == "addUserKnob" {
            let inside =
                value.strip_prefix('{').and_then(|v| v.strip_suffix('}')).ok_or(wrong("no braces"))?;
            let parts: Vec<&str> = inside.split('"').collect();
            if parts.len().is_multiple_of(2) || inside.contains(['{', '}', '[', ']', '$', '\\']) {
                return Err(wrong("quotes do not match"));
            }
            let [kind, name] = inside.split_whitespace().take(2).collect::<Vec<_>>()[..] else {
                return Err(wrong("no name"));
            };
            let tooltip =
                parts.iter().zip(&parts[1..]).find(|(before, _)| before.ends_with(" t ")).map(|p| p.1);
            let range = inside
                .rsplit_once(" R ")
                .map(|(_, ends)| ends.split(' ').map(str::parse).collect::<Vec<_>>());
            let range = match range.as_deref() {
                Some([Ok(from), Ok(to)]) => Some([*from, *to]),
                Some(_) => return Err(wrong("no range")),
                None => None,
            };
            if kind == "7" || kind == "2" {
                let tooltip = tooltip.ok_or(wrong("no tooltip"))?.to_string();
                added.push(AddedKnob { name: name.into(), tooltip, range });
            }
            continue;
        } else if let Some(inside) = value.strip_prefix("{{").and_then(|v| v.strip_suffix("}}")) {
            inside
        } else if let Some(inside) = value.strip_prefix('"').and_then(|v| v.strip_suffix('"')) {
            inside
        } else if value.contains(' ') {
            return Err(wrong("the value must be quoted"));
        } else {
            value
        };
        // Brackets would run Tcl, but for the one that reads a knob; braces and quotes would end the value.
        let plain = value.strip_prefix("\\[value ").and_then(|v| v.strip_suffix(']')).unwrap_or(value);
        if plain.contains(['"', '{', '}', '[', ']', '$', '\\']) {
            return Err(wrong("the value must be quoted"));
        }
        refers(plain)?;
        knobs.push((knob.to_string(), value.to_string()));
    }
}

/// Reads the keys of a Godot resource of one head, one section, and keys with a number, a boolean or a string.
fn read_tres(source: &str) -> Result<Vec<(String, String)>, String> {
    let mut lines = source.lines().filter(|l| !l.trim().is_empty() && !l.starts_with(';'));
    let head = lines.next().unwrap_or_default();
    if !(head.starts_with("[gd_resource type=\"") && head.ends_with("format=3]")) {
        return Err(head.into());
    }
    if lines.next() != Some("[resource]") {
        return Err("there is no [resource]".into());
    }
    lines
        .map(|line| {
            let (key, value) = line.split_once(" = ").ok_or(line)?;
            let name = key.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            let string = value.len() > 1 && value.starts_with('"') && value.ends_with('"');
            let known = string || ["true", "false"].contains(&value) || value.parse::<f64>().is_ok();
            if name && known { Ok((key.into(), value.into())) } else { Err(line.to_string()) }
        })
        .collect()
}

/// Compiles a Godot compute shader.
fn compile(source: &str) -> Result<(), String> {
    use naga::front::glsl::{Frontend, Options};
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    // The line `#[compute]` is Godot's own, and names the stage.
    let source = source.replacen("#[compute]\n", "", 1);
    let module = Frontend::default()
        .parse(&Options::from(naga::ShaderStage::Compute), &source)
        .map_err(|e| e.emit_to_string(&source))?;
    Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map(drop)
        .map_err(|e| e.emit_to_string(&source))
}

fn check(name: &str, source: &str) -> Result<(), String> {
    let extension = name.rsplit('.').next().unwrap_or_default();
    match extension {
        "cs" => parse(tree_sitter_c_sharp::LANGUAGE.into(), name, source),
        "py" => parse(tree_sitter_python::LANGUAGE.into(), name, source),
        "js" => parse(tree_sitter_javascript::LANGUAGE.into(), name, source),
        "h" => parse(tree_sitter_cpp::LANGUAGE.into(), name, source),
        "rs" => parse(tree_sitter_rust::LANGUAGE.into(), name, source),
        "gd" => parse(tree_sitter_gdscript::LANGUAGE.into(), name, source),
        "glsl" => compile(source),
        "nk" => read_nk(source).map(drop),
        "tres" => read_tres(source).map(drop),
        // HLSL shaders are compiled and run by crates/blindaug-gpu/tests/exported.rs.
        "shader" => Ok(()),
        "tbl" | "csv" => Ok(()),
        _ => Err(format!("{name}: nobody checks this")),
    }
}

/// Models with all parts known, with none known, and with each part known alone.
fn models() -> Vec<CameraModel> {
    let all = camera_model(0.5, 4.0, 3.0);
    let nothing = CameraModel::unknown(all.capture, "nobody looked");
    let mut models = vec![all.clone(), nothing.clone(), nothing.clone(), nothing.clone(), nothing];
    models[2].noise = all.noise;
    models[3].defocus = all.defocus;
    models[4].motion_blur = all.motion_blur;
    models
}

#[test]
fn every_file_is_read_by_a_parser_of_its_language() {
    let mut seen = vec![];
    for model in models() {
        for target in Target::ALL {
            for file in exported(&model, *target).files {
                if let Content::Text(text) = &file.content {
                    check(&file.name, text).unwrap_or_else(|e| panic!("{target}: {e}"));
                    seen.push(file.name.rsplit('.').next().unwrap_or_default().to_string());
                }
            }
        }
    }
    // Negative control: every parser refuses a broken file.
    for extension in ["cs", "py", "js", "h", "rs", "gd", "glsl", "nk", "tres"] {
        assert!(seen.iter().any(|s| s == extension), "nothing was written in {extension}");
        let model = &models()[0];
        let file = Target::ALL.iter().flat_map(|t| exported(model, *t).files).find_map(|f| match f.content {
            Content::Text(text) if f.name.ends_with(&format!(".{extension}")) => Some(text),
            _ => None,
        });
        let text = file.unwrap();
        let broken = format!("{text}\n) = (\n");
        assert!(
            check(&format!("broken.{extension}"), &broken).is_err(),
            "{extension} was broken and is read"
        );
    }
}

/// What Python's own compiler says of a script; `None` where there is no Python, which is said.
fn compiled_by_python(name: &str, script: &str) -> Option<Result<(), String>> {
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, script).unwrap();
    let output = std::process::Command::new("python3").args(["-m", "py_compile"]).arg(&path).output();
    match output {
        Ok(output) if output.status.success() => Some(Ok(())),
        Ok(output) => Some(Err(String::from_utf8_lossy(&output.stderr).into_owned())),
        Err(why) => {
            eprintln!("NOT TESTED: python3 cannot be run ({why})");
            None
        }
    }
}

#[test]
fn python_compiles_the_scripts() {
    for (i, model) in models().iter().enumerate() {
        for target in [Target::Unreal, Target::Blender] {
            let export = exported(model, target);
            let name = format!("exported_{target}_{i}.py");
            let Some(compiled) = compiled_by_python(&name, text(&export)) else { return };
            compiled.unwrap_or_else(|e| panic!("{target}: {e}"));
            // Negative control: an unbalanced quote, and a line that is indented for no reason.
            for broken in ["x = \"\"\"\n", "x = 1\n    y = 2\n"] {
                let broken = format!("{}{broken}", text(&export));
                assert!(compiled_by_python(&name, &broken).unwrap().is_err(), "{target}");
            }
        }
    }
    // The whole noise is in Unreal's material, and its textures lie beside the script.
    let export = exported(&models()[0], Target::Unreal);
    for name in [grain::BANDS, grain::TILE] {
        assert!(text(&export).contains(name) && export.files.iter().any(|f| f.name == name), "{name}");
    }
    assert!(!text(&exported(&models()[1], Target::Unreal)).contains("grain"));
}

#[test]
fn what_is_unknown_is_left_at_the_tool_s_default_and_said() {
    for model in models() {
        for target in Target::ALL {
            let export = exported(&model, *target);
            for (part, unknown) in [
                ("motion blur", model.motion_blur.why_unknown()),
                ("depth of field", model.defocus.why_unknown()),
                ("noise", model.noise.why_unknown()),
            ] {
                let said = export.lost.iter().any(|s| s.starts_with(part) && s.contains("nobody looked"));
                assert_eq!(said, unknown.is_some(), "{target}: {part}: {:?}", export.lost);
            }
        }
    }
    // No setting of an unknown part is written.
    let nothing = &models()[1];
    for (target, names) in [
        (Target::UnityUrp, &["Add<MotionBlur>", "Add<DepthOfField>", "Add<FilmGrain>"][..]),
        (Target::Godot, &["dof_blur_amount"]),
        (Target::Bevy, &["MotionBlur {", "DepthOfField {"]),
        (Target::Nuke, &["ZDefocus2", "VectorBlur", "MergeExpression"]),
        (Target::Unreal, &["motion_blur_amount", "fstop", "film_grain"]),
        (Target::Filament, &["cocScale"]),
    ] {
        for name in names {
            assert!(!text(&exported(nothing, target)).contains(name), "{target}: {name}");
            assert!(text(&exported(&models()[0], target)).contains(name), "{target}: {name}");
        }
    }
}

#[test]
fn relative_depth_is_not_exported_and_is_after_it_was_scaled() {
    let mut model = camera_model(0.5, 4.0, 3.0);
    let relative = DefocusModel::given(
        DefocusCurve::ThinLens { sigma_px_at_infinity: 4.0, focus_inverse_depth: 0.8, interval: None },
        DepthKind::Relative,
    );
    model.defocus = Estimate::Known(relative);
    let export = exported(&model, Target::Nuke);
    assert!(
        export.lost.iter().any(|s| s.contains("the scene's scale")) && !text(&export).contains("ZDefocus2")
    );
    model.defocus = Estimate::Known(relative.to_metric(2.0, 0.1));
    assert!(text(&exported(&model, Target::Nuke)).contains("ZDefocus2"));
}

#[test]
fn nuke_s_expression_makes_the_model_s_noise() {
    let model = camera_model(0.5, 4.0, 3.0);
    let noise = model.noise.known().unwrap();
    let nodes = read_nk(text(&exported(&model, Target::Nuke))).unwrap();
    let merge = nodes[0].of_class("MergeExpression");
    assert_eq!(merge.knob("temp_name3"), "amount");
    assert_eq!(nodes[0].evaluated(merge.knob("temp_expr3")), 1.0);
    let bands = grain::bands();
    for (c, key) in ["expr0", "expr1", "expr2"].iter().enumerate() {
        let expression = merge.knob(key);
        assert!(expression.contains("+amount*sqrt("));
        // The terms are of the form `max(s*luma+i,0)*(Ab(..+dx)..)`.
        let terms: Vec<(f32, f32)> = expression
            .match_indices("max(")
            .filter(|(at, _)| expression[*at..].split(')').next().unwrap().contains("*luma+"))
            .map(|(at, _)| {
                let inner = &expression[at + 4..];
                (value(inner, ""), value(inner, "luma+"))
            })
            .collect();
        assert_eq!(terms.len(), NOISE_LEVELS);
        let y = 0.4;
        let variance: f32 = bands
            .data()
            .iter()
            .map(|texel| {
                let n: f32 =
                    terms.iter().zip(texel).map(|((s, i), t)| (s * y + i).max(0.0) * (t - 0.5)).sum();
                (n / value(&expression[expression.find("sqrt(").unwrap()..], "0))/")).powi(2)
            })
            .sum::<f32>()
            / bands.data().len() as f32;
        let want = noise.total_std(y)[c];
        assert!((variance.sqrt() / want - 1.0).abs() < 0.02, "{} {want}", variance.sqrt());
    }
}

#[test]
fn nuke_s_group_is_wired_and_its_knobs_are_explained() {
    let model = camera_model(0.5, 4.0, 3.0);
    let export = exported(&model, Target::Nuke);
    let nodes = read_nk(text(&export)).unwrap();
    let [group] = &nodes[..] else { panic!("{} nodes", nodes.len()) };
    // An artist can change the camera by hand.
    let knobs: Vec<&str> = group.added.iter().map(|k| k.name.as_str()).collect();
    assert_eq!(knobs, ["exposure", "focus", "blur", "grain", "octaves"]);
    for AddedKnob { name, tooltip, range } in &group.added {
        assert!(tooltip.ends_with('.') && tooltip.len() > 30, "{name}: {tooltip}");
        if name == "octaves" {
            assert_eq!(group.knob(name), grain::BANDS);
            continue;
        }
        let ([from, to], value) = (range.unwrap(), group.knob(name).parse::<f32>().unwrap());
        assert!(from <= value && value <= to && from < to, "{name}: {value} in {from} to {to}");
    }
    // The first input is followed from the group's end to its beginning, with the second ones on the way.
    let at = |i: usize| &group.group[i];
    let name = |node: &Node| format!("{} {}", node.class, node.knob("name"));
    let mut node = group.group.last().unwrap();
    let mut way = vec![name(node)];
    while let Some(Some(first)) = node.inputs.first() {
        if let Some(second) = node.inputs.get(1) {
            way.push(format!("(beside it: {})", name(at(second.unwrap()))));
        }
        node = at(*first);
        way.push(name(node));
    }
    assert_eq!(
        way,
        [
            "Output Output",
            "Colorspace Decode",
            "MergeExpression Grain",
            "(beside it: Read Octaves)",
            "Colorspace Encode",
            "Copy LayersAlpha",
            "(beside it: VectorBlur MotionBlur)",
            "Merge2 Over",
            "(beside it: VectorBlur MotionBlur)",
            "Input plate",
        ]
    );
    let blurred = group.of_class("VectorBlur");
    assert_eq!(group.evaluated(blurred.knob("scale")), 0.5);
    let defocused = at(blurred.inputs[0].unwrap());
    assert_eq!(name(defocused), "ZDefocus2 Defocus");
    assert_eq!(name(at(defocused.inputs[0].unwrap())), "Input layer");
    // Negative controls: a group that does not end, a wire that leads nowhere, a knob that nobody has, a node too few, quotes that do not match.
    for (from, to) in [
        ("end_group\n", ""),
        ("push $Nlayer\n", "push $Nother\n"),
        ("parent.focus", "parent.focal"),
        ("push $Nlayer\n", ""),
        ("l \"focus, m\"", "l \"focus, m"),
        ("name Over\n}", "name Over\n"),
    ] {
        let broken = text(&export).replacen(from, to, 1);
        assert!(broken != text(&export) && read_nk(&broken).is_err(), "{from:?} became {to:?}");
    }
}

#[test]
fn the_av1_table_says_what_its_settings_are() {
    let model = camera_model(0.5, 4.0, 3.0);
    let export = exported(&model, Target::Av1Grain);
    let s = av1_grain::settings(model.noise.known().unwrap(), 1080);
    let lines: Vec<Vec<&str>> = text(&export).lines().map(|l| l.split_whitespace().collect()).collect();
    assert_eq!(lines[0], ["filmgrn1"]);
    assert_eq!(lines[1][0], "E");
    assert_eq!(lines[2].len(), 13);
    assert_eq!(
        lines[2][1..5],
        ["3", &s.ar_coeff_shift.to_string(), &s.grain_scale_shift.to_string(), &s.scaling_shift.to_string()]
    );
    for (line, points) in lines[3..6].iter().zip(&s.scaling) {
        assert_eq!(line[1].parse(), Ok(points.len()));
        let numbers: Vec<u8> = line[2..].iter().map(|v| v.parse().unwrap()).collect();
        assert_eq!(numbers, points.as_flattened());
    }
    for (line, coefficients) in lines[6..9].iter().zip(&s.coefficients) {
        let numbers: Vec<i32> = line[1..].iter().map(|v| v.parse().unwrap()).collect();
        assert_eq!(&numbers, coefficients);
    }
}

#[test]
fn the_shape_of_out_of_focus_points_is_exported_where_the_tool_has_it() {
    let polygon =
        |blades, roundness, rotation_degrees| Bokeh::Polygon { blades, roundness, rotation_degrees };
    let of = |aperture: Aperture| {
        let mut model = camera_model(0.5, 4.0, 2.0);
        if let Estimate::Known(lens) = &mut model.defocus {
            lens.bokeh = aperture;
        }
        model
    };
    let shaped = of(Aperture { squeeze: 1.5, cats_eye: 0.5, ..polygon(6, 0.25, 10.0).into() });
    let lost = |target: Target, model: &CameraModel| -> String {
        exported(model, target)
            .lost
            .iter()
            .filter(|l| l.contains("out-of-focus points are"))
            .cloned()
            .collect()
    };
    for (target, keys, unsaid) in [
        (
            Target::Blender,
            &[("\"blades\":", 6.0), ("\"ratio\":", 1.5)][..],
            "how round the blades are, the cut",
        ),
        (
            Target::UnityUrp,
            &[("bladeCount.Override(", 6.0), ("bladeRotation.Override(", 10.0)],
            "not told the stretch, the cut",
        ),
        (Target::UnityHdrp, &[("bladeCount =", 6.0)], "not told how they are turned, the stretch, the cut"),
        (
            Target::Unreal,
            &[("blade_count\":", 6.0), ("min_fstop\":", 0.0)],
            "how round the blades are, how they are turned, the",
        ),
        (
            Target::Nuke,
            &[("\n blades", 6.0), ("roundness", 0.25)],
            "not told how they are turned, the stretch, the cut",
        ),
        (Target::Godot, &[], "not told the blades, the stretch, the cut"),
        (Target::Bevy, &[], "not told the blades"),
    ] {
        let export = exported(&shaped, target);
        for (key, want) in keys {
            assert!((value(text(&export), key) - want).abs() < 1e-3, "{target} {key}");
        }
        assert!(lost(target, &shaped).contains(unsaid), "{target}: {}", lost(target, &shaped));
        // Disks and Gaussians need no words.
        assert_eq!(lost(target, &of(Bokeh::Disk.into())), "", "{target}");
        // The blur keeps its std, whatever the shape.
        if [Target::UnityUrp, Target::UnityHdrp].contains(&target) {
            let straight = exported(&of(polygon(5, 0.0, 0.0).into()), target);
            let disk = exported(&of(Bokeh::Disk.into()), target);
            // The formulas in `blur_of` are those of disks, of which a pentagon has a share of the std.
            let share = ((2.0 + (72.0f32).to_radians().cos()) / 3.0).sqrt();
            let [a, b] = [straight, disk].map(|e| blur_of(target, text(&e))(3.0));
            assert!((a * share / b - 1.0).abs() < 2e-3, "{target}: {a} {b}");
            assert!((a / b - 1.0).abs() > 0.05);
        }
    }
    // Shapes beyond what a tool has.
    assert!(lost(Target::UnityUrp, &of(polygon(12, 0.0, 0.0).into())).contains("the blades"));
    assert!(
        text(&exported(&of(polygon(12, 0.0, 0.0).into()), Target::UnityUrp))
            .contains("bladeCount.Override(9)")
    );
    assert_eq!(lost(Target::Blender, &of(polygon(7, 0.0, 20.0).into())), "");
}
