//! The header: which elements follow, and how their properties are stored.

use crate::files::error::Refused;

/// How the rows after the header are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    BinaryLittleEndian,
    BinaryBigEndian,
}

impl Encoding {
    pub fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::BinaryLittleEndian => "binary_little_endian",
            Self::BinaryBigEndian => "binary_big_endian",
        }
    }
}

/// A stored number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    Int8,
    Uint8,
    Int16,
    Uint16,
    Int32,
    Uint32,
    Float32,
    Float64,
}

impl Scalar {
    fn parse(name: &str) -> Result<Self, String> {
        Ok(match name {
            "char" | "int8" => Self::Int8,
            "uchar" | "uint8" => Self::Uint8,
            "short" | "int16" => Self::Int16,
            "ushort" | "uint16" => Self::Uint16,
            "int" | "int32" => Self::Int32,
            "uint" | "uint32" => Self::Uint32,
            "float" | "float32" => Self::Float32,
            "double" | "float64" => Self::Float64,
            _ => return Err(format!("unknown type {name:?}")),
        })
    }

    pub fn size_bytes(self) -> usize {
        match self {
            Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }

    pub fn is_floating(self) -> bool {
        matches!(self, Self::Float32 | Self::Float64)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PropertyKind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    pub name: String,
    pub kind: PropertyKind,
}

/// A table: so many rows with these properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    pub size_bytes: usize,
    pub line_count: usize,
}

/// A header longer than this is none.
const LINE_COUNT_MAX: usize = 10_000;

impl Header {
    pub fn parse(bytes: &[u8]) -> Result<Self, Refused> {
        if !bytes.starts_with(b"ply") {
            return Err(Refused::at(
                1,
                "not a PLY file: it does not begin with `ply`",
            ));
        }
        let mut encoding = None;
        let mut elements = Vec::new();
        let mut size_bytes = 0;
        for (line_idx, raw) in bytes
            .split_inclusive(|byte| *byte == b'\n')
            .take(LINE_COUNT_MAX)
            .enumerate()
        {
            size_bytes += raw.len();
            let line = String::from_utf8_lossy(raw);
            let refused = |reason| Refused::at(line_idx + 1, reason);
            let words: Vec<&str> = line.split_whitespace().collect();
            match words.as_slice() {
                ["format", name, _version] => {
                    encoding = Some(parse_encoding(name).map_err(refused)?);
                }
                ["end_header"] => {
                    return Ok(Self {
                        encoding: encoding.ok_or_else(|| refused("no line `format`".into()))?,
                        elements,
                        size_bytes,
                        line_count: line_idx + 1,
                    });
                }
                ["element", name, count] => elements.push(Element {
                    name: (*name).to_owned(),
                    count: count
                        .parse()
                        .map_err(|_| refused(format!("{count:?} is no number of elements")))?,
                    properties: Vec::new(),
                }),
                ["property", words @ ..] => elements
                    .last_mut()
                    .ok_or_else(|| refused("a property before any element".into()))?
                    .properties
                    .push(parse_property(words).map_err(refused)?),
                [] | ["ply" | "comment" | "obj_info", ..] => {}
                _ => return Err(refused(format!("unknown header line {:?}", line.trim()))),
            }
        }
        Err(Refused::whole("truncated: the header has no end"))
    }
}

fn parse_encoding(name: &str) -> Result<Encoding, String> {
    [
        Encoding::Ascii,
        Encoding::BinaryLittleEndian,
        Encoding::BinaryBigEndian,
    ]
    .into_iter()
    .find(|encoding| encoding.name() == name)
    .ok_or_else(|| format!("unknown format {name:?}"))
}

fn parse_property(words: &[&str]) -> Result<Property, String> {
    let (name, kind) = match *words {
        ["list", count, item, name] => {
            let (count, item) = (Scalar::parse(count)?, Scalar::parse(item)?);
            if count.is_floating() {
                return Err("a list's length is no floating number".to_owned());
            }
            (name, PropertyKind::List { count, item })
        }
        [scalar, name] => (name, PropertyKind::Scalar(Scalar::parse(scalar)?)),
        _ => return Err(format!("unknown property {:?}", words.join(" "))),
    };
    Ok(Property {
        name: name.to_owned(),
        kind,
    })
}
