//! Choices of the method.

use crate::program::{folder, json, made, refused};

#[test]
fn the_order_belongs_to_the_method_paper_and_cut_models_are_named() {
    let (m, out) = (made(), folder("order"));
    let (model, data, to) = (m.model.display(), m.data.display(), out.display());
    let wrong = ["--paper-order", "choice of the method paper"];
    let track = format!("track {model} {data} --scene 1 --backend cpu --out {to}/r.csv");
    refused(&format!("{track} --paper-order right"), &wrong);
    refused(&format!("demo --frames 2 --paper-order left --out {to}/demo"), &wrong);
    let experiment = format!("experiment --frames 2 --methods edge --paper-order left --out {to}/e");
    refused(&experiment, &wrong);
    let warning = |more: &str| json(&format!("{track} {more}"))["warning"].as_str().map(str::to_owned);
    let said = warning("--method paper --paper-order right").expect("the triangles are cut");
    assert!(said.contains("--whole-triangles"), "{said}");
    assert_eq!(warning("--method forward-additive"), None, "made for any triangles");
}
