//! Markers for the kinds of frame. Which map or which vehicle is data and is checked at run time.

macro_rules! frame {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {}
    };
}

frame! {
    /// Earth-centred, Earth-fixed WGS84, metres.
    Ecef
}
frame! {
    /// East, north, up about a datum, metres; indoors the site frame of a motion-capture system.
    Enu
}
frame! {
    /// A vehicle's own monocular map. Its unit has no metric meaning.
    Map
}
frame! {
    /// Origin and axes of a keyframe's camera, unit of the map, frozen when the chunk is cut.
    Chunk
}
frame! {
    /// Forward, left, up on the vehicle, metres.
    Body
}
frame! {
    /// The optical frame: x right, y down, z forward.
    Camera
}
