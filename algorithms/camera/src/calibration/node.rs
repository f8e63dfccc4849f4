//! A YAML document as a tree, since kinds of calibration are told apart by what is in them.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use super::CalibrationError;

#[derive(Clone, Debug, PartialEq)]
pub enum Node {
    /// Nothing, or a truth value: no calibration needs them.
    Blank,
    Number(f64),
    Text(String),
    List(Vec<Node>),
    Map(BTreeMap<String, Node>),
}

impl Node {
    /// Reads the first document of a file, as YAML or as OpenCV writes it.
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let plain = first_document(text);
        // What is not finite is refused with the name of its field.
        let options = serde_saphyr::options! {
            non_finite_float_policy: serde_saphyr::options::NonFiniteFloatPolicy::PassThrough,
        };
        serde_saphyr::from_str_with_options(&plain, options).map_err(|error| {
            let reason = error.to_string();
            let first = reason.lines().next().unwrap_or_default();
            CalibrationError::Syntax(first.trim_start_matches("error: ").to_owned())
        })
    }

    /// The entry of one of these names; capitals and underscores do not matter.
    pub fn find(&self, names: &[&str]) -> Option<(&str, &Node)> {
        let Self::Map(entries) = self else {
            return None;
        };
        names.iter().find_map(|name| {
            let found = entries.iter().find(|(key, _)| plain_key(key) == *name)?;
            Some((found.0.as_str(), found.1))
        })
    }

    pub fn get(&self, key: &str) -> Option<&Node> {
        match self {
            Self::Map(entries) => entries.get(key).filter(|node| **node != Self::Blank),
            _ => None,
        }
    }

    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            _ => None,
        }
    }

    /// All numbers of a list, of lists in it, or of a matrix with `data`; `None` if there is
    /// anything else.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::Number(number) => Some(vec![*number]),
            Self::List(items) => {
                let parts: Option<Vec<_>> = items.iter().map(Self::numbers).collect();
                Some(parts?.concat())
            }
            Self::Map(entries) => entries.get("data")?.numbers(),
            Self::Blank | Self::Text(_) => None,
        }
    }
}

fn plain_key(key: &str) -> String {
    let letters = key.chars().filter(|letter| *letter != '_');
    letters.flat_map(char::to_lowercase).collect()
}

/// OpenCV begins its files with `%YAML:1.0`, which YAML does not know, and names the types of its
/// matrices; `ros2 topic echo` ends each message with a new document.
fn first_document(text: &str) -> String {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut plain = String::with_capacity(text.len());
    for line in text.lines() {
        // Lines are kept, so that errors name the right one.
        if line.starts_with('%') {
            plain.push('\n');
            continue;
        }
        if line.starts_with("---") || line.starts_with("...") {
            if !plain.trim().is_empty() {
                break;
            }
            plain.push('\n');
            continue;
        }
        plain += &line.replace("!!opencv-matrix", "");
        plain.push('\n');
    }
    plain
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("YAML")
    }

    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Blank)
    }

    fn visit_none<E>(self) -> Result<Node, E> {
        Ok(Node::Blank)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Node, D::Error> {
        Node::deserialize(deserializer)
    }

    fn visit_bool<E>(self, _: bool) -> Result<Node, E> {
        Ok(Node::Blank)
    }

    fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Number(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Node, E> {
        Ok(Node::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Node, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Node::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Node, A::Error> {
        let mut map = BTreeMap::new();
        while let Some((key, value)) = entries.next_entry()? {
            map.insert(key, value);
        }
        Ok(Node::Map(map))
    }
}
