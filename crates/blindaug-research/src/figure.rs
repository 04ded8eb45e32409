//! Figures of results, drawn alike as SVG and as PDF.

use crate::pdf::PdfBackend;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde::{Deserialize, Serialize};

/// A figure over two axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// The name of the figure's files.
    pub name: String,
    /// What is to be seen, in whole sentences.
    pub caption: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis. If it has rows, the series' y are numbers of rows, from 0 at the top.
    pub y: Axis,
    /// What is drawn, in the order of the legend.
    pub series: Vec<Series>,
}

/// An axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// The name, with the unit.
    pub name: String,
    /// The range; `None`: that of the data.
    pub range: Option<[f64; 2]>,
    /// The names of rows, for a vertical axis of names instead of numbers.
    pub rows: Vec<String>,
}

impl Axis {
    /// An axis over the range of the data.
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// An axis over this range.
    pub fn over(name: impl Into<String>, range: [f64; 2]) -> Self {
        Self { name: name.into(), range: Some(range), rows: vec![] }
    }

    /// A vertical axis with a row for each name.
    pub fn of_rows(rows: Vec<String>) -> Self {
        Self { rows, ..Self::default() }
    }
}

/// Points or a line with one entry in the legend.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// The name in the legend; without one, there is no entry.
    pub name: String,
    /// The way it is drawn.
    pub style: Style,
    /// The number of its colour; series that belong together share one.
    pub colour: usize,
    /// The marks; those that are not finite are left out.
    pub marks: Vec<Mark>,
}

/// The way a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Style {
    /// Points, with their intervals as bars.
    Points,
    /// A line through the marks.
    Line,
    /// A dashed grey line through the marks: a truth or a goal.
    Reference,
}

/// A point of a series.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// The place along the horizontal axis.
    pub x: f64,
    /// The place along the vertical axis.
    pub y: f64,
    /// The interval of y; of x, where the vertical axis has rows.
    pub interval: Option<[f64; 2]>,
}

impl Mark {
    /// A mark without an interval.
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y, interval: None }
    }
}

/// The reason why a figure cannot be drawn, in words.
pub type Drawn<T> = Result<T, String>;

const WIDTH: u32 = 900;
/// The size of the text in the units of [`WIDTH`], as plotters counts it: its SVG text is smaller by 1.24.
const FONT: f64 = 33.0;
/// The mean width of a character and the height of a line, in the units of [`WIDTH`].
const CHARACTER: f64 = 14.5;
const LINE: u32 = 40;
const INK: RGBColor = RGBColor(0x33, 0x33, 0x33);
const GRID: RGBColor = RGBColor(0xe4, 0xe4, 0xe4);
/// Colours that people who see no red or no green can tell apart (Okabe & Ito 2008), without the yellow.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x00, 0x00, 0x00),
];

impl Figure {
    /// The figure as an SVG file.
    ///
    /// # Errors
    /// If an axis cannot be drawn.
    pub fn svg(&self) -> Drawn<String> {
        let mut text = String::new();
        let area = SVGBackend::with_string(&mut text, self.size()).into_drawing_area();
        let drawn = self.draw(&area).and_then(|()| area.present()).map_err(|e| e.to_string());
        drop(area);
        drawn.map(|()| text)
    }

    /// The figure as a PDF file.
    ///
    /// # Errors
    /// If an axis cannot be drawn.
    pub fn pdf(&self) -> Drawn<Vec<u8>> {
        let mut file = vec![];
        let area = PdfBackend::new(&mut file, self.size()).into_drawing_area();
        let drawn = self.draw(&area).and_then(|()| area.present()).map_err(|e| e.to_string());
        drop(area);
        drawn.map(|()| file)
    }

    /// Width and height, in the units of the figure's files.
    pub fn size(&self) -> (u32, u32) {
        (WIDTH, self.height())
    }

    fn height(&self) -> u32 {
        let chart = if self.y.rows.is_empty() { 560 } else { 110 + 62 * self.y.rows.len() as u32 };
        chart + self.legend_height()
    }

    /// The entries of the legend, each with its series' number and its place.
    fn legend(&self) -> Vec<(usize, (i32, i32))> {
        let (mut x, mut y) = (24.0, 12 + LINE as i32 / 2);
        let mut entries = vec![];
        for (i, s) in self.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty()) {
            // On a narrow screen the page's text is larger than the figure's.
            let width = 72.0 + 1.25 * CHARACTER * s.name.chars().count() as f64;
            if x > 24.0 && x + width > f64::from(WIDTH) {
                (x, y) = (24.0, y + LINE as i32);
            }
            entries.push((i, (x as i32, y)));
            x += width;
        }
        entries
    }

    fn legend_height(&self) -> u32 {
        self.legend().last().map_or(0, |(_, (_, y))| *y as u32 + LINE / 2)
    }

    /// The range of an axis: its own, or that of the values with a margin.
    fn range(axis: &Axis, values: impl Iterator<Item = f64>) -> [f64; 2] {
        if let Some(range) = axis.range {
            return range;
        }
        let [low, high] = blindaug_report::plots::extent(values).unwrap_or([0.0, 1.0]);
        let margin = 0.06 * if high > low { high - low } else { low.abs().max(1.0) };
        // A quantity that is never negative is shown from 0 if 0 is near.
        let from = if low >= 0.0 && low < 0.4 * high { 0.0 } else { low - margin };
        [from, high + margin]
    }

    fn colour(&self, series: usize) -> RGBColor {
        match self.series[series].style {
            Style::Reference => RGBColor(0x77, 0x77, 0x77),
            _ => COLOURS[self.series[series].colour % COLOURS.len()],
        }
    }

    fn draw_legend<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        for (i, (x, y)) in self.legend() {
            match self.series[i].style {
                Style::Points => root.draw(&Circle::new((x + 16, y), 8, self.colour(i).filled()))?,
                _ => root.draw(&PathElement::new([(x, y), (x + 32, y)], self.colour(i).stroke_width(4)))?,
            }
            root.draw_text(&self.series[i].name, &text(HPos::Left), (x + 42, y))?;
        }
        Ok(())
    }

    fn draw<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        root.fill(&WHITE)?;
        self.draw_legend(root)?;
        let (_, below) = root.split_vertically(self.legend_height());
        let rows = self.y.rows.len();
        // The first row is at the top, where y is largest.
        let height = |y: f64| if rows > 0 { (rows - 1) as f64 - y } else { y };
        let marks = || self.series.iter().flat_map(|s| &s.marks);
        let spans = |m: &Mark| m.interval.unwrap_or([f64::NAN; 2]);
        let [x, y] = match rows {
            0 => [
                Self::range(&self.x, marks().map(|m| m.x)),
                Self::range(&self.y, marks().flat_map(|m| [m.y, spans(m)[0], spans(m)[1]])),
            ],
            _ => [
                Self::range(&self.x, marks().flat_map(|m| [m.x, spans(m)[0], spans(m)[1]])),
                [-0.6, rows as f64 - 0.4],
            ],
        };
        let longest = self.y.rows.iter().map(|r| r.chars().count()).max().unwrap_or(0);
        let left = if rows > 0 { 24 + (CHARACTER * longest as f64) as u32 } else { 130 };
        let mut chart = ChartBuilder::on(&below)
            .margin(14)
            .margin_right(40)
            .x_label_area_size(92)
            .y_label_area_size(left.min(WIDTH / 2))
            .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(&self.x.name)
            .y_desc(&self.y.name)
            .x_labels(6)
            .y_labels(if rows > 0 { 0 } else { 6 })
            .x_label_formatter(&|v| tick(*v))
            .y_label_formatter(&|v| tick(*v))
            .max_light_lines(0)
            .bold_line_style(GRID)
            .axis_style(INK.mix(0.6))
            .label_style(("sans-serif", FONT).into_font().color(&INK))
            .axis_desc_style(("sans-serif", FONT).into_font().color(&INK));
        mesh.draw()?;
        for (i, name) in self.y.rows.iter().enumerate() {
            let (px, py) = chart.backend_coord(&(x[0], height(i as f64)));
            root.draw_text(name, &text(HPos::Right), (px - 14, py))?;
        }
        let inside = |v: f64, range: [f64; 2]| v.clamp(range[0], range[1]);
        let place = |m: &Mark| (inside(m.x, x), inside(height(m.y), y));
        let finite = |m: &&Mark| m.x.is_finite() && m.y.is_finite();
        for (i, s) in self.series.iter().enumerate() {
            let (colour, all) = (self.colour(i), s.marks.iter().filter(finite));
            match s.style {
                Style::Line => {
                    chart.draw_series(LineSeries::new(all.map(place), colour.stroke_width(4)))?;
                }
                Style::Reference => {
                    chart.draw_series(DashedLineSeries::new(
                        all.map(place),
                        14,
                        10,
                        colour.stroke_width(3),
                    ))?;
                }
                Style::Points => {
                    for m in all {
                        if let Some([low, high]) = m.interval.filter(|i| i.iter().all(|v| !v.is_nan())) {
                            let ends = if rows > 0 {
                                [(inside(low, x), place(m).1), (inside(high, x), place(m).1)]
                            } else {
                                [(place(m).0, inside(low, y)), (place(m).0, inside(high, y))]
                            };
                            chart.draw_series([PathElement::new(ends, colour.stroke_width(4))])?;
                        }
                        chart.draw_series([Circle::new(place(m), 7, colour.filled())])?;
                    }
                }
            }
        }
        Ok(())
    }
}

/// Text beside a point, at its height.
fn text(at: HPos) -> TextStyle<'static> {
    ("sans-serif", FONT).into_font().color(&INK).pos(Pos::new(at, VPos::Center))
}

/// A number beside an axis, without zeros at its end.
fn tick(v: f64) -> String {
    let text = format!("{v:.3}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".into() } else { short.replace('-', "\u{2212}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure() -> Figure {
        let marks = vec![
            Mark { x: 0.2, y: 0.25, interval: Some([0.1, 0.4]) },
            Mark { x: 0.8, y: f64::NAN, interval: None },
            Mark::new(0.5, 0.5),
        ];
        Figure {
            name: "example".into(),
            caption: "An example.".into(),
            x: Axis::over("true exposure fraction", [0.0, 1.0]),
            y: Axis::new("estimated"),
            series: vec![
                Series { name: "ours <blind>".into(), style: Style::Points, colour: 0, marks },
                Series {
                    name: "truth".into(),
                    style: Style::Reference,
                    colour: 0,
                    marks: vec![Mark::new(0.0, 0.0), Mark::new(1.0, 1.0)],
                },
            ],
        }
    }

    #[test]
    fn both_formats_hold_the_same_figure() {
        let svg = figure().svg().unwrap();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"), "{svg}");
        assert!(svg.contains("ours &lt;blind&gt;") && svg.contains("true exposure fraction"));
        // A mark that is not finite is left out; the entry of the legend is a circle, too.
        assert_eq!(svg.matches("<circle").count(), 3);
        let pdf = figure().pdf().unwrap();
        let text = String::from_utf8_lossy(&pdf);
        assert!(text.starts_with("%PDF-") && text.trim_end().ends_with("%%EOF"));
        assert!(text.contains("(ours <blind>) Tj") && text.contains("(true exposure fraction) Tj"));
    }

    #[test]
    fn rows_are_named_from_the_top() {
        let mut f = figure();
        f.y = Axis::of_rows(vec!["first".into(), "second".into()]);
        f.series.truncate(1);
        f.series[0].marks = vec![Mark { x: 0.3, y: 0.0, interval: Some([0.2, 0.4]) }, Mark::new(0.6, 1.0)];
        let svg = f.svg().unwrap();
        let height_of = |name: &str| -> i32 {
            let before = svg.split(&format!("\n{name}\n")).next().unwrap();
            let y = before.rsplit(" y=\"").next().unwrap();
            y.split('"').next().unwrap().parse().unwrap()
        };
        assert!(height_of("first") < height_of("second"), "{svg}");
    }

    #[test]
    fn a_figure_without_data_is_drawn() {
        let mut f = figure();
        f.series.clear();
        assert!(f.svg().is_ok() && f.pdf().is_ok());
    }
}
