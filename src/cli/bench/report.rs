//! The tables for people.

use std::fmt::Write as _;

use super::Summary;
use super::measure::PassFigures;

const HEAD: &str = "# Benchmarks

Written by `aam6d bench --write`; run it to get yours. Times of a shared machine vary by half; ratios within one run
mean more than figures. CPU time is that of the whole process, a software GPU included, and the best of all rounds
in which the backends take turns; `cpu` is the fast implementation, `cpu (twin)` the readable reference in f64.
";

/// The document.
pub(super) fn markdown(summary: &Summary) -> Result<String, std::fmt::Error> {
    let mut text = HEAD.to_owned();
    machine(&mut text, summary)?;
    passes(&mut text, &summary.passes)?;
    sizes(&mut text, summary)?;
    frames(&mut text, summary)?;
    throughput(&mut text, summary)?;
    streams(&mut text, summary)?;
    loads(&mut text, summary)?;
    Ok(text)
}

fn machine(text: &mut String, summary: &Summary) -> std::fmt::Result {
    let m = &summary.machine;
    writeln!(text, "\n| | |\n|---|---|")?;
    writeln!(
        text,
        "| program | {} ({}), {} build |",
        m.version,
        m.commit.as_deref().unwrap_or("?"),
        m.profile
    )?;
    writeln!(text, "| CPU | {}, {} cores, {} |", m.cpu, m.cores, m.instructions)?;
    let none = "none".to_owned();
    let [adapter, driver] = [&m.adapter, &m.driver].map(|x| x.as_ref().unwrap_or(&none));
    writeln!(text, "| adapter | {adapter}, driver {driver} |")?;
    writeln!(
        text,
        "| workload | simulated relief, 640x480, {} triangles, {:?} pixels per level |",
        summary.triangles, summary.template_px
    )?;
    let e = summary.effort;
    writeln!(text, "| effort | {} rounds, {} frames |", e.rounds, e.frames)
}

fn passes(text: &mut String, passes: &[PassFigures]) -> std::fmt::Result {
    writeln!(
        text,
        "\n## Stages\n\nCPU time per pixel and iteration on one thread, full size. The limit is the time to read the bytes of\n\
         the template once and do nothing else.\n\n\
         | stage | backend | l | ns per px | times the limit | bytes per px | twin / this |\n|---|---|---|---|---|---|---|"
    )?;
    for pass in passes {
        for stage in pass.stages.iter().filter(|s| s.stage != "downsample") {
            let (name, l, ns) = (stage.stage, pass.modes, stage.ns_per_px);
            let over = ns / pass.limit_ns_per_px;
            let ratio = of_twin(pass, name) / ns;
            writeln!(
                text,
                "| {name} | {} | {l} | {ns:.2} | {over:.2} | {:.0} | {ratio:.1} |",
                stage.backend, pass.bytes_per_px
            )?;
        }
        writeln!(text, "| accumulate | limit | {} | {:.2} | 1 | | |", pass.modes, pass.limit_ns_per_px)?;
    }
    let downsample = passes.iter().flat_map(|p| &p.stages).filter(|s| s.stage == "downsample");
    let best = downsample.map(|s| s.ns_per_px).fold(f64::INFINITY, f64::min);
    writeln!(text, "| downsample | cpu | | {best:.2} | | | |")
}

fn of_twin(pass: &PassFigures, stage: &str) -> f64 {
    pass.stages.iter().find(|s| s.stage == stage).map_or(f64::NAN, |s| s.ns_per_px)
}

fn sizes(text: &mut String, summary: &Summary) -> std::fmt::Result {
    writeln!(
        text,
        "\n## Number of pixels\n\nStage accumulate, l = {}, ns per pixel; `us` is the whole pass.\n\n\
         | pixels N | backend | ns per px | us | limit, ns per px |\n|---|---|---|---|---|",
        summary.sizes.first().map_or(0, |pass| pass.modes)
    )?;
    for pass in &summary.sizes {
        for stage in pass.stages.iter().filter(|s| s.stage == "accumulate") {
            let (n, ns, limit) = (pass.pixels, stage.ns_per_px, pass.limit_ns_per_px);
            #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
            let us = ns * n as f64 / 1e3;
            writeln!(text, "| {n} | {} | {ns:.2} | {us:.0} | {limit:.2} |", stage.backend)?;
        }
    }
    Ok(())
}

fn frames(text: &mut String, summary: &Summary) -> std::fmt::Result {
    writeln!(
        text,
        "\n## One stream\n\nMedian over the frames, all three levels, from image to pose; CPU backends on one thread. Backends and methods take turns,\n\
         a whole sequence each, twelve times; the best time of every frame counts.\n\n\
         | method | backend | l | CPU ms | wall ms | iterations | lost |\n|---|---|---|---|---|---|---|"
    )?;
    for f in &summary.frames {
        let t = f.per_frame;
        writeln!(
            text,
            "| {} | {} | {} | {:.2} | {:.2} | {:.1} | {} |",
            f.method, f.backend, f.modes, t.cpu_ms, t.wall_ms, f.iterations, f.lost
        )?;
    }
    Ok(())
}

fn throughput(text: &mut String, summary: &Summary) -> std::fmt::Result {
    writeln!(
        text,
        "\n## Many poses of one object in one frame\n\nl = 4, all cores.\n\n\
         | backend | poses B | poses per second | CPU ms per pose |\n|---|---|---|---|"
    )?;
    for f in &summary.throughput {
        let (b, per_second, cpu) = (f.poses, f.per_second, f.cpu_ms_per_pose);
        writeln!(text, "| {} | {b} | {per_second:.0} | {cpu:.2} |", f.backend)?;
    }
    Ok(())
}

fn streams(text: &mut String, summary: &Summary) -> std::fmt::Result {
    writeln!(
        text,
        "\n## Many streams of one object\n\nOne tracker per stream, each at another point of the sequence, all with one model; \
         l = 4, all cores. Submits, maps\nand what is read back are per frame. The memory of a further stream is that of \
         the process, the device's included where\nit is software.\n\n\
         | backend | streams B | frames per second | CPU ms per frame | submits | maps | kB read | MB per further stream |\n\
         |---|---|---|---|---|---|---|---|"
    )?;
    for f in &summary.streams {
        let (b, per_second, cpu) = (f.streams, f.per_second, f.cpu_ms_per_frame);
        let mb = f.mb_per_stream.map_or_else(String::new, |mb| format!("{mb:.1}"));
        let (submits, maps, kb) = (f.submits_per_frame, f.maps_per_frame, f.kb_read_per_frame);
        let name = &f.backend;
        writeln!(
            text,
            "| {name} | {b} | {per_second:.0} | {cpu:.2} | {submits:.2} | {maps:.2} | {kb:.0} | {mb} |"
        )?;
    }
    Ok(())
}

fn loads(text: &mut String, summary: &Summary) -> std::fmt::Result {
    writeln!(
        text,
        "\n## Start\n\nOpening the backend and loading the model, shader compilation and warm-up included.\n\n\
         | backend | l | wall ms |\n|---|---|---|"
    )?;
    for f in &summary.loads {
        writeln!(text, "| {} | {} | {:.0} |", f.backend, f.modes, f.open_and_load.wall_ms)?;
    }
    match summary.peak_memory_mb {
        Some(mb) => writeln!(text, "\nPeak memory of the whole run: {mb:.0} MB."),
        None => Ok(()),
    }
}
