//! The questionnaire that a participant answers: one HTML file, which needs no network.

use super::answers::Task;
use base64::{Engine, engine::general_purpose::STANDARD};
use maud::{DOCTYPE, PreEscaped, html};
use serde_json::json;
use std::collections::BTreeMap;

/// The seconds that a participant needs for a still and for a clip, for the announcement on the first page.
const SECONDS: [usize; 2] = [6, 14];

/// What a participant is shown and asked about. A task, a scene and a method together stand for one stimulus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stimulus {
    /// The task whose question is asked.
    pub task: Task,
    /// The name of the scene.
    pub scene: String,
    /// The method's name, or [`REAL`](super::REAL). Participants do not see it.
    pub method: String,
    /// The still or the clip.
    pub media: Media,
}

/// A still or a clip, as a file has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Media {
    /// The format of the bytes.
    pub format: MediaFormat,
    /// The content of the file.
    pub bytes: Vec<u8>,
}

/// The formats of stimuli.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MediaFormat {
    /// A PNG picture.
    Png,
    /// A JPEG picture.
    Jpeg,
    /// An MP4 video.
    Mp4,
    /// A WebM video.
    Webm,
}

impl MediaFormat {
    /// The MIME type.
    pub fn mime(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::Mp4 => "video/mp4",
            Self::Webm => "video/webm",
        }
    }

    /// Whether it is a video.
    pub fn is_video(self) -> bool {
        matches!(self, Self::Mp4 | Self::Webm)
    }
}

/// The order in which a participant sees the stimuli, as indices: first Identification, then Consistency, each shuffled by the seed and
/// the participant's id, as it stands in the exported answers. Two stimuli of one scene follow each other only where that cannot be
/// avoided. `questionnaire.js` computes the same.
pub fn order(stimuli: &[Stimulus], seed: u64, participant: &str) -> Vec<usize> {
    let of_task = |task: Task| {
        let mut all: Vec<usize> = (0..stimuli.len()).filter(|&i| stimuli[i].task == task).collect();
        let mut draws = Draws(hash32(format!("{seed} {} {participant}", task.name()).as_bytes()));
        // The shuffle of Fisher and Yates.
        for last in (1..all.len()).rev() {
            all.swap(last, draws.below(last + 1));
        }
        spread(all, |i| &*stimuli[i].scene)
    };
    Task::ALL.into_iter().flat_map(of_task).collect()
}

/// Takes again and again the first one of another scene than the last; as soon as a scene makes up more than half of what is left, the
/// next one must be of that scene, or two of it would meet at the end.
fn spread<'a>(mut left: Vec<usize>, scene: impl Fn(usize) -> &'a str) -> Vec<usize> {
    let mut count: BTreeMap<&str, usize> = BTreeMap::new();
    left.iter().for_each(|&i| *count.entry(scene(i)).or_default() += 1);
    let mut taken: Vec<usize> = vec![];
    while !left.is_empty() {
        let last = taken.last().map(|&i| scene(i));
        let urgent = |i: usize| 2 * count[scene(i)] > left.len();
        let other = |i: usize| Some(scene(i)) != last;
        let next = (left.iter().position(|&i| other(i) && urgent(i)))
            .or_else(|| left.iter().position(|&i| other(i)))
            .unwrap_or(0);
        let i = left.remove(next);
        *count.entry(scene(i)).or_default() -= 1;
        taken.push(i);
    }
    taken
}

/// The hash of bytes in 32 bits (FNV-1a), which browsers compute without large integers.
fn hash32(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |h, &b| (h ^ u32::from(b)).wrapping_mul(0x0100_0193))
}

/// Random numbers in 32 bits: a Weyl sequence, mixed by the last step of MurmurHash3.
struct Draws(u32);

impl Draws {
    /// A number in 0..n.
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9);
        let x = (self.0 ^ (self.0 >> 16)).wrapping_mul(0x85eb_ca6b);
        let x = (x ^ (x >> 13)).wrapping_mul(0xc2b2_ae35);
        ((u64::from(x ^ (x >> 16)) * n as u64) >> 32) as usize
    }
}

/// The hash of a kit (FNV-1a, 64 bits): answers to one kit are not taken for answers to another.
fn hash_of_kit(title: &str, stimuli: &[Stimulus], seed: u64) -> String {
    let names = stimuli.iter().flat_map(|s| [s.task.name(), &s.scene, &s.method].map(str::as_bytes));
    let media = stimuli.iter().map(|s| &*s.media.bytes);
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    for part in [title.as_bytes(), &seed.to_le_bytes()].into_iter().chain(names).chain(media) {
        // The length keeps apart what is only divided otherwise.
        for &b in (part.len() as u64).to_le_bytes().iter().chain(part) {
            hash = (hash ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    format!("{hash:016x}")
}

/// The questionnaire as an HTML page that holds all stimuli. Participants see them in the [`order`] of the seed, and export their answers
/// for [`read_answers`](super::read_answers).
// This function is long, since it is one page.
pub fn questionnaire(title: &str, stimuli: &[Stimulus], seed: u64) -> String {
    let kit = json!({
        "hash": hash_of_kit(title, stimuli, seed),
        // As text: browsers round large numbers.
        "seed": seed.to_string(),
        "tasks": Task::ALL.map(|t| json!({ "name": t.name(), "question": t.question() })),
        "stimuli": stimuli.iter().map(|s| json!({
            "task": s.task.name(), "scene": s.scene, "method": s.method, "mime": s.media.format.mime(),
        })).collect::<Vec<_>>(),
    });
    // Within a script, "<" might end it.
    let kit = kit.to_string().replace('<', "\\u003c");
    let of = |task: Task| stimuli.iter().filter(|s| s.task == task).count();
    let seconds: usize = stimuli.iter().map(|s| SECONDS[usize::from(s.media.format.is_video())]).sum();
    let [pictures, clips] = Task::ALL.map(of);
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                // The browser, too, is told to load nothing from outside.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src blob:; media-src blob:; script-src 'unsafe-inline'; style-src 'unsafe-inline'";
                title { (title) }
                style { (PreEscaped(include_str!("questionnaire.css"))) }
            }
            body {
                noscript { p.note { "This page needs JavaScript; please allow it, or open the page in another browser." } }
                p #unsaved.note role="alert" hidden {
                    "This browser does not keep your answers: export them before you close or reload this page."
                }
                main #start hidden {
                    h1 tabindex="-1" { (title) }
                    p {
                        "You will see pictures and short clips of small objects. In some of them an object is virtual: it was added by a \
                         computer. You are asked, with Yes or No:"
                    }
                    ol {
                        @if pictures > 0 { li { strong { (Task::Identification.question()) } " (" (pictures) " questions)" } }
                        @if clips > 0 { li { strong { (Task::Consistency.question()) } " (" (clips) " questions)" } }
                    }
                    p {
                        "There are " (stimuli.len()) " questions in all, which take about " (seconds.div_ceil(60)) " minutes. "
                        "Look as long as you like, then answer what you think first. You can stop and go on later on the same device."
                    }
                    form #begin {
                        label for="participant" { "Your participant id" }
                        input #participant type="text" required autocomplete="off" autocapitalize="none" spellcheck="false" aria-describedby="about-id";
                        p #about-id.soft { "Leave it as it is, unless you were given one. Please do not use your name." }
                        p {
                            "By starting I agree that my answers, and the seconds that each took, are used for research under this id. \
                             Taking part is voluntary, and I may stop at any time. The page sends nothing: answers stay on this device until I export them."
                        }
                        button.main type="submit" { "I agree, start" }
                    }
                }
                main #trial hidden {
                    header {
                        p #progress aria-live="polite" {}
                        progress #bar aria-label="Questions answered" {}
                        details #menu {
                            summary { "Menu" }
                            div {
                                button type="button" data-do="export" { "Export answers" }
                                button type="button" data-do="anew" { "Start anew" }
                            }
                        }
                    }
                    div #stage {}
                    div #asked {
                        h1 #question tabindex="-1" {}
                        div #broken.note role="alert" hidden {
                            p { "This cannot be shown in this browser. Please try another browser, or leave the question out." }
                            button type="button" #skip { "Leave out" }
                        }
                        div.answers {
                            button.main type="button" #yes aria-keyshortcuts="y" { "Yes" kbd { "Y" } }
                            button.main type="button" #no aria-keyshortcuts="n" { "No" kbd { "N" } }
                        }
                    }
                }
                main #break hidden {
                    h1 tabindex="-1" { "Time for a break" }
                    p { "The first part is done. Rest your eyes for a minute." }
                    p { "From now on you see clips, which repeat until you answer. The question is:" }
                    p { strong { (Task::Consistency.question()) } }
                    button.main type="button" #go-on { "Go on" }
                }
                main #export hidden {
                    h1 #export-title tabindex="-1" {}
                    p { "Save the file with your answers, or copy them as text, and send them to whoever asked you to take part." }
                    p #count.soft {}
                    p { a #save.main { "Save the answers" } }
                    // Folded, since it names the methods, and questions may still follow.
                    details #as-text {
                        summary { "Show the answers as text" }
                        label for="csv" { "Your answers" }
                        textarea #csv readonly rows="8" spellcheck="false" {}
                    }
                    p.row {
                        button type="button" #copy { "Copy as text" }
                        button type="button" #back { "Back to the questions" }
                        button type="button" data-do="anew" { "Start anew" }
                    }
                    p #copied.soft role="status" {}
                }
                script #kit type="application/json" { (PreEscaped(&kit)) }
                // Each apart, so that the browser decodes only what it shows.
                @for (i, s) in stimuli.iter().enumerate() {
                    script id=(format!("media{i}")) type="text/plain" { (PreEscaped(STANDARD.encode(&s.media.bytes))) }
                }
                script { (PreEscaped(include_str!("questionnaire.js"))) }
            }
        }
    }
    .into_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn stimuli(scenes: usize, methods: usize) -> Vec<Stimulus> {
        let mut all = vec![];
        for task in Task::ALL {
            for i in 0..scenes * methods {
                let bytes = format!("{} {i} of many", task.name()).into_bytes();
                all.push(Stimulus {
                    task,
                    scene: format!("scene {}", i / methods),
                    method: format!("m<{}>", i % methods),
                    media: Media { format: MediaFormat::Png, bytes },
                });
            }
        }
        all
    }

    #[test]
    fn the_page_holds_each_stimulus_once_and_nothing_from_outside() {
        let all = stimuli(3, 2);
        let page = questionnaire("A & B </title><script>alert(1)</script>", &all, 5);
        for s in &all {
            assert_eq!(page.matches(&STANDARD.encode(&s.media.bytes)).count(), 1);
        }
        assert!(page.contains("<title>A &amp; B &lt;/title&gt;"));
        assert!(!page.contains("<script>alert") && !page.contains("m<0>") && page.contains("m\\u003c0>"));
        for outside in ["http:", "https:", "url(", "@import", "innerHTML", "src=\"", "href=\""] {
            assert!(!page.contains(outside), "{outside}");
        }
        // A script of the page must not end itself.
        assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
        assert!(page.contains("There are 12 questions") && page.contains("about 2 minutes"));
    }

    #[test]
    fn the_order_is_a_permutation_that_seed_and_participant_fix() {
        let all = stimuli(7, 5);
        let one = order(&all, 1, "p1");
        assert_eq!(one.iter().copied().collect::<BTreeSet<_>>(), (0..70).collect());
        assert!(one[..35].iter().all(|&i| all[i].task == Task::Identification));
        assert_eq!(one, order(&all, 1, "p1"));
        assert!(one != order(&all, 1, "p2") && one != order(&all, 2, "p1"));
        // Nor do both tasks have the same order.
        assert!((0..35).any(|i| one[i] + 35 != one[35 + i]));
    }

    #[test]
    fn every_stimulus_comes_at_every_place_about_as_often() {
        let all = stimuli(4, 3);
        let mut count = [[0; 12]; 12];
        for participant in 0..2400 {
            let order = order(&all, 9, &participant.to_string());
            (0..12).for_each(|place| count[place][order[place]] += 1);
        }
        // 200 are expected, with a std of 13.5.
        let [least, most] = [count.iter().flatten().min(), count.iter().flatten().max()].map(Option::unwrap);
        assert!(*least > 130 && *most < 270, "{least} to {most}");
    }

    fn repetitions(all: &[Stimulus], order: &[usize]) -> usize {
        order
            .windows(2)
            .filter(|w| all[w[0]].task == all[w[1]].task && all[w[0]].scene == all[w[1]].scene)
            .count()
    }

    #[test]
    fn no_scene_follows_itself_where_that_can_be_avoided() {
        let all = stimuli(3, 4);
        assert!(repetitions(&all, &(0..24).collect::<Vec<_>>()) > 0);
        for p in 0..200 {
            assert_eq!(repetitions(&all, &order(&all, 1, &p.to_string())), 0);
        }
        // Three of one scene and two others, which leaves one way; and four of it, which leaves none.
        for (mine, others, unavoidable) in [(3, 2, 0), (4, 2, 1), (3, 0, 2)] {
            let mut all = stimuli(1, mine);
            all.truncate(mine);
            all.extend(stimuli(others + 1, 1).into_iter().skip(1).take(others));
            for p in 0..50 {
                assert_eq!(repetitions(&all, &order(&all, 1, &p.to_string())), unavoidable);
            }
        }
    }

    #[test]
    fn kits_have_hashes_of_their_own() {
        let all = stimuli(2, 2);
        let mut other = all.clone();
        other[3].media.bytes[0] ^= 1;
        let hash = hash_of_kit("t", &all, 1);
        assert_eq!(hash, hash_of_kit("t", &all, 1));
        for changed in [hash_of_kit("t", &other, 1), hash_of_kit("t", &all, 2), hash_of_kit("u", &all, 1)] {
            assert_ne!(hash, changed);
        }
    }
}
