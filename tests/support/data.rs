//! The real image sequences: `AAM6D_DATA`, or `../shared/data` beside the repository. Without them every case is shown as
//! ignored. With `AAM6D_FIGURES=1` the measured figures are printed.

use std::io::Write;
use std::path::{Path, PathBuf};

use libtest_mimic::{Arguments, Failed, Trial};

/// A case gets the folder of the data sets.
pub(crate) type Case = fn(&Path) -> Result<(), Failed>;

/// The folder of the data sets, and whether it is absent.
pub(crate) fn folder() -> (PathBuf, bool) {
    let folder = std::env::var_os("AAM6D_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let absent = !folder.is_dir();
    (folder, absent)
}

/// A case as a test.
pub(crate) fn trial(name: &str, case: Case) -> Trial {
    let (folder, absent) = folder();
    Trial::test(name, move || case(&folder)).with_ignored_flag(absent)
}

/// Runs the tests.
pub(crate) fn main(trials: Vec<Trial>) {
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

pub(crate) fn check(condition: bool, message: impl Into<String>) -> Result<(), Failed> {
    if condition { Ok(()) } else { Err(message.into().into()) }
}

/// Shows a measured figure where asked for.
pub(crate) fn figure(text: &str) {
    if std::env::var_os("AAM6D_FIGURES").is_some() {
        let _ = writeln!(std::io::stderr().lock(), "{text}");
    }
}
