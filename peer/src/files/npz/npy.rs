//! One array of NumPy: a line that describes it, then its numbers.

const MAGIC: &[u8] = b"\x93NUMPY";

/// Numbers of up to two dimensions.
pub struct Array {
    shape: Vec<usize>,
    by_columns: bool,
    scalar: Scalar,
    big_endian: bool,
    bytes: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    Int(usize),
    Uint(usize),
    Float(usize),
}

impl Scalar {
    fn size_bytes(self) -> usize {
        match self {
            Self::Int(size) | Self::Uint(size) | Self::Float(size) => size,
        }
    }
}

impl Array {
    /// `None` if it holds no numbers: text, flags, records, objects.
    pub fn parse(bytes: &[u8]) -> Result<Option<Self>, String> {
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or("no NPY array: it does not begin with `\\x93NUMPY`")?;
        let [major, _minor, sizes @ ..] = rest else {
            return Err("truncated".to_owned());
        };
        let (size_size, size) = match (major, sizes) {
            (1, [a, b, ..]) => (2, u32::from_le_bytes([*a, *b, 0, 0])),
            (2 | 3, [a, b, c, d, ..]) => (4, u32::from_le_bytes([*a, *b, *c, *d])),
            (1..=3, _) => return Err("truncated".to_owned()),
            _ => return Err(format!("version {major} of the format is not supported")),
        };
        let header = sizes
            .get(size_size..size_size + size as usize)
            .ok_or("truncated")?;
        let header = String::from_utf8_lossy(header);
        let body = &sizes[size_size + size as usize..];
        let kind = quoted(&header, "'descr':");
        let Some((big_endian, scalar)) = kind.and_then(parse_kind) else {
            return Ok(None);
        };
        let shape = parse_shape(&header).ok_or_else(|| format!("no shape in {header:?}"))?;
        let count = shape.iter().try_fold(1_usize, |a, b| a.checked_mul(*b));
        let expected = count.and_then(|count| count.checked_mul(scalar.size_bytes()));
        if expected != Some(body.len()) {
            let size = body.len();
            return Err(format!("{size} bytes for shape {shape:?}: truncated"));
        }
        Ok(Some(Self {
            shape,
            by_columns: after(&header, "'fortran_order':")
                .is_some_and(|rest| rest.trim_start().starts_with("True")),
            scalar,
            big_endian,
            bytes: body.to_vec(),
        }))
    }

    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    pub fn row_count(&self) -> usize {
        self.shape.first().copied().unwrap_or(1)
    }

    /// `None` unless there are two dimensions.
    pub fn column_count(&self) -> Option<usize> {
        match self.shape.as_slice() {
            [_, columns] => Some(*columns),
            _ => None,
        }
    }

    pub fn has_shape(&self, row_count: usize, column_count: usize) -> bool {
        self.shape == [row_count, column_count]
    }

    pub fn is_floating(&self) -> bool {
        matches!(self.scalar, Scalar::Float(_))
    }

    pub fn is_bytes(&self) -> bool {
        self.scalar == Scalar::Uint(1)
    }

    /// The number at a place that is there.
    pub fn value(&self, row: usize, column: usize) -> f64 {
        let (row_count, column_count) = (self.row_count(), self.column_count().unwrap_or(1));
        let idx = if self.by_columns {
            column * row_count + row
        } else {
            row * column_count + column
        };
        let size = self.scalar.size_bytes();
        let mut little = [0; 8];
        little[..size].copy_from_slice(&self.bytes[idx * size..(idx + 1) * size]);
        if self.big_endian {
            little[..size].reverse();
        }
        let bits = u64::from_le_bytes(little);
        match self.scalar {
            Scalar::Float(4) => f64::from(f32::from_bits(bits as u32)),
            Scalar::Float(_) => f64::from_bits(bits),
            Scalar::Uint(_) => bits as f64,
            Scalar::Int(size) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
        }
    }
}

/// `<f4`: byte order, kind, size in bytes.
fn parse_kind(text: &str) -> Option<(bool, Scalar)> {
    let (order, rest) = text.split_at_checked(1)?;
    let (kind, size) = rest.split_at_checked(1)?;
    let size: usize = size.parse().ok()?;
    let scalar = match (kind, size) {
        ("f", 4 | 8) => Scalar::Float(size),
        ("u", 1 | 2 | 4 | 8) => Scalar::Uint(size),
        ("i", 1 | 2 | 4 | 8) => Scalar::Int(size),
        _ => return None,
    };
    match order {
        "<" | "|" | "=" => Some((false, scalar)),
        ">" => Some((true, scalar)),
        _ => None,
    }
}

fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    header.split_once(key).map(|(_, rest)| rest)
}

/// The text in quotes after a key.
fn quoted<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let rest = after(header, key)?.trim_start().strip_prefix('\'')?;
    rest.split_once('\'').map(|(text, _)| text)
}

fn parse_shape(header: &str) -> Option<Vec<usize>> {
    let rest = after(header, "'shape':")?.trim_start().strip_prefix('(')?;
    let (inside, _) = rest.split_once(')')?;
    inside
        .split(',')
        .map(str::trim)
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().ok())
        .collect()
}
