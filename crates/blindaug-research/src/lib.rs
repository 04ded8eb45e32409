//! The experiments of the Blind Augmentation paper, those that it could not do, and the kit of its user study.

pub mod statistics;
pub mod study;
