//! The graphics device of the tests.

use blindaug_gpu::Gpu;
use std::sync::LazyLock;

static FOUND: LazyLock<blindaug::Result<Gpu>> = LazyLock::new(Gpu::new);

/// Of tests that have asked [`no_gpu`].
pub static GPU: LazyLock<Gpu> = LazyLock::new(|| FOUND.clone().expect("no_gpu() was asked first"));

/// Says so, loudly, if there is no device, or fails where BLINDAUG_NEED_GPU is set.
pub fn no_gpu() -> bool {
    match &*FOUND {
        Ok(_) => false,
        Err(why) if std::env::var_os("BLINDAUG_NEED_GPU").is_some() => panic!("{why}"),
        Err(why) => {
            eprintln!("NOT TESTED: {why}");
            true
        }
    }
}
