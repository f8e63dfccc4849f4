//! The Stanford PLY format, text and binary.
//!
//! Vertices may carry `red green blue` and, as a list property `descriptor`, the 32 bytes of a
//! binary descriptor or the 128 of a gradient histogram. Everything else is skipped.

mod body;
mod header;

use std::fmt::Write;

use nalgebra::Vector3;
use registration::Descriptors;

use super::error::Refused;
use super::point_cloud::{PointCloud, typed_descriptors};
use body::{Body, Row};
use header::{Element, Header, PropertyKind};

pub use header::Encoding;

/// Reads a whole file.
pub(super) fn parse(bytes: &[u8]) -> Result<PointCloud, Refused> {
    let header = Header::parse(bytes)?;
    let mut body = Body::new(&header, bytes)?;
    for element in &header.elements {
        if element.properties.is_empty() {
            let reason = format!("element {:?} has no properties", element.name);
            return Err(Refused::whole(reason));
        }
        if element.name == "vertex" {
            return read_vertices(element, &mut body);
        }
        for element_idx in 0..element.count {
            body.read_row(element, element_idx, |row| skip_row(element, row))?;
        }
    }
    Err(Refused::whole("the header names no element `vertex`"))
}

fn skip_row(element: &Element, row: &mut Row<'_>) -> Result<(), String> {
    for property in &element.properties {
        match property.kind {
            PropertyKind::Scalar(scalar) => {
                row.value(scalar)?;
            }
            PropertyKind::List { count, item } => {
                for _ in 0..row.count(count)? {
                    row.value(item)?;
                }
            }
        }
    }
    Ok(())
}

/// What a property of a vertex means to us.
#[derive(Clone, Copy, PartialEq)]
enum Meaning {
    Position(usize),
    Color(usize),
    Descriptor,
    Skipped,
}

fn meaning(name: &str) -> Meaning {
    match name {
        "x" => Meaning::Position(0),
        "y" => Meaning::Position(1),
        "z" => Meaning::Position(2),
        "red" | "r" => Meaning::Color(0),
        "green" | "g" => Meaning::Color(1),
        "blue" | "b" => Meaning::Color(2),
        "descriptor" => Meaning::Descriptor,
        _ => Meaning::Skipped,
    }
}

/// One vertex as it is read, field by field.
#[derive(Default)]
struct Vertex {
    position: [f64; 3],
    color: [u8; 3],
    descriptor: Vec<u8>,
}

fn read_vertices(element: &Element, body: &mut Body<'_>) -> Result<PointCloud, Refused> {
    let meanings: Vec<Meaning> = element
        .properties
        .iter()
        .map(|property| meaning(&property.name))
        .collect();
    let has = |wanted: Meaning| meanings.contains(&wanted);
    if !(0..3).all(|axis| has(Meaning::Position(axis))) {
        return Err(Refused::whole("vertices have no x, y and z"));
    }
    let has_color = (0..3).all(|channel| has(Meaning::Color(channel)));
    let has_descriptor = has(Meaning::Descriptor);
    let mut points = Vec::new();
    let mut colors = Vec::new();
    let mut descriptors = Vec::new();
    let mut vertex = Vertex::default();
    for vertex_idx in 0..element.count {
        body.read_row(element, vertex_idx, |row| {
            read_vertex(element, &meanings, row, &mut vertex)
        })?;
        points.push(Vector3::from(vertex.position));
        if has_color {
            colors.push(vertex.color);
        }
        if has_descriptor {
            descriptors.push(std::mem::take(&mut vertex.descriptor));
        }
    }
    Ok(PointCloud {
        points,
        colors: has_color.then_some(colors),
        descriptors: typed_descriptors(descriptors)?,
    })
}

fn read_vertex(
    element: &Element,
    meanings: &[Meaning],
    row: &mut Row<'_>,
    vertex: &mut Vertex,
) -> Result<(), String> {
    for (property, meaning) in element.properties.iter().zip(meanings) {
        match (property.kind, *meaning) {
            (PropertyKind::Scalar(scalar), Meaning::Position(axis)) => {
                vertex.position[axis] = row.value(scalar)?;
            }
            (PropertyKind::Scalar(scalar), Meaning::Color(channel)) => {
                let value = row.value(scalar)?;
                // Floating colours run from zero to one.
                let value = if scalar.is_floating() {
                    value * 255.0
                } else {
                    value
                };
                vertex.color[channel] = value.round().clamp(0.0, 255.0) as u8;
            }
            (PropertyKind::Scalar(scalar), _) => {
                row.value(scalar)?;
            }
            (PropertyKind::List { count, item }, meaning) => {
                for _ in 0..row.count(count)? {
                    let value = row.value(item)?;
                    if meaning == Meaning::Descriptor {
                        vertex.descriptor.push(byte(value)?);
                    }
                }
            }
        }
    }
    Ok(())
}

fn byte(value: f64) -> Result<u8, String> {
    if value.fract() == 0.0 && (0.0..=255.0).contains(&value) {
        Ok(value as u8)
    } else {
        Err(format!("{value} in a descriptor, expected 0 to 255"))
    }
}

/// The whole file as bytes; coordinates as 32 bit floats.
pub(super) fn format(cloud: &PointCloud, encoding: Encoding) -> Vec<u8> {
    let mut file = format_header(cloud, encoding).into_bytes();
    for point_idx in 0..cloud.points.len() {
        let position = cloud.points[point_idx].map(|coordinate| coordinate as f32);
        let color = cloud.colors.as_ref().map(|colors| colors[point_idx]);
        let descriptor: Option<Vec<u8>> = match &cloud.descriptors {
            Descriptors::None => None,
            Descriptors::Binary(list) => Some(list[point_idx].to_bytes().to_vec()),
            Descriptors::Histogram(list) => Some(list[point_idx].to_vec()),
        };
        let bytes = color.iter().flatten().copied();
        let list = descriptor
            .iter()
            .flat_map(|bytes| std::iter::once(bytes.len() as u8).chain(bytes.iter().copied()));
        match encoding {
            Encoding::Ascii => {
                let mut line = format!("{} {} {}", position.x, position.y, position.z);
                for byte in bytes.chain(list) {
                    write!(line, " {byte}").expect("writing to a string does not fail");
                }
                line.push('\n');
                file.extend_from_slice(line.as_bytes());
            }
            Encoding::BinaryLittleEndian => {
                for coordinate in position.iter() {
                    file.extend_from_slice(&coordinate.to_le_bytes());
                }
                file.extend(bytes.chain(list));
            }
            Encoding::BinaryBigEndian => {
                for coordinate in position.iter() {
                    file.extend_from_slice(&coordinate.to_be_bytes());
                }
                file.extend(bytes.chain(list));
            }
        }
    }
    file
}

fn format_header(cloud: &PointCloud, encoding: Encoding) -> String {
    let mut header = format!(
        "ply\nformat {} 1.0\nelement vertex {}\n",
        encoding.name(),
        cloud.points.len()
    );
    for axis in ["x", "y", "z"] {
        header += &format!("property float {axis}\n");
    }
    if cloud.colors.is_some() {
        for channel in ["red", "green", "blue"] {
            header += &format!("property uchar {channel}\n");
        }
    }
    if !matches!(cloud.descriptors, Descriptors::None) {
        header += "property list uchar uchar descriptor\n";
    }
    header + "end_header\n"
}
