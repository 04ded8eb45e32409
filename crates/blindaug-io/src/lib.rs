//! Files in and out of blindaug.
