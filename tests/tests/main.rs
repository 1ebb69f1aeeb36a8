//! The library crates in use, as one program: each program links the whole workspace.

mod compensation;
mod creep;
mod drivers;
mod fitting;
mod hostile_bags;
mod ideal_model;
mod import;
mod magnet_fields;
mod noise_floor;
mod orientation;
mod polynomial_inverse;
mod recording_errors;
mod third_party_data;
