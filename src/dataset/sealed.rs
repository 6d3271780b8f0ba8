//! The program's own binary files: magic, version, length and checksum before the payload, so that a wrong, old, cut or
//! damaged file is told from a good one.

use std::path::Path;

use crate::error::{Error, Result};

/// What kind of file it is.
#[derive(Debug, Clone, Copy)]
pub struct Seal {
    /// First bytes.
    pub magic: [u8; 8],
    /// Of the payload; files of another version are refused.
    pub version: u32,
    /// Name of the kind, for messages.
    pub what: &'static str,
    /// How to get a new one, for messages.
    pub remedy: &'static str,
}

impl Seal {
    /// The bytes of a file: magic, version, length of the payload and its CRC-32 (IEEE), all little-endian, and the payload.
    pub fn close(&self, payload: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(8 + 4 + 8 + 4 + payload.len());
        bytes.extend_from_slice(&self.magic);
        bytes.extend_from_slice(&self.version.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&crc32fast::hash(payload).to_le_bytes());
        bytes.extend_from_slice(payload);
        bytes
    }

    /// The payload of a file; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Field`] for a file of another kind or version, and one that is cut short or damaged.
    pub fn open<'b>(&self, path: &Path, bytes: &'b [u8]) -> Result<&'b [u8]> {
        let wrong = |field, problem, remedy| Error::field(path, field, problem, remedy);
        let again = format!("copy the file again or {}", self.remedy);
        let truncated =
            || wrong("header", format!("the file ends after {} bytes", bytes.len()), again.as_str());
        let (magic, rest) = bytes.split_first_chunk::<8>().ok_or_else(truncated)?;
        if *magic != self.magic {
            return Err(wrong("magic", format!("this is not a {}", self.what), self.remedy));
        }
        let (version, rest) = rest.split_first_chunk::<4>().ok_or_else(truncated)?;
        let version = u32::from_le_bytes(*version);
        if version != self.version {
            let problem = format!("version {version}, this program reads version {}", self.version);
            return Err(wrong("version", problem, &format!("{} with this program", self.remedy)));
        }
        let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(truncated)?;
        let (checksum, payload) = rest.split_first_chunk::<4>().ok_or_else(truncated)?;
        let length = u64::from_le_bytes(*length);
        if payload.len() as u64 != length {
            let problem = format!("{} bytes where the header says {length}", payload.len());
            return Err(wrong("payload", problem, &again));
        }
        if crc32fast::hash(payload) != u32::from_le_bytes(*checksum) {
            return Err(wrong("payload", "the checksum is wrong: the file is damaged".to_owned(), &again));
        }
        Ok(payload)
    }
}
