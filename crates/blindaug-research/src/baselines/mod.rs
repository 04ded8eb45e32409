//! The methods with which ours is compared. What follows a paper's text, but not its code, is called "-like".

pub mod okumura;
pub mod okumura_plus;
pub mod shutter_angle;
