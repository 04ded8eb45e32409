//! Scenes of known truth filmed with one setting after another.

use blindaug::{Encoded, Flow, Result, Transfer};
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::measure::{Footage, NoiseTruth, Truth};
use blindaug_scenes::scene::{Exposure, Scene};

/// A scene, its sharp frames and the evidence that can be given with them.
pub(crate) struct Filming {
    scene: Scene,
    /// The footage of the last setting.
    pub(crate) footage: Footage,
    /// The motion of each frame at its own time.
    motion: Vec<Flow>,
    /// The camera and the setting that filmed last, their frames and the noise of these.
    filmed: Option<((Camera, Setting), Vec<Encoded>, NoiseTruth)>,
}

impl Filming {
    /// So many frames of a scene, not filmed yet.
    pub(crate) fn new(scene: Scene, frames: u64) -> Self {
        let times = || 0..frames;
        let footage = Footage {
            frames: vec![],
            clean: times()
                .map(|t| scene.picture(t as f32, Exposure::default(), 0).to_encoded(Transfer::Srgb))
                .collect(),
            inverse_depth: times().map(|t| scene.inverse_depth(t as f32)).collect(),
            flow: times().map(|t| scene.flow(t as f32)).collect(),
            truth: Truth { exposure: 0.0, lens: None },
            noise: None,
        };
        let motion = times().map(|t| scene.motion(t as f32)).collect();
        Self { scene, footage, motion, filmed: None }
    }

    /// Films the scene, unless that was done last, and puts the frames and the truth into the footage.
    pub(crate) fn film(&mut self, camera: Camera, setting: Setting, seed: u64) -> Result<()> {
        let by = (camera, setting);
        if self.filmed.as_ref().is_none_or(|f| f.0 != by) {
            let mut noise = NoiseTruth::default();
            let mut frames = vec![];
            for (t, clean) in self.footage.clean.iter().enumerate() {
                let evidence =
                    (&clean.to_linear(Transfer::Srgb), &self.footage.inverse_depth[t], &self.motion[t]);
                let filmed = camera.film(&self.scene, t as u64, evidence, &setting, seed)?;
                noise.add(&filmed.frame, &filmed.without_noise);
                frames.push(filmed.frame);
            }
            self.filmed = Some((by, frames, noise));
        }
        let (_, frames, noise) = self.filmed.as_ref().expect("it was just filmed");
        self.footage.truth = Truth { exposure: setting.exposure, lens: setting.lens };
        self.footage.frames.clone_from(frames);
        self.footage.noise = Some(noise.clone());
        Ok(())
    }
}
