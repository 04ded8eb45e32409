//! Tables of results, written once and shown as CSV, LaTeX, HTML and text.

use crate::statistics::Mean;
use maud::{Markup, html};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// A table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The name of the table's files.
    pub name: String,
    /// What the table shows, in whole sentences.
    pub caption: String,
    /// The columns' names, with their units.
    pub head: Vec<String>,
    /// The rows, each with a cell for every column.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Cell {
    /// Nothing was measured.
    Empty,
    /// A name or a few words.
    Text(String),
    /// A number with so many digits after the point.
    Number(f64, usize),
    /// A mean with its standard deviation and the number of samples, with so many digits.
    Spread(Mean, usize),
    /// A number with its 95 % interval, or a median with its quartiles, with so many digits.
    Interval(f64, [f64; 2], usize),
    /// A probability of a test; very small ones are shown with an exponent.
    Probability(f64),
}

impl Cell {
    /// A cell of text.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A mean with its spread; empty where there is none.
    pub fn spread(mean: Option<Mean>, digits: usize) -> Self {
        mean.map_or(Self::Empty, |m| Self::Spread(m, digits))
    }

    /// A number; empty where there is none, or it is not a number.
    pub fn number(v: Option<f64>, digits: usize) -> Self {
        v.filter(|v| !v.is_nan()).map_or(Self::Empty, |v| Self::Number(v, digits))
    }

    /// The cell as it is shown to people.
    pub fn shown(&self) -> String {
        match self {
            Self::Empty => "\u{2013}".into(),
            Self::Text(text) => text.clone(),
            Self::Number(v, digits) => fixed(*v, *digits),
            Self::Spread(m, digits) if m.n == 1 => format!("{} (n 1)", fixed(m.mean, *digits)),
            Self::Spread(m, digits) => {
                format!("{} ± {} (n {})", fixed(m.mean, *digits), fixed(m.std, *digits), m.n)
            }
            Self::Interval(v, [low, high], digits) => {
                let [v, low, high] = [*v, *low, *high].map(|v| fixed(v, *digits));
                format!("{v} [{low}, {high}]")
            }
            Self::Probability(p) if *p < 1e-3 => format!("{p:.0e}"),
            Self::Probability(p) => fixed(*p, 3),
        }
    }

    /// The names of the columns of a CSV file that the cell needs beside the first.
    fn parts(&self) -> &'static [&'static str] {
        match self {
            Self::Spread(..) => &["std", "n"],
            Self::Interval(..) => &["low", "high"],
            _ => &[],
        }
    }

    /// The cell's values in a CSV file, unrounded.
    fn values(&self) -> Vec<String> {
        match self {
            Self::Empty => vec![String::new()],
            Self::Text(text) => vec![text.clone()],
            Self::Number(v, _) | Self::Probability(v) => vec![v.to_string()],
            Self::Spread(m, _) => vec![m.mean.to_string(), m.std.to_string(), m.n.to_string()],
            Self::Interval(v, [low, high], _) => [v, low, high].map(f64::to_string).to_vec(),
        }
    }
}

/// A number with so many digits after the point; a zero has no sign.
fn fixed(v: f64, digits: usize) -> String {
    let text = format!("{v:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.into(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text,
    }
}

impl Table {
    /// The table as a CSV file, with unrounded numbers; the spread and the interval of a number have columns of their own.
    pub fn csv(&self) -> String {
        let parts: Vec<&[&str]> = (0..self.head.len())
            .map(|i| self.rows.iter().map(|r| r[i].parts()).max_by_key(|p| p.len()).unwrap_or(&[]))
            .collect();
        let mut writer = csv::Writer::from_writer(vec![]);
        let head = self.head.iter().zip(&parts).flat_map(|(name, parts)| {
            std::iter::once(name.clone()).chain(parts.iter().map(move |part| format!("{name}: {part}")))
        });
        let mut write = |record: Vec<String>| writer.write_record(record).expect("memory takes every record");
        write(head.collect());
        for row in &self.rows {
            let cells = row.iter().zip(&parts).flat_map(|(cell, parts)| {
                let mut values = cell.values();
                values.resize(1 + parts.len(), String::new());
                values
            });
            write(cells.collect());
        }
        String::from_utf8(writer.into_inner().expect("memory is always flushed")).expect("strings are UTF-8")
    }

    /// The table for LaTeX, with the rules of the package booktabs.
    pub fn latex(&self) -> String {
        let columns: String = (0..self.head.len()).map(|i| if self.is_text(i) { 'l' } else { 'r' }).collect();
        let line = |cells: Vec<String>| format!("  {} \\\\\n", cells.join(" & "));
        let mut text =
            format!("% {}\n\\begin{{tabular}}{{{columns}}}\n  \\toprule\n", one_line(&self.caption));
        text += &line(self.head.iter().map(|h| latex(h)).collect());
        text += "  \\midrule\n";
        for row in &self.rows {
            text += &line(row.iter().map(|c| latex(&c.shown())).collect());
        }
        text + "  \\bottomrule\n\\end{tabular}\n"
    }

    /// The table for a page.
    pub fn html(&self) -> Markup {
        html! {
            p.soft { (self.caption) }
            div.wide { table {
                thead { tr { @for h in &self.head { th scope="col" { (h) } } } }
                tbody { @for row in &self.rows { tr { @for (i, cell) in row.iter().enumerate() {
                    // On a narrow screen a row is a paragraph, in which the first cell is the heading and the others say what they are.
                    @let label = (i > 0).then(|| &self.head[i]);
                    @if self.is_text(i) { td.name[self.is_short(i)] data-label=[label] { (cell.shown()) } }
                    @else { td.number data-label=[label] { (cell.shown()) } }
                } } } }
            } }
        }
    }

    /// The table for a terminal.
    pub fn text(&self) -> String {
        let shown: Vec<Vec<String>> = [self.head.clone()]
            .into_iter()
            .chain(self.rows.iter().map(|r| r.iter().map(Cell::shown).collect()))
            .collect();
        let width = |i: usize| shown.iter().map(|r| r[i].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.head.len()).map(width).collect();
        let mut text = String::new();
        for row in &shown {
            let cells: Vec<String> = row.iter().zip(&widths).map(|(c, &w)| format!("{c:w$}")).collect();
            let _ = writeln!(text, "{}", cells.join("  ").trim_end());
        }
        text
    }

    /// Whether all cells of a column are so short that they stay in one line.
    fn is_short(&self, column: usize) -> bool {
        self.rows.iter().all(|r| r[column].shown().chars().count() <= 32)
    }

    fn is_text(&self, column: usize) -> bool {
        self.rows.iter().any(|r| matches!(r[column], Cell::Text(_)))
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The text with the characters replaced that LaTeX would take for commands.
fn latex(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out += "\\textbackslash{}",
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            '\u{2212}' => out += "$-$",
            '\u{2013}' => out += "--",
            '±' => out += "$\\pm$",
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        Table {
            name: "psnr".into(),
            caption: "PSNR\nover the object.".into(),
            head: ["method", "PSNR, dB", "p", "slope"].map(String::from).into(),
            rows: vec![
                vec![
                    Cell::text("Okumura_like, 50 %"),
                    Cell::Spread(Mean { mean: 30.25, std: 1.5, n: 6 }, 1),
                    Cell::Probability(4e-12),
                    Cell::Interval(-0.04, [-1.0, 1.25], 1),
                ],
                vec![
                    Cell::text("ours"),
                    Cell::spread(None, 1),
                    Cell::Number(1.0, 0),
                    Cell::number(Some(f64::NAN), 1),
                ],
            ],
        }
    }

    #[test]
    fn a_csv_file_has_a_column_for_every_number() {
        let want = "method,\"PSNR, dB\",\"PSNR, dB: std\",\"PSNR, dB: n\",p,slope,slope: low,slope: high\n\
                    \"Okumura_like, 50 %\",30.25,1.5,6,0.000000000004,-0.04,-1,1.25\nours,,,,1,,,\n";
        assert_eq!(table().csv(), want);
    }

    #[test]
    fn latex_has_its_special_characters_escaped() {
        let tex = table().latex();
        assert!(tex.starts_with("% PSNR over the object.\n\\begin{tabular}{lrrr}"), "{tex}");
        assert!(
            tex.contains("Okumura\\_like, 50 \\% & 30.2 $\\pm$ 1.5 (n 6) & 4e-12 & 0.0 [$-$1.0, 1.2] \\\\"),
            "{tex}"
        );
    }

    #[test]
    fn every_format_shows_the_same_cells() {
        let (html, text) = (table().html().into_string(), table().text());
        assert!(
            html.contains("data-label=\"PSNR, dB\">30.2 ± 1.5 (n 6)")
                && !html.contains("data-label=\"method\""),
            "{html}"
        );
        for cell in ["30.2 ± 1.5 (n 6)", "4e-12", "0.0 [−1.0, 1.2]"] {
            assert!(html.contains(cell) && text.contains(cell), "{cell}: {html}\n{text}");
        }
    }
}
