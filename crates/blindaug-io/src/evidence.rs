//! Reading and writing the evidence of an estimate in the layout of the paper's released data: a folder for each kind of evidence,
//! and in it a folder per scene.

use crate::{
    DepthFormat, DepthValues, Error, Inputs, Result, SideFolder, check_folder, remove_leftovers_in,
    write_flo, write_grey16, write_png16,
};
use blindaug::{
    Encoded, Flow, Plane,
    fit::{Estimator, Evidence},
};
use std::path::{Path, PathBuf};

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
        let relative = DepthFormat { values: DepthValues::RelativeInverse, ..DepthFormat::default() };
        Ok(Self {
            original,
            denoised: frames("denoised")?,
            de_motion_blurred: frames("de_motion_blurred")?,
            de_focus_blurred: frames("de_focus_blurred")?,
            depth: folder("depth").map(|p| SideFolder::depth(p, relative)).transpose()?,
            flow: folder("flow").map(SideFolder::flow).transpose()?,
        })
    }
}

/// A writer of the evidence of an estimate, in the layout that [`PaperScene`] reads.
pub struct EvidenceWriter {
    folder: PathBuf,
    scene: String,
    /// The divisor of inverse depth, from the first frame that has depth.
    depth_scale: Option<f32>,
}

impl EvidenceWriter {
    /// A writer to a folder, which is made with the first file; the scene is named after the input.
    ///
    /// # Errors
    /// If the folder cannot be made or written to, or one of its subfolders is an input.
    pub fn new(folder: &Path, input: &Path, inputs: &Inputs) -> Result<Self> {
        check_folder(folder)?;
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
            .map_err(|e| Error::new(&folder, format!("the folder cannot be made ({e})")))?;
        Ok(folder.join(format!("{number:04}.{extension}")))
    }

    /// Writes a frame, and the frames made from it by removal of noise and blur.
    ///
    /// # Errors
    /// If a file cannot be written.
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

    /// Writes the flow and the depth that the estimator used for its last frame.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn geometry(&mut self, number: u64, estimator: &Estimator) -> Result<()> {
        if let Some(flow) = estimator.flow() {
            write_flo(self.path("flow", number, "flo")?, flow)?;
        }
        if let Some((depth, _)) = estimator.inverse_depth() {
            // The divisor is twice the largest value, since other frames may show nearer objects.
            let most = || 2.0 * depth.data().iter().copied().filter(|d| d.is_finite()).fold(1e-6, f32::max);
            let scale = *self.depth_scale.get_or_insert_with(most);
            write_grey16(self.path("depth", number, "png")?, &depth.map(|d| d / scale))?;
        }
        Ok(())
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
        self.depth_scale
    }
}
