//! Marker vision on seeded pictures, and on pictures that are none.

mod finder;
mod hostile;
mod matrix;
mod paper;
mod runs;
