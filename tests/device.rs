//! What happens when devices are missing, lost, or too small.

mod support;

use std::process::{Command, ExitCode};

use aam6d::Error;
use aam6d::backend::gpu::GpuOptions;
use aam6d::backend::{AdapterSelection, Backend, GpuBackend, Sums, adapters};
use aam6d::imaging::GrayImage;
use libtest_mimic::{Failed, Trial};
use support::Scene;
use support::gpu::{open, sums, trial};

/// Set for the process that must not find a driver.
const NO_DRIVER: &str = "AAM6D_TEST_NO_DRIVER";

fn main() -> ExitCode {
    if std::env::var_os(NO_DRIVER).is_some() {
        return report_missing_driver();
    }
    support::gpu::main(vec![
        trial("lost_and_reopened", a_lost_device_is_reported_and_can_be_opened_again),
        trial("lost_while_loading", loading_on_a_lost_device_fails),
        trial("image_too_large", an_image_beyond_the_limit_is_refused),
        trial("request_does_not_fit", wrong_requests_are_refused),
        trial("listed", adapters_can_be_selected),
        trial("unknown_adapter", an_unknown_adapter_is_refused_with_a_list),
        Trial::test("no_driver", a_missing_driver_is_said).with_kind("gpu"),
    ])
}

fn expect<T: std::fmt::Debug>(
    what: &str,
    result: Result<T, Error>,
    is_it: impl Fn(&Error) -> bool,
) -> Result<(), Failed> {
    match result {
        Err(error) if is_it(&error) => Ok(()),
        other => Err(format!("{what} gave {other:?}").into()),
    }
}

fn lost(error: &Error) -> bool {
    matches!(error, Error::DeviceLost { reason, .. } if reason.contains("Destroyed"))
}

fn a_lost_device_is_reported_and_can_be_opened_again() -> Result<(), Failed> {
    let scene = Scene::new(1, 257, 3, 2);
    let mut gpu = open(GpuOptions::default());
    let before = sums(&mut gpu, &scene)?;
    let model = gpu.load(&scene.model)?;
    gpu.destroy();
    let mut after = before.clone();
    for _ in 0..2 {
        expect("accumulate", gpu.accumulate(&scene.request(model), &mut after), lost)?;
    }
    if after != before {
        return Err("results so far were not kept".into());
    }
    expect("set_frame", gpu.set_frame(&scene.image, 1), lost)?;
    expect("read_level", gpu.read_level(0, 0), lost)?;
    let again = sums(&mut open(GpuOptions::default()), &scene)?;
    if again == before { Ok(()) } else { Err("the reopened device gives other sums".into()) }
}

fn loading_on_a_lost_device_fails() -> Result<(), Failed> {
    let mut gpu = open(GpuOptions::default());
    gpu.destroy();
    expect("load", gpu.load(&Scene::new(2, 256, 4, 1).model), lost)
}

fn an_image_beyond_the_limit_is_refused() -> Result<(), Failed> {
    let mut gpu = open(GpuOptions::default());
    let side = gpu.adapter().max_image_side + 1;
    let too_small =
        |e: &Error| matches!(e, Error::AdapterTooSmall { needed, .. } if *needed == u64::from(side));
    expect("an image too wide", gpu.set_frame(&GrayImage::new(side, 1), 2), too_small)?;
    Ok(gpu.set_frame(&GrayImage::new(64, 48), 2)?)
}

fn wrong_requests_are_refused() -> Result<(), Failed> {
    let scene = Scene::new(4, 255, 3, 2);
    let mut gpu = open(GpuOptions::default());
    let invalid = |e: &Error| matches!(e, Error::Invalid { .. });
    let model = gpu.load(&scene.model)?;
    let request = scene.request(model);
    let mut out = Sums::default();
    expect("no frame", gpu.accumulate(&request, &mut out), invalid)?;
    gpu.set_frame(&scene.image, 1)?;
    let short = aam6d::backend::Request { warps: &scene.warps[1..], ..request };
    expect("too few warps", gpu.accumulate(&short, &mut out), invalid)?;
    let level = aam6d::backend::Request { level: 1, image_level: 1, ..request };
    expect("no such level", gpu.accumulate(&level, &mut out), invalid)?;
    Ok(gpu.accumulate(&request, &mut out)?)
}

fn adapters_can_be_selected() -> Result<(), Failed> {
    for adapter in adapters() {
        let selections =
            [AdapterSelection::Index(adapter.index), AdapterSelection::Name(adapter.name.to_uppercase())];
        for selection in selections {
            let gpu = GpuBackend::open(&selection)?;
            if gpu.name() != adapter.name {
                return Err(format!("{selection:?} opened {}", gpu.name()).into());
            }
        }
    }
    Ok(())
}

fn an_unknown_adapter_is_refused_with_a_list() -> Result<(), Failed> {
    let present = adapters()[0].name.clone();
    for selection in [AdapterSelection::Name("no such device".into()), AdapterSelection::Index(99)] {
        let listed = |e: &Error| matches!(e, Error::NoAdapter { reason } if reason.contains(&present));
        expect("an unknown adapter", GpuBackend::open(&selection), listed)?;
    }
    Ok(())
}

/// Drivers are found by environment variables, so another process has to try without them.
fn a_missing_driver_is_said() -> Result<(), Failed> {
    let output = Command::new(std::env::current_exe()?)
        .env(NO_DRIVER, "1")
        .env("VK_ICD_FILENAMES", "/no/such/driver.json")
        .env("VK_DRIVER_FILES", "/no/such/driver.json")
        .output()?;
    if output.status.success() {
        return Ok(());
    }
    Err(String::from_utf8_lossy(&output.stderr).into_owned().into())
}

fn report_missing_driver() -> ExitCode {
    match GpuBackend::open(&AdapterSelection::Auto) {
        Err(Error::NoAdapter { reason }) if reason.contains("no Vulkan loader or driver") => {
            ExitCode::SUCCESS
        }
        // Other platforms have their graphics interface built in.
        _ if !cfg!(target_os = "linux") => ExitCode::SUCCESS,
        other => {
            #[expect(clippy::print_stderr, reason = "the parent process reads it")]
            {
                eprintln!("without a driver: {other:?}");
            }
            ExitCode::FAILURE
        }
    }
}
