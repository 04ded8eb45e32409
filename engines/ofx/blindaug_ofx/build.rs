//! Says how the plugin is linked.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // Hosts load a plugin to describe it, unload it, and load it again. The worker threads of rayon outlive that, so that the code that
    // they run must stay in memory.
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo::rustc-link-arg-cdylib=-Wl,-z,nodelete");
    }
}
