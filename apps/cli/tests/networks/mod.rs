//! Tests of networks on the command line, with tiny networks of known results (crates/blindaug-nets/tests/data).

use super::{blindaug, fails, files_in, run, sentence_of, succeeds, text, write_frames};
use std::path::{Path, PathBuf};
use std::process::Output;
use tempfile::TempDir;

fn network(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../crates/blindaug-nets/tests/data").join(file)
}

/// Writes the manifest `NAME.toml` of `NAME.onnx` in the folder.
fn write_manifest(folder: &Path, name: &str, operator: &str, more: &str) {
    let text = format!(
        "name = '{name}'\noperator = '{operator}'\ntitle = 'a test'\nlicence = 'MIT'\nsource = 'here'\nfile = '{name}.onnx'\n{more}"
    );
    std::fs::write(folder.join(format!("{name}.toml")), text).unwrap();
}

/// A clip, and a network that blurs instead of deblurring.
fn clip() -> TempDir {
    let dir = TempDir::new().unwrap();
    write_frames(&dir.path().join("frames"), 1..=4, (160, 120));
    write_manifest(dir.path(), "box", "removeDoF", "[output]\nkind = 'image'");
    std::fs::copy(network("box.onnx"), dir.path().join("box.onnx")).unwrap();
    dir
}

/// `blindaug models ..` with the model folder `models`.
fn models(dir: &Path, arguments: &str) -> Output {
    blindaug()
        .current_dir(dir)
        .env("BLINDAUG_MODELS", dir.join("models"))
        .args(arguments.split(' '))
        .output()
        .unwrap()
}

#[test]
fn evidence_that_was_saved_gives_the_same_estimate_again() {
    let dir = clip();
    // The network for noise blurs, too: what counts is that its frames are written and read again.
    write_manifest(dir.path(), "nan", "removeNoise", "[output]\nkind = 'image'");
    std::fs::copy(network("box.onnx"), dir.path().join("nan.onnx")).unwrap();
    let said = succeeds(
        dir.path(),
        "estimate frames --method removal --network box.toml --network nan.toml --save-evidence evidence -o a.json",
    );
    let kinds = ["de_focus_blurred", "denoised", "flow", "original"];
    for kind in kinds {
        let extension = if kind == "flow" { "flo" } else { "png" };
        let files = files_in(&dir.path().join("evidence").join(kind));
        // The last frame has no next one.
        let last = if kind == "flow" { 3 } else { 4 };
        let wanted: Vec<String> = (1..=last).map(|n| format!("frames/{n:04}.{extension}")).collect();
        assert_eq!(files, wanted, "{kind}: {said}");
    }
    succeeds(dir.path(), "estimate --evidence evidence --scene frames --method removal -o b.json");
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(dir.path().join(name)).unwrap()).unwrap()
    };
    let (a, b) = (read("a.json"), read("b.json"));
    let exposure = |c: &serde_json::Value| c["motion_blur"]["exposure"].as_f64();
    match (exposure(&a), exposure(&b)) {
        (Some(a), Some(b)) => assert!((a - b).abs() < 0.02, "{a} {b}"),
        (a, b) => assert_eq!(a, b),
    }
    assert_eq!(a["noise"]["method"], b["noise"]["method"]);
}

#[test]
fn a_network_that_cannot_be_used_is_named_and_the_classical_method_goes_on() {
    let dir = clip();
    let classical = succeeds(dir.path(), "estimate frames --method removal --network none -o classical.json");
    let whole = std::fs::read(network("box.onnx")).unwrap();
    let cut = whole[..whole.len() / 2].to_vec();
    let read = |file: &str| std::fs::read(network(file)).unwrap();
    for (what, onnx, more) in [
        ("it may be cut short", cut, ""),
        ("gives values that are no numbers", read("nan.onnx"), ""),
        ("takes 2 inputs", read("flow.onnx"), ""),
        ("does not run on [1, 3, 120, 160]", read("depth.onnx"), ""),
        ("MB are free", whole, "[input]\nmemory = 1000000000000\n"),
    ] {
        write_manifest(dir.path(), "bad", "removeDoF", &format!("{more}[output]\nkind = 'image'"));
        std::fs::write(dir.path().join("bad.onnx"), onnx).unwrap();
        let output = run(dir.path(), "estimate frames --method removal --network bad.toml -o c.json");
        let said = text(&output.stderr);
        assert!(output.status.success() && !said.contains("panicked"), "{what}: {said}");
        let warned: Vec<&str> = said.lines().filter(|l| l.contains("bad.onnx")).collect();
        let [warned] = warned[..] else { panic!("{what}: {said}") };
        assert!(
            warned.contains(what) && warned.ends_with("removeDoF is left to the classical method"),
            "{warned}"
        );
        assert_eq!(text(&output.stdout), classical, "{what}");
    }
}

#[test]
fn networks_that_do_not_fit_together_are_refused() {
    let dir = clip();
    for (arguments, sentence) in [
        ("estimate frames -o c.json --network nothing", "there is no network nothing"),
        ("estimate frames -o c.json --network raft-small", "raft-small is not installed"),
        ("estimate frames -o c.json --network missing.toml", "missing.toml: there is no such file"),
        ("estimate frames -o c.json --network box.toml --network box.toml", "are both for removeDoF"),
        ("estimate frames -o c.json --network none --network box.toml", "cannot be combined"),
        ("estimate frames -o c.json --method spectral --network box.toml", "removes nothing"),
        ("estimate frames -o c.json --clean frames --network box.toml", "such frames are given"),
        ("estimate frames -o c.json --track --network box.toml", "--track does not remove blur"),
    ] {
        let said = fails(dir.path(), arguments);
        assert!(said.contains(sentence), "{arguments}: {said}");
        assert!(!dir.path().join("c.json").exists(), "{arguments}");
    }
}

#[test]
fn the_model_folder_is_listed_filled_and_checked() {
    let dir = TempDir::new().unwrap();
    let said = |arguments: &str| {
        let output = models(dir.path(), arguments);
        assert!(output.status.success(), "{arguments}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let listed = said("models list");
    assert!(
        listed.contains("ffdnet-color") && listed.contains("[MIT]") && listed.contains("getDepth"),
        "{listed}"
    );
    assert_eq!(said("models path").trim(), dir.path().join("models").display().to_string());

    // The licence is shown, and must be accepted.
    let install = format!("models install nafnet-sidd-width32 --from {}", network("box.onnx").display());
    let output = models(dir.path(), &install);
    assert!(sentence_of(&output, &install).contains("run the command with --yes"));
    assert!(text(&output.stderr).contains("licence: MIT"));
    assert!(!dir.path().join("models").exists());
    let wrong = format!("models install nafnet-sidd-width32 --yes --from {}", network("flow.onnx").display());
    assert!(sentence_of(&models(dir.path(), &wrong), &wrong).contains("takes 2 inputs"));
    said(&format!("{install} --yes"));
    let line = |text: &str| text.lines().find(|l| l.contains("nafnet-sidd-width32")).unwrap().to_owned();
    assert!(line(&said("models list")).contains(" installed "));
    let checked = line(&said("models check nafnet-sidd-width32 --size 90x70"));
    assert!(checked.contains("90 x 70 px: a frame, 0."), "{checked}");

    // A damaged file is found.
    let file = dir.path().join("models/nafnet-sidd-width32/nafnet-sidd-width32.onnx");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() / 3]).unwrap();
    let output = models(dir.path(), "models check");
    assert!(sentence_of(&output, "models check").contains("networks cannot be used"));
    assert!(text(&output.stderr).contains("it may be cut short"));
    let unknown = models(dir.path(), "models install nothing --yes");
    assert!(sentence_of(&unknown, "models install nothing").contains("there is no network nothing"));
    let by_hand = models(dir.path(), "models install raft-small --yes");
    assert!(sentence_of(&by_hand, "models install raft-small").contains("no package holds raft-small"));
}
