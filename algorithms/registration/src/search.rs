//! A start where none is known.

use geometry::Similarity;

use crate::cloud::ShapedCloud;
use crate::register::{Refusal, RegisterSettings, Source, Target};

/// An alignment of the centred clouds, near enough for the iteration.
pub(crate) fn find(
    _source: &ShapedCloud,
    _target: &ShapedCloud,
    _settings: &RegisterSettings,
) -> Result<Similarity<Target, Source>, Refusal> {
    Err(Refusal::SearchFoundNothing)
}
