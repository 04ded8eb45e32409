//! Networks of the paper's pipeline: which are used, and what they and the estimator find, kept in files.

use crate::console::{self, Failure, Result, failure, note, warn};
use blindaug::{
    Encoded,
    fit::{Estimator, Evidence},
};
use blindaug_io::{Inputs, PaperScene, remove_leftovers_in, write_flo, write_grey16, write_png16};
use blindaug_nets::{Chain, Network, Removed, Slot, Slots, Store};
use std::path::{Path, PathBuf};

/// The networks that a command uses.
#[derive(Default)]
pub struct Networks {
    chain: Chain,
    names: Vec<String>,
}

impl Networks {
    /// Those of these names or manifests; `removal`: where none is named, the built-in ones that remove. `none` leaves all out.
    ///
    /// A network that is damaged is left out, and said so.
    ///
    /// # Errors
    /// If there is none of a name, it is not installed, or two do the same.
    pub fn named(names: &[String], removal: bool) -> Result<Self> {
        let store = Store::user();
        if names.iter().any(|n| n == "none") {
            return match names.len() {
                1 => Ok(Self::default()),
                _ => Err(Failure("--network none cannot be combined with another network".into())),
            };
        }
        let mut slots = Slots::default();
        let mut used = vec![];
        let mut fill = |network: Network| {
            used.push(network.manifest().name.clone());
            slots.fill(network);
        };
        let mut filled: Vec<(Slot, String)> = vec![];
        for name in names {
            let manifest = store.find(name)?;
            store.check_installed(name)?;
            if let Some((slot, other)) = filled.iter().find(|f| f.0 == manifest.operator) {
                return Err(Failure(format!("{other} and {name} are both for {}: name one", slot.name())));
            }
            filled.push((manifest.operator, name.clone()));
            match store.open(name) {
                Ok(network) => fill(network),
                Err(e) => fall_back(manifest.operator, &e),
            }
        }
        if names.is_empty() && removal {
            Store::built_in()?.into_iter().for_each(fill);
        }
        Ok(Self { chain: Chain::new(slots), names: used })
    }

    /// Their names, joined by commas.
    pub fn names(&self) -> String {
        self.names.join(", ")
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.chain.slots().is_empty()
    }

    /// Whether one of them removes something.
    pub fn remove(&self) -> bool {
        self.chain.slots().remove()
    }

    /// Forgets the frames so far: another clip begins.
    pub fn clear(&mut self) {
        self.chain.clear();
    }

    /// Whether one of them removes noise.
    pub fn remove_noise(&self) -> bool {
        self.chain.slots().remove_noise.is_some()
    }

    /// How many frames before and after one they look at.
    pub fn reach(&self) -> usize {
        self.chain.reach()
    }

    /// What they make of frame `at` of successive ones. One that fails is left out from now on, and said so.
    pub fn run(&mut self, frames: &[(u64, &Encoded)], at: usize) -> Removed {
        let mut removed = self.chain.run(frames, at);
        for (slot, e) in removed.failed.drain(..) {
            fall_back(slot, &e);
        }
        removed
    }
}

/// What is given, and where nothing is, what networks made.
pub fn or_removed<'a>(given: Evidence<'a>, removed: &'a Removed) -> Evidence<'a> {
    let Removed { denoised, motion_deblurred, defocus_deblurred, flow, inverse_depth, .. } = removed;
    // After motion blur too, what is without defocus is clean.
    let (clean, defocus_only) = match motion_deblurred {
        Some(_) => (defocus_deblurred.as_deref(), None),
        None => (None, defocus_deblurred.as_deref()),
    };
    Evidence {
        flow: given.flow.or(flow.as_ref()),
        inverse_depth: given.inverse_depth.or(inverse_depth.as_ref().map(|(d, kind)| (d, *kind))),
        denoised: given.denoised.or(denoised.as_deref()),
        motion_deblurred: given.motion_deblurred.or(motion_deblurred.as_deref()),
        defocus_deblurred: given.defocus_deblurred.or(defocus_only),
        clean: given.clean.or(clean),
        by_network: given.by_network
            || [denoised, motion_deblurred, defocus_deblurred].iter().any(|i| i.is_some()),
    }
}

fn fall_back(slot: Slot, e: &blindaug_io::Error) {
    warn(format_args!("{e}; {} is left to the classical method", slot.name()));
}

/// Writes what an estimate rests on, in the layout of the paper's data: a folder for each kind, and a folder per scene in it.
pub struct EvidenceWriter {
    folder: PathBuf,
    scene: String,
    /// Inverse depth is divided by this: of the first frame that has it.
    depth_scale: Option<f32>,
}

impl EvidenceWriter {
    /// Into a folder, which is made with the first file; the scene is named after the input.
    ///
    /// # Errors
    /// If the folder cannot be made or written to, or one of its folders is an input.
    pub fn new(folder: &Path, input: &Path, inputs: &Inputs) -> Result<Self> {
        console::check_folder(folder)?;
        let scene = input.file_stem().unwrap_or(input.as_os_str()).to_string_lossy().into_owned();
        for kind in PaperScene::KINDS {
            let files = folder.join(kind).join(&scene);
            inputs.check_output_folder(&files, |_| true)?;
            remove_leftovers_in(&files, |_| true);
        }
        Ok(Self { folder: folder.into(), scene, depth_scale: None })
    }

    fn path(&self, kind: &str, number: u64, extension: &str) -> Result<PathBuf> {
        let folder = self.folder.join(kind).join(&self.scene);
        std::fs::create_dir_all(&folder)
            .map_err(|e| failure(&folder, format_args!("the folder cannot be made ({e})")))?;
        Ok(folder.join(format!("{number:04}.{extension}")))
    }

    /// A frame and what was removed from it.
    pub fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()> {
        let images = [
            ("original", Some(frame)),
            ("denoised", evidence.denoised),
            ("de_motion_blurred", evidence.motion_deblurred),
            ("de_focus_blurred", evidence.clean.or(evidence.defocus_deblurred)),
        ];
        for (kind, image) in images {
            if let Some(image) = image {
                write_png16(self.path(kind, number, "png")?, image)?;
            }
        }
        Ok(())
    }

    /// The flow and depth that the estimator used of its last frame.
    pub fn geometry(&mut self, number: u64, estimator: &Estimator) -> Result<()> {
        if let Some(flow) = estimator.flow() {
            write_flo(self.path("flow", number, "flo")?, flow)?;
        }
        if let Some((depth, _)) = estimator.inverse_depth() {
            // Other frames may hold nearer things.
            let most = || 2.0 * depth.data().iter().copied().filter(|d| d.is_finite()).fold(1e-6, f32::max);
            let scale = *self.depth_scale.get_or_insert_with(most);
            write_grey16(self.path("depth", number, "png")?, &depth.map(|d| d / scale))?;
        }
        Ok(())
    }

    /// Says where it is and how it is read again.
    pub fn finish(&self) {
        let (folder, scene) = (self.folder.display(), &self.scene);
        note(format_args!("evidence written: {folder} (read again by --evidence {folder} --scene {scene})"));
        if let Some(scale) = self.depth_scale {
            note(format_args!("its depth is inverse depth divided by {scale:.4}"));
        }
    }
}
