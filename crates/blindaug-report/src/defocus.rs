//! The section of defocus.

use crate::depth_map;
use crate::numbers::{distance, interval, metres, number, tick};
use crate::page::{Card, Part, Row, basis, blur_samples, heading, parameter_table, swatch, unknown};
use crate::plots::{self, ESTIMATE, POINTS};
use blindaug::CameraModel;
use blindaug::fit::Diagnostics;
use blindaug::model::{
    DefocusCurve, DefocusModel, DepthKind, Distortion, Estimate, Focus, OutsideFocus, ThinLensInterval,
    VISIBLE_PX, thin_lens_sharp,
};
use maud::html;

/// The distances of a range of inverse depths in 1/m, such as "from 0.800 to 1.20 m".
fn metric_range([low, high]: [f32; 2]) -> String {
    let [low, high] = [low, high].map(f64::from);
    let near = distance(high);
    match distance(low) {
        far if far.is_infinite() && (near == 0.0 || high.is_infinite()) => "at every distance".into(),
        far if far.is_infinite() => format!("from {} m on", number(near)),
        far => format!("from {} to {} m", number(near), number(far)),
    }
}

pub(crate) fn defocus_section(model: &CameraModel, diagnostics: &Diagnostics) -> Part {
    let known = model.defocus.known();
    let plot = plots::defocus(&diagnostics.blur_points, known)?;
    let points = diagnostics.blur_points.len();
    Ok(html! {
        section {
            h2 { (heading(Distortion::Defocus)) }
            @match &model.defocus {
                Estimate::Known(m) => {
                    (parameter_table(&lens_parameters(m)))
                    (basis(m.samples, blur_samples(m.method), m.method))
                    @if m.depth_kind == DepthKind::Relative {
                        p.soft { "Depth is known up to a scale and an offset only, so there are no metres here. Compositing needs the relation to metres (the scene's scale, or real depth)." }
                    }
                }
                Estimate::Unknown(why) => (unknown(Distortion::Defocus, why)),
            }
            @match plot {
                Some(plot) => figure { (plot) figcaption {
                    @if points > 0 { (swatch(POINTS)) "the blur that fits each place best alone, the stronger the more it says; " }
                    @if let Some(m) = known {
                        (swatch(ESTIMATE)) "the fitted curve"
                        @if matches!(m.curve, DefocusCurve::ThinLens { interval: Some(_), .. }) { " with both of its numbers anywhere in their 95 % intervals" }
                        "; "
                    }
                    "dashed: " (tick(VISIBLE_PX.into())) " px, where blur starts to show."
                    @if points == 0 { " No measured places were kept." }
                } },
                None => @if known.is_some() { p.soft { "There is nothing to plot for this estimate." } },
            }
            (depth_map::picture(model))
        }
    })
}

fn lens_parameters(m: &DefocusModel) -> Vec<Row> {
    let metric = m.depth_kind == DepthKind::Metric;
    let place = |d: f64| place(d, metric);
    let place_interval = |i: [f64; 2]| place_interval(i, metric);
    let focus_name = if metric { "Focus distance" } else { "Focus (relative inverse depth)" };
    let facts = m.facts();
    let range_value = if facts.sharp.is_empty() {
        "nowhere".into()
    } else if metric {
        facts.sharp.iter().map(|r| metric_range(*r)).collect::<Vec<_>>().join("; ")
    } else {
        facts.sharp.iter().map(|r| interval(r.map(f64::from), "")).collect::<Vec<_>>().join("; ")
    };
    let range = |interval: Option<String>| Row {
        name: "Blur stays below 0.5 px".into(),
        value: range_value.clone(),
        interval,
        meaning: "Outside this range blur starts to show.".into(),
    };
    let focus = match facts.focus {
        Focus::At(d) => Some(Row {
            name: focus_name.into(),
            value: match facts.outside {
                Some(outside) => format!("{}\n({})", outside.words(), place(outside.limit().into())),
                None => place(d.into()),
            },
            interval: facts.focus_interval.map(|i| place_interval(i.map(f64::from))),
            meaning: match facts.outside {
                Some(_) => "How far outside, blur hardly tells.".into(),
                None => "What lies here is sharp.".into(),
            },
        }),
        Focus::LeastBlurred { inverse_depth, sigma_px } => Some(Row {
            name: if metric { "Least blur at" } else { "Least blur at (relative inverse depth)" }.into(),
            value: place(inverse_depth.into()),
            interval: None,
            meaning: format!(
                "What lies here is sharpest, but for {} px of blur: nothing is quite in focus.",
                number(sigma_px.into())
            ),
        }),
        Focus::Everywhere => None,
    };
    let mut rows: Vec<Row> = focus.into_iter().collect();
    match m.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, interval: known, .. } => {
            let ends = known.map(|i| {
                let [far, near] = sharp_ends(i).map(place_interval);
                format!("near end {near}\nfar end {far}")
            });
            rows.push(range(ends));
            rows.push(Row {
                name: if metric { "Blur at infinity" } else { "Blur at relative inverse depth 0" }.into(),
                value: match facts.sigma_below {
                    Some(most) => format!("below {} px", number(most.into())),
                    None => format!("{} px", number(s.into())),
                },
                interval: known.map(|i| interval(i.sigma_px_at_infinity.map(f64::from), " px")),
                meaning: format!(
                    "Std of the Gaussian that is equivalent to the blur of what is very far. A round aperture turns a point of light \
                     there into a disk {}{} px across.",
                    if facts.sigma_below.is_some() { "of less than " } else { "" },
                    number(4.0 * f64::from(facts.sigma_below.unwrap_or(s)))
                ),
            });
        }
        DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [low, high] } => {
            rows.push(range(None));
            rows.extend(quadratic_parameters(m, [a, b, c], [low, high], metric));
        }
    }
    if !m.bokeh.is_default() {
        rows.push(Row {
            name: "Out-of-focus points".into(),
            value: m.bokeh.words(),
            interval: Some("–".into()),
            meaning: "The shape of the blur, as the footage shows it or as it was set by hand. Its std is that of the equivalent Gaussian."
                .into(),
        });
    }
    rows
}

/// The rows that only a quadratic has: the blur at its ends, and its coefficients.
fn quadratic_parameters(m: &DefocusModel, [a, b, c]: [f32; 3], range: [f32; 2], metric: bool) -> Vec<Row> {
    let place = |d: f64| if metric { metres(d) } else { number(d) };
    let [low, high] = range.map(f64::from);
    let unit = if metric { " with d in 1/m" } else { " with d relative" };
    vec![
        Row {
            name: "Blur at the far and the near end".into(),
            value: format!(
                "{} px, {} px",
                number(m.sigma_px(low as f32).into()),
                number(m.sigma_px(high as f32).into())
            ),
            interval: None,
            meaning: format!(
                "Std of the equivalent Gaussian at the farthest and the nearest depth that was seen ({} and {}); beyond, it is taken as constant.",
                place(low),
                place(high)
            ),
        },
        Row {
            name: "Curve".into(),
            value: format!("{} d² + {} d + {}", number(a.into()), number(b.into()), number(c.into())),
            interval: None,
            meaning: format!(
                "Blur std in px over inverse depth d{unit}. Its three numbers depend on each other; the plot shows how far the points scatter."
            ),
        },
    ]
}

/// The least and the largest inverse depth at which the far and the near end of the sharp range may lie, if both numbers of a thin
/// lens lie anywhere in their intervals.
fn sharp_ends(interval: ThinLensInterval) -> [[f64; 2]; 2] {
    let corners: Vec<[f32; 2]> = interval
        .sigma_px_at_infinity
        .iter()
        .flat_map(|&s| interval.focus_inverse_depth.map(|f| thin_lens_sharp(s, f)))
        .collect();
    [0, 1].map(|end| {
        let values = corners.iter().map(|c| f64::from(c[end]));
        [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
    })
}

/// The lens's card.
pub(crate) fn focus_card(m: &DefocusModel) -> Card {
    let metric = m.depth_kind == DepthKind::Metric;
    let relative = "in relative inverse depth: no unit, larger is nearer";
    let facts = m.facts();
    let known_to = facts.focus_interval.map(|i| place_interval(i.map(f64::from), metric));
    let card = |big: String, interval: Option<String>, more: String| Card { big, interval, more };
    match (facts.focus, facts.outside) {
        (Focus::Everywhere, _) => match facts.sigma_below {
            Some(most) => card(
                format!("Sharp: blur below {} px", number(most.into())),
                None,
                "at infinity, 95 % bound; less cannot be told from none".into(),
            ),
            None => card("No blur seen".into(), None, "everything that was seen is sharp".into()),
        },
        (Focus::At(_), Some(outside)) => {
            let limit = place(outside.limit().into(), metric);
            let end = if matches!(outside, OutsideFocus::Nearer(_)) { "nearest" } else { "farthest" };
            card(
                format!("Focus {}", outside.words()),
                None,
                format!("the {end} thing that tells is at {limit}{}", if metric { "" } else { ", relative" }),
            )
        }
        (Focus::At(d), None) if metric => {
            let sharp = facts.sharp.first().map_or(String::new(), |r| format!("sharp {}", metric_range(*r)));
            card(format!("Focus at {}", metres(d.into())), known_to, sharp)
        }
        (Focus::At(d), None) => card(format!("Focus at {}", number(d.into())), known_to, relative.into()),
        (Focus::LeastBlurred { inverse_depth: d, sigma_px }, _) => {
            let more = format!("no distance is quite sharp: {} px there", number(sigma_px.into()));
            card(format!("Least blur at {}", place(d.into(), metric)), None, more)
        }
    }
}

/// A place, given as an inverse depth.
fn place(inverse_depth: f64, metric: bool) -> String {
    if metric { metres(inverse_depth) } else { number(inverse_depth) }
}

/// An interval of places, given as inverse depths.
fn place_interval([a, b]: [f64; 2], metric: bool) -> String {
    if metric { interval([distance(a), distance(b)], " m") } else { interval([a, b], "") }
}
