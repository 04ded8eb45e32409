//! A camera model in words and units, for a terminal, and the same numbers as JSON; per-frame models as a table.

use crate::depth_map;
use crate::numbers::tidy;
use crate::plots::defocus_interval;
use blindaug::{
    CameraModel,
    model::{
        CameraTrack, Capture, DefocusCurve, DefocusModel, DepthKind, Distortion, Estimate, ExposureFraction,
        Focus, Method, NoiseModel, OutsideFocus, Parameter, TrackedCamera, VISIBLE_PX,
    },
};
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// The number of rows of the table over time, beside the rows of changes.
const ROWS: usize = 10;

/// The table of a camera over time: a row for a handful of frames, and for each frame in which a change was noticed.
pub fn table(track: &CameraTrack) -> String {
    let frames = track.frames();
    let TrackedCamera { camera, frame: first, .. } = &frames[0];
    let Capture { width, height, .. } = camera.capture;
    let TrackedCamera { camera: of_last, frame: last, .. } = &frames[frames.len() - 1];
    let stopped = of_last.stopped.map_or(String::new(), |stopped| format!("; {stopped}"));
    let mut text = format!(
        "Camera     {width} x {height} px, tracked over {} ({first} to {last}{stopped})\n",
        count(frames.len() as u64, "frame")
    );
    text.extend(of_last.warnings.iter().map(|sentence| format!("Warning    {sentence}\n")));
    text.push('\n');
    let lens = match frames.iter().find_map(|f| f.camera.defocus.known()).map(|d| d.depth_kind) {
        Some(DepthKind::Metric) => "in focus at, m",
        _ => "in focus at, relative",
    };
    let own_columns = [Distortion::Defocus, Distortion::MotionBlur, Distortion::Noise];
    let others: Vec<Distortion> = Distortion::ALL
        .into_iter()
        .filter(|d| !own_columns.contains(d) && frames.iter().any(|f| f.camera.basis(*d).is_some()))
        .collect();
    let row = |cells: [&str; 6], others: &[String]| {
        let [frame, exposure, sigma, focus, noise, changed] = cells;
        let others: String = others.iter().map(|cell| format!("{cell:<18}  ")).collect();
        let line =
            format!("{frame:>7}  {exposure:<18}  {sigma:<18}  {focus:<21}  {noise:<18}  {others}{changed}");
        format!("{}\n", line.trim_end())
    };
    let names: Vec<String> = others.iter().map(|d| d.name().into()).collect();
    text += &row(["frame", "exposure", "px at infinity", lens, "noise, /255", "changed"], &names);
    let step = (frames.len() - 1).div_ceil(ROWS - 1).max(1);
    let shown =
        (0..).zip(frames).filter(|(i, f)| i % step == 0 || *i == frames.len() - 1 || !f.changed.is_empty());
    for (_, f) in shown {
        let unknown = || "unknown".to_owned();
        let exposure =
            f.camera.motion_blur.known().map_or_else(unknown, |m| with_interval(m.exposure.0, m.interval));
        let facts = f.camera.defocus.known().map(DefocusModel::facts);
        let metric = lens.ends_with(" m");
        let sigma = facts.as_ref().and_then(|d| match (d.sigma_below, d.sigma_px_at_infinity) {
            (Some(most), _) => Some(format!("below {most:.2}")),
            (None, Some(s)) => Some(with_interval(s, d.sigma_interval.unwrap_or([s; 2]))),
            _ => None,
        });
        let focus = facts.as_ref().map(|d| match (d.focus, d.outside) {
            (_, Some(OutsideFocus::Nearer(_))) => "nearer than all seen".into(),
            (_, Some(OutsideFocus::Beyond(_))) => "beyond all seen".into(),
            (Focus::At(f), None) => {
                let [low, high] = d.focus_interval.unwrap_or([f; 2]);
                let metres = |d: f32| if d > 1e-4 { d.recip() } else { f32::INFINITY };
                if metric {
                    with_interval(metres(f), [metres(high), metres(low)])
                } else {
                    with_interval(f, [low, high])
                }
            }
            (Focus::LeastBlurred { .. }, None) => unknown(),
            (Focus::Everywhere, None) => "everywhere".into(),
        });
        let noise = f.camera.noise.known().map(|n| {
            let [low, std, high] = noise_std(n, 0.5).map(|s| s[1]);
            with_interval(std, [low, high])
        });
        let changed: Vec<&str> =
            Distortion::ALL.into_iter().filter(|d| f.changed.of(*d)).map(changed_name).collect();
        let other = |&d: &Distortion| f.camera.parameters(d).first().map_or_else(unknown, first_number);
        let others: Vec<String> = others.iter().map(other).collect();
        let cells = [
            &f.frame.to_string(),
            &exposure,
            &sigma.unwrap_or_else(unknown),
            &focus.unwrap_or_else(unknown),
            &noise.unwrap_or_else(unknown),
            &changed.join(", "),
        ];
        text += &row(cells.map(String::as_str), &others);
    }
    text += "\nIntervals are 95 %; noise is the std of green at luminance 0.5, in steps of 8 bit.\n";
    text
}

/// The name of a distortion's parameters in tables.
fn changed_name(distortion: Distortion) -> &'static str {
    match distortion {
        Distortion::Defocus => "lens",
        Distortion::MotionBlur => "exposure",
        other => other.name(),
    }
}

/// The luminances at which the noise is reported.
const LUMINANCES: [f32; 3] = [0.1, 0.5, 0.9];

/// The model in words, a line per fact; `at_depth` are depths (m, or relative inverse depths) whose blur is added.
pub fn words(model: &CameraModel, at_depth: &[f32]) -> String {
    let Capture { width, height, fps, frames_used, pixel_aspect } = model.capture;
    let rate = fps.map_or("at an unknown frame rate".into(), |f| format!("at {} frames a second", short(f)));
    let frames = count(frames_used as u64, "frame");
    let stopped = model.stopped.map_or(String::new(), |stopped| format!(" ({stopped})"));
    let pixels = match pixel_aspect {
        1.0 => String::new(),
        wide => format!(" (pixels {} times as wide as high)", short(wide.into())),
    };
    let mut text =
        format!("Camera     {width} x {height} px{pixels} {rate}; estimated from {frames}{stopped}\n");
    for sentence in &model.warnings {
        let _ = writeln!(text, "Warning    {sentence}");
    }
    // Writing to a String cannot fail.
    for distortion in Distortion::ALL {
        let _ = match distortion {
            Distortion::Defocus => defocus_words(&mut text, &model.defocus, at_depth),
            Distortion::MotionBlur => motion_blur_words(&mut text, model),
            Distortion::Noise => noise_words(&mut text, &model.noise),
            other => other_words(&mut text, model, other),
        };
    }
    let _ = depth_map::words(&mut text, model);
    text
}

fn noise_words(text: &mut String, noise: &Estimate<NoiseModel>) -> std::fmt::Result {
    let noise = match noise {
        Estimate::Known(noise) => noise,
        Estimate::Unknown(why) => return writeln!(text, "Noise      unknown: {why}"),
    };
    writeln!(text, "Noise      std in R, G, B, in steps of 8 bit (1/255):")?;
    for y in LUMINANCES {
        let [low, std, high] = noise_std(noise, y);
        let of = |c: usize| match noise.lines().interval {
            Some(_) => format!("{:.2} ({:.2} to {:.2})", std[c], low[c], high[c]),
            None => format!("{:.2}", std[c]),
        };
        writeln!(text, "             at luminance {y}: {}, {}, {}", of(0), of(1), of(2))?;
    }
    let clip = short(noise.clip().into());
    if noise.clip() > 1.0 {
        writeln!(text, "           known up to the encoded value {clip}, where the footage ends")?;
    } else if noise.clip() < 0.9995 {
        writeln!(text, "           none from the encoded value {clip} up, where the sensor clips")?;
    }
    if let Some(curves) = noise.curves() {
        let [rg, rb, gb] = curves.levels[0].correlation();
        writeln!(
            text,
            "           its finest grain is shared by the channels: correlation {rg:.2} of R and G, {rb:.2} of R and B, {gb:.2} of G and B"
        )?;
        writeln!(
            text,
            "           its correlation with that of the frame before: {:.2}",
            curves.temporal_correlation
        )?;
    }
    writeln!(text, "           {}", origin(noise.method(), noise.samples(), "local measurements"))
}

/// The lower ends, the values and the upper ends of the std of the whole noise of R, G and B at a luminance, in steps of 8 bit.
fn noise_std(noise: &NoiseModel, y: f32) -> [[f32; 3]; 3] {
    noise.told_std(y).map(|std| std.map(|v| 255.0 * v))
}

fn motion_blur_words(text: &mut String, model: &CameraModel) -> std::fmt::Result {
    let blur = match &model.motion_blur {
        Estimate::Known(blur) => blur,
        Estimate::Unknown(why) => return writeln!(text, "Exposure   unknown: {why}"),
    };
    let angle = blur.exposure.shutter_angle();
    writeln!(
        text,
        "Exposure   {} of the frame interval ({}): a shutter angle of {angle:.0} degrees",
        short(blur.exposure.0.into()),
        interval(blur.interval)
    )?;
    if let Some(fps) = model.capture.fps {
        let seconds = blur.exposure.seconds(fps);
        let fraction = if seconds > 0.0 { format!(", 1/{:.0} s", seconds.recip()) } else { String::new() };
        writeln!(text, "           {:.1} ms at {} frames a second{fraction}", 1e3 * seconds, short(fps))?;
    }
    if let Some(phase) = blur.phase_degrees {
        let phase = short(phase.into());
        writeln!(
            text,
            "           the shutter opens at a phase of {phase} degrees (given), 0 being the frame's time"
        )?;
    }
    writeln!(text, "           {}", origin(blur.method, blur.samples, unit_of_samples(blur.method)))
}

fn defocus_words(text: &mut String, defocus: &Estimate<DefocusModel>, at_depth: &[f32]) -> std::fmt::Result {
    let defocus = match defocus {
        Estimate::Known(defocus) => defocus,
        Estimate::Unknown(why) => return writeln!(text, "Defocus    unknown: {why}"),
    };
    let metric = defocus.depth_kind == DepthKind::Metric;
    let facts = defocus.facts();
    let place = |d: f32| if metric { depth(d) } else { format!("relative inverse depth {d:.3}") };
    let known_to = |i: Option<[f32; 2]>, text: &dyn Fn(f32) -> String| {
        i.map_or(String::new(), |[lo, hi]| format!(" ({} to {})", text(lo), text(hi)))
    };
    match (facts.focus, facts.outside) {
        (Focus::At(_), Some(outside)) => {
            writeln!(
                text,
                "Defocus    in focus {}, that is {}",
                outside.words(),
                match outside {
                    OutsideFocus::Nearer(d) => format!("nearer than {}", place(d)),
                    OutsideFocus::Beyond(d) => format!("beyond {}", place(d)),
                }
            )?;
        }
        (Focus::At(d), None) => {
            // The far end of the interval of inverse depth is the larger depth.
            let i = facts.focus_interval.map(|[lo, hi]| if metric { [hi, lo] } else { [lo, hi] });
            writeln!(text, "Defocus    in focus at {}{}", place(d), known_to(i, &place))?;
        }
        (Focus::LeastBlurred { inverse_depth, sigma_px }, _) => {
            let place = place(inverse_depth);
            writeln!(
                text,
                "Defocus    nothing in its range is in focus; least blurred ({sigma_px:.2} px) at {place}"
            )?;
        }
        (Focus::Everywhere, _) => writeln!(text, "Defocus    no blur: everything is in focus")?,
    }
    if let Some(s) = facts.sigma_px_at_infinity {
        let of = if metric { "at infinity" } else { "at relative inverse depth 0" };
        let i = known_to(facts.sigma_interval, &|v| format!("{v:.2}"));
        match facts.sigma_below {
            Some(most) => writeln!(
                text,
                "           blur {of}: below {most:.2} px (95 % bound; less cannot be told from none), the std of the equivalent Gaussian"
            )?,
            None => writeln!(text, "           blur {of}: {s:.2} px{i}, the std of the equivalent Gaussian")?,
        }
    }
    if !defocus.bokeh.is_default() {
        writeln!(text, "           an out-of-focus point is {}", defocus.bokeh.words())?;
    }
    let shows = format!("           blur shows (over {VISIBLE_PX} px)");
    match facts.sharp.as_slice() {
        [] => writeln!(text, "{shows} everywhere")?,
        // Relative inverse depth ends at 1, where the nearest things are.
        [[far, near]] if *far <= 0.0 && (*near >= 1.0 && !metric || near.is_infinite()) => {
            writeln!(text, "{shows} nowhere")?;
        }
        sharp => {
            let ends = |&[far, near]: &[f32; 2]| if metric { [near, far] } else { [far, near] };
            let ranges: Vec<String> = sharp
                .iter()
                .map(|range| {
                    let [low, high] = ends(range).map(place);
                    format!("{low} to {high}")
                })
                .collect();
            let ranges = ranges.join(" and ");
            writeln!(text, "           blur starts to show (over {VISIBLE_PX} px) outside {ranges}")?;
        }
    }
    for &at in at_depth {
        let d = if metric { at.recip() } else { at };
        let what = if metric { format!("{at} m") } else { format!("relative inverse depth {at}") };
        let known = defocus_interval(defocus, d.into());
        let known = known.map_or(String::new(), |[low, high]| format!(" ({low:.2} to {high:.2})"));
        writeln!(text, "           at {what}: {:.2} px{known}", defocus.sigma_px(d))?;
    }
    writeln!(text, "           {}", origin(defocus.method, defocus.samples, unit_of_samples(defocus.method)))
}

/// Writes the parameters of a distortion that has no text of its own; nothing if it is unknown and not every camera has it.
fn other_words(text: &mut String, model: &CameraModel, distortion: Distortion) -> std::fmt::Result {
    let name = distortion.name();
    let mut head = name[..1].to_uppercase() + &name[1..];
    if let Some(why) = model.why_unknown(distortion).filter(|_| distortion.in_every_camera()) {
        writeln!(text, "{head:<10} unknown: {why}")?;
    }
    let Some((method, samples)) = model.basis(distortion) else { return Ok(()) };
    for p in model.parameters(distortion) {
        let known_to = p.interval.map_or(String::new(), |i| format!(" ({})", interval(i)));
        let value = short(p.value.into()) + &p.unit_after_value();
        writeln!(text, "{head:<10} {} {value}{known_to}", p.name)?;
        head.clear();
    }
    writeln!(text, "           {}", origin(method, samples, "samples"))
}

/// The names and short texts of a camera's parameters: the value with its interval, or the reason why it is unknown.
pub fn parameters(camera: &CameraModel) -> Vec<(&'static str, String)> {
    let mut rows = Vec::new();
    for distortion in Distortion::ALL {
        if let Some(why) = camera.why_unknown(distortion) {
            rows.push((changed_name(distortion), format!("unknown: {why}")));
            continue;
        }
        match distortion {
            Distortion::Defocus => {
                camera.defocus.known().iter().for_each(|lens| rows.extend(lens_rows(lens)))
            }
            Distortion::MotionBlur => {
                let known = camera.motion_blur.known();
                rows.extend(known.map(|m| ("exposure", with_interval(m.exposure.0, m.interval))));
            }
            Distortion::Noise => rows.extend(camera.noise.known().map(|noise| {
                let [low, std, high] = noise_std(noise, 0.5);
                let of = |c: usize| match noise.lines().interval {
                    Some(_) => with_interval(std[c], [low[c], high[c]]),
                    None => format!("{:.2}", std[c]),
                };
                ("noise, 1/255", [0, 1, 2].map(of).join(", "))
            })),
            other => {
                rows.extend(camera.parameters(other).first().map(|p| (other.name(), first_number(p))));
            }
        }
    }
    rows
}

fn first_number(p: &Parameter) -> String {
    with_interval(p.value, p.interval.unwrap_or([p.value; 2]))
}

fn lens_rows(lens: &DefocusModel) -> Vec<(&'static str, String)> {
    match lens.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval } => {
            let i = interval.map_or([[s; 2], [f; 2]], |i| [i.sigma_px_at_infinity, i.focus_inverse_depth]);
            let unit = if lens.depth_kind == DepthKind::Metric { "focus, 1/m" } else { "focus, relative" };
            let facts = lens.facts();
            let blur = match facts.sigma_below {
                Some(most) => format!("below {most:.2}"),
                None => with_interval(s, i[0]),
            };
            let focus = facts.outside.map_or_else(|| with_interval(f, i[1]), |o| o.words().into());
            vec![("blur at infinity, px", blur), (unit, focus)]
        }
        DefocusCurve::Quadratic { a, b, c, .. } => {
            vec![("lens", format!("{a:.2} d² + {b:.2} d + {c:.2} px"))]
        }
    }
}

/// The values that follow from the model, for programs: each with its 95 % interval where there is one, and numbers at six digits.
pub fn derived(model: &CameraModel, at_depth: &[f32]) -> Value {
    tidy(derived_exactly(model, at_depth))
}

fn derived_exactly(model: &CameraModel, at_depth: &[f32]) -> Value {
    let noise = match &model.noise {
        Estimate::Known(n) => {
            let std = LUMINANCES.map(|y| {
                let [low, std, high] = n.told_std(y);
                let interval = n.lines().interval.map(|_| [0, 1, 2].map(|c| [low[c], high[c]]));
                json!({ "luminance": y, "std": std, "interval": interval })
            });
            let correlation = n.curves().map(|c| json!({ "of_channels_rg_rb_gb": c.levels.map(|l| l.correlation()), "of_frames": c.temporal_correlation }));
            json!({ "std_of_encoded_rgb": std, "correlation": correlation, "clip": n.clip(), "method": n.method(), "samples": n.samples() })
        }
        Estimate::Unknown(why) => json!(why),
    };
    let motion_blur = match &model.motion_blur {
        Estimate::Known(m) => json!({
            "exposure": m.exposure, "interval": m.interval,
            "shutter_angle_degrees": m.exposure.shutter_angle(),
            "shutter_angle_interval": m.interval.map(|v| ExposureFraction(v).shutter_angle()),
            "exposure_time_s": model.capture.fps.map(|f| m.exposure.seconds(f)),
            "exposure_time_interval": model.capture.fps.map(|f| m.interval.map(|v| ExposureFraction(v).seconds(f))),
            "method": m.method, "samples": m.samples
        }),
        Estimate::Unknown(why) => json!(why),
    };
    let defocus = match &model.defocus {
        Estimate::Known(d) => defocus_derived(d, at_depth),
        Estimate::Unknown(why) => json!(why),
    };
    let mut value =
        json!({ "capture": model.capture, "noise": noise, "motion_blur": motion_blur, "defocus": defocus });
    if let Some(stopped) = &model.stopped {
        value["stopped"] = json!(stopped);
    }
    if !model.warnings.is_empty() {
        value["warnings"] = json!(model.warnings);
    }
    // The other distortions are written as in camera.json.
    let file = json!(model);
    let written = |d: &Distortion| d.in_every_camera() || model.why_unknown(*d).is_none();
    for distortion in Distortion::ALL.into_iter().filter(written) {
        let key = distortion.name().replace(' ', "_");
        if value.get(&key).is_none() {
            value[&key] = file[&key].clone();
        }
    }
    value
}

fn defocus_derived(model: &DefocusModel, at_depth: &[f32]) -> Value {
    let facts = model.facts();
    let mut values = Map::new();
    let mut put = |key: &str, value: Value| values.insert(key.into(), value);
    put("depth_kind", json!(model.depth_kind));
    put("sigma_px_at_infinity", json!(facts.sigma_px_at_infinity));
    put("sigma_px_at_infinity_interval", json!(facts.sigma_interval));
    put("sigma_px_at_infinity_below", json!(facts.sigma_below));
    put("focus_inverse_depth", json!(facts.in_focus()));
    put("focus_inverse_depth_interval", json!(facts.focus_interval));
    put("inverse_depth_seen", json!(model.inverse_depth_seen));
    put("focus_outside_of_what_was_seen", json!(facts.outside.map(OutsideFocus::words)));
    // The sharp range runs from the far end of the farthest range to the near end of the nearest one.
    let finite = |d: f32| d.is_finite().then_some(d);
    let sharp = facts.sharp.first().zip(facts.sharp.last()).map(|(far, near)| [far[0], near[1]]);
    put("inverse_depth_with_sigma_below_half_px", json!(sharp.map(|range| range.map(finite))));
    let metric = model.depth_kind == DepthKind::Metric;
    if metric {
        // Null means infinitely far.
        let metres = |d: f32| (d > 0.0).then(|| d.recip());
        put("focus_distance_m", json!(facts.in_focus().and_then(metres)));
        let distances = facts.focus_interval.map(|[far, near]| [near, far].map(metres));
        put("focus_distance_m_interval", json!(distances));
        put("depth_m_with_sigma_below_half_px", json!(sharp.map(|[far, near]| [near, far].map(metres))));
    }
    let at: Vec<_> = at_depth
        .iter()
        .map(|&z| {
            let (key, d) = if metric { ("depth_m", z.recip()) } else { ("relative_inverse_depth", z) };
            json!({ key: z, "sigma_px": model.sigma_px(d), "interval": defocus_interval(model, d.into()) })
        })
        .collect();
    put("at", json!(at));
    put("method", json!(model.method));
    put("samples", json!(model.samples));
    Value::Object(values)
}

/// A depth in words, given as inverse depth in 1/m.
fn depth(d: f32) -> String {
    if d > 1e-4 { format!("{} m", short(d.recip().into())) } else { "infinity".into() }
}

/// An interval in words, such as "0.45 to 0.51, 95 % sure".
fn interval([lo, hi]: [f32; 2]) -> String {
    format!("{} to {}, 95 % sure", short(lo.into()), short(hi.into()))
}

fn origin(method: Method, samples: u64, unit: &str) -> String {
    let how = match method {
        Method::Temporal => "from differences of successive frames",
        Method::Spatial => "from the flattest parts of single frames",
        Method::Spectral => "from local spectra",
        Method::Removal => "by comparison with clean frames, given or restored",
        Method::Given => return "given, not estimated".into(),
    };
    format!("{how} ({samples} {unit})")
}

fn unit_of_samples(method: Method) -> &'static str {
    if method == Method::Spectral { "tiles" } else { "places" }
}

/// A value with its interval, such as "0.48 [0.45, 0.51]".
pub fn with_interval(value: f32, interval: [f32; 2]) -> String {
    let text = |v: f32| if v.is_infinite() { "∞".into() } else { format!("{v:.2}") };
    let [lo, hi] = interval.map(text);
    format!("{} [{lo}, {hi}]", text(value))
}

/// A number with about three significant digits, without zeros at the end.
pub fn short(v: f64) -> String {
    let decimals = match v.abs() {
        a if a >= 100.0 => 1,
        a if a >= 0.1 => 2,
        _ => 4,
    };
    let text = format!("{v:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}

/// A count in words, such as "1 frame" or "5 frames".
pub fn count(n: u64, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::{Method, NoiseInterval, NoiseLevel, NoiseLines};

    #[test]
    fn numbers_are_short() {
        for (v, text) in [
            (0.48, "0.48"),
            (30.0, "30"),
            (29.97, "29.97"),
            (0.0123, "0.0123"),
            (0.0, "0"),
            (1234.56, "1234.6"),
        ] {
            assert_eq!(short(v), text);
        }
    }

    #[test]
    fn noise_is_shown_with_its_interval_where_there_is_one() {
        let level = |std: f32| NoiseLevel { slope: [0.0; 3], intercept: [std / 255.0; 3] };
        let levels = [level(2.0), level(0.0), level(0.0), level(0.0)];
        let shown = |interval| {
            let mut model = CameraModel::unknown(
                Capture { width: 8, height: 8, fps: None, frames_used: 1, pixel_aspect: 1.0 },
                "not looked at",
            );
            let lines = NoiseLines { levels, interval, clip: 1.0, method: Method::Temporal, samples: 1 };
            model.noise = Estimate::Known(NoiseModel::Lines(lines));
            let rows = parameters(&model);
            rows.into_iter().find(|(name, _)| name.starts_with("noise")).unwrap().1
        };
        let of = |low: f32, high: f32| NoiseInterval {
            slope: [[0.0; 2]; 3],
            intercept: [[low / 255.0, high / 255.0]; 3],
        };
        let text = shown(Some([of(1.5, 2.5), of(0.0, 0.0), of(0.0, 0.0), of(0.0, 0.0)]));
        assert_eq!(text, "2.00 [1.50, 2.50], 2.00 [1.50, 2.50], 2.00 [1.50, 2.50]");
        // The ends are those of the file, which need not lie at one distance.
        let text = shown(Some([of(1.5, 6.0), of(0.0, 0.0), of(0.0, 0.0), of(0.0, 0.0)]));
        assert_eq!(text, "2.00 [1.50, 6.00], 2.00 [1.50, 6.00], 2.00 [1.50, 6.00]");
        assert_eq!(shown(None), "2.00, 2.00, 2.00");
    }

    #[test]
    fn where_blur_shows_is_said_in_the_model_s_own_depth() {
        let told = |sigma, depth_kind| {
            let mut model = CameraModel::unknown(
                Capture { width: 8, height: 8, fps: None, frames_used: 1, pixel_aspect: 1.0 },
                "not looked at",
            );
            let lens = DefocusModel::given_lens(sigma, 0.25);
            model.defocus = Estimate::Known(DefocusModel { depth_kind, ..lens });
            words(&model, &[])
        };
        assert!(told(0.1, DepthKind::Relative).contains("(over 0.5 px) nowhere"));
        assert!(told(2.0, DepthKind::Relative).contains("outside relative inverse depth 0.188 to"));
        assert!(!told(0.1, DepthKind::Metric).contains("nowhere"));
        for kind in [DepthKind::Metric, DepthKind::Relative] {
            let text = told(0.0, kind);
            assert!(text.contains("everything is in focus") && text.contains("nowhere"), "{text}");
        }
    }
}
