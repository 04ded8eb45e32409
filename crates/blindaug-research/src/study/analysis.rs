//! What the answers of a study say: the share of successes of each method, and whether methods differ.

use super::answers::{Answer, REAL, Task};
use crate::statistics::{Proportion, Resampled, bootstrap, trials_for_power, two_proportion_test};
use std::collections::{BTreeMap, BTreeSet};

/// The level of the next study's tests.
pub const LEVEL: f64 = 0.05;
/// The power of the next study.
pub const POWER: f64 = 0.8;

/// The results of both tasks.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// The method with which the others are compared.
    pub reference: String,
    /// The results of the tasks that have answers.
    pub tasks: Vec<TaskResult>,
}

/// The results of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskResult {
    /// The task.
    pub task: Task,
    /// The number of participants.
    pub participants: usize,
    /// The methods, the best first.
    pub methods: Vec<MethodResult>,
    /// The trials with a real object: successes are those taken for real, or consistent.
    pub real: Option<Proportion>,
}

/// The result of a method in a task.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodResult {
    /// The method's name.
    pub method: String,
    /// Its successes.
    pub count: Proportion,
    /// The spread of the share of successes over participants; `None` for fewer than two participants.
    pub share: Option<Resampled>,
    /// The comparison with the reference; `None` for the reference itself.
    pub against: Option<Comparison>,
}

/// How a method differs from the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The p-value of the two-proportion z-test (pooled, two-sided), which takes all answers for independent, as the paper does.
    pub p: f64,
    /// The share of the reference minus that of the method, with the spread over participants, whose answers are not independent;
    /// `None` for fewer than two participants.
    pub difference: Option<Resampled>,
    /// The number of participants that the next study needs to find this difference (at [`LEVEL`] with [`POWER`]), if each answers as many
    /// questions as in this one; `None` if there is no difference.
    pub participants_needed: Option<u64>,
}

/// Analyses the answers; every method is compared with `reference`.
pub fn analyse(answers: &[Answer], reference: &str, seed: u64) -> Analysis {
    let tasks =
        Task::ALL.into_iter().filter_map(|task| task_result(answers, task, reference, seed)).collect();
    Analysis { reference: reference.into(), tasks }
}

/// The counts of each method, for each participant.
type Counts<'a> = Vec<BTreeMap<&'a str, Proportion>>;

fn task_result(answers: &[Answer], task: Task, reference: &str, seed: u64) -> Option<TaskResult> {
    let of_task: Vec<&Answer> = answers.iter().filter(|a| a.task == task).collect();
    let names: BTreeSet<&str> = of_task.iter().map(|a| &*a.participant).collect();
    let number: BTreeMap<&str, usize> = names.iter().copied().zip(0..).collect();
    let mut counts: Counts = vec![BTreeMap::new(); names.len()];
    for a in &of_task {
        let count = counts[number[&*a.participant]].entry(&a.method).or_default();
        count.trials += 1;
        count.successes += u64::from(task.is_success(a.yes));
    }
    let everybody: Vec<usize> = (0..counts.len()).collect();
    let of_reference = total(&counts, &everybody, reference);
    let methods: BTreeSet<&str> = of_task.iter().map(|a| &*a.method).filter(|&m| m != REAL).collect();
    let mut methods: Vec<MethodResult> = methods
        .into_iter()
        .map(|method| {
            let count = total(&counts, &everybody, method);
            let share = bootstrap(counts.len(), seed, |drawn| shares(&counts, drawn, method));
            let against = (method != reference && of_reference.trials > 0).then(|| {
                let difference = bootstrap(counts.len(), seed, |drawn| {
                    shares(&counts, drawn, reference) - shares(&counts, drawn, method)
                });
                Comparison {
                    p: two_proportion_test(of_reference, count),
                    difference,
                    participants_needed: needed(of_reference, count, difference, counts.len()),
                }
            });
            MethodResult { method: method.into(), count, share, against }
        })
        .collect();
    methods.sort_by(|a, b| b.count.share().total_cmp(&a.count.share()));
    let real = total(&counts, &everybody, REAL);
    let result =
        TaskResult { task, participants: counts.len(), methods, real: (real.trials > 0).then_some(real) };
    (!of_task.is_empty()).then_some(result)
}

fn total(counts: &Counts, of: &[usize], method: &str) -> Proportion {
    let counts = of.iter().filter_map(|&i| counts[i].get(method));
    counts.fold(Proportion::default(), |sum, c| Proportion {
        successes: sum.successes + c.successes,
        trials: sum.trials + c.trials,
    })
}

fn shares(counts: &Counts, of: &[usize], method: &str) -> f64 {
    let total = total(counts, of, method);
    if total.trials > 0 { total.share() } else { f64::NAN }
}

/// The participants whom the next study needs: the trials of independent answers, times the factor by which the variance over
/// participants exceeds that of independent answers, over the trials of a participant.
fn needed(a: Proportion, b: Proportion, spread: Option<Resampled>, participants: usize) -> Option<u64> {
    let trials = trials_for_power(a.share(), b.share(), LEVEL, POWER)? as f64;
    let independent: f64 =
        [a, b].iter().map(|p| p.share() * (1.0 - p.share()) / p.trials.max(1) as f64).sum();
    let factor = spread.map_or(1.0, |s| s.std * s.std / independent);
    let factor = if factor.is_finite() { factor.max(1.0) } else { 1.0 };
    let each = (a.trials + b.trials) as f64 / (2 * participants.max(1)) as f64;
    Some((trials * factor / each).ceil() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const METHODS: [&str; 5] = ["Ours", "OkumuraEtAl", "OkumuraEtAl++", "MandlEtAl", "Naive"];

    /// As many successes of each method as in the paper's study, dealt out to its 19 participants.
    fn paper() -> Vec<Answer> {
        let mut all = vec![];
        let counts = [
            (Task::Identification, [88, 72, 75, 29, 22], 152),
            (Task::Consistency, [73, 63, 15, 66, 37], 114),
        ];
        for (task, successes, trials) in counts {
            for (method, successes) in METHODS.into_iter().zip(successes) {
                all.extend((0..trials).map(|i| Answer {
                    participant: (i % 19).to_string(),
                    task,
                    scene: (i / 19).to_string(),
                    method: method.into(),
                    yes: task.is_success(true) == (i < successes),
                }));
            }
        }
        all
    }

    #[test]
    fn the_papers_counts_give_the_papers_table() {
        let analysis = analyse(&paper(), "Ours", 1);
        let want = [
            [
                ("OkumuraEtAl", 47.4, "6.6e-2"),
                ("OkumuraEtAl++", 49.3, "1.3e-1"),
                ("MandlEtAl", 19.1, "4e-12"),
                ("Naive", 14.5, "3e-15"),
            ],
            [
                ("OkumuraEtAl", 55.3, "1.77e-1"),
                ("OkumuraEtAl++", 13.2, "3e-15"),
                ("MandlEtAl", 57.9, "3.42e-1"),
                ("Naive", 32.5, "2e-6"),
            ],
        ];
        for ((task, want), ours) in analysis.tasks.iter().zip(want).zip([57.9, 64.0]) {
            assert_eq!(task.participants, 19);
            assert!(task.methods[0].method == "Ours" && task.methods[0].against.is_none());
            assert!((100.0 * task.methods[0].count.share() - ours).abs() < 0.05);
            for (method, share, p) in want {
                let m = task.methods.iter().find(|m| m.method == method).unwrap();
                assert!((100.0 * m.count.share() - share).abs() < 0.05, "{method}");
                // The p-value is the paper's in all figures that the paper prints.
                let (ours, paper): (f64, f64) = (m.against.unwrap().p, p.parse().unwrap());
                let digits = p.split_once('e').unwrap().0.replace('.', "").len();
                let printed: f64 = format!("{ours:.*e}", digits - 1).parse().unwrap();
                assert!((printed / paper - 1.0).abs() < 0.06, "{method}: {ours:e}, in the paper {p}");
            }
        }
    }

    #[test]
    fn answers_of_one_person_count_less_than_those_of_many() {
        // Half of the participants always say no, the others never: as many answers as before, and far fewer opinions.
        let opinionated: Vec<Answer> = (0..200)
            .map(|i| Answer {
                participant: (i % 10).to_string(),
                task: Task::Identification,
                scene: (i / 10).to_string(),
                method: if i / 10 < 10 { "Ours" } else { "Naive" }.into(),
                yes: i % 10 < if i / 10 < 10 { 4 } else { 6 },
            })
            .collect();
        let result = &analyse(&opinionated, "Ours", 1).tasks[0];
        let independent = (0.24f64 / 100.0).sqrt();
        assert!(result.methods[0].share.unwrap().std > 2.5 * independent);
        let naive = result.methods.iter().find(|m| m.method == "Naive").unwrap().against.unwrap();
        // The test of independent answers finds a difference that two changed minds are.
        assert!(naive.p < 0.01 && naive.difference.unwrap().interval[0] <= 0.0, "{naive:?}");
    }

    #[test]
    fn catch_trials_are_no_method() {
        let real = |yes: bool| Answer {
            participant: "1".into(),
            task: Task::Identification,
            scene: yes.to_string(),
            method: REAL.into(),
            yes,
        };
        let result = &analyse(&[real(true), real(false)], "Ours", 1).tasks[0];
        assert_eq!(result.real, Some(Proportion { successes: 1, trials: 2 }));
        assert!(result.methods.is_empty());
    }
}
