//! Reading optical flow from Middlebury `.flo` files and EXR, and writing `.flo` files.

use crate::{
    Error, Result, exr,
    files::open_file,
    limits::{check_size, is_exr},
    partial::write_atomically,
};
use blindaug::{Flow, Raster};
use std::{
    io::{BufReader, Read},
    path::Path,
};

const FLO_MAGIC: &[u8; 4] = b"PIEH";

/// Reads optical flow to the next frame (px, x right, y down; NaN where unknown) from a `.flo` file or from an EXR's
/// `forward.u`, `forward.v` or Blender Vector pass.
///
/// # Errors
/// If the file is missing, damaged, too large, or has no flow.
pub fn read_flow(path: impl AsRef<Path>) -> Result<Flow> {
    let path = path.as_ref();
    if is_exr(path)? { exr::read_flow(path) } else { read_flo(path) }
}

fn read_flo(path: &Path) -> Result<Flow> {
    let io = |e: std::io::Error| Error::cannot_read(path, &e);
    let file = open_file(path)?;
    let length = file.metadata().map_err(io)?.len();
    let mut file = BufReader::new(file);
    let mut head = [[0; 4]; 3];
    file.read_exact(head.as_flattened_mut()).map_err(io)?;
    let [magic, width, height] = head;
    if &magic != FLO_MAGIC {
        return Err(Error::new(path, "not a .flo file of optical flow (it does not start with PIEH)"));
    }
    let side =
        |b| u64::try_from(i32::from_le_bytes(b)).map_err(|_| Error::damaged(path, "its size is negative"));
    let (width, height) = check_size(path, side(width)?, side(height)?)?;
    let want = 12 + 8 * (width * height) as u64;
    if length < want {
        return Err(Error::new(
            path,
            format!(
                "the file is cut short ({length} bytes, but {width} x {height} pixels of flow take {want})"
            ),
        ));
    }
    let mut data = Vec::with_capacity(width * height);
    let mut row = vec![0; 8 * width];
    for _ in 0..height {
        file.read_exact(&mut row).map_err(io)?;
        let pairs = row.as_chunks::<4>().0.as_chunks::<2>().0.iter();
        data.extend(pairs.map(|uv| exr::known_flow(uv.map(f32::from_le_bytes))));
    }
    Raster::from_vec(width, height, data).map_err(|e| Error::new(path, e.to_string()))
}

/// Writes flow, px, to a `.flo` file; unknown flow (NaN) becomes 1e10.
///
/// # Errors
/// If the file cannot be written.
pub fn write_flo(path: impl AsRef<Path>, flow: &Flow) -> Result<()> {
    let mut bytes = FLO_MAGIC.to_vec();
    bytes.extend((flow.width() as i32).to_le_bytes());
    bytes.extend((flow.height() as i32).to_le_bytes());
    let stored = flow.data().as_flattened().iter().map(|&v| if v.is_finite() { v } else { 1e10 });
    bytes.extend(stored.flat_map(f32::to_le_bytes));
    write_atomically(path, |partial| std::fs::write(partial, bytes))
}
