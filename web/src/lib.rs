//! What the npm package `blindaug` does in WebAssembly. `js/` holds the package's own interface, which talks to this in a worker: cameras pass
//! as the JSON of camera.json, frames as bytes R, G, B, A.

mod camera;
mod failure;
mod frames;
mod live;
mod screen;
mod tracker;

#[cfg(feature = "threads")]
pub use wasm_bindgen_rayon::init_thread_pool;
