//! Pictures as SVG text.

use std::fmt::Write;

use super::canvas::{Anchor, Canvas, Color, Frame, TEXT_SIZE_PX};

/// The elements so far.
#[derive(Default)]
pub struct SvgCanvas {
    elements: String,
    clip_count: usize,
}

impl SvgCanvas {
    /// The whole file.
    pub fn finish(self, [width, height]: [f64; 2]) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
             font-size=\"{TEXT_SIZE_PX}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n{}</svg>\n",
            self.elements
        )
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        writeln!(self.elements, "{element}").expect("writing to a string does not fail");
    }
}

impl Canvas for SvgCanvas {
    fn line(&mut self, points: &[[f64; 2]], color: Color, width_px: f64, clip: Option<&Frame>) {
        if points.is_empty() {
            return;
        }
        let mut clip_attribute = String::new();
        if let Some(frame) = clip {
            let Frame {
                left,
                top,
                width,
                height,
            } = frame;
            let id = self.clip_count;
            self.clip_count += 1;
            self.push(format_args!(
                "<clipPath id=\"c{id}\"><rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" \
                 height=\"{height:.1}\"/></clipPath>"
            ));
            clip_attribute = format!(" clip-path=\"url(#c{id})\"");
        }
        let path: Vec<String> = points
            .iter()
            .map(|[x, y]| format!("{x:.1},{y:.1}"))
            .collect();
        self.push(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width_px}\" \
             stroke-linejoin=\"round\"{clip_attribute}/>",
            path.join(" "),
            hex(color)
        ));
    }

    fn dots(&mut self, points: &[[f64; 2]], color: Color, diameter_px: f64) {
        if points.is_empty() {
            return;
        }
        // Strokes of no length with round ends: a fifth of the bytes of as many circles.
        let path: String = points
            .iter()
            .map(|[x, y]| format!("M{x:.1} {y:.1}h0"))
            .collect();
        self.push(format_args!(
            "<path d=\"{path}\" stroke=\"{}\" stroke-width=\"{diameter_px}\" \
             stroke-linecap=\"round\" stroke-opacity=\"0.7\"/>",
            hex(color)
        ));
    }

    fn text(&mut self, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escape(text);
        self.push(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" fill=\"{}\">{text}</text>",
            hex(Color::BLACK)
        ));
    }
}

fn hex(Color([red, green, blue]): Color) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
