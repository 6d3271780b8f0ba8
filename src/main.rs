//! The `aam6d` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    aam6d::cli::run(std::env::args_os())
}
