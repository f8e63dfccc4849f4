//! A rectangle with a grid, and where values lie in it.

use super::axis::Range;
use super::canvas::{Anchor, Canvas, Color, Frame};

/// What stretch of each coordinate a rectangle shows.
pub struct Axes {
    pub frame: Frame,
    pub across: Range,
    pub upward: Range,
}

/// From one tick to the next, about.
const TICK_ACROSS_PX: f64 = 110.0;
const TICK_UPWARD_PX: f64 = 50.0;

impl Axes {
    pub fn place(&self, [across, upward]: [f64; 2]) -> [f64; 2] {
        [
            self.frame.left + (across - self.across.start) / self.across.span() * self.frame.width,
            self.frame.top + (self.upward.end - upward) / self.upward.span() * self.frame.height,
        ]
    }

    /// Draws the grid with its values, the border, and the label of the axis across.
    pub fn draw(&self, across_label: &str, canvas: &mut impl Canvas) {
        let Frame {
            left,
            top,
            width,
            height,
        } = self.frame;
        let (right, bottom) = (left + width, top + height);
        let (ticks, decimals) = self.across.ticks(width / TICK_ACROSS_PX);
        for tick in ticks {
            let [x, _] = self.place([tick, self.upward.start]);
            canvas.line(&[[x, top], [x, bottom]], Color::LIGHT, 1.0, None);
            let text = format!("{:.decimals$}", without_negative_zero(tick));
            canvas.text([x, bottom + 18.0], Anchor::Middle, &text);
        }
        let (ticks, decimals) = self.upward.ticks(height / TICK_UPWARD_PX);
        for tick in ticks {
            let [_, y] = self.place([self.across.start, tick]);
            canvas.line(&[[left, y], [right, y]], Color::LIGHT, 1.0, None);
            let text = format!("{:.decimals$}", without_negative_zero(tick));
            canvas.text([left - 8.0, y + 5.0], Anchor::End, &text);
        }
        let corners = [
            [left, top],
            [right, top],
            [right, bottom],
            [left, bottom],
            [left, top],
        ];
        canvas.line(&corners, Color::GREY, 1.0, None);
        canvas.text([right, bottom + 38.0], Anchor::End, across_label);
    }
}

fn without_negative_zero(value: f64) -> f64 {
    value + 0.0
}
