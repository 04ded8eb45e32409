//! Relative inverse depth from the parallax of a moving camera.
