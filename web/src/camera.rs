//! A camera in words, and as settings of other tools.

use crate::failure::of;
use blindaug::{
    CameraModel, Raster, byte_from_encoded,
    export::{Camera, Content, File, Target, View, grain},
};
use blindaug_report::words;
use serde_json::json;
use wasm_bindgen::prelude::*;

fn model(camera: &str) -> Result<CameraModel, JsError> {
    CameraModel::from_json(camera).map_err(of)
}

/// A camera in words, a line per fact.
///
/// # Errors
/// If this is no camera.
#[wasm_bindgen(js_name = cameraWords)]
pub fn camera_words(camera: &str) -> Result<String, JsError> {
    Ok(words::words(&model(camera)?, &[]))
}

/// The names and short texts of a camera's parameters, a JSON list of pairs: the value with its interval, or the reason why it is unknown.
///
/// # Errors
/// If this is no camera.
#[wasm_bindgen(js_name = cameraParameters)]
pub fn camera_parameters(camera: &str) -> Result<String, JsError> {
    Ok(json!(words::parameters(&model(camera)?)).to_string())
}

/// The file camera.json of a camera.
///
/// # Errors
/// If this is no camera.
#[wasm_bindgen(js_name = cameraFile)]
pub fn camera_file(camera: &str) -> Result<String, JsError> {
    Ok(model(camera)?.to_json())
}

/// The tools that cameras can be exported to, a JSON list of objects with `name`, `tool`, `motionBlur`, `defocus` and `grain`.
#[wasm_bindgen(js_name = exportTargets)]
pub fn export_targets() -> String {
    let entry = |target: &Target| {
        let a = target.abilities();
        json!({ "name": target.name(), "tool": a.tool, "motionBlur": a.motion_blur, "defocus": a.defocus, "grain": a.grain })
    };
    json!(Target::ALL.iter().map(entry).collect::<Vec<_>>()).to_string()
}

/// A camera as settings of a tool.
#[wasm_bindgen]
pub struct Exported {
    files: Vec<File>,
    notes: Vec<String>,
}

#[wasm_bindgen]
impl Exported {
    /// The camera for a tool whose vertical field of view is `fov` degrees.
    ///
    /// # Errors
    /// If this is no camera, or there is no tool of this name.
    #[wasm_bindgen(constructor)]
    pub fn new(camera: &str, target: &str, fov: Option<f32>) -> Result<Exported, JsError> {
        let Some(found) = Target::ALL.iter().find(|t| t.name() == target) else {
            let names: Vec<&str> = Target::ALL.iter().map(|t| t.name()).collect();
            return Err(JsError::new(&format!(
                "\"{target}\" is no tool to export to; take one of {}",
                names.join(", ")
            )));
        };
        let view = View { size: None, fov_y_degrees: fov };
        let export = found.export(&Camera::new(&model(camera)?, &view).map_err(of)?);
        Ok(Exported { files: export.files, notes: export.lost })
    }

    /// The names of the files; the first one refers to the others.
    #[wasm_bindgen(getter)]
    pub fn names(&self) -> Vec<String> {
        self.files.iter().map(|f| f.name.clone()).collect()
    }

    /// What the tool cannot do and what is left at its default, a sentence each.
    #[wasm_bindgen(getter)]
    pub fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// The bytes of a file: text in UTF-8, or a PNG.
    ///
    /// # Errors
    /// If there is no such file.
    pub fn content(&self, index: usize) -> Result<Vec<u8>, JsError> {
        let file = self.files.get(index).ok_or_else(|| JsError::new("the export has fewer files"))?;
        match &file.content {
            Content::Text(text) => Ok(text.clone().into_bytes()),
            Content::Texture(texture) => png_of(texture).map_err(of),
        }
    }
}

/// The tile of noise that shaders read, bytes R, G, B, A: four octaves of std 1, finest first, each stored as 0.5 + gain n.
#[wasm_bindgen(js_name = noiseTile)]
pub fn noise_tile() -> Vec<u8> {
    bytes_of(&grain::bands())
}

/// How the tile of noise is read: its side in px, its gain, and where the three channels read, as JSON.
#[wasm_bindgen(js_name = noiseTileLayout)]
pub fn noise_tile_layout() -> String {
    json!({ "side": grain::SIDE, "gain": grain::GAIN, "offsets": grain::CHANNEL_OFFSETS }).to_string()
}

fn bytes_of(texture: &Raster<[f32; 4]>) -> Vec<u8> {
    texture.data().as_flattened().iter().map(|&v| byte_from_encoded(v)).collect()
}

/// A texture as PNG, 8 bits per value.
fn png_of(texture: &Raster<[f32; 4]>) -> Result<Vec<u8>, png::EncodingError> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, texture.width() as u32, texture.height() as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&bytes_of(texture))?;
    writer.finish()?;
    Ok(out)
}
