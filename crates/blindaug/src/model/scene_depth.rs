//! The depth of the scene that the lens was fitted with, coarsely, so that places in the picture can be named.

use super::{CameraModel, DepthKind, SceneScale};
use crate::{Error, Plane, Result};
use serde::{Deserialize, Serialize};

/// The inverse depth in one frame, as medians of a grid of cells, with four digits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "File", try_from = "File")]
pub struct SceneDepth {
    /// The number of the frame.
    pub frame: u64,
    /// The unit of the inverse depths, which is that of the lens.
    pub kind: DepthKind,
    /// The side of a cell, px.
    pub cell_px: f32,
    /// The number of cells in a row.
    pub columns: usize,
    /// The median inverse depth of each cell, row by row from the top left; `None` where too little is known.
    pub inverse_depth: Vec<Option<f32>>,
}

/// The form of a [`SceneDepth`] in camera.json: a line of text for each row of cells, with `-` where nothing is known.
#[derive(Clone, Serialize, Deserialize)]
struct File {
    frame: u64,
    kind: DepthKind,
    cell_px: f32,
    inverse_depth: Vec<String>,
}

impl From<SceneDepth> for File {
    fn from(depth: SceneDepth) -> Self {
        let word = |d: &Option<f32>| d.map_or("-".into(), |d| d.to_string());
        let row = |row: &[Option<f32>]| row.iter().map(word).collect::<Vec<_>>().join(" ");
        let inverse_depth = depth.inverse_depth.chunks(depth.columns.max(1)).map(row).collect();
        Self { frame: depth.frame, kind: depth.kind, cell_px: depth.cell_px, inverse_depth }
    }
}

impl TryFrom<File> for SceneDepth {
    type Error = Error;

    fn try_from(file: File) -> Result<Self> {
        let bad = || {
            Error::new("scene_depth.inverse_depth must hold rows of as many numbers, or - for unknown ones")
        };
        let number = |word: &str| match word {
            "-" => Ok(None),
            word => word.parse().map(Some).map_err(|_| bad()),
        };
        let columns = file.inverse_depth.first().map_or(0, |row| row.split_whitespace().count());
        let words = file.inverse_depth.iter().flat_map(|row| row.split_whitespace());
        let inverse_depth = words.map(number).collect::<Result<Vec<_>>>()?;
        if inverse_depth.len() != columns * file.inverse_depth.len() {
            return Err(bad());
        }
        Ok(Self { frame: file.frame, kind: file.kind, cell_px: file.cell_px, columns, inverse_depth })
    }
}

/// The number with four digits.
fn rounded(v: f32) -> f32 {
    format!("{v:.3e}").parse().unwrap_or(v)
}

/// A place in a picture whose distance is known, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownDistance {
    /// The place, px from the top left of the camera's own frames.
    pub place: [f32; 2],
    /// The depth along the view axis, m, > 0.
    pub metres: f32,
}

/// The most cells along each side of a picture.
const CELLS: usize = 32;
/// The share of a cell's pixels whose depth must be known.
const ENOUGH: f32 = 0.25;

impl SceneDepth {
    /// The medians of a depth map of one frame (NaN: unknown); `None` if no cell's depth is known.
    pub fn of(depth: &Plane, kind: DepthKind, frame: u64) -> Option<Self> {
        let (w, h) = depth.size();
        let side = w.max(h).div_ceil(CELLS).max(1);
        let (columns, rows) = (w.div_ceil(side), h.div_ceil(side));
        let cell = |i: usize| {
            let (x0, y0) = (i % columns * side, i / columns * side);
            let part = depth.crop(x0, y0, side.min(w - x0), side.min(h - y0));
            let mut known: Vec<f32> = part.data().iter().copied().filter(|d| d.is_finite()).collect();
            if known.is_empty() || (known.len() as f32) < ENOUGH * part.data().len() as f32 {
                return None;
            }
            let middle = known.len() / 2;
            Some(rounded(*known.select_nth_unstable_by(middle, f32::total_cmp).1))
        };
        let inverse_depth: Vec<Option<f32>> = (0..columns * rows).map(cell).collect();
        inverse_depth.iter().any(Option::is_some).then_some(Self {
            frame,
            kind,
            cell_px: side as f32,
            columns,
            inverse_depth,
        })
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.inverse_depth.len() / self.columns.max(1)
    }

    /// The cell of a place, px; `None` outside.
    fn cell(&self, place: [f32; 2]) -> Option<usize> {
        let [column, row] = place.map(|v| (v / self.cell_px).floor());
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f32 && row < self.rows() as f32;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// The middle of a cell, px; cells are counted row by row from the top left.
    pub fn middle(&self, cell: usize) -> [f32; 2] {
        [cell % self.columns, cell / self.columns].map(|v| (v as f32 + 0.5) * self.cell_px)
    }

    /// The inverse depth at a place, px.
    ///
    /// # Errors
    /// If the place is outside the frame, or its depth is unknown; the sentence then names the nearest place that is known.
    pub fn at(&self, place @ [x, y]: [f32; 2]) -> Result<f32> {
        let Some(cell) = self.cell(place) else {
            return Err(Error::new(format!("the place {x},{y} is outside the picture")));
        };
        if let Some(depth) = self.inverse_depth[cell] {
            return Ok(depth);
        }
        let distance = |i: usize| {
            let [a, b] = self.middle(i);
            (a - x).hypot(b - y)
        };
        let known = (0..self.inverse_depth.len()).filter(|&i| self.inverse_depth[i].is_some());
        let nearest = known.min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let instead = nearest.map_or(String::new(), |i| {
            let [a, b] = self.middle(i);
            format!("; the nearest place that is known is {a:.0},{b:.0}")
        });
        Err(Error::new(format!(
            "the footage does not tell the depth at {x},{y} (frame {}){instead}",
            self.frame
        )))
    }

    /// Whether the sizes are right and the numbers finite.
    pub(super) fn validate(&self) -> Result<()> {
        let cells = self.inverse_depth.len();
        let sound = self.columns > 0
            && self.cell_px.is_finite()
            && self.cell_px > 0.0
            && (1..=1 << 16).contains(&cells)
            && cells.is_multiple_of(self.columns)
            && self.inverse_depth.iter().flatten().all(|d| d.is_finite());
        if sound { Ok(()) } else { Err(Error::new("scene_depth must hold rows of finite numbers or null")) }
    }
}

impl CameraModel {
    /// The inverse depth that was found at a place in the picture, px of the model's own frames, in the unit of the lens.
    ///
    /// # Errors
    /// If the model holds no depth of its scene, or none at this place.
    pub fn depth_at(&self, place: [f32; 2]) -> Result<f32> {
        let none = "it holds no depth of its scene, since it was estimated from frames in which nothing told the depth, or \
            frame by frame, or by an older version";
        self.scene_depth.as_ref().ok_or_else(|| Error::new(none))?.at(place)
    }

    /// The scale of the scene by one or two places whose distance is known. With one, what is infinitely far away is taken to have a
    /// relative inverse depth of 0.
    ///
    /// # Errors
    /// If the model is in metres already, the depth at a place is unknown, or the distances contradict the depths.
    pub fn scale_by(&self, known: &[KnownDistance]) -> Result<SceneScale> {
        if self.defocus.known().is_some_and(|lens| lens.depth_kind == DepthKind::Metric) {
            return Err(Error::new("its lens is in metres already, so that no distance is needed"));
        }
        let depths = known.iter().map(|k| Ok((self.depth_at(k.place)?, 1.0 / k.metres)));
        let depths: Vec<(f32, f32)> = depths.collect::<Result<_>>()?;
        let scale = match depths[..] {
            [(d, inverse)] => SceneScale { scale: d / inverse, offset: 0.0 },
            [(d1, i1), (d2, i2)] => {
                let scale = (d1 - d2) / (i1 - i2);
                SceneScale { scale, offset: d1 - scale * i1 }
            }
            _ => return Err(Error::new("one or two places with their distances are needed")),
        };
        if scale.scale.is_finite() && scale.scale > 0.0 && scale.offset.is_finite() {
            return Ok(scale);
        }
        let found: Vec<String> = depths.iter().map(|(d, _)| format!("{d:.3}")).collect();
        Err(Error::new(format!(
            "the distances contradict the relative inverse depths that were found there ({}): what is nearer must have the larger one",
            found.join(" and ")
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Capture, DefocusModel, Estimate};

    /// A model over relative inverse depth d = 0.5 / Z + 0.1 of a wall whose distance rises to the right from 1 m to 4 m.
    fn model() -> CameraModel {
        let (w, h) = (321, 100);
        let metres = |x: usize| 1.0 + 3.0 * x as f32 / 320.0;
        let depth = Plane::from_fn(w, h, |x, y| if y < 50 { 0.5 / metres(x) + 0.1 } else { f32::NAN });
        let mut model = CameraModel::unknown(
            Capture { width: w, height: h, fps: None, frames_used: 1, pixel_aspect: 1.0 },
            "test",
        );
        let lens = DefocusModel { depth_kind: DepthKind::Relative, ..DefocusModel::given_lens(3.0, 0.4) };
        model.defocus = Estimate::Known(lens);
        model.scene_depth = SceneDepth::of(&depth, DepthKind::Relative, 7);
        model
    }

    #[test]
    fn two_known_distances_give_the_scale() {
        let model = model();
        let metres = |x: f32| 1.0 + 3.0 * x / 320.0;
        // Places in the middle of cells, which are 11 px wide.
        let known = [5.0, 236.0].map(|x| KnownDistance { place: [x, 20.0], metres: metres(x) });
        let scale = model.scale_by(&known).unwrap();
        assert!((scale.scale - 0.5).abs() < 0.01 && (scale.offset - 0.1).abs() < 0.01, "{scale:?}");
        // One place leaves the offset at 0.
        let one = model.scale_by(&known[..1]).unwrap();
        assert!(
            one.offset == 0.0 && (one.scale - (0.5 / metres(5.0) + 0.1) * metres(5.0)).abs() < 0.01,
            "{one:?}"
        );
        // Negative controls: distances in the wrong order, a place whose depth is unknown, one outside, and a metric lens.
        let swapped = [known[0], KnownDistance { metres: 0.2, ..known[1] }];
        assert!(model.scale_by(&swapped).unwrap_err().to_string().contains("contradict"));
        let unknown = KnownDistance { place: [100.0, 90.0], metres: 1.0 };
        let e = model.scale_by(&[unknown]).unwrap_err().to_string();
        assert!(e.contains("100,90") && e.contains("nearest"), "{e}");
        let outside = KnownDistance { place: [100.0, 190.0], metres: 1.0 };
        assert!(model.scale_by(&[outside]).unwrap_err().to_string().contains("outside"));
        let metric = model.clone().to_metric(scale);
        assert!(metric.scale_by(&known).unwrap_err().to_string().contains("metres already"));
        // The depth goes to metres with the lens.
        assert!((metric.depth_at(known[0].place).unwrap() - 1.0 / metres(5.0)).abs() < 0.02);
    }

    #[test]
    fn the_depth_is_kept_in_the_file() {
        let model = model();
        let read = CameraModel::from_json(&model.to_json()).unwrap();
        assert_eq!(read.scene_depth, model.scene_depth);
        let broken = model.to_json().replacen("      \"- - ", "      \"- ", 1);
        assert!(CameraModel::from_json(&broken).unwrap_err().to_string().contains("scene_depth"));
        assert!(SceneDepth::of(&Plane::filled(9, 9, f32::NAN), DepthKind::Metric, 1).is_none());
    }
}
