//! `report.html`: one file that needs nothing else, light or dark as the reader's system is.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context;

use super::basin::{self, Basin};
use super::record::{Report, Run, SequenceRecord, write_text};
use super::sheet::{escape, number};
use super::tables;
use super::template::data_uri;

const STYLE: &str = "\
:root{color-scheme:light dark;--back:#f5f6f8;--card:#fff;--ink:#1f262d;--soft:#59636e;--rule:#dfe3e8;--tint:#f0f3f7;\
--accent:#0a5fb0}\
@media(prefers-color-scheme:dark){:root{--back:#0f1317;--card:#171b20;--ink:#e3e8ee;--soft:#9aa5b1;--rule:#2f363e;\
--tint:#1f252c;--accent:#5cb0ff}}\
*{box-sizing:border-box}body{margin:0;background:var(--back);color:var(--ink);\
font:16px/1.55 system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif}\
main{max-width:1120px;margin:0 auto;padding:40px 20px 60px}h1{font-size:1.9rem;line-height:1.2;margin:0 0 .4em}\
h2{font-size:1.3rem;margin:2.4em 0 .5em}p{max-width:76ch;margin:.5em 0 1em}.lead{font-size:1.1rem;color:var(--soft)}\
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(220px,1fr));gap:14px;margin:24px 0}\
.card,figure,.scroll{background:var(--card);border:1px solid var(--rule);border-radius:10px}\
.card{padding:14px 18px}.card b{display:block;font-size:1.7rem;line-height:1.25;font-variant-numeric:tabular-nums}\
.card span{color:var(--soft);font-size:.9rem}figure{margin:18px 0;padding:14px}\
figure svg,figure img{display:block;width:100%;height:auto;border-radius:5px}\
figcaption{color:var(--soft);font-size:.92rem;margin-top:10px;max-width:90ch}\
.row{display:grid;gap:14px}.two{grid-template-columns:repeat(2,1fr)}.three{grid-template-columns:repeat(3,1fr)}\
@media(max-width:700px){.two,.three{grid-template-columns:1fr}}.scroll{overflow-x:auto;margin:16px 0}\
table{border-collapse:collapse;width:100%;font-size:.88rem;font-variant-numeric:tabular-nums}\
th,td{padding:5px 8px;text-align:right;white-space:nowrap}.text{text-align:left}thead th{white-space:normal;\
vertical-align:bottom;color:var(--soft);font-weight:600;border-bottom:1px solid var(--rule)}\
.heading th{text-align:left;background:var(--tint);font-weight:650;padding-top:8px;padding-bottom:8px}\
td.text:first-child{font-weight:600}tbody tr+tr.first td{border-top:1px solid var(--rule)}\
.published td{color:var(--soft);font-style:italic}.published td.text:first-child{font-weight:400}\
.note{color:var(--soft)}code{font-size:.92em}";

/// Writes the page from what is in the folder.
pub(super) fn write(out: &Path, report: Option<&Report>, basin: Option<&Basin>) -> anyhow::Result<()> {
    let mut page = String::from("<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">");
    page.push_str("<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">");
    write!(page, "<title>aam6d: the paper's experiment</title><style>{STYLE}</style></head><body><main>")?;
    page.push_str("<h1>Tracking an object in 6 degrees of freedom: the paper's experiment</h1>\n");
    if let Some(report) = report {
        opening(&mut page, report)?;
        table_sections(&mut page, report)?;
        for sequence in &report.sequences {
            sequence_section(&mut page, out, report, sequence)?;
        }
        template_section(&mut page, out, report)?;
    }
    if let Some(basin) = basin {
        basin_section(&mut page, out, basin)?;
    }
    if let Some(report) = report {
        origin(&mut page, report)?;
    }
    page.push_str("</main></body></html>\n");
    write_text(&out.join("report.html"), &page)
}

/// What this is, and the numbers that matter most.
fn opening(page: &mut String, report: &Report) -> anyhow::Result<()> {
    let frames: usize = report.sequences.iter().map(|s| s.frames).sum();
    write!(
        page,
        "<p class=\"lead\">A textured object in {frames} simulated frames with exact poses. The model is trained on \
         one sequence and tracked in the other, both ways, with every method.</p>"
    )?;
    if !report.complete {
        page.push_str("<p><strong>This run was not finished; what was finished is here.</strong></p>");
    }
    page.push_str("<div class=\"cards\">");
    for sequence in &report.sequences {
        let Some(run) = report.shown(sequence.number).next() else { continue };
        let e = &run.evaluation;
        let cards = [
            (format!("{} of {}", e.frames - e.lost, e.frames), "frames tracked"),
            (format!("{} mm", number(e.rms_t_mm)), "rms error of the object's position"),
        ];
        for (value, what) in cards {
            let (value, n) = (escape(&value), sequence.number);
            write!(page, "<div class=\"card\"><b>{value}</b><span>sequence {n}: {what}</span></div>")?;
        }
    }
    page.push_str("</div>\n");
    if let Some(run) = report.shown(1).next() {
        let name = run.method.name();
        write!(
            page,
            "<p class=\"note\">The numbers above are those of the default method, <code>{name}</code>.</p>"
        )?;
    }
    Ok(())
}

fn table_sections(page: &mut String, report: &Report) -> anyhow::Result<()> {
    let (one, two) = (tables::table1(report).html(), tables::summary(report).html());
    let absent = tables::absent(report);
    write!(page, "<h2>Table 1</h2><p>{}</p>{one}", escape(tables::TABLE1_NOTE))?;
    if !absent.is_empty() {
        write!(page, "<p class=\"note\">{}</p>", escape(&absent))?;
    }
    write!(page, "<h2>As a tracker</h2><p>{}</p>{two}", escape(tables::SUMMARY_NOTE))?;
    Ok(())
}

fn sequence_section(
    page: &mut String,
    out: &Path,
    report: &Report,
    sequence: &SequenceRecord,
) -> anyhow::Result<()> {
    let n = sequence.number;
    write!(page, "<h2>Sequence {n}</h2>")?;
    let caption = "The six coefficients of the end-effector's motion since the first frame. The wide pale line is the \
                   truth; a line ends where its method lost the object.";
    figure(page, out, &format!("coefficients-{n}"), caption)?;
    let caption = "The error of every frame, on a logarithmic scale: what cannot be seen above.";
    figure(page, out, &format!("errors-{n}"), caption)?;
    let Some(run) = report.shown(n).next() else { return Ok(()) };
    overlays(page, out, run)
}

fn overlays(page: &mut String, out: &Path, run: &Run) -> anyhow::Result<()> {
    page.push_str("<figure><div class=\"row three\">");
    for name in &run.overlays {
        let path = out.join(name);
        let picture = image::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 86)
            .encode_image(&picture.to_rgb8())?;
        let frame = Path::new(name).file_stem().and_then(|s| s.to_str()).unwrap_or_default();
        let frame = frame.trim_start_matches('0');
        let frame = if frame.is_empty() { "0" } else { frame };
        let uri = data_uri("image/jpeg", &bytes);
        write!(page, "<img src=\"{uri}\" alt=\"Frame {frame} with the estimated outline\">")?;
    }
    let (name, folder) = (run.method.name(), run.overlays.first().and_then(|o| o.rsplit_once('/')));
    writeln!(
        page,
        "</div><figcaption>Estimated outline and axes by <code>{name}</code>: green is tracked, red is lost. Pictures \
         of the other methods are beside <code>{}</code>.</figcaption></figure>",
        escape(folder.map_or("overlays", |(f, _)| f))
    )?;
    Ok(())
}

fn template_section(page: &mut String, out: &Path, report: &Report) -> anyhow::Result<()> {
    page.push_str("<h2>Template and weights</h2><div class=\"row two\">");
    let Some(s) = report.sequences.first() else { return Ok(()) };
    let caption = format!(
        "The template of the model that tracks sequence {}: mean of {} training images, {} landmarks, {} triangles, {} \
         pixels.",
        s.number, s.training_images, s.landmarks, s.triangles, s.template_px
    );
    figure(page, out, &format!("template-{}", s.number), &caption)?;
    let caption = "The weight of every template pixel (eq. 10): edges count more than even areas.";
    figure(page, out, &format!("weights-{}", s.number), caption)?;
    page.push_str("</div>");
    Ok(())
}

fn basin_section(page: &mut String, out: &Path, basin: &Basin) -> anyhow::Result<()> {
    write!(page, "<h2>How far away a start may be</h2><p>{}</p>", escape(&basin::note(basin)))?;
    let caption = "Share of the starts that converged. Points of different methods at the same distance are drawn a \
                   little apart.";
    figure(page, out, "basin", caption)?;
    page.push_str(&basin::sheet(basin).html());
    Ok(())
}

/// A figure of the folder, if it has been drawn.
fn figure(page: &mut String, out: &Path, name: &str, caption: &str) -> anyhow::Result<()> {
    let path = out.join("figures").join(format!("{name}.svg"));
    if let Ok(svg) = std::fs::read_to_string(path) {
        writeln!(page, "<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption))?;
    }
    Ok(())
}

/// How the numbers came about.
fn origin(page: &mut String, report: &Report) -> anyhow::Result<()> {
    let o = &report.options;
    let scene = format!("{:?}", o.scene).to_lowercase();
    let light = if o.light { "changing" } else { "constant" };
    let devices: Vec<String> = report
        .backends
        .iter()
        .filter_map(|b| {
            let software = if b.software { ", a software adapter" } else { "" };
            Some(format!("{}{software}", b.device.as_ref()?))
        })
        .collect();
    writeln!(
        page,
        "<h2>How this was made</h2><p>aam6d {}, <code>aam6d experiment</code>: scene {scene}, {} frames per sequence, \
         seed {}, light {light}, {} appearance modes. Backends: {}. It took {:.0} s. Every number is in \
         <code>results.json</code>, every figure in <code>figures/</code>.</p>\
         <p class=\"note\">Published numbers: {}.</p>",
        escape(&report.version),
        o.frames,
        o.seed,
        o.modes,
        escape(&devices.join("; ")),
        report.seconds,
        escape(&report.published.source)
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_style_loads_nothing() {
        assert!(!super::STYLE.contains("url(") && !super::STYLE.contains("@import"), "no network");
    }
}
