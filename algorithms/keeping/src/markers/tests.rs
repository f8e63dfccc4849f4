//! The matrix of light conditions, on seeded pictures, for both pipelines.

mod matrix;
