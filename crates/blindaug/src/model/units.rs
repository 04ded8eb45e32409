//! The units of inverse depth, and the relation of relative inverse depth to metres.

use super::{CameraModel, CameraTrack, DefocusModel};
use crate::Plane;
use serde::{Deserialize, Serialize};

/// The unit of the inverse depths of a defocus model or of a depth map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthKind {
    /// Inverse depth along the view axis, in 1/m.
    Metric,
    /// Relative inverse depth without a unit: its scale and offset are unknown; larger is nearer.
    Relative,
}

/// The depth, m, from which on a renderer means that there is nothing.
const FARTHEST_M: f32 = 1e9;

/// The inverse depth, 1/m, of a depth Z along the view axis, m; NaN if Z means that there is nothing (0 or less, 1e9 or more, NaN).
pub fn inverse_of_metric(z: f32) -> f32 {
    if z > 0.0 && z < FARTHEST_M { 1.0 / z } else { f32::NAN }
}

/// Relates relative inverse depth d to the depth Z in metres: d = scale / Z + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneScale {
    /// The relative inverse depth of a point 1 m away, less the offset; > 0.
    pub scale: f32,
    /// The relative inverse depth of a point at infinity.
    pub offset: f32,
}

impl SceneScale {
    /// Inverse depth in 1/m from relative inverse depth; NaN stays NaN.
    pub fn to_metric(self, mut relative: Plane) -> Plane {
        let (slope, offset) = (self.scale.recip(), -self.offset / self.scale);
        relative.data_mut().iter_mut().for_each(|d| *d = slope * *d + offset);
        relative
    }

    /// Converts a lens over relative inverse depth to one over inverse depth in 1/m; a lens that is metric already stays as it is.
    pub fn lens_to_metric(self, lens: DefocusModel) -> DefocusModel {
        match lens.depth_kind {
            DepthKind::Metric => lens,
            DepthKind::Relative => lens.to_metric(self.scale, self.offset),
        }
    }
}

impl CameraModel {
    /// The camera with its lens over inverse depth in 1/m.
    pub fn to_metric(mut self, scale: SceneScale) -> Self {
        self.defocus = self.defocus.map(|lens| scale.lens_to_metric(lens));
        if let Some(depth) = self.scene_depth.as_mut().filter(|d| d.kind == DepthKind::Relative) {
            let known = depth.inverse_depth.iter_mut().flatten();
            known.for_each(|d| *d = (*d - scale.offset) / scale.scale);
            depth.kind = DepthKind::Metric;
        }
        self
    }
}

impl CameraTrack {
    /// The unit of the lens's inverse depth in the first frame whose lens is known; `None` if no frame's is.
    pub fn depth_kind(&self) -> Option<DepthKind> {
        self.frames().iter().find_map(|f| f.camera.defocus.known()).map(|lens| lens.depth_kind)
    }

    /// The cameras with their lenses over inverse depth in 1/m.
    pub fn to_metric(self, scale: SceneScale) -> Self {
        self.map(|camera| camera.to_metric(scale))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{DefocusCurve, ThinLensInterval};

    #[test]
    fn a_depth_that_means_nothing_has_no_inverse() {
        assert_eq!(inverse_of_metric(4.0), 0.25);
        assert!(
            [0.0, -1.0, 1e10, f32::INFINITY, f32::NAN].into_iter().all(|z| inverse_of_metric(z).is_nan())
        );
    }

    #[test]
    fn depth_and_lens_are_brought_to_metres_alike() {
        let scale = SceneScale { scale: 0.5, offset: 0.1 };
        let lens = DefocusModel { depth_kind: DepthKind::Relative, ..DefocusModel::given_lens(3.0, 0.4) };
        let metric = scale.lens_to_metric(lens);
        let relative = Plane::from_vec(3, 1, vec![0.2, 0.6, f32::NAN]).unwrap();
        let inverse_depth = scale.to_metric(relative.clone());
        for x in 0..2 {
            let (a, b) = (lens.sigma_px(relative.at(x, 0)), metric.sigma_px(inverse_depth.at(x, 0)));
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
        assert!(inverse_depth.at(2, 0).is_nan());
        assert_eq!(scale.lens_to_metric(metric), metric);
        // Intervals and what was seen are brought to metres too, and hold what they held.
        let interval = ThinLensInterval { sigma_px_at_infinity: [2.7, 3.3], focus_inverse_depth: [0.3, 0.6] };
        let curve = DefocusCurve::ThinLens {
            sigma_px_at_infinity: 3.0,
            focus_inverse_depth: 0.4,
            interval: Some(interval),
        };
        let known = DefocusModel { curve, inverse_depth_seen: Some([0.2, 0.9]), ..lens };
        let facts = scale.lens_to_metric(known).facts();
        let near = |a: Option<[f32; 2]>, b: [f32; 2]| {
            a.is_some_and(|a| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-5)
        };
        assert!(near(facts.focus_interval, [0.4, 1.0]), "{facts:?}");
        assert!(near(facts.sigma_interval, [2.7 * 0.75, 3.3 * 0.75]), "{facts:?}");
        assert!(near(scale.lens_to_metric(known).inverse_depth_seen, [0.2, 1.6]));
    }
}
