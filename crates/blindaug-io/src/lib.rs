//! Files in and out of blindaug: image sequences, video, EXR layers, depth, optical flow and camera.json.
//!
//! Everything streams: one frame is in memory at a time. Whatever a file holds, a reader returns a value or an
//! [`Error`] of one sentence that names the file. What a file's head asks for is checked against its length and against the
//! process's budget ([`memory`]) before anything is allocated.
//!
//! | what | from | functions |
//! |---|---|---|
//! | camera.json | | [`read_camera`], [`write_camera`] |
//! | a camera for each frame | JSON lines | [`read_camera_track`], [`CameraTrackWriter`] |
//! | frames | PNG, JPEG, TIFF, BMP, PNM, EXR | [`read_frame`], [`read_linear`] |
//! | virtual layers | EXR | [`read_virtual_layer`] |
//! | depth | EXR, PNG, PGM, TIFF | [`read_inverse_depth`] |
//! | frames in order | folders, single images, videos, cameras | [`FrameSource`] |
//! | what belongs to them | folders, by number | [`SideFolder`] |
//! | what an estimate rests on | the paper's layout | [`PaperScene`], [`EvidenceWriter`] |
//! | optical flow | `.flo`, EXR | [`read_flow`], [`write_flo`] |
//! | frames out | PNG | [`write_png`], [`write_png16`], [`write_grey16`], row by row [`PngWriter`] |
//! | videos out | | [`VideoWriter`] |
//!
//! Cameras are read and videos decoded by the `ffmpeg` program; without one, videos by a built-in decoder of H.264 in MP4. The environment
//! variable `BLINDAUG_FFMPEG` names another program; `none` forbids it.

mod camera;
mod depth;
mod error;
mod evidence;
mod exr;
mod ffmpeg;
mod files;
mod flow;
mod image;
mod limits;
pub mod memory;
mod mp4;
mod mp4_boxes;
mod partial;
#[cfg(test)]
mod regressions;
mod sequence;
mod side;
mod video;
mod video_head;
mod yuv;

pub use blindaug::Frame;
pub use camera::{CameraTrackWriter, read_camera, read_camera_track, write_camera};
pub use depth::{DepthFormat, DepthValues, read_inverse_depth};
pub use error::{Error, Result, guarded, one_line};
pub use evidence::{EvidenceWriter, PaperScene};
pub use exr::{ExrContents, VirtualLayerFile, exr_contents, read_virtual_layer};
pub use ffmpeg::VideoWriter;
pub use files::{Inputs, open_file, read_file, read_text, same_file};
pub use flow::{read_flow, write_flo};
pub use image::{PngWriter, read_frame, read_linear, write_grey16, write_png, write_png16, write_texture};
pub use limits::{MAX_PIXELS, MAX_SIDE};
pub use partial::{
    check_folder, check_writable, is_stream, make_folder, remove_incomplete_files, remove_leftovers_in,
    write_atomically,
};
pub use sequence::{FrameRange, FrameSource, Frames};
pub use side::SideFolder;
