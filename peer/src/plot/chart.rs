//! Values over time, panel below panel.

use super::Picture;
use super::axes::Axes;
use super::axis::Range;
use super::canvas::{Anchor, Canvas, Color, Frame};
use super::font;

/// A picture of panels that share nothing but their width.
#[derive(Clone, Debug)]
pub struct Chart {
    pub title: String,
    pub panels: Vec<ChartPanel>,
}

#[derive(Clone, Debug)]
pub struct ChartPanel {
    /// The quantity upward and its unit, such as `Distance [m]`.
    pub title: String,
    /// The same across, such as `time [s]`.
    pub across_label: String,
    /// Later curves lie over earlier ones.
    pub curves: Vec<Curve>,
}

#[derive(Clone, Debug)]
pub struct Curve {
    /// Stands in the legend, unless it is empty.
    pub name: String,
    pub color: Color,
    pub width_px: f64,
    /// Across and upward. The line is broken where a value is not finite.
    pub points: Vec<[f64; 2]>,
}

const WIDTH_PX: f64 = 1100.0;
const MARGIN_LEFT_PX: f64 = 80.0;
const MARGIN_RIGHT_PX: f64 = 30.0;
const TITLE_HEIGHT_PX: f64 = 44.0;
const PANEL_TITLE_PX: f64 = 30.0;
const PANEL_HEIGHT_PX: f64 = 300.0;
const AXIS_HEIGHT_PX: f64 = 60.0;
/// Before a name of the legend, for the sample of its line, and after it.
const LEGEND_SAMPLE_PX: f64 = 32.0;
const LEGEND_GAP_PX: f64 = 16.0;
const PADDING_SHARE: f64 = 0.04;

impl Picture for Chart {
    fn draw(&self, canvas: &mut impl Canvas) -> [f64; 2] {
        canvas.text([MARGIN_LEFT_PX, 26.0], Anchor::Start, &self.title);
        let mut top = TITLE_HEIGHT_PX;
        for panel in &self.panels {
            let frame = Frame {
                left: MARGIN_LEFT_PX,
                top: top + PANEL_TITLE_PX,
                width: WIDTH_PX - MARGIN_LEFT_PX - MARGIN_RIGHT_PX,
                height: PANEL_HEIGHT_PX,
            };
            panel.draw(frame, canvas);
            top = frame.top + frame.height + AXIS_HEIGHT_PX;
        }
        [WIDTH_PX, top]
    }
}

impl ChartPanel {
    fn draw(&self, frame: Frame, canvas: &mut impl Canvas) {
        let title_at = [frame.left, frame.top - 9.0];
        canvas.text(title_at, Anchor::Start, &self.title);
        self.draw_legend(&frame, canvas);
        let axes = Axes {
            frame,
            across: self.range(0, 0.0),
            upward: self.range(1, PADDING_SHARE),
        };
        axes.draw(&self.across_label, canvas);
        for curve in &self.curves {
            let is_finite = |point: &[f64; 2]| point.iter().all(|value| value.is_finite());
            for piece in curve.points.split(|point| !is_finite(point)) {
                let line: Vec<[f64; 2]> = piece.iter().map(|point| axes.place(*point)).collect();
                canvas.line(&line, curve.color, curve.width_px, Some(&axes.frame));
            }
        }
    }

    /// From the right border leftward, on the line of the title.
    fn draw_legend(&self, frame: &Frame, canvas: &mut impl Canvas) {
        let mut left = frame.left + frame.width;
        let y = frame.top - 14.0;
        let is_named = |curve: &&Curve| !curve.name.is_empty();
        for curve in self.curves.iter().rev().filter(is_named) {
            left -= LEGEND_SAMPLE_PX + font::width_px(&curve.name);
            canvas.line(&[[left, y], [left + 24.0, y]], curve.color, 2.5, None);
            let text_at = [left + LEGEND_SAMPLE_PX, y + 5.0];
            canvas.text(text_at, Anchor::Start, &curve.name);
            left -= LEGEND_GAP_PX;
        }
    }

    fn range(&self, axis: usize, padding_share: f64) -> Range {
        let values = self.curves.iter().flat_map(|curve| &curve.points);
        Range::of(values.map(|point| point[axis]), 0.0)
            .map(|range| range.widened_to(range.span() * (1.0 + 2.0 * padding_share)))
            .unwrap_or(Range {
                start: 0.0,
                end: 0.0,
            })
            .widened_to(1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_names_its_axes_and_breaks_lines_at_gaps() {
        let chart = Chart {
            title: "Distances".to_owned(),
            panels: vec![ChartPanel {
                title: "one run: distance [m]".to_owned(),
                across_label: "time [s]".to_owned(),
                curves: vec![Curve {
                    name: "drones 1-2".to_owned(),
                    color: Color::BLUE,
                    width_px: 1.5,
                    points: vec![
                        [0.0, 1.0],
                        [1.0, 2.0],
                        [2.0, f64::NAN],
                        [3.0, 2.0],
                        [4.0, 1.0],
                    ],
                }],
            }],
        };
        let svg = chart.to_svg();
        for expected in [
            "time [s]",
            "distance [m]",
            "drones 1-2",
            "Distances",
            "one run",
        ] {
            assert!(svg.contains(expected), "{expected} is missing");
        }
        assert!(!svg.contains("NaN"));
        // Two pieces and the sample in the legend.
        assert_eq!(svg.matches("#2c68cc").count(), 3);
        assert!(chart.to_png().starts_with(b"\x89PNG"));
    }

    #[test]
    fn names_of_a_legend_do_not_lie_over_each_other() {
        let names = ["short", "a name that is rather long", "other"];
        let curve = |name: &str| Curve {
            name: name.to_owned(),
            color: Color::BLUE,
            width_px: 1.5,
            points: vec![[0.0, 1.0], [1.0, 2.0]],
        };
        let chart = Chart {
            title: String::new(),
            panels: vec![ChartPanel {
                title: String::new(),
                across_label: String::new(),
                curves: names.map(curve).into(),
            }],
        };
        let svg = chart.to_svg();
        let left_px = |name: &str| -> f64 {
            let text = svg.lines().find(|line| line.contains(name)).unwrap();
            text.split('"').nth(1).unwrap().parse().unwrap()
        };
        for pair in names.windows(2) {
            let end_px = left_px(pair[0]) + font::width_px(pair[0]);
            assert!(end_px < left_px(pair[1]), "{pair:?}");
        }
        assert!(left_px("other") + font::width_px("other") < WIDTH_PX);
    }

    #[test]
    fn a_chart_without_values_is_drawn_empty() {
        let panel = ChartPanel {
            title: String::new(),
            across_label: String::new(),
            curves: Vec::new(),
        };
        let chart = Chart {
            title: String::new(),
            panels: vec![panel],
        };
        assert!(!chart.to_svg().contains("NaN"));
    }
}
