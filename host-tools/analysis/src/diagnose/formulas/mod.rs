//! Search for formulas of the covariates, where the effects of the catalogue leave structure.
//!
//! A formula is a product of functions of the recorded covariates that acts at a point of the chain from force to field. Forward
//! selection on held-out rows: all terms of a dictionary are scored exactly at all points of the chain, the best candidates are
//! refined, and the simplest within 2 % of the least remaining error is accepted if its family-wise p-value is below 1 % and
//! every fold improves. Then the whole model is fitted again with the formula as a user-defined effect. At the end terms
//! without effect are dropped, and the point of the chain is decided by full fits. A formula has no physical
//! name; an effect of the catalogue that does the same takes its place.
//!
//! - [`chain_points`]: where a formula can act.
//! - [`atoms`]: functions of one covariate.
//! - [`harmonics`]: those of the rotor's turn in a residual.
//! - [`dictionary`]: their products, and their values.
//! - [`rows`]: a fitted model linearised, whitened and averaged.
//! - [`scan`]: scores and significance.
//! - [`candidate`]: terms at points of the chain, as columns and as text.
//! - [`search`]: the search from one model.
//! - [`discover`]: formulas next to the effects of a selection, or in their place.
//! - [`discovered`]: a formula that was found.
//! - [`simpler`]: formulas with fewer parameters than an accepted effect.

pub mod atoms;
pub mod candidate;
pub mod chain_points;
pub mod dictionary;
pub mod discover;
pub mod discovered;
pub mod harmonics;
pub mod rows;
pub mod scan;
pub mod search;
pub mod simpler;
