//! Analysis of the scene from the frames themselves: optical flow, relative inverse depth from parallax, and cuts.

pub(crate) mod active_area;
pub(crate) mod brightness;
pub mod cuts;
pub mod depth;
pub mod flow;
mod padded;
mod variational;

/// The value below which a share `q` of the values lies. There must be at least one value.
fn quantile<T: Copy + PartialOrd>(values: &mut [T], q: f64) -> &T {
    let k = ((values.len() - 1) as f64 * q) as usize;
    values.select_nth_unstable_by(k, |a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal)).1
}
