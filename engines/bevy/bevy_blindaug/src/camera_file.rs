//! camera.json, and a camera over time, as assets.

use bevy::asset::{Asset, AssetLoader, LoadContext, io::Reader};
use bevy::reflect::TypePath;
use blindaug::CameraModel;
use blindaug::model::CameraTrack;

/// The largest file that is read, bytes: a camera over time has about three thousand bytes a frame.
const MAX_BYTES: usize = 1 << 29;

/// A camera as `blindaug estimate` writes it: one model for all frames (camera.json), or one for each frame (`estimate --track`, JSON
/// lines).
///
/// A file that is broken or was written by a newer version is an asset as well, which holds the reason instead of a camera: so a file
/// that is edited while the game runs takes effect whatever was written into it.
#[derive(Asset, TypePath, Clone, Debug)]
pub struct FilmedCamera(pub Result<CameraTrack, String>);

impl From<CameraTrack> for FilmedCamera {
    fn from(track: CameraTrack) -> Self {
        Self(Ok(track))
    }
}

impl From<CameraModel> for FilmedCamera {
    fn from(model: CameraModel) -> Self {
        Self(Ok(model.into()))
    }
}

/// Reads [`FilmedCamera`]s from `.json` and `.jsonl` files.
#[derive(Default, TypePath)]
pub(crate) struct FilmedCameraLoader;

impl AssetLoader for FilmedCameraLoader {
    type Asset = FilmedCamera;
    type Settings = ();
    type Error = std::io::Error;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        (): &(),
        _: &mut LoadContext<'_>,
    ) -> Result<FilmedCamera, std::io::Error> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        Ok(FilmedCamera(parsed(&bytes)))
    }

    fn extensions(&self) -> &[&str] {
        &["json", "jsonl", "camera.json"]
    }
}

/// The camera in a file's bytes.
///
/// # Errors
/// If there is none: one sentence without the file's name.
fn parsed(bytes: &[u8]) -> Result<CameraTrack, String> {
    if bytes.len() > MAX_BYTES {
        return Err(format!("larger than {MAX_BYTES} bytes, so no camera model"));
    }
    let text = std::str::from_utf8(bytes).map_err(|_| "not text, so no camera model".to_string())?;
    CameraTrack::from_json(text).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::Capture;

    #[test]
    fn what_is_no_camera_is_said_in_one_line() {
        let capture = Capture { width: 64, height: 48, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let json = CameraModel::unknown(capture, "not given").to_json();
        assert_eq!(parsed(json.as_bytes()).unwrap().frames().len(), 1);
        let newer = json.replace("\"version\": 1", "\"version\": 2");
        assert_ne!(newer, json);
        for (bad, word) in [
            (newer.as_bytes(), "newer"),
            (&json.as_bytes()[..40], "not a camera model"),
            (b"\xff\xfe\x00", "not text"),
            (b"", "not a camera model"),
        ] {
            let why = parsed(bad).unwrap_err();
            assert!(why.contains(word) && !why.contains('\n'), "{why}");
        }
    }
}
