//! The blindaug command line.
fn main() {}
