//! Cameras as settings of other tools.

use crate::{
    failure::{self, of},
    pixels::shaped,
};
use blindaug::{
    CameraModel,
    export::{Camera, Content, Export as Exported, Target, View},
};
use blindaug_io::{make_folder, write_atomically, write_texture};
use pyo3::{prelude::*, types::PyDict};
use std::path::PathBuf;

/// The names of all tools.
pub fn names() -> Vec<&'static str> {
    Target::ALL.iter().map(|target| target.name()).collect()
}

/// The camera as settings of the tool of this name.
pub fn exported(
    model: &CameraModel,
    target: &str,
    fov: Option<f32>,
    size: Option<(usize, usize)>,
) -> PyResult<Export> {
    let found = Target::ALL.iter().find(|t| t.name() == target);
    let target =
        found.ok_or_else(|| of("target", format!("\"{target}\" is none of {}", names().join(", "))))?;
    let camera = Camera::new(model, &View { size, fov_y_degrees: fov });
    let camera = camera.map_err(|e| failure::Error::new_err(e.to_string()))?;
    Ok(Export { target: target.name(), export: target.export(&camera) })
}

/// The files that a tool loads, and what it cannot do.
#[pyclass(frozen, module = "blindaug")]
pub struct Export {
    target: &'static str,
    export: Exported,
}

#[pymethods]
impl Export {
    /// The name of the tool.
    #[getter]
    fn target(&self) -> &'static str {
        self.target
    }

    /// The contents by the names of the files: texts, and textures (H, W, 4) as float32 in [0, 1].
    #[getter]
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let files = PyDict::new(py);
        for file in &self.export.files {
            match &file.content {
                Content::Text(text) => files.set_item(&file.name, text)?,
                Content::Texture(texture) => {
                    let (width, height) = texture.size();
                    let values = texture.data().as_flattened().to_vec();
                    files.set_item(&file.name, shaped(py, values, &[height, width, 4])?)?;
                }
            }
        }
        Ok(files)
    }

    /// What the tool cannot do and what is left at its default, a sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.export.lost.clone()
    }

    /// Writes the files into a folder, and gives their paths; the tool loads the first one.
    fn write(&self, py: Python<'_>, folder: PathBuf) -> PyResult<Vec<PathBuf>> {
        let write = || -> blindaug_io::Result<Vec<PathBuf>> {
            make_folder(&folder)?;
            // The first file refers to the others, so these are written before it.
            for file in self.export.files.iter().rev() {
                let path = folder.join(&file.name);
                match &file.content {
                    Content::Text(text) => write_atomically(&path, |partial| std::fs::write(partial, text))?,
                    Content::Texture(texture) => write_texture(&path, texture)?,
                }
            }
            Ok(self.export.files.iter().map(|file| folder.join(&file.name)).collect())
        };
        py.detach(write).map_err(failure::of_file)
    }

    fn __repr__(&self) -> String {
        let names: Vec<&str> = self.export.files.iter().map(|f| f.name.as_str()).collect();
        format!("<Export to {}: {}>", self.target, names.join(", "))
    }
}
