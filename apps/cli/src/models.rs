//! `blindaug models`: lists, installs and checks networks.

use crate::console::{self, Failure, Progress, Result, note, warn};
use blindaug::{Encoded, Raster};
use blindaug_io::memory;
use blindaug_nets::{Manifest, Slot, State, Store, install, manifest::Kind};
use std::{
    fmt::Write as _,
    io::{IsTerminal, Write},
    path::PathBuf,
    time::Instant,
};

/// List, install and check networks that remove noise or blur, or find flow or depth
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug models install ffdnet-color")]
pub struct Models {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// All networks that can be named: what each does, its licence, and whether it is there
    List,
    /// Get a network into the model folder; its licence is shown first
    Install(Install),
    /// Print the model folder: a folder per network, with NAME.toml and its ONNX file (BLINDAUG_MODELS sets another)
    Path,
    /// Run networks on a test frame: whether their files are whole, what they give, how long it takes
    Check(Check),
}

#[derive(clap::Args)]
struct Install {
    /// A name of `blindaug models list`
    name: String,
    /// An ONNX file that was exported, instead of where the manifest says
    #[arg(long, value_name = "FILE.onnx")]
    from: Option<PathBuf>,
    /// Accept the licence without being asked
    #[arg(short, long)]
    yes: bool,
}

#[derive(clap::Args)]
struct Check {
    /// Names, or manifests [default: all that are there]
    names: Vec<String>,
    /// Width and height of the test frame, px [default: 512x512, or a network's own]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
}

fn size(text: &str) -> std::result::Result<(usize, usize), String> {
    let side = |t: &str| t.parse::<usize>().ok().filter(|s| (1..=8192).contains(s));
    let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
    sides.ok_or_else(|| "it must be a width and a height of 1 to 8192 px, as 512x512".into())
}

/// Runs the command.
pub fn run(args: &Models) -> Result<()> {
    let store = Store::user();
    match &args.command {
        Command::List => list(&store),
        Command::Install(args) => get(&store, args),
        Command::Path => console::print(&format!("{}\n", store.folder().display())),
        Command::Check(args) => check(&store, args),
    }
}

fn list(store: &Store) -> Result<()> {
    let (networks, problems) = store.list();
    for problem in problems {
        warn(problem);
    }
    let name_width = networks.iter().map(|n| n.0.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    let mut last: Option<Slot> = None;
    for (Manifest { name, operator, title, licence, install, .. }, state) in &networks {
        if last.replace(*operator) != Some(*operator) {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{}", operator.name());
        }
        let state = match (state, install) {
            (State::BuiltIn, _) => "built in",
            (State::Installed(_), _) => "installed",
            (State::Missing, Some(_)) => "can be installed",
            (State::Missing, None) => "needs its file",
        };
        let _ = writeln!(text, "  {name:name_width$}  {state:16}  {title} [{licence}]");
    }
    console::print(&text)
}

fn get(store: &Store, args: &Install) -> Result<()> {
    let Install { name, from, yes } = args;
    let Manifest { title, licence, source, .. } = store.find(name)?;
    if Store::is_built_in(name) {
        return Err(Failure(format!("{name} is built in: there is nothing to install")));
    }
    note(format_args!("{name}: {title}\nlicence: {licence}\nsource: {source}"));
    if let (None, Some(plan)) = (from, install::plan(store, name)?) {
        note(format_args!("gets: {plan}"));
    }
    if !yes {
        if !std::io::stdin().is_terminal() {
            return Err(Failure(format!(
                "to accept the licence of {name} ({licence}), run the command with --yes"
            )));
        }
        let mut answer = String::new();
        // If standard error cannot be written, the question is lost.
        let _ = write!(std::io::stderr(), "Accept the licence and install? [y/N] ");
        let _ = std::io::stdin().read_line(&mut answer);
        if !matches!(answer.trim(), "y" | "Y" | "yes") {
            return Err(Failure("nothing was installed".into()));
        }
    }
    let progress = Progress::counting("installing", "", None);
    let manifest = install::install(store, name, from.as_deref(), &|step| note(step))?;
    drop(progress);
    note(format_args!("installed: {}", manifest.display()));
    Ok(())
}

fn check(store: &Store, args: &Check) -> Result<()> {
    let names = match &args.names[..] {
        [] => {
            let (networks, problems) = store.list();
            for problem in problems {
                warn(problem);
            }
            networks.into_iter().filter(|n| n.1 != State::Missing).map(|n| n.0.name).collect()
        }
        names => names.to_vec(),
    };
    if names.is_empty() {
        note("no network is installed: `blindaug models list` says which can be");
    }
    let mut failed = 0;
    for name in &names {
        match checked(store, name, args.size) {
            Ok(line) => console::print(&line)?,
            Err(e) => {
                failed += 1;
                warn(e);
            }
        }
    }
    match failed {
        0 => Ok(()),
        n => Err(Failure(format!("{n} of {} networks cannot be used", names.len()))),
    }
}

/// A line with the range of a network's output for a test frame, and the time that it takes.
fn checked(store: &Store, name: &str, size: Option<(usize, usize)>) -> blindaug_io::Result<String> {
    let start = Instant::now();
    let network = store.open(name)?;
    let loaded = start.elapsed();
    let input = &network.manifest().input;
    let side = input.tile.unwrap_or(512).min(512);
    let (w, h) = size.or(input.size.map(|[w, h]| (w, h))).unwrap_or((side, side));
    // The test frames show stripes and steps that move a little from frame to frame.
    let frame = |t: usize| {
        Encoded(Raster::from_fn(w, h, |x, y| {
            let wave = |k: usize| 0.5 + 0.35 * (((x + 2 * t) * k) as f32 * 0.013 + y as f32 * 0.021).sin();
            [wave(1), wave(7), if (x / 37 + y / 23) % 2 == 0 { 0.2 } else { 0.7 }]
        }))
    };
    let frames: Vec<Encoded> = (0..input.frames.len()).map(frame).collect();
    let frames: Vec<&Encoded> = frames.iter().collect();
    let range = |values: &[f32]| {
        let (lo, hi) = values.iter().fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
        format!("{lo:.3} to {hi:.3}")
    };
    let start = Instant::now();
    let gives = match network.manifest().output.kind {
        Kind::Image | Kind::Residual => {
            format!("a frame, {}", range(network.image(&frames)?.0.data().as_flattened()))
        }
        Kind::Flow => format!("flow, {} px", range(network.flow(&frames)?.data().as_flattened())),
        Kind::InverseDepth | Kind::Depth => {
            format!("inverse depth, {}", range(network.inverse_depth(&frames)?.0.data()))
        }
    };
    let seconds = start.elapsed().as_secs_f32();
    let memory = memory::most().map_or(String::new(), |m| format!(", {} MB at most so far", m >> 20));
    Ok(format!(
        "{:28} {w} x {h} px: {gives}; {seconds:.2} s in {}, loaded in {:.2} s{memory}\n",
        network.manifest().name,
        network.runtime(),
        loaded.as_secs_f32()
    ))
}
