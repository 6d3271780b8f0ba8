//! How figures look: colours for light and dark, and one dash pattern and marker per method, so that lines can be
//! told apart without colour.

use crate::align::Method;

/// Looks of one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Look {
    /// Class in [`STYLE`].
    pub(super) class: &'static str,
    pub(super) marker: Option<Marker>,
}

/// Shape of the points on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Marker {
    Circle,
    Square,
    Triangle,
    Diamond,
}

/// The truth: a wide pale line under the others.
pub(super) const TRUTH: Look = Look { class: "truth", marker: None };

const LOOKS: [Look; 4] = [
    Look { class: "m0", marker: Some(Marker::Circle) },
    Look { class: "m1", marker: Some(Marker::Square) },
    Look { class: "m2", marker: Some(Marker::Triangle) },
    Look { class: "m3", marker: Some(Marker::Diamond) },
];

/// The same look for a method in every figure.
pub(super) fn look(method: Method) -> Look {
    LOOKS[method as usize % LOOKS.len()]
}

/// Style sheet inside every figure.
pub(super) const STYLE: &str = "\
.aam6d{--ink:#1f262d;--soft:#59636e;--grid:#e4e8ec;--back:#fff;--truth:#c3cad2;--m0:#0a5fb0;--m1:#c24e00;\
--m2:#00795a;--m3:#8b3a9e;font:12px system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif}\
@media(prefers-color-scheme:dark){.aam6d{--ink:#e3e8ee;--soft:#9aa5b1;--grid:#2f363e;--back:#171b20;\
--truth:#59636e;--m0:#5cb0ff;--m1:#ff9950;--m2:#3fd4a4;--m3:#dc9bec}}\
.aam6d .back{fill:var(--back)}.aam6d text{fill:var(--ink)}.aam6d .soft{fill:var(--soft)}\
.aam6d .title{font-weight:600}.aam6d .grid{stroke:var(--grid);fill:none}.aam6d .frame{stroke:var(--soft);fill:none}\
.aam6d .line{fill:none;stroke-width:1.7;stroke-linejoin:round}\
.aam6d .mark{stroke-width:1.2;stroke-dasharray:none}\
.aam6d .truth{stroke:var(--truth);stroke-width:5;stroke-linecap:round}\
.aam6d .m0{stroke:var(--m0)}.aam6d .m1{stroke:var(--m1);stroke-dasharray:7 4}\
.aam6d .m2{stroke:var(--m2);stroke-dasharray:9 3 2 3}.aam6d .m3{stroke:var(--m3);stroke-dasharray:2 3}\
.aam6d .mark.m0{fill:var(--m0)}.aam6d .mark.m1{fill:var(--m1)}.aam6d .mark.m2{fill:var(--m2)}\
.aam6d .mark.m3{fill:var(--m3)}.aam6d .mark.m0,.aam6d .mark.m1,.aam6d .mark.m2,.aam6d .mark.m3{stroke:var(--back);\
stroke-dasharray:none}\
.aam6d .mesh{fill:none;stroke:#ffd23f;stroke-opacity:.75;stroke-width:.7}\
.aam6d .landmark{fill:#00c2ff;stroke:#06222c;stroke-width:.7}";
