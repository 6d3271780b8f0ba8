//! Text for people and JSON for machines.

use std::io::{self, Write};
use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use crate::dataset::write_atomically;

/// Where `--json` writes.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct JsonArg {
    /// Also write the summary as JSON to this file; `-` writes it to standard output instead of the text
    #[arg(long, value_name = "FILE|-")]
    json: Option<String>,
}

impl JsonArg {
    /// Writes the summary: JSON where asked for, the text unless JSON takes its place.
    pub(super) fn write(&self, text: &str, value: &impl Serialize) -> anyhow::Result<()> {
        let json = || serde_json::to_string_pretty(value).context("cannot write the summary as JSON");
        match self.json.as_deref() {
            Some("-") => print(&json()?),
            Some(path) => {
                let json = json()?;
                write_atomically(Path::new(path), |out| writeln!(out, "{json}"))?;
                print(text)
            }
            None => print(text),
        }
    }
}

/// Prints a line; a closed pipe (`| head`) is no failure.
pub(super) fn print(text: &str) -> anyhow::Result<()> {
    let written = writeln!(io::stdout().lock(), "{}", text.trim_end());
    match written {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}
