//! Errors as JavaScript has them.

use std::fmt::Display;
use wasm_bindgen::prelude::*;

/// An `Error` whose message is one sentence.
pub fn of(e: impl Display) -> JsError {
    JsError::new(&e.to_string())
}

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console)]
    fn error(message: &str);
}

/// From now on a panic's message goes to the console: the module itself then ends, and only a new worker goes on.
#[wasm_bindgen(start)]
fn tell_panics() {
    std::panic::set_hook(Box::new(|panic| error(&panic.to_string())));
}
