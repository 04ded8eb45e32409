//! The virtual layer over the frame.
