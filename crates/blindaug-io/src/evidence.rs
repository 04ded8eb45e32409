//! Reading and writing the evidence of an estimate in the layout of the paper's released data: a folder for each kind of evidence,
//! and in it a folder per scene.

use crate::{
    DepthFormat, DepthValues, Error, Inputs, Result, SideFolder, check_folder, read_text,
    remove_leftovers_in, write_atomically, write_flo, write_grey16, write_png16,
};
use blindaug::{Encoded, Flow, Plane, fit::Evidence, model::DepthKind, text::why_not_json};
use serde::{Deserialize, Serialize};
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// What is to be known of evidence beside its images, so that an estimate from it is that of the run that saved it. It lies beside the
/// folders of the kinds of evidence, as `SCENE.evidence.json`; the paper's data have no such file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedEvidence {
    /// Frames per second, if they were known.
    #[serde(default)]
    pub fps: Option<f64>,
    /// The unit of inverse depth; `None` if there is no depth.
    #[serde(default)]
    pub depth_kind: Option<DepthKind>,
    /// The inverse depth, in that unit, of the largest integer in the files of depth; integer 0 is no reading.
    #[serde(default)]
    pub depth_of_largest: Option<f32>,
    /// Whether the flow was found in the frames, not given.
    pub flow_found: bool,
    /// Whether the frames in `de_focus_blurred` are clean: without motion blur too, although no others stand in `de_motion_blurred`.
    pub clean: bool,
    /// Whether networks made the frames from which something was removed.
    pub by_network: bool,
}

impl SavedEvidence {
    fn path(dir: &Path, scene: &str) -> PathBuf {
        dir.join(format!("{scene}.evidence.json"))
    }

    /// Reads the file beside the evidence of a scene; `None` if there is none.
    fn read(dir: &Path, scene: &str) -> Result<Option<Self>> {
        /// The most bytes of such a file, which has six numbers.
        const MAX_BYTES: u64 = 1 << 16;
        let path = Self::path(dir, scene);
        if !path.is_file() {
            return Ok(None);
        }
        let text = read_text(&path, MAX_BYTES)?;
        let read: Self = serde_json::from_str(&text).map_err(|e| {
            let why = why_not_json(&text, &e);
            Error::new(&path, format!("it does not describe evidence ({why}); save it again"))
        })?;
        let positive = |v: Option<f64>| v.is_none_or(|v| v.is_finite() && v > 0.0);
        if !positive(read.fps) || !positive(read.depth_of_largest.map(f64::from)) {
            return Err(Error::new(&path, "its numbers must be greater than 0; save the evidence again"));
        }
        Ok(Some(read))
    }
}

/// A scene in the layout of the paper's released data: a folder for each kind of evidence. A folder that is missing is `None`.
pub struct PaperScene {
    /// The folder of the recorded frames.
    pub original: PathBuf,
    /// Frames without noise.
    pub denoised: Option<SideFolder<Encoded>>,
    /// Frames without noise and motion blur.
    pub de_motion_blurred: Option<SideFolder<Encoded>>,
    /// Frames without noise, motion blur and defocus.
    pub de_focus_blurred: Option<SideFolder<Encoded>>,
    /// Relative inverse depth.
    pub depth: Option<SideFolder<Plane>>,
    /// Optical flow to the next frame, px.
    pub flow: Option<SideFolder<Flow>>,
    /// What is known of evidence that this program saved; `None` of other evidence. Depth is then in its own unit.
    pub saved: Option<SavedEvidence>,
}

impl PaperScene {
    /// The names of the folders, one for each kind of evidence.
    pub const KINDS: [&str; 6] =
        ["original", "denoised", "de_motion_blurred", "de_focus_blurred", "depth", "flow"];

    /// The folders that [`PaperScene::open`] may read.
    pub fn folders(dir: impl AsRef<Path>, scene: &str) -> Vec<PathBuf> {
        let dir = dir.as_ref();
        Self::KINDS.iter().flat_map(|kind| [dir.join(kind).join(scene), dir.join(scene).join(kind)]).collect()
    }

    /// Opens `dir/original/scene`, `dir/denoised/scene` and so on, or `dir/scene/original` and so on.
    ///
    /// # Errors
    /// If there is no folder of original frames, or one of the folders lacks the files of its kind.
    pub fn open(dir: impl AsRef<Path>, scene: &str) -> Result<Self> {
        let dir = dir.as_ref();
        let folder = |kind: &str| {
            let places = [dir.join(kind).join(scene), dir.join(scene).join(kind)];
            places.into_iter().find(|p| p.is_dir())
        };
        let Some(original) = folder("original") else {
            return Err(Error::new(
                dir,
                format!("no scene \"{scene}\": there is neither original/{scene} nor {scene}/original in it"),
            ));
        };
        let frames = |kind: &'static str| folder(kind).map(|p| SideFolder::frames(p, kind)).transpose();
        let saved = SavedEvidence::read(dir, scene)?;
        let relative = DepthFormat { values: DepthValues::RelativeInverse, ..DepthFormat::default() };
        Ok(Self {
            original,
            denoised: frames("denoised")?,
            de_motion_blurred: frames("de_motion_blurred")?,
            de_focus_blurred: frames("de_focus_blurred")?,
            depth: folder("depth")
                .map(|p| match saved.and_then(|s| s.depth_of_largest) {
                    Some(scale) => SideFolder::saved_depth(p, scale),
                    None => SideFolder::depth(p, relative),
                })
                .transpose()?,
            flow: folder("flow").map(SideFolder::flow).transpose()?,
            saved,
        })
    }
}

/// A writer of the evidence of an estimate, in the layout that [`PaperScene`] reads.
pub struct EvidenceWriter {
    folder: PathBuf,
    scene: String,
    saved: SavedEvidence,
    /// What an earlier run saved there, perhaps of other frames of the same clip.
    earlier: Option<SavedEvidence>,
}

/// The name of a scene after the input: that of the folder or file, however its path is written.
fn scene_of(input: &Path) -> String {
    let named = |path: &Path| Some(path.file_stem()?.to_string_lossy().into_owned());
    let whole = || named(&input.canonicalize().ok()?);
    named(input).or_else(whole).unwrap_or_else(|| "frames".into())
}

impl EvidenceWriter {
    /// A writer to a folder, which is made with the first file; the scene is named after the input.
    ///
    /// # Errors
    /// If the folder cannot be made or written to, or one of its subfolders is an input.
    pub fn new(folder: &Path, input: &Path, inputs: &Inputs) -> Result<Self> {
        check_folder(folder)?;
        let scene = scene_of(input);
        for kind in PaperScene::KINDS {
            let files = folder.join(kind).join(&scene);
            inputs.check_output_folder(&files, |_| true)?;
            remove_leftovers_in(&files, |_| true);
        }
        // A file of an earlier run would speak of other images.
        let path = SavedEvidence::path(folder, &scene);
        let earlier = SavedEvidence::read(folder, &scene).ok().flatten();
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != ErrorKind::NotFound => {
                return Err(Error::new(&path, format!("it cannot be replaced ({e})")));
            }
            _ => {}
        }
        let saved = SavedEvidence {
            fps: None,
            depth_kind: None,
            depth_of_largest: None,
            flow_found: true,
            clean: false,
            by_network: false,
        };
        Ok(Self { folder: folder.into(), scene, saved, earlier })
    }

    /// The file of a kind of evidence of a frame, in a folder that is made if it `is_there`; else what an earlier run left of it is removed.
    fn path(&self, kind: &str, number: u64, extension: &str, is_there: bool) -> Result<Option<PathBuf>> {
        let folder = self.folder.join(kind).join(&self.scene);
        let path = folder.join(format!("{number:04}.{extension}"));
        if is_there {
            std::fs::create_dir_all(&folder)
                .map_err(|e| Error::new(&folder, format!("the folder cannot be made ({e})")))?;
            return Ok(Some(path));
        }
        match std::fs::remove_file(&path) {
            Err(e) if ![ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => {
                Err(Error::new(&path, format!("it is of an earlier run, and cannot be removed ({e})")))
            }
            _ => Ok(None),
        }
    }

    /// Writes a frame, and the frames made from it by removal of noise and blur.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()> {
        self.saved.flow_found &= evidence.flow.is_none() || evidence.found_before;
        self.saved.clean |= evidence.clean.is_some() && evidence.motion_deblurred.is_none();
        self.saved.by_network |= evidence.by_network;
        let images = [
            ("original", Some(frame)),
            ("denoised", evidence.denoised),
            ("de_motion_blurred", evidence.motion_deblurred),
            ("de_focus_blurred", evidence.clean.or(evidence.defocus_deblurred)),
        ];
        for (kind, image) in images {
            if let (Some(path), Some(image)) = (self.path(kind, number, "png", image.is_some())?, image) {
                write_png16(path, image)?;
            }
        }
        Ok(())
    }

    /// Writes a frame's flow to the next frame, px, and its inverse depth with its unit, as far as they were found.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn geometry(
        &mut self,
        number: u64,
        flow: Option<&Flow>,
        inverse_depth: Option<(&Plane, DepthKind)>,
    ) -> Result<()> {
        if let (Some(path), Some(flow)) = (self.path("flow", number, "flo", flow.is_some())?, flow) {
            write_flo(path, flow)?;
        }
        let path = self.path("depth", number, "png", inverse_depth.is_some())?;
        if let (Some(path), Some((depth, kind))) = (path, inverse_depth) {
            let earlier =
                self.earlier.filter(|e| e.depth_kind == Some(kind)).and_then(|e| e.depth_of_largest);
            // The divisor is that of frames which an earlier run wrote, or a power of two of at least twice the largest value, since other
            // frames may show nearer objects.
            let divisor = || {
                let largest = depth.data().iter().copied().filter(|d| d.is_finite()).fold(1e-6, f32::max);
                earlier
                    .filter(|scale| *scale >= largest)
                    .unwrap_or_else(|| (2.0 * largest).log2().ceil().exp2())
            };
            let scale = *self.saved.depth_of_largest.get_or_insert_with(divisor);
            self.saved.depth_kind = Some(kind);
            // What is infinitely far is the smallest integer that is a reading.
            let stored = |d: f32| if d.is_finite() { (d / scale).max(1.0 / 65535.0) } else { f32::NAN };
            write_grey16(path, &depth.map(stored))?;
        }
        Ok(())
    }

    /// Writes what is to be known beside the images, once all are written; `fps`: frames per second, if known.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn finish(&mut self, fps: Option<f64>) -> Result<()> {
        self.saved.fps = fps;
        let text = serde_json::to_string_pretty(&self.saved).unwrap_or_default() + "\n";
        write_atomically(SavedEvidence::path(&self.folder, &self.scene), |partial| {
            std::fs::write(partial, text)
        })
    }

    /// The folder that is written to.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The scene's name.
    pub fn scene(&self) -> &str {
        &self.scene
    }

    /// The divisor of the inverse depth that was written; `None` if there was no depth.
    pub fn depth_scale(&self) -> Option<f32> {
        self.saved.depth_of_largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;

    #[test]
    fn what_an_earlier_run_left_of_a_frame_is_gone_and_its_unit_of_depth_stays() {
        let dir = tempfile::tempdir().unwrap();
        let frame = Encoded(Raster::filled(16, 12, [0.5; 3]));
        let write = |number: u64, clean: bool, nearest: f32| {
            let mut writer =
                EvidenceWriter::new(dir.path(), Path::new("clip.mp4"), &Inputs::default()).unwrap();
            let evidence = Evidence { clean: clean.then_some(&frame), ..Evidence::default() };
            writer.images(number, &frame, &evidence).unwrap();
            let depth = Plane::filled(16, 12, nearest);
            writer.geometry(number, None, Some((&depth, DepthKind::Metric))).unwrap();
            writer.finish(None).unwrap();
            writer.depth_scale().unwrap()
        };
        let clean = |number: u64| dir.path().join(format!("de_focus_blurred/clip/{number:04}.png")).exists();
        assert_eq!((write(1, true, 0.3), clean(1)), (1.0, true));
        // Another part of the clip.
        assert_eq!((write(2, true, 0.9), clean(1), clean(2)), (1.0, true, true));
        // The first part anew, without clean frames.
        assert_eq!((write(1, false, 0.3), clean(1), clean(2)), (1.0, false, true));
        // What is nearer than any depth in that unit.
        assert_eq!(write(1, false, 1.1), 4.0);
    }

    #[test]
    fn a_scene_has_the_name_of_its_folder_however_it_is_written() {
        let dir = tempfile::tempdir().unwrap();
        let shot = dir.path().join("shot");
        std::fs::create_dir_all(shot.join("a")).unwrap();
        for path in [shot.clone(), shot.join("a/.."), shot.join("."), dir.path().join("shot.mp4")] {
            assert_eq!(scene_of(&path), "shot", "{}", path.display());
        }
        assert_eq!(scene_of(Path::new("/")), "frames");
    }
}
