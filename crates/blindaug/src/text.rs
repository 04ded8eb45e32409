//! Text from outside (a file, a name, another program's message), made safe to show.
//!
//! Nothing that a file says may end a comment of another language, move a terminal's cursor, or fill a screen. So every such text
//! passes one of these functions where it enters a message or a model, and once more where it is shown.

use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter};
use std::io::Write;

/// The largest number of characters that a message shows of a text from outside.
pub const LONGEST: usize = 500;

/// Whether a character is shown as a code instead of itself: control characters, which terminals obey; separators that some
/// languages take for the end of a line; and marks that reverse the direction of what follows or cannot be seen.
fn hidden(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

/// The text with its invisible characters shown as codes, such as `\u{1b}`. Line breaks and tabs are kept.
pub fn printable(text: &str) -> String {
    shown(text, |c| hidden(c) && c != '\n' && c != '\t')
}

/// The text as one printable line: white space becomes single spaces, invisible characters are shown as codes, and the middle of a
/// text of more than [`LONGEST`] characters is left out.
pub fn one_line(text: &str) -> String {
    // Only the first words are read, so that a huge text costs nothing.
    let words = text.split_whitespace().take(LONGEST + 1).collect::<Vec<_>>().join(" ");
    shown(&cut(&words, LONGEST), hidden)
}

/// The text; if it has more than `most` characters, its beginning and its end with ` .. ` between them.
pub fn cut(text: &str, most: usize) -> String {
    if text.chars().nth(most).is_none() {
        return text.into();
    }
    let end = most / 4;
    let start = (most - end).saturating_sub(4);
    let first: String = text.chars().take(start).collect();
    let skip = text.char_indices().rev().nth(end.saturating_sub(1)).map_or(text.len(), |(i, _)| i);
    format!("{first} .. {}", &text[if end == 0 { text.len() } else { skip }..])
}

/// What is wrong with a text that is no JSON, or JSON of another kind: a clause.
pub fn why_not_json(text: &str, error: &serde_json::Error) -> String {
    if text.trim().is_empty() {
        return "it is empty".into();
    }
    if error.is_eof() {
        return "it ends in the middle, as if it had been cut off".into();
    }
    one_line(&error.to_string())
}

/// The number of significant digits of numbers in files.
const DIGITS: usize = 6;

/// Ranges of whole numbers, both ends included, such as `3 to 5, 9`. Of many ranges the first few stand for all, and how many numbers these are is
/// told.
pub fn ranges_in_words(ranges: &[(u64, u64)]) -> String {
    const LISTED: usize = 5;
    let listed: Vec<String> = ranges
        .iter()
        .take(LISTED)
        .map(|(a, b)| if a == b { a.to_string() } else { format!("{a} to {b}") })
        .collect();
    let all: u64 = ranges.iter().map(|(a, b)| b - a + 1).sum();
    let more = if ranges.len() > LISTED { format!(", ... ({all} in all)") } else { String::new() };
    format!("{}{more}", listed.join(", "))
}

/// The number with six significant digits: beyond those lie the errors of arithmetic with f32, which make 0.48 a 0.47999998.
pub fn rounded(v: f32) -> f32 {
    format!("{v:.*e}", DIGITS - 1).parse().unwrap_or(v)
}

/// Writes numbers of type f32 with six significant digits, all else as the formatter within does.
struct Rounded<F>(F);

impl<F: Formatter> Formatter for Rounded<F> {
    fn write_f32<W: ?Sized + Write>(&mut self, writer: &mut W, v: f32) -> std::io::Result<()> {
        self.0.write_f32(writer, rounded(v))
    }
    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.begin_array(writer)
    }
    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.end_array(writer)
    }
    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> std::io::Result<()> {
        self.0.begin_array_value(writer, first)
    }
    fn end_array_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.end_array_value(writer)
    }
    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.begin_object(writer)
    }
    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.end_object(writer)
    }
    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> std::io::Result<()> {
        self.0.begin_object_key(writer, first)
    }
    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.begin_object_value(writer)
    }
    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.0.end_object_value(writer)
    }
}

/// A value whose maps have only string keys, as JSON over several lines; numbers of type f32 have six significant digits.
pub(crate) fn json_pretty(value: &impl Serialize) -> String {
    json(value, PrettyFormatter::new())
}

/// The same as [`json_pretty`] in one line.
pub(crate) fn json_line(value: &impl Serialize) -> String {
    json(value, CompactFormatter)
}

fn json(value: &impl Serialize, formatter: impl Formatter) -> String {
    let mut out = vec![];
    let mut serializer = serde_json::Serializer::with_formatter(&mut out, Rounded(formatter));
    value.serialize(&mut serializer).expect("all keys are strings, and a Vec takes all bytes");
    String::from_utf8(out).expect("JSON is text")
}

fn shown(text: &str, hidden: impl Fn(char) -> bool) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if hidden(c) { out.extend(c.escape_unicode()) } else { out.push(c) }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_that_ends_too_early_is_told_from_wrong_json() {
        let why = |json: &str| why_not_json(json, &serde_json::from_str::<Vec<u8>>(json).unwrap_err());
        assert_eq!([why(""), why(" \n")], ["it is empty"; 2]);
        assert_eq!(why("[1,\n2"), "it ends in the middle, as if it had been cut off");
        assert!(why("[1, x]").contains("expected value"), "{}", why("[1, x]"));
    }

    #[test]
    fn what_a_terminal_or_a_language_would_obey_is_shown_as_a_code() {
        assert_eq!(one_line("a\nimport os\r\n b"), "a import os b");
        assert_eq!(one_line("\u{1b}[2J\u{9b}1m\u{7}"), "\\u{1b}[2J\\u{9b}1m\\u{7}");
        // A line separator of JavaScript is white space; a mark of direction and a null are not.
        assert_eq!(one_line("a\u{2028}b\u{85}c\u{202e}d\0"), "a b c\\u{202e}d\\u{0}");
        assert_eq!(printable("two\nlines\tkept\u{1b}"), "two\nlines\tkept\\u{1b}");
        assert_eq!(one_line("größe, 日本, 1/255 ±"), "größe, 日本, 1/255 ±");
    }

    #[test]
    fn numbers_in_files_have_six_digits() {
        let dust = 0.1f32 + 0.7 - 0.32;
        assert_ne!(dust.to_string(), "0.48");
        assert_eq!(json_line(&[dust, 0.0, 123.456_79, -7.614_714e-7]), "[0.48,0.0,123.457,-7.61471e-7]");
        assert_eq!(json_pretty(&[0.5f64]), "[\n  0.5\n]");
        assert!(rounded(f32::NAN).is_nan());
    }

    #[test]
    fn a_long_text_loses_its_middle() {
        let long = one_line(&"x".repeat(5_000_000));
        assert!(long.chars().count() <= LONGEST && long.contains(" .. "), "{}", long.len());
        assert!(one_line(&"é ".repeat(100_000)).chars().count() <= LONGEST);
        assert_eq!(cut("abcdefghij", 10), "abcdefghij");
        assert_eq!(cut("abcdefghijkl", 8), "ab .. kl");
        // A control character becomes a code of six characters.
        assert!(one_line(&"\u{1b}".repeat(9000)).len() <= 8 * LONGEST);
    }
}
