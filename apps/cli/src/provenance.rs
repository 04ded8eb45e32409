//! Where a result comes from: the command, the version, the date, and the inputs with their hashes.

use crate::console::Result;
use blindaug::text::one_line;
use blindaug_io::{Error, Fingerprint, fingerprint};
use blindaug_report::{Provenance, ReadInput};
use std::{
    cell::RefCell,
    ffi::OsString,
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

thread_local! {
    /// The arguments that this thread runs, without the program's name.
    static ARGUMENTS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Keeps the arguments of the command line that this thread runs from now on, of which the first is the program's name.
pub fn begin(arguments: &[OsString]) {
    ARGUMENTS.set(arguments.iter().skip(1).map(|a| a.to_string_lossy().into_owned()).collect());
}

/// The arguments that this thread runs, without the program's name.
pub fn arguments() -> Vec<String> {
    ARGUMENTS.with_borrow(Vec::clone)
}

/// The command line that this thread runs.
fn command() -> String {
    let quoted = |a: String| if a.contains(char::is_whitespace) { format!("'{a}'") } else { a };
    let arguments: Vec<String> = arguments().into_iter().map(quoted).collect();
    one_line(&format!("blindaug {}", arguments.join(" ")))
}

/// The provenance of what this command makes from these inputs.
///
/// # Errors
/// If an input cannot be read.
pub fn of<'a>(inputs: impl IntoIterator<Item = &'a Path>) -> Result<Provenance> {
    let input = |path: &Path| -> Result<ReadInput> {
        let hash = fingerprint(path)?.map(|Fingerprint { sha256, of }| (sha256, of));
        Ok(ReadInput { name: Error::shown_path(path), sha256: hash })
    };
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    Ok(Provenance {
        command: command(),
        version: env!("CARGO_PKG_VERSION").into(),
        date: date(seconds),
        inputs: inputs.into_iter().map(input).collect::<Result<_>>()?,
    })
}

/// The date and time of so many seconds after the beginning of 1970, in UTC.
fn date(seconds: u64) -> String {
    let leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let (mut days, of_day) = (seconds / 86_400, seconds % 86_400);
    let mut year = 1970;
    while days >= if leap(year) { 366 } else { 365 } {
        days -= if leap(year) { 366 } else { 365 };
        year += 1;
    }
    let february = if leap(year) { 29 } else { 28 };
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hour, minute) = (of_day / 3600, of_day / 60 % 60);
    format!("{year}-{month:02}-{:02} {hour:02}:{minute:02} UTC", days + 1)
}

#[cfg(test)]
mod tests {
    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01 00:00 UTC"),
            (951_782_399, "2000-02-28 23:59 UTC"),
            (951_782_400, "2000-02-29 00:00 UTC"),
            (951_868_800, "2000-03-01 00:00 UTC"),
            (1_798_761_599, "2026-12-31 23:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00 UTC"),
        ] {
            assert_eq!(super::date(seconds), text);
        }
    }
}
