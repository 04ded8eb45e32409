use crate::{Encoded, Flow, Plane};

/// A frame and its number: the last number in its file's name or, in a video, its place, counted from 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The frame's number.
    pub number: u64,
    /// The frame's picture.
    pub image: Encoded,
}

/// A frame that is kept for a report, with what is known of it. All rasters have the frame's size.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The frame's number.
    pub number: u64,
    /// The frame as it was filmed.
    pub frame: Encoded,
    /// The frame after it, which the flow leads to.
    pub next: Option<Encoded>,
    /// Optical flow to the next frame, px.
    pub flow: Option<Flow>,
    /// Inverse depth, in the unit of the model's defocus.
    pub inverse_depth: Option<Plane>,
    /// The frame, sharp and without noise.
    pub clean: Option<Encoded>,
}
