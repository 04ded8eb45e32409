use crate::{Observer, Result};
use blindaug::{Encoded, Flow, Plane, fit::Evidence, model::DepthKind};

/// Operators, such as neural networks, that process frames before the estimation and add to their evidence.
pub trait Operators {
    /// The number of frames before and after a frame that the operators look at.
    fn reach(&self) -> usize;

    /// The given evidence of frame `at` of successive frames, completed by what the operators find.
    fn evidence<'a>(
        &'a mut self,
        frames: &[(u64, &Encoded)],
        at: usize,
        given: Evidence<'a>,
        observer: &dyn Observer,
    ) -> Evidence<'a>;
}

/// A sink that keeps the evidence of an estimate, frame by frame.
pub trait EvidenceSink {
    /// Takes a frame and its versions from which something was removed.
    ///
    /// # Errors
    /// If the frames cannot be kept.
    fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()>;

    /// Takes a frame's flow to the next frame, px, and its inverse depth with its unit, as far as they were found.
    ///
    /// # Errors
    /// If flow or depth cannot be kept.
    fn geometry(
        &mut self,
        number: u64,
        flow: Option<&Flow>,
        inverse_depth: Option<(&Plane, DepthKind)>,
    ) -> Result<()>;
}

#[cfg(feature = "files")]
impl EvidenceSink for blindaug_io::EvidenceWriter {
    fn images(&mut self, number: u64, frame: &Encoded, evidence: &Evidence) -> Result<()> {
        Ok(self.images(number, frame, evidence)?)
    }

    fn geometry(
        &mut self,
        number: u64,
        flow: Option<&Flow>,
        inverse_depth: Option<(&Plane, DepthKind)>,
    ) -> Result<()> {
        Ok(self.geometry(number, flow, inverse_depth)?)
    }
}
