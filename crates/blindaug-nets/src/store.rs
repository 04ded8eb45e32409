//! The built-in networks, and those in the user's model folder.

use crate::manifest::{MOST_BYTES, Manifest};
use crate::network::Network;
use blindaug_io::{Error, Result, read_text};
use std::path::{Path, PathBuf};

/// The networks that ship with the crate: manifest and weights. `train/` made them; models/*.md describe their training and gain.
static BUILT_IN: [(&str, &[u8]); 2] = [
    (include_str!("../models/blindaug-noise.toml"), include_bytes!("../models/blindaug-noise.onnx")),
    (include_str!("../models/blindaug-defocus.toml"), include_bytes!("../models/blindaug-defocus.onnx")),
];

/// Manifests of networks that others have trained, whose weights are not part of this crate.
const KNOWN: [&str; 19] = [
    include_str!("../manifests/depth-anything-v2-small.toml"),
    include_str!("../manifests/depth-pro.toml"),
    include_str!("../manifests/dpt-large.toml"),
    include_str!("../manifests/drbnet-single.toml"),
    include_str!("../manifests/ffdnet-color.toml"),
    include_str!("../manifests/flownet2.toml"),
    include_str!("../manifests/maxim-deblurring.toml"),
    include_str!("../manifests/maxim-denoising.toml"),
    include_str!("../manifests/midas-small.toml"),
    include_str!("../manifests/nafnet-gopro-width32.toml"),
    include_str!("../manifests/nafnet-sidd-width32.toml"),
    include_str!("../manifests/raft-large.toml"),
    include_str!("../manifests/raft-small.toml"),
    include_str!("../manifests/restormer-defocus-deblurring.toml"),
    include_str!("../manifests/restormer-motion-deblurring.toml"),
    include_str!("../manifests/restormer-real-denoising.toml"),
    include_str!("../manifests/scunet-color-real.toml"),
    include_str!("../manifests/sea-raft-m.toml"),
    include_str!("../manifests/shift-net-gopro.toml"),
];

/// The place of a network's weights.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// The manifest and the weights are part of this crate.
    BuiltIn,
    /// The weights are in the model folder, beside this manifest.
    Installed(PathBuf),
    /// The weights are not installed.
    Missing,
}

/// The networks that can be opened by name.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The store of the user's model folder, which the environment variable `BLINDAUG_MODELS` names; by default it is
    /// `blindaug/models` in the user's data directory.
    pub fn user() -> Self {
        let given = std::env::var_os("BLINDAUG_MODELS").filter(|p| !p.is_empty()).map(PathBuf::from);
        let home = || dirs::data_dir().unwrap_or_else(|| PathBuf::from(".")).join("blindaug").join("models");
        Self { folder: given.unwrap_or_else(home) }
    }

    /// The store of another folder.
    pub fn at(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The model folder: one folder per network, with its manifest (`NAME.toml`) and its ONNX file. The model folder need not exist.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// All networks (built in, known, and in the model folder), sorted by operator and name, and the errors of manifests in the model
    /// folder.
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
            // A network of the same name in the model folder takes precedence.
            if networks.iter().all(|n: &(Manifest, State)| n.0.name != network.0.name) {
                networks.push(network);
            }
        }
        networks.sort_by(|a, b| (a.0.operator, &a.0.name).cmp(&(b.0.operator, &b.0.name)));
        (networks, problems)
    }

    /// The manifest of a network, found by the network's name or the manifest's path.
    ///
    /// # Errors
    /// If there is no network of that name, or its manifest is damaged.
    pub fn find(&self, name: &str) -> Result<Manifest> {
        if let Some(own) = self.own(name) {
            return Manifest::read(&own);
        }
        of_this_crate(name).map(parsed).ok_or_else(|| {
            Error::new(
                self.manifest_path(name),
                format!("there is no network {name} (`blindaug models list` names all); a new one needs this manifest"),
            )
        })
    }

    /// Opens a network, found by its name or the path of its manifest.
    ///
    /// # Errors
    /// If there is no network of that name, or it is not installed or damaged.
    pub fn open(&self, name: &str) -> Result<Network> {
        self.check_installed(name)?;
        match (self.own(name), built_in(name)) {
            (None, Some(built_in)) => opened(built_in),
            (own, _) => Network::open(&own.unwrap_or_else(|| self.manifest_path(name))),
        }
    }

    /// Fails if a network is not installed.
    ///
    /// # Errors
    /// The same as [`Store::find`], or if the network's ONNX file is missing.
    pub fn check_installed(&self, name: &str) -> Result<()> {
        let Manifest { file, .. } = self.find(name)?;
        let own = self.own(name);
        let built_in = own.is_none() && Self::is_built_in(name);
        let file = own.unwrap_or_else(|| self.manifest_path(name)).with_file_name(file);
        if built_in || file.is_file() { Ok(()) } else { Err(crate::network::not_installed(&file, name)) }
    }

    /// The text of a network's manifest.
    ///
    /// # Errors
    /// The same as [`Store::find`].
    pub fn manifest_text(&self, name: &str) -> Result<String> {
        match self.own(name) {
            Some(own) => read_text(&own, MOST_BYTES),
            None => of_this_crate(name)
                .map(str::to_owned)
                .ok_or_else(|| Error::new(self.manifest_path(name), format!("there is no network {name}"))),
        }
    }

    /// Whether a network's manifest is one of this crate's known ones, and not somebody else's of the same name.
    pub fn is_of_this_crate(&self, name: &str) -> bool {
        self.manifest_text(name).is_ok_and(|text| KNOWN.contains(&text.as_str()))
    }

    /// The path of a manifest: `name` itself if it ends in `.toml`, else that in the model folder if it exists.
    fn own(&self, name: &str) -> Option<PathBuf> {
        if name.ends_with(".toml") {
            return Some(name.into());
        }
        Some(self.manifest_path(name)).filter(|own| own.is_file())
    }

    /// The path of a network's manifest in the model folder, which need not exist.
    pub fn manifest_path(&self, name: &str) -> PathBuf {
        self.folder.join(name).join(format!("{name}.toml"))
    }

    /// Whether a network of this name is built in.
    pub fn is_built_in(name: &str) -> bool {
        built_in(name).is_some()
    }

    /// The built-in networks.
    ///
    /// # Errors
    /// Only if the program itself is damaged.
    pub fn built_in() -> Result<Vec<Network>> {
        BUILT_IN.iter().map(opened).collect()
    }

    /// The manifests in the model folder.
    fn manifests(&self) -> Vec<PathBuf> {
        let Ok(folders) = std::fs::read_dir(&self.folder) else { return vec![] };
        let manifest = |folder: PathBuf| {
            let path = self.manifest_path(folder.file_name()?.to_str()?);
            path.is_file().then_some(path)
        };
        folders.filter_map(|f| manifest(f.ok()?.path())).collect()
    }
}

/// The text of this crate's manifest of the network with this name.
fn of_this_crate(name: &str) -> Option<&'static str> {
    let mut texts = BUILT_IN.iter().map(|(text, _)| *text).chain(KNOWN);
    texts.find(|text| parsed(text).name == name)
}

/// Parses a manifest of this crate; a test makes sure that all of them can be parsed.
fn parsed(text: &str) -> Manifest {
    Manifest::parse(text, Path::new("built-in manifest")).expect("a test parses the manifests of this crate")
}

/// The manifest and weights of the built-in network with this name.
fn built_in(name: &str) -> Option<&'static (&'static str, &'static [u8])> {
    BUILT_IN.iter().find(|(text, _)| parsed(text).name == name)
}

/// Opens a built-in network.
fn opened((text, onnx): &(&str, &[u8])) -> Result<Network> {
    let manifest = parsed(text);
    let file = PathBuf::from(&manifest.file);
    Network::new(manifest, &file, onnx.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_manifests_of_this_crate_are_sound_and_have_names_of_their_own() {
        let (all, problems) = Store::at("missing".into()).list();
        assert_eq!((all.len(), problems), (BUILT_IN.len() + KNOWN.len(), vec![]));
        let mut names: Vec<_> = all.iter().map(|n| &n.0.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), all.len());
        for (manifest, _) in &all {
            let Manifest { licence, source, install, .. } = manifest;
            let own = Store::is_built_in(&manifest.name);
            assert!(!licence.is_empty() && (own || source.starts_with("http")), "{}", manifest.name);
            let from =
                install.as_ref().map(|i| [&i.url, &i.pip, &i.npm].iter().filter(|f| f.is_some()).count());
            assert!(from.is_none_or(|n| n == 1), "{}", manifest.name);
        }
        let files = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/manifests")).unwrap().count();
        assert_eq!(files, KNOWN.len());
    }

    #[test]
    fn the_built_in_networks_run() {
        let frame = blindaug::Encoded(blindaug::Raster::from_fn(70, 50, |x, y| {
            [0.01 * x as f32, 0.5, 0.02 * y as f32]
        }));
        for network in Store::built_in().unwrap() {
            let frames = vec![&frame; network.manifest().input.frames.len()];
            assert_eq!(network.image(&frames).unwrap().0.size(), (70, 50));
        }
    }

    #[test]
    fn a_network_of_ones_own_is_a_manifest_and_a_file_in_the_model_folder() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::at(folder.path().into());
        let own = store.manifest_path("mine");
        std::fs::create_dir(own.parent().unwrap()).unwrap();
        let text = "name = 'mine'\noperator = 'removeDoF'\ntitle = 't'\nlicence = 'MIT'\nsource = 's'\nfile = 'box.onnx'\n[output]\nkind = 'image'";
        std::fs::write(&own, text).unwrap();
        let e = store.open("mine").err().unwrap().to_string();
        assert!(e.contains("mine is not installed"), "{e}");
        std::fs::copy(
            concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/box.onnx"),
            own.with_file_name("box.onnx"),
        )
        .unwrap();
        assert_eq!(store.open("mine").unwrap().manifest().title, "t");
        assert!(
            store
                .list()
                .0
                .iter()
                .any(|(m, state)| m.name == "mine" && *state == State::Installed(own.clone()))
        );
        std::fs::write(&own, "name = 3").unwrap();
        let (_, problems) = store.list();
        assert!(matches!(&problems[..], [e] if e.sentence().starts_with("line 1")), "{problems:?}");
        let e = store.open("raft-small").err().unwrap().to_string();
        assert!(e.contains("raft-small is not installed"), "{e}");
        let e = store.open("nothing").err().unwrap().to_string();
        assert!(e.contains("there is no network nothing"), "{e}");
    }
}
