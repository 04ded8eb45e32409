use crate::{Observer, Result};
use blindaug::{
    Encoded,
    fit::{Estimator, Evidence},
};

/// What looks at frames before they are estimated from, and adds to what is known of them: neural networks, for instance.
pub trait Operators {
    /// How many frames before and after one it looks at.
    fn reach(&self) -> usize;

    /// What is given of frame `at` of successive ones, and where nothing is, what it finds.
    fn evidence<'a>(
        &'a mut self,
        frames: &[(u64, &Encoded)],
        at: usize,
        given: Evidence<'a>,
        observer: &dyn Observer,
    ) -> Evidence<'a>;
}

/// What keeps the evidence of an estimate, frame by frame.
pub trait EvidenceSink {
    /// Takes a frame and what was removed from it.
    ///
    /// # Errors
    /// If it cannot be kept.
    fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()>;

    /// Takes the flow and the depth that the estimator used of its last frame.
    ///
    /// # Errors
    /// If they cannot be kept.
    fn geometry(&mut self, number: u64, estimator: &Estimator) -> Result<()>;
}

#[cfg(feature = "files")]
impl EvidenceSink for blindaug_io::EvidenceWriter {
    fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()> {
        Ok(self.images(number, frame, evidence)?)
    }

    fn geometry(&mut self, number: u64, estimator: &Estimator) -> Result<()> {
        Ok(self.geometry(number, estimator)?)
    }
}
