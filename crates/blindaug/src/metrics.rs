//! Measures of how close two frames are.
