//! The questionnaire: one page that holds all stimuli, works without a network, and gives the answers as a CSV file.

use super::answers::Task;
use base64::{Engine, engine::general_purpose::STANDARD};
use maud::{DOCTYPE, PreEscaped, html};
use serde_json::json;

/// A picture or a video.
pub struct Media {
    /// Its type, such as `image/png` or `video/mp4`.
    pub mime: &'static str,
    /// The contents of the file.
    pub bytes: Vec<u8>,
}

/// What a participant judges.
pub struct Stimulus {
    /// The task.
    pub task: Task,
    /// The scene; participants do not see its name.
    pub scene: String,
    /// The method, or [`super::REAL`]; participants do not see it.
    pub method: String,
    /// What is shown.
    pub media: Media,
}

/// The page. Each participant gets an order of their own, which follows from the seed and their name by [`order`].
pub fn questionnaire(title: &str, stimuli: &[Stimulus], seed: u64) -> String {
    let list: Vec<_> = stimuli
        .iter()
        .map(|s| json!({ "task": s.task.name(), "scene": s.scene, "method": s.method, "mime": s.media.mime }))
        .collect();
    let tasks: Vec<Task> =
        Task::ALL.into_iter().filter(|task| stimuli.iter().any(|s| s.task == *task)).collect();
    let questions: serde_json::Map<String, serde_json::Value> =
        tasks.iter().map(|t| (t.name().to_owned(), t.question().into())).collect();
    let hash = stimuli.iter().fold(fnv(seed.to_string().as_bytes()), |h, s| {
        h.rotate_left(5) ^ fnv(s.method.as_bytes()) ^ fnv(&s.media.bytes)
    });
    let kit = json!({
        "seed": seed.to_string(),
        "hash": format!("{hash:08x}"),
        "tasks": tasks.iter().map(|t| t.name()).collect::<Vec<_>>(),
        "questions": questions,
        "stimuli": list,
    });
    // No text of the data may end the element that holds it.
    let kit = kit.to_string().replace('<', "\\u003c");
    let minutes =
        (stimuli.iter().map(|s| if s.task == Task::Identification { 6.0 } else { 11.0 }).sum::<f64>() / 60.0)
            .ceil();
    let policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src blob:; media-src blob:";
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // The browser, too, is told to load nothing from outside.
                meta http-equiv="Content-Security-Policy" content=(policy);
                title { (title) }
                style { (PreEscaped(include_str!("questionnaire.css"))) }
            }
            body {
                header { button.quiet type="button" id="export" hidden { "Export answers" } }
                main {
                    noscript { p.warning { "This page needs JavaScript, which is switched off." } }
                    p.warning id="unsaved" hidden role="status" {
                        "This browser does not save answers: do not close or reload the page before you have exported them."
                    }
                    section id="start" hidden {
                        h1 tabindex="-1" { (title) }
                        p { "You will see " (stimuli.len()) " pictures and clips, one after another, and answer a question on each with yes \
                             or no. There is no right or wrong pace; follow your first impression. It takes about " (minutes) " minutes." }
                        p { "Your answers stay on this device until you hand them over. You may stop at any time, and go on later in the \
                             same browser with the same name." }
                        form id="begin" {
                            label for="participant" { "Your number or a made-up name" }
                            input id="participant" required maxlength="60" autocomplete="off";
                            button { "I take part" }
                        }
                    }
                    section id="part" hidden {
                        h2 tabindex="-1" { "The next part" }
                        p { "The question on each of " span id="part-count" {} " stimuli is:" }
                        p { strong id="part-question" {} }
                        p.soft { "On a keyboard, Y and N answer, too. You may take a break now." }
                        button type="button" id="go" { "Go on" }
                    }
                    section id="trial" hidden {
                        div id="stimulus" {}
                        p.warning id="broken" hidden { "This cannot be shown by your browser: please try another one." }
                        h2 id="question" tabindex="-1" {}
                        div.choice {
                            button type="button" id="yes" { "Yes" }
                            button type="button" id="no" { "No" }
                        }
                        div.progress { span id="progress" role="status" {} progress id="bar" aria-label="answered" {} }
                    }
                    section id="end" hidden {
                        h2 tabindex="-1" { "Your answers" }
                        p { "You have answered " span id="count" {} " questions. Please send this file to whoever asked you." }
                        p { a.button id="download" { "Save the file" } " "
                            button.quiet type="button" id="copy" { "Copy the text" } " "
                            button.quiet type="button" id="back" { "Back to the questions" } }
                        label for="csv" { "Or copy this text:" }
                        textarea id="csv" readonly spellcheck="false" {}
                        button.quiet type="button" id="anew" { "Start anew" }
                    }
                }
                @for (i, s) in stimuli.iter().enumerate() {
                    script type="text/plain" id=(format!("s{i}")) { (PreEscaped(STANDARD.encode(&s.media.bytes))) }
                }
                script type="application/json" id="kit" { (PreEscaped(kit)) }
                script { (PreEscaped(include_str!("questionnaire.js"))) }
            }
        }
    }
    .into_string()
}

/// The order in which a participant sees the stimuli of a task, as the page's script finds it: shuffled (Fisher & Yates), then changed
/// so that no scene comes twice in a row where that can be avoided.
pub fn order(stimuli: &[Stimulus], seed: u64, participant: &str, task: Task) -> Vec<usize> {
    let mut all: Vec<usize> = (0..stimuli.len()).filter(|&i| stimuli[i].task == task).collect();
    let mut state = fnv(format!("{seed}|{participant}|{}", task.name()).as_bytes());
    for i in (1..all.len()).rev() {
        let below = (u64::from(mulberry(&mut state)) * (i as u64 + 1)) >> 32;
        all.swap(i, below as usize);
    }
    for i in 1..all.len() {
        let before = &stimuli[all[i - 1]].scene;
        if stimuli[all[i]].scene == *before
            && let Some(other) = (i + 1..all.len()).find(|&j| stimuli[all[j]].scene != *before)
        {
            all.swap(i, other);
        }
    }
    all
}

/// The hash FNV-1a of 32 bits.
fn fnv(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |h, b| (h ^ u32::from(*b)).wrapping_mul(0x0100_0193))
}

/// The next number of the generator mulberry32.
fn mulberry(state: &mut u32) -> u32 {
    *state = state.wrapping_add(0x6d2b_79f5);
    let a = *state;
    let t = (a ^ (a >> 15)).wrapping_mul(a | 1);
    let t = t.wrapping_add((t ^ (t >> 7)).wrapping_mul(t | 61)) ^ t;
    t ^ (t >> 14)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn stimuli() -> Vec<Stimulus> {
        let of = |task, scene: usize, method: &str| Stimulus {
            task,
            scene: scene.to_string(),
            method: method.into(),
            media: Media { mime: "image/png", bytes: format!("{scene}{method}").into_bytes() },
        };
        let mut all = vec![];
        for task in Task::ALL {
            for scene in 0..6 {
                all.extend(["Naive", "Ours", "real </script>"].map(|m| of(task, scene, m)));
            }
        }
        all
    }

    #[test]
    fn every_stimulus_is_in_the_page_and_nothing_ends_its_data_early() {
        let page = questionnaire("Real & <virtual>?", &stimuli(), 7);
        for (i, s) in stimuli().iter().enumerate() {
            let data = format!(
                "<script type=\"text/plain\" id=\"s{i}\">{}</script>",
                STANDARD.encode(&s.media.bytes)
            );
            assert_eq!(page.matches(&data).count(), 1);
        }
        assert!(page.contains("Real &amp; &lt;virtual&gt;?") && !page.contains("real </script>"));
        assert!(!page.contains("http://") && !page.contains("https://"));
    }

    #[test]
    fn each_participant_has_an_order_of_their_own() {
        let all = stimuli();
        let of = |participant: &str, seed| order(&all, seed, participant, Task::Consistency);
        let first = of("p1", 1);
        assert_eq!(first, of("p1", 1));
        assert!(first != of("p2", 1) && first != of("p1", 2));
        let seen: BTreeSet<usize> = first.iter().copied().collect();
        assert_eq!(seen, (18..36).collect());
        for p in 0..40 {
            let order = of(&format!("p{p}"), 3);
            let repeated = order.windows(2).filter(|w| all[w[0]].scene == all[w[1]].scene).count();
            // Only the last ones may have no other left to change with.
            assert!(repeated <= 2, "{p}: {order:?}");
        }
    }
}
