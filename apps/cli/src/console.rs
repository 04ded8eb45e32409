//! What the program says: results on standard output, progress and notes on standard error, Ctrl-C.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    cell::RefCell,
    fmt::Display,
    io::{ErrorKind, IsTerminal, Write},
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

/// Why a command failed, in one sentence that names the file, without a full stop.
#[derive(Debug)]
pub struct Failure(pub String);

/// The result type of the commands.
pub type Result<T> = std::result::Result<T, Failure>;

impl From<blindaug_io::Error> for Failure {
    fn from(e: blindaug_io::Error) -> Self {
        Self(e.to_string())
    }
}

/// A failure of a file.
pub fn failure(path: &Path, sentence: impl Display) -> Failure {
    Failure(format!("{}: {sentence}", path.display()))
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

/// Writes a line to standard error, above the progress bar if there is one.
pub fn note(sentence: impl Display) {
    let write = || {
        // Nobody is left to be told if this fails.
        let _ = writeln!(std::io::stderr(), "{sentence}");
    };
    BAR.with_borrow(|bar| match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    });
}

/// A note that something was left out or may be wrong.
pub fn warn(sentence: impl Display) {
    note(format_args!("warning: {sentence}"));
}

thread_local! {
    static BAR: RefCell<Option<ProgressBar>> = const { RefCell::new(None) };
}

/// How far a loop over frames has come: a bar on a terminal, else a line every ten seconds.
pub struct Progress {
    what: &'static str,
    unit: &'static str,
    done: u64,
    total: Option<u64>,
    last_said: Instant,
}

impl Progress {
    /// A loop that does `what` ("estimating") to `total` frames, if their number is known.
    pub fn new(what: &'static str, total: Option<usize>) -> Self {
        Self::counting(what, "frames", total)
    }

    /// A loop over other things than frames.
    pub fn counting(what: &'static str, unit: &'static str, total: Option<usize>) -> Self {
        let total = total.map(|n| n as u64);
        if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr());
            let template = match total {
                Some(_) => format!("{{msg}} {{wide_bar}} {{pos}}/{{len}} {unit}, {{eta}} left"),
                None => format!("{{msg}} {{spinner}} {{pos}} {unit}, {{elapsed}}"),
            };
            if let Ok(style) = ProgressStyle::with_template(&template) {
                bar.set_style(style);
            }
            bar.set_message(what);
            BAR.set(Some(bar));
        }
        Self { what, unit, done: 0, total, last_said: Instant::now() }
    }

    /// One more frame is done.
    pub fn step(&mut self) {
        self.done += 1;
        let bar = BAR.with_borrow(|bar| bar.as_ref().map(|b| b.inc(1)).is_some());
        if !bar && self.last_said.elapsed() > Duration::from_secs(10) {
            self.last_said = Instant::now();
            let of = self.total.map_or(String::new(), |n| format!(" of {n}"));
            note(format_args!("{}: {}{of} {}", self.what, self.done, self.unit));
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = BAR.take() {
            bar.finish_and_clear();
        }
    }
}

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Lets Ctrl-C stop after the frame in hand; a second one stops at once.
pub fn catch_interrupt() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        let _ = writeln!(std::io::stderr(), "\nstopping after this frame (Ctrl-C again: at once)");
    };
    if let Err(e) = ctrlc::set_handler(handler) {
        warn(format_args!("Ctrl-C will stop at once ({e})"));
    }
}

/// Whether Ctrl-C was pressed.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Checks, before the work starts, that a file can be written.
///
/// # Errors
/// If its folder is missing or cannot be written to, or the path is a folder's.
pub fn check_writable(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(failure(path, "this is a folder; give the name of a file"));
    }
    if path.file_name().is_none() {
        return Err(failure(path, "this is not the name of a file to write"));
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(failure(
            path,
            format_args!("there is no folder {} to write it to; make it first", folder.display()),
        ));
    }
    check_folder_writable(folder)
}

/// Checks that a file can be made in a folder.
pub fn check_folder_writable(folder: &Path) -> Result<()> {
    let probe = folder.join(format!(".blindaug-{}", std::process::id()));
    std::fs::File::create(&probe).and_then(|_| std::fs::remove_file(&probe)).map_err(|e| {
        failure(folder, format_args!("no file can be written to this folder ({e}); choose another"))
    })
}

/// Makes a folder for results, with those above it.
pub fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|e| failure(folder, format_args!("the folder cannot be made ({e}); choose another")))?;
    check_folder_writable(folder)
}
