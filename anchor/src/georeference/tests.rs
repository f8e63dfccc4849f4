//! Tests of the georeference.
