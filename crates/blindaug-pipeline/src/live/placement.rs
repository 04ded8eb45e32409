//! The place of the object: on a plane that homographies of the flow track, or fixed in view if there is no plane.
//!
//! The plane is taken to face the camera, at a given distance, when it is found. From then on the product of the homographies between
//! frames gives the places of its points in the picture, and from them (Zhang 2000) its pose.

use blindaug::Flow;
use glam::{DMat3, DVec2, DVec3};

/// Share of the flow's samples that must agree with one homography for a plane to be found, and for it to be kept.
const FOUND: f64 = 0.5;
const KEPT: f64 = 0.35;
/// The number of frames in a row that must agree before a plane counts as found, or as lost.
const AGREEING: u32 = 3;
/// The approximate number of places at which the flow is read.
const SAMPLES: usize = 800;
/// The number of draws of four samples, each of which gives a homography.
const DRAWS: usize = 200;
/// The distance up to which a sample of the flow agrees with a homography: as a share of the picture's width, and its least value in px.
const TOLERANCE: f64 = 0.002;
const TOLERANCE_PX: f64 = 0.5;
/// The number of least-squares fits of the homography, each with weights from the residuals of the one before.
const REFINEMENTS: usize = 5;
/// The range of distances in which a plane is followed, in units of the distance at which it was found.
const REACH: std::ops::Range<f64> = 0.1..20.0;

/// A pinhole camera with square pixels; x is right, y down, z forward.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    /// Width and height, px.
    pub size: (usize, usize),
    /// The focal length, px.
    pub focal_length: f64,
}

impl Pinhole {
    /// A camera for pictures of a size in px, with a vertical field of view in degrees, in (0, 180).
    pub fn new(size: (usize, usize), fov: f64) -> Self {
        Self { size, focal_length: 0.5 * size.1 as f64 / (0.5 * fov.to_radians()).tan() }
    }

    /// The principal point: the middle of the picture, px from the centre of its first pixel.
    pub fn centre(&self) -> DVec2 {
        0.5 * DVec2::new(self.size.0 as f64 - 1.0, self.size.1 as f64 - 1.0)
    }

    /// The height, m, that is seen at a distance in m.
    pub fn seen_height(&self, distance: f64) -> f64 {
        distance * self.size.1 as f64 / self.focal_length
    }

    /// The matrix from camera coordinates to px.
    fn matrix(&self) -> DMat3 {
        let (f, c) = (self.focal_length, self.centre());
        DMat3::from_cols(DVec3::new(f, 0.0, 0.0), DVec3::new(0.0, f, 0.0), c.extend(1.0))
    }
}

/// The transform from coordinates of the plane (x right, y down, z away from the camera, m) to the camera's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The rotation from the plane's axes to the camera's.
    pub rotation: DMat3,
    /// The plane's origin in the camera's coordinates, m.
    pub translation: DVec3,
}

impl Pose {
    /// The pose of a plane that faces the camera, with its origin at pixel position `at`, `distance` metres away.
    fn facing(camera: &Pinhole, at: DVec2, distance: f64) -> Self {
        let place = (at - camera.centre()) / camera.focal_length;
        Self { rotation: DMat3::IDENTITY, translation: distance * place.extend(1.0) }
    }

    /// The homography from the plane's coordinates to px.
    fn homography(&self, camera: &Pinhole) -> DMat3 {
        let DMat3 { x_axis, y_axis, .. } = self.rotation;
        camera.matrix() * DMat3::from_cols(x_axis, y_axis, self.translation)
    }

    /// The pose that a homography from the plane's coordinates to px stands for. If no pose fits exactly, the plane's origin is kept, and
    /// its axes are turned as little as possible to be perpendicular.
    fn of_homography(homography: &DMat3, camera: &Pinhole) -> Option<Self> {
        let m = camera.matrix().inverse() * *homography;
        let scale = 0.5 * (m.x_axis.length() + m.y_axis.length());
        let m = m * (m.z_axis.z.signum() / scale);
        let (a, b) = (m.x_axis.normalize(), m.y_axis.normalize());
        let (sum, difference) = ((a + b).normalize(), (a - b).normalize());
        let (x, y) = ((sum + difference).normalize(), (sum - difference).normalize());
        let pose = Self { rotation: DMat3::from_cols(x, y, x.cross(y)), translation: m.z_axis };
        (pose.rotation.is_finite() && pose.translation.is_finite()).then_some(pose)
    }
}

/// The poses of the object in a frame and in the next one.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// The pose in the frame.
    pub now: Pose,
    /// The pose in the next frame.
    pub next: Pose,
    /// Whether the object stands on a plane that was found.
    pub on_plane: bool,
}

/// Follows a plane from frame to frame.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    camera: Pinhole,
    /// The pose of the object before a plane is found.
    home: Pose,
    /// The homography from coordinates of the plane to px of the next frame that is pushed.
    plane: DMat3,
    /// The last homography from one frame to the next.
    step: DMat3,
    on_plane: bool,
    /// The number of frames in a row that contradicted `on_plane`.
    against: u32,
}

impl Placement {
    /// A placement of an object that stands at `at` (shares of the picture's width and height), `distance` metres away.
    pub fn new(camera: Pinhole, at: DVec2, distance: f64) -> Self {
        let (w, h) = camera.size;
        let home = Pose::facing(&camera, at * DVec2::new(w as f64, h as f64), distance);
        let plane = home.homography(&camera);
        Self { camera, home, plane, step: DMat3::IDENTITY, on_plane: false, against: 0 }
    }

    /// Takes the flow of a frame to the next one, if it is known.
    pub fn push(&mut self, flow: Option<&Flow>) -> Placed {
        let found = flow.and_then(homography);
        let enough = if self.on_plane { KEPT } else { FOUND };
        let found = found.filter(|f| f.share >= enough).map(|f| f.homography);
        self.against = if found.is_some() == self.on_plane { 0 } else { self.against + 1 };
        if self.against >= AGREEING {
            (self.on_plane, self.against) = (!self.on_plane, 0);
            if self.on_plane {
                // The tilt and the distance of the new plane are unknown, whatever those of the last plane were.
                let foot = moved(&self.plane, DVec2::ZERO);
                let plane = Pose::facing(&self.camera, foot, self.home.translation.z);
                self.plane = plane.homography(&self.camera);
            }
        }
        self.step = match (self.on_plane, found) {
            (true, Some(found)) => found,
            // The plane is taken to move as before, for the few frames until it counts as lost.
            (true, None) => self.step,
            (false, _) => DMat3::IDENTITY,
        };
        // An object that is fixed in view must be in view.
        if !self.on_plane && !self.is_seen() {
            self.plane = self.home.homography(&self.camera);
        }
        self.advance()
    }

    /// Whether the plane's origin is in the picture.
    fn is_seen(&self) -> bool {
        let (w, h) = self.camera.size;
        let foot = moved(&self.plane, DVec2::ZERO);
        (0.0..w as f64).contains(&foot.x) && (0.0..h as f64).contains(&foot.y)
    }

    /// Repeats the last motion for a frame whose flow is unknown.
    pub fn skip(&mut self) -> Placed {
        self.advance()
    }

    fn advance(&mut self) -> Placed {
        let near = |pose: &Pose| REACH.contains(&(pose.translation.z / self.home.translation.z));
        let pose = |plane: &DMat3| Pose::of_homography(plane, &self.camera).filter(near);
        let moved = self.step * self.plane;
        if let (Some(now), Some(next)) = (pose(&self.plane), pose(&moved)) {
            // A homography's scale does not matter, but it must neither grow nor vanish with time.
            self.plane = moved / moved.z_axis.length();
            return Placed { now, next, on_plane: self.on_plane };
        }
        *self = Self {
            plane: self.home.homography(&self.camera),
            step: DMat3::IDENTITY,
            on_plane: false,
            ..*self
        };
        Placed { now: self.home, next: self.home, on_plane: false }
    }
}

/// A homography, and the share of the flow's samples that agree with it, 0 to 1.
struct Found {
    homography: DMat3,
    share: f64,
}

/// The point to which a homography moves p.
fn moved(homography: &DMat3, p: DVec2) -> DVec2 {
    let q = *homography * p.extend(1.0);
    q.truncate() / q.z
}

/// The homography that most of the flow agrees with: the best of those of four random samples (RANSAC), refined by least
/// squares with Tukey's weights.
fn homography(flow: &Flow) -> Option<Found> {
    let (w, h) = flow.size();
    let stride = ((w * h / SAMPLES) as f64).sqrt().max(1.0) as usize;
    let grid =
        || (stride / 2..h).step_by(stride).flat_map(|y| (stride / 2..w).step_by(stride).map(move |x| (x, y)));
    // Positions are in widths of the picture from its middle, so that the equations are well conditioned.
    let unit = w as f64;
    let middle = 0.5 * DVec2::new(w as f64, h as f64);
    let samples: Vec<(DVec2, DVec2)> = grid()
        .filter_map(|(x, y)| {
            let [u, v] = flow.at(x, y).map(f64::from);
            let p = DVec2::new(x as f64, y as f64) - middle;
            (u.is_finite() && v.is_finite()).then(|| (p / unit, (p + DVec2::new(u, v)) / unit))
        })
        .collect();
    if samples.len() < 4 {
        return None;
    }
    let tolerance = TOLERANCE.max(TOLERANCE_PX / unit);
    let residual = |m: &DMat3, &(p, q): &(DVec2, DVec2)| (moved(m, p) - q).length();
    let agreeing = |m: &DMat3| samples.iter().filter(|s| residual(m, s) < tolerance).count();
    let mut random = 1u32;
    let mut draw = || {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        samples[random as usize % samples.len()]
    };
    let drawn = (0..DRAWS).filter_map(|_| fitted([draw(), draw(), draw(), draw()].map(|s| (s, 1.0))));
    let mut best = drawn.max_by_key(&agreeing)?;
    for _ in 0..REFINEMENTS {
        let weight = |s| (1.0 - (residual(&best, s) / (2.0 * tolerance)).powi(2)).max(0.0).powi(2);
        match fitted(samples.iter().map(|s| (*s, weight(s)))) {
            Some(finer) => best = finer,
            None => break,
        }
    }
    let to_unit = DMat3::from_scale(DVec2::splat(unit.recip())) * DMat3::from_translation(-middle);
    let share = agreeing(&best) as f64 / grid().count() as f64;
    Some(Found { homography: to_unit.inverse() * best * to_unit, share })
}

/// The homography of weighted pairs of points by the direct linear transform; its last element is set to 1, which it nearly is between
/// successive frames.
fn fitted(pairs: impl IntoIterator<Item = ((DVec2, DVec2), f64)>) -> Option<DMat3> {
    const N: usize = 8;
    // The normal equations, with their right-hand side.
    let mut rows = [[0.0f64; N + 1]; N];
    for ((p, q), weight) in pairs {
        let x = [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, q.x];
        let y = [0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, q.y];
        for equation in [x, y] {
            for (row, a) in rows.iter_mut().zip(equation) {
                row.iter_mut().zip(equation).for_each(|(sum, b)| *sum += weight * a * b);
            }
        }
    }
    // Gauss-Jordan with pivots.
    for i in 0..N {
        let pivot = (i..N).max_by(|&a, &b| rows[a][i].abs().total_cmp(&rows[b][i].abs()))?;
        rows.swap(i, pivot);
        let row = rows[i].map(|v| v / rows[i][i]);
        if !row[N].is_finite() {
            return None;
        }
        for other in rows.iter_mut() {
            let factor = other[i];
            other.iter_mut().zip(row).for_each(|(v, r)| *v -= factor * r);
        }
        rows[i] = row;
    }
    let [a, b, c, d, e, f, g, h] = rows.map(|r| r[N]);
    Some(DMat3::from_cols_array(&[a, d, g, b, e, h, c, f, 1.0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    const SIZE: (usize, usize) = (320, 180);

    fn camera() -> Pinhole {
        Pinhole::new(SIZE, 50.0)
    }

    fn placement() -> Placement {
        Placement::new(camera(), DVec2::new(0.5, 0.7), 2.0)
    }

    fn flow_of(homography: &DMat3) -> Flow {
        Flow::from_fn(SIZE.0, SIZE.1, |x, y| {
            let p = DVec2::new(x as f64, y as f64);
            let [u, v] = (moved(homography, p) - p).to_array();
            [u as f32, v as f32]
        })
    }

    /// The pose of a wall, in m, for a camera that faces the wall at first, then moves along it and turns.
    fn filmed(frame: usize) -> Pose {
        let t = frame as f64;
        let rotation = DMat3::from_rotation_y(0.004 * t) * DMat3::from_rotation_z(0.002 * t);
        Pose { rotation, translation: DVec3::new(-0.012 * t, 0.008 * t, 2.0 + 0.01 * t) }
    }

    fn noise(rng: &mut StdRng) -> Flow {
        let mut flow = Flow::filled(SIZE.0, SIZE.1, [0.0; 2]);
        flow.data_mut().iter_mut().for_each(|f| *f = [0; 2].map(|_| rng.random_range(-6.0..6.0)));
        flow
    }

    fn pixel(pose: &Pose, point: DVec3) -> DVec2 {
        let q = camera().matrix() * (pose.rotation * point + pose.translation);
        q.truncate() / q.z
    }

    #[test]
    fn the_object_sticks_to_a_plane_that_the_camera_moves_along() {
        let mut rng = StdRng::seed_from_u64(1);
        let mut placement = placement();
        let mut anchor: Option<(usize, Pose)> = None;
        for frame in 0..60 {
            let step =
                filmed(frame + 1).homography(&camera()) * filmed(frame).homography(&camera()).inverse();
            let mut flow = flow_of(&step);
            // Two of five pixels have another motion; that of the rest is not exact.
            let other = noise(&mut rng);
            for (i, f) in flow.data_mut().iter_mut().enumerate() {
                *f = if i % 5 < 2 { other.data()[i] } else { f.map(|v| v + rng.random_range(-0.1..0.1)) };
            }
            let placed = placement.push(Some(&flow));
            if let (None, true) = (&anchor, placed.on_plane) {
                anchor = Some((frame, placed.now));
            }
            let Some((since, first)) = anchor else { continue };
            // The plane was taken to face the camera when it was found, and by then it nearly did.
            assert_eq!(since, 2);
            for (pose, at) in [(placed.now, frame), (placed.next, frame + 1)] {
                for corner in [DVec3::ZERO, DVec3::new(0.2, 0.0, 0.0), DVec3::new(0.0, -0.3, 0.0)] {
                    let seen = moved(&filmed(since).homography(&camera()).inverse(), pixel(&first, corner));
                    let truth = pixel(&filmed(at), seen.extend(0.0));
                    let error = (pixel(&pose, corner) - truth).length();
                    assert!(error < 1.0, "frame {at}: {error} px");
                }
            }
        }
        assert!(anchor.is_some());
        // Negative control: without the homographies the object is far off.
        let still = super::Placement::new(camera(), DVec2::new(0.5, 0.7), 2.0).push(None).now;
        assert!((pixel(&still, DVec3::ZERO) - pixel(&placement.push(None).now, DVec3::ZERO)).length() > 20.0);
    }

    #[test]
    fn where_the_flow_is_noise_the_object_is_fixed_in_view() {
        let mut rng = StdRng::seed_from_u64(2);
        let mut placement = placement();
        for _ in 0..20 {
            let Placed { now, next, on_plane } = placement.push(Some(&noise(&mut rng)));
            assert!(!on_plane && now == next);
            assert!((pixel(&now, DVec3::ZERO) - DVec2::new(160.0, 126.0)).length() < 1e-6);
        }
    }

    #[test]
    fn a_bad_frame_does_not_lose_the_plane_and_several_do() {
        let mut rng = StdRng::seed_from_u64(3);
        let mut placement = placement();
        let steady = flow_of(&DMat3::from_translation(DVec2::new(1.5, 0.0)));
        let on_plane = |placement: &mut Placement, flow: &Flow| placement.push(Some(flow)).on_plane;
        assert_eq!([(); 3].map(|()| on_plane(&mut placement, &steady)), [false, false, true]);
        let before = placement.push(Some(&steady)).now;
        let during = placement.push(Some(&noise(&mut rng)));
        assert!(during.on_plane);
        // The object goes on as before.
        let step = pixel(&during.next, DVec3::ZERO) - pixel(&before, DVec3::ZERO);
        assert!((step - DVec2::new(3.0, 0.0)).length() < 0.1, "{step}");
        assert!(on_plane(&mut placement, &steady));
        assert_eq!([(); 3].map(|()| on_plane(&mut placement, &noise(&mut rng))), [true, true, false]);
        // The object stays where the plane was lost.
        let Placed { now, next, .. } = placement.push(None);
        assert!(now == next && pixel(&now, DVec3::ZERO).x > 165.0);
    }

    #[test]
    fn a_plane_that_is_found_again_faces_the_camera_at_the_distance_of_the_first_one() {
        let mut rng = StdRng::seed_from_u64(4);
        let mut placement = placement();
        for frame in 0..40 {
            let step =
                filmed(frame + 1).homography(&camera()) * filmed(frame).homography(&camera()).inverse();
            placement.push(Some(&flow_of(&step)));
        }
        let [.., lost] = [(); 3].map(|()| placement.push(Some(&noise(&mut rng))));
        let is_facing = |p: &Placed| {
            (p.now.translation.z - 2.0).abs() < 1e-9
                && (p.now.rotation - DMat3::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-9)
        };
        assert!(!lost.on_plane && !is_facing(&lost));
        let still = flow_of(&DMat3::IDENTITY);
        let [.., found] = [(); 3].map(|()| placement.push(Some(&still)));
        assert!(found.on_plane && is_facing(&found));
        assert!((pixel(&found.now, DVec3::ZERO) - pixel(&lost.now, DVec3::ZERO)).length() < 1e-6);
    }

    #[test]
    fn what_is_lost_out_of_view_comes_back() {
        let mut placement = placement();
        let sideways = flow_of(&DMat3::from_translation(DVec2::new(9.0, 0.0)));
        for _ in 0..30 {
            placement.push(Some(&sideways));
        }
        assert!(pixel(&placement.push(None).now, DVec3::ZERO).x > 320.0);
        placement.push(None);
        assert_eq!(
            pixel(&placement.push(None).now, DVec3::ZERO),
            pixel(&super::Placement::new(camera(), DVec2::new(0.5, 0.7), 2.0).push(None).now, DVec3::ZERO)
        );
    }

    #[test]
    fn a_plane_that_comes_too_near_is_left() {
        let mut placement = placement();
        let nearer = DMat3::from_scale(DVec2::splat(1.1));
        let placed: Vec<_> = (0..60).map(|_| placement.push(Some(&flow_of(&nearer)))).collect();
        assert!(placed.iter().any(|p| p.on_plane) && placed.iter().all(|p| p.next.translation.z > 0.1));
    }
}
