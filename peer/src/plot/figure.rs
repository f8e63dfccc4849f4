//! Where everything of a picture goes.

use nalgebra::Vector3;

use super::axes::Axes;
use super::axis::Range;
use super::canvas::{Anchor, Canvas, Frame};
use super::{Layer, Mark, Plot};

const WIDTH_PX: f64 = 1100.0;
const MARGIN_LEFT_PX: f64 = 80.0;
const MARGIN_RIGHT_PX: f64 = 30.0;
const TITLE_HEIGHT_PX: f64 = 40.0;
const LEGEND_ROW_PX: f64 = 24.0;
const LEGEND_COLUMNS: usize = 3;
const AXIS_HEIGHT_PX: f64 = 56.0;
const PANEL_TITLE_PX: f64 = 26.0;
const PANEL_HEIGHT_MAX_PX: f64 = 620.0;
const PANEL_HEIGHT_MIN_PX: f64 = 110.0;
/// More dots of one layer hide each other.
const DOT_COUNT_MAX: usize = 8000;
/// Far outliers of clouds do not set the range.
const SHARE_LEFT_OUT: f64 = 0.005;
const PADDING_SHARE: f64 = 0.04;

/// Draws the picture and gives its width and height in pixels.
pub fn draw(plot: &Plot, canvas: &mut impl Canvas) -> [f64; 2] {
    let ranges = [0, 1, 2].map(|axis| range_of(&plot.layers, axis));
    let panel_width = WIDTH_PX - MARGIN_LEFT_PX - MARGIN_RIGHT_PX;
    // Both views share the scale, so that a metre is a metre everywhere.
    let px_per_m = (panel_width / ranges[0].span())
        .min(PANEL_HEIGHT_MAX_PX / ranges[1].span())
        .min(PANEL_HEIGHT_MAX_PX / ranges[2].span());
    let across = ranges[0].widened_to(panel_width / px_per_m);

    canvas.text([MARGIN_LEFT_PX, 26.0], Anchor::Start, &plot.title);
    let mut top = TITLE_HEIGHT_PX + draw_legend(&plot.layers, canvas);
    for (name, axis, label) in [("from above", 1, "y [m]"), ("from the side", 2, "z [m]")] {
        let upward = ranges[axis].widened_to(PANEL_HEIGHT_MIN_PX / px_per_m);
        let frame = Frame {
            left: MARGIN_LEFT_PX,
            top: top + PANEL_TITLE_PX,
            width: panel_width,
            height: upward.span() * px_per_m,
        };
        canvas.text([frame.left, frame.top - 8.0], Anchor::Start, name);
        canvas.text([frame.left - 8.0, frame.top - 8.0], Anchor::End, label);
        let axes = Axes {
            frame,
            across,
            upward,
        };
        axes.draw("x [m]", canvas);
        for layer in &plot.layers {
            draw_layer(layer, axis, &axes, canvas);
        }
        top = frame.top + frame.height + AXIS_HEIGHT_PX;
    }
    [WIDTH_PX, top]
}

/// What every view must hold of one coordinate.
fn range_of(layers: &[Layer], axis: usize) -> Range {
    layers
        .iter()
        .filter_map(|layer| {
            let left_out = match layer.mark {
                Mark::Dots | Mark::LargeDots => SHARE_LEFT_OUT,
                Mark::Line => 0.0,
            };
            Range::of(layer.points.iter().map(|point| point[axis]), left_out)
        })
        .reduce(|left, right| left.united(&right))
        .map(|range| range.widened_to(range.span() * (1.0 + 2.0 * PADDING_SHARE)))
        .filter(|range| range.span().is_finite())
        .unwrap_or(Range {
            start: 0.0,
            end: 0.0,
        })
        .widened_to(1e-3)
}

/// Names what has a name, row by row, and gives the height of the rows.
fn draw_legend(layers: &[Layer], canvas: &mut impl Canvas) -> f64 {
    let column_width = (WIDTH_PX - MARGIN_LEFT_PX) / LEGEND_COLUMNS as f64;
    let named: Vec<&Layer> = layers
        .iter()
        .filter(|layer| !layer.name.is_empty())
        .collect();
    for (layer_idx, layer) in named.iter().enumerate() {
        let left = MARGIN_LEFT_PX + (layer_idx % LEGEND_COLUMNS) as f64 * column_width;
        let y = TITLE_HEIGHT_PX + 12.0 + (layer_idx / LEGEND_COLUMNS) as f64 * LEGEND_ROW_PX;
        match layer.mark {
            Mark::Line => canvas.line(&[[left, y], [left + 24.0, y]], layer.color, 2.5, None),
            Mark::Dots | Mark::LargeDots => {
                let dots = [4.0, 12.0, 20.0].map(|offset| [left + offset, y]);
                canvas.dots(&dots, layer.color, 5.0);
            }
        }
        canvas.text([left + 32.0, y + 5.0], Anchor::Start, &layer.name);
    }
    named.len().div_ceil(LEGEND_COLUMNS) as f64 * LEGEND_ROW_PX
}

/// Draws a layer as one view shows it.
///
/// - `axis`: which coordinate is upward.
fn draw_layer(layer: &Layer, axis: usize, axes: &Axes, canvas: &mut impl Canvas) {
    let place = |point: &Vector3<f64>| axes.place([point.x, point[axis]]);
    let is_finite = |point: &&Vector3<f64>| point.iter().all(|value| value.is_finite());
    match layer.mark {
        Mark::Dots | Mark::LargeDots => {
            let stride = layer.points.len().div_ceil(DOT_COUNT_MAX).max(1);
            let dots: Vec<[f64; 2]> = layer
                .points
                .iter()
                .step_by(stride)
                .filter(is_finite)
                .map(place)
                .filter(|dot| axes.frame.contains(*dot))
                .collect();
            let diameter_px = if layer.mark == Mark::Dots { 2.0 } else { 4.0 };
            canvas.dots(&dots, layer.color, diameter_px);
        }
        Mark::Line => {
            let line: Vec<[f64; 2]> = layer.points.iter().filter(is_finite).map(place).collect();
            canvas.line(&line, layer.color, 1.8, Some(&axes.frame));
        }
    }
}
