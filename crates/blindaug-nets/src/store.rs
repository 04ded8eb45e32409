//! Where networks are: those built in, and the user's model folder.

use crate::manifest::Manifest;
use crate::network::Network;
use blindaug_io::{Error, Result};
use std::path::{Path, PathBuf};

/// The networks that ship with the crate: manifest and weights.
const BUILT_IN: [(&str, &[u8]); 0] = [];

/// Manifests of networks that others have trained, whose weights are not part of this crate.
const KNOWN: [&str; 0] = [];

/// Where a network's weights are.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// In this crate.
    BuiltIn,
    /// In the model folder: the manifest.
    Installed(PathBuf),
    /// Nowhere yet.
    Missing,
}

/// The networks that can be asked for by name.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The store of the model folder: that of the environment variable `BLINDAUG_MODELS`, else `blindaug/models` in the user's data
    /// directory.
    pub fn user() -> Self {
        let given = std::env::var_os("BLINDAUG_MODELS").filter(|p| !p.is_empty()).map(PathBuf::from);
        let home = || dirs::data_dir().unwrap_or_else(|| PathBuf::from(".")).join("blindaug").join("models");
        Self { folder: given.unwrap_or_else(home) }
    }

    /// The store of another folder.
    pub fn at(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The model folder: one folder per network, with its manifest (`NAME.toml`) and its file. It need not exist.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// All networks: built in, known, and those in the model folder, by operator and name; and what is wrong with files there.
    pub fn list(&self) -> (Vec<(Manifest, State)>, Vec<Error>) {
        let mut networks = vec![];
        let mut problems = vec![];
        for path in self.manifests() {
            match Manifest::read(&path) {
                Ok(manifest) => {
                    let there = path.with_file_name(&manifest.file).is_file();
                    networks.push((manifest, if there { State::Installed(path) } else { State::Missing }));
                }
                Err(e) => problems.push(e),
            }
        }
        let built_in = BUILT_IN.iter().map(|(text, _)| (parsed(text), State::BuiltIn));
        let known = KNOWN.iter().map(|text| (parsed(text), State::Missing));
        for network in built_in.chain(known) {
            // The user's own of that name comes first.
            if networks.iter().all(|n: &(Manifest, State)| n.0.name != network.0.name) {
                networks.push(network);
            }
        }
        networks.sort_by(|a, b| (a.0.operator, &a.0.name).cmp(&(b.0.operator, &b.0.name)));
        (networks, problems)
    }

    /// A network by its name, or the path of its manifest.
    ///
    /// # Errors
    /// If there is none of that name, or it is damaged.
    pub fn open(&self, name: &str) -> Result<Network> {
        if name.ends_with(".toml") {
            return Network::open(Path::new(name));
        }
        let own = self.folder.join(name).join(format!("{name}.toml"));
        if own.is_file() {
            return Network::open(&own);
        }
        if let Some((text, onnx)) = BUILT_IN.iter().find(|(text, _)| parsed(text).name == name) {
            let manifest = parsed(text);
            let file = PathBuf::from(&manifest.file);
            return Network::new(manifest, &file, onnx.to_vec());
        }
        if KNOWN.iter().any(|text| parsed(text).name == name) {
            return Err(Error::new(
                own,
                format!(
                    "the network {name} is not installed: `blindaug models install {name}` says how to get it"
                ),
            ));
        }
        Err(Error::new(
            own,
            format!(
                "there is no network {name} (`blindaug models list` names all); a new one needs this manifest"
            ),
        ))
    }

    /// The manifest of a known network and its text, to be installed; of one in the model folder too.
    pub fn manifest(&self, name: &str) -> Result<(Manifest, String)> {
        let own = self.folder.join(name).join(format!("{name}.toml"));
        if let Some(text) = KNOWN.iter().find(|text| parsed(text).name == name) {
            return Ok((parsed(text), (*text).to_owned()));
        }
        let text = std::fs::read_to_string(&own).map_err(|e| Error::cannot_read(&own, &e))?;
        Ok((Manifest::parse(&text, &own)?, text))
    }

    /// The built-in networks.
    ///
    /// # Errors
    /// None that an intact program gives cause for.
    pub fn built_in() -> Result<Vec<Network>> {
        let open = |(text, onnx): &(&str, &[u8])| {
            let manifest = parsed(text);
            let file = PathBuf::from(&manifest.file);
            Network::new(manifest, &file, onnx.to_vec())
        };
        BUILT_IN.iter().map(open).collect()
    }

    /// The manifests in the model folder.
    fn manifests(&self) -> Vec<PathBuf> {
        let Ok(folders) = std::fs::read_dir(&self.folder) else { return vec![] };
        let manifest = |folder: PathBuf| {
            let name = folder.file_name()?.to_owned();
            let path = folder.join(name).with_extension("toml");
            path.is_file().then_some(path)
        };
        folders.filter_map(|f| manifest(f.ok()?.path())).collect()
    }
}

/// A manifest of this crate; a test parses all of them.
fn parsed(text: &str) -> Manifest {
    Manifest::parse(text, Path::new("built-in manifest")).expect("a test parses the manifests of this crate")
}
