//! The plots of a report, as SVG. Each is `None` where there is nothing to draw.

use crate::numbers::{distance, tick};
use blindaug::fit::{BlurPoint, Shot, noise::NoisePoint};
use blindaug::model::{
    DefocusCurve, DefocusModel, DepthKind, MotionBlurModel, NOISE_LEVELS, NoiseModel, VISIBLE_PX,
};
use maud::{Markup, PreEscaped, html};
use plotters::coord::{Shift, types::RangedCoordf64};
use plotters::prelude::*;
use std::cell::RefCell;
use std::ops::Range;

/// The colour of the estimate. People who see no red or no green can tell it from [`POINTS`].
pub const ESTIMATE: RGBColor = RGBColor(0xc2, 0x41, 0x0c);
/// The colour of measured points.
pub const POINTS: RGBColor = RGBColor(0x1d, 0x4e, 0xd8);
/// The colours of the red, green and blue channels.
pub const CHANNELS: [RGBColor; 3] =
    [RGBColor(0xd0, 0x3a, 0x2f), RGBColor(0x0f, 0x8a, 0x4c), RGBColor(0x2f, 0x5f, 0xd0)];
const INK: RGBColor = RGBColor(0x33, 0x33, 0x33);
const GRID: RGBColor = RGBColor(0xe4, 0xe4, 0xe4);

/// The width of a plot in its own units, which are twice as fine as the page's pixels, since SVG coordinates are whole numbers here.
const WIDTH: u32 = 1440;
/// The size of text in the units of [`WIDTH`]; the library divides it by 1.24.
const FONT: u32 = 29;

/// The largest number of points of a plot; more cannot be told apart and make the file large.
const MOST_POINTS: usize = 1500;

/// The reason why a plot cannot be drawn.
pub type PlotError = DrawingAreaErrorKind<std::io::Error>;
type Result<T> = std::result::Result<T, PlotError>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The values that a plot tells under the pointer: a text for each of its circles, in the order in which they are drawn.
#[derive(Default)]
struct Hover(RefCell<Vec<String>>);

impl Hover {
    /// The text of the next circle.
    fn say(&self, text: String) {
        self.0.borrow_mut().push(text);
    }

    /// The plot with the texts as titles of its circles, which browsers show under the pointer without a script.
    fn titled(self, svg: &str) -> String {
        let mut texts = self.0.into_inner().into_iter();
        let mut titled = String::with_capacity(svg.len());
        let mut rest = svg;
        while let Some(at) = rest.find("<circle") {
            let Some(end) = rest[at..].find("/>").map(|end| at + end) else { break };
            titled += &rest[..end];
            match texts.next() {
                Some(text) => {
                    titled += "><title>";
                    titled += &html! { (text) }.into_string();
                    titled += "</title></circle>";
                }
                None => titled += "/>",
            }
            rest = &rest[end + 2..];
        }
        titled + rest
    }
}

fn svg(height: u32, label: &str, draw: impl FnOnce(&Area, &Hover) -> Result<()>) -> Result<Markup> {
    let mut text = String::new();
    let hover = Hover::default();
    {
        let area = SVGBackend::with_string(&mut text, (WIDTH, height)).into_drawing_area();
        draw(&area, &hover)?;
        area.present()?;
    }
    Ok(in_page(&hover.titled(&text), (WIDTH, height), label))
}

/// The radius of the invisible circles that tell a curve's values.
const REACH: i32 = 16;
/// The most such circles along a curve.
const MOST_TOLD: usize = 48;

/// A plot of this size, an SVG file, as a part of a page. Its root element needs a label for readers who cannot see it, but no namespace,
/// and its size on the page is that of its column.
pub fn in_page(svg: &str, (width, height): (u32, u32), label: &str) -> Markup {
    let inner = svg.split_once('>').map_or("", |(_, inner)| inner);
    let inner = inner.trim_end().strip_suffix("</svg>").unwrap_or(inner);
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(label) { (PreEscaped(inner)) }
    }
}

struct Axes<'a> {
    title: &'a str,
    x: Range<f64>,
    y: Range<f64>,
    x_name: &'a str,
    y_name: &'a str,
    x_tick: &'a dyn Fn(f64) -> String,
    x_ticks: usize,
}

impl<'a> Axes<'a> {
    fn chart<'b, 'c>(&self, area: &'c Area<'b>) -> Result<Chart<'c, 'b>> {
        let mut builder = ChartBuilder::on(area);
        builder
            .margin(12)
            .margin_right(56)
            .margin_top(if self.title.is_empty() { 28 } else { 12 })
            .x_label_area_size(if self.x_name.is_empty() { 48 } else { 92 })
            .y_label_area_size(if self.y_name.is_empty() { 84 } else { 124 });
        if !self.title.is_empty() {
            builder.caption(self.title, ("sans-serif", FONT + 2).into_font().color(&INK));
        }
        let mut chart = builder.build_cartesian_2d(self.x.clone(), self.y.clone())?;
        chart
            .configure_mesh()
            .x_desc(self.x_name)
            .y_desc(self.y_name)
            .x_labels(self.x_ticks)
            .y_labels(6)
            .x_label_formatter(&|v| (self.x_tick)(*v))
            .y_label_formatter(&|v| tick(*v))
            .max_light_lines(0)
            .bold_line_style(GRID)
            .axis_style(INK.mix(0.6))
            .label_style(("sans-serif", FONT).into_font().color(&INK))
            .axis_desc_style(("sans-serif", FONT).into_font().color(&INK))
            .draw()?;
        Ok(chart)
    }

    /// Draws a line; points outside the axes are moved to their border.
    fn line(
        &self,
        chart: &mut Chart,
        points: impl IntoIterator<Item = [f64; 2]>,
        style: ShapeStyle,
    ) -> Result<()> {
        let points: Vec<_> = points.into_iter().filter_map(|p| self.inside(p)).collect();
        chart.draw_series(LineSeries::new(points, style)).map(drop)
    }

    /// Draws circles with what each tells.
    fn circles(
        &self,
        chart: &mut Chart,
        (radius, style): (i32, ShapeStyle),
        hover: &Hover,
        points: impl IntoIterator<Item = ([f64; 2], String)>,
    ) -> Result<()> {
        let shown = points.into_iter().filter_map(|(p, text)| {
            let at = self.inside(p)?;
            hover.say(text);
            Some(Circle::new(at, radius, style))
        });
        // They are collected, since the texts must be said in the order of drawing.
        let shown: Vec<_> = shown.collect();
        chart.draw_series(shown).map(drop)
    }

    /// Lets some points of a curve tell their values: `[x, y]` with what to say.
    fn told(&self, chart: &mut Chart, hover: &Hover, points: Vec<([f64; 2], String)>) -> Result<()> {
        let step = points.len().div_ceil(MOST_TOLD).max(1);
        let some = points.into_iter().step_by(step);
        // What is wholly transparent is not drawn at all, and would not be found by the pointer.
        self.circles(chart, (REACH, WHITE.mix(0.001).filled()), hover, some)
    }

    /// Draws the area between two curves over the same places: `[x, low, high]`.
    fn band(&self, chart: &mut Chart, curves: &[[f64; 3]], colour: RGBColor) -> Result<()> {
        let low = curves.iter().filter_map(|&[x, low, _]| self.inside([x, low]));
        let high = curves.iter().rev().filter_map(|&[x, _, high]| self.inside([x, high]));
        let outline: Vec<_> = low.chain(high).collect();
        if outline.len() < 3 {
            return Ok(());
        }
        chart.draw_series([Polygon::new(outline, colour.mix(0.16).filled())]).map(drop)
    }

    fn horizontal(&self, chart: &mut Chart, y: f64) -> Result<()> {
        if !self.y.contains(&y) {
            return Ok(());
        }
        dashed(chart, [(self.x.start, y), (self.x.end, y)])
    }

    /// Draws an estimate on the x axis with its interval.
    fn mark(&self, chart: &mut Chart, x: f64, [low, high]: [f64; 2]) -> Result<()> {
        let (bottom, top) = (self.y.start, self.y.end);
        self.band(chart, &[[low, bottom, top], [high, bottom, top]], ESTIMATE)?;
        self.line(chart, [[x, bottom], [x, top]], ESTIMATE.stroke_width(4))
    }

    fn inside(&self, [x, y]: [f64; 2]) -> Option<(f64, f64)> {
        let finite = x.is_finite() && !y.is_nan();
        finite.then(|| (x.clamp(self.x.start, self.x.end), y.clamp(self.y.start, self.y.end)))
    }
}

fn dashed(chart: &mut Chart, ends: [(f64, f64); 2]) -> Result<()> {
    chart.draw_series(DashedLineSeries::new(ends, 14, 10, INK.mix(0.7).stroke_width(2))).map(drop)
}

/// The label of a whole number, empty for others: frames have no fractions.
fn whole(v: f64) -> String {
    if v.fract() == 0.0 { format!("{v}") } else { String::new() }
}

/// The least and the largest finite value; `None` if there is none.
pub fn extent(values: impl IntoIterator<Item = f64>) -> Option<[f64; 2]> {
    values
        .into_iter()
        .filter(|v| v.is_finite())
        .fold(None, |e: Option<[f64; 2]>, v| Some(e.map_or([v, v], |[low, high]| [low.min(v), high.max(v)])))
}

/// The extent with a margin on both sides, never empty.
fn padded([low, high]: [f64; 2], margin: f64) -> Range<f64> {
    let size = if high > low { high - low } else { low.abs().max(1.0) };
    low - margin * size..high + margin * size
}

/// The plot of the log-likelihood over the exposure.
pub fn exposure(curve: &[[f32; 2]], model: Option<&MotionBlurModel>) -> Result<Option<Markup>> {
    let mut curve: Vec<[f64; 2]> =
        curve.iter().filter(|p| p.iter().all(|v| v.is_finite())).map(|p| p.map(f64::from)).collect();
    curve.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (Some(x), Some(y)) = (extent(curve.iter().map(|p| p[0])), extent(curve.iter().map(|p| p[1]))) else {
        return Ok(None);
    };
    if x[0] == x[1] {
        return Ok(None);
    }
    let percent = |v: f64| format!("{} %", tick(100.0 * v));
    let whole = Axes {
        title: "All exposures",
        x: x[0].min(0.0)..x[1].max(1.0),
        y: padded(y, 0.05),
        x_name: "exposure, % of the frame interval",
        y_name: "log-likelihood",
        x_tick: &percent,
        x_ticks: 6,
    };
    let interval = model.map(|m| m.interval.map(f64::from)).filter(|i| i.iter().all(|v| v.is_finite()));
    // A sharp peak is a mere spike on the whole range, so that a second panel enlarges it.
    let near = model.zip(interval).and_then(|(m, [low, high])| {
        let at = f64::from(m.exposure.0);
        let reach = 2.0 * (high - low).max(0.02);
        let (from, to) = ((at - reach).max(x[0]), (at + reach).min(x[1]));
        let within = |p: &&[f64; 2]| (from..=to).contains(&p[0]);
        if reach > 0.25 || curve.iter().filter(within).count() < 3 {
            return None;
        }
        let mut part = vec![[from, interpolated(&curve, from)?]];
        part.extend(curve.iter().filter(within));
        part.push([to, interpolated(&curve, to)?]);
        let y = extent(part.iter().map(|p| p[1]))?;
        let axes = Axes {
            title: "Near the estimate",
            x: from..to,
            y: padded(y, 0.08),
            y_name: "",
            ..whole_copy(&whole)
        };
        Some((axes, part))
    });
    let panel = |area: &Area, hover: &Hover, axes: &Axes, points: &[[f64; 2]]| -> Result<()> {
        let mut chart = axes.chart(area)?;
        if let Some((m, interval)) = model.zip(interval) {
            axes.mark(&mut chart, f64::from(m.exposure.0), interval)?;
        }
        axes.line(&mut chart, points.iter().copied(), POINTS.stroke_width(4))?;
        let said = |&[e, l]: &[f64; 2]| ([e, l], format!("exposure {}: {} nats", percent(e), tick(l)));
        axes.told(&mut chart, hover, points.iter().map(said).collect())
    };
    let label = match model {
        Some(m) => format!("Log-likelihood over exposure, largest at {}", percent(f64::from(m.exposure.0))),
        None => "Log-likelihood over exposure".into(),
    };
    svg(560, &label, |area, hover| match &near {
        Some((axes, part)) => {
            let (left, right) = area.split_horizontally(WIDTH * 11 / 20);
            panel(&left, hover, &whole, &curve)?;
            panel(&right, hover, axes, part)
        }
        None => panel(area, hover, &Axes { title: "", ..whole_copy(&whole) }, &curve),
    })
    .map(Some)
}

fn whole_copy<'a>(a: &Axes<'a>) -> Axes<'a> {
    Axes { x: a.x.clone(), y: a.y.clone(), ..*a }
}

/// The linearly interpolated value at `x` of points [x, y] in rising order.
fn interpolated(points: &[[f64; 2]], x: f64) -> Option<f64> {
    let after = points.partition_point(|p| p[0] < x);
    let b = points.get(after)?;
    if b[0] == x || after == 0 {
        return Some(b[1]);
    }
    let a = points[after - 1];
    Some(a[1] + (x - a[0]) / (b[0] - a[0]) * (b[1] - a[1]))
}

/// The plot of the exposure that each frame alone gives, with the estimate of each shot if there are several, else that of all frames.
/// `numbers` are those of the frames, as far as they are not counted from 1.
pub fn exposure_per_frame(
    frames: &[(usize, f32)],
    model: Option<&MotionBlurModel>,
    shots: &[Shot],
    numbers: &[u64],
) -> Result<Option<Markup>> {
    let number = |index: usize| numbers.get(index).map_or(index as f64 + 1.0, |&number| number as f64);
    let points: Vec<(f64, f64)> = frames
        .iter()
        .filter(|f| f.1.is_finite())
        .map(|&(i, v)| (number(i), f64::from(v).clamp(0.0, 1.0)))
        .collect();
    let ends_of = |s: &Shot| [number(s.frames.start), number(s.frames.end.saturating_sub(1))];
    let ends = shots.iter().flat_map(ends_of);
    let Some([first, last]) = extent(points.iter().map(|p| p.0).chain(ends)).filter(|_| points.len() > 1)
    else {
        return Ok(None);
    };
    let axes = Axes {
        title: "",
        x: first - 0.5..last + 0.5,
        y: 0.0..100.0,
        x_name: "frame",
        y_name: "exposure, %",
        x_tick: &whole,
        x_ticks: (last - first).min(11.0) as usize + 1,
    };
    svg(400, &format!("Exposure of each of {} frames", points.len()), |area, hover| {
        let mut chart = axes.chart(area)?;
        let all = model.filter(|_| shots.is_empty()).map(|m| ([axes.x.start, axes.x.end], m));
        let each = shots.iter().filter_map(|s| {
            let [first, last] = ends_of(s);
            Some(([first - 0.5, last + 0.5], s.motion_blur.known()?))
        });
        for ([left, right], m) in all.into_iter().chain(each) {
            let ([low, high], at) =
                (m.interval.map(|v| 100.0 * f64::from(v)), 100.0 * f64::from(m.exposure.0));
            axes.band(&mut chart, &[[left, low, high], [right, low, high]], ESTIMATE)?;
            axes.line(&mut chart, [[left, at], [right, at]], ESTIMATE.stroke_width(4))?;
        }
        let said = points.iter().map(|&(i, v)| ([i, 100.0 * v], format!("frame {i}: {} %", tick(100.0 * v))));
        axes.circles(&mut chart, (7, POINTS.mix(0.8).filled()), hover, said)
    })
    .map(Some)
}

/// A number over time, in stretches of frames in which the number is known.
pub struct Course {
    /// For each frame of each stretch, `[frame, value, low, high]`.
    pub stretches: Vec<Vec<[f64; 4]>>,
    /// The colour of the number's line.
    pub colour: RGBColor,
}

/// The plot of numbers over the frames, with their intervals and the frames in which a change was noticed. The y axis ends at
/// `most`; without it, just above the numbers.
pub fn over_time(
    name: &str,
    [first, last]: [f64; 2],
    most: Option<f64>,
    courses: &[Course],
    changes: &[f64],
) -> Result<Option<Markup>> {
    let all = || courses.iter().flat_map(|c| c.stretches.iter().flatten());
    let (Some([_, largest]), Some([_, high])) = (extent(all().map(|p| p[1])), extent(all().map(|p| p[3])))
    else {
        return Ok(None);
    };
    let axes = Axes {
        title: "",
        x: first - 0.5..last + 0.5,
        // Wide intervals must not press the curves to the bottom.
        y: 0.0..most.unwrap_or(1.08 * high.clamp(largest, 2.0 * largest).max(0.05)),
        x_name: "frame",
        y_name: name,
        x_tick: &whole,
        x_ticks: (last - first).min(11.0) as usize + 1,
    };
    svg(400, &format!("{name} over time; {} changes noticed", changes.len()), |area, hover| {
        let mut chart = axes.chart(area)?;
        for Course { stretches, colour } in courses {
            for stretch in stretches {
                let shown = wide_enough(stretch);
                let band: Vec<[f64; 3]> = shown.iter().map(|&[x, _, low, high]| [x, low, high]).collect();
                axes.band(&mut chart, &band, *colour)?;
                axes.line(&mut chart, shown.iter().map(|p| [p[0], p[1]]), colour.stroke_width(4))?;
                let said = |&[frame, v, low, high]: &[f64; 4]| {
                    ([frame, v], format!("frame {frame}: {} ({} to {})", tick(v), tick(low), tick(high)))
                };
                axes.told(&mut chart, hover, stretch.iter().map(said).collect())?;
            }
        }
        changes.iter().try_for_each(|&x| dashed(&mut chart, [(x, axes.y.start), (x, axes.y.end)]))
    })
    .map(Some)
}

/// The points of a stretch that are drawn: few enough, and for a single frame two points, one frame apart.
fn wide_enough(stretch: &[[f64; 4]]) -> Vec<[f64; 4]> {
    if let &[[x, value, low, high]] = stretch {
        return vec![[x - 0.5, value, low, high], [x + 0.5, value, low, high]];
    }
    let step = stretch.len().div_ceil(MOST_POINTS);
    let kept = |i: usize| i.is_multiple_of(step) || i + 1 == stretch.len();
    (0..).zip(stretch).filter(|(i, _)| kept(*i)).map(|(_, p)| *p).collect()
}

/// The plot of blur over inverse depth: the points, and the curve with its interval.
pub fn defocus(points: &[BlurPoint], model: Option<&DefocusModel>) -> Result<Option<Markup>> {
    let mut points: Vec<BlurPoint> = points
        .iter()
        .copied()
        .filter(|p| p.inverse_depth.is_finite() && p.sigma_px.is_finite() && p.weight > 0.0)
        .collect();
    points.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    points.truncate(MOST_POINTS);
    let seen = extent(points.iter().map(|p| f64::from(p.inverse_depth)));
    let Some([near_zero, largest]) =
        extent(seen.into_iter().flatten().chain(model.into_iter().flat_map(|m| match m.curve {
            // The focus is shown unless it is far from all depths that were seen.
            DefocusCurve::ThinLens { focus_inverse_depth: f, .. } => {
                let f = f64::from(f);
                let reach = seen.map_or(2.0 * f, |s| 1.5 * s[1]);
                [0.0, f.min(reach) * 1.15]
            }
            DefocusCurve::Quadratic { inverse_depth_range, .. } => inverse_depth_range.map(f64::from),
        })))
    else {
        return Ok(None);
    };
    let metric = model.is_some_and(|m| m.depth_kind == DepthKind::Metric);
    let x = padded([near_zero, largest], 0.03);
    let x = x.start.max(near_zero.min(0.0))..x.end;
    const STEPS: usize = 240;
    let places: Vec<f64> =
        (0..=STEPS).map(|i| x.start + (x.end - x.start) * i as f64 / STEPS as f64).collect();
    let curve: Vec<[f64; 2]> =
        model.iter().flat_map(|m| places.iter().map(|&d| [d, f64::from(m.sigma_px(d as f32))])).collect();
    let curve_top = extent(curve.iter().map(|p| p[1])).map_or(0.0, |e| e[1]);
    // A few outliers must not press the other points to the bottom.
    let mut sigmas: Vec<f32> = points.iter().map(|p| p.sigma_px).collect();
    sigmas.sort_by(f32::total_cmp);
    let points_top = sigmas.get(sigmas.len().saturating_sub(1) * 98 / 100).map_or(0.0, |&s| f64::from(s));
    let top =
        points_top.max(curve_top.min(if points.is_empty() { f64::MAX } else { 3.0 * points_top + 1.0 }));
    let with_distance = |v: f64| {
        if v < -1e-9 {
            String::new()
        } else {
            format!("{} ({} m)", tick(v), tick(distance(if v < 1e-9 { 0.0 } else { v })))
        }
    };
    let x_tick: &dyn Fn(f64) -> String = if metric { &with_distance } else { &tick };
    let axes = Axes {
        title: "",
        x,
        y: 0.0..1.08 * top.max(1.0),
        x_name: if metric {
            "inverse depth in 1/m (distance)"
        } else {
            "relative inverse depth (larger is nearer)"
        },
        y_name: "blur std, px",
        x_tick,
        x_ticks: if metric { 7 } else { 9 },
    };
    let band: Vec<[f64; 3]> = model.map_or(vec![], |m| {
        places.iter().filter_map(|&d| defocus_interval(m, d).map(|[low, high]| [d, low, high])).collect()
    });
    let heaviest = points.first().map_or(1.0, |p| p.weight.min(1.0));
    svg(
        680,
        &format!("Blur over inverse depth: {} measured places and the fitted curve", points.len()),
        |area, hover| {
            let mut chart = axes.chart(area)?;
            axes.band(&mut chart, &band, ESTIMATE)?;
            let place = |d: f64| if metric { format!("{} m", tick(distance(d))) } else { tick(d) };
            for p in &points {
                let opacity = 0.06 + 0.64 * f64::from((p.weight / heaviest).min(1.0));
                let at = [f64::from(p.inverse_depth), f64::from(p.sigma_px)];
                let said = format!("at {}: {} px by itself", place(at[0]), tick(at[1]));
                let style = POINTS.mix(opacity).filled();
                axes.circles(&mut chart, (6, style), hover, [(at, said)])?;
            }
            axes.horizontal(&mut chart, f64::from(VISIBLE_PX))?;
            axes.line(&mut chart, curve.iter().copied(), ESTIMATE.stroke_width(5))?;
            let said = |&[d, s]: &[f64; 2]| {
                let known = model.and_then(|m| defocus_interval(m, d));
                let known = known.map_or(String::new(), |[l, h]| format!(" ({} to {})", tick(l), tick(h)));
                ([d, s], format!("at {}: {} px{known}", place(d), tick(s)))
            };
            axes.told(&mut chart, hover, curve.iter().map(said).collect())
        },
    )
    .map(Some)
}

/// The least and the largest blur, px, at inverse depth `d` if each number of a thin lens may lie anywhere in its interval.
pub fn defocus_interval(model: &DefocusModel, d: f64) -> Option<[f64; 2]> {
    let DefocusCurve::ThinLens { interval: Some(interval), .. } = model.curve else { return None };
    let [low, high] = interval.focus_inverse_depth.map(|f| f64::from(f).max(1e-9));
    let sigma = |f: f64| (1.0 - d / f).abs();
    // The factor |1 - d / f| falls towards f = d and rises beyond.
    let least = if (low..=high).contains(&d) { 0.0 } else { sigma(low).min(sigma(high)) };
    let [s_low, s_high] = interval.sigma_px_at_infinity.map(|s| f64::from(s).max(0.0));
    let both = [s_low * least, s_high * sigma(low).max(sigma(high))];
    both.iter().all(|v| v.is_finite()).then_some(both)
}

/// The plot of the noise's std over luminance for each band and channel, in 8-bit steps.
pub fn noise(points: &[NoisePoint], model: Option<&NoiseModel>) -> Result<Option<Markup>> {
    let points: Vec<&NoisePoint> = points
        .iter()
        // The axis ends at white; scene-linear footage has points beyond.
        .filter(|p| p.level < NOISE_LEVELS && p.y <= 1.0 && p.sigma.iter().all(|s| s.is_finite()))
        .collect();
    if points.is_empty() && model.is_none() {
        return Ok(None);
    }
    const LUMINANCES: [f32; 11] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
    /// The most of the y axis, over what lines and points take of it.
    const MOST_OF_INTERVALS: f64 = 4.0;
    let steps = |v: f32| 255.0 * f64::from(v);
    let panel = |area: &Area, hover: &Hover, level: usize| -> Result<()> {
        let points: Vec<_> = points.iter().filter(|p| p.level == level).collect();
        let lines: Vec<[[f64; 2]; 11]> = (0..3)
            .filter_map(|c| {
                Some(LUMINANCES.map(|y| [f64::from(y), 0.0])).zip(model).map(|(mut l, m)| {
                    l.iter_mut().zip(LUMINANCES).for_each(|(p, y)| p[1] = steps(m.std(level, y)[c]));
                    l
                })
            })
            .collect();
        let all = points.iter().flat_map(|p| p.sigma.map(steps)).chain(lines.iter().flatten().map(|p| p[1]));
        let of_values = extent(all).map_or(1.0, |e| e[1]).max(0.05);
        let bands: Vec<[[f64; 3]; 11]> = model.map_or(vec![], |m| {
            let at = |c: usize, y: f32| {
                let [low, high] = m.interval_of_std(level, c, y).map(steps);
                [f64::from(y), low, high]
            };
            (0..3).map(|c| LUMINANCES.map(|y| at(c, y))).collect()
        });
        // Intervals are shown whole, unless they are so wide that nothing else could be seen.
        let of_bands = extent(bands.iter().flatten().map(|p| p[2])).map_or(0.0, |e| e[1]);
        let top = of_values.max(of_bands.min(MOST_OF_INTERVALS * of_values));
        let title = format!("Band {}: {}", level + 1, band_name(level));
        let axes = Axes {
            title: &title,
            x: 0.0..1.0,
            y: 0.0..1.12 * top,
            x_name: if level >= 2 { "luminance Y" } else { "" },
            y_name: if level.is_multiple_of(2) { "std, 8-bit steps" } else { "" },
            x_tick: &tick,
            x_ticks: 6,
        };
        let mut chart = axes.chart(area)?;
        for (band, colour) in bands.iter().zip(CHANNELS) {
            axes.band(&mut chart, band, colour)?;
        }
        for (line, colour) in lines.into_iter().zip(CHANNELS) {
            axes.line(&mut chart, line, colour.stroke_width(4))?;
        }
        const NAMES: [&str; 3] = ["red", "green", "blue"];
        for (c, colour) in CHANNELS.into_iter().enumerate() {
            let said = points.iter().map(|p| {
                let at = [f64::from(p.y), steps(p.sigma[c])];
                (at, format!("{} at Y = {}: measured {} of 255", NAMES[c], tick(at[0]), tick(at[1])))
            });
            axes.circles(&mut chart, (6, colour.mix(0.75).filled()), hover, said)?;
        }
        if let Some(m) = model {
            for (c, name) in NAMES.into_iter().enumerate() {
                let said = LUMINANCES.map(|y| {
                    let std = steps(m.std(level, y)[c]);
                    let [low, high] = m.interval_of_std(level, c, y).map(|v| tick(steps(v)));
                    (
                        [f64::from(y), std],
                        format!("{name} at Y = {y}: {} ({low} to {high}) of 255", tick(std)),
                    )
                });
                axes.told(&mut chart, hover, said.into())?;
            }
        }
        Ok(())
    };
    svg(980, "Noise over luminance: four pyramid bands, three channels", |area, hover| {
        for (level, area) in area.split_evenly((2, 2)).iter().enumerate() {
            panel(area, hover, level)?;
        }
        Ok(())
    })
    .map(Some)
}

/// The plot of estimated over true values in [0, `most`], with their intervals: `[true, estimated, low, high]`, a colour per group.
pub fn true_and_estimated(name: &str, most: f64, groups: &[Vec<[f64; 4]>]) -> Result<Markup> {
    let axes = Axes {
        title: "",
        x: 0.0..most * 1.05,
        y: 0.0..most * 1.05,
        x_name: &format!("true {name}"),
        y_name: &format!("estimated {name}"),
        x_tick: &tick,
        x_ticks: 6,
    };
    svg(1100, &format!("True and estimated {name}"), |area, hover| {
        let mut chart = axes.chart(area)?;
        axes.line(&mut chart, [[0.0, 0.0], [most, most]], INK.mix(0.6).stroke_width(2))?;
        for (i, group) in groups.iter().enumerate() {
            let colour = GROUPS[i % GROUPS.len()];
            for &[truth, estimate, low, high] in group {
                // Groups are drawn side by side, so that both are seen.
                let x = truth + most * (0.008 * i as f64 - 0.004);
                axes.line(&mut chart, [[x, low], [x, high]], colour.mix(0.35).stroke_width(3))?;
                let [t, e, l, h] = [truth, estimate, low, high].map(tick);
                let said = [([x, estimate], format!("true {t}: estimated {e} ({l} to {h})"))];
                axes.circles(&mut chart, (8, colour.mix(0.75).filled()), hover, said)?;
            }
        }
        Ok(())
    })
}

/// The plot of a true curve, in black, and of recovered ones, from blue to orange.
pub fn curves(x_name: &str, y_name: &str, truth: &[[f64; 2]], recovered: &[Vec<[f64; 2]>]) -> Result<Markup> {
    let all = || truth.iter().chain(recovered.iter().flatten());
    let x = extent(all().map(|p| p[0])).unwrap_or([0.0, 1.0]);
    let y = extent(all().map(|p| p[1])).unwrap_or([0.0, 1.0]);
    let x = padded(x, 0.03);
    let axes = Axes { title: "", x, y: 0.0..1.08 * y[1].max(1.0), x_name, y_name, x_tick: &tick, x_ticks: 7 };
    svg(680, &format!("{y_name} over {x_name}, true and recovered"), |area, hover| {
        let mut chart = axes.chart(area)?;
        for (i, curve) in recovered.iter().enumerate() {
            let t = i as f64 / (recovered.len().max(2) - 1) as f64;
            let between = |a: u8, b: u8| (f64::from(a) + t * (f64::from(b) - f64::from(a))) as u8;
            let colour = RGBColor(
                between(POINTS.0, ESTIMATE.0),
                between(POINTS.1, ESTIMATE.1),
                between(POINTS.2, ESTIMATE.2),
            );
            axes.line(&mut chart, curve.iter().copied(), colour.mix(0.8).stroke_width(5))?;
        }
        axes.line(&mut chart, truth.iter().copied(), INK.stroke_width(4))?;
        let said = |&[x, y]: &[f64; 2]| ([x, y], format!("true at {}: {}", tick(x), tick(y)));
        axes.told(&mut chart, hover, truth.iter().map(said).collect())
    })
}

/// The plot of points, with a colour per group.
pub fn scatter(x_name: &str, y_name: &str, groups: &[Vec<[f64; 2]>]) -> Result<Markup> {
    let all = || groups.iter().flatten();
    let x = extent(all().map(|p| p[0])).unwrap_or([0.0, 1.0]);
    let y = extent(all().map(|p| p[1])).unwrap_or([0.0, 1.0]);
    let x = padded(x, 0.05);
    let axes =
        Axes { title: "", x, y: 0.0..1.08 * y[1].max(1e-6), x_name, y_name, x_tick: &tick, x_ticks: 7 };
    svg(600, &format!("{y_name} over {x_name}"), |area, hover| {
        let mut chart = axes.chart(area)?;
        for (i, group) in groups.iter().enumerate() {
            let colour = GROUPS[i % GROUPS.len()].mix(0.75);
            let said = group.iter().map(|&[x, y]| ([x, y], format!("{}: {}", tick(x), tick(y))));
            axes.circles(&mut chart, (8, colour.filled()), hover, said)?;
        }
        Ok(())
    })
}

/// The colours of groups.
const GROUPS: [RGBColor; 2] = [POINTS, ESTIMATE];

/// The name of a pyramid band.
pub fn band_name(level: usize) -> String {
    match level {
        0 => "finest grain".into(),
        _ => format!("grain of about {} px", 2 << level),
    }
}
