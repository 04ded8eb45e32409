//! The messages of a program: results on standard output, progress and notes on standard error; and the signals that stop the program.

use blindaug::text::{cut, printable};
use blindaug_io::{Error, Inputs, remove_incomplete_files, same_file, write_atomically};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    cell::RefCell,
    fmt::Display,
    io::{ErrorKind, IsTerminal, Write},
    path::Path,
    sync::atomic::{AtomicI32, Ordering},
    time::{Duration, Instant},
};

/// The reason why a command failed: one sentence that names the file, without a full stop.
#[derive(Debug)]
pub struct Failure(pub String);

/// The result type of the commands.
pub type Result<T> = std::result::Result<T, Failure>;

impl From<Error> for Failure {
    fn from(e: Error) -> Self {
        match e.is_over_budget() {
            true => Self(format!("{e} (--memory SIZE raises the budget)")),
            false => Self(e.to_string()),
        }
    }
}

/// Takes the sentence of the library, and adds the option that helps.
impl From<blindaug_pipeline::Error> for Failure {
    fn from(e: blindaug_pipeline::Error) -> Self {
        use blindaug_pipeline::Error as E;
        match e {
            E::File(e) => e.into(),
            E::NoSceneScale { is_model: true, .. } => Self(format!(
                "{e}: name a place whose distance is known (--at X,Y=METRES), blur the object like what is seen at a place (composite \
                 --match-at X,Y), or give --scene-scale S[,O], where relative inverse depth is S / Z + O"
            )),
            E::NoSceneScale { .. } => {
                Self(format!("{e}: give --scene-scale S[,O], where relative inverse depth is S / Z + O"))
            }
            E::NoMatch { .. } => Self(format!("{e} (--first N, --frames A..B)")),
            E::AlreadyThere { name } => {
                Self(format!("{name}: this is there already; add --overwrite, or give another name"))
            }
            E::OtherSettings { name } => Self(format!(
                "{name}: the frames there were made with other settings; add --overwrite to make them anew, or give another folder"
            )),
            _ => Self(e.to_string()),
        }
    }
}

/// The command line as an observer of jobs.
pub struct Console;

/// The console that all commands use.
pub const CONSOLE: &Console = &Console;

thread_local! {
    static RUNNING: RefCell<Option<Progress>> = const { RefCell::new(None) };
}

impl blindaug_pipeline::Observer for Console {
    fn begin(&self, what: &'static str, unit: &'static str, total: Option<usize>) {
        RUNNING.set(Some(Progress::counting(what, unit, total)));
    }

    fn step(&self) {
        RUNNING.with_borrow_mut(|progress| progress.iter_mut().for_each(Progress::step));
    }

    fn end(&self) {
        RUNNING.set(None);
    }

    fn note(&self, sentence: &str) {
        note(sentence);
    }

    fn warning(&self, sentence: &str) {
        warn(sentence);
    }

    fn stops(&self) -> bool {
        interrupted()
    }
}

/// A failure with a file's name and a sentence.
pub fn failure(path: &Path, sentence: impl Display) -> Failure {
    Failure(format!("{}: {sentence}", Error::shown_path(path)))
}

/// Prepares a program: sets the memory budget, if one is given, and lets writes to files that grow too large fail.
pub fn begin(memory: Option<u64>) {
    if let Some(bytes) = memory {
        blindaug_io::memory::set_budget(bytes);
    }
    catch_size_limit();
}

/// The exit status of a program whose command ended so; says why a command failed.
pub fn ended(result: Result<()>) -> u8 {
    let Err(Failure(sentence)) = result else { return 0 };
    // Standard error may be closed; there is nobody else to tell.
    let _ = writeln!(
        std::io::stderr(),
        "{} {}",
        Paint::of_stderr().bold_red("blindaug:"),
        for_terminal(&sentence)
    );
    exit_status()
}

/// Prints what the argument parser has to say, help or what is wrong with the arguments, and gives the exit status.
pub fn said(e: &clap::Error) -> u8 {
    if e.use_stderr() {
        let _ = write!(std::io::stderr(), "{}", for_terminal(&e.render().to_string()));
        return 2;
    }
    let help = e.render();
    let help = if Paint::of_stdout().0 { help.ansi().to_string() } else { help.to_string() };
    ended(print(&help))
}

/// Whether text is coloured.
#[derive(Clone, Copy)]
struct Paint(bool);

impl Paint {
    /// Colours only for a terminal that has them, and not if the environment variable NO_COLOR is set (no-color.org).
    fn of(stream: &impl IsTerminal) -> Self {
        let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty());
        Self(stream.is_terminal() && set("NO_COLOR").is_none() && set("TERM").is_none_or(|t| t != "dumb"))
    }

    fn of_stdout() -> Self {
        Self::of(&std::io::stdout())
    }

    fn of_stderr() -> Self {
        Self::of(&std::io::stderr())
    }

    fn with(self, code: &str, text: &str) -> String {
        if self.0 { format!("\x1b[{code}m{text}\x1b[0m") } else { text.into() }
    }

    fn bold_red(self, text: &str) -> String {
        self.with("1;31", text)
    }

    fn yellow(self, text: &str) -> String {
        self.with("33", text)
    }

    fn bold(self, text: &str) -> String {
        self.with("1", text)
    }

    /// A camera in words: the names at the beginning of lines are bold, what is unknown and warnings yellow.
    fn words(self, text: &str) -> String {
        let line = |line: &str| {
            let end = line.find(' ').unwrap_or(line.len());
            let (head, rest) = line.split_at(end);
            let marked = head == "Warning" || rest.trim_start().starts_with("unknown");
            match (head.is_empty(), marked) {
                (true, _) => line.into(),
                (false, true) => self.yellow(line),
                (false, false) => self.bold(head) + rest,
            }
        };
        text.split('\n').map(line).collect::<Vec<_>>().join("\n")
    }
}

/// Prints a camera in words on standard output, with colours where the terminal has them.
///
/// # Errors
/// The same as [`print()`].
pub fn print_words(text: &str) -> Result<()> {
    print(&Paint::of_stdout().words(text))
}

/// Writes text to standard output. A reader that has gone away (`| head`) is no error.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure(format!("standard output: cannot be written ({e})")))
        }
        _ => Ok(()),
    }
}

/// Writes text to standard output, or to standard error where standard output gets the file `output`.
pub fn print_beside(output: &Path, text: &str) -> Result<()> {
    if cfg!(unix) && same_file(output, Path::new("/dev/stdout")) {
        note(text.trim_end());
        return Ok(());
    }
    print(text)
}

/// The same as [`print_beside`] of a camera in words, with colours where the terminal has them.
///
/// # Errors
/// The same as [`print()`].
pub fn print_words_beside(output: &Path, text: &str) -> Result<()> {
    print_beside(output, &Paint::of_stdout().words(text))
}

/// Makes text safe for a terminal: characters that control the terminal are shown as codes, and very long words and lines lose their
/// middle.
pub fn for_terminal(text: &str) -> String {
    const LONGEST_WORD: usize = 300;
    const LONGEST_LINE: usize = 4000;
    let line = |line: &str| {
        let words: Vec<String> = line.split(' ').map(|word| cut(word, LONGEST_WORD)).collect();
        printable(&cut(&words.join(" "), LONGEST_LINE))
    };
    text.split('\n').map(line).collect::<Vec<_>>().join("\n")
}

/// Writes a line to standard error, above the progress bar if there is one.
pub fn note(sentence: impl Display) {
    write_line(for_terminal(&sentence.to_string()));
}

fn write_line(sentence: String) {
    let write = || {
        // If standard error cannot be written, the message is lost.
        let _ = writeln!(std::io::stderr(), "{sentence}");
    };
    BAR.with_borrow(|bar| match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    });
}

/// A note that something was left out or may be wrong.
pub fn warn(sentence: impl Display) {
    write_line(format!("{} {}", Paint::of_stderr().yellow("warning:"), for_terminal(&sentence.to_string())));
}

thread_local! {
    static BAR: RefCell<Option<ProgressBar>> = const { RefCell::new(None) };
}

/// The progress of a loop: a bar on a terminal, else a line every ten seconds.
pub struct Progress {
    what: &'static str,
    unit: &'static str,
    done: u64,
    total: Option<u64>,
    begun: Instant,
    last_said: Instant,
}

impl Progress {
    /// A loop that does `what` ("estimating") to `total` frames, if their number is known.
    pub fn new(what: &'static str, total: Option<usize>) -> Self {
        Self::counting(what, "frames", total)
    }

    /// A loop over `total` items called `unit`, such as "cases".
    pub fn counting(what: &'static str, unit: &'static str, total: Option<usize>) -> Self {
        let total = total.map(|n| n as u64);
        if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr());
            let template = match total {
                Some(_) => format!("{{msg}} {{wide_bar}} {{pos}}/{{len}} {unit}, {{eta}} left"),
                None if unit.is_empty() => "{msg} {spinner} {elapsed}".into(),
                None => format!("{{msg}} {{spinner}} {{pos}} {unit}, {{elapsed}}"),
            };
            if let Ok(style) = ProgressStyle::with_template(&template) {
                bar.set_style(style);
            }
            bar.set_message(what);
            // The time goes on while a single item takes long.
            bar.enable_steady_tick(Duration::from_millis(500));
            BAR.set(Some(bar));
        }
        Self { what, unit, done: 0, total, begun: Instant::now(), last_said: Instant::now() }
    }

    /// Counts one more item as done.
    pub fn step(&mut self) {
        self.done += 1;
        let bar = BAR.with_borrow(|bar| bar.as_ref().map(|b| b.inc(1)).is_some());
        if !bar && self.last_said.elapsed() > Duration::from_secs(10) {
            self.last_said = Instant::now();
            let of = self.total.map_or(String::new(), |n| format!(" of {n}"));
            let left = self.total.and_then(|n| left(self.begun.elapsed(), self.done, n));
            let left = left.map_or(String::new(), |s| format!(", about {s} left"));
            note(format_args!("{}: {}{of} {}{left}", self.what, self.done, self.unit));
        }
    }
}

/// The time that a loop will still take, in words, after `done` of `total` items; `None` if nothing is left.
fn left(elapsed: Duration, done: u64, total: u64) -> Option<String> {
    let rest = total.checked_sub(done).filter(|n| *n > 0)?;
    let seconds = elapsed.as_secs_f64() * rest as f64 / done.max(1) as f64;
    Some(match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    })
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = BAR.take() {
            bar.finish_and_clear();
        }
    }
}

/// The number of the signal that asked this program to stop; 0: none did.
static STOPPED_BY: AtomicI32 = AtomicI32::new(0);

/// Asks for a stop after the frame in hand; asked a second time, the program ends at once.
fn stop(signal: i32) {
    if STOPPED_BY.swap(signal, Ordering::Relaxed) != 0 {
        remove_incomplete_files();
        std::process::exit(128 + signal);
    }
    let _ = writeln!(std::io::stderr(), "\nstopping after this frame (Ctrl-C again: at once)");
}

/// Lets Ctrl-C, a request to end and a terminal that goes away stop the program after the frame in hand; a second signal stops it at once.
#[cfg(unix)]
pub fn catch_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = vec![SIGINT, SIGTERM];
    // A program that was started with nohup is to outlive its terminal.
    if !is_ignored(SIGHUP) {
        signals.push(SIGHUP);
    }
    match signal_hook::iterator::Signals::new(&signals) {
        Ok(mut signals) => drop(std::thread::spawn(move || signals.forever().for_each(stop))),
        Err(e) => warn(format_args!("Ctrl-C will stop at once ({e})")),
    }
}

/// Lets Ctrl-C stop the program after the frame in hand; a second signal stops it at once.
#[cfg(not(unix))]
pub fn catch_signals() {
    if let Err(e) = ctrlc::set_handler(|| stop(2)) {
        warn(format_args!("Ctrl-C will stop at once ({e})"));
    }
}

/// Makes a write beyond the allowed size of a file fail, so that it can be reported, instead of ending the program.
pub fn catch_size_limit() {
    #[cfg(unix)]
    // If this fails, such a write ends the program as before.
    let _ = signal_hook::flag::register(
        signal_hook::consts::SIGXFSZ,
        std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false)),
    );
}

/// Whether this program was started with a signal ignored, where the system tells (Linux).
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|l| l.strip_prefix("SigIgn:"))
        .and_then(|m| u64::from_str_radix(m.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Whether the program was asked to stop.
pub fn interrupted() -> bool {
    STOPPED_BY.load(Ordering::Relaxed) != 0
}

/// The exit status of a command that failed: 1, or the shell's convention for a signal if one stopped it (130 for Ctrl-C).
pub fn exit_status() -> u8 {
    match STOPPED_BY.load(Ordering::Relaxed) {
        0 => 1,
        signal => u8::try_from(128 + signal).unwrap_or(1),
    }
}

/// Checks, before anything is read, that files can be written, that none of them is an input, and that they are different files. Leftovers
/// of these files from earlier runs that were killed are removed.
///
/// # Errors
/// If a file cannot be used; the sentence names it and says what to do.
pub fn check_outputs<'a>(inputs: &Inputs, outputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
    let outputs: Vec<&Path> = outputs.into_iter().collect();
    for (i, output) in outputs.iter().enumerate() {
        if output.is_dir() {
            return Err(failure(output, "this is a folder; give the name of a file"));
        }
        inputs.check_output(output)?;
        if outputs[..i].iter().any(|other| same_file(other, output)) {
            return Err(failure(
                output,
                "two results would be written to this one file; give each a name of its own",
            ));
        }
        blindaug_io::check_writable(output)?;
    }
    Ok(())
}

/// Writes an HTML page, whole or not at all.
///
/// # Errors
/// If the page could not be made or cannot be written; then no file is left.
pub fn write_page(path: &Path, page: blindaug_report::Result<String>) -> Result<()> {
    let page = page.map_err(|e| failure(path, e))?;
    Ok(write_atomically(path, |partial| std::fs::write(partial, page))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_coloured_only_where_they_may_be() {
        let text = "Camera     8 x 8 px\nWarning    few frames\nExposure   unknown: still\n           more\n";
        assert_eq!(Paint(false).words(text), text);
        let painted = Paint(true).words(text);
        assert!(
            painted.starts_with("\x1b[1mCamera\x1b[0m     8 x 8 px\n\x1b[33mWarning    few"),
            "{painted:?}"
        );
        assert!(
            painted.contains("\x1b[33mExposure   unknown: still\x1b[0m\n           more\n"),
            "{painted:?}"
        );
    }

    #[test]
    fn the_time_that_is_left_is_told_in_words() {
        let after = |seconds, done, total| left(Duration::from_secs(seconds), done, total);
        assert_eq!(after(10, 1, 4).as_deref(), Some("30 s"));
        assert_eq!(after(60, 6, 66).as_deref(), Some("10 min"));
        assert_eq!(after(3600, 10, 40).as_deref(), Some("3.0 h"));
        assert_eq!((after(10, 4, 4), after(10, 5, 4)), (None, None));
    }
}
