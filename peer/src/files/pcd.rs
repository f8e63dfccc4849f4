//! The PCD format of the Point Cloud Library, text and binary.

use nalgebra::Vector3;

use super::error::Refused;
use super::point_cloud::PointCloud;

/// One column group of the rows.
struct Field {
    name: String,
    size_bytes: usize,
    kind: u8,
    count: usize,
}

#[derive(Default)]
struct Header {
    fields: Vec<Field>,
    point_count: usize,
    is_text: bool,
    size_bytes: usize,
    line_count: usize,
}

/// Reads a whole file; `binary_compressed` is refused by name.
pub(super) fn parse(bytes: &[u8]) -> Result<PointCloud, Refused> {
    let header = parse_header(bytes)?;
    let columns = Columns::find(&header.fields)
        .ok_or_else(|| Refused::whole("the header names no fields x, y and z"))?;
    let body = &bytes[header.size_bytes..];
    let mut cloud = PointCloud::from_points(Vec::new());
    let mut colors = Vec::new();
    let mut push = |values: &[Value]| {
        cloud.points.push(Vector3::from(
            columns.axes.map(|column| values[column].number()),
        ));
        if let Some(column) = columns.color {
            colors.push(values[column].packed_color());
        }
    };
    if header.is_text {
        read_text(&header, body, &mut push)?;
    } else {
        read_binary(&header, body, &mut push)?;
    }
    cloud.colors = columns.color.map(|_| colors);
    Ok(cloud)
}

fn parse_header(bytes: &[u8]) -> Result<Header, Refused> {
    let mut header = Header::default();
    let (mut sizes, mut kinds, mut counts) = (Vec::new(), Vec::new(), None);
    let mut names: Vec<String> = Vec::new();
    for (line_idx, raw) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
        header.size_bytes += raw.len();
        let line = String::from_utf8_lossy(raw);
        let refused = |reason: String| Refused::at(line_idx + 1, reason);
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["FIELDS" | "COLUMNS", words @ ..] => {
                names = words.iter().map(|word| (*word).to_owned()).collect();
            }
            ["SIZE", words @ ..] => sizes = parse_numbers(words).map_err(refused)?,
            ["TYPE", words @ ..] => kinds = words.iter().map(|word| word.as_bytes()[0]).collect(),
            ["COUNT", words @ ..] => counts = Some(parse_numbers(words).map_err(refused)?),
            ["POINTS", count] => header.point_count = parse_numbers(&[count]).map_err(refused)?[0],
            ["DATA", encoding] => {
                header.is_text = match *encoding {
                    "ascii" => true,
                    "binary" => false,
                    _ => return Err(refused(format!("DATA {encoding} is not supported"))),
                };
                header.line_count = line_idx + 1;
                let counts = counts.unwrap_or_else(|| vec![1; names.len()]);
                header.fields = join_fields(names, &sizes, &kinds, &counts).map_err(refused)?;
                return Ok(header);
            }
            [] | ["VERSION" | "WIDTH" | "HEIGHT" | "VIEWPOINT", ..] => {}
            [word, ..] if word.starts_with('#') => {}
            _ => return Err(refused(format!("unknown header line {:?}", line.trim()))),
        }
    }
    Err(Refused::whole("truncated: the header has no line DATA"))
}

fn parse_numbers(words: &[&str]) -> Result<Vec<usize>, String> {
    let parse = |word: &&str| word.parse().map_err(|_| format!("{word:?} is no count"));
    words.iter().map(parse).collect()
}

fn join_fields(
    names: Vec<String>,
    sizes: &[usize],
    kinds: &[u8],
    counts: &[usize],
) -> Result<Vec<Field>, String> {
    if [sizes.len(), kinds.len(), counts.len()] != [names.len(); 3] {
        return Err(format!(
            "{} FIELDS, {} SIZE, {} TYPE, {} COUNT do not agree",
            names.len(),
            sizes.len(),
            kinds.len(),
            counts.len()
        ));
    }
    let mut fields = Vec::new();
    for (idx, name) in names.into_iter().enumerate() {
        let (size_bytes, kind, count) = (sizes[idx], kinds[idx], counts[idx]);
        let is_known = match kind {
            b'F' => matches!(size_bytes, 4 | 8),
            b'I' | b'U' => matches!(size_bytes, 1 | 2 | 4 | 8),
            _ => false,
        };
        if !is_known || count > 4096 {
            let kind = char::from(kind);
            return Err(format!(
                "field {name}: {count} of TYPE {kind} SIZE {size_bytes}"
            ));
        }
        fields.push(Field {
            name,
            size_bytes,
            kind,
            count,
        });
    }
    Ok(fields)
}

/// Which numbers of a row we want, counted over all fields.
struct Columns {
    axes: [usize; 3],
    color: Option<usize>,
}

impl Columns {
    fn find(fields: &[Field]) -> Option<Self> {
        let find = |name: &str| {
            let idx = fields.iter().position(|field| field.name == name)?;
            (fields[idx].count > 0)
                .then(|| fields[..idx].iter().map(|field| field.count).sum::<usize>())
        };
        Some(Self {
            axes: [find("x")?, find("y")?, find("z")?],
            color: find("rgb").or_else(|| find("rgba")),
        })
    }
}

/// A number as it was stored: packed colours are integers that may be stored as a float.
#[derive(Clone, Copy)]
enum Value {
    Float(f64),
    Integer(i64),
}

impl Value {
    fn number(self) -> f64 {
        match self {
            Self::Float(value) => value,
            Self::Integer(value) => value as f64,
        }
    }

    fn packed_color(self) -> [u8; 3] {
        let bits = match self {
            Self::Float(value) => (value as f32).to_bits(),
            Self::Integer(value) => value as u32,
        };
        let [_, red, green, blue] = bits.to_be_bytes();
        [red, green, blue]
    }
}

fn read_text(header: &Header, body: &[u8], push: &mut impl FnMut(&[Value])) -> Result<(), Refused> {
    let text = std::str::from_utf8(body).map_err(|_| Refused::whole("the text is not UTF-8"))?;
    let kinds: Vec<u8> = header
        .fields
        .iter()
        .flat_map(|field| std::iter::repeat_n(field.kind, field.count))
        .collect();
    let mut values = Vec::with_capacity(kinds.len());
    let mut lines = text.lines().enumerate();
    for point_idx in 0..header.point_count {
        let position = || format!("point {point_idx} of {}", header.point_count);
        let (line_idx, line) = lines
            .by_ref()
            .find(|(_, line)| !line.trim().is_empty())
            .ok_or_else(|| Refused::whole(format!("truncated before {}", position())))?;
        let line_number = header.line_count + line_idx + 1;
        values.clear();
        for (word, kind) in line.split_whitespace().zip(&kinds) {
            let value = match kind {
                b'F' => word.parse().ok().map(Value::Float),
                _ => word.parse().ok().map(Value::Integer),
            };
            values.push(value.ok_or_else(|| {
                Refused::at(
                    line_number,
                    format!("{}: {word:?} is no number", position()),
                )
            })?);
        }
        if values.len() != kinds.len() {
            let reason = format!(
                "{}: truncated: {} numbers, expected {}",
                position(),
                values.len(),
                kinds.len()
            );
            return Err(Refused::at(line_number, reason));
        }
        push(&values);
    }
    Ok(())
}

fn read_binary(
    header: &Header,
    body: &[u8],
    push: &mut impl FnMut(&[Value]),
) -> Result<(), Refused> {
    let row_size_bytes: usize = header
        .fields
        .iter()
        .map(|field| field.size_bytes * field.count)
        .sum();
    let whole_count = body.len() / row_size_bytes.max(1);
    if whole_count < header.point_count {
        return Err(Refused::whole(format!(
            "truncated: {whole_count} of {} points",
            header.point_count
        )));
    }
    let mut values = Vec::new();
    for row in body.chunks_exact(row_size_bytes).take(header.point_count) {
        values.clear();
        let mut rest = row;
        for field in &header.fields {
            for _ in 0..field.count {
                let (raw, after) = rest.split_at(field.size_bytes);
                values.push(decode(field.kind, raw));
                rest = after;
            }
        }
        push(&values);
    }
    Ok(())
}

fn decode(kind: u8, raw: &[u8]) -> Value {
    let mut little = [0; 8];
    little[..raw.len()].copy_from_slice(raw);
    let bits = u64::from_le_bytes(little);
    match (kind, raw.len()) {
        (b'F', 4) => Value::Float(f64::from(f32::from_bits(bits as u32))),
        (b'F', _) => Value::Float(f64::from_bits(bits)),
        (b'I', 1) => Value::Integer(i64::from(bits as i8)),
        (b'I', 2) => Value::Integer(i64::from(bits as i16)),
        (b'I', 4) => Value::Integer(i64::from(bits as i32)),
        _ => Value::Integer(bits as i64),
    }
}

/// The whole file as bytes, binary; colours packed as PCL packs them.
pub(super) fn format(cloud: &PointCloud) -> Vec<u8> {
    let (fields, sizes, kinds, counts) = match cloud.colors {
        Some(_) => ("x y z rgb", "4 4 4 4", "F F F U", "1 1 1 1"),
        None => ("x y z", "4 4 4", "F F F", "1 1 1"),
    };
    let count = cloud.points.len();
    let mut file = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\n\
         TYPE {kinds}\nCOUNT {counts}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\nDATA binary\n"
    )
    .into_bytes();
    for (point_idx, point) in cloud.points.iter().enumerate() {
        for coordinate in point.iter() {
            file.extend_from_slice(&(*coordinate as f32).to_le_bytes());
        }
        if let Some(colors) = &cloud.colors {
            let [red, green, blue] = colors[point_idx];
            file.extend_from_slice(&[blue, green, red, 0]);
        }
    }
    file
}
