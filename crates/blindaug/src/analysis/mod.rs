//! Analysis of the scene from the frames themselves: optical flow, relative inverse depth from parallax, and cuts.

pub(crate) mod active_area;
pub(crate) mod brightness;
pub mod cuts;
pub mod depth;
pub mod flow;
mod padded;
mod variational;

/// The value below which a share `q` of the values lies; NaN counts as the largest. There must be at least one value.
fn quantile<T: Copy + Into<f64>>(values: &mut [T], q: f64) -> &T {
    let k = ((values.len() - 1) as f64 * q) as usize;
    // A NaN with a sign, as 0 / 0 gives, would count as the least value.
    let key = |v: &T| -> f64 {
        let v = (*v).into();
        if v.is_nan() { f64::NAN } else { v }
    };
    values.select_nth_unstable_by(k, |a, b| key(a).total_cmp(&key(b))).1
}
