//! Reading and writing of blindaug's files: image sequences, video, EXR layers, depth, optical flow and camera.json.
//!
//! Everything streams: one frame is in memory at a time. A reader returns a value, or an [`Error`] of one sentence that
//! names the file, even if the file is damaged. The size that a file's head claims is checked against the file's length and the
//! process's memory budget ([`memory`]) before anything is allocated.
//!
//! | content | files | functions |
//! |---|---|---|
//! | camera.json | | [`read_camera`], [`write_camera`] |
//! | a camera for each frame | JSON lines | [`read_camera_track`], [`CameraTrackWriter`] |
//! | frames | PNG, JPEG, TIFF, BMP, PNM, EXR | [`read_frame`], [`read_linear`] |
//! | virtual layers | EXR | [`read_virtual_layer`], [`write_distorted_layer`] |
//! | depth | EXR, PNG, PGM, TIFF | [`read_inverse_depth`] |
//! | frames in order | folders, single images, videos, cameras | [`FrameSource`] |
//! | frames' depth, flow, layers | folders, by number | [`SideFolder`] |
//! | evidence of an estimate | the paper's layout | [`PaperScene`], [`EvidenceWriter`] |
//! | what an input was | any file or folder | [`fingerprint`] |
//! | optical flow | `.flo`, EXR | [`read_flow`], [`write_flo`] |
//! | frames out | PNG, TIFF, EXR | [`FrameFormat::write`]; [`write_png`], [`write_png16`], [`write_grey16`], row by row [`PngWriter`] |
//! | videos out | | [`VideoWriter`] |
//!
//! The `ffmpeg` program reads cameras and decodes videos. Without ffmpeg, a built-in decoder reads H.264 in MP4, unless the feature `openh264`
//! is turned off. The environment
//! variable `BLINDAUG_FFMPEG` names another program; with `none`, ffmpeg is never used.

mod camera;
mod coding;
mod depth;
mod error;
mod evidence;
mod exr;
mod ffmpeg;
mod files;
mod fingerprint;
mod flow;
mod format;
mod icc;
mod image;
mod limits;
pub mod memory;
#[cfg(feature = "openh264")]
mod mp4;
#[cfg(feature = "openh264")]
mod mp4_boxes;
mod not_numbers;
mod partial;
mod pattern;
#[cfg(test)]
mod regressions;
mod sequence;
mod side;
mod video;
mod video_head;
mod yuv;

pub use blindaug::Frame;
pub use camera::{CameraTrackWriter, read_camera, read_camera_track, write_camera};
pub use coding::{Coding, Reading};
pub use depth::{DepthFormat, DepthValues, read_inverse_depth};
pub use error::{Error, Result, guarded, one_line};
pub use evidence::{EvidenceWriter, PaperScene, SavedEvidence};
pub use exr::{
    ExrContents, ExrHead, VirtualLayerFile, exr_contents, read_virtual_layer, write_distorted_layer,
};
pub use ffmpeg::{VideoCoding, VideoShape, VideoWriter};
pub use files::{Inputs, has_extension, open_file, read_file, read_text, same_file};
pub use fingerprint::{Fingerprint, fingerprint};
pub use flow::{read_flow, write_flo};
pub use format::{FileKind, FrameFormat};
pub use icc::IccProfile;
pub use image::{PngWriter, read_frame, read_linear, write_grey16, write_png, write_png16, write_texture};
pub use limits::{MAX_PIXELS, MAX_SIDE};
pub use partial::{
    cannot_write, check_folder, check_writable, is_stream, make_folder, remove_incomplete_files,
    remove_leftovers_in, write_atomically,
};
pub use pattern::NamePattern;
pub use sequence::{FrameRange, FrameSource, Frames};
pub use side::{MatteSide, SideFolder};
