//! Reads the bytes that a file refers to by a URI: in the URI itself, or in another file beside the file or below.

use base64::{
    Engine, alphabet,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use std::{
    io,
    path::{Component, Path},
};

/// Base64 with or without its padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The bytes, at most `most` of them, that the file at `path` names by a URI.
///
/// # Errors
/// If the bytes cannot be read; the message continues a sentence that begins with their name.
pub fn read(path: &Path, uri: &str, most: u64) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or("is data, but not in Base64")?;
        if data.len() as u64 / 4 * 3 > most {
            return Err("is too large".into());
        }
        return BASE64.decode(data).map_err(|e| format!("is damaged ({e})"));
    }
    let name = decoded(uri).ok_or("is no URI")?;
    let name = Path::new(&name);
    let inside = |c: Component| matches!(c, Component::Normal(_) | Component::CurDir);
    if uri.contains(':') || name.to_string_lossy().contains(':') || !name.components().all(inside) {
        return Err("does not lie beside the file or below: give its path from there".into());
    }
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let cannot = |e: io::Error| match e.kind() {
        io::ErrorKind::NotFound => "is not there".into(),
        _ => format!("cannot be read ({e})"),
    };
    let folder = folder.canonicalize().map_err(cannot)?;
    let file = folder.join(name).canonicalize().map_err(cannot)?;
    if !file.starts_with(&folder) {
        return Err("is a link to a place that is not beside the file or below".into());
    }
    blindaug_io::read_file(&file, most).map_err(|e| format!("cannot be read: {}", e.sentence()))
}

/// A URI with its percent signs and the two digits after each replaced by the bytes that they stand for.
fn decoded(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        let (digits, rest) = part.split_at_checked(2)?;
        if !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
            return None;
        }
        bytes.push(u8::from_str_radix(digits, 16).ok()?);
        bytes.extend(rest.bytes());
    }
    String::from_utf8(bytes).ok()
}
