//! Frames as pages have them.

use crate::failure::of;
use blindaug::{ByteRows, Encoded, byte_from_encoded};
use wasm_bindgen::JsError;

/// The longest side of a frame, px, that a page's memory holds with all that is derived from it.
const MAX_SIDE: usize = 4096;

/// A frame from bytes R, G, B, A of rows without padding.
///
/// # Errors
/// If the size is none that can be worked on, or there are not as many bytes.
pub fn frame(size @ (width, height): (usize, usize), rgba: &[u8]) -> Result<Encoded, JsError> {
    if width > MAX_SIDE || height > MAX_SIDE {
        let sentence =
            format!("a frame of {width} x {height} px is too large for a page; reduce it to {MAX_SIDE} px");
        return Err(JsError::new(&sentence));
    }
    Encoded::from_rgba8(size, ByteRows::new(rgba, 4 * width)).map_err(of)
}

/// The bytes R, G, B, A of a frame, opaque.
pub fn rgba(frame: &Encoded) -> impl Iterator<Item = u8> {
    frame.0.data().iter().flat_map(|rgb| {
        let [r, g, b] = rgb.map(byte_from_encoded);
        [r, g, b, 255]
    })
}
