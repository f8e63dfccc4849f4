//! What a picture is drawn on.

/// Red, green, blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Color(pub [u8; 3]);

impl Color {
    pub const RED: Self = Self([214, 48, 39]);
    pub const BLUE: Self = Self([44, 104, 204]);
    pub const GREEN: Self = Self([30, 150, 70]);
    pub const PURPLE: Self = Self([135, 60, 170]);
    pub const GREY: Self = Self([120, 120, 120]);
    pub const BLACK: Self = Self([30, 30, 30]);
    pub const LIGHT: Self = Self([226, 226, 226]);
}

/// A rectangle in pixels, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
}

impl Frame {
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.left..=self.left + self.width).contains(&x)
            && (self.top..=self.top + self.height).contains(&y)
    }
}

/// Which end of a text its position names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// The height of capital letters is about 0.7 of this.
pub const TEXT_SIZE_PX: f64 = 15.0;

/// Something to draw on; positions are pixels, x to the right and y down.
pub trait Canvas {
    /// Draws a line through these positions, only inside `clip` if there is one.
    fn line(&mut self, points: &[[f64; 2]], color: Color, width_px: f64, clip: Option<&Frame>);

    fn dots(&mut self, points: &[[f64; 2]], color: Color, diameter_px: f64);

    /// Writes on the baseline through `at`.
    fn text(&mut self, at: [f64; 2], anchor: Anchor, text: &str);
}
