//! Files in and out of blindaug: image sequences, video, EXR layers, depth, optical flow and camera.json.
//!
//! Everything streams: one frame is in memory at a time. Whatever a file holds, a reader returns a value or an
//! [`Error`] of one sentence that names the file.
//!
//! | what | from | functions |
//! |---|---|---|
//! | frames | PNG, JPEG, TIFF, BMP, PNM, EXR | [`read_frame`], [`read_linear`] |
//! | virtual layers | EXR | [`read_virtual_layer`] |
//! | depth | EXR, PNG, PGM, TIFF | [`read_inverse_depth`] |
//! | optical flow | `.flo`, EXR | [`read_flow`], [`write_flo`] |

mod depth;
mod error;
mod exr;
mod flow;
mod image;

pub use depth::{DepthFormat, DepthValues, read_inverse_depth};
pub use error::{Error, Result};
pub use exr::{ExrContents, VirtualLayerFile, exr_contents, read_virtual_layer};
pub use flow::{read_flow, write_flo};
pub use image::{MAX_PIXELS, MAX_SIDE, read_frame, read_linear};
