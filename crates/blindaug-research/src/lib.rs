//! The experiments of the Blind Augmentation paper and those it could not do, and the kit of its user study.
//!
//! [`experiments`] are those of `blindaug reproduce`; [`validation`] is one of them, and [`study`] the user study, whose answers are given.
//! Results are [`table`]s and [`figure`]s, each written once and shown in every format; a [`run`] keeps what is done and writes the page;
//! [`statistics`] has the tests and the intervals.

pub mod baselines;
pub mod experiments;
pub mod fidelity;
pub mod figure;
mod filming;
mod pdf;
pub mod run;
mod sceneries;
mod shot;
pub mod statistics;
pub mod study;
pub mod table;
pub mod validation;
