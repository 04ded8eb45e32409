//! The plugin as hosts call it: through its C functions, by a small host written here, and by the hosts' own code (`demo_host`).
#![allow(unsafe_code, missing_docs)]
// The host hands non-variadic functions to the plugin as variadic ones, which have the same calling convention here.
#![cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]

mod clip;
mod demo_host;
mod frames;
mod host;
mod lies;
