//! The process on every vehicle, and the command line of `starling`.

pub mod background;
pub mod cli;
pub mod config;
pub mod dataset;
pub mod demo;
pub mod evaluate;
pub mod files;
pub mod link;
pub mod node;
pub mod plot;
pub mod position;
pub mod process;
pub mod recorder;
pub mod rendered;
pub mod station;
pub mod store;
pub mod swarm;
pub mod team;
#[cfg(test)]
mod test_support;
