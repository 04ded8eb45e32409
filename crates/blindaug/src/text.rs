//! Text from outside (a file, a name, another program's message), made safe to show.
//!
//! Nothing that a file says may end a comment of another language, move a terminal's cursor, or fill a screen. So every such text
//! passes one of these functions where it enters a message or a model, and once more where it is shown.

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
    fn what_a_terminal_or_a_language_would_obey_is_shown_as_a_code() {
        assert_eq!(one_line("a\nimport os\r\n b"), "a import os b");
        assert_eq!(one_line("\u{1b}[2J\u{9b}1m\u{7}"), "\\u{1b}[2J\\u{9b}1m\\u{7}");
        // A line separator of JavaScript is white space; a mark of direction and a null are not.
        assert_eq!(one_line("a\u{2028}b\u{85}c\u{202e}d\0"), "a b c\\u{202e}d\\u{0}");
        assert_eq!(printable("two\nlines\tkept\u{1b}"), "two\nlines\tkept\\u{1b}");
        assert_eq!(one_line("größe, 日本, 1/255 ±"), "größe, 日本, 1/255 ±");
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
