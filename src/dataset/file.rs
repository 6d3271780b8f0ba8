//! Whole files: text in, and output that appears complete or not at all.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Reads a UTF-8 text file.
///
/// # Errors
/// [`Error::Io`] if it cannot be read, [`Error::Line`] at the first byte that is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = fs::read(path).map_err(|e| Error::io(path, e))?;
    String::from_utf8(bytes).map_err(|e| {
        let good = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        Error::line(path, line_after(good), "not UTF-8 text", "save the file as UTF-8 text")
    })
}

/// Number (from 1) of the line that follows the bytes `before`.
fn line_after(before: &[u8]) -> u64 {
    1 + before.iter().map(|&b| u64::from(b == b'\n')).sum::<u64>()
}

/// Writes a file through a temporary file in the same folder, so that readers see the old content or the new
/// one and never a part. Missing parent folders are made. Devices and pipes are written directly.
///
/// # Errors
/// [`Error::Io`] naming `path`, from the file system or from `write`; the old content is then untouched.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    replace(path, write).map_err(|e| Error::io(path, e))
}

fn replace(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    // A link must keep pointing to its file: replace the file, not the link.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if fs::metadata(&target).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let mut device = fs::OpenOptions::new().write(true).open(&target)?;
        write(&mut device)?;
        return device.flush();
    }
    let folder = parent(&target);
    fs::create_dir_all(&folder)?;
    let mut out = BufWriter::new(temporary(&folder)?);
    write(&mut out)?;
    let file = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.as_file().sync_all()?;
    file.persist(&target)?;
    Ok(())
}

fn parent(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// A temporary file with the permissions of an ordinary new file (its own default is private to the user).
fn temporary(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".aam6d-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_appears_whole_in_a_new_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/out.txt");
        write_atomically(&path, |w| w.write_all(b"one")).unwrap();
        write_atomically(&path, |w| w.write_all(b"two")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two", "the second content replaces the first");
    }

    #[test]
    fn a_failing_writer_leaves_the_old_content_and_no_litter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        let text = error.unwrap_err().to_string();
        assert!(text.contains("out.txt") && text.contains("disk full"), "{text}");
        assert_eq!(fs::read(&path).unwrap(), b"old", "untouched");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
    }

    #[test]
    fn a_folder_in_the_way_is_an_error_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let text = write_atomically(folder.path(), |w| w.write_all(b"x")).unwrap_err().to_string();
        assert!(text.contains(folder.path().to_str().unwrap()), "{text}");
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomically(&link, |w| w.write_all(b"new")).unwrap();
        assert!(link.is_symlink(), "still a link");
        assert_eq!(fs::read(&file).unwrap(), b"new", "its file has the content");
        write_atomically("/dev/null", |w| w.write_all(b"x")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file(), "still a device");
    }

    #[test]
    fn bad_text_is_named_by_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.txt");
        fs::write(&path, b"one\ntwo\n\xff").unwrap();
        let text = read_text(&path).unwrap_err().to_string();
        assert!(text.contains("t.txt:3:"), "{text}");
    }
}
