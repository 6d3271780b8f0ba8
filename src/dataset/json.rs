//! JSON files read field by field, so that every error names the place, e.g. `"3"[0].cam_R_m2c`.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::error::{Error, Result};

/// A parsed JSON file.
pub(super) struct Document {
    path: PathBuf,
    value: Value,
}

/// A value inside a [`Document`], with its place.
#[derive(Clone)]
pub(super) struct Node<'a> {
    path: &'a Path,
    place: String,
    value: &'a Value,
}

impl Document {
    /// Reads and parses a file; syntax errors carry the line.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).map_err(|e| Error::io(path, e))?;
        let value = serde_json::from_slice(&bytes).map_err(|e| {
            let line = u64::try_from(e.line()).unwrap_or(u64::MAX);
            Error::line(path, line, e.to_string(), "write valid JSON; is the file complete?")
        })?;
        Ok(Self { path: path.to_owned(), value })
    }

    /// The outermost value.
    pub(super) fn root(&self) -> Node<'_> {
        Node { path: &self.path, place: String::new(), value: &self.value }
    }
}

impl<'a> Node<'a> {
    /// The file this value stands in.
    pub(super) fn path(&self) -> &'a Path {
        self.path
    }

    /// Where in the file this value stands.
    pub(super) fn place(&self) -> &str {
        if self.place.is_empty() { "the whole file" } else { &self.place }
    }

    /// An error at this place.
    pub(super) fn error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::field(self.path, self.place(), problem, remedy)
    }

    /// A member of an object; `None` if absent or null.
    pub(super) fn optional(&self, name: &str) -> Option<Self> {
        let value = self.value.get(name).filter(|v| !v.is_null())?;
        let place = if self.place.is_empty() { name.to_owned() } else { format!("{}.{name}", self.place) };
        Some(Self { path: self.path, place, value })
    }

    /// A member of an object that must be there.
    pub(super) fn member(&self, name: &str) -> Result<Self> {
        self.optional(name).ok_or_else(|| {
            let problem = format!("the field {name} is missing");
            self.error(problem, "see the BOP format description for the fields of this file")
        })
    }

    /// The members of an object whose keys are ids, in the order of the file.
    pub(super) fn by_id(&self) -> Result<Vec<(u32, Self)>> {
        let members = self
            .value
            .as_object()
            .ok_or_else(|| self.error("not an object", r#"write one entry per id, e.g. {"0": ...}"#))?;
        let node = |(key, value): (&'a String, &'a Value)| {
            let place = format!("{}{key:?}", self.place);
            let node = Self { path: self.path, place, value };
            let id =
                key.parse().map_err(|_| node.error("the key is not an id", "use whole numbers from 0"))?;
            Ok((id, node))
        };
        members.iter().map(node).collect()
    }

    /// The items of an array.
    pub(super) fn items(&self) -> Result<Vec<Self>> {
        let items = self.value.as_array().ok_or_else(|| self.error("not a list", "write a list in [...]"))?;
        let node = |(k, value)| Self { path: self.path, place: format!("{}[{k}]", self.place), value };
        Ok(items.iter().enumerate().map(node).collect())
    }

    /// A finite number.
    pub(super) fn number(&self) -> Result<f64> {
        self.value
            .as_f64()
            .filter(|v| v.is_finite())
            .ok_or_else(|| self.error("not a finite number", "write a finite number"))
    }

    /// A text or a whole number, as text.
    pub(super) fn label(&self) -> Result<String> {
        let text = self.value.as_str().filter(|s| !s.is_empty()).map(str::to_owned);
        text.or_else(|| self.value.as_u64().map(|n| n.to_string()))
            .ok_or_else(|| self.error("not a name", "write a text or a whole number"))
    }

    /// A whole number from 0.
    pub(super) fn whole(&self) -> Result<u32> {
        self.value
            .as_u64()
            .and_then(|v| u32::try_from(v).ok())
            .ok_or_else(|| self.error("not a whole number from 0", "write a whole number"))
    }

    /// A list of finite numbers.
    pub(super) fn numbers(&self) -> Result<Vec<f64>> {
        self.items()?.iter().map(Self::number).collect()
    }

    /// A list of exactly N finite numbers.
    pub(super) fn array<const N: usize>(&self) -> Result<[f64; N]> {
        self.numbers()?.try_into().map_err(|found: Vec<f64>| {
            self.error(format!("{} numbers instead of {N}", found.len()), "complete the list")
        })
    }
}
