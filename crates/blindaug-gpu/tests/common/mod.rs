//! The graphics device of the tests.

use blindaug_gpu::Gpu;
use std::sync::LazyLock;

static FOUND: LazyLock<Option<Gpu>> = LazyLock::new(Gpu::for_tests);

/// The device of tests that have asked [`no_gpu`].
pub static GPU: LazyLock<Gpu> = LazyLock::new(|| FOUND.clone().expect("no_gpu() was asked first"));

/// Whether there is no device to test with.
pub fn no_gpu() -> bool {
    FOUND.is_none()
}
