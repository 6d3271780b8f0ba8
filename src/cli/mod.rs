//! The command line: each command reads files and writes files.

mod align;
mod backend;
mod bench;
mod decode;
mod demo;
mod details;
mod eval;
mod experiment;
mod follow;
mod frames;
mod hand_eye;
mod info;
mod init;
mod landmarks;
mod method;
mod overlay;
mod progress;
mod records;
mod simulate;
mod smoothed;
mod summary;
mod track;
mod train;

use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Tracks the 6-DoF pose of a known, textured, rigid object in calibrated video.
#[derive(Debug, Parser)]
#[command(name = "aam6d", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulate, train on one sequence, track the other, evaluate: no input needed
    Demo(demo::Args),
    /// Write a simulated BOP dataset with exact ground truth
    Simulate(simulate::Args),
    /// Triangulate landmarks from clicks in a stereo pair
    Landmarks(landmarks::Args),
    /// Train a model from posed or annotated frames
    Train(train::Args),
    /// Track an object through a scene
    Track(track::Args),
    /// Align every given start pose on its own
    Align(align::Args),
    /// Judge poses against a reference
    Eval(eval::Args),
    /// Compare the methods as the paper does: Table 1, figures, one page
    Experiment(experiment::Args),
    /// Calibrate where the camera sits on the robot's end-effector
    HandEye(hand_eye::Args),
    /// Measure time and memory of every backend on the standard workload
    Bench(bench::Args),
    /// Show the adapters, which one would be used and why, and test CPU against GPU
    Info(info::Args),
}

/// Runs the program. Exit code 0: done, 1: failed, 2: wrong usage.
pub fn run(args: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            let wrong = error.use_stderr();
            // Nothing is left to report to if the terminal is gone.
            let _ = error.print();
            return if wrong { ExitCode::from(2) } else { ExitCode::SUCCESS };
        }
    };
    start_log();
    match execute(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr().lock(), "aam6d: {}", chain(&error));
            ExitCode::FAILURE
        }
    }
}

/// The error and its causes, each said once.
fn chain(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |text, cause| match text {
        text if text.is_empty() => cause,
        text if text.contains(&cause) => text,
        text => format!("{text}: {cause}"),
    })
}

fn execute(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Landmarks(args) => landmarks::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Track(args) => track::run(&args),
        Command::Align(args) => align::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Experiment(args) => experiment::run(&args),
        Command::HandEye(args) => hand_eye::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Info(args) => info::run(&args),
    }
}

/// Warnings go to the terminal; `AAM6D_LOG` (e.g. `debug`) shows more.
fn start_log() {
    use tracing_subscriber::filter::{EnvFilter, LevelFilter};
    let filter = EnvFilter::builder()
        .with_env_var("AAM6D_LOG")
        .with_default_directive(LevelFilter::ERROR.into())
        .from_env_lossy();
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
}
