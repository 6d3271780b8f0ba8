//! Procedural print: noise, panels, discs, rings and rows of letter-like strokes, in surface units.
//!
//! All edges are soft over a fraction of a unit, so that what is printed has no detail finer than a camera resolves.

use rayon::prelude::*;

use super::random::{Stream, value_noise};
use super::texture::Texture;

/// What a painted surface looks like. Lengths are surface units (millimetres on objects).
#[derive(Debug, Clone, Copy)]
pub(super) struct Style {
    /// Width and height of the surface.
    pub(super) size: [f64; 2],
    /// Bitmap resolution, texels per unit.
    pub(super) texels_per_unit: f64,
    /// Grey level of the bare surface.
    pub(super) base: f64,
    /// Grey levels of the noise, coarse to fine.
    pub(super) grain: f64,
    /// Number of large plain panels.
    pub(super) panels: usize,
    /// Number of discs and rings.
    pub(super) discs: usize,
    /// Number of rows of letters.
    pub(super) rows: usize,
    /// Largest height of a letter; discs go with it.
    pub(super) letter: f64,
    /// Half the width of every edge.
    pub(super) softness: f64,
    /// Frames the surface with a line, like the rim of a cover or the fold of a carton.
    pub(super) framed: bool,
}

/// Cell size (units) and share of each octave of the noise.
const OCTAVES: [(f64, f64); 5] = [(38.0, 1.0), (17.0, 0.7), (8.0, 0.5), (4.0, 0.36), (2.2, 0.2)];

/// A rounded rectangle, filled or as an outline; a disc if the corner radius is half the size.
#[derive(Debug, Clone, Copy)]
struct Mark {
    centre: [f64; 2],
    half: [f64; 2],
    corner: f64,
    /// Cosine and sine of its turn.
    turn: [f64; 2],
    /// Width of the outline, or `None` if filled.
    outline: Option<f64>,
    ink: f64,
    opacity: f64,
}

impl Mark {
    fn bar(centre: [f64; 2], half: [f64; 2], ink: f64) -> Self {
        let corner = 0.6 * half[0].min(half[1]);
        Self { centre, half, corner, turn: [1.0, 0.0], outline: None, ink, opacity: 0.75 }
    }

    /// Signed distance of a point to the mark's edge, negative inside.
    fn distance(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let along = (self.turn[0] * dx + self.turn[1] * dy).abs() - self.half[0] + self.corner;
        let across = (self.turn[0] * dy - self.turn[1] * dx).abs() - self.half[1] + self.corner;
        let (a, b) = (along.max(0.0), across.max(0.0));
        let d = (a * a + b * b).sqrt() + along.max(across).min(0.0) - self.corner;
        self.outline.map_or(d, |width| d.abs() - width / 2.0)
    }

    /// Radius that holds the whole mark.
    fn reach(&self) -> f64 {
        let diagonal = (self.half[0] * self.half[0] + self.half[1] * self.half[1]).sqrt();
        diagonal + self.outline.unwrap_or(0.0)
    }
}

/// A surface being painted.
struct Canvas {
    width: usize,
    height: usize,
    scale: f64,
    softness: f64,
    values: Vec<f64>,
}

impl Canvas {
    fn stamp(&mut self, mark: &Mark) {
        let reach = mark.reach() + self.softness;
        #[expect(clippy::cast_possible_truncation, reason = "clamped to the canvas")]
        let texels = |centre: f64, size: usize| {
            let lo = ((centre - reach) * self.scale).floor().clamp(0.0, size as f64) as usize;
            lo..((centre + reach) * self.scale).ceil().clamp(0.0, size as f64) as usize
        };
        let (columns, rows) = (texels(mark.centre[0], self.width), texels(mark.centre[1], self.height));
        for j in rows {
            let y = (j as f64 + 0.5) / self.scale;
            for i in columns.clone() {
                let d = mark.distance((i as f64 + 0.5) / self.scale, y);
                let t = ((self.softness - d) / (2.0 * self.softness)).clamp(0.0, 1.0);
                let cover = mark.opacity * t * t * (3.0 - 2.0 * t);
                let value = &mut self.values[j * self.width + i];
                *value += cover * (mark.ink - *value);
            }
        }
    }

    /// Bytes within about 31..225, so that neither light nor noise saturates them.
    fn into_texture(self) -> Texture {
        let byte = |v: &f64| {
            let x = (v - 128.0) / 97.0;
            #[expect(clippy::cast_possible_truncation, reason = "31..225")]
            let byte = (128.0 + 97.0 * x / (1.0 + x * x).sqrt()).round() as u8;
            byte
        };
        Texture::new(self.width, self.values.iter().map(byte).collect())
    }
}

/// Paints a surface.
pub(super) fn paint(style: &Style, random: &mut Stream) -> Texture {
    let mut canvas = ground(style, random.bits());
    for _ in 0..style.panels {
        canvas.stamp(&panel(style, random));
    }
    for _ in 0..style.discs {
        for mark in disc(style, random) {
            canvas.stamp(&mark);
        }
    }
    for row in 0..style.rows {
        let y = style.size[1] * (row as f64 + random.range(0.35, 0.65)) / style.rows as f64;
        letters(style, y, random, |mark| canvas.stamp(&mark));
    }
    if style.framed {
        canvas.stamp(&frame(style, random));
    }
    // The paper's own grain lies over everything printed, so that no panel is without structure.
    let grain = Style { base: 0.0, grain: 0.5 * style.grain, ..*style };
    let over = ground(&grain, random.bits());
    canvas.values.iter_mut().zip(over.values).for_each(|(v, g)| *v += g);
    canvas.into_texture()
}

fn ground(style: &Style, seed: u64) -> Canvas {
    let scale = style.texels_per_unit;
    #[expect(clippy::cast_possible_truncation, reason = "surfaces have a few thousand texels a side")]
    let [width, height] = style.size.map(|s| ((s * scale).ceil() as usize).max(2));
    let mut values = vec![0.0; width * height];
    values.par_chunks_mut(width).enumerate().for_each(|(j, row)| {
        let y = (j as f64 + 0.5) / scale;
        for (i, value) in row.iter_mut().enumerate() {
            let x = (i as f64 + 0.5) / scale;
            // The lattice is turned, so that its axes do not show beside the upright print.
            let (a, b) = (0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y);
            let octaves = OCTAVES.iter().zip(0_u64..);
            let noise: f64 = octaves
                .map(|(&(cell, share), k)| share * value_noise(seed.wrapping_add(k), a / cell, b / cell))
                .sum();
            *value = style.base + style.grain * noise;
        }
    });
    Canvas { width, height, scale, softness: style.softness, values }
}

fn somewhere(style: &Style, random: &mut Stream) -> [f64; 2] {
    style.size.map(|s| random.range(0.0, s))
}

/// A line along the rim.
fn frame(style: &Style, random: &mut Stream) -> Mark {
    let width = random.range(1.6, 2.6);
    Mark {
        centre: style.size.map(|s| s / 2.0),
        half: style.size.map(|s| s / 2.0 - 1.6 * width),
        corner: 3.0 * width,
        turn: [1.0, 0.0],
        outline: Some(width),
        ink: if random.chance(0.5) { 60.0 } else { 200.0 },
        opacity: 0.5,
    }
}

fn panel(style: &Style, random: &mut Stream) -> Mark {
    let angle = if random.chance(0.6) { 0.0 } else { random.range(-0.6, 0.6) };
    let short = style.size[0].min(style.size[1]);
    let half = [random.range(0.12, 0.45) * short, random.range(0.07, 0.22) * short];
    let outline = random.chance(0.3).then(|| random.range(1.2, 3.0));
    Mark {
        centre: somewhere(style, random),
        half,
        corner: random.range(0.1, 0.9) * half[1],
        turn: [libm::cos(angle), libm::sin(angle)],
        outline,
        ink: random.range(60.0, 195.0),
        opacity: random.range(0.6, 0.9),
    }
}

/// A disc with a ring around or inside it, like a seal, a bolt or a logo.
fn disc(style: &Style, random: &mut Stream) -> [Mark; 2] {
    let radius = random.range(0.6, 2.6) * style.letter;
    let ink = if random.chance(0.5) { random.range(60.0, 100.0) } else { random.range(155.0, 195.0) };
    let disc = Mark {
        centre: somewhere(style, random),
        half: [radius; 2],
        corner: radius,
        turn: [1.0, 0.0],
        outline: random.chance(0.4).then_some(0.3 * radius),
        ink,
        opacity: random.range(0.5, 0.8),
    };
    let inner = random.range(0.4, 0.7) * radius;
    let ring = Mark {
        half: [inner; 2],
        corner: inner,
        outline: random.chance(0.5).then_some(0.25 * inner),
        ink: 255.0 - ink + random.range(-15.0, 15.0),
        ..disc
    };
    [disc, ring]
}

/// A row of letter-like groups of strokes.
fn letters(style: &Style, y: f64, random: &mut Stream, mut stamp: impl FnMut(Mark)) {
    let height = random.range(0.45, 1.0) * style.letter;
    let (wide, stroke) = (0.34 * height, 0.08 * height + 0.12);
    let ink = if random.chance(0.6) { random.range(62.0, 85.0) } else { random.range(165.0, 190.0) };
    let mut x = random.range(0.0, 0.55) * style.size[0];
    let end = x + random.range(0.2, 0.6) * style.size[0];
    while x < end.min(style.size[0]) {
        x += 0.95 * height;
        if random.chance(0.14) {
            continue;
        }
        if random.chance(0.3) {
            let loop_ = Mark::bar([x, y], [wide, 0.5 * height], ink);
            stamp(Mark { outline: Some(2.0 * stroke), corner: wide, ..loop_ });
            continue;
        }
        let strokes = random.bits() | 1 << (random.bits() % 2);
        let upright = |dx: f64| Mark::bar([x + dx, y], [stroke, 0.5 * height], ink);
        let level = |dy: f64| Mark::bar([x, y + dy], [wide, stroke], ink);
        let all = [upright(-wide), upright(wide), level(-0.45 * height), level(0.0), level(0.45 * height)];
        all.into_iter().enumerate().filter(|(i, _)| strokes >> i & 1 == 1).for_each(|(_, mark)| stamp(mark));
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    #[test]
    fn a_surface_is_contrasted_but_not_saturated() {
        let style = Style {
            size: [80.0, 60.0],
            texels_per_unit: 4.0,
            base: 130.0,
            grain: 25.0,
            panels: 3,
            discs: 4,
            rows: 4,
            letter: 6.0,
            softness: 0.5,
            framed: true,
        };
        let texture = paint(&style, &mut Stream::new(1, Purpose::Surface, 0));
        assert_eq!(texture.size(), [320, 240], "four texels per unit");
        let (lo, hi) = texture.texels().iter().fold((255, 0), |(lo, hi), &v| (v.min(lo), v.max(hi)));
        assert!((25..90).contains(&lo) && (165..=230).contains(&hi), "{lo}..{hi}");
    }
}
