//! A run of experiments: its folder, the cases that it has done, and its results in files.
//!
//! A case that is done is written down at once, so that a run that was stopped goes on where it stopped. Results say by what command, with
//! which seed and version, and on what machine they were made.

use crate::figure::Figure;
use crate::table::Table;
use blindaug_io::{Error, Result, make_folder, remove_leftovers_in, write_atomically};
use blindaug_pipeline::{Observer, Steps};
use blindaug_report::{page_with, plots::in_page};
use maud::{Markup, html};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::cell::Cell;
use std::path::{Path, PathBuf};

/// By what results were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The command line.
    pub command: String,
    /// The version of the program.
    pub version: String,
    /// The seed of everything that is drawn at random.
    pub seed: u64,
    /// The machine: its processor, the number of its threads, its operating system.
    pub machine: String,
}

impl Provenance {
    /// The provenance of what this process does.
    pub fn here(seed: u64) -> Self {
        let command: Vec<String> = std::env::args().collect();
        Self {
            command: command.join(" "),
            version: env!("CARGO_PKG_VERSION").into(),
            seed,
            machine: machine(),
        }
    }
}

/// The machine in words.
fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let processor =
        text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':').map(|p| p.1.trim()));
    let processor = processor.unwrap_or(std::env::consts::ARCH);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{processor}, {threads} threads, {}", std::env::consts::OS)
}

/// What an experiment found: a section of the page, and a folder of files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Findings {
    /// The name of the folder.
    pub name: String,
    /// The heading.
    pub title: String,
    /// What was done and what it says, a paragraph each.
    pub text: Vec<String>,
    /// The tables.
    pub tables: Vec<Table>,
    /// The figures.
    pub figures: Vec<Figure>,
    /// Rows of pictures.
    pub pictures: Vec<Pictures>,
    /// Other files of the folder, each with what it is.
    pub files: Vec<(String, PathBuf)>,
}

/// Pictures to compare, side by side.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pictures {
    /// The heading of the row.
    pub title: String,
    /// The pictures' captions and their PNG files in the experiment's folder.
    pub files: Vec<(String, PathBuf)>,
}

/// A run of experiments in a folder.
pub struct Run<'a> {
    folder: PathBuf,
    provenance: Provenance,
    overwrite: bool,
    observer: &'a dyn Observer,
    /// The numbers of cases: done by an earlier run, done, and all.
    counts: Cell<[usize; 3]>,
}

/// The stored form of a case.
#[derive(Serialize, Deserialize)]
struct Stored<C, O> {
    version: String,
    case: C,
    outcome: O,
}

impl<'a> Run<'a> {
    /// A run whose files lie in `folder`, which is made. With `overwrite`, cases that are done already are done again.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn new(
        folder: &Path,
        provenance: Provenance,
        overwrite: bool,
        observer: &'a dyn Observer,
    ) -> Result<Self> {
        make_folder(folder)?;
        remove_leftovers_in(folder, |_| true);
        Ok(Self { folder: folder.into(), provenance, overwrite, observer, counts: Cell::new([0; 3]) })
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.provenance.seed
    }

    /// The folder of an experiment, which is made.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn folder(&self, experiment: &str) -> Result<PathBuf> {
        let folder = self.folder.join(experiment);
        make_folder(&folder)?;
        remove_leftovers_in(&folder, |_| true);
        Ok(folder)
    }

    /// The path of a file of the run.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The observer of the run.
    pub fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    /// The numbers of cases so far: done by an earlier run, done, and all. If not all are done, the observer has stopped the run.
    pub fn counts(&self) -> [usize; 3] {
        self.counts.get()
    }

    /// Whether the observer has stopped the run.
    pub fn is_stopped(&self) -> bool {
        let [_, done, all] = self.counts();
        done < all
    }

    /// The cases of an experiment with their outcomes, in their order; fewer if the observer stops the run. Each case has a name, which is
    /// that of its file. An outcome of the same case and version that lies there is taken as it is; the others are made and stored.
    ///
    /// # Errors
    /// If a case fails, or an outcome cannot be written.
    pub fn cases<C: Serialize + DeserializeOwned + PartialEq, O: Serialize + DeserializeOwned>(
        &self,
        experiment: &'static str,
        cases: Vec<(String, C)>,
        mut outcome: impl FnMut(&C) -> Result<O>,
    ) -> Result<Vec<(C, O)>> {
        let folder = self.folder(&format!("{experiment}/cases"))?;
        let steps = Steps::begin(self.observer, experiment, "cases", Some(cases.len()));
        let mut all = vec![];
        let count = |which: usize, n: usize| {
            let mut counts = self.counts.get();
            counts[which] += n;
            self.counts.set(counts);
        };
        count(2, cases.len());
        for (name, case) in cases {
            let path = folder.join(format!("{name}.json"));
            let known = if self.overwrite { None } else { self.stored(&path, &case) };
            let made = match known {
                Some(made) => {
                    count(0, 1);
                    made
                }
                None => {
                    if self.observer.stops() {
                        break;
                    }
                    let made = outcome(&case)?;
                    let stored =
                        Stored { version: self.provenance.version.clone(), case: &case, outcome: &made };
                    write_json(&path, &stored)?;
                    made
                }
            };
            steps.step();
            count(1, 1);
            all.push((case, made));
        }
        Ok(all)
    }

    /// The stored outcome of a case, if it is that of the same case by the same version.
    fn stored<C: DeserializeOwned + PartialEq, O: DeserializeOwned>(
        &self,
        path: &Path,
        case: &C,
    ) -> Option<O> {
        let stored: Stored<C, O> = serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()?;
        (stored.version == self.provenance.version && stored.case == *case).then_some(stored.outcome)
    }

    /// Writes the findings: for each experiment a folder with its tables (CSV, LaTeX) and figures (SVG, PDF); `NAME.json` with the
    /// findings and their provenance, and the page `index.html`. Returns the page's path.
    ///
    /// # Errors
    /// If a file cannot be written or a figure cannot be drawn.
    pub fn write(&self, name: &str, title: &str, findings: &[Findings]) -> Result<PathBuf> {
        for f in findings {
            let folder = self.folder(&f.name)?;
            for t in &f.tables {
                write_text(&folder.join(format!("{}.csv", t.name)), &t.csv())?;
                write_text(&folder.join(format!("{}.tex", t.name)), &t.latex())?;
            }
            for figure in &f.figures {
                let path = folder.join(format!("{}.svg", figure.name));
                write_text(&path, &figure.svg().map_err(|e| Error::new(&path, e))?)?;
                let path = folder.join(format!("{}.pdf", figure.name));
                let pdf = figure.pdf().map_err(|e| Error::new(&path, e))?;
                write_atomically(&path, |partial| std::fs::write(partial, &pdf))?;
            }
        }
        let results = Results { provenance: &self.provenance, findings };
        write_json(&self.folder.join(format!("{name}.json")), &results)?;
        let page = self.folder.join("index.html");
        write_text(&page, &self.page(title, findings)?.into_string())?;
        Ok(page)
    }

    fn page(&self, title: &str, findings: &[Findings]) -> Result<Markup> {
        let p = &self.provenance;
        let sections = findings.iter().map(|f| self.section(f, title)).collect::<Result<Vec<_>>>()?;
        let body = html! {
            @if findings.len() > 1 {
                nav { ul { @for f in findings { li { a href=(format!("#{}", f.name)) { (f.title) } } } } }
            }
            @for section in sections { (section) }
        };
        let about = format!("blindaug {} · seed {} · {}", p.version, p.seed, p.machine);
        Ok(page_with(title, &about, &body, &format!("Made by: {}", p.command)))
    }

    fn section(&self, f: &Findings, title: &str) -> Result<Markup> {
        let folder = self.folder.join(&f.name);
        let file = |name: &Path, what: &str| {
            html! { a href=(format!("{}/{}", f.name, name.display())) { (what) } }
        };
        let mut figures = vec![];
        for figure in &f.figures {
            let svg = figure.svg().map_err(|e| Error::new(&folder, e))?;
            figures.push(html! { figure {
                (in_page(&svg, figure.size(), &figure.caption))
                figcaption { (figure.caption) " "
                    @for ending in ["svg", "pdf"] { (file(Path::new(&format!("{}.{ending}", figure.name)), &ending.to_uppercase())) " " } }
            } });
        }
        let mut pictures = vec![];
        for row in &f.pictures {
            let mut shown = vec![];
            for (caption, name) in &row.files {
                let path = folder.join(name);
                let frame = blindaug_io::read_frame(&path)?;
                let picture = blindaug_report::shown(&frame, MOST_PIXELS)
                    .ok_or_else(|| Error::new(&path, "the picture cannot be shown"))?;
                shown.push(html! { figure {
                    img.fill src=(picture.uri) width=(picture.width) height=(picture.height) alt=(caption);
                    figcaption { (caption) }
                } });
            }
            pictures.push(html! { h3 { (row.title) } div.row.small { @for p in shown { (p) } } });
        }
        Ok(html! { section id=(f.name) {
            @if f.title != title { h2 { (f.title) } }
            @for text in &f.text { p { (text) } }
            @for table in &f.tables {
                (table.html())
                p.soft { @for ending in ["csv", "tex"] { (file(Path::new(&format!("{}.{ending}", table.name)), &format!("{}.{ending}", table.name))) " " } }
            }
            @if !figures.is_empty() { div.row.plots { @for figure in figures { (figure) } } }
            @for row in pictures { (row) }
            @if !f.files.is_empty() { p { "Files: " @for (what, name) in &f.files { (file(name, what)) " " } } }
        } })
    }
}

/// The most pixels of a picture on the page.
const MOST_PIXELS: usize = 512 * 384;

#[derive(Serialize)]
struct Results<'a> {
    provenance: &'a Provenance,
    findings: &'a [Findings],
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |partial| std::fs::write(partial, text))
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_text(path, &serde_json::to_string_pretty(value).expect("results are plain data"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug_pipeline::Silent;

    fn provenance(version: &str) -> Provenance {
        Provenance { command: "test".into(), version: version.into(), seed: 1, machine: "none".into() }
    }

    /// The outcomes of three cases, whose squares they are, and the number of those that were made.
    fn squares(folder: &Path, version: &str, overwrite: bool, observer: &dyn Observer) -> (Vec<u32>, usize) {
        let run = Run::new(folder, provenance(version), overwrite, observer).unwrap();
        let made = Cell::new(0);
        let cases = (1..=3).map(|i| (format!("case{i}"), i)).collect();
        let outcomes = run.cases("squares", cases, |&i: &u32| {
            made.set(made.get() + 1);
            Ok(i * i)
        });
        (outcomes.unwrap().into_iter().map(|o| o.1).collect(), made.get())
    }

    #[test]
    fn a_run_goes_on_where_it_stopped() {
        /// Stops after the first case.
        struct Once(Cell<usize>);
        impl Observer for Once {
            fn step(&self) {
                self.0.set(self.0.get() + 1);
            }
            fn stops(&self) -> bool {
                self.0.get() > 0
            }
        }
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(squares(dir.path(), "1", false, &Once(Cell::new(0))), (vec![1], 1));
        // A file that was damaged is made anew.
        std::fs::write(dir.path().join("squares/cases/case1.json"), "{").unwrap();
        assert_eq!(squares(dir.path(), "1", false, &Silent), (vec![1, 4, 9], 3));
        assert_eq!(squares(dir.path(), "1", false, &Silent), (vec![1, 4, 9], 0));
        // Another version may give other numbers.
        assert_eq!(squares(dir.path(), "2", false, &Silent).1, 3);
        assert_eq!(squares(dir.path(), "2", true, &Silent).1, 3);
    }

    #[test]
    fn stored_numbers_come_back_to_the_last_digit() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(dir.path(), provenance("1"), false, &Silent).unwrap();
        let numbers = || {
            let all: Vec<f64> = (1..2000).map(|i| f64::from(i).sqrt().exp() / 7.0).collect();
            let cases = vec![("numbers".to_owned(), 0)];
            run.cases("numbers", cases, |_: &u32| Ok(all.clone())).unwrap().remove(0).1
        };
        assert_eq!(numbers(), numbers());
        assert_eq!(run.counts(), [1, 2, 2]);
    }

    #[test]
    fn findings_are_written_in_every_format() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(dir.path(), provenance("1"), false, &Silent).unwrap();
        let table = Table {
            name: "numbers".into(),
            caption: "Some.".into(),
            head: vec!["name".into()],
            rows: vec![vec![crate::table::Cell::text("a <b>")]],
        };
        let figure = Figure {
            name: "plot".into(),
            caption: "A plot.".into(),
            x: Default::default(),
            y: Default::default(),
            series: vec![],
        };
        let findings = Findings {
            name: "first".into(),
            title: "First".into(),
            tables: vec![table],
            figures: vec![figure],
            ..Findings::default()
        };
        let page = run.write("all", "A run", &[findings]).unwrap();
        let html = std::fs::read_to_string(page).unwrap();
        assert!(html.contains("a &lt;b&gt;") && html.contains("<svg") && html.contains("first/numbers.csv"));
        for name in ["all.json", "first/numbers.csv", "first/numbers.tex", "first/plot.svg", "first/plot.pdf"]
        {
            assert!(dir.path().join(name).metadata().unwrap().len() > 0, "{name}");
        }
    }
}
