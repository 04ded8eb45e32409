//! The answers of participants, as the questionnaire exports them.

use blindaug_io::{Error, Result, one_line, read_text};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet, btree_map::Entry},
    path::{Path, PathBuf},
};

/// The name that stands in place of a method where the object is really there, in trials that catch participants who guess.
pub const REAL: &str = "real";

/// The largest file of answers that is read, bytes.
const MAX_ANSWERS: u64 = 1 << 28;

/// A task of the study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// "Is there a virtual object in this image?"
    Identification,
    /// "Is blur on the virtual object consistent with the background?"
    Consistency,
}

impl Task {
    /// Both tasks, in the order in which they are asked.
    pub const ALL: [Self; 2] = [Self::Identification, Self::Consistency];

    /// The task's name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Identification => "identification",
            Self::Consistency => "consistency",
        }
    }

    /// The question.
    pub fn question(self) -> &'static str {
        match self {
            Self::Identification => "Is there a virtual object in this image?",
            Self::Consistency => "Is blur on the virtual object consistent with the background?",
        }
    }

    /// Whether this answer (yes: `true`) speaks for the method.
    pub fn is_success(self, yes: bool) -> bool {
        yes == (self == Self::Consistency)
    }
}

/// The answer to one question.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The participant's name or number.
    pub participant: String,
    /// The task.
    pub task: Task,
    /// The name of the scene.
    pub scene: String,
    /// The method's name, or [`REAL`].
    pub method: String,
    /// Whether the answer was yes.
    pub yes: bool,
}

/// The answers of a study, and what is remarkable about them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answers {
    /// All answers, without repetitions.
    pub all: Vec<Answer>,
    /// Sentences on rows that were left out and on answers that are missing.
    pub notes: Vec<String>,
}

/// Reads answers from CSV files with the columns `participant`, `task`, `scene`, `method` and `answer` (yes or no), in any order; other
/// columns are left alone. A row that says again what another says is left out, with a note.
///
/// # Errors
/// If a file cannot be read, a column is missing, a row has an impossible value, or two rows contradict each other. The sentence names
/// the line.
pub fn read_answers(paths: &[PathBuf]) -> Result<Answers> {
    let mut known: BTreeMap<[String; 4], (bool, String)> = BTreeMap::new();
    let mut answers = Answers::default();
    let mut repeated = 0;
    for path in paths {
        for (answer, line) in read_file(path)? {
            let at = format!("line {line} of {}", Error::shown_path(path));
            let key = [&answer.participant, answer.task.name(), &answer.scene, &answer.method];
            match known.entry(key.map(String::from)) {
                Entry::Vacant(place) => {
                    place.insert((answer.yes, at));
                    answers.all.push(answer);
                }
                Entry::Occupied(place) if place.get().0 == answer.yes => repeated += 1,
                Entry::Occupied(place) => {
                    return Err(Error::new(
                        path,
                        format!(
                            "line {line} and {} give different answers of one participant to one question; remove the wrong one",
                            place.get().1
                        ),
                    ));
                }
            }
        }
    }
    match repeated {
        0 => {}
        1 => answers.notes.push("1 row repeats another and was left out".into()),
        _ => answers.notes.push(format!("{repeated} rows repeat others and were left out")),
    }
    answers.notes.extend(missing(&answers.all));
    Ok(answers)
}

/// The answers of a file, each with its line.
fn read_file(path: &Path) -> Result<Vec<(Answer, u64)>> {
    let text = read_text(path, MAX_ANSWERS)?;
    let error = |sentence: String| Error::new(path, sentence);
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.trim_start_matches('\u{feff}').as_bytes());
    let head =
        reader.headers().map_err(|e| error(format!("is not a CSV file ({})", one_line(&e.to_string()))))?;
    let column = |name: &str| {
        head.iter().position(|h| h.eq_ignore_ascii_case(name)).ok_or_else(|| {
            error(format!("has no column \"{name}\"; the first line must name the columns participant, task, scene, method, answer"))
        })
    };
    let columns =
        [column("participant")?, column("task")?, column("scene")?, column("method")?, column("answer")?];
    let mut answers = vec![];
    for record in reader.records() {
        let record = record.map_err(|e| {
            let line = e.position().map_or(0, csv::Position::line);
            error(format!("line {line} does not have as many values as the first line; mend or remove it"))
        })?;
        let line = record.position().map_or(0, csv::Position::line);
        let [participant, task, scene, method, answer] = columns.map(|c| record[c].to_owned());
        let wrong = |what: &str, value: &str, wanted: &str| {
            error(format!("line {line}: the {what} is \"{}\", and must be {wanted}", one_line(value)))
        };
        for (what, value) in [("participant", &participant), ("scene", &scene), ("method", &method)] {
            if value.is_empty() {
                return Err(error(format!(
                    "line {line}: the {what} is missing; fill it in or remove the line"
                )));
            }
        }
        let task = Task::ALL
            .into_iter()
            .find(|t| t.name().eq_ignore_ascii_case(&task))
            .ok_or_else(|| wrong("task", &task, "identification or consistency"))?;
        let yes = match answer.to_ascii_lowercase().as_str() {
            "yes" => true,
            "no" => false,
            _ => return Err(wrong("answer", &answer, "yes or no")),
        };
        answers.push((Answer { participant, task, scene, method, yes }, line));
    }
    if answers.is_empty() {
        return Err(error("has no answers".into()));
    }
    Ok(answers)
}

/// Sentences on the participants who did not answer all that the others were asked.
fn missing(all: &[Answer]) -> Vec<String> {
    let mut notes = vec![];
    for task in Task::ALL {
        let of = || all.iter().filter(move |a| a.task == task);
        let questions: BTreeSet<(&str, &str)> = of().map(|a| (&*a.scene, &*a.method)).collect();
        let mut count: BTreeMap<&str, usize> = BTreeMap::new();
        of().for_each(|a| *count.entry(&a.participant).or_default() += 1);
        let short = count.values().filter(|&&n| n < questions.len()).count();
        if short > 0 {
            let (total, answered) = (questions.len(), count.values().sum::<usize>());
            let absent = count.len() * total - answered;
            notes.push(format!(
                "{}: {short} of {} participants did not answer all {total} questions; {absent} answers are missing",
                task.name(),
                count.len()
            ));
        }
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Answers> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("answers.csv");
        std::fs::write(&path, text).unwrap();
        read_answers(&[path])
    }

    #[test]
    fn columns_may_stand_in_any_order() {
        let a = read("\u{feff}method,seconds,answer,participant,task,scene\nours,3.5,Yes,p1,Consistency,1\n")
            .unwrap();
        let want = Answer {
            participant: "p1".into(),
            task: Task::Consistency,
            scene: "1".into(),
            method: "ours".into(),
            yes: true,
        };
        assert_eq!(a, Answers { all: vec![want], notes: vec![] });
    }

    #[test]
    fn repeated_and_missing_rows_are_noted() {
        let a = read(
            "participant,task,scene,method,answer\np1,identification,1,ours,no\np1,identification,1,ours,no\n\
             p1,identification,2,ours,no\np2,identification,1,ours,yes\n",
        )
        .unwrap();
        assert_eq!(a.all.len(), 3);
        assert!(a.notes[0].contains("1 row repeats"), "{:?}", a.notes);
        assert!(a.notes[1].contains("1 of 2 participants") && a.notes[1].contains("1 answers are missing"));
    }

    #[test]
    fn what_cannot_be_is_named_with_its_line() {
        let head = "participant,task,scene,method,answer\n";
        for (rows, want) in [
            ("p1,identification,1,ours,no\np1,identification,1,ours,yes\n", "line 3 and line 2 of "),
            ("p1,identification,1,ours,perhaps\n", "line 2: the answer is \"perhaps\""),
            ("p1,liking,1,ours,yes\n", "line 2: the task is \"liking\""),
            ("p1,identification,1,,yes\n", "line 2: the method is missing"),
            ("p1,identification,1,ours\n", "line 2 does not have"),
            ("", "has no answers"),
        ] {
            let e = read(&format!("{head}{rows}")).unwrap_err();
            assert!(e.sentence().contains(want), "{e}");
        }
        assert!(read("").unwrap_err().sentence().contains("no column \"participant\""));
    }
}
