//! Dense optical flow by dense inverse search and variational refinement.
