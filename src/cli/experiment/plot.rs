//! Line plots as SVG: panels in a grid under one legend.

use svg::Document;
use svg::node::element::{Group, Line as Segment, Polygon, Polyline, Rectangle, Style, Text};

use super::theme::{Look, Marker, STYLE};

/// Width of a figure; heights follow.
const WIDTH: f64 = 960.0;
const PANEL_HEIGHT: f64 = 218.0;
const LEGEND_HEIGHT: f64 = 30.0;
/// Room in a panel beside the axes: left, right, above, below.
const MARGIN: [f64; 4] = [58.0, 14.0, 26.0, 40.0];

/// How numbers become positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Logarithmic,
}

/// One axis of a panel.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) label: String,
    pub(super) scale: Scale,
    pub(super) from: f64,
    pub(super) to: f64,
}

/// A line; it is broken where a piece ends.
#[derive(Debug, Clone)]
pub(super) struct Line {
    pub(super) look: Look,
    pub(super) pieces: Vec<Vec<[f64; 2]>>,
    /// A marker at every how many points, and at which first.
    pub(super) markers: (usize, usize),
}

/// One pair of axes.
#[derive(Debug, Clone)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) x: Axis,
    pub(super) y: Axis,
    pub(super) lines: Vec<Line>,
}

impl Axis {
    /// From `from` to `to`, both included.
    pub(super) fn linear(label: &str, from: f64, to: f64) -> Self {
        Self { label: label.to_owned(), scale: Scale::Linear, from, to }
    }

    /// Linear, around all values with a little room.
    pub(super) fn around(label: &str, values: impl Iterator<Item = f64>) -> Self {
        let (lo, hi) = range(values).unwrap_or((0.0, 1.0));
        let room = 0.06 * (hi - lo).max(1e-9);
        Self::linear(label, lo - room, hi + room)
    }

    /// Logarithmic, whole decades around all positive values.
    pub(super) fn decades(label: &str, values: impl Iterator<Item = f64>) -> Self {
        let (lo, hi) = range(values.filter(|v| *v > 0.0)).unwrap_or((0.1, 1.0));
        let (from, to) = (lo.log10().floor(), hi.log10().ceil());
        let to = if to > from { to } else { from + 1.0 };
        let (from, to) = (10_f64.powf(from), 10_f64.powf(to));
        Self { label: label.to_owned(), scale: Scale::Logarithmic, from, to }
    }

    /// 0 at the beginning of the axis, 1 at its end.
    fn share(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.from) / (self.to - self.from),
            Scale::Logarithmic => (value.max(self.from) / self.from).log10() / (self.to / self.from).log10(),
        }
    }

    fn ticks(&self) -> Vec<f64> {
        match self.scale {
            Scale::Linear => linear_ticks(self.from, self.to),
            Scale::Logarithmic => decade_ticks(self.from, self.to),
        }
    }
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.filter(|v| v.is_finite()).fold(None, |range, v| {
        let (lo, hi) = range.unwrap_or((v, v));
        Some((lo.min(v), hi.max(v)))
    })
}

/// About five multiples of 1, 2 or 5 times a power of ten.
fn linear_ticks(from: f64, to: f64) -> Vec<f64> {
    let rough = (to - from) / 5.0;
    let power = 10_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|f| f * power >= rough * 0.999).unwrap_or(10.0);
    let step = factor * power;
    let first = (from / step - 1e-9).ceil();
    let at = |k: u32| (first + f64::from(k)) * step;
    (0..20).map(at).take_while(|v| *v <= to + step * 1e-9).collect()
}

fn decade_ticks(from: f64, to: f64) -> Vec<f64> {
    let first = from.log10().round();
    (0..20).map(|k| 10_f64.powf(first + f64::from(k))).take_while(|v| *v <= to * 1.001).collect()
}

/// A tick's number without superfluous digits.
fn tick_text(value: f64, step: f64) -> String {
    let digits = (0_usize..6).find(|&d| {
        let scale = 10_f64.powf(f64::from(u32::try_from(d).unwrap_or(0)));
        (step * scale - (step * scale).round()).abs() < 1e-6 * (step * scale)
    });
    let text = format!("{value:.*}", digits.unwrap_or(6));
    if text.trim_start_matches(['-', '0', '.']).is_empty() { "0".into() } else { text.replace('-', "−") }
}

/// A figure of panels, `columns` side by side, with a legend above. `about` tells those who cannot see it.
pub(super) fn figure(panels: &[Panel], columns: usize, legend: &[(Look, String)], about: &str) -> Document {
    let rows = panels.len().div_ceil(columns);
    let height = LEGEND_HEIGHT + PANEL_HEIGHT * count(rows) + 4.0;
    let width = WIDTH / count(columns);
    let mut document = canvas(WIDTH, height, about).add(legend_row(legend));
    for (k, panel) in panels.iter().enumerate() {
        let (x, y) = (width * count(k % columns), LEGEND_HEIGHT + PANEL_HEIGHT * count(k / columns));
        document = document.add(draw(panel, width).set("transform", format!("translate({x:.1} {y:.1})")));
    }
    document
}

/// An empty figure with its background and styles.
pub(super) fn canvas(width: f64, height: f64, about: &str) -> Document {
    Document::new()
        .set("viewBox", format!("0 0 {width} {height}"))
        .set("class", "aam6d")
        .set("role", "img")
        .set("aria-label", about)
        .add(Style::new(STYLE))
        .add(Rectangle::new().set("class", "back").set("width", "100%").set("height", "100%"))
}

fn count(n: usize) -> f64 {
    f64::from(u32::try_from(n).unwrap_or(u32::MAX))
}

fn legend_row(legend: &[(Look, String)]) -> Group {
    let mut group = Group::new();
    let mut x = MARGIN[0];
    for (look, name) in legend {
        let line = Polyline::new()
            .set("points", format!("{x:.1},16 {:.1},16", x + 34.0))
            .set("class", format!("line {}", look.class));
        group = group.add(line);
        if let Some(shape) = look.marker {
            group = group.add(marker(shape, look.class, x + 17.0, 16.0));
        }
        group = group.add(text(x + 41.0, 20.0, name, "", "start"));
        x += 41.0 + 7.2 * count(name.chars().count()) + 26.0;
    }
    group
}

fn draw(panel: &Panel, width: f64) -> Group {
    let [left, right, above, below] = MARGIN;
    let (w, h) = (width - left - right, PANEL_HEIGHT - above - below);
    let at = |p: &[f64; 2]| {
        (left + w * panel.x.share(p[0]), above + h * (1.0 - panel.y.share(p[1]).clamp(-0.02, 1.02)))
    };
    let mut group = axes(panel, w, h).add(text(left, above - 9.0, &panel.title, "title", "start"));
    for line in &panel.lines {
        let class = format!("line {}", line.look.class);
        for piece in &line.pieces {
            let points: Vec<String> = piece.iter().map(at).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
            group = group.add(Polyline::new().set("points", points.join(" ")).set("class", class.as_str()));
        }
        let Some(shape) = line.look.marker else { continue };
        let points = line.pieces.iter().flatten();
        for (x, y) in points.skip(line.markers.1).step_by(line.markers.0.max(1)).map(at) {
            group = group.add(marker(shape, line.look.class, x, y));
        }
    }
    group
}

/// Grid, numbers and names of both axes.
fn axes(panel: &Panel, w: f64, h: f64) -> Group {
    let [left, _, above, _] = MARGIN;
    let mut group = Group::new();
    let segment = |x1: f64, y1: f64, x2: f64, y2: f64, class: &str| {
        let round = |v: f64| (v * 10.0).round() / 10.0;
        Segment::new()
            .set("x1", round(x1))
            .set("y1", round(y1))
            .set("x2", round(x2))
            .set("y2", round(y2))
            .set("class", class)
    };
    let step = |ticks: &[f64], log: Scale, k: usize| match (log, ticks) {
        (Scale::Linear, [a, b, ..]) => b - a,
        _ => ticks[k],
    };
    let ticks = panel.y.ticks();
    for (k, &tick) in ticks.iter().enumerate() {
        let y = above + h * (1.0 - panel.y.share(tick));
        let words = tick_text(tick, step(&ticks, panel.y.scale, k));
        group = group.add(segment(left, y, left + w, y, "grid"));
        group = group.add(text(left - 7.0, y + 4.0, &words, "soft", "end"));
    }
    let ticks = panel.x.ticks();
    for (k, &tick) in ticks.iter().enumerate() {
        let x = left + w * panel.x.share(tick);
        let words = tick_text(tick, step(&ticks, panel.x.scale, k));
        group = group.add(segment(x, above + h, x, above + h + 4.0, "frame"));
        group = group.add(text(x, above + h + 17.0, &words, "soft", "middle"));
    }
    let name = text(0.0, 0.0, &panel.y.label, "soft", "middle")
        .set("transform", format!("translate(13 {:.1}) rotate(-90)", above + h / 2.0));
    group
        .add(segment(left, above + h, left + w, above + h, "frame"))
        .add(text(left + w / 2.0, above + h + 33.0, &panel.x.label, "soft", "middle"))
        .add(name)
}

/// A text with its anchor `start`, `middle` or `end`.
pub(super) fn text(x: f64, y: f64, words: &str, class: &str, anchor: &str) -> Text {
    Text::new(words)
        .set("x", (x * 10.0).round() / 10.0)
        .set("y", (y * 10.0).round() / 10.0)
        .set("class", class)
        .set("text-anchor", anchor)
}

/// A marker about (x, y).
fn marker(shape: Marker, class: &str, x: f64, y: f64) -> Polygon {
    let around = |corners: u32, turn: f64, radius: f64| -> Vec<String> {
        let corner = |k: u32| {
            let angle = std::f64::consts::TAU * (f64::from(k) + turn) / f64::from(corners);
            format!("{:.1},{:.1}", x + radius * angle.sin(), y - radius * angle.cos())
        };
        (0..corners).map(corner).collect()
    };
    let points = match shape {
        Marker::Circle => around(16, 0.0, 4.2),
        Marker::Square => around(4, 0.5, 5.2),
        Marker::Triangle => around(3, 0.0, 5.6),
        Marker::Diamond => around(4, 0.0, 5.4),
    };
    Polygon::new().set("points", points.join(" ")).set("class", format!("mark {class}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::experiment::theme::TRUTH;

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(linear_ticks(-11.0, 52.0), [0.0, 20.0, 40.0], "steps of 20");
        assert_eq!(linear_ticks(0.0, 1.0).len(), 6, "steps of a fifth");
        let axis = Axis::decades("mm", [0.003, 4.0].into_iter());
        assert_eq!(axis.ticks().len(), 5, "0.001 to 10");
        assert_eq!(
            [tick_text(0.2, 0.2), tick_text(-40.0, 20.0), tick_text(-0.0, 0.5), tick_text(0.001, 0.001)],
            ["0.2", "−40", "0", "0.001"]
        );
    }

    #[test]
    fn a_broken_line_is_drawn_in_pieces() {
        let line = |pieces| Line { look: TRUTH, pieces, markers: (1, 0) };
        let panel = Panel {
            title: "x < y".into(),
            x: Axis::linear("frame", 0.0, 4.0),
            y: Axis::around("mm", [0.0, 1.0].into_iter()),
            lines: vec![line(vec![vec![[0.0, 0.0], [1.0, 1.0]], vec![[3.0, 0.5], [4.0, 0.7]]])],
        };
        let text = figure(&[panel], 1, &[(TRUTH, "truth".into())], "a test").to_string();
        assert_eq!(text.matches("<polyline").count(), 3, "two pieces and the legend: {text}");
        assert!(text.contains("x &lt; y"), "text is escaped: {text}");
    }
}
