//! Names of things in maps. They are unique over all maps of one [`crate::Vslam`].

use std::fmt;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u32);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id! {
    /// Counts maps: a map that starts anew shares no frame with the one before.
    MapId
}
id! {
    /// Counts keyframes in the order in which they were made, over all maps.
    KeyframeId
}
id! {
    /// Counts map points in the order in which they were made, over all maps.
    PointId
}
