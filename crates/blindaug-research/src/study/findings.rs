//! The analysis of a study as tables and figures.

use super::analysis::{Analysis, LEVEL, MethodResult, POWER, TaskResult};
use super::answers::{Answers, REAL, Task};
use crate::figure::{Axis, Figure, Mark, Series, Style};
use crate::run::Findings;
use crate::table::{Cell, Table};
use std::collections::BTreeSet;

/// The findings of a study, in the folder `study`.
pub fn findings(analysis: &Analysis, answers: &Answers) -> Findings {
    let participants: BTreeSet<&str> = answers.all.iter().map(|a| &*a.participant).collect();
    let mut text = vec![format!(
        "{} answers of {} participants. Identification: the share of the images in which no virtual object was seen. Consistency: the \
         share of the clips in which the blur of the virtual object was called consistent with the background.",
        answers.all.len(),
        participants.len()
    )];
    text.push(format!(
        "p is that of the two-proportion z-test against {} (pooled variance, two-sided), which takes all answers for independent. One \
         person's answers are not: the standard deviations and the intervals come from a bootstrap over participants.",
        analysis.reference
    ));
    for t in &analysis.tasks {
        if let Some(real) = t.real {
            text.push(format!(
                "{}: of {} trials in which the object was really there, or none was, {:.1} % were {}.",
                title(t.task),
                real.trials,
                100.0 * real.share(),
                if t.task == Task::Identification { "taken for real" } else { "called consistent" }
            ));
        }
    }
    text.extend(answers.notes.iter().map(|n| format!("Note: {n}.")));
    Findings {
        name: "study".into(),
        title: "User study".into(),
        text,
        tables: vec![shares(analysis), tests(analysis)],
        figures: vec![figure(analysis)],
        ..Findings::default()
    }
}

fn title(task: Task) -> &'static str {
    match task {
        Task::Identification => "Identification",
        Task::Consistency => "Consistency",
    }
}

/// The methods of all tasks in the order of the first task, in which the best comes first.
fn methods(analysis: &Analysis) -> Vec<&str> {
    let mut names: Vec<&str> = vec![];
    for m in analysis.tasks.iter().flat_map(|t| &t.methods) {
        if !names.contains(&&*m.method) {
            names.push(&m.method);
        }
    }
    names
}

fn result<'a>(task: &'a TaskResult, method: &str) -> Option<&'a MethodResult> {
    task.methods.iter().find(|m| m.method == method)
}

/// The paper's table: a row for each method, the share and the p-value of each task.
fn shares(analysis: &Analysis) -> Table {
    let head = analysis.tasks.iter().flat_map(|t| [format!("{}, %", title(t.task)), "p".into()]);
    let rows = methods(analysis).into_iter().map(|method| {
        let cells = analysis.tasks.iter().flat_map(|t| match result(t, method) {
            None => [Cell::Empty, Cell::Empty],
            Some(m) => [
                Cell::Number(100.0 * m.count.share(), 1),
                m.against.map_or(Cell::Empty, |a| Cell::Probability(a.p)),
            ],
        });
        [Cell::text(method)].into_iter().chain(cells).collect()
    });
    Table {
        name: "shares".into(),
        caption: format!("Share of successes, and p against {}.", analysis.reference),
        head: ["method".to_owned()].into_iter().chain(head).collect(),
        rows: rows.collect(),
    }
}

/// The counts, the tests and what the next study needs.
fn tests(analysis: &Analysis) -> Table {
    let row = |t: &TaskResult, m: &MethodResult| {
        let percent = |v: f64| 100.0 * v;
        let share = m.share.map_or(Cell::Number(percent(m.count.share()), 1), |s| {
            Cell::Interval(percent(m.count.share()), s.interval.map(percent), 1)
        });
        let difference = m.against.and_then(|a| a.difference).map_or(Cell::Empty, |d| {
            let reference = result(t, &analysis.reference).map_or(0.0, |r| r.count.share());
            Cell::Interval(percent(reference - m.count.share()), d.interval.map(percent), 1)
        });
        let needed = m.against.and_then(|a| a.participants_needed);
        vec![
            Cell::text(title(t.task)),
            Cell::text(&m.method),
            Cell::Number(m.count.successes as f64, 0),
            Cell::Number(m.count.trials as f64, 0),
            share,
            m.against.map_or(Cell::Empty, |a| Cell::Probability(a.p)),
            difference,
            Cell::number(needed.map(|n| n as f64), 0),
        ]
    };
    let real = |t: &TaskResult| {
        t.real.map(|r| {
            let counts = [r.successes, r.trials].map(|n| Cell::Number(n as f64, 0));
            let mut cells = vec![Cell::text(title(t.task)), Cell::text(REAL)];
            cells.extend(counts);
            cells.push(Cell::Number(100.0 * r.share(), 1));
            cells.extend([Cell::Empty, Cell::Empty, Cell::Empty]);
            cells
        })
    };
    let head = [
        "task",
        "method",
        "successes",
        "trials",
        "share, %",
        "p",
        "difference to the reference, percentage points",
        "participants needed",
    ];
    Table {
        name: "tests".into(),
        caption: format!(
            "Counts, shares and differences to {}, with 95 % intervals of a bootstrap over participants; and the participants that the \
             next study needs to find such a difference at the level {LEVEL} with a power of {POWER}, if each answers as many \
             questions as here.",
            analysis.reference
        ),
        head: head.map(String::from).into(),
        rows: analysis
            .tasks
            .iter()
            .flat_map(|t| t.methods.iter().map(|m| row(t, m)).chain(real(t)))
            .collect(),
    }
}

fn figure(analysis: &Analysis) -> Figure {
    let names = methods(analysis);
    let tasks = analysis.tasks.len().max(1) as f64;
    let series = analysis.tasks.iter().enumerate().map(|(i, t)| {
        // The tasks' marks lie beside each other in the row.
        let offset = 0.3 * (i as f64 - 0.5 * (tasks - 1.0));
        let marks = names.iter().enumerate().filter_map(|(row, name)| {
            let m = result(t, name)?;
            Some(Mark {
                x: 100.0 * m.count.share(),
                y: row as f64 + offset,
                interval: m.share.map(|s| s.interval.map(|v| 100.0 * v)),
            })
        });
        Series { name: title(t.task).into(), style: Style::Points, colour: i, marks: marks.collect() }
    });
    Figure {
        name: "shares".into(),
        caption: "Share of successes of each method, with 95 % intervals of a bootstrap over participants."
            .into(),
        x: Axis::over("share of successes, %", [0.0, 100.0]),
        y: Axis::of_rows(names.iter().map(|n| n.to_string()).collect()),
        series: series.collect(),
    }
}
