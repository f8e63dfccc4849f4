//! Pairs of marker lights in an image.
