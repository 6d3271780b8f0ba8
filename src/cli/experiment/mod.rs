//! `aam6d experiment`: the paper's comparison on simulated sequences, as tables, figures and one page.

mod basin;
mod cases;
mod curves;
mod data;
mod html;
mod methods;
mod motion;
mod plot;
mod published;
mod record;
mod run;
mod sheet;
mod starts;
mod tables;
mod template;
mod theme;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::ValueEnum;
use serde::Serialize;

use super::method::OrderArg;
use super::simulate::Choice;
use super::summary::JsonArg;
use crate::align::Method;
use basin::Basin;
use cases::Case;
use methods::{BackendChoice, engines};
use record::{Options, PublishedTable, Report, write_bytes, write_json, write_text};
use run::Plan;
use template::Picture;

/// Names a folder that an earlier experiment wrote and this one may write to again.
const MARKER: &str = "aam6d-experiment.json";

/// What to find out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Study {
    /// Track both sequences with every method
    Sequences,
    /// How far away a start may be
    Basin,
    /// Both
    All,
}

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for everything; a folder of an earlier experiment is written over
    #[arg(long, value_name = "DIR", default_value = "experiment")]
    out: PathBuf,
    /// What to find out
    #[arg(long, value_enum, default_value = "sequences")]
    study: Study,
    /// What to show
    #[arg(long, value_enum, default_value = "cell")]
    scene: Choice,
    /// Frames of each of the two sequences
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(2..))]
    frames: u32,
    /// Seed of simulation and start poses
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let exposure and direction of light change
    #[arg(long)]
    light: bool,
    /// Cell: standard deviation of a click in pixels, per coordinate
    #[arg(long, value_name = "PX", default_value_t = 0.3)]
    click_noise: f64,
    /// Number of appearance modes
    #[arg(long, value_name = "L", default_value_t = 0)]
    modes: usize,
    /// Methods to compare; all if not given
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',')]
    methods: Vec<Method>,
    #[command(flatten)]
    order: OrderArg,
    /// Where the image work is done
    #[arg(long, value_enum, default_value = "both")]
    backend: BackendChoice,
    /// GPU adapter to use: part of its name or its number (see `aam6d info`)
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Starts per tilt and distance (study of the basin)
    #[arg(long, default_value_t = 24, value_parser = at_least_one)]
    trials: usize,
    #[command(flatten)]
    json: JsonArg,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Found {
    sequences: Option<Report>,
    basin: Option<Basin>,
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "give a whole number from 1 on".to_owned())
}

impl Args {
    /// The methods, each once, in the order of the tables.
    fn methods(&self) -> Vec<Method> {
        let wanted = |m: &Method| self.methods.is_empty() || self.methods.contains(m);
        Method::ALL.into_iter().filter(wanted).collect()
    }

    fn options(&self) -> anyhow::Result<Options> {
        Ok(Options {
            scene: self.scene,
            frames: self.frames,
            seed: self.seed,
            light: self.light,
            modes: self.modes,
            click_noise_px: self.click_noise,
            methods: self.methods(),
            backend: self.backend,
            paper_order: self.order.among(&self.methods())?,
        })
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    claim(&args.out)?;
    // What the other study found is still in the folder and stays on the page.
    let mut report: Option<Report> = read(&args.out.join("results.json"));
    let mut basin: Option<Basin> = read(&args.out.join("basin.json"));
    let mut text = String::new();
    if args.study != Study::Basin {
        let done = sequences(args, basin.as_ref())?;
        text.push_str(&tables::markdown(&done));
        report = Some(done);
    }
    if args.study != Study::Sequences {
        let done = study_basin(args)?;
        writeln!(text, "\n{}\n\n{}", basin::note(&done), basin::sheet(&done).markdown())?;
        basin = Some(done);
        html::write(&args.out, report.as_ref(), basin.as_ref())?;
    }
    writeln!(text, "\n{}: report.html shows everything", args.out.display())?;
    let found = Found {
        sequences: report.filter(|_| args.study != Study::Basin),
        basin: basin.filter(|_| args.study != Study::Sequences),
    };
    args.json.write(&text, &found)
}

fn study_basin(args: &Args) -> anyhow::Result<Basin> {
    let backends = engines(args.backend, args.adapter.as_deref())?;
    let engine = backends.iter().find(|b| b.absent.is_none()).context("there is no backend")?;
    basin::run(&basin::Options {
        out: &args.out,
        seed: args.seed,
        trials: args.trials,
        methods: args.methods(),
        order: args.order.among(&args.methods())?,
        engine,
        adapter: args.adapter.as_deref(),
    })
}

/// A record of an earlier run, if it can be read.
fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

/// Takes a folder that is new, empty, or from an earlier experiment.
fn claim(out: &Path) -> anyhow::Result<()> {
    let occupied = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    anyhow::ensure!(
        !occupied || out.join(MARKER).is_file(),
        "{}: the folder is not empty and not from an earlier experiment; choose another with --out",
        out.display()
    );
    write_json(&out.join(MARKER), &env!("CARGO_PKG_VERSION"))
}

/// Runs every method on every backend through both sequences; what is finished is on disk.
fn sequences(args: &Args, basin: Option<&Basin>) -> anyhow::Result<Report> {
    let began = Instant::now();
    let options = args.options()?;
    let backends = engines(options.backend, args.adapter.as_deref())?;
    let cases = cases::prepare(&args.out, &options)?;
    cases.iter().try_for_each(|case| draw_template(&args.out, case))?;
    let mut report = Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        complete: false,
        seconds: 0.0,
        options,
        backends: backends.clone(),
        sequences: cases.iter().map(|c| c.record.clone()).collect(),
        runs: Vec::new(),
        published: PublishedTable::new(),
    };
    let present: Vec<_> = backends.iter().filter(|b| b.absent.is_none()).collect();
    let total = report.options.methods.len() * present.len() * cases.len();
    for method in report.options.methods.clone() {
        for engine in &present {
            for case in &cases {
                let (number, name) = (case.record.number, method.name());
                let label =
                    format!("{}/{total} sequence {number}, {name}, {}", report.runs.len() + 1, engine.name);
                let adapter = args.adapter.as_deref();
                let plan = Plan {
                    case,
                    method,
                    order: report.options.paper_order,
                    engine,
                    adapter,
                    out: &args.out,
                    label,
                };
                let run =
                    plan.run().with_context(|| format!("sequence {number}, {name}, {}", engine.name))?;
                report.runs.push(run);
                report.complete = report.runs.len() == total;
                report.seconds = began.elapsed().as_secs_f64();
                publish(&args.out, &report, basin)?;
            }
        }
    }
    Ok(report)
}

/// Writes what is known so far.
fn publish(out: &Path, report: &Report, basin: Option<&Basin>) -> anyhow::Result<()> {
    write_json(&out.join("results.json"), report)?;
    write_text(&out.join("table1.md"), &tables::markdown(report))?;
    for sequence in &report.sequences {
        let n = sequence.number;
        let figures = [
            ("coefficients", curves::coefficients(report, sequence)),
            ("errors", curves::errors(report, sequence)),
        ];
        for (name, figure) in figures {
            write_text(&out.join(format!("figures/{name}-{n}.svg")), &figure.to_string())?;
        }
    }
    html::write(out, Some(report), basin)
}

/// Template and weights of the model of a sequence.
fn draw_template(out: &Path, case: &Case) -> anyhow::Result<()> {
    let n = case.record.number;
    let picture = Picture::new(&case.models.cut, &case.mesh)?;
    let path = |name: &str, ending: &str| out.join(format!("figures/{name}-{n}.{ending}"));
    write_bytes(&path("template", "png"), &picture.template_png()?)?;
    write_bytes(&path("weights", "png"), &picture.weights_png()?)?;
    write_text(&path("template", "svg"), &picture.landmarks()?.to_string())?;
    write_text(&path("weights", "svg"), &picture.weights()?.to_string())
}
